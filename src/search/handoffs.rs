//! Handoffs found so far. A meeting of two arms in the air depends on nothing but the arms, the
//! two holds and the object's shape, so that what was sampled for one object serves all of its
//! class.

use std::collections::BTreeMap;

use rand::Rng as _;

use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::transition::{Contacts, HandoffContact, HandoffQuery, travel_time};
use crate::workcell::ArmId;

/// Handoffs kept for two arms and a class of objects.
const MOST_KEPT: usize = 400;

/// Handoffs wanted of a query where there should be some to choose from.
pub(super) const WANTED: usize = 3;

/// How many times as many tries are given to a query in vain.
const INSISTENCE: usize = 3;

/// Failed queries after which the same one is mostly taken for hopeless.
const HOPELESS_AFTER: u32 = 2;

/// Giver, receiver and class.
type Key = (usize, usize, usize);

/// Holds by their numbers to the bit.
type Holds = Vec<[u64; 7]>;

/// The pool.
#[derive(Debug, Clone, Default)]
pub(super) struct HandoffPool {
    known: BTreeMap<Key, Vec<HandoffContact>>,
    /// Queries in vain, by their holds.
    failed: BTreeMap<(Key, Holds, Holds), u32>,
}

impl HandoffPool {
    /// Handoffs that fit `query`, the cheapest first: known ones, and fresh ones where fewer than `wanted` are known
    /// or `anew` asks for some. `tries` bounds the sampling.
    pub(super) fn find(
        &mut self,
        problem: &Problem,
        contacts: &mut Contacts<'_>,
        query: &HandoffQuery<'_>,
        (tries, wanted): (usize, usize),
        anew: bool,
        rng: &mut Rng,
    ) -> Vec<HandoffContact> {
        let key = (query.giver.0, query.receiver.0, problem.objects[query.object.0].class);
        let giving: Holds = query.giver_holds.iter().map(|(_, hold)| bits(hold)).collect();
        let taking: Holds = query.receiver_holds.iter().map(|(_, hold)| bits(hold)).collect();
        let fits = |contact: &HandoffContact| {
            giving.contains(&bits(&contact.giver_hold)) && taking.contains(&bits(&contact.receiver_hold))
        };
        let known = self.known.entry(key).or_default();
        let mut fitting: Vec<HandoffContact> = known.iter().filter(|c| fits(c)).cloned().collect();
        if fitting.len() < wanted || anew {
            let failures = self.failed.get(&(key, giving.clone(), taking.clone())).copied().unwrap_or(0);
            if fitting.is_empty() && failures >= HOPELESS_AFTER && rng.random_bool(0.95) {
                return Vec::new();
            }
            let mut fresh = contacts.handoffs(query, tries, wanted, rng);
            if fresh.is_empty() && fitting.is_empty() {
                // By such a one the mode graph knows that it can be done.
                fresh = contacts.witnessed_handoffs(query);
            }
            if fresh.is_empty() && fitting.is_empty() {
                // Before something is blamed for it, and in whatever holds.
                let faces = contacts.prefer_facing(false);
                fresh = contacts.handoffs(query, INSISTENCE * tries, 1, rng);
                contacts.prefer_facing(faces);
            }
            if fresh.is_empty() && fitting.is_empty() {
                *self.failed.entry((key, giving, taking)).or_default() += 1;
                return Vec::new();
            }
            known.extend(fresh.iter().cloned());
            if known.len() > MOST_KEPT {
                known.drain(..known.len() - MOST_KEPT);
            }
            fitting.extend(fresh);
        }
        by_cost(problem, query, &mut fitting);
        fitting
    }

    /// Up to `wanted` handoffs that fit `query`, or more where more are known, the cheapest first; what is
    /// missing is sampled anew with `tries` draws of a meeting place.
    pub(super) fn many(
        &mut self,
        problem: &Problem,
        contacts: &mut Contacts<'_>,
        query: &HandoffQuery<'_>,
        tries: usize,
        wanted: usize,
        rng: &mut Rng,
    ) -> Vec<HandoffContact> {
        let key = (query.giver.0, query.receiver.0, problem.objects[query.object.0].class);
        let fits = |contact: &HandoffContact| {
            query.giver_holds.iter().any(|(_, hold)| *hold == contact.giver_hold)
                && query.receiver_holds.iter().any(|(_, hold)| *hold == contact.receiver_hold)
        };
        let known = self.known.entry(key).or_default();
        let mut fitting: Vec<HandoffContact> = known.iter().filter(|c| fits(c)).cloned().collect();
        if fitting.len() < wanted {
            let fresh = contacts.handoffs(query, tries, wanted - fitting.len(), rng);
            fitting.extend(fresh.iter().cloned());
            known.extend(fresh);
            if known.len() > MOST_KEPT {
                known.drain(..known.len() - MOST_KEPT);
            }
        }
        by_cost(problem, query, &mut fitting);
        fitting
    }
}

/// Works out what handoffs cost from where the query's arms are, and puts the cheapest first.
fn by_cost(problem: &Problem, query: &HandoffQuery<'_>, fitting: &mut [HandoffContact]) {
    let arms = &problem.workcell.arms;
    let sum = |arm: ArmId, near: &[Config], q: &[f64]| {
        near.iter().map(|n| travel_time(&arms[arm.0], n, q)).sum::<f64>()
    };
    for contact in fitting.iter_mut() {
        contact.cost = sum(query.giver, query.giver_near, &contact.giver_q)
            + sum(query.receiver, query.receiver_near, &contact.receiver_q);
    }
    fitting.sort_by(|a, b| a.cost.total_cmp(&b.cost));
}

/// A pose's numbers to the bit.
fn bits(pose: &Pose) -> [u64; 7] {
    let (t, r) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(f64::to_bits)
}

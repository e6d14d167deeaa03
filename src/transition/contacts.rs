//! The memory of contacts: what was asked once is not sampled again, and no more is sampled than
//! was asked.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::collision::{CollisionWorld, Exemption, Held, PathMotion, Scene};
use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::mode_graph::HandoffWitness;
use crate::problem::Problem;
use crate::run::{Control, Rng, Seed};
use crate::workcell::{ArmId, ObjectId};

use super::contact::{Contact, ContactKind, ContactQuery, Grounding};
use super::handoff::{HandoffContact, HandoffQuery, Handoffs};
use super::hands::Hands;
use super::memory::{Class, ReachMemory};

/// Objects farther away (m) than this are in nobody's way while one is picked or placed.
const NEIGHBOURHOOD: f64 = 0.6;

/// Answers about contacts among others that are remembered.
const MOST_LOOKED_AT: usize = 20_000;

/// A pose's numbers to the bit.
type Bits = [u64; 7];

/// Grasp numbers with the object's frame in the TCP frame.
type Holds = Arc<[(usize, Pose)]>;

/// A cache key: arm, whether it is about a place that no pick mirrors, class, pose and hold.
type Key = (usize, bool, usize, Bits, Bits);

/// Samples contacts, and remembers them.
///
/// The first contacts of a query and a hold depend on these alone, whatever was asked before:
/// their configurations come from a stream of their own. [`Contacts::more`] draws from the stream
/// that was handed in.
#[derive(Debug, Clone)]
pub struct Contacts<'a> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    rng: Rng,
    known: BTreeMap<Key, Entry>,
    /// The holds in which the hand has room, none where the object has not: by hand, class, surface and pose.
    roomy: BTreeMap<(usize, usize, usize, Bits), Holds>,
    /// By arm, class and grasp, how often an estimate found a way by it: a guess where to look first.
    promising: BTreeMap<(usize, usize, usize), u32>,
    /// Whether a contact is clear of others: by arm, surface, kind and class, pose, hold, the others with their poses, and
    /// configuration.
    clear: BTreeMap<Box<[u64]>, bool>,
    /// Holds in which no contact is clear of others: by arm, surface, kind and class, pose, hold, and the others with their
    /// poses.
    refused: BTreeSet<Box<[u64]>>,
    hands: Hands,
    handoffs: Handoffs<'a>,
}

/// What is known of one query and one hold.
#[derive(Debug, Clone, Default)]
struct Entry {
    /// Configurations that were not looked at yet, the next one last.
    open: Vec<Config>,
    found: Arc<Vec<Contact>>,
    /// The contacts found, reversed in time, where somebody asked for them.
    reversed: Option<Arc<Vec<Contact>>>,
}

impl Entry {
    fn push(&mut self, contacts: impl IntoIterator<Item = Contact>) {
        Arc::make_mut(&mut self.found).extend(contacts);
        self.reversed = None;
    }
}

impl<'a> Contacts<'a> {
    /// A sampler that draws further contacts from `rng`.
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld, rng: Rng) -> Self {
        Self::remembering(problem, world, rng, Arc::default())
    }

    /// The same with what is known from other problems with an equal workcell and clearance.
    pub(super) fn remembering(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        rng: Rng,
        memory: Arc<ReachMemory>,
    ) -> Self {
        Self {
            problem,
            world,
            rng,
            known: BTreeMap::new(),
            roomy: BTreeMap::new(),
            promising: BTreeMap::new(),
            clear: BTreeMap::new(),
            refused: BTreeSet::new(),
            hands: Hands::new(problem),
            handoffs: Handoffs::new(problem, world, memory),
        }
    }

    /// Has no search for handoffs go on when `control` says stop.
    pub fn heed(&mut self, control: &Control) {
        self.handoffs.heed(control);
    }

    /// The same knowledge, drawing from another stream from now on.
    pub fn with_rng(mut self, rng: Rng) -> Self {
        self.rng = rng;
        self
    }

    /// Contacts that hold the object at `object_in_tcp`: at most the problem's `ik_solutions`,
    /// sampled once and then remembered. Empty when none is found.
    pub fn at(&mut self, query: &ContactQuery, object_in_tcp: &Pose) -> Arc<Vec<Contact>> {
        let most = self.most();
        self.ground(query, object_in_tcp, most)
    }

    /// The first contacts of [`Self::at`], no more than `count`, for which no others are sampled.
    pub fn first(&mut self, query: &ContactQuery, object_in_tcp: &Pose, count: usize) -> Vec<Contact> {
        let known = self.ground(query, object_in_tcp, count.min(self.most()));
        known.iter().take(count).cloned().collect()
    }

    /// The contact with number `index` of [`Self::at`], for which no later one is sampled.
    pub fn nth(&mut self, query: &ContactQuery, object_in_tcp: &Pose, index: usize) -> Option<Contact> {
        if index >= self.most() {
            return None;
        }
        self.ground(query, object_in_tcp, index + 1).get(index).cloned()
    }

    /// Whether there is a contact that holds the object at `object_in_tcp`.
    pub fn has(&mut self, query: &ContactQuery, object_in_tcp: &Pose) -> bool {
        !self.ground(query, object_in_tcp, 1).is_empty()
    }

    /// Samples once more and adds what is found to what is remembered; whether there was any.
    pub fn more(&mut self, query: &ContactQuery, object_in_tcp: &Pose) -> bool {
        self.at(query, object_in_tcp);
        let (asked, _) = self.canonical(query);
        let most = self.most();
        let mut rng = self.rng.clone();
        let fresh = self.sample(&asked, object_in_tcp, &mut rng);
        self.rng = rng;
        if fresh.is_empty() {
            return false;
        }
        // What was refused may do now, for the contact backwards in time, too.
        self.refused.clear();
        let entry = self.known.entry(self.key(&asked, object_in_tcp)).or_default();
        entry.push(fresh);
        // The oldest go first, so that a long run keeps sampling densely in bounded memory.
        if entry.found.len() > 8 * most {
            let surplus = entry.found.len() - 8 * most;
            Arc::make_mut(&mut entry.found).drain(..surplus);
        }
        true
    }

    /// Contacts that are sampled once more and not remembered.
    pub fn others(&mut self, query: &ContactQuery, object_in_tcp: &Pose, rng: &mut Rng) -> Vec<Contact> {
        let (asked, is_reversed) = self.canonical(query);
        let fresh = self.sample(&asked, object_in_tcp, rng);
        if is_reversed { fresh.iter().map(Contact::reversed).collect() } else { fresh }
    }

    /// Contacts of a query that is remembered, at most [`Self::most`].
    fn sample(&mut self, canonical: &ContactQuery, hold: &Pose, rng: &mut Rng) -> Vec<Contact> {
        let grounding = Grounding::new(self.problem, self.world, canonical, hold);
        if !self.has_room(canonical, hold) {
            return Vec::new();
        }
        let most = self.most();
        let configurations = grounding.configurations(3 * most, rng);
        configurations.iter().filter_map(|q| grounding.ground(q)).take(most).collect()
    }

    /// The holds (grasp number and object frame in the TCP frame) by which the contact can be had.
    pub fn holds(&mut self, query: &ContactQuery) -> Vec<(usize, Pose)> {
        let mut holds = self.possible_holds(query);
        holds.retain(|(_, hold)| self.has(query, hold));
        holds
    }

    /// The holds in which the arm's gripper fits around the object, and hand and object have room:
    /// cheaper than [`Self::holds`], and never less.
    pub fn possible_holds(&mut self, query: &ContactQuery) -> Vec<(usize, Pose)> {
        self.with_room(query).to_vec()
    }

    fn with_room(&mut self, query: &ContactQuery) -> Arc<[(usize, Pose)]> {
        let problem = self.problem;
        let class = problem.objects[query.object.0].class;
        let key = (self.hands.kind(query.arm), class, query.surface.0, bits(&query.pose));
        if let Some(known) = self.roomy.get(&key) {
            return known.clone();
        }
        let found: Arc<[(usize, Pose)]> = match self.object_has_room(query) {
            true => self.grasps(query).filter(|(_, hold)| self.hand_has_room(query, hold)).collect(),
            false => Arc::default(),
        };
        self.roomy.insert(key, found.clone());
        found
    }

    /// Whether the contact can be had by any grasp.
    pub fn any(&mut self, query: &ContactQuery) -> bool {
        self.with_room(query).iter().any(|(_, hold)| self.has(query, hold))
    }

    /// Whether it looks as if the contact could be had: a cheap estimate of [`Self::any`] that
    /// leaves out whether the lines are free of collision. Nothing is remembered of it.
    pub fn seems_possible(&mut self, query: &ContactQuery) -> bool {
        let (asked, _) = self.canonical(query);
        let class = self.problem.objects[asked.object.0].class;
        // The answer is the same in whatever order the holds are looked at.
        let mut holds = self.with_room(&asked).to_vec();
        let promise = |grasp: usize| self.promising.get(&(asked.arm.0, class, grasp)).copied().unwrap_or(0);
        holds.sort_by_cached_key(|(grasp, _)| std::cmp::Reverse(promise(*grasp)));
        let found = holds.iter().find(|(_, hold)| {
            let key = self.key(&asked, hold);
            if self.known.get(&key).is_some_and(|entry| !entry.found.is_empty()) {
                return true;
            }
            let grounding = Grounding::new(self.problem, self.world, &asked, hold);
            if grounding.leads_beyond() {
                return false;
            }
            let configurations = grounding.configurations(3 * self.most(), &mut stream(&key));
            configurations.iter().any(|q| grounding.seems_good(q))
        });
        let Some((grasp, _)) = found else { return false };
        *self.promising.entry((asked.arm.0, class, *grasp)).or_default() += 1;
        true
    }

    /// Whether a contact and its lines are clear of the other objects at rest in `scene` (the
    /// object itself may be among them). Remembered.
    pub fn is_clear(&mut self, query: &ContactQuery, contact: &Contact, scene: &Scene) -> bool {
        let others = near_by(query, scene);
        if others.is_empty() {
            return true;
        }
        let asked: Box<[u64]> = self
            .beside(query, &contact.object_in_tcp, &others)
            .into_iter()
            .chain(contact.q.iter().map(|angle| angle.to_bits()))
            .collect();
        if let Some(&known) = self.clear.get(&asked) {
            return known;
        }
        let is_clear = self.look_around(query, contact, others);
        if self.clear.len() >= MOST_LOOKED_AT {
            self.clear.clear();
        }
        self.clear.insert(asked, is_clear);
        is_clear
    }

    /// What is asked of an arm, in a hold, beside others: as a key.
    fn beside(&self, query: &ContactQuery, hold: &Pose, others: &[(ObjectId, Pose)]) -> Box<[u64]> {
        let (arm, surface) = (query.arm.0 as u64, query.surface.0 as u64);
        let is_place = u64::from(query.kind == ContactKind::Place);
        let class = self.problem.objects[query.object.0].class as u64;
        let around = others.iter().flat_map(|(id, pose)| std::iter::once(id.0 as u64).chain(bits(pose)));
        let asked = [arm, surface, is_place, class, others.len() as u64].into_iter();
        asked.chain(bits(&query.pose)).chain(bits(hold)).chain(around).collect()
    }

    /// [`Self::is_clear`] of `others`, asked for the first time.
    fn look_around(&self, query: &ContactQuery, contact: &Contact, others: Vec<(ObjectId, Pose)>) -> bool {
        let surface = &self.problem.workcell.surfaces[query.surface.0];
        let touching = Exemption { hand_with: Some(query.object), held_with: surface.carrier };
        let held = Held { object: query.object, object_in_tcp: contact.object_in_tcp };
        let around = self.world.resting_atoms(&Scene { resting: others });
        let (holding, without) = match query.kind {
            ContactKind::Pick => (&contact.retreat, &contact.approach),
            ContactKind::Place => (&contact.approach, &contact.retreat),
        };
        let along = |line: &super::line::Line, held: Option<&Held>| {
            let motion = PathMotion::new(&line.waypoints);
            self.world.static_free(query.arm, &motion, held, &around, touching)
        };
        along(holding, Some(&held)) && along(without, None)
    }

    /// [`Self::possible_holds`] without those that [`Self::confirm`] refused beside the same objects.
    pub fn open_holds(&mut self, query: &ContactQuery, scene: &Scene) -> Vec<(usize, Pose)> {
        let mut holds = self.possible_holds(query);
        let others = near_by(query, scene);
        holds.retain(|(_, hold)| !self.refused.contains(&self.beside(query, hold, &others)));
        holds
    }

    /// [`Self::is_clear_of`]; a refusal is remembered. What is open depends on what was refused here alone, and not on
    /// contacts that were asked for elsewhere: those are fewer where the workcell is known.
    pub fn confirm(&mut self, query: &ContactQuery, object_in_tcp: &Pose, scene: &Scene) -> bool {
        let is_clear = self.is_clear_of(query, object_in_tcp, scene);
        if !is_clear {
            if self.refused.len() >= MOST_LOOKED_AT {
                self.refused.clear();
            }
            let refused = self.beside(query, object_in_tcp, &near_by(query, scene));
            self.refused.insert(refused);
        }
        is_clear
    }

    /// Whether some contact of [`Self::at`], or one of [`Self::more`], is clear of the objects in `scene`.
    pub fn is_clear_of(&mut self, query: &ContactQuery, object_in_tcp: &Pose, scene: &Scene) -> bool {
        let most = self.most();
        for index in 0..most {
            match self.nth(query, object_in_tcp, index) {
                Some(contact) if self.is_clear(query, &contact, scene) => return true,
                Some(_) => {}
                None => return false,
            }
        }
        let known = self.ground(query, object_in_tcp, most);
        known.iter().skip(most).any(|contact| self.is_clear(query, contact, scene))
    }

    /// Up to `most` handoffs, sampled with up to `tries` draws of a meeting place: the cheapest of a handful, with
    /// their lines. For a pair of holds none comes twice.
    pub fn handoffs(
        &mut self,
        query: &HandoffQuery<'_>,
        tries: usize,
        most: usize,
        rng: &mut Rng,
    ) -> Vec<HandoffContact> {
        self.handoffs.sample(query, tries, most, rng)
    }

    /// Whether [`Self::handoffs`] are mostly such in which the hands face each other, as far as they can, so that the
    /// arms are little in each other's way; or all that fit `query` are as likely.
    /// Returns how it was before.
    pub fn prefer_facing(&mut self, faces: bool) -> bool {
        self.handoffs.prefer_facing(faces)
    }

    /// [`Self::handoffs`] that depend on the question and `rng` alone, not on what was asked before.
    pub fn first_handoffs(
        &self,
        query: &HandoffQuery<'_>,
        tries: usize,
        most: usize,
        rng: &mut Rng,
    ) -> Vec<HandoffContact> {
        self.handoffs.first(query, tries, most, rng)
    }

    /// Handoffs that fit `query` of those by which the mode graph knows that arms can hand over.
    pub fn witnessed_handoffs(&self, query: &HandoffQuery<'_>) -> Vec<HandoffContact> {
        self.handoffs.witnessed(query)
    }

    /// Takes down a handoff of `object` that the mode graph was told of.
    pub(super) fn witness(&mut self, arms: (ArmId, ArmId), object: ObjectId, witness: &HandoffWitness) {
        self.handoffs.witness(arms, object, witness);
    }

    /// What is known of reach.
    pub(super) fn memory(&self) -> &Arc<ReachMemory> {
        self.handoffs.memory()
    }

    /// The class of an object in [`Self::memory`].
    pub(super) fn class(&self, object: ObjectId) -> Class {
        self.handoffs.class(object)
    }

    fn most(&self) -> usize {
        self.problem.options.ik_solutions.max(1)
    }

    /// The query that is remembered, and whether the one asked is that backwards in time. A place
    /// mirrors a pick where approach and retreat are equally long: the same contact, the same
    /// lines with the same hand, empty or full.
    fn canonical(&self, query: &ContactQuery) -> (ContactQuery, bool) {
        let object = &self.problem.objects[query.object.0];
        if query.kind == ContactKind::Place && object.approach == object.retreat {
            return (ContactQuery { kind: ContactKind::Pick, ..*query }, true);
        }
        (*query, false)
    }

    fn key(&self, canonical: &ContactQuery, hold: &Pose) -> Key {
        let class = self.problem.objects[canonical.object.0].class;
        let is_place = canonical.kind == ContactKind::Place;
        (canonical.arm.0, is_place, class, bits(&canonical.pose), bits(hold))
    }

    /// At least `wanted` contacts, or all that the first configurations give.
    fn ground(&mut self, query: &ContactQuery, hold: &Pose, wanted: usize) -> Arc<Vec<Contact>> {
        let (asked, is_reversed) = self.canonical(query);
        let key = self.key(&asked, hold);
        if !self.known.contains_key(&key) {
            let entry = self.begin(&asked, hold, &key);
            self.known.insert(key, entry);
        }
        let Some(entry) = self.known.get_mut(&key) else { return Arc::default() };
        if entry.found.len() < wanted && !entry.open.is_empty() {
            let grounding = Grounding::new(self.problem, self.world, &asked, hold);
            while entry.found.len() < wanted
                && let Some(q) = entry.open.pop()
            {
                entry.push(grounding.ground(&q));
            }
        }
        if !is_reversed {
            return entry.found.clone();
        }
        let found = &entry.found;
        entry.reversed.get_or_insert_with(|| Arc::new(found.iter().map(Contact::reversed).collect())).clone()
    }

    /// What is to be looked at for a query that was never asked.
    fn begin(&mut self, asked: &ContactQuery, hold: &Pose, key: &Key) -> Entry {
        if !self.has_room(asked, hold) {
            return Entry::default();
        }
        let grounding = Grounding::new(self.problem, self.world, asked, hold);
        if grounding.leads_beyond() {
            return Entry::default();
        }
        let mut rng = stream(key);
        let mut open = grounding.configurations(3 * self.most(), &mut rng);
        open.reverse();
        Entry { open, ..Entry::default() }
    }

    /// Whether object and hand have room; `false` is a proof that there is no contact.
    fn has_room(&mut self, query: &ContactQuery, hold: &Pose) -> bool {
        if self.with_room(query).iter().any(|(_, roomy)| roomy == hold) {
            return true;
        }
        // Held as no grasp says.
        !self.grasps(query).any(|(_, grasp)| grasp == *hold)
            && self.object_has_room(query)
            && self.hand_has_room(query, hold)
    }

    /// The object's grasps that fit the arm's gripper: number, and object frame in the TCP frame.
    fn grasps(&self, query: &ContactQuery) -> impl Iterator<Item = (usize, Pose)> + use<'a> {
        let problem = self.problem;
        let opening = problem.workcell.arms[query.arm.0].tool.max_opening;
        let grasps = problem.objects[query.object.0].grasps.iter().enumerate();
        grasps
            .filter(move |(_, grasp)| grasp.fits(opening))
            .map(|(number, grasp)| (number, grasp.object_in_tcp))
    }

    /// Whether the object is clear of all obstacles but what it rests on.
    fn object_has_room(&self, query: &ContactQuery) -> bool {
        let carrier = self.problem.workcell.surfaces[query.surface.0].carrier;
        self.world.placement_free(query.object, &query.pose, carrier, &Scene::default())
    }

    fn hand_has_room(&self, query: &ContactQuery, hold: &Pose) -> bool {
        self.world.hand_free(query.arm, &(query.pose * hold.inverse()))
    }
}

/// The other objects of `scene` that may be in the way where one is picked or placed.
fn near_by(query: &ContactQuery, scene: &Scene) -> Vec<(ObjectId, Pose)> {
    let is_near =
        |pose: &Pose| (pose.translation.vector - query.pose.translation.vector).norm() < NEIGHBOURHOOD;
    scene.resting.iter().filter(|(id, pose)| *id != query.object && is_near(pose)).copied().collect()
}

/// A stream that depends on what is asked alone, not on how the problem numbers its classes.
fn stream(key: &Key) -> Rng {
    let (arm, is_place, _, pose, hold) = *key;
    let numbers = [arm as u64, u64::from(is_place)];
    Seed::mixed(numbers.into_iter().chain(pose).chain(hold)).stream("contacts")
}

/// A pose's numbers to the bit, as a key.
pub(super) fn bits(pose: &Pose) -> Bits {
    let (t, r) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(f64::to_bits)
}

/// The arm of a kind stands for all of them.
pub(super) fn same_hand(problem: &Problem, a: ArmId, b: ArmId) -> bool {
    let workcell = &problem.workcell;
    let (first, second) = (&workcell.arms[a.0], &workcell.arms[b.0]);
    let allowed = |arm: ArmId| {
        workcell.allowed_arm_obstacle.iter().filter(move |(this, ..)| *this == arm).map(|(_, g, o)| (*g, *o))
    };
    Arc::ptr_eq(&first.model, &second.model) && first.tool == second.tool && allowed(a).eq(allowed(b))
}

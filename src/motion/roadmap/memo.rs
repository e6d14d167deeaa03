//! What is known of a roadmap's edges among objects at rest, with something in the hand, and beside arms that stand
//! still.
//!
//! A step is planned again and again with the same objects in the same places; what its edges meet does not change
//! with where an arm comes from or goes to.

use std::collections::{BTreeMap, BTreeSet};

use sha2::{Digest as _, Sha256};

use crate::collision::{Held, Resting};
use crate::geometry::Pose;
use crate::motion::arm_path::Avoid;

/// Situations that are remembered; for one more the oldest is forgotten.
const MOST_SITUATIONS: usize = 64;

/// All on which it depends whether an edge is free, to the bit: what the arm holds, what is at rest where, and the
/// other arms that stand in the way; as a digest (SHA-256), since there may be many objects.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::motion) struct Situation([u8; 32]);

impl Situation {
    pub(in crate::motion) fn new(held: Option<&Held>, resting: &Resting, avoid: &[Avoid]) -> Self {
        fn push_pose(key: &mut Vec<u64>, pose: &Pose) {
            let (t, r) = (pose.translation.vector, pose.rotation.coords);
            key.extend([t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(f64::to_bits));
        }
        fn push_held(key: &mut Vec<u64>, held: Option<&Held>) {
            key.push(u64::from(held.is_some()));
            if let Some(held) = held {
                key.push(held.object.0 as u64);
                push_pose(key, &held.object_in_tcp);
            }
        }
        let mut key = Vec::with_capacity(10 + 8 * resting.objects().len());
        push_held(&mut key, held);
        key.push(resting.objects().len() as u64);
        for (object, pose) in resting.objects() {
            key.push(object.0 as u64);
            push_pose(&mut key, pose);
        }
        for other in avoid {
            key.extend([other.arm.0 as u64, other.q.len() as u64]);
            key.extend(other.q.iter().map(|x| x.to_bits()));
            push_held(&mut key, other.held.as_ref());
        }
        Self::of(&key)
    }

    fn of(words: &[u64]) -> Self {
        let mut digest = Sha256::new();
        for word in words {
            digest.update(word.to_le_bytes());
        }
        Self(digest.finalize().into())
    }
}

/// What was found out about edges in one situation, by number.
#[derive(Debug, Clone, Default)]
pub(in crate::motion) struct KnownEdges {
    pub(in crate::motion) free: BTreeSet<usize>,
    pub(in crate::motion) blocked: BTreeSet<usize>,
}

impl KnownEdges {
    /// Whether an edge is free; what is not known is asked of `check`.
    pub(in crate::motion) fn is_free(&mut self, edge: usize, check: impl FnOnce() -> bool) -> bool {
        if self.free.contains(&edge) {
            return true;
        }
        if self.blocked.contains(&edge) {
            return false;
        }
        let free = check();
        if free { &mut self.free } else { &mut self.blocked }.insert(edge);
        free
    }
}

/// What is known in some situations, with the number of the one that was remembered before; bounded.
#[derive(Debug, Clone, Default)]
pub(super) struct EdgeMemo {
    known: BTreeMap<Situation, (u64, KnownEdges)>,
    latest: u64,
}

impl EdgeMemo {
    /// Takes out what is known in a situation, to be given back by [`Self::give_back`].
    pub(super) fn take(&mut self, situation: &Situation) -> KnownEdges {
        self.known.remove(situation).map(|(_, known)| known).unwrap_or_default()
    }

    pub(super) fn give_back(&mut self, situation: Situation, known: KnownEdges) {
        self.latest += 1;
        self.known.insert(situation, (self.latest, known));
        if self.known.len() > MOST_SITUATIONS
            && let Some(oldest) = self.known.iter().min_by_key(|(_, (age, _))| *age).map(|(at, _)| at.clone())
        {
            self.known.remove(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::{CollisionWorld, Scene};
    use crate::geometry::pose_from_parts;
    use crate::kinematics::Config;
    use crate::scenario::{Family, generate};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
    use crate::workcell::{ArmId, ObjectId};

    #[test]
    fn situations_differ_by_all_that_an_edge_may_meet() {
        let document = generate(Family::Switch, 2, 2, 0).unwrap();
        let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let world = CollisionWorld::new(&problem);
        let at = |x: f64| pose_from_parts([x, 0.0, 0.7], [0.0, 0.0, 0.0, 1.0]);
        let resting = |list: &[(usize, f64)]| {
            let resting = list.iter().map(|&(object, x)| (ObjectId(object), at(x))).collect();
            world.resting_atoms(&Scene { resting })
        };
        let held = |object: usize, x: f64| Held { object: ObjectId(object), object_in_tcp: at(x) };
        let arm = |x: f64, held| Avoid { arm: ArmId(1), q: Config::from_slice(&[x, 0.0]), held };
        let (none, one, moved, other) =
            (resting(&[]), resting(&[(0, 0.1)]), resting(&[(0, 0.2)]), resting(&[(1, 0.1)]));
        let all = [
            Situation::new(None, &none, &[]),
            Situation::new(None, &one, &[]),
            Situation::new(None, &moved, &[]),
            Situation::new(None, &other, &[]),
            Situation::new(Some(&held(0, 0.1)), &none, &[]),
            Situation::new(Some(&held(0, 0.2)), &none, &[]),
            Situation::new(Some(&held(1, 0.1)), &none, &[]),
            Situation::new(None, &one, &[arm(0.0, None)]),
            Situation::new(None, &one, &[arm(0.1, None)]),
            Situation::new(None, &one, &[arm(0.1, Some(held(1, 0.1)))]),
        ];
        for (i, a) in all.iter().enumerate() {
            assert!(all.iter().enumerate().all(|(j, b)| (i == j) == (a == b)), "{i}");
        }
        assert_eq!(Situation::new(None, &one, &[]), Situation::new(None, &resting(&[(0, 0.1)]), &[]));
    }

    #[test]
    fn what_is_asked_once_is_known_and_memory_is_bounded() {
        let mut memo = EdgeMemo::default();
        let situation = |n: u64| Situation::of(&[n]);
        let mut known = memo.take(&situation(0));
        assert!(known.is_free(3, || true) && !known.is_free(4, || false));
        memo.give_back(situation(0), known);
        let mut known = memo.take(&situation(0));
        assert!(known.is_free(3, || unreachable!()) && !known.is_free(4, || unreachable!()));
        memo.give_back(situation(0), known);
        for n in 1..1000 {
            memo.give_back(situation(n), KnownEdges::default());
            // What is asked for again and again stays.
            let known = memo.take(&situation(0));
            assert!(known.free.contains(&3));
            memo.give_back(situation(0), known);
            assert!(memo.known.len() <= MOST_SITUATIONS);
        }
    }
}

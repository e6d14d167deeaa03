//! What is looked at together, or made ready once, gets the verdict that it gets alone.

use rand::Rng as _;

use super::tests::{Case, problem, random_case, random_config, random_exemption, random_held, sets};
use super::{CubicRow, Cubics, cut_in_eight};
use crate::collision::reference;
use crate::collision::{CollisionWorld, JointMotion, PathMotion, Scene, StraightMotion};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::{Rng, Seed};
use crate::workcell::ArmId;

/// Two neighbours.
fn neighbours(problem: &Problem, rng: &mut Rng) -> (Case, Case) {
    let (mut a, mut b) = (random_case(problem, rng), random_case(problem, rng));
    a.arm = ArmId(4);
    b.arm = ArmId([1, 3, 5, 7][rng.random_range(0..4)]);
    (a, b)
}

/// The same, for every second case drawn again until they meet on their ways.
fn meeting_neighbours(world: &CollisionWorld, problem: &Problem, case: usize, rng: &mut Rng) -> (Case, Case) {
    let mut drawn = neighbours(problem, rng);
    for _ in 0..if case.is_multiple_of(2) { 60 } else { 0 } {
        let (a, b) = &drawn;
        let (one, two) = (StraightMotion::new(&a.q, &a.to), StraightMotion::new(&b.q, &b.to));
        if !world.motions_apart(a.parts(&one), b.parts(&two), (0.0, 1.0)) {
            break;
        }
        drawn = neighbours(problem, rng);
    }
    drawn
}

#[test]
fn one_arm_may_stand_still() {
    let problem = problem("switch/9x4");
    let mut strict = problem.clone();
    strict.options.clearance_m += 3e-4;
    let stricter = CollisionWorld::new(&strict);
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(61).stream("one at rest");
        let mut apart = 0;
        for _ in 0..800 {
            let (a, b) = neighbours(&problem, &mut rng);
            let (moves, rests) = (StraightMotion::new(&a.q, &a.to), StraightMotion::rest(&b.q));
            let found = world.motions_apart(a.parts(&moves), b.parts(&rests), (0.0, 1.0));
            assert_eq!(found, world.motions_apart(b.parts(&rests), a.parts(&moves), (0.0, 1.0)));
            apart += usize::from(found);
            if found {
                for step in 0..=40 {
                    let here = StraightMotion::rest(&moves.at(f64::from(step) / 40.0));
                    assert!(reference::are_apart(&world, &a.parts(&here), &b.parts(&rests)));
                }
            } else {
                assert!(!reference::are_apart(&stricter, &a.parts(&moves), &b.parts(&rests)));
            }
        }
        assert!(apart > 80 && apart < 790, "{apart}");
    }
}

#[test]
fn spans_may_be_looked_at_together() {
    let problem = problem("switch/9x4");
    let mut strict = problem.clone();
    strict.options.clearance_m += 3e-4;
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let stricter = CollisionWorld::with_instructions(&strict, set);
        let mut rng = Seed(62).stream("spans");
        let (mut apart, mut meet) = (0, 0);
        for case in 0..600 {
            let (a, b) = meeting_neighbours(&world, &problem, case / 6, &mut rng);
            let moves = (StraightMotion::new(&a.q, &a.to), StraightMotion::new(&b.q, &b.to));
            let count = [0, 1, 3, 8, 9, 17][case % 6];
            let mut edges: Vec<f64> = (0..2 * count).map(|_| rng.random_range(0.0..=1.0)).collect();
            edges.sort_by(f64::total_cmp);
            let spans: Vec<(f64, f64)> = edges.chunks(2).map(|pair| (pair[0], pair[1])).collect();
            let found = world.motions_apart_in(a.parts(&moves.0), b.parts(&moves.1), &spans);
            if found {
                apart += 1;
                for (from, to) in &spans {
                    for step in 0..=8 {
                        let s = from + (to - from) * f64::from(step) / 8.0;
                        let rests = [&moves.0, &moves.1].map(|motion| StraightMotion::rest(&motion.at(s)));
                        assert!(reference::are_apart(&world, &a.parts(&rests[0]), &b.parts(&rests[1])));
                    }
                }
            } else {
                meet += 1;
                let alone =
                    |span: &(f64, f64)| stricter.motions_apart(a.parts(&moves.0), b.parts(&moves.1), *span);
                assert!(!spans.iter().all(alone));
            }
        }
        assert!(apart > 100 && meet > 60, "{apart} {meet}");
    }
}

#[test]
fn pieces_cover_their_spans() {
    let mut rng = Seed(63).stream("pieces");
    for _ in 0..500 {
        let count = rng.random_range(0..=8);
        let mut edges: Vec<f64> = (0..2 * count).map(|_| rng.random_range(-1.0..1.0)).collect();
        edges.sort_by(f64::total_cmp);
        let spans: Vec<(f64, f64)> = edges.chunks(2).map(|pair| (pair[0], pair[1])).collect();
        let pieces = cut_in_eight(&spans);
        assert_eq!(pieces.len(), if count == 0 { 0 } else { 8 });
        let mut left = pieces.as_slice();
        for (from, to) in spans {
            let mut at = from;
            while let [(start, end), rest @ ..] = left
                && *start == at
                && *end <= to + 1e-12
            {
                (at, left) = (*end, rest);
                if (at - to).abs() < 1e-12 {
                    break;
                }
            }
            assert!((at - to).abs() < 1e-12, "{from} {to}: {pieces:?}");
        }
        assert!(left.is_empty());
    }
}

#[test]
fn pairs_are_compared_like_one_by_one() {
    let problem = problem("switch/9x4");
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(64).stream("pairs of configurations");
        let mut apart = 0;
        for case in 0..120 {
            let (a, b) = meeting_neighbours(&world, &problem, case / 6, &mut rng);
            let count = [0, 1, 7, 8, 9, 20][case % 6];
            let configs: Vec<(Config, Config)> = (0..count)
                .map(|_| {
                    // Somewhere on their ways.
                    let s = rng.random_range(0.0..=1.0);
                    let [one, two] = [&a, &b].map(|case| StraightMotion::new(&case.q, &case.to).at(s));
                    (one, two)
                })
                .collect();
            let pairs: Vec<(&[f64], &[f64])> = configs.iter().map(|(p, q)| (&p[..], &q[..])).collect();
            let (ours, theirs) =
                ((a.arm, a.held.as_ref(), a.exemption), (b.arm, b.held.as_ref(), b.exemption));
            let found = world.each_apart(ours, theirs, &pairs);
            let alone = pairs.iter().map(|(p, q)| {
                world.arms_apart((ours.0, p, ours.1, ours.2), (theirs.0, q, theirs.1, theirs.2))
            });
            assert_eq!(found, alone.collect::<Vec<bool>>());
            apart += found.iter().filter(|apart| **apart).count();
        }
        assert!(apart > 100 && apart < 850, "{apart}");
    }
}

/// Straight from one waypoint to the next, said in cubics.
struct InCubics<'a> {
    path: PathMotion<'a>,
    times: Vec<f64>,
    rows: Vec<CubicRow>,
}

impl<'a> InCubics<'a> {
    fn new(waypoints: &'a [Config]) -> Self {
        let row = |pair: &[Config]| {
            let mut row = [[0.0; 8]; 4];
            for (joint, (a, b)) in pair[0].iter().zip(&pair[1]).enumerate() {
                (row[0][joint], row[1][joint]) = (*a as f32, (b - a) as f32);
            }
            row
        };
        let times = (0..waypoints.len()).map(|n| n as f64).collect();
        Self { path: PathMotion::new(waypoints), times, rows: waypoints.windows(2).map(row).collect() }
    }
}

impl JointMotion for InCubics<'_> {
    fn at(&self, s: f64) -> Config {
        self.path.at(s)
    }

    fn deviation(&self, s0: f64, s1: f64) -> Config {
        self.path.deviation(s0, s1)
    }

    fn span(&self) -> (f64, f64) {
        self.path.span()
    }

    fn stands_still(&self) -> bool {
        self.path.stands_still()
    }

    fn cubics(&self) -> Option<Cubics<'_>> {
        Some(Cubics { joints: 7, times: &self.times, rows: &self.rows, instants: false })
    }
}

#[test]
fn cubics_are_certified_like_paths() {
    let problem = problem("switch/9x4");
    for set in sets() {
        let world = CollisionWorld::with_instructions(&problem, set);
        let mut rng = Seed(65).stream("cubics");
        let (mut apart, mut free, mut alike) = (0, 0, 0);
        let cases = 500;
        for case in 0..cases {
            let (a, b) = neighbours(&problem, &mut rng);
            let mut path = |one: &Case| -> Vec<Config> {
                let end: Config = one.q.iter().zip(&one.to).map(|(p, q)| p + (q - p) * 0.6).collect();
                let rests = case % 5 == 0 && one.arm == b.arm;
                let far = random_config(&problem, one.arm, &mut rng);
                let on = end.iter().zip(&far).map(|(p, q)| p + (q - p) * 0.1).collect();
                if rests { vec![one.q.clone(); 3] } else { vec![one.q.clone(), end, on] }
            };
            let (ours, theirs) = (path(&a), path(&b));
            let (one, two) = (InCubics::new(&ours), InCubics::new(&theirs));
            let found = world.motions_apart(a.parts(&one), b.parts(&two), (0.0, 2.0));
            let scene = Scene::default();
            let alone = world.motion_free(a.arm, &one, a.held.as_ref(), &scene, a.exemption);
            for step in 0..=60 {
                let s = f64::from(step) / 30.0;
                let rests = [one.at(s), two.at(s)].map(|q| StraightMotion::rest(&q));
                assert!(!found || reference::are_apart(&world, &a.parts(&rests[0]), &b.parts(&rests[1])));
                assert!(!alone || reference::is_free(&world, &a.parts(&rests[0]), &scene));
            }
            let as_path = world.motions_apart(a.parts(&one.path), b.parts(&two.path), (0.0, 2.0));
            (apart, free) = (apart + usize::from(found), free + usize::from(alone));
            alike += usize::from(as_path == found);
        }
        assert!(apart > 50 && apart < cases - 5 && free > 30 && free < cases - 30, "{apart} {free}");
        // Only what is undecided to a hair may come out otherwise.
        assert!(alike > cases - 3, "{alike}");
    }
}

#[test]
fn what_hands_held_before_does_not_matter() {
    let problem = problem("switch/9x4");
    let world = CollisionWorld::new(&problem);
    let mut rng = Seed(66).stream("hands");
    let cases: Vec<_> = (0..100)
        .map(|_| {
            let arm = ArmId(rng.random_range(0..9));
            let held = random_held(&problem, &mut rng);
            (arm, random_config(&problem, arm, &mut rng), held, random_exemption(&problem, &mut rng))
        })
        .collect();
    for round in 0..3 {
        for (index, (arm, q, held, exemption)) in cases.iter().enumerate() {
            // The same in another's hand, too.
            let arm = ArmId((arm.0 + round) % 9);
            let verdict = |world: &CollisionWorld| {
                world.config_free(arm, q, held.as_ref(), &Scene::default(), *exemption)
            };
            let fresh = world.with_objects_of(&problem);
            assert_eq!(verdict(&world), verdict(&fresh), "{round} {index}");
        }
    }
}

//! The tree alone: random actions instead of the guided ones, and no means of motion but the
//! composite search. Guidance is to make the search fast, not to make it work.

use rand::Rng as _;
use rand::seq::IndexedRandom;

use super::*;
use crate::collision::CollisionWorld;
use crate::guidance::{Guide, Instance, Move, Solution};
use crate::mode_graph::{ModeGraphOptions, build_mode_graph};
use crate::motion::{ArmGoal, Roadmap};
use crate::problem::Problem;
use crate::run::{Control, Rng, Seed};
use crate::scenario::{Family, generate};
use crate::transition::SampledReach;
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
use crate::workcell::ArmId;

fn problem(family: Family, seed: u64) -> Problem {
    let document = generate(family, 4, 4, seed).unwrap();
    read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem
}

/// Picks of random objects by random arms that reach them: a step that nobody planned.
fn random_step(instance: &Instance, map: &Map, rng: &mut Rng) -> Guide {
    let start = instance.start();
    let mut moves: Vec<Move> = Vec::new();
    for (object, &from) in start.iter().enumerate() {
        let class = instance.objects[object].class;
        let edges = instance.edges.iter().filter(|e| e.from == from && e.class.is_none_or(|c| c == class));
        let free: Vec<Move> = edges
            .map(|edge| Move { object, from, to: edge.to })
            .filter(|action| moves.iter().all(|other| other.to != action.to))
            .collect();
        if rng.random_bool(0.7) {
            moves.extend(free.choose(rng));
        }
    }
    let solution = Solution { start, steps: vec![moves], weight: 0.0 };
    Guide::along(map.network(), solution, None)
}

#[test]
fn the_tree_reaches_mode_goals_without_guidance() {
    let control = Control::unbounded();
    for family in [Family::Switch, Family::SideToSide, Family::Random] {
        let problem = problem(family, 1);
        let seed = Seed(5);
        let world = CollisionWorld::new(&problem);
        let mut reach = SampledReach::new(&problem, &world, seed);
        let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::planning(), &control);
        let contacts = reach.into_contacts();
        let map = Map::new(graph).unwrap();
        let mut rng = seed.stream("test");
        let roadmaps = problem.workcell.arms.iter().enumerate().map(|(index, arm)| {
            let mut roadmap = Roadmap::new(ArmId(index), arm);
            roadmap.grow(&world, arm, 300, &control, &mut rng);
            roadmap
        });
        let roadmaps: Vec<Roadmap> = roadmaps.collect();
        let settings = Settings::default();
        let mut search = Search::new(&problem, &world, &map, contacts, roadmaps, settings, seed, &control);
        let reached = (0..40).any(|_| {
            let guide = random_step(map.network().instance(), &map, &mut rng);
            if guide.immediate.is_empty() {
                return false;
            }
            let outline = search.grounder.outline(&search.tree[0], &guide);
            let Ok(grounding) = search.grounder.ground(&search.tree[0], &guide, &outline) else {
                return false;
            };
            let Ok(motion) = search.planner.plan_as_one_robot(&grounding.task, &control) else {
                return false;
            };
            // modal_check: every arm with an action stands at its contact, all at the same time.
            motion.arms.iter().zip(&grounding.task.arms).all(|(arm, task)| match &task.goal {
                ArmGoal::Contact { q, .. } => {
                    let end = &arm.curve.last().q;
                    let near = end.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-9);
                    near && (arm.curve.end_time() - motion.duration).abs() < 1e-9
                }
                _ => true,
            })
        });
        assert!(reached, "{}", family.name());
    }
}

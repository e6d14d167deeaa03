//! A free path of one arm where its roadmap holds none: two trees that grow towards each other (RRT-Connect, Kuffner
//! and LaValle 2000).

use rand::Rng as _;

use crate::kinematics::Config;
use crate::run::{Control, Rng};
use crate::workcell::Arm;

use super::arm_path::Surroundings;
use super::roadmap::{Roadmap, draw, one_turn};

/// Samples before the search gives up.
const GREATEST_SAMPLES: usize = 250;

/// Longest edge of a tree, in [`Roadmap::distance`] (s).
const RANGE: f64 = 0.6;

/// Share of the samples near one of the ends, where passages are narrow.
const NEAR_ENDS: f64 = 0.3;

/// How far (share of a joint's range, or of a turn) these lie from the end at most.
const NEIGHBOURHOOD: f64 = 0.15;

/// Samples after which both trees must have grown.
const HOPELESS: usize = 80;

/// A tree of configurations with their parents; the root is its own.
struct Tree(Vec<(Config, usize)>);

/// How far a tree came.
enum Step {
    Reached(usize),
    Advanced(usize),
    Trapped,
}

impl Tree {
    /// One edge from the nearest vertex towards `target`.
    fn extend(&mut self, around: &Surroundings<'_>, roadmap: &Roadmap, target: &Config) -> Step {
        let distances = self.0.iter().map(|(q, _)| roadmap.distance(q, target)).enumerate();
        let Some((near, distance)) = distances.min_by(|a, b| a.1.total_cmp(&b.1)) else {
            return Step::Trapped;
        };
        let from = &self.0[near].0;
        let share = RANGE / distance;
        let next: Config = if share >= 1.0 {
            target.clone()
        } else {
            from.iter().zip(target).map(|(a, b)| a + (b - a) * share).collect()
        };
        if !around.edge_free(from, &next) {
            return Step::Trapped;
        }
        self.0.push((next, near));
        let new = self.0.len() - 1;
        if share >= 1.0 { Step::Reached(new) } else { Step::Advanced(new) }
    }

    /// The way from `vertex` to the root.
    fn way(&self, mut vertex: usize) -> Vec<Config> {
        let mut way = vec![self.0[vertex].0.clone()];
        while self.0[vertex].1 != vertex {
            vertex = self.0[vertex].1;
            way.push(self.0[vertex].0.clone());
        }
        way
    }
}

/// A free path from `from` to `to`, both ends included; `None` when none was found or `control` stops the search.
pub(super) fn connect(
    around: &Surroundings<'_>,
    roadmap: &Roadmap,
    arm: &Arm,
    (from, to): (&Config, &Config),
    control: &Control,
    rng: &mut Rng,
) -> Option<Vec<Config>> {
    if ![from, to].into_iter().all(|end| around.edge_free(end, end)) {
        return None;
    }
    let mut trees = [Tree(vec![(from.clone(), 0)]), Tree(vec![(to.clone(), 0)])];
    for sample in 0..GREATEST_SAMPLES {
        if control.should_stop() || sample == HOPELESS && trees.iter().any(|tree| tree.0.len() == 1) {
            return None;
        }
        let (growing, other) = (sample % 2, 1 - sample % 2);
        let target = match rng.random_bool(NEAR_ENDS) {
            true => near(arm, [from, to][rng.random_range(0..2)], rng),
            false => draw(arm, rng),
        };
        let new = match trees[growing].extend(around, roadmap, &target) {
            Step::Reached(new) | Step::Advanced(new) => new,
            Step::Trapped => continue,
        };
        let goal = trees[growing].0[new].0.clone();
        let met = loop {
            match trees[other].extend(around, roadmap, &goal) {
                Step::Reached(met) => break Some(met),
                Step::Advanced(_) if !control.should_stop() => {}
                _ => break None,
            }
        };
        if let Some(met) = met {
            let ends = if growing == 0 { (new, met) } else { (met, new) };
            let mut path = trees[0].way(ends.0);
            path.reverse();
            path.extend(trees[1].way(ends.1).into_iter().skip(1));
            return Some(path);
        }
    }
    None
}

/// A configuration near `q`, within the limits.
fn near(arm: &Arm, q: &Config, rng: &mut Rng) -> Config {
    let moved = q.iter().zip(&arm.limits).enumerate().map(|(joint, (at, limit))| {
        let (lower, upper) = one_turn(arm, joint, *at);
        let half = NEIGHBOURHOOD * (upper - lower);
        (at + rng.random_range(-half..=half)).clamp(limit.lower, limit.upper)
    });
    moved.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::{CollisionWorld, Exemption, Scene};
    use crate::run::Seed;
    use crate::scenario::{Family, generate};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
    use crate::workcell::ArmId;

    #[test]
    fn what_it_finds_is_free_and_it_mostly_finds_something() {
        let value = generate(Family::Switch, 2, 2, 0).unwrap();
        let problem = read_problem_value(&value, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let world = CollisionWorld::new(&problem);
        let (id, arm) = (ArmId(0), &problem.workcell.arms[0]);
        let (resting, control) = (world.resting_atoms(&Scene::default()), Control::unbounded());
        let around = Surroundings { world: &world, arm: id, held: None, resting: &resting, avoid: &[] };
        let roadmap = Roadmap::new(id, arm);
        let mut rng = Seed(3).stream("connect");
        let (mut asked, mut found) = (0, 0);
        while asked < 40 {
            let ends = [draw(arm, &mut rng), draw(arm, &mut rng)];
            let free = |q: &Config| world.config_free(id, q, None, &Scene::default(), Exemption::default());
            if !ends.iter().all(free) || around.edge_free(&ends[0], &ends[1]) {
                continue;
            }
            asked += 1;
            let Some(path) = connect(&around, &roadmap, arm, (&ends[0], &ends[1]), &control, &mut rng) else {
                continue;
            };
            found += 1;
            assert_eq!((path.first(), path.last()), (Some(&ends[0]), Some(&ends[1])));
            assert!(path.len() > 2 && path.windows(2).all(|edge| around.edge_free(&edge[0], &edge[1])));
        }
        assert!(found >= 32, "{found} of {asked}");
    }
}

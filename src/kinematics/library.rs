//! Robots that ship with the product.

/// A robot of the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LibraryRobot {
    /// Its name, as in `library:NAME`.
    pub name: &'static str,
    /// Its URDF: primitive shapes only, no meshes to resolve.
    pub urdf: &'static str,
    /// Its SRDF.
    pub srdf: &'static str,
}

macro_rules! robot {
    ($name:literal) => {
        LibraryRobot {
            name: $name,
            urdf: include_str!(concat!("../../scenarios/robots/", $name, ".urdf")),
            srdf: include_str!(concat!("../../scenarios/robots/", $name, ".srdf")),
        }
    };
}

/// All robots of the library, by name.
const ROBOTS: &[LibraryRobot] = &[robot!("iiwa14"), robot!("panda_type"), robot!("ur_type")];

/// The library's robot called `name`.
pub fn library(name: &str) -> Option<LibraryRobot> {
    ROBOTS.iter().copied().find(|robot| robot.name == name)
}

/// The names of all robots of the library.
pub fn library_names() -> impl Iterator<Item = &'static str> {
    ROBOTS.iter().map(|robot| robot.name)
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use rand::Rng as _;

    use super::*;
    use crate::geometry::{ExactShape, Vec3};
    use crate::kinematics::{ArmModel, NoMeshes, disabled_link_pairs};
    use crate::run::Seed;

    fn load(robot: &LibraryRobot) -> ArmModel {
        ArmModel::from_urdf(robot.name, robot.urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0
    }

    /// The share of random configurations in which the shapes of two links overlap, by pair.
    fn overlap_shares(model: &ArmModel, samples: u32) -> BTreeMap<(usize, usize), f64> {
        let mut rng = Seed(11).stream("library overlaps");
        let shapes: Vec<Vec<ExactShape>> =
            model.links.iter().map(|link| link.shapes.iter().map(ExactShape::new).collect()).collect();
        let mut shares = BTreeMap::new();
        let mut poses = Vec::new();
        for _ in 0..samples {
            let q: Vec<f64> =
                model.joints.iter().map(|j| rng.random_range(j.limits.lower..j.limits.upper)).collect();
            model.link_poses(&q, &mut poses);
            let mut overlapping = BTreeSet::new();
            for a in 0..model.links.len() {
                for b in a + 1..model.links.len() {
                    let touches = shapes[a].iter().any(|x| {
                        shapes[b].iter().any(|y| x.signed_distance(&poses[a], y, &poses[b], 0.01) < -0.002)
                    });
                    if touches && model.links[a].group != model.links[b].group {
                        overlapping.insert((a, b));
                    }
                }
            }
            for pair in overlapping {
                *shares.entry(pair).or_insert(0.0) += 1.0 / f64::from(samples);
            }
        }
        shares
    }

    #[test]
    fn only_pairs_that_overlap_often_are_disabled() {
        for robot in ROBOTS {
            let model = load(robot);
            let disabled = disabled_link_pairs(robot.srdf, &model).unwrap();
            let adjacent = |a: usize, b: usize| model.links[b].group == model.links[a].group + 1;
            let shares = overlap_shares(&model, 200);
            for (&(a, b), share) in &shares {
                let exempt = adjacent(a, b) || disabled.contains(&(a, b));
                assert!(exempt || *share < 0.15, "{} {a}-{b}: {share}", robot.name);
            }
            for (a, b) in disabled {
                let share = shares.get(&(a, b)).copied().unwrap_or_default();
                assert!(adjacent(a, b) || share > 0.15, "{} {a}-{b}: {share}", robot.name);
            }
        }
    }

    #[test]
    fn usual_postures_are_free_of_self_contact() {
        let postures: [(&str, &[f64]); 3] = [
            ("iiwa14", &[0.0, -20.0, 0.0, -110.0, 0.0, 60.0, 0.0]),
            ("panda_type", &[0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0]),
            ("ur_type", &[0.0, -90.0, 90.0, -90.0, -90.0, 0.0]),
        ];
        for (name, degrees) in postures {
            let robot = library(name).unwrap();
            let model = load(&robot);
            let disabled = disabled_link_pairs(robot.srdf, &model).unwrap();
            let q: Vec<f64> = degrees.iter().map(|angle| angle.to_radians()).collect();
            let mut poses = Vec::new();
            model.link_poses(&q, &mut poses);
            for (a, first) in model.links.iter().enumerate() {
                for (b, second) in model.links.iter().enumerate().skip(a + 1) {
                    if second.group <= first.group + 1 || disabled.contains(&(a, b)) {
                        continue;
                    }
                    for x in &first.shapes {
                        for y in &second.shapes {
                            let gap = ExactShape::new(x).signed_distance(
                                &poses[a],
                                &ExactShape::new(y),
                                &poses[b],
                                1.0,
                            );
                            assert!(gap > 0.004, "{name} {}-{}: {gap}", first.name, second.name);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn flanges_stand_where_the_parameters_say() {
        let ur = load(&library("ur_type").unwrap()).mount_pose(&[0.0; 6]);
        let expected = Vec3::new(-0.6127 - 0.57155, -0.17415 - 0.11655, 0.1807 - 0.11985);
        assert!((ur.translation.vector - expected).norm() < 1e-9, "{}", ur.translation);
        let panda = load(&library("panda_type").unwrap()).mount_pose(&[0.0; 7]);
        let expected = Vec3::new(0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107);
        assert!((panda.translation.vector - expected).norm() < 1e-9, "{}", panda.translation);
    }
}

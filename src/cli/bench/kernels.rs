//! The kernels' benchmark: each on random work that is drawn from one seed, next to parry where parry
//! can do the same.

use std::hint::black_box;

use super::table::{Table, best};
use super::work::{Frames, Inverse, KnownWorkcell, ManyArms, Narrow, OneArm};
use crate::geometry::lanes::InstructionSet;
use crate::run::{Rng, Seed};

/// Measures everything.
pub(super) fn measure() -> Table {
    let mut table = Table { instructions: InstructionSet::best().name(), lines: Vec::new() };
    let mut rng = Seed(1).stream("bench/kernels");
    narrow(&mut table, &mut rng);
    forward(&mut table, &mut rng);
    one_arm(&mut table, &mut rng);
    many_arms(&mut table, &mut rng);
    inverse(&mut table, &mut rng);
    if let Some(known) = KnownWorkcell::new("switch/9x4") {
        table.add(
            "a known workcell of nine arms, from lookup to ready",
            best(1, || {
                black_box(known.ready());
            }),
        );
    }
    table
}

fn narrow(table: &mut Table, rng: &mut Rng) {
    let work = Narrow::new(rng);
    let ours = best(Narrow::PAIRS, || {
        black_box(work.capsule_capsule());
    });
    let theirs = best(Narrow::PAIRS, || {
        black_box(work.capsule_capsule_by_parry());
    });
    table.compare("capsule against capsule", ours, "parry", theirs);
    let ours = best(Narrow::PAIRS, || {
        black_box(work.capsule_box());
    });
    let theirs = best(Narrow::PAIRS, || {
        black_box(work.capsule_box_by_parry());
    });
    table.compare("capsule against box", ours, "parry", theirs);
}

fn forward(table: &mut Table, rng: &mut Rng) {
    let Some(mut work) = Frames::new(rng) else { return };
    let ours = best(Frames::CONFIGURATIONS, || {
        black_box(work.place());
    });
    let theirs = best(1, || work.link_poses());
    table.compare("iiwa14, all frames", ours, "in f64", theirs);
}

/// One arm among ten boxes.
fn one_arm(table: &mut Table, rng: &mut Rng) {
    let Some(work) = OneArm::new(rng) else { return };
    let ours = best(OneArm::CONFIGURATIONS, || {
        black_box(work.random());
    });
    let theirs = best(OneArm::CONFIGURATIONS, || {
        black_box(work.random_by_parry());
    });
    table.compare("iiwa14 (9 capsules) and itself, 10 boxes: random", ours, "parry, boxes first", theirs);
    let ours = best(OneArm::CONFIGURATIONS, || {
        black_box(work.along());
    });
    let theirs = best(OneArm::CONFIGURATIONS, || {
        black_box(work.along_by_parry());
    });
    table.compare("the same along valid edges", ours, "parry, boxes first", theirs);
    let whole = best(OneArm::EDGES, || {
        black_box(work.certified());
    });
    table.add("such an edge certified continuously", whole);
    let targets = best(OneArm::TARGETS, || {
        black_box(work.inverse(rng));
    });
    table.add("inverse kinematics there, in a batch: five, those that are free", targets);
}

/// Two and nine arms against each other.
fn many_arms(table: &mut Table, rng: &mut Rng) {
    let Some(work) = ManyArms::new(rng) else { return };
    let pairs = best(ManyArms::EDGES * 8, || {
        black_box(work.pair());
    });
    table.add("two arms 1.1 m apart, per eighth of an edge", pairs);
    let all = best(ManyArms::EDGES * 8, || {
        black_box(work.all());
    });
    table.add("nine arms (36 pairs), per eighth of an edge", all);
}

/// Inverse kinematics in closed form.
fn inverse(table: &mut Table, rng: &mut Rng) {
    for (name, most, work) in [
        ("iiwa14", 5, "inverse kinematics, iiwa14: five solutions"),
        ("ur_type", 8, "inverse kinematics, UR type: all solutions"),
        ("panda_type", 5, "inverse kinematics, Panda type: five solutions"),
    ] {
        let Some(mut targets) = Inverse::new(name, most, rng) else { continue };
        let time = best(Inverse::TARGETS, || {
            black_box(targets.solve());
        });
        table.add(work, time);
    }
}

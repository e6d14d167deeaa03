//! Whole graphs.

use proptest::prelude::*;

use super::cell::{Cell, Cube, PlainReach, at};
use crate::geometry::ExactShape;
use crate::guidance::{Answer, Cuts, Effort, Instance, Network, check, solve};
use crate::mode_graph::{
    GraphKind, ModeGoal, ModeGraph, ModeGraphOptions, Place, build_mode_graph, optimistic_mode_graph,
};
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::run::{CancelToken, Control, Deadline, Seed};
use crate::workcell::{ArmId, ObjectId, SurfaceId, Symmetry};

fn build(problem: &Problem) -> ModeGraph {
    let mut reach = PlainReach::new(problem);
    build_mode_graph(problem, &mut reach, &ModeGraphOptions::default(), &Control::unbounded())
}

/// Steps of the best plan on the graph, its plan checked; `None` when there is none.
fn steps(graph: &ModeGraph) -> Option<usize> {
    let instance = Instance::from(graph);
    instance.validate().unwrap();
    let network = Network::new(instance.clone()).unwrap();
    let cuts = Cuts::default();
    let answer =
        solve(&network, &instance.start(), &cuts, &Effort::quick(), Seed(1), &Control::unbounded()).unwrap();
    match answer {
        Answer::Solved(solution, certificate) => {
            check(&instance, &solution).unwrap();
            assert!(certificate.optimum.is_none_or(|optimum| optimum == solution.steps.len()));
            Some(solution.steps.len())
        }
        Answer::Infeasible(_) => None,
        Answer::Unknown { .. } => panic!("small instances are decided"),
    }
}

fn regions(graph: &ModeGraph) -> Vec<&crate::mode_graph::Region> {
    let region = |node: &crate::mode_graph::ModeNode| matches!(node.place, Place::Region(_));
    graph
        .nodes
        .iter()
        .filter(|node| region(node))
        .filter_map(|node| match &node.place {
            Place::Region(region) => Some(region),
            _ => None,
        })
        .collect()
}

fn switch() -> Cell {
    Cell::pair(vec![
        Cube::new((0, at(-0.56, 0.1, 0.0)), (1, at(1.6, -0.1, 0.4))),
        Cube::new((1, at(1.7, 0.1, 0.0)), (0, at(-0.5, -0.1, 0.7))),
    ])
}

#[test]
fn switch_of_two_takes_six_steps() {
    let problem = switch().problem();
    let graph = build(&problem);
    assert!(graph.complete && graph.kind == GraphKind::Guidance);
    // Two arms and one roomy region for each table, into which all slots merge.
    assert_eq!(graph.nodes.len(), 4);
    assert_eq!(regions(&graph).iter().map(|region| region.merged.len()).collect::<Vec<_>>(), [2, 2]);
    assert!(graph.handoff(ArmId(0), ArmId(1), 0).is_some_and(|edge| edge.witness.is_some()));
    assert!(graph.handoff(ArmId(1), ArmId(0), 0).is_some());
    assert_eq!(steps(&graph), Some(6));
    assert_eq!(steps(&optimistic_mode_graph(&problem)), Some(6));
}

#[test]
fn one_object_needs_a_pick_a_handoff_and_a_place() {
    let problem = Cell::pair(vec![Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.66, 0.0, 0.0)))]).problem();
    assert_eq!(steps(&build(&problem)), Some(3));
    assert_eq!(steps(&optimistic_mode_graph(&problem)), Some(3));
}

#[test]
fn a_pose_on_the_same_table_costs_a_pick_and_a_place() {
    let bystander = at(1.66, 0.0, 0.0);
    let cubes = vec![
        Cube::new((0, at(-0.56, 0.0, 0.0)), (0, at(-0.56, 0.0, 0.5))),
        Cube::new((1, bystander), (1, bystander)),
    ];
    let problem = Cell::pair(cubes).problem();
    let graph = build(&problem);
    assert_eq!(steps(&graph), Some(2));
    assert_eq!(steps(&optimistic_mode_graph(&problem)), Some(2));
    // Start and goal are nodes of their own that exclude each other.
    assert_eq!(graph.nodes.iter().filter(|node| matches!(node.place, Place::Slot(_))).count(), 3);
    assert_eq!(graph.conflicts.len(), 1);
}

#[test]
fn symmetry_makes_a_quarter_turn_nothing_to_do() {
    let mut cube = Cube::new((0, at(-0.56, 0.0, 0.0)), (0, at(-0.56, 0.0, std::f64::consts::FRAC_PI_2)));
    let turned = Cell::pair(vec![cube.clone()]).problem();
    assert_eq!(steps(&build(&turned)), Some(2));
    cube.symmetry = Symmetry::Box;
    let problem = Cell::pair(vec![cube]).problem();
    let graph = build(&problem);
    assert_eq!(steps(&graph), Some(0));
    assert_eq!(graph.objects[0].goal_poses.len(), 24);
    assert_eq!(steps(&optimistic_mode_graph(&problem)), Some(0));
}

fn swap(tables: f64) -> Cell {
    let (a, b) = (at(-0.6, 0.05, 0.0), at(-0.5, -0.05, 0.0));
    let mut cell = Cell::pair(vec![Cube::new((0, a), (0, b)), Cube::new((0, b), (0, a))]);
    cell.tables[0].1 = [tables, tables];
    cell
}

#[test]
fn swap_in_place_goes_through_a_buffer() {
    let problem = swap(0.2).problem();
    let graph = build(&problem);
    assert_eq!(steps(&graph), Some(6));
    // Each cube's start is the other's goal.
    assert_eq!(graph.nodes.iter().filter(|node| matches!(node.place, Place::Slot(_))).count(), 2);
    assert!(regions(&graph).iter().all(|region| region.merged.is_empty()));
}

#[test]
fn swap_without_room_finds_no_plan_with_one_table() {
    let (a, b) = (at(-0.6, 0.0, 0.0), at(-0.52, 0.0, 0.0));
    let cell = Cell {
        arms: vec![[0.0, 0.0]],
        tables: vec![([-0.56, 0.0], [0.075, 0.045])],
        cubes: vec![Cube::new((0, a), (0, b)), Cube::new((0, b), (0, a))],
    };
    assert_eq!(steps(&build(&cell.problem())), None);
}

#[test]
fn a_band_between_two_arms_is_a_region_of_its_own() {
    let mut cell = Cell::pair(vec![Cube::new((0, at(0.55, 0.6, 0.0)), (0, at(0.45, 0.4, 0.0)))]);
    cell.tables = vec![([0.55, 0.5], [0.8, 0.15])];
    let graph = build(&cell.problem());
    let mut arms: Vec<Vec<usize>> =
        regions(&graph).iter().map(|region| region.arms.iter().map(|arm| arm.0).collect()).collect();
    arms.sort();
    arms.dedup();
    assert_eq!(arms, [vec![0], vec![0, 1], vec![1]]);
    for region in regions(&graph) {
        for spot in &region.spots {
            for arm in 0..2 {
                let base = cell.arms[arm];
                let place = spot.poses[0].translation.vector;
                let near = (place.x - base[0]).hypot(place.y - base[1]) <= 0.85;
                assert_eq!(near, region.arms.contains(&ArmId(arm)));
            }
        }
    }
}

#[test]
fn handoffs_need_a_grasp_that_can_be_placed() {
    // Grasps from straight above only: what comes from above cannot go from above.
    let problem = switch().problem();
    let mut reach = PlainReach { steepest: 0.99, ..PlainReach::new(&problem) };
    let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::default(), &Control::unbounded());
    assert!(graph.edges.iter().all(|edge| edge.witness.is_none()));
    assert_eq!(steps(&graph), None);
    // A third arm in the middle takes it from the side, and gives it on.
    let mut cell = switch();
    cell.arms = vec![[0.0, 0.0], [1.1, 0.0], [0.55, 0.5]];
    let problem = cell.problem();
    let mut reach = PlainReach { steepest: 0.99, ..PlainReach::new(&problem) };
    let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::default(), &Control::unbounded());
    assert!(graph.handoff(ArmId(0), ArmId(2), 0).is_some() && graph.handoff(ArmId(2), ArmId(1), 0).is_some());
    assert!(steps(&graph).is_some());
}

#[test]
fn surfaces_given_as_goals_hold_all_their_nodes() {
    let mut cell = switch();
    cell.cubes[0].goal = GoalPlacement::Surface(SurfaceId(1));
    cell.cubes[1].goal = GoalPlacement::Anywhere;
    let problem = cell.problem();
    for graph in [build(&problem), optimistic_mode_graph(&problem)] {
        assert_eq!(steps(&graph), Some(3));
        assert_eq!(graph.objects[1].goal, ModeGoal::AnyPlacement);
    }
}

#[test]
fn what_stands_in_the_way_is_put_aside() {
    // Nobody wants the second cube anywhere, but it stands where the first one must go.
    let place = at(1.66, 0.0, 0.0);
    let mut cell = Cell::pair(vec![
        Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.67, 0.01, 0.3))),
        Cube::new((1, place), (1, place)),
    ]);
    cell.cubes[1].goal = GoalPlacement::Anywhere;
    let problem = cell.problem();
    // The arm beside it takes it, puts it on a buffer, receives the other and puts it down.
    for graph in [build(&problem), optimistic_mode_graph(&problem)] {
        assert_eq!(steps(&graph), Some(4));
    }
    // Where there is no buffer on that table, the other arm has to take it over.
    let mut tight = cell;
    tight.tables[1].1 = [0.05, 0.05];
    assert!(steps(&build(&tight.problem())).is_none_or(|steps| steps > 4));
}

#[test]
fn an_object_may_start_in_a_hand() {
    let cell = Cell::pair(vec![Cube::new((0, at(-0.56, 0.0, 0.0)), (1, at(1.66, 0.0, 0.0)))]);
    let mut problem = cell.problem();
    let approach = |pose: &crate::geometry::Pose| pose.rotation.inverse() * crate::geometry::Vec3::z();
    let slanted = problem.objects[0].grasps.iter().map(|grasp| grasp.object_in_tcp).find(|pose| {
        let along = approach(pose);
        along.x > 0.7 && along.z < -0.7
    });
    let hold = slanted.unwrap();
    problem.initial[0] = InitialPlacement::Held { arm: ArmId(0), object_in_tcp: hold };
    let graph = build(&problem);
    assert_eq!(graph.objects[0].start, graph.arm_node(ArmId(0)));
    // Given to the other arm and put down.
    assert_eq!(steps(&graph), Some(2));
    assert_eq!(steps(&optimistic_mode_graph(&problem)), Some(2));
    // A hold that is none of the grasps is a hold all the same.
    let turned = crate::geometry::pose_from_parts([0.0, 0.0, 0.001], [0.0, 0.0, 0.0, 1.0]) * hold;
    problem.initial[0] = InitialPlacement::Held { arm: ArmId(0), object_in_tcp: turned };
    assert_eq!(steps(&build(&problem)), Some(2));
}

#[test]
fn given_capacities_bind() {
    let problem = switch().problem();
    let mut tight = problem.clone();
    let mut workcell = (*problem.workcell).clone();
    workcell.surfaces[0].capacity = Some(1);
    tight.workcell = std::sync::Arc::new(workcell);
    let graph = build(&tight);
    assert!(graph.conflicts.iter().any(|conflict| conflict.capacity == 1 && conflict.nodes.len() == 1));
    assert!(steps(&graph) >= Some(6) && steps(&optimistic_mode_graph(&tight)) >= Some(6));
}

#[test]
fn classes_are_kept_apart() {
    let mut cell = switch();
    cell.cubes[1].class = 1;
    let problem = cell.problem();
    let graph = build(&problem);
    let classes: Vec<usize> = regions(&graph).iter().map(|region| region.class).collect();
    assert!(classes.contains(&0) && classes.contains(&1));
    // Where two classes share a table, their regions share room, and slots stay apart.
    assert!(regions(&graph).iter().all(|region| region.merged.is_empty()));
    assert!(graph.conflicts.iter().any(|conflict| conflict.nodes.len() == 2 && conflict.capacity > 1));
    assert_eq!(steps(&graph), Some(6));
}

#[test]
fn a_stopped_build_is_valid_and_says_so() {
    let problem = switch().problem();
    let mut reach = PlainReach::new(&problem);
    let cancel = CancelToken::new();
    cancel.cancel();
    let control = Control::new(Deadline::never(), cancel);
    let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::default(), &control);
    assert!(!graph.complete);
    Instance::from(&graph).validate().unwrap();
    assert_eq!((reach.asked, graph.objects.len()), (0, 2));
}

#[test]
fn printing_names_every_node_once() {
    let problem = swap(0.2).problem();
    for graph in [build(&problem), optimistic_mode_graph(&problem)] {
        let names: std::collections::BTreeSet<String> =
            (0..graph.nodes.len()).map(|node| graph.node_name(&problem, node)).collect();
        assert_eq!(names.len(), graph.nodes.len());
        let (text, dot) = (graph.to_text(&problem), graph.to_dot(&problem));
        for name in &names {
            assert!(text.contains(name.as_str()) && dot.contains(name.as_str()));
        }
        assert!(names.contains("start of cube0, goal of cube1") && names.contains("arm arm1"));
        assert_eq!(dot.matches('{').count(), dot.matches('}').count());
    }
}

#[test]
fn capacities_say_whether_room_or_want_ended_them() {
    // Two cubes stand on a narrow board so that few others find room beside them; a table is empty.
    let [left, right] = [at(-0.69, 0.0, 0.0), at(-0.43, 0.0, 0.0)];
    let mut cell = Cell::pair(vec![Cube::new((0, left), (0, left)), Cube::new((0, right), (0, right))]);
    cell.tables[0].1 = [0.2, 0.035];
    let problem = cell.problem();
    let graph = build(&problem);
    let mut seen = [0, 0];
    for (node, found) in graph.nodes.iter().enumerate() {
        let Place::Region(region) = &found.place else { continue };
        let (spots, why) = (region.spots.len(), graph.why(&problem, node));
        seen[region.surface.0] += 1;
        if region.surface == SurfaceId(0) {
            assert!(!region.more_may_fit && spots <= 2);
            let s = if spots == 1 { "" } else { "s" };
            assert_eq!(why, format!("{spots} spot{s} with room for fingers, no room for more was found"));
        } else {
            assert!(region.more_may_fit && spots > 2);
            let enough = "which is enough for the 2 objects of the class at once";
            assert_eq!(why, format!("at least {spots} spots with room for fingers, {enough}"));
        }
        let (text, dot) = (graph.to_text(&problem), graph.to_dot(&problem));
        let said = format!("capacity {} ({why})", found.capacity);
        assert!(text.contains(&said) && dot.contains(&said));
    }
    assert_eq!(seen, [1, 1]);
}

/// Cells with one to three arms, two tables and cubes anywhere on them.
fn cells() -> impl Strategy<Value = Cell> {
    let place = || (0..2_usize, -0.15..0.15_f64, -0.15..0.15_f64, 0.0..1.5_f64);
    (1..4_usize, prop::collection::vec((place(), place(), 0..2_usize), 1..5), 0.19..0.3_f64).prop_map(
        |(arms, cubes, half)| {
            let tables = vec![([-0.56, 0.0], [half, half]), ([1.66, 0.0], [half, half])];
            let pose = |(table, x, y, yaw): (usize, f64, f64, f64)| {
                let centre = [-0.56, 1.66][table];
                (table, at(centre + x, y, yaw))
            };
            let cubes = cubes
                .into_iter()
                .map(|(start, goal, class)| Cube { class, ..Cube::new(pose(start), pose(goal)) });
            Cell {
                arms: [[0.0, 0.0], [1.1, 0.0], [0.5, 0.6]][..arms].to_vec(),
                tables,
                cubes: cubes.collect(),
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn graphs_are_sound(cell in cells()) {
        let problem = cell.problem();
        let graph = build(&problem);
        prop_assert_eq!(&graph, &build(&problem));
        let instance = Instance::from(&graph);
        instance.validate().unwrap();
        let cube = ExactShape::new(&problem.objects[0].shapes[0]);
        let slots: Vec<_> = graph.nodes.iter().flat_map(|node| match &node.place {
            Place::Slot(slot) => vec![slot.pose],
            Place::Region(region) => region.merged.iter().map(|slot| slot.pose).collect(),
            _ => Vec::new(),
        }).collect();
        for region in regions(&graph) {
            for (index, spot) in region.spots.iter().enumerate() {
                // No spot overlaps a slot or another spot of its region, whichever way round.
                for pose in &spot.poses {
                    let surface = &problem.workcell.surfaces[region.surface.0];
                    prop_assert!(crate::workcell::rests_on(&problem.objects[0].shapes, pose, surface).is_ok());
                    for other in slots.iter().chain(region.spots[..index].iter().map(|spot| &spot.poses[0])) {
                        prop_assert!(cube.signed_distance(pose, &cube, other, 0.1) > 0.009);
                    }
                }
            }
        }
        // A node holds as many objects as it says: what merges has a place for each owner.
        for (index, object) in graph.objects.iter().enumerate() {
            if let ModeGoal::Nodes(nodes) = &object.goal {
                for &node in nodes {
                    let placements = graph.placements(ObjectId(index), node);
                    prop_assert_eq!(
                        placements.iter().map(|p| p.pose).collect::<Vec<_>>(),
                        object.goal_poses.clone()
                    );
                }
            }
        }
    }

    /// What the guidance graph can do, the optimistic one can, in as many steps or fewer.
    #[test]
    fn optimistic_graph_bounds(cell in cells()) {
        let problem = cell.problem();
        let instance = Instance::from(&optimistic_mode_graph(&problem));
        instance.validate().unwrap();
        let network = Network::new(instance.clone()).unwrap();
        let control = Control::unbounded();
        let bound = solve(&network, &instance.start(), &Cuts::default(), &Effort::quick(), Seed(1), &control).unwrap();
        let inner = Instance::from(&build(&problem));
        let network = Network::new(inner.clone()).unwrap();
        let answer = solve(&network, &inner.start(), &Cuts::default(), &Effort::quick(), Seed(1), &control).unwrap();
        if let Answer::Solved(solution, _) = answer {
            match bound {
                Answer::Solved(_, certificate) => prop_assert!(certificate.lower_bound <= solution.steps.len()),
                Answer::Infeasible(reason) => prop_assert!(false, "{reason}"),
                Answer::Unknown { lower_bound } => prop_assert!(lower_bound <= solution.steps.len()),
            }
        }
    }
}

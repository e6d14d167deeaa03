//! Carries on which no grasps fit together, and what stands in the way.

use nalgebra::UnitQuaternion;

use super::cell::{Cell, Cube, PlainReach, at};
use crate::geometry::Vec3;
use crate::guidance::{Answer, Cuts, Effort, Instance, Network, NodeId, Solution, check, instance_of, solve};
use crate::mode_graph::{
    BarredCarry, Blockage, BlockedPart, CarryEnd, ModeGraph, ModeGraphOptions, RestAction, build_mode_graph,
};
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::run::{Control, Seed};
use crate::workcell::{ArmId, ObjectId};

fn graph(problem: &Problem, steepest: f64, elbow_room: f64) -> ModeGraph {
    let mut reach = PlainReach { steepest, elbow_room, ..PlainReach::new(problem) };
    build_mode_graph(problem, &mut reach, &ModeGraphOptions::planning(), &Control::unbounded())
}

/// The best plan on the graph, checked, and the node of the graph for each of the instance.
fn plan(graph: &ModeGraph) -> (Option<Solution>, Vec<usize>) {
    let (instance, stands_for) = instance_of(graph);
    let network = Network::new(instance.clone()).unwrap();
    let control = Control::unbounded();
    let answer =
        solve(&network, &instance.start(), &Cuts::none(), &Effort::quick(), Seed(1), &control).unwrap();
    if let Answer::Solved(solution, certificate) = &answer {
        check(&instance, solution).unwrap();
        assert_eq!(certificate.optimum, Some(solution.steps.len()));
    }
    (answer.solution().cloned(), stands_for)
}

/// Two cubes that go from one table to the other, `y` (m) from the middle; the first is turned over on
/// the way.
fn turned_and_straight(y: f64) -> Cell {
    let mut turned = Cube::new((0, at(-0.56, y, 0.0)), (1, at(1.66, y, 0.0)));
    if let GoalPlacement::Pose { pose, .. } = &mut turned.goal {
        pose.rotation *= UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
    }
    Cell::pair(vec![turned, Cube::new((0, at(-0.56, -y, 0.0)), (1, at(1.66, -y, 0.0)))])
}

#[test]
fn grasps_that_do_not_fit_together_bar_a_carry() {
    // From above alone, an arm that took a cube by its top cannot hand it over to one that must put it
    // down by its top.
    let problem = turned_and_straight(0.12).problem();
    let steep = graph(&problem, 0.9, 0.0);
    assert_eq!(steep.barred, [BarredCarry { object: ObjectId(1), carriers: vec![ArmId(0), ArmId(1)] }]);
    let (found, stands_for) = plan(&steep);
    // The second cube gets there all the same, where it is put down and taken up anew.
    if let Some(found) = found {
        let way: Vec<usize> =
            found.steps.iter().flatten().filter(|m| m.object == 1).map(|m| stands_for[m.to.0]).collect();
        assert!(way.len() > 3, "{way:?}");
    }
    let text = steep.to_text(&problem);
    assert!(text.contains("cube1 from its start by arm0, then arm1 to its goal"), "{text}");
    // With grasps at the edges everything fits.
    let free = graph(&problem, 0.7, 0.0);
    assert_eq!((free.barred.len(), free.blockages.len()), (0, 0));
    assert_eq!(plan(&free).0.unwrap().steps.len(), 5);
}

#[test]
fn a_hold_from_the_start_may_bar_a_carry() {
    let mut problem = turned_and_straight(0.12).problem();
    let from_above = problem.objects[1].grasps.iter().map(|grasp| grasp.object_in_tcp).find(|hold| {
        let approach = hold.rotation.inverse() * Vec3::z();
        approach.z < -0.9
    });
    problem.initial[1] = InitialPlacement::Held { arm: ArmId(0), object_in_tcp: from_above.unwrap() };
    let steep = graph(&problem, 0.9, 0.0);
    assert_eq!(steep.barred, [BarredCarry { object: ObjectId(1), carriers: vec![ArmId(0), ArmId(1)] }]);
    let (instance, stands_for) = instance_of(&steep);
    let start = instance.start()[1].0;
    assert!(start >= steep.nodes.len() && stands_for[start] == 0, "a hand that says how it is held");
    if let Some(found) = plan(&steep).0 {
        assert!(found.steps.iter().flatten().filter(|m| m.object == 1).count() > 2);
    }
}

#[test]
fn what_stands_beside_a_goal_is_placed_in_order() {
    // Hands come from where there is room: the cube in the middle has neighbours on all sides.
    let row = |y: f64| Cube::new((0, at(-0.56, y, 0.0)), (1, at(1.66, 0.6 * y, 0.0)));
    let mut cubes = vec![row(0.0), row(0.15), row(-0.15)];
    cubes.push(Cube::new((0, at(-0.71, 0.0, 0.0)), (1, at(1.57, 0.0, 0.0))));
    cubes.push(Cube::new((0, at(-0.41, 0.0, 0.0)), (1, at(1.75, 0.0, 0.0))));
    let problem = Cell::pair(cubes).problem();
    let open = graph(&problem, 0.8, 0.0);
    assert!(open.blockages.is_empty());
    // From above alone nothing is in the way.
    assert!(graph(&problem, 0.99, 0.2).blockages.is_empty());

    let tight = graph(&problem, 0.7, 0.12);
    for Blockage { part, at, .. } in &tight.blockages {
        assert!(*at < tight.nodes.len());
        let (BlockedPart::Contact(action, _) | BlockedPart::Carry(action, _)) = part;
        assert_eq!(*action, RestAction::Place, "starts are far apart");
    }
    // Every block of the instance is one of the graph's, and plans keep to them.
    let instance = Instance::from(&tight);
    assert!(instance.blocks.len() >= tight.blockages.len());
    let known = |at: NodeId| tight.blockages.iter().any(|blockage| blockage.at == at.0);
    assert!(instance.blocks.iter().all(|block| known(block.at)));
    plan(&tight).0.unwrap();
}

/// The ends of straight carries in the steps of a plan: the step, and which end of whose carry.
fn ends(graph: &ModeGraph, found: &Solution, stands_for: &[usize]) -> Vec<(usize, CarryEnd)> {
    let mut ends = Vec::new();
    for index in 0..graph.objects.len() {
        let moves =
            found.steps.iter().enumerate().flat_map(|(step, moves)| moves.iter().map(move |m| (step, m)));
        let way: Vec<(usize, usize)> = moves
            .filter(|(_, action)| action.object == index)
            .map(|(step, action)| (step, stands_for[action.to.0]))
            .collect();
        let arms: Vec<ArmId> = way.iter().filter_map(|&(_, node)| graph.arm_of(node)).collect();
        let is_straight = arms.len() + 1 == way.len() && arms.len() <= 2;
        if let (true, Some(first), Some(last)) = (is_straight, way.first(), way.last()) {
            for (step, action) in [(first.0, RestAction::Pick), (last.0, RestAction::Place)] {
                ends.push((step, CarryEnd { object: ObjectId(index), action, carriers: arms.clone() }));
            }
        }
    }
    ends
}

#[test]
fn ends_of_carries_that_leave_no_room_come_in_different_steps() {
    let problem = turned_and_straight(0.12).problem();
    let mut graph = graph(&problem, 0.7, 0.0);
    let (found, stands_for) = plan(&graph);
    let fewest = found.as_ref().unwrap().steps.len();
    let mut at_once = ends(&graph, &found.unwrap(), &stands_for);
    let mut rounds = 0;
    // The plan with the fewest steps places one cube and picks the other in one step; however that is done, it is
    // given up in the end.
    loop {
        let pair = at_once.iter().enumerate().find_map(|(index, (step, one))| {
            let other = at_once[..index].iter().find(|(at, two)| at == step && two.object != one.object);
            other.map(|(_, two)| [two.clone(), one.clone()])
        });
        let Some(pair) = pair else { break };
        assert!(!graph.crowdings.contains(&pair), "{pair:?} in one step all the same");
        graph.crowdings.push(pair);
        rounds += 1;
        let (found, stands_for) = plan(&graph);
        at_once = ends(&graph, &found.unwrap(), &stands_for);
    }
    let instance = Instance::from(&graph);
    assert_eq!(instance.clashes.len(), rounds);
    assert!(rounds > 0 && plan(&graph).0.unwrap().steps.len() > fewest);
}

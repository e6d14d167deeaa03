//! temporary
use crate::mode_graph::*;
use crate::problem::*;
use crate::workcell::*;
/// temp
pub fn rough(problem: &Problem, reach: &mut dyn Reach) -> ModeGraph {
    let mut nodes: Vec<ModeNode> = Vec::new();
    let mut edges = Vec::new();
    for (i, arm) in problem.workcell.arms.iter().enumerate() {
        nodes.push(ModeNode {
            place: Place::Arm(ArmId(i)),
            capacity: 1,
            centre: arm.base.translation.vector,
        });
    }
    let mut objects = Vec::new();
    let n = problem.workcell.arms.len();
    for o in 0..problem.objects.len() {
        let mut mk = |pose: crate::geometry::Pose, surface, s: bool| {
            nodes.push(ModeNode {
                place: Place::Slot(Slot {
                    pose,
                    surface,
                    class: 0,
                    start_of: s.then_some(ObjectId(o)),
                    goal_of: (!s).then_some(ObjectId(o)),
                }),
                capacity: 1,
                centre: pose.translation.vector,
            });
            let id = nodes.len() - 1;
            for a in 0..n {
                if reach.reaches(RestAction::Pick, ArmId(a), ObjectId(o), &pose, surface) {
                    let w = (nodes[a].centre - pose.translation.vector).norm();
                    edges.push(ModeEdge { from: a, to: id, class: 0, weight: w, witness: None });
                    edges.push(ModeEdge { from: id, to: a, class: 0, weight: w, witness: None });
                }
            }
            id
        };
        let (InitialPlacement::Resting { pose, surface }, GoalPlacement::Pose { pose: gp, surface: gs }) =
            (&problem.initial[o], &problem.goal[o])
        else {
            continue;
        };
        let s = mk(*pose, *surface, true);
        let g = mk(*gp, *gs, false);
        objects.push(ModeObject {
            start: s,
            goal: ModeGoal::Nodes(vec![g]),
            class: 0,
            goal_poses: vec![*gp],
        });
    }
    let all: Vec<Hold> = problem.objects[0]
        .grasps
        .iter()
        .enumerate()
        .map(|(i, g)| Hold { grasp: Some(i), object_in_tcp: g.object_in_tcp })
        .collect();
    for a in 0..n {
        for b in 0..n {
            if a != b && reach.handoff(ArmId(a), ArmId(b), ObjectId(0), &all, &all).is_some() {
                edges.push(ModeEdge { from: a, to: b, class: 0, weight: 1.0, witness: None });
            }
        }
    }
    ModeGraph { kind: GraphKind::Guidance, nodes, edges, conflicts: vec![], objects, complete: true }
}

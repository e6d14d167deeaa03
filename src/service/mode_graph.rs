//! Mode graphs as JSON documents, and the mode graph of a workcell that has no objects yet.

use std::time::Duration;

use serde_json::{Value, json};

use super::ApiError;
use super::workcells::Bundle;
use crate::collision::CollisionWorld;
use crate::geometry::{Pose, Vec3};
use crate::mode_graph::{
    BlockedPart, GraphKind, ModeGoal, ModeGraph, ModeGraphOptions, Place, Slot, Witness, build_mode_graph,
    find_witnesses,
};
use crate::problem::Problem;
use crate::run::{Control, Seed};
use crate::transition::SampledReach;
use crate::wire::{Fault, FaultCode, PoseDocument, ReadLimits, read_around_workcell, read_workcell_value};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

/// Places per side that are tried for the probe on each surface.
const GRID: usize = 5;
/// The probe's id.
const PROBE: &str = "quadrille-probe";

/// The mode graph of a workcell for a box of these extents (m), which stands where there is room for
/// it, with the default grasps.
///
/// # Errors
/// When the workcell has faults, or no room for such a box.
pub fn of_workcell(
    bundle: &Bundle,
    extents: Vec3,
    budget: Duration,
    limits: &ReadLimits,
) -> Result<Value, ApiError> {
    let problem = probe(bundle, extents, limits)?;
    let control = Control::with_budget(budget);
    let world = CollisionWorld::new(&problem);
    let mut reach = SampledReach::new(&problem, &world, Seed(problem.options.seed));
    let mut graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::default(), &control);
    find_witnesses(&problem, &mut graph, &mut reach, &control);
    Ok(document(&graph, &problem))
}

/// A problem with a single box in the workcell.
fn probe(bundle: &Bundle, extents: Vec3, limits: &ReadLimits) -> Result<Problem, ApiError> {
    let read = read_workcell_value(&bundle.document, bundle, limits).map_err(ApiError::InvalidProblem)?;
    let size = json!({ "x": extents.x, "y": extents.y, "z": extents.z });
    let mut why = vec![Fault {
        pointer: "/surfaces".to_owned(),
        code: FaultCode::MissingField,
        message: "the workcell has no surface, so no object can rest and there are no modes".to_owned(),
    }];
    for surface in &read.workcell.surfaces {
        let step = |index: usize, extent: f64| {
            let room = (extent - extents.x.max(extents.y)).max(0.0);
            // From the middle outwards: 0, +1, -1, +2, -2.
            let half = (index.div_ceil(2)) as f64 * if index % 2 == 1 { 1.0 } else { -1.0 };
            half * room / (GRID - 1) as f64
        };
        for place in 0..GRID * GRID {
            let at = Pose::translation(
                step(place % GRID, 2.0 * surface.half_extents[0]),
                step(place / GRID, 2.0 * surface.half_extents[1]),
                extents.z / 2.0,
            );
            let pose = pose(&(surface.pose * at));
            let whole = json!({
                "schema": "quadrille.problem/1",
                "workcell": bundle.document,
                "objects": [{ "id": PROBE, "shape": { "type": "box", "size": size } }],
                "initial": { PROBE: { "pose": pose } },
            });
            let whole = serde_json::from_str(&whole.to_string().replace(PROBE, "quadrille-probe"));
            match read_around_workcell(&whole.unwrap_or(Value::Null), bundle, limits) {
                Ok(read) => return Ok(read.problem),
                Err(faults) => why = faults,
            }
        }
    }
    Err(ApiError::InvalidProblem(why))
}

/// The graph as a JSON document: nodes by index, as edges, conflicts and objects name them.
pub fn document(graph: &ModeGraph, problem: &Problem) -> Value {
    let workcell = &problem.workcell;
    let arm = |arm: &ArmId| workcell.arms[arm.0].id.clone();
    let surface = |surface: SurfaceId| workcell.surfaces[surface.0].id.clone();
    let object = |object: Option<ObjectId>| object.map(|o| problem.objects[o.0].id.clone());
    let slot = |slot: &Slot| {
        json!({
            "pose": pose(&slot.pose), "surface": surface(slot.surface), "class": slot.class,
            "start_of": object(slot.start_of), "goal_of": object(slot.goal_of),
        })
    };
    let nodes = graph.nodes.iter().enumerate().map(|(index, node)| {
        let place = match &node.place {
            Place::Arm(id) => json!({ "kind": "arm", "arm": arm(id) }),
            Place::Slot(this) => json!({ "kind": "slot", "slot": slot(this) }),
            Place::Region(region) => json!({
                "kind": "region", "surface": surface(region.surface), "class": region.class,
                "arms": region.arms.iter().map(arm).collect::<Vec<_>>(),
                "spots": region.spots.iter().filter_map(|spot| spot.poses.first()).map(pose).collect::<Vec<_>>(),
                "more_may_fit": region.more_may_fit,
                "merged": region.merged.iter().map(slot).collect::<Vec<_>>(),
            }),
            Place::Surface(this) => json!({ "kind": "surface", "surface": surface(*this) }),
        };
        let centre = node.centre;
        json!({
            "name": graph.node_name(problem, index), "capacity": node.capacity,
            "why": graph.why(problem, index), "place": place,
            "centre": { "x": centre.x, "y": centre.y, "z": centre.z },
        })
    });
    let edges = graph.edges.iter().map(|edge| {
        let witness = edge.witness.as_ref().map(|witness| match witness {
            Witness::Handoff(witness) => json!({
                "giver_q": witness.giver_q.to_vec(), "receiver_q": witness.receiver_q.to_vec(),
                "object_in_tcp": pose(&witness.giver_hold.object_in_tcp),
                "to_object_in_tcp": pose(&witness.receiver_hold.object_in_tcp),
            }),
            Witness::Rest(witness) => json!({
                "q": witness.q.to_vec(), "object_in_tcp": pose(&witness.hold.object_in_tcp),
                "object_pose": pose(&witness.pose), "surface": surface(witness.surface),
            }),
        });
        json!({
            "from": edge.from, "to": edge.to, "class": edge.class, "weight": edge.weight, "witness": witness,
        })
    });
    let conflicts = graph
        .conflicts
        .iter()
        .map(|conflict| json!({ "nodes": conflict.nodes, "capacity": conflict.capacity }));
    let objects = graph.objects.iter().zip(&problem.objects).map(|(object, model)| {
        let goal = match &object.goal {
            ModeGoal::Nodes(nodes) => json!(nodes),
            ModeGoal::AnyPlacement => json!("any_placement"),
        };
        json!({ "id": model.id, "class": object.class, "start": object.start, "goal": goal })
    });
    let barred = graph.barred.iter().map(|carry| {
        json!({
            "object": object(Some(carry.object)), "arms": carry.carriers.iter().map(arm).collect::<Vec<_>>(),
        })
    });
    let blockages = graph.blockages.iter().map(|blockage| {
        let (action, arms, carried) = match &blockage.part {
            BlockedPart::Contact(action, by) => (action, vec![arm(by)], false),
            BlockedPart::Carry(action, by) => (action, by.iter().map(arm).collect(), true),
        };
        json!({
            "object": object(Some(blockage.object)), "at": blockage.at, "action": action.verb(), "arms": arms,
            "carried": carried,
        })
    });
    let crowdings = graph.crowdings.iter().map(|ends| {
        json!(ends.each_ref().map(|end| {
            json!({
                "object": object(Some(end.object)), "action": end.action.verb(),
                "arms": end.carriers.iter().map(arm).collect::<Vec<_>>(),
            })
        }))
    });
    json!({
        "schema": "quadrille.mode_graph/1",
        "kind": match graph.kind { GraphKind::Guidance => "guidance", GraphKind::Optimistic => "optimistic" },
        "complete": graph.complete,
        "nodes": nodes.collect::<Vec<_>>(),
        "edges": edges.collect::<Vec<_>>(),
        "conflicts": conflicts.collect::<Vec<_>>(),
        "objects": objects.collect::<Vec<_>>(),
        "barred_carries": barred.collect::<Vec<_>>(),
        "blockages": blockages.collect::<Vec<_>>(),
        "crowdings": crowdings.collect::<Vec<_>>(),
    })
}

fn pose(pose: &Pose) -> Value {
    let PoseDocument { position: p, orientation: o } = PoseDocument::from(pose);
    json!({
        "position": { "x": p.x, "y": p.y, "z": p.z },
        "orientation": { "x": o.x, "y": o.y, "z": o.z, "w": o.w },
    })
}

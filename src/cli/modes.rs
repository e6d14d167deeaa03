//! `quadrille modes`: prints the mode graph of a problem.

use std::path::PathBuf;
use std::time::Duration;

use clap::ValueEnum;
use serde_json::{Value, json};

use super::{Answer, CliError, budget, input};
use crate::collision::CollisionWorld;
use crate::geometry::Pose;
use crate::mode_graph::{
    GraphKind, ModeGoal, ModeGraph, ModeGraphOptions, Place, build_mode_graph, optimistic_mode_graph,
};
use crate::problem::Problem;
use crate::run::{Control, Seed};
use crate::transition::SampledReach;
use crate::wire::PoseDocument;

/// Arguments of `modes`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The problem file; `-` for stdin
    file: PathBuf,
    /// How the graph is written
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
    /// The graph that bounds instead of the one that guides
    #[arg(long)]
    optimistic: bool,
    /// Time budget, such as 10s or 500ms
    #[arg(long, value_parser = budget::parse)]
    budget: Option<Duration>,
    /// Seed of all randomness
    #[arg(long)]
    seed: Option<u64>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Lines of text
    Text,
    /// One JSON document
    Json,
    /// Graphviz's DOT
    Dot,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    let problem = input::problem(&arguments.file)?.problem;
    let control = arguments.budget.map_or_else(Control::unbounded, Control::with_budget);
    let graph = if arguments.optimistic {
        optimistic_mode_graph(&problem)
    } else {
        let world = CollisionWorld::new(&problem);
        let seed = Seed(arguments.seed.unwrap_or(problem.options.seed));
        let mut reach = SampledReach::new(&problem, &world, seed);
        build_mode_graph(&problem, &mut reach, &ModeGraphOptions::default(), &control)
    };
    let text = match arguments.format {
        Format::Text => graph.to_text(&problem),
        Format::Dot => graph.to_dot(&problem),
        Format::Json => serde_json::to_string_pretty(&document(&graph, &problem))
            .map_err(|error| CliError::Write { path: "stdout".into(), source: error.into() })?,
    };
    input::write(None, &text)?;
    Ok(if graph.complete { Answer::Yes } else { Answer::No })
}

/// The graph as a JSON document: nodes by index, as edges, conflicts and objects name them.
fn document(graph: &ModeGraph, problem: &Problem) -> Value {
    let workcell = &problem.workcell;
    let arm = |arm: &crate::workcell::ArmId| workcell.arms[arm.0].id.clone();
    let surface = |surface: crate::workcell::SurfaceId| workcell.surfaces[surface.0].id.clone();
    let object = |object: Option<crate::workcell::ObjectId>| object.map(|o| problem.objects[o.0].id.clone());
    let slot = |slot: &crate::mode_graph::Slot| {
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
                "merged": region.merged.iter().map(slot).collect::<Vec<_>>(),
            }),
            Place::Surface(this) => json!({ "kind": "surface", "surface": surface(*this) }),
        };
        let centre = node.centre;
        json!({
            "name": graph.node_name(problem, index), "capacity": node.capacity, "place": place,
            "centre": { "x": centre.x, "y": centre.y, "z": centre.z },
        })
    });
    let edges = graph.edges.iter().map(|edge| {
        let witness = edge.witness.as_ref().map(|witness| {
            json!({
                "giver_q": witness.giver_q.to_vec(), "receiver_q": witness.receiver_q.to_vec(),
                "object_in_tcp": pose(&witness.giver_hold.object_in_tcp),
                "to_object_in_tcp": pose(&witness.receiver_hold.object_in_tcp),
            })
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
    json!({
        "schema": "quadrille.mode_graph/1",
        "kind": match graph.kind { GraphKind::Guidance => "guidance", GraphKind::Optimistic => "optimistic" },
        "complete": graph.complete,
        "nodes": nodes.collect::<Vec<_>>(),
        "edges": edges.collect::<Vec<_>>(),
        "conflicts": conflicts.collect::<Vec<_>>(),
        "objects": objects.collect::<Vec<_>>(),
    })
}

fn pose(pose: &Pose) -> Value {
    let PoseDocument { position: p, orientation: o } = PoseDocument::from(pose);
    json!({
        "position": { "x": p.x, "y": p.y, "z": p.z },
        "orientation": { "x": o.x, "y": o.y, "z": o.z, "w": o.w },
    })
}

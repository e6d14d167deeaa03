//! The graph for people: as text, and as DOT for Graphviz.

use std::fmt::Write as _;

use crate::problem::Problem;
use crate::workcell::ArmId;

use super::graph::{BlockedPart, GraphKind, ModeEdge, ModeGoal, ModeGraph, ModeNode, Place, Slot};
use super::reach::Hold;
use super::witness::Witness;

impl ModeGraph {
    /// A name for `node` that is unique in the graph and made of the problem's ids:
    /// `arm left`, `start of red`, `start of red, goal of blue`, `region 7 on table_a`,
    /// `surface table_a`.
    pub fn node_name(&self, problem: &Problem, node: usize) -> String {
        let Some(found) = self.nodes.get(node) else { return format!("node {node}") };
        let workcell = &problem.workcell;
        match &found.place {
            Place::Arm(arm) => format!("arm {}", workcell.arms[arm.0].id),
            Place::Slot(slot) => slot_name(problem, slot),
            Place::Region(region) => format!("region {node} on {}", workcell.surfaces[region.surface.0].id),
            Place::Surface(surface) => format!("surface {}", workcell.surfaces[surface.0].id),
        }
    }

    /// The graph as lines of text: nodes, edges (both ways on one line), conflicts, objects.
    pub fn to_text(&self, problem: &Problem) -> String {
        let mut out = String::new();
        let name = |node: usize| self.node_name(problem, node);
        let names = |nodes: &[usize]| nodes.iter().map(|&node| name(node)).collect::<Vec<_>>().join("; ");
        let kind = match self.kind {
            GraphKind::Guidance => "guidance graph",
            GraphKind::Optimistic => "optimistic graph",
        };
        let state = if self.complete { "" } else { " (stopped before it was complete)" };
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{kind}{state}: {} nodes, {} edges", self.nodes.len(), self.edges.len());
        let _ = writeln!(out, "nodes");
        for (index, node) in self.nodes.iter().enumerate() {
            let centre = node.centre;
            let _ = write!(
                out,
                "  {index}: {}, capacity {} ({}), at ({:.3}, {:.3}, {:.3})",
                name(index),
                node.capacity,
                self.why(problem, index),
                centre.x,
                centre.y,
                centre.z
            );
            if let Place::Region(region) = &node.place {
                let arms = arm_names(problem, &region.arms);
                let merged = region.merged.iter().map(|slot| slot_name(problem, slot)).collect::<Vec<_>>();
                let _ = write!(out, ", class {}, reached by {arms}", region.class);
                if !merged.is_empty() {
                    let _ = write!(out, ", with {}", merged.join("; "));
                }
            }
            let _ = writeln!(out);
        }
        let _ = writeln!(out, "edges");
        for edge in &self.edges {
            let back = self.back(edge);
            if back.is_some() && edge.from > edge.to {
                continue;
            }
            let arrow = if back.is_some() { "<->" } else { "->" };
            let _ = writeln!(
                out,
                "  {} {arrow} {}, class {}, {:.3} m{}",
                name(edge.from),
                name(edge.to),
                edge.class,
                edge.weight,
                self.how(edge, back).map_or_else(String::new, |how| format!(", {how}"))
            );
        }
        if !self.conflicts.is_empty() {
            let _ = writeln!(out, "together at most");
        }
        for conflict in &self.conflicts {
            let _ = writeln!(out, "  {}: {}", conflict.capacity, names(&conflict.nodes));
        }
        if !self.barred.is_empty() {
            let _ = writeln!(out, "no grasps fit together");
        }
        for carry in &self.barred {
            let arms = carry.carriers.iter().map(|arm| problem.workcell.arms[arm.0].id.as_str());
            let _ = writeln!(
                out,
                "  {} from its start by {} to its goal",
                problem.objects[carry.object.0].id,
                arms.collect::<Vec<_>>().join(", then ")
            );
        }
        if !self.blockages.is_empty() {
            let _ = writeln!(out, "in the way");
        }
        for blockage in &self.blockages {
            let arm = |arm: &ArmId| problem.workcell.arms[arm.0].id.clone();
            let (action, how) = match &blockage.part {
                BlockedPart::Contact(action, by) => (action, format!("by {}", arm(by))),
                BlockedPart::Carry(action, by) => {
                    let carriers = by.iter().map(arm).collect::<Vec<_>>();
                    (action, format!("to be carried straight by {}", carriers.join(", then ")))
                }
            };
            let (action, object) = (action.verb(), &problem.objects[blockage.object.0].id);
            let _ = writeln!(out, "  {}: {action} of {object} {how}", name(blockage.at));
        }
        if !self.crowdings.is_empty() {
            let _ = writeln!(out, "not in one step");
        }
        for ends in &self.crowdings {
            let ends = ends.iter().map(|end| {
                let carriers = end.carriers.iter().map(|arm| problem.workcell.arms[arm.0].id.as_str());
                let (action, object) = (end.action.verb(), &problem.objects[end.object.0].id);
                let carriers = carriers.collect::<Vec<_>>().join(", then ");
                format!("{action} of {object} to be carried straight by {carriers}")
            });
            let _ = writeln!(out, "  {}", ends.collect::<Vec<_>>().join("; "));
        }
        let _ = writeln!(out, "objects");
        for (object, model) in self.objects.iter().zip(&problem.objects) {
            let goal = match &object.goal {
                ModeGoal::Nodes(nodes) if nodes.is_empty() => "nowhere that is known".to_owned(),
                ModeGoal::Nodes(nodes) => names(nodes),
                ModeGoal::AnyPlacement => "any placement".to_owned(),
            };
            let _ =
                writeln!(out, "  {} (class {}): {} => {goal}", model.id, object.class, name(object.start));
        }
        out
    }

    /// The graph in Graphviz's DOT: arms as boxes, slots as diamonds, regions as ellipses; an edge
    /// that goes both ways is drawn once. What is long is in tooltips.
    pub fn to_dot(&self, problem: &Problem) -> String {
        let mut out = String::from("digraph modes {\n  overlap = false;\n");
        for (index, node) in self.nodes.iter().enumerate() {
            let shape = match node.place {
                Place::Arm(_) => "box",
                Place::Slot(_) => "diamond",
                Place::Region(_) | Place::Surface(_) => "ellipse",
            };
            // Ids are made of letters, digits, `_`, `.` and `-`: nothing to escape.
            let name = self.node_name(problem, index);
            let reached = match &node.place {
                Place::Region(region) => format!("\\nreached by {}", arm_names(problem, &region.arms)),
                _ => String::new(),
            };
            let why = self.why(problem, index);
            let _ = writeln!(
                out,
                "  n{index} [shape={shape}, label=\"{name}\\ncapacity {}{reached}\", \
                 tooltip=\"{name}: capacity {0} ({why})\", pos=\"{:.3},{:.3}\"];",
                node.capacity, node.centre.x, node.centre.y
            );
        }
        for edge in &self.edges {
            let back = self.back(edge);
            if back.is_some() && edge.from > edge.to {
                continue;
            }
            let both = if back.is_some() { ", dir=both" } else { "" };
            let by = match &edge.witness {
                Some(Witness::Rest(rest)) => format!("\\nby {}", grasp(&rest.hold)),
                Some(Witness::Handoff(handoff)) => {
                    format!("\\nby {} to {}", grasp(&handoff.giver_hold), grasp(&handoff.receiver_hold))
                }
                None => String::new(),
            };
            let tooltip =
                self.how(edge, back).map_or_else(String::new, |how| format!(", edgetooltip=\"{how}\""));
            let _ = writeln!(
                out,
                "  n{} -> n{} [label=\"class {}, {:.2} m{by}\"{tooltip}{both}];",
                edge.from, edge.to, edge.class, edge.weight
            );
        }
        for conflict in self.conflicts.iter().filter(|conflict| conflict.nodes.len() == 2) {
            let _ = writeln!(
                out,
                "  n{} -> n{} [style=dashed, dir=none, label=\"{}\"];",
                conflict.nodes[0], conflict.nodes[1], conflict.capacity
            );
        }
        out.push_str("}\n");
        out
    }

    /// Where the capacity of `node` comes from.
    pub fn why(&self, problem: &Problem, node: usize) -> String {
        let Some(ModeNode { place, capacity, .. }) = self.nodes.get(node) else { return String::new() };
        let region = match place {
            Place::Arm(_) => return "one gripper".to_owned(),
            Place::Slot(_) => return "one exact pose".to_owned(),
            Place::Surface(_) => return "all objects, within what the surface's area holds".to_owned(),
            Place::Region(region) => region,
        };
        let spots = region.spots.len();
        let least = if region.more_may_fit { "at least " } else { "" };
        let s = if spots == 1 { "" } else { "s" };
        let merged = match region.merged.len() {
            0 => String::new(),
            1 => " and 1 start or goal within".to_owned(),
            count => format!(" and {count} starts and goals within"),
        };
        let objects = problem.objects.iter().filter(|object| object.class == region.class).count();
        let end = match (region.more_may_fit, objects) {
            (false, _) => "no room for more was found".to_owned(),
            (true, 1) if *capacity >= 1 => "which is enough for the one object of the class".to_owned(),
            (true, _) if *capacity >= objects => {
                format!("which is enough for the {objects} objects of the class at once")
            }
            (true, _) => "no more were looked for".to_owned(),
        };
        format!("{least}{spots} spot{s} with room for fingers{merged}, {end}")
    }

    /// The edge that leads back, if there is one.
    fn back(&self, edge: &ModeEdge) -> Option<&ModeEdge> {
        self.edges.iter().find(|e| e.from == edge.to && e.to == edge.from && e.class == edge.class)
    }

    /// The witnesses of an edge and of the one that leads back; `None` on the graph that bounds, which
    /// has no witnesses.
    fn how(&self, edge: &ModeEdge, back: Option<&ModeEdge>) -> Option<String> {
        if self.kind == GraphKind::Optimistic {
            return None;
        }
        let known = |edge: &ModeEdge| match &edge.witness {
            Some(witness) => format!("by {}", case(witness)),
            None => "without a witness".to_owned(),
        };
        let there = known(edge);
        Some(match back {
            None => there,
            Some(back) if back.witness == edge.witness.as_ref().map(Witness::reversed) => {
                format!("{there}, both ways")
            }
            Some(back) => format!("{there}, back {}", known(back)),
        })
    }
}

/// A witness in words: grasps, joints, and where the object rests.
fn case(witness: &Witness) -> String {
    match witness {
        Witness::Rest(rest) => {
            let at = rest.pose.translation.vector;
            let hold = grasp(&rest.hold);
            format!("{hold} at {}, the object at ({:.3}, {:.3}, {:.3})", joints(&rest.q), at.x, at.y, at.z)
        }
        Witness::Handoff(handoff) => format!(
            "{} at {} to {} at {}",
            grasp(&handoff.giver_hold),
            joints(&handoff.giver_q),
            grasp(&handoff.receiver_hold),
            joints(&handoff.receiver_q)
        ),
    }
}

fn arm_names(problem: &Problem, arms: &[ArmId]) -> String {
    arms.iter().map(|arm| problem.workcell.arms[arm.0].id.as_str()).collect::<Vec<_>>().join(", ")
}

fn grasp(hold: &Hold) -> String {
    hold.grasp.map_or_else(|| "the hold at the start".to_owned(), |number| format!("grasp {number}"))
}

/// Joint values for people (rad or m).
fn joints(q: &[f64]) -> String {
    let values = q.iter().map(|value| format!("{value:.2}")).collect::<Vec<_>>();
    format!("[{}]", values.join(", "))
}

fn slot_name(problem: &Problem, slot: &Slot) -> String {
    let id = |object: crate::workcell::ObjectId| problem.objects[object.0].id.as_str();
    match (slot.start_of, slot.goal_of) {
        (Some(start), Some(goal)) => format!("start of {}, goal of {}", id(start), id(goal)),
        (Some(start), None) => format!("start of {}", id(start)),
        (None, Some(goal)) => format!("goal of {}", id(goal)),
        (None, None) => "slot".to_owned(),
    }
}

//! The graph that guides, from geometry and reach.

use std::collections::{BTreeMap, BTreeSet};

use crate::geometry::Vec3;
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::run::Control;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::carries::Carries;
use super::graph::{
    Blockage, GraphKind, ModeEdge, ModeGoal, ModeGraph, ModeNode, ModeObject, NodeConflict, Place, Region,
    Slot,
};
use super::handoffs::{Handover, Meetings, handoffs};
use super::holds::RestHolds;
use super::proof::Proof;
use super::reach::Reach;
use super::slots::{Slots, resting_poses};
use super::survey::{Group, SlotReach, Surveyor};
use super::witness::Witness;

/// How finely surfaces are looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeGraphOptions {
    /// Spots wanted on each surface for each class, at least; positive.
    pub least_spots: usize,
    /// Spots wanted at most, however large the surface.
    pub most_spots: usize,
    /// Side (m) of the square of surface for which one spot is wanted; positive.
    pub spacing: f64,
    /// Whether goal slots may merge into their regions. Then all objects that must end in a region
    /// are alike to guidance, but an object cannot be told to stop there short of its goal.
    pub merge_goals: bool,
}

impl Default for ModeGraphOptions {
    fn default() -> Self {
        Self { least_spots: 9, most_spots: 400, spacing: 0.2, merge_goals: true }
    }
}

impl ModeGraphOptions {
    /// As the planner wants it: goals stay apart from their regions, so that an object may be put
    /// aside right beside its goal; and no more spots than it takes to tell regions apart and to have a
    /// choice, since reach is asked for at each.
    pub fn planning() -> Self {
        Self { merge_goals: false, spacing: 0.25, ..Self::default() }
    }
}

/// What was found for one class of objects.
struct ClassSurvey {
    /// Groups by surface.
    groups: Vec<(SurfaceId, Group)>,
    handovers: Vec<Handover>,
}

/// What was found.
struct Survey {
    slots: Slots,
    slot_reach: Vec<SlotReach>,
    classes: BTreeMap<usize, ClassSurvey>,
    carries: Carries,
}

/// Builds the graph that guides `problem`.
///
/// Start and goal poses become slots, reach at each of them is asked of `reach` itself; surfaces
/// are packed with spots, of which neighbours that the same arms reach become regions; every pair
/// of arms that may meet is asked for a handoff. Deterministic if `reach` is. When `control` stops
/// it the graph holds what was found by then and is marked incomplete.
pub fn build_mode_graph(
    problem: &Problem,
    reach: &mut dyn Reach,
    options: &ModeGraphOptions,
    control: &Control,
) -> ModeGraph {
    let proof = Proof::new(problem);
    let slots = Slots::new(problem);
    let classes = classes(problem);
    let mut surveyor =
        Surveyor { problem, proof: &proof, reach, meetings: Meetings::default(), control, complete: true };
    let mut holds: BTreeMap<usize, RestHolds> =
        classes.iter().map(|&class| (class, surveyor.initial_holds(class))).collect();
    let mut slot_reach = Vec::with_capacity(slots.slots.len());
    for slot in &slots.slots {
        let known = match holds.get_mut(&slot.class) {
            Some(holds) => surveyor.slot(slot, holds),
            None => SlotReach::default(),
        };
        slot_reach.push(known);
    }
    let mut surveys = BTreeMap::new();
    for (&class, holds) in &mut holds {
        let mut groups = Vec::new();
        for surface in (0..problem.workcell.surfaces.len()).map(SurfaceId) {
            let wanted = wanted_spots(problem, class, surface, options);
            for group in surveyor.surface(surface, class, &slots, &slot_reach, wanted) {
                surveyor.group_holds(&group, class, surface, holds);
                groups.push((surface, group));
            }
        }
        let member = problem.objects.iter().position(|object| object.class == class).unwrap_or(0);
        let (reach, meetings) = (&mut *surveyor.reach, &mut surveyor.meetings);
        let (handovers, complete) =
            handoffs(problem, reach, &proof, ObjectId(member), (holds, &groups), meetings, control);
        surveyor.complete &= complete;
        surveys.insert(class, ClassSurvey { groups, handovers });
    }
    let mut carries = Carries::default();
    for (object, model) in problem.objects.iter().enumerate() {
        let handovers = surveys.get(&model.class).map_or(&[][..], |survey| &survey.handovers);
        carries.look_at(&mut surveyor, &slots, &slot_reach, handovers, ObjectId(object));
    }
    let complete = surveyor.complete;
    let survey = Survey { slots, slot_reach, classes: surveys, carries };
    assemble(problem, survey, complete, options.merge_goals)
}

/// The classes of the problem's objects, ascending.
pub(super) fn classes(problem: &Problem) -> Vec<usize> {
    problem.objects.iter().map(|object| object.class).collect::<BTreeSet<_>>().into_iter().collect()
}

/// How many spots of `class` to look for on `surface`.
fn wanted_spots(problem: &Problem, class: usize, surface: SurfaceId, options: &ModeGraphOptions) -> usize {
    let objects = problem.objects.iter().filter(|object| object.class == class).count();
    let [x, y] = problem.workcell.surfaces[surface.0].half_extents;
    let squares = (4.0 * x * y / (options.spacing * options.spacing)).ceil();
    let squares = if squares.is_finite() { squares as usize } else { options.most_spots };
    options.least_spots.max(2 * objects).max(squares).min(options.most_spots)
}

/// Puts nodes, edges and conflicts together.
fn assemble(problem: &Problem, survey: Survey, complete: bool, merge_goals: bool) -> ModeGraph {
    let Survey { slots, slot_reach, classes: surveys, carries } = survey;
    let overlaps = slots.overlaps(problem, problem.options.clearance_m, false);
    let mut nodes = arm_nodes(problem);
    // Which region a slot merges into, and each region's place in the list of nodes.
    let merged = merged_slots(problem, &slots, &overlaps, &surveys, &carries, merge_goals);
    let mut slot_node: Vec<Option<usize>> = vec![None; slots.slots.len()];
    for (number, slot) in slots.slots.iter().enumerate() {
        if merged[number].is_none() {
            slot_node[number] = Some(nodes.len());
            let centre = slot.pose.translation.vector;
            nodes.push(ModeNode { place: Place::Slot(slot.clone()), capacity: 1, centre });
        }
    }
    let mut edges = Vec::new();
    let mut region_nodes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (class, survey) in surveys {
        for (index, (surface, group)) in survey.groups.into_iter().enumerate() {
            let own: Vec<usize> =
                (0..slots.slots.len()).filter(|&slot| merged[slot] == Some((class, index))).collect();
            own.iter().for_each(|&slot| slot_node[slot] = Some(nodes.len()));
            region_nodes.insert((class, index), nodes.len());
            let merged: Vec<Slot> = own.iter().map(|&slot| slots.slots[slot].clone()).collect();
            nodes.push(region_node(surface, class, group, merged));
        }
        for pair in survey.handovers {
            let (from, to) = (pair.giver.0, pair.receiver.0);
            edges.push(edge(&nodes, from, to, class, Some(Witness::Handoff(pair.witness))));
        }
    }
    for node in 0..nodes.len() {
        let (class, pick, place) = match &nodes[node].place {
            Place::Slot(slot) => {
                let Some(number) = slot_node.iter().position(|&at| at == Some(node)) else { continue };
                (slot.class, slot_reach[number].pick.clone(), slot_reach[number].place.clone())
            }
            Place::Region(region) => (region.class, region.arms.clone(), region.arms.clone()),
            Place::Arm(_) | Place::Surface(_) => continue,
        };
        edges.extend(pick.iter().map(|arm| edge(&nodes, node, arm.0, class, None)).collect::<Vec<_>>());
        edges.extend(place.iter().map(|arm| edge(&nodes, arm.0, node, class, None)).collect::<Vec<_>>());
    }
    edges.sort_by_key(|edge| (edge.from, edge.to, edge.class));
    let mut conflicts: Vec<NodeConflict> = overlaps
        .iter()
        .filter_map(|&(a, b)| {
            let mut nodes = vec![slot_node[a]?, slot_node[b]?];
            nodes.sort_unstable();
            Some(NodeConflict { nodes, capacity: 1 })
        })
        .collect();
    conflicts.extend(shared_room(problem, &nodes));
    conflicts.extend(given_capacities(problem, &nodes));
    let objects = (0..problem.objects.len())
        .map(|index| mode_object(problem, &slots, &slot_node, &nodes, index))
        .collect::<Option<Vec<_>>>();
    // Every start has its slot, and every slot its node.
    let objects = objects.unwrap_or_default();
    let Carries { mut barred, obstacles } = carries;
    barred.sort();
    let mut blockages: Vec<Blockage> = obstacles
        .into_iter()
        .filter_map(|o| Some(Blockage { object: o.object, part: o.part, at: slot_node[o.at]? }))
        .collect();
    blockages.sort();
    ModeGraph {
        kind: GraphKind::Guidance,
        nodes,
        edges,
        conflicts,
        objects,
        barred,
        blockages,
        crowdings: Vec::new(),
        complete,
    }
}

pub(super) fn arm_nodes(problem: &Problem) -> Vec<ModeNode> {
    let node = |(index, arm): (usize, &crate::workcell::Arm)| ModeNode {
        place: Place::Arm(ArmId(index)),
        capacity: 1,
        centre: arm.base.translation.vector,
    };
    problem.workcell.arms.iter().enumerate().map(node).collect()
}

pub(super) fn edge(
    nodes: &[ModeNode],
    from: usize,
    to: usize,
    class: usize,
    witness: Option<Witness>,
) -> ModeEdge {
    let weight = (nodes[from].centre - nodes[to].centre).norm();
    ModeEdge { from, to, class, weight, witness }
}

fn region_node(surface: SurfaceId, class: usize, group: Group, merged: Vec<Slot>) -> ModeNode {
    let positions =
        group.spots.iter().filter_map(|spot| spot.poses.first()).chain(merged.iter().map(|slot| &slot.pose));
    let positions: Vec<Vec3> = positions.map(|pose| pose.translation.vector).collect();
    let centre = positions.iter().sum::<Vec3>() / positions.len().max(1) as f64;
    let capacity = group.spots.len() + merged.len();
    let Group { arms, spots, more_may_fit, .. } = group;
    let region = Region { surface, class, arms, spots, more_may_fit, merged };
    ModeNode { place: Place::Region(region), capacity, centre }
}

/// By slot, the region (class and number) that it merges into, if it does.
///
/// A slot merges when it overlaps no other, is only a start or only a goal, was found to belong to
/// the region (a neighbour with the same arms), its object has no other slot in that region, and there
/// is nothing special about carries from or to it. A region takes its slots in only if its spots are enough for all objects of the class that own none of them: then no
/// count of objects in the region can force one onto a slot that is still needed, and the capacity
/// is the spots and the slots together. Where classes share a surface nothing merges.
fn merged_slots(
    problem: &Problem,
    slots: &Slots,
    overlaps: &[(usize, usize)],
    surveys: &BTreeMap<usize, ClassSurvey>,
    carries: &Carries,
    merge_goals: bool,
) -> Vec<Option<(usize, usize)>> {
    let mut merged = vec![None; slots.slots.len()];
    for (&class, survey) in surveys {
        for (index, (surface, group)) in survey.groups.iter().enumerate() {
            let shared = surveys
                .iter()
                .any(|(&other, survey)| other != class && survey.groups.iter().any(|(at, _)| at == surface))
                || slots.slots.iter().any(|slot| slot.class != class && slot.surface == *surface);
            if shared {
                continue;
            }
            let fits = |&number: &usize| {
                let slot = &slots.slots[number];
                let alone = !overlaps.iter().any(|&(a, b)| a == number || b == number);
                let other_end = match (slot.start_of, slot.goal_of) {
                    (Some(object), None) => slots.goal[object.0],
                    (None, Some(object)) if merge_goals => slots.start[object.0],
                    _ => return false,
                };
                let owner = slot.start_of.or(slot.goal_of);
                let barred = carries.barred.iter().any(|carry| Some(carry.object) == owner);
                let mut obstacles = carries.obstacles.iter();
                let blocked = obstacles.any(|o| o.at == number || Some(o.object) == owner);
                alone && !barred && !blocked && !other_end.is_some_and(|other| group.slots.contains(&other))
            };
            let own: Vec<usize> = group.slots.iter().copied().filter(|number| fits(number)).collect();
            let owners: BTreeSet<ObjectId> = own
                .iter()
                .flat_map(|&number| [slots.slots[number].start_of, slots.slots[number].goal_of])
                .flatten()
                .collect();
            let members = problem.objects.iter().filter(|object| object.class == class).count();
            if group.spots.len() + owners.len() >= members {
                own.into_iter().for_each(|number| merged[number] = Some((class, index)));
            }
        }
    }
    merged
}

/// Capacities of pairs of regions of different classes on one surface: spots of one class may
/// overlap those of the other. With `w` the most spots of one class that an object on a spot of
/// the other blocks, `1 + (least - 1) / w` objects always find room one after the other.
fn shared_room(problem: &Problem, nodes: &[ModeNode]) -> Vec<NodeConflict> {
    let regions: Vec<(usize, &Region)> = nodes
        .iter()
        .enumerate()
        .filter_map(|(node, found)| match &found.place {
            Place::Region(region) => Some((node, region)),
            _ => None,
        })
        .collect();
    let mut conflicts = Vec::new();
    for (position, &(a, first)) in regions.iter().enumerate() {
        for &(b, second) in &regions[position + 1..] {
            if first.surface != second.surface || first.class == second.class {
                continue;
            }
            let radius = |region: &Region| {
                let member = problem.objects.iter().find(|object| object.class == region.class);
                member.map_or(0.0, |object| object.bounding_radius())
            };
            let near = radius(first) + radius(second) + problem.options.clearance_m.max(0.0);
            let blocked = |region: &Region, by: &Region| {
                let count = |spot: &super::graph::Spot| {
                    let at = spot.poses.first().map(|pose| pose.translation.vector);
                    region
                        .spots
                        .iter()
                        .filter(|other| {
                            let other = other.poses.first().map(|pose| pose.translation.vector);
                            at.zip(other).is_some_and(|(a, b)| (a - b).norm() < near)
                        })
                        .count()
                };
                by.spots.iter().map(count).max().unwrap_or(0)
            };
            let worst = blocked(first, second).max(blocked(second, first));
            let least = first.spots.len().min(second.spots.len());
            if let Some(others) = least.saturating_sub(1).checked_div(worst) {
                conflicts.push(NodeConflict { nodes: vec![a, b], capacity: 1 + others });
            }
        }
    }
    conflicts
}

/// The capacities that the problem gives for surfaces, over all their nodes.
pub(super) fn given_capacities(problem: &Problem, nodes: &[ModeNode]) -> Vec<NodeConflict> {
    let surfaces = problem.workcell.surfaces.iter().enumerate();
    surfaces
        .filter_map(|(index, surface)| {
            let capacity = surface.capacity?;
            Some(NodeConflict { nodes: nodes_on(nodes, SurfaceId(index)), capacity })
        })
        .filter(|conflict| !conflict.nodes.is_empty())
        .collect()
}

/// The placement nodes on `surface`, ascending.
pub(super) fn nodes_on(nodes: &[ModeNode], surface: SurfaceId) -> Vec<usize> {
    let on = |node: &ModeNode| match &node.place {
        Place::Arm(_) => false,
        Place::Slot(slot) => slot.surface == surface,
        Place::Region(region) => region.surface == surface,
        Place::Surface(this) => *this == surface,
    };
    (0..nodes.len()).filter(|&node| on(&nodes[node])).collect()
}

/// Object `index` on the graph; `None` when its start has no node.
pub(super) fn mode_object(
    problem: &Problem,
    slots: &Slots,
    slot_node: &[Option<usize>],
    nodes: &[ModeNode],
    index: usize,
) -> Option<ModeObject> {
    let object = &problem.objects[index];
    let node_of = |slot: Option<usize>| slot.and_then(|number| slot_node[number]);
    let start = match &problem.initial[index] {
        InitialPlacement::Held { arm, .. } => arm.0,
        InitialPlacement::Resting { .. } => node_of(slots.start[index])?,
    };
    let (goal, goal_poses) = match &problem.goal[index] {
        GoalPlacement::Pose { pose, surface } => {
            let node = node_of(slots.goal[index]);
            let poses = resting_poses(object, pose, &problem.workcell.surfaces[surface.0]);
            (ModeGoal::Nodes(node.into_iter().collect()), poses)
        }
        GoalPlacement::Surface(surface) => {
            let takes = |&node: &usize| match &nodes[node].place {
                Place::Slot(slot) => slot.class == object.class,
                Place::Region(region) => region.class == object.class,
                Place::Arm(_) => false,
                Place::Surface(_) => true,
            };
            let on: Vec<usize> = nodes_on(nodes, *surface).into_iter().filter(takes).collect();
            (ModeGoal::Nodes(on), Vec::new())
        }
        GoalPlacement::Anywhere => (ModeGoal::AnyPlacement, Vec::new()),
    };
    Some(ModeObject { start, goal, class: object.class, goal_poses })
}

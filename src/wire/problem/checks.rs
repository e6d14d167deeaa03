//! What must hold between the parts of a problem: objects rest, nothing collides, goals are not
//! out of reach, capacities hold.

use super::bodies::{Body, arm_bodies, deepest};
use super::context::Context;
use super::draft::Draft;
use super::packing::is_packed;
use super::placement::{End, Start};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::Config;
use crate::problem::{ContactPartner, GoalPlacement, InitialPlacement};
use crate::wire::fault::FaultCode;
use crate::workcell::{
    Arm, ArmId, ObjectId, ObjectModel, ObstacleId, RestFault, Surface, SurfaceId, footprint, rests_on,
};

/// An object in its place, for collision checks.
struct PlacedObject<'d> {
    object: ObjectId,
    id: &'d str,
    pointer: &'d str,
    body: Vec<Body>,
    carrier: Option<ObstacleId>,
    holder: Option<usize>,
}

/// An arm at a configuration.
struct PlacedArm<'d> {
    index: usize,
    arm: &'d Arm,
    pointer: String,
    /// Whether it is assumed to be there, and nobody's statement.
    assumed: bool,
    bodies: Vec<Body>,
}

/// A contact of two bodies.
struct Contact<'b> {
    bodies: [&'b str; 2],
    depth: f64,
    /// What to do about it.
    advice: &'static str,
}

/// What came of the checks.
pub struct Checked {
    /// Where each object is; `None` for those at fault.
    pub initial: Vec<Option<InitialPlacement>>,
    /// Where each object shall go; `None` for those at fault.
    pub goal: Vec<Option<GoalPlacement>>,
    /// By arm, what stands in for its home, where it is not to be there and could not.
    pub homes: Vec<Option<Config>>,
}

/// Runs all checks on whatever could be read, and resolves placements.
pub fn check(draft: &Draft, context: &mut Context<'_>) -> Checked {
    let initial = resolve_initial(draft, context);
    let goal = resolve_goal(draft, context);
    check_held(draft, context);
    check_capacities(draft, &initial, &goal, context);
    check_reach(draft, &initial, context);
    let obstacles: Vec<(usize, Vec<Body>)> = draft
        .obstacles
        .iter()
        .enumerate()
        .filter_map(|(index, obstacle)| Some((index, vec![Body::obstacle(obstacle.as_ref()?)])))
        .collect();
    let starts = placed_at_start(draft, &initial);
    let arms = arms_at_start(draft);
    check_objects(draft, &starts, &obstacles, FaultCode::InitialCollision, context);
    check_arms(draft, &arms, &obstacles, context);
    check_arms_against_objects(draft, &arms, &starts, FaultCode::InitialCollision, context);
    let homes = if draft.options.return_home {
        check_arms(draft, &arms_at_home(draft), &obstacles, context);
        vec![None; draft.arms.len()]
    } else {
        homes_that_are_free(draft, &obstacles, context)
    };
    let ends = placed_at_goal(draft, &goal);
    check_objects(draft, &ends, &obstacles, FaultCode::GoalCollision, context);
    if draft.options.return_home {
        check_arms_against_objects(draft, &arms_at_home(draft), &ends, FaultCode::GoalCollision, context);
    }
    Checked { initial, goal, homes }
}

// ---------------------------------------------------------------------------------------------
// Resting

fn resolve_initial(draft: &Draft, context: &mut Context<'_>) -> Vec<Option<InitialPlacement>> {
    draft
        .objects
        .iter()
        .zip(&draft.initial)
        .map(|(object, start)| {
            let (object, start) = (object.as_ref()?, start.as_ref()?);
            match &start.what {
                Start::Pose(pose) => {
                    let surface = rest(draft, object, pose, &format!("{}/pose", start.pointer), context)?;
                    Some(InitialPlacement::Resting { pose: *pose, surface })
                }
                Start::Held(arm, object_in_tcp) => {
                    Some(InitialPlacement::Held { arm: ArmId(*arm), object_in_tcp: *object_in_tcp })
                }
            }
        })
        .collect()
}

fn resolve_goal(draft: &Draft, context: &mut Context<'_>) -> Vec<Option<GoalPlacement>> {
    draft
        .objects
        .iter()
        .zip(&draft.goal)
        .map(|(object, end)| {
            let object = object.as_ref()?;
            let Some(end) = end else { return Some(GoalPlacement::Anywhere) };
            match &end.what {
                End::Pose(pose) => {
                    let surface = rest(draft, object, pose, &format!("{}/pose", end.pointer), context)?;
                    Some(GoalPlacement::Pose { pose: *pose, surface })
                }
                End::Surface(surface) => Some(GoalPlacement::Surface(SurfaceId(*surface))),
            }
        })
        .collect()
}

/// The one surface on which `object` rests at `pose`.
fn rest(
    draft: &Draft,
    object: &ObjectModel,
    pose: &Pose,
    pointer: &str,
    context: &mut Context<'_>,
) -> Option<SurfaceId> {
    let mut under = Vec::new();
    let mut nearest: Option<(f64, &Surface, RestFault)> = None;
    for (index, surface) in draft.surfaces.iter().enumerate() {
        let Some(surface) = surface else { continue };
        match rests_on(&object.shapes, pose, surface) {
            Ok(()) => under.push((SurfaceId(index), surface)),
            Err(fault) => {
                let away = rectangle_distance(surface, &pose.translation.vector);
                if nearest.is_none_or(|(least, ..)| away < least) {
                    nearest = Some((away, surface, fault));
                }
            }
        }
    }
    match under[..] {
        [(surface, _)] => return Some(surface),
        // A surface that could not be read may be the one.
        [] if draft.surfaces.iter().any(Option::is_none) => return None,
        [] => {
            let why = match nearest {
                None => "there is no surface; add one under it".to_owned(),
                Some((_, surface, fault)) => format!("{} `{}`", rest_advice(fault), surface.id),
            };
            let message = format!("object `{}` rests on no surface: {why}", object.id);
            context.faults.push(pointer, FaultCode::NotResting, message);
        }
        _ => {
            let names: Vec<&str> = under.iter().map(|(_, surface)| surface.id.as_str()).collect();
            let message = format!(
                "object `{}` rests on {} at once; leave it one of them",
                object.id,
                names.join(" and ")
            );
            context.faults.push(pointer, FaultCode::NotResting, message);
        }
    }
    None
}

fn rest_advice(fault: RestFault) -> String {
    let mm = 1000.0 * fault.by();
    match fault {
        RestFault::Height(height) if height > 0.0 => format!("lower it by {mm:.1} mm onto"),
        RestFault::Height(_) => format!("raise it by {mm:.1} mm onto"),
        RestFault::Outside(_) => format!("its foot stands {mm:.1} mm over the edge; move it inwards on"),
        RestFault::Topples(_) => {
            format!("its centre lies {mm:.1} mm beside the points that touch; set it upright on")
        }
    }
}

/// Distance (m) from `point` to the rectangle of `surface`.
fn rectangle_distance(surface: &Surface, point: &Vec3) -> f64 {
    let local = surface.pose.inverse_transform_point(&(*point).into());
    let over = |value: f64, half: f64| (value.abs() - half).max(0.0);
    let (x, y) = (over(local.x, surface.half_extents[0]), over(local.y, surface.half_extents[1]));
    (x * x + y * y + local.z * local.z).sqrt()
}

// ---------------------------------------------------------------------------------------------
// Hands and capacities

fn check_held(draft: &Draft, context: &mut Context<'_>) {
    let mut holders = std::collections::BTreeMap::new();
    for start in draft.initial.iter().flatten() {
        if let Start::Held(arm, _) = start.what
            && holders.insert(arm, ()).is_some()
        {
            let message = "this arm holds another object already; an arm holds one at a time";
            context.faults.push(start.pointer.clone(), FaultCode::CapacityExceeded, message);
        }
    }
}

fn check_capacities(
    draft: &Draft,
    initial: &[Option<InitialPlacement>],
    goal: &[Option<GoalPlacement>],
    context: &mut Context<'_>,
) {
    for (index, surface) in draft.surfaces.iter().enumerate() {
        let Some((surface, capacity)) = surface.as_ref().and_then(|s| Some((s, s.capacity?))) else {
            continue;
        };
        let id = SurfaceId(index);
        let at_start = initial
            .iter()
            .flatten()
            .filter(
                |placement| matches!(placement, InitialPlacement::Resting { surface, .. } if *surface == id),
            )
            .count();
        let at_end = goal
            .iter()
            .flatten()
            .filter(|placement| match placement {
                GoalPlacement::Pose { surface, .. } | GoalPlacement::Surface(surface) => *surface == id,
                GoalPlacement::Anywhere => false,
            })
            .count();
        if !is_packing_found(draft, surface, capacity) {
            let message = format!(
                "no packing of {capacity} objects on surface `{}` was found; the number is taken as given",
                surface.id
            );
            let pointer = format!("/workcell/surfaces/{index}/capacity");
            context.faults.warn(pointer, FaultCode::CapacityExceeded, message);
        }
        for (count, field) in [(at_start, "initial"), (at_end, "goal")] {
            if count > capacity {
                let message = format!(
                    "{count} objects on surface `{}`, which takes {capacity}; raise its capacity or move some",
                    surface.id
                );
                context.faults.push(format!("/{field}"), FaultCode::CapacityExceeded, message);
            }
        }
    }
}

/// Whether the `capacity` smallest objects, or all of them, are packed on the surface, standing as
/// in their own frames.
fn is_packing_found(draft: &Draft, surface: &Surface, capacity: usize) -> bool {
    let mut footprints: Vec<[f64; 2]> =
        draft.objects.iter().flatten().map(|object| footprint(&object.shapes)).collect();
    footprints.sort_by(|a, b| (a[0] * a[1]).total_cmp(&(b[0] * b[1])));
    footprints.truncate(capacity);
    let [x, y] = surface.half_extents;
    is_packed(&footprints, [2.0 * x, 2.0 * y])
}

// ---------------------------------------------------------------------------------------------
// Reach

/// Refuses goals that no arm's TCP can come near enough to, but for objects that are there already.
fn check_reach(draft: &Draft, initial: &[Option<InitialPlacement>], context: &mut Context<'_>) {
    // Reach of an arm that could not be read is unknown.
    if draft.arms.is_empty() || draft.arms.iter().any(Option::is_none) {
        return;
    }
    let reaches: Vec<(Vec3, f64)> = draft.arms.iter().flatten().map(tcp_reach).collect();
    let placements = draft.initial.iter().zip(initial);
    for ((object, (start, placement)), end) in draft.objects.iter().zip(placements).zip(&draft.goal) {
        let (Some(object), Some(end)) = (object, end) else { continue };
        if start.as_ref().is_some_and(|start| is_there(object, &start.what, placement.as_ref(), &end.what)) {
            continue;
        }
        // The TCP of a grasp is this far from the object's origin, whatever its orientation.
        let grasp = object
            .grasps
            .iter()
            .map(|grasp| grasp.object_in_tcp.translation.vector.norm())
            .fold(0.0_f64, f64::max);
        let distance = |from: &Vec3| match &end.what {
            End::Pose(pose) => (pose.translation.vector - from).norm(),
            End::Surface(surface) => match draft.surfaces.get(*surface) {
                Some(Some(surface)) => rectangle_distance(surface, from) - object.bounding_radius(),
                _ => 0.0,
            },
        };
        let least_lack = reaches
            .iter()
            .map(|(centre, radius)| distance(centre) - grasp - radius)
            .fold(f64::INFINITY, f64::min);
        if least_lack > 0.0 {
            let message = format!(
                "the goal of object `{}` is {:.3} m beyond the greatest reach of every arm; bring it or an \
                 arm nearer",
                object.id, least_lack
            );
            context.faults.push(end.pointer.clone(), FaultCode::GoalUnreachable, message);
        }
    }
}

/// Whether an object is at its goal from the start, as the judge of plans sees it; `placement` is what `start` resolves to.
fn is_there(object: &ObjectModel, start: &Start, placement: Option<&InitialPlacement>, end: &End) -> bool {
    match (start, end) {
        (Start::Pose(start), End::Pose(end)) => object.is_at_goal(start, end),
        (Start::Pose(_), End::Surface(end)) => {
            matches!(placement, Some(InitialPlacement::Resting { surface, .. }) if surface.0 == *end)
        }
        (Start::Held(..), _) => false,
    }
}

/// A ball in the world that an arm's TCP never leaves: centre and radius (m).
fn tcp_reach(arm: &Arm) -> (Vec3, f64) {
    let reach = arm.model.reach_within(&arm.limits);
    let centre = arm.base * nalgebra::Point3::from(reach.centre);
    (centre.coords, reach.radius + arm.tool.tcp.translation.vector.norm())
}

// ---------------------------------------------------------------------------------------------
// Collisions

fn placed_at_start<'d>(draft: &'d Draft, initial: &[Option<InitialPlacement>]) -> Vec<PlacedObject<'d>> {
    let mut out = Vec::new();
    for (index, placement) in initial.iter().enumerate() {
        let (Some(Some(object)), Some(Some(start))) = (draft.objects.get(index), draft.initial.get(index))
        else {
            continue;
        };
        let (pose, carrier, holder) = match (placement, &start.what) {
            (Some(InitialPlacement::Resting { pose, surface }), _) => (*pose, draft.carrier(*surface), None),
            (Some(InitialPlacement::Held { arm, object_in_tcp }), _) => {
                let (Some(Some(model)), Some(Some((q, _)))) =
                    (draft.arms.get(arm.0), draft.starts.get(arm.0))
                else {
                    continue;
                };
                (model.tcp_pose(q) * object_in_tcp, None, Some(arm.0))
            }
            // It does not rest, but may still stand in something's way.
            (None, Start::Pose(pose)) => (*pose, None, None),
            (None, Start::Held(..)) => continue,
        };
        let body = vec![Body::new(object.id.clone(), None, &object.shapes, pose)];
        out.push(PlacedObject {
            object: ObjectId(index),
            id: &object.id,
            pointer: &start.pointer,
            body,
            carrier,
            holder,
        });
    }
    out
}

fn placed_at_goal<'d>(draft: &'d Draft, goal: &[Option<GoalPlacement>]) -> Vec<PlacedObject<'d>> {
    let mut out = Vec::new();
    for (index, placement) in goal.iter().enumerate() {
        let (Some(Some(object)), Some(Some(end))) = (draft.objects.get(index), draft.goal.get(index)) else {
            continue;
        };
        let End::Pose(pose) = end.what else { continue };
        let carrier = match placement {
            Some(GoalPlacement::Pose { surface, .. }) => draft.carrier(*surface),
            _ => None,
        };
        let body = vec![Body::new(object.id.clone(), None, &object.shapes, pose)];
        out.push(PlacedObject {
            object: ObjectId(index),
            id: &object.id,
            pointer: &end.pointer,
            body,
            carrier,
            holder: None,
        });
    }
    out
}

fn arms_at_start(draft: &Draft) -> Vec<PlacedArm<'_>> {
    let starts = draft.arms.iter().zip(&draft.starts).enumerate();
    starts
        .filter_map(|(index, (arm, start))| {
            let (arm, (q, pointer)) = (arm.as_ref()?, start.as_ref()?);
            let pointer = pointer.clone().unwrap_or_else(|| draft.homes.pointer(index));
            let assumed = draft.assumed.get(index).copied().unwrap_or(false);
            Some(PlacedArm { index, arm, pointer, assumed, bodies: arm_bodies(arm, q) })
        })
        .collect()
}

fn arms_at_home(draft: &Draft) -> Vec<PlacedArm<'_>> {
    let arms = draft.arms.iter().enumerate();
    arms.filter_map(|(index, arm)| {
        let arm = arm.as_ref()?;
        let (pointer, bodies) = (draft.homes.pointer(index), arm_bodies(arm, &arm.home));
        Some(PlacedArm { index, arm, pointer, assumed: false, bodies })
    })
    .collect()
}

/// By arm that starts elsewhere and need not come home, where it starts if it cannot be at home: that stands in for it.
fn homes_that_are_free(
    draft: &Draft,
    obstacles: &[(usize, Vec<Body>)],
    context: &mut Context<'_>,
) -> Vec<Option<Config>> {
    let mut homes = vec![None; draft.arms.len()];
    for home in arms_at_home(draft) {
        let Some(start) = draft.start_elsewhere(home.index) else { continue };
        let contacts = contacts_of_arm(draft, &home, obstacles);
        let (Some(Contact { bodies: [a, b], depth, .. }), Some(slot)) =
            (contacts.first(), homes.get_mut(home.index))
        else {
            continue;
        };
        *slot = Some(start.clone());
        let advice = "the arm does not have to be at home, and where it starts stands in for it";
        let message = collision_message(a, b, *depth, advice);
        context.faults.warn(home.pointer.clone(), FaultCode::InitialCollision, message);
    }
    homes
}

fn collision_message(one: &str, other: &str, depth: f64, advice: &str) -> String {
    format!("`{one}` and `{other}` overlap by {:.1} mm; {advice}", 1000.0 * depth)
}

fn check_objects(
    draft: &Draft,
    objects: &[PlacedObject<'_>],
    obstacles: &[(usize, Vec<Body>)],
    code: FaultCode,
    context: &mut Context<'_>,
) {
    let allowed = |object: ObjectId, partner| draft.allowed.object.contains(&(object, partner));
    for (index, one) in objects.iter().enumerate() {
        for other in &objects[..index] {
            let (low, high) = (one.object.min(other.object), one.object.max(other.object));
            if let Some((_, _, depth)) = deepest(&one.body, &other.body, |_, _| true)
                && !allowed(low, ContactPartner::Object(high))
            {
                let message = collision_message(one.id, other.id, depth, "move them apart");
                context.faults.push(one.pointer, FaultCode::Overlap, message);
            }
        }
        for (obstacle, body) in obstacles {
            let obstacle = ObstacleId(*obstacle);
            if one.carrier == Some(obstacle) || allowed(one.object, ContactPartner::Obstacle(obstacle)) {
                continue;
            }
            if let Some((_, body, depth)) = deepest(&one.body, body, |_, _| true) {
                let message = collision_message(one.id, &body.name, depth, "move the object away");
                context.faults.push(one.pointer, code, message);
            }
        }
    }
}

fn check_arms(
    draft: &Draft,
    arms: &[PlacedArm<'_>],
    obstacles: &[(usize, Vec<Body>)],
    context: &mut Context<'_>,
) {
    for (index, one) in arms.iter().enumerate() {
        for Contact { bodies: [a, b], depth, advice } in contacts_of_arm(draft, one, obstacles) {
            note_collision(&one.pointer, one.assumed, collision_message(a, b, depth, advice), context);
        }
        for other in &arms[..index] {
            let checks = |a: &Body, b: &Body| {
                let pair =
                    a.of_arm.zip(b.of_arm).map(|(a, b)| ((ArmId(one.index), a), (ArmId(other.index), b)));
                pair.is_none_or(|(a, b)| !draft.allowed.arm_arm.contains(&(a.min(b), a.max(b))))
            };
            if let Some((a, b, depth)) = deepest(&one.bodies, &other.bodies, checks) {
                let message =
                    collision_message(&a.name, &b.name, depth, "change a configuration or move an arm");
                note_collision(&one.pointer, one.assumed || other.assumed, message, context);
            }
        }
    }
}

/// Notes a collision of an arm: a warning where it is only assumed to be there.
fn note_collision(pointer: &str, assumed: bool, message: String, context: &mut Context<'_>) {
    if assumed {
        context.faults.warn(pointer, FaultCode::InitialCollision, message);
    } else {
        context.faults.push(pointer, FaultCode::InitialCollision, message);
    }
}

/// Contacts of an arm with itself, the deepest, and with each obstacle.
fn contacts_of_arm<'b>(
    draft: &Draft,
    placed: &'b PlacedArm<'_>,
    obstacles: &'b [(usize, Vec<Body>)],
) -> Vec<Contact<'b>> {
    let mut contacts = Vec::new();
    let itself = |a: &Body, b: &Body| {
        a.of_arm < b.of_arm && a.of_arm.zip(b.of_arm).is_some_and(|(a, b)| placed.arm.checks_bodies(a, b))
    };
    if let Some((a, b, depth)) = deepest(&placed.bodies, &placed.bodies, itself) {
        let advice = "change the configuration, or exempt the pair";
        contacts.push(Contact { bodies: [&a.name, &b.name], depth, advice });
    }
    for (obstacle, body) in obstacles {
        let checks = |a: &Body, _: &Body| {
            let contact = a.of_arm.map(|body| (ArmId(placed.index), body, ObstacleId(*obstacle)));
            contact.is_none_or(|contact| !draft.allowed.arm_obstacle.contains(&contact))
        };
        if let Some((a, b, depth)) = deepest(&placed.bodies, body, checks) {
            let advice = "change the configuration, move one of them, or list the pair in allowed_contacts";
            contacts.push(Contact { bodies: [&a.name, &b.name], depth, advice });
        }
    }
    contacts
}

fn check_arms_against_objects(
    draft: &Draft,
    arms: &[PlacedArm<'_>],
    objects: &[PlacedObject<'_>],
    code: FaultCode,
    context: &mut Context<'_>,
) {
    for arm in arms.iter().filter(|arm| !arm.assumed) {
        for object in objects {
            let checks = |part: &Body, _: &Body| {
                let Some(body) = part.of_arm else { return true };
                let is_hand = arm.arm.hand_groups.contains(&arm.arm.group_of(body));
                let partner = ContactPartner::Arm(ArmId(arm.index), body);
                let is_held = is_hand && object.holder == Some(arm.index);
                !is_held && !draft.allowed.object.contains(&(object.object, partner))
            };
            if let Some((part, _, depth)) = deepest(&arm.bodies, &object.body, checks) {
                let message = collision_message(&part.name, object.id, depth, "move one of them away");
                context.faults.push(object.pointer, code, message);
            }
        }
    }
}

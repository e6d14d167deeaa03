//! Obstacles, surfaces and allowed contacts.

use std::collections::{BTreeMap, BTreeSet};

use super::context::{Context, Named};
use super::shape::read_shape;
use crate::geometry::Pose;
use crate::problem::ContactPartner;
use crate::wire::fault::FaultCode;
use crate::wire::reader::{Fields, Node, Range};
use crate::workcell::{Arm, ArmBody, ArmId, BodyPair, ObjectId, Obstacle, ObstacleId, Surface, body_pair};

/// Most pairs of bodies that all entries of `allowed_contacts` together may stand for: two whole arms
/// stand for each body of the one against each of the other.
const MAX_ALLOWED_PAIRS: usize = 1_000_000;

/// A pose that may be left out.
pub fn optional_pose(fields: &mut Fields<'_>, key: &'static str, context: &mut Context<'_>) -> Option<Pose> {
    match fields.optional(key) {
        Some(node) => node.pose(&mut context.faults),
        None => Some(Pose::identity()),
    }
}

/// `workcell.obstacles`, one entry per element.
pub fn read_obstacles(node: Option<Node<'_>>, context: &mut Context<'_>) -> Vec<Option<Obstacle>> {
    let Some(node) = node else { return Vec::new() };
    let elements = context.named_elements(&node, "obstacles", context.limits.max_obstacles);
    elements.iter().enumerate().map(|(index, node)| read_obstacle(index, node, context)).collect()
}

fn read_obstacle(index: usize, node: &Node<'_>, context: &mut Context<'_>) -> Option<Obstacle> {
    let mut fields = node.fields(&mut context.faults)?;
    let id = fields.required("id", &mut context.faults);
    let id = context.register(id, Named::Obstacle(index));
    let shapes = fields
        .required("shape", &mut context.faults)
        .and_then(|node| read_shape(&node, Pose::identity(), context));
    let pose = optional_pose(&mut fields, "pose", context);
    fields.finish(&mut context.faults);
    Some(Obstacle { id: id?, shapes: shapes?, pose: pose? })
}

/// `workcell.surfaces`, one entry per element; obstacles have been read.
pub fn read_surfaces(node: Option<Node<'_>>, context: &mut Context<'_>) -> Vec<Option<Surface>> {
    let Some(node) = node else { return Vec::new() };
    let elements = context.named_elements(&node, "surfaces", context.limits.max_surfaces);
    elements.iter().enumerate().map(|(index, node)| read_surface(index, node, context)).collect()
}

fn read_surface(index: usize, node: &Node<'_>, context: &mut Context<'_>) -> Option<Surface> {
    let mut fields = node.fields(&mut context.faults)?;
    let id = fields.required("id", &mut context.faults);
    let id = context.register(id, Named::Surface(index));
    let carrier = match fields.optional("on") {
        Some(node) => node.string(&mut context.faults).and_then(|text| match context.named(text) {
            Some(Named::Obstacle(index)) => Some(Some(ObstacleId(index))),
            _ => {
                context.unknown(&node.pointer, text, "obstacle", FaultCode::UnknownBody);
                None
            }
        }),
        None => Some(None),
    };
    let pose = optional_pose(&mut fields, "pose", context);
    let half_extents = fields.required("size", &mut context.faults).and_then(|node| {
        let mut size = node.fields(&mut context.faults)?;
        let mut half = |key| {
            let node = size.required(key, &mut context.faults)?;
            Some(node.number(&mut context.faults, Range::Positive(1000.0))? / 2.0)
        };
        let (x, y) = (half("x"), half("y"));
        size.finish(&mut context.faults);
        Some([x?, y?])
    });
    let capacity = match fields.nullable("capacity") {
        Some(node) => node.whole(&mut context.faults, 0, 1_000_000).map(|value| Some(value as usize)),
        None => Some(None),
    };
    fields.finish(&mut context.faults);
    Some(Surface {
        id: id?,
        carrier: carrier?,
        pose: pose?,
        half_extents: half_extents?,
        capacity: capacity?,
    })
}

/// What `allowed_contacts` exempts.
#[derive(Debug, Default)]
pub struct AllowedContacts {
    /// Bodies of one arm against each other, by arm.
    pub within_arm: BTreeMap<usize, BTreeSet<BodyPair>>,
    /// Bodies of arms against obstacles.
    pub arm_obstacle: BTreeSet<(ArmId, ArmBody, ObstacleId)>,
    /// Bodies of two arms against each other, the lower arm first.
    pub arm_arm: BTreeSet<((ArmId, ArmBody), (ArmId, ArmBody))>,
    /// Objects against anything.
    pub object: BTreeSet<(ObjectId, ContactPartner)>,
}

/// A resolved body name.
enum Body {
    OfArm(usize, Vec<ArmBody>),
    Obstacle(usize),
    Object(usize),
}

impl Body {
    /// How many bodies it stands for.
    fn size(&self) -> usize {
        match self {
            Self::OfArm(_, bodies) => bodies.len(),
            Self::Obstacle(_) | Self::Object(_) => 1,
        }
    }
}

/// `workcell.allowed_contacts`; everything that has a name has been read.
pub fn read_allowed_contacts(
    node: Option<Node<'_>>,
    arms: &[Option<Arm>],
    context: &mut Context<'_>,
) -> AllowedContacts {
    let mut allowed = AllowedContacts::default();
    let Some(node) = node else { return allowed };
    let elements =
        node.elements(&mut context.faults, "allowed contacts", context.limits.max_allowed_contacts);
    let (mut seen, mut count) = (BTreeSet::new(), 0);
    for pair in elements {
        let bodies = pair.elements(&mut context.faults, "bodies in a pair", 2);
        let [a, b] = &bodies[..] else {
            if pair.value.as_array().is_some_and(|list| list.len() < 2) {
                pair.fault(&mut context.faults, FaultCode::WrongType, "give two body names");
            }
            continue;
        };
        let (one, other) = (a.value.as_str(), b.value.as_str());
        let names = (one.min(other), one.max(other));
        // Two whole arms stand for thousands of pairs: once is enough.
        if seen.contains(&names) {
            continue;
        }
        let (a, b) = (read_body(a, arms, context), read_body(b, arms, context));
        if let (Some(a), Some(b)) = (a, b) {
            seen.insert(names);
            count += a.size() * b.size();
            if count > MAX_ALLOWED_PAIRS {
                let message = format!(
                    "the allowed contacts up to this one stand for {count} pairs of bodies, at most \
                     {MAX_ALLOWED_PAIRS} are taken; name links instead of whole arms"
                );
                node.fault(&mut context.faults, FaultCode::TooLarge, message);
                break;
            }
            allow(&mut allowed, &a, &b);
        }
    }
    allowed
}

fn allow(allowed: &mut AllowedContacts, a: &Body, b: &Body) {
    match (a, b) {
        (Body::OfArm(arm_a, bodies_a), Body::OfArm(arm_b, bodies_b)) => {
            for &a in bodies_a {
                for &b in bodies_b {
                    if arm_a == arm_b {
                        allowed.within_arm.entry(*arm_a).or_default().insert(body_pair(a, b));
                    } else {
                        let (one, other) = ((ArmId(*arm_a), a), (ArmId(*arm_b), b));
                        allowed.arm_arm.insert((one.min(other), one.max(other)));
                    }
                }
            }
        }
        (Body::OfArm(arm, bodies), Body::Obstacle(obstacle))
        | (Body::Obstacle(obstacle), Body::OfArm(arm, bodies)) => {
            let pairs = bodies.iter().map(|body| (ArmId(*arm), *body, ObstacleId(*obstacle)));
            allowed.arm_obstacle.extend(pairs);
        }
        (Body::OfArm(arm, bodies), Body::Object(object))
        | (Body::Object(object), Body::OfArm(arm, bodies)) => {
            let partners = bodies.iter().map(|body| ContactPartner::Arm(ArmId(*arm), *body));
            allowed.object.extend(partners.map(|partner| (ObjectId(*object), partner)));
        }
        (Body::Object(object), Body::Obstacle(obstacle))
        | (Body::Obstacle(obstacle), Body::Object(object)) => {
            allowed.object.insert((ObjectId(*object), ContactPartner::Obstacle(ObstacleId(*obstacle))));
        }
        (Body::Object(one), Body::Object(other)) => {
            let partner = ContactPartner::Object(ObjectId(*one.max(other)));
            allowed.object.insert((ObjectId(*one.min(other)), partner));
        }
        // Obstacles do not move: they are never checked against each other.
        (Body::Obstacle(_), Body::Obstacle(_)) => {}
    }
}

/// `ARM`, `ARM/LINK`, `ARM/@tool`, an obstacle's or an object's id.
fn read_body(node: &Node<'_>, arms: &[Option<Arm>], context: &mut Context<'_>) -> Option<Body> {
    let text = node.string(&mut context.faults)?;
    let (id, link) = match text.split_once('/') {
        Some((id, link)) => (id, Some(link)),
        None => (text, None),
    };
    match (context.named(id), link) {
        (Some(Named::Obstacle(index)), None) => Some(Body::Obstacle(index)),
        (Some(Named::Object(index)), None) => Some(Body::Object(index)),
        (Some(Named::Arm(index)), link) => {
            // An arm that could not be read has its faults already.
            let arm = arms.get(index)?.as_ref()?;
            let bodies = match link {
                None => arm.bodies().map(|(body, ..)| body).collect(),
                Some("@tool") => vec![ArmBody::Tool],
                Some(link) => match arm.model.link_index(link) {
                    Some(link) => vec![ArmBody::Link(link)],
                    None => {
                        let links: Vec<&str> =
                            arm.model.links.iter().take(40).map(|link| link.name.as_str()).collect();
                        let message =
                            format!("arm `{id}` has no such link; it has @tool, {}", links.join(", "));
                        node.fault(&mut context.faults, FaultCode::UnknownBody, message);
                        return None;
                    }
                },
            };
            Some(Body::OfArm(index, bodies))
        }
        _ => {
            context.unknown(&node.pointer, text, "body", FaultCode::UnknownBody);
            None
        }
    }
}

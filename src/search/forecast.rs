//! Where the other objects are, as far as known, when something happens later in a guide's plan.

use crate::collision::Scene;
use crate::geometry::Pose;
use crate::guidance::NodeId;
use crate::workcell::ObjectId;

use super::chain::Chains;
use super::leg::Leg;
use super::map::Map;
use super::tree::{Vertex, Whereabouts};

/// Another object at rest.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbour {
    pub(super) object: ObjectId,
    pub(super) node: NodeId,
    pub(super) pose: Pose,
}

/// Where all objects but `object` rest before `step` of the plan or after it: where they are now,
/// where their chains put them, or where their goal is one pose. One that moves in that step may be
/// listed at both places.
pub(super) fn around(
    map: &Map,
    vertex: &Vertex,
    legs: &[Leg],
    chains: &Chains,
    object: usize,
    step: usize,
) -> Vec<Neighbour> {
    let mut found = Vec::new();
    for (other, whereabouts) in vertex.objects.iter().enumerate() {
        if other == object {
            continue;
        }
        let mut of_other = legs.iter().filter(|leg| leg.object == other);
        if let Whereabouts::Resting { pose, .. } = whereabouts {
            let leaves = of_other.clone().next().map_or(usize::MAX, Leg::begins);
            if step <= leaves {
                found.push(Neighbour { object: ObjectId(other), node: vertex.mode[other], pose: *pose });
            }
        }
        let mut number = 0;
        while let Some(leg) = of_other.next() {
            let leaves = of_other.clone().next().map_or(usize::MAX, Leg::begins);
            if leg.ends() <= step && step <= leaves {
                let planned = chains.get(&other).and_then(|known| known.get(number));
                let pose = match planned {
                    Some(chain) => Some(chain.target.0),
                    None => match map.placements(other, leg.end).as_slice() {
                        [(pose, _)] => Some(*pose),
                        _ => None,
                    },
                };
                found.extend(pose.map(|pose| Neighbour { object: ObjectId(other), node: leg.end, pose }));
            }
            number += 1;
        }
    }
    found
}

/// The neighbours as a scene.
pub(super) fn scene_of(neighbours: &[Neighbour]) -> Scene {
    Scene { resting: neighbours.iter().map(|n| (n.object, n.pose)).collect() }
}

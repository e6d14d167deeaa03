//! An arm's rigid groups as a tree, with their frames and how far its motion can carry a body.

use nalgebra::{Matrix3, Rotation3, Unit};

use super::gap::Frame;
use crate::geometry::Vec3;
use crate::kinematics::{ArmModel, LinkMotion};
use crate::workcell::Arm;

/// How a group moves against the one before it.
#[derive(Debug, Clone)]
enum Drive {
    Fixed,
    Turn { axis: Unit<Vec3>, joint: usize, multiplier: f64, offset: f64 },
    Slide { axis: Unit<Vec3>, joint: usize, multiplier: f64, offset: f64 },
}

#[derive(Debug, Clone)]
struct Node {
    /// The URDF's rigid group.
    group: usize,
    parent: Option<usize>,
    /// The joint frame in the parent group's frame.
    origin: Frame,
    drive: Drive,
    /// The moving nodes from the root to this one, itself included.
    path: Vec<usize>,
}

/// An arm's rigid groups, parents before children.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    base: Frame,
    nodes: Vec<Node>,
    /// Per link: its node, and its frame in the node's frame.
    links: Vec<(usize, Frame)>,
    /// The node that carries the tool, and the TCP frame in it.
    mount: usize,
    tcp: Frame,
}

impl Chain {
    /// The tree of `arm`.
    pub(super) fn new(arm: &Arm) -> Self {
        let model: &ArmModel = &arm.model;
        let mut nodes: Vec<Node> = Vec::new();
        let mut links: Vec<(usize, Frame)> = Vec::with_capacity(model.links.len());
        for link in &model.links {
            let origin = Frame::of(&link.origin);
            let parent = link.parent.map(|parent| links[parent]);
            if let Some((node, frame)) = parent
                && nodes[node].group == link.group
            {
                links.push((node, frame.compose(&origin)));
                continue;
            }
            let drive = match &link.motion {
                LinkMotion::Held => Drive::Fixed,
                LinkMotion::Revolute { axis, joint, multiplier, offset } => {
                    Drive::Turn { axis: *axis, joint: *joint, multiplier: *multiplier, offset: *offset }
                }
                LinkMotion::Prismatic { axis, joint, multiplier, offset } => {
                    Drive::Slide { axis: *axis, joint: *joint, multiplier: *multiplier, offset: *offset }
                }
            };
            let mut path = parent.map(|(node, _)| nodes[node].path.clone()).unwrap_or_default();
            if !matches!(drive, Drive::Fixed) {
                path.push(nodes.len());
            }
            let origin = parent.map_or(origin, |(_, frame)| frame.compose(&origin));
            links.push((nodes.len(), Frame::identity()));
            nodes.push(Node { group: link.group, parent: parent.map(|(node, _)| node), origin, drive, path });
        }
        let (mount, mount_frame) = links[model.mount];
        let tcp = mount_frame.compose(&Frame::of(&arm.tool.tcp));
        Self { base: Frame::of(&arm.base), nodes, links, mount, tcp }
    }

    /// Number of nodes.
    pub(super) fn len(&self) -> usize {
        self.nodes.len()
    }

    /// The node of a link, and the link's frame in the node's frame.
    pub(super) fn link(&self, link: usize) -> (usize, Frame) {
        self.links[link]
    }

    /// The URDF's rigid group of a node.
    pub(super) fn group(&self, node: usize) -> usize {
        self.nodes[node].group
    }

    /// The node that carries the tool.
    pub(super) fn mount(&self) -> usize {
        self.mount
    }

    /// The TCP frame in the mount node's frame.
    pub(super) fn tcp(&self) -> &Frame {
        &self.tcp
    }

    /// Number of moving nodes on the way from the root to `node`.
    pub(super) fn depth(&self, node: usize) -> usize {
        self.nodes[node].path.len()
    }

    /// How many moving nodes the ways from the root to two nodes have in common.
    pub(super) fn common(&self, a: usize, b: usize) -> usize {
        let (a, b) = (&self.nodes[a].path, &self.nodes[b].path);
        a.iter().zip(b).take_while(|(x, y)| x == y).count()
    }

    /// The frames of all nodes in the world at `q`, written to `out`.
    pub(super) fn frames(&self, q: &[f64], out: &mut Vec<Frame>) {
        out.clear();
        for node in &self.nodes {
            let parent = node.parent.map_or(&self.base, |parent| &out[parent]);
            let mut frame = parent.compose(&node.origin);
            match &node.drive {
                Drive::Fixed => {}
                Drive::Turn { axis, joint, multiplier, offset } => {
                    turn(&mut frame.rotation, axis, multiplier * q[*joint] + offset);
                }
                Drive::Slide { axis, joint, multiplier, offset } => {
                    frame.position += frame.rotation * axis.as_ref() * (multiplier * q[*joint] + offset);
                }
            }
            out.push(frame);
        }
    }

    /// The TCP frame in the world for the node frames in `frames`.
    pub(super) fn tcp_frame(&self, frames: &[Frame]) -> Frame {
        frames[self.mount].compose(&self.tcp)
    }

    /// How far any point of a ball on `node` can get from where it is at the frames `frames`, when
    /// every joint leaves its value there by at most `excursions`. Entry `k` of `out` counts only
    /// the moving nodes from the `k`-th on the way from the root on: the bound on the motion
    /// relative to what the first `k` carry. The last entry is 0.
    ///
    /// Moving the joints one after the other, root first, turns the ball about axes whose distance
    /// from it is still that of `frames`; the ways add up.
    pub(super) fn motion_bounds(
        &self,
        node: usize,
        centre: &Vec3,
        radius: f64,
        frames: &[Frame],
        excursions: &[f64],
        out: &mut [f64],
    ) {
        let path = &self.nodes[node].path;
        let mut sum = 0.0;
        out[path.len()] = 0.0;
        for (index, &moving) in path.iter().enumerate().rev() {
            let frame = &frames[moving];
            sum += match &self.nodes[moving].drive {
                Drive::Fixed => 0.0,
                Drive::Slide { joint, multiplier, .. } => multiplier.abs() * excursions[*joint],
                Drive::Turn { axis, joint, multiplier, .. } => {
                    let angle = multiplier.abs() * excursions[*joint];
                    if angle > 0.0 {
                        let lever = (frame.rotation * axis.as_ref()).cross(&(centre - frame.position)).norm();
                        angle * (lever + radius)
                    } else {
                        0.0
                    }
                }
            };
            out[index] = sum;
        }
    }

    /// How far the TCP frame can turn (rad) when every joint moves by at most `excursions`.
    pub(super) fn turn_bound(&self, excursions: &[f64]) -> f64 {
        let turning = self.nodes[self.mount].path.iter().map(|&moving| match &self.nodes[moving].drive {
            Drive::Turn { joint, multiplier, .. } => multiplier.abs() * excursions[*joint],
            _ => 0.0,
        });
        turning.sum()
    }
}

/// Turns what `rotation` has turned already about `axis` in its own coordinates.
fn turn(rotation: &mut Matrix3<f64>, axis: &Unit<Vec3>, angle: f64) {
    // Mostly it is one of the coordinate axes, which leaves its column and mixes the other two.
    let is_own = |k: usize| axis[k].abs() == 1.0 && axis[(k + 1) % 3] == 0.0 && axis[(k + 2) % 3] == 0.0;
    let Some(own) = (0..3).find(|&k| is_own(k)) else {
        *rotation *= *Rotation3::from_axis_angle(axis, angle).matrix();
        return;
    };
    let (sine, cosine) = (angle * axis[own]).sin_cos();
    let (u, v) = ((own + 1) % 3, (own + 2) % 3);
    for row in 0..3 {
        let (x, y) = (rotation[(row, u)], rotation[(row, v)]);
        rotation[(row, u)] = x * cosine + y * sine;
        rotation[(row, v)] = y * cosine - x * sine;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_about_coordinate_axes_are_turns() {
        let oblique = Unit::new_normalize(Vec3::new(0.3, -0.5, 0.8));
        let before = *Rotation3::from_axis_angle(&oblique, 0.7).matrix();
        let slanted = Unit::new_normalize(Vec3::new(1.0, 1e-8, 0.0));
        let axes = [Vec3::x_axis(), Vec3::y_axis(), Vec3::z_axis(), oblique, slanted];
        for axis in axes.into_iter().flat_map(|axis| [axis, -axis]) {
            for angle in [-2.9, -0.4, 0.0, 1.1, 3.0] {
                let mut turned = before;
                turn(&mut turned, &axis, angle);
                let expected = before * Rotation3::from_axis_angle(&axis, angle).matrix();
                assert!((turned - expected).norm() < 1e-14, "{axis:?} {angle}");
            }
        }
    }
}

//! Instances of known make for tests and benchmarks: a grid of arms between two tables.

use super::instance::{ConflictSet, Edge, Goal, Instance, Node, NodeId, NodeKind, Object};
use crate::run::Rng;
use rand::Rng as _;
use rand::seq::SliceRandom as _;

/// A grid of arms, `depth` in the direction of transfer and `lanes` across it, neighbours (also
/// diagonal ones if asked) able to hand over to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Arms from one table to the other.
    pub depth: usize,
    /// Arms side by side.
    pub lanes: usize,
    /// Whether diagonal neighbours hand over, too.
    pub diagonals: bool,
}

impl Grid {
    fn arm(&self, i: usize, j: usize) -> NodeId {
        NodeId(i * self.lanes + j)
    }

    fn arms(&self) -> (Vec<Node>, Vec<Edge>) {
        let nodes = vec![Node { kind: NodeKind::Arm, capacity: 1 }; self.depth * self.lanes];
        let mut edges = Vec::new();
        let arms: Vec<(usize, usize)> =
            (0..self.depth).flat_map(|i| (0..self.lanes).map(move |j| (i, j))).collect();
        for &(i, j) in &arms {
            for &(k, l) in &arms {
                let (across, along) = (i.abs_diff(k), j.abs_diff(l));
                let near = across + along == 1 || (self.diagonals && across == 1 && along == 1);
                if near {
                    let weight = 1.1 * ((across * across + along * along) as f64).sqrt();
                    edges.push(Edge { from: self.arm(i, j), to: self.arm(k, l), weight, class: None });
                }
            }
        }
        (nodes, edges)
    }

    /// Two tables, each one region that every arm of its row reaches; `swapped` of the objects start
    /// on the far table, the others on the near one, and each must get to the other table.
    pub fn two_regions(&self, objects: usize, swapped: usize) -> Instance {
        let (mut nodes, mut edges) = self.arms();
        let near = NodeId(nodes.len());
        let far = NodeId(nodes.len() + 1);
        nodes.extend([Node { kind: NodeKind::Region, capacity: objects as u32 }; 2]);
        for j in 0..self.lanes {
            for (arm, table) in [(self.arm(0, j), near), (self.arm(self.depth - 1, j), far)] {
                both_ways(&mut edges, arm, table, 0.56);
            }
        }
        let objects = (0..objects)
            .map(|object| {
                let (start, goal) = if object < swapped { (far, near) } else { (near, far) };
                Object { start, goal: Goal::Nodes(vec![goal]), class: 0 }
            })
            .collect();
        Instance { nodes, edges, objects, ..Instance::default() }
    }

    /// Half of the objects on each table, to trade tables.
    pub fn switch(&self, objects: usize) -> Instance {
        self.two_regions(objects, objects / 2)
    }

    /// All objects from one table to the other.
    pub fn side_to_side(&self, objects: usize) -> Instance {
        self.two_regions(objects, 0)
    }

    /// As a planner refines it: every object has a start slot and a goal slot of its own, each in
    /// reach of the arm of its lane or of two neighbours; every lane has a small buffer region per
    /// table; some start and goal slots overlap. Each object starts on a random table and goes
    /// to the other.
    pub fn refined(&self, objects: usize, rng: &mut Rng) -> Instance {
        let (mut nodes, mut edges) = self.arms();
        let mut conflicts = Vec::new();
        let ends = [0, self.depth - 1];
        for &end in &ends {
            for j in 0..self.lanes {
                let buffer = NodeId(nodes.len());
                nodes.push(Node { kind: NodeKind::Region, capacity: 2 });
                both_ways(&mut edges, self.arm(end, j), buffer, 0.56);
                if j + 1 < self.lanes && rng.random_ratio(1, 2) {
                    both_ways(&mut edges, self.arm(end, j + 1), buffer, 0.79);
                }
            }
        }
        let slot = |rng: &mut Rng, nodes: &mut Vec<Node>, edges: &mut Vec<Edge>, end: usize| {
            let slot = NodeId(nodes.len());
            nodes.push(Node { kind: NodeKind::Slot, capacity: 1 });
            let lane = rng.random_range(0..self.lanes);
            both_ways(edges, self.arm(end, lane), slot, 0.5 + 0.1 * rng.random::<f64>());
            if lane + 1 < self.lanes && rng.random_ratio(1, 3) {
                both_ways(edges, self.arm(end, lane + 1), slot, 0.6 + 0.1 * rng.random::<f64>());
            }
            slot
        };
        let mut sides: Vec<usize> = (0..objects).map(|_| rng.random_range(0..2)).collect();
        sides.shuffle(rng);
        let mut travellers: Vec<Object> = Vec::new();
        for side in sides {
            let start = slot(rng, &mut nodes, &mut edges, ends[side]);
            let goal = slot(rng, &mut nodes, &mut edges, ends[1 - side]);
            travellers.push(Object { start, goal: Goal::Nodes(vec![goal]), class: 0 });
        }
        for one in 0..objects {
            for other in 0..objects {
                let (start, goal) = (travellers[one].start, &travellers[other].goal);
                if let Goal::Nodes(goal) = goal
                    && one != other
                    && rng.random_range(0..objects * 4) == 0
                {
                    conflicts.push(ConflictSet { nodes: vec![start, goal[0]], capacity: 1 });
                }
            }
        }
        Instance { nodes, edges, conflicts, objects: travellers, ..Instance::default() }
    }
}

/// A row of `arms` arms with `places` exact places and one buffer slot at each end of the row (one end
/// only if there is one arm); object `n` stands on place `n` and must get to the place of the next
/// object, the last to that of the first. Places alternate between the ends.
pub fn derangement(arms: usize, places: usize) -> Instance {
    let row = Grid { depth: arms, lanes: 1, diagonals: false };
    let (mut nodes, mut edges) = row.arms();
    let first = nodes.len();
    for place in 0..places {
        let slot = NodeId(nodes.len());
        nodes.push(Node { kind: NodeKind::Slot, capacity: 1 });
        let end = if place % 2 == 0 { 0 } else { arms - 1 };
        both_ways(&mut edges, NodeId(end), slot, 0.56);
    }
    let mut ends = vec![0, arms - 1];
    ends.dedup();
    for end in ends {
        let buffer = NodeId(nodes.len());
        nodes.push(Node { kind: NodeKind::Region, capacity: 1 });
        both_ways(&mut edges, NodeId(end), buffer, 0.56);
    }
    let objects = (0..places)
        .map(|place| Object {
            start: NodeId(first + place),
            goal: Goal::Nodes(vec![NodeId(first + (place + 1) % places)]),
            class: 0,
        })
        .collect();
    Instance { nodes, edges, objects, ..Instance::default() }
}

fn both_ways(edges: &mut Vec<Edge>, arm: NodeId, placement: NodeId, weight: f64) {
    edges.push(Edge { from: placement, to: arm, weight, class: None });
    edges.push(Edge { from: arm, to: placement, weight, class: None });
}

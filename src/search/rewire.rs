//! `rewire`: the best parent for a new vertex, and a better one for those that it leads to more cheaply.
//!
//! Vertices between which a parent may be exchanged have the same tau in all that matters to what comes
//! after: every object rests at the same pose or is held by the same arm in the same way. They differ in
//! where the arms are, and in how they came there.

use std::sync::Arc;

use crate::motion::StepTask;
use crate::run::Control;

use super::refine::pinned;
use super::select::cost_so_far;
use super::smart::Search;
use super::tree::{CostsAfter, Step, Vertex, Whereabouts};

/// Parents, and children, to which a motion is planned for one new vertex.
const MOST_TRIED: usize = 2;

/// Least gain (of the objective) for which a vertex gets another parent.
const LEAST_GAIN: f64 = 1e-6;

impl Search<'_> {
    /// Looks for a cheaper way to `new` by a vertex like its parent, and for cheaper ways by `new` to
    /// the children of vertices like it. A vertex at which all goals are met and that is reached more
    /// cheaply than the incumbent, if there is one now.
    pub(super) fn rewire(&mut self, new: usize, control: &Control) -> Option<usize> {
        self.adopt_parent(new, control);
        let end = self.adopt_children(new, control);
        if self.tree[new].is_goal { Some(new) } else { end }
    }

    fn cost(&self, vertex: usize) -> [f64; 2] {
        cost_so_far(&self.tree[vertex], self.problem.options.objective)
    }

    /// Whether the first costs plainly less than the second.
    fn is_cheaper(&self, one: usize, other: usize) -> bool {
        is_less(self.cost(one), self.cost(other))
    }

    fn adopt_parent(&mut self, new: usize, control: &Control) {
        let Some(parent) = self.tree[new].parent else { return };
        let mut others: Vec<usize> = (0..self.tree.len())
            .filter(|&i| i != parent && i != new && self.is_cheaper(i, new))
            .filter(|&i| alike(&self.tree[i], &self.tree[parent]))
            .collect();
        others.sort_by(|&a, &b| by_cost(self.cost(a), self.cost(b)).then(a.cmp(&b)));
        for other in others.into_iter().take(MOST_TRIED) {
            if control.should_stop() {
                return;
            }
            if let Some(found) = self.by_way_of(other, new, control) {
                self.tree[new] = found;
            }
        }
    }

    fn adopt_children(&mut self, new: usize, control: &Control) -> Option<usize> {
        let mut children: Vec<usize> = (0..self.tree.len())
            .filter(|&child| self.is_cheaper(new, child))
            .filter(|&child| {
                let parent = self.tree[child].parent;
                parent.is_some_and(|parent| parent != new && alike(&self.tree[parent], &self.tree[new]))
            })
            .collect();
        // The incumbent's way first, then what costs most now.
        let rank = |child: usize| (!self.best_way.contains(&child), self.cost(child));
        children.sort_by(|&a, &b| {
            let ((a_off, a_cost), (b_off, b_cost)) = (rank(a), rank(b));
            a_off.cmp(&b_off).then(by_cost(b_cost, a_cost)).then(a.cmp(&b))
        });
        for child in children.into_iter().take(MOST_TRIED) {
            if control.should_stop() {
                return None;
            }
            let Some(found) = self.by_way_of(new, child, control) else { continue };
            if let Some(place) = self.best_way.iter().position(|&vertex| vertex == child) {
                // The incumbent stays as it is; its rest is taken over as new vertices.
                let rest = self.best_way[place + 1..].to_vec();
                self.tree.push(found);
                let mut end = self.tree.len() - 1;
                for old in rest {
                    let mut vertex = self.tree[old].clone();
                    vertex.parent = Some(end);
                    vertex.set_costs(CostsAfter::new(&self.tree[end], vertex.step.as_deref()));
                    (vertex.expansions, vertex.failures) = (1, 0);
                    self.tree.push(vertex);
                    end = self.tree.len() - 1;
                }
                return Some(end);
            }
            self.tree[child] = found;
            self.update_below(child);
        }
        None
    }

    /// `child` as it would be with `parent` before it, where that is cheaper and a motion is found.
    fn by_way_of(&mut self, parent: usize, child: usize, control: &Control) -> Option<Vertex> {
        let step = self.tree[child].step.clone()?;
        let mut task: StepTask = step.task.clone();
        for (arm, from) in task.arms.iter_mut().zip(&self.tree[parent].arms) {
            arm.start = from.q.clone();
            arm.departure = from.departure.clone();
            arm.wait_for = from.wait_for;
            arm.dwell = from.dwell;
        }
        let motion = self.planner.plan(&pinned(&task, &step.motion, None), false, control).ok()?;
        let mut vertex = self.tree[child].clone();
        vertex.parent = Some(parent);
        vertex.step = Some(Arc::new(Step { actions: step.actions.clone(), motion, task }));
        vertex.set_costs(CostsAfter::new(&self.tree[parent], vertex.step.as_deref()));
        let cost = cost_so_far(&vertex, self.problem.options.objective);
        is_less(cost, self.cost(child)).then_some(vertex)
    }

    /// Carries the costs of `vertex` on to all that descend from it.
    fn update_below(&mut self, vertex: usize) {
        let mut changed = vec![vertex];
        while let Some(parent) = changed.pop() {
            for child in 0..self.tree.len() {
                if self.tree[child].parent == Some(parent) {
                    let costs = CostsAfter::new(&self.tree[parent], self.tree[child].step.as_deref());
                    self.tree[child].set_costs(costs);
                    changed.push(child);
                }
            }
        }
    }
}

/// In order of cost: what comes first counts first.
fn by_cost(a: [f64; 2], b: [f64; 2]) -> std::cmp::Ordering {
    a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]))
}

/// Whether the cost `a` is less than `b` by [`LEAST_GAIN`].
fn is_less(a: [f64; 2], b: [f64; 2]) -> bool {
    a[0] + LEAST_GAIN < b[0] || a[0] < b[0] + LEAST_GAIN && a[1] + LEAST_GAIN < b[1]
}

/// Whether all objects are where they are in the same way.
fn alike(a: &Vertex, b: &Vertex) -> bool {
    a.mode == b.mode
        && a.objects.iter().zip(&b.objects).all(|pair| match pair {
            (
                Whereabouts::Resting { pose, surface },
                Whereabouts::Resting { pose: other_pose, surface: other_surface },
            ) => surface == other_surface && pose == other_pose,
            (
                Whereabouts::Held { arm, object_in_tcp },
                Whereabouts::Held { arm: other_arm, object_in_tcp: other_hold },
            ) => arm == other_arm && object_in_tcp == other_hold,
            _ => false,
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_first_counts_first() {
        assert!(is_less([2.0, 9.0], [3.0, 1.0]) && !is_less([3.0, 1.0], [2.0, 9.0]));
        assert!(is_less([2.0, 1.0], [2.0, 1.1]) && !is_less([2.0, 1.0], [2.0, 1.0]));
        assert!(!is_less([2.0, 1.0], [2.0, 1.0 + LEAST_GAIN / 2.0]));
        assert!(by_cost([2.0, 9.0], [3.0, 1.0]).is_lt() && by_cost([2.0, 9.0], [2.0, 1.0]).is_gt());
    }
}

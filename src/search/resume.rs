//! Going on from a plan that is in hand already: its steps become the way of the incumbent, so that
//! windows of it are planned again and branches leave from it, as if it had been found here.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use crate::collision::Exemption;
use crate::geometry::{Pose, Vec3};
use crate::guidance::{Move, NodeId, check};
use crate::kinematics::Config;
use crate::motion::{ArmGoal, ArmMotion, ArmTask, Departure, StepMotion, StepTask, windows};
use crate::plan::{Action, ActionKind, Plan};
use crate::run::Control;
use crate::trajectory::{Curve, CurvePoint};
use crate::transition::Line;
use crate::workcell::{ArmId, SurfaceId};

use super::ground::{held_by, scene};
use super::map::Map;
use super::smart::Search;
use super::tree::{ArmState, Step, Vertex, Whereabouts};

/// Placements as near as this (m) are one.
const SAME_PLACE: f64 = 1e-3;

/// Times (s) and velocities (rad/s or m/s) below this are none.
const NOTHING: f64 = 1e-9;

/// Why a plan cannot be taken into the tree. It still bounds what is looked for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NotResumed {
    /// The plan has no actions, or its trajectories make no curves.
    #[error("it has no steps")]
    NoSteps,
    /// A step does not end at one instant at which all arms rest.
    #[error("step {0} does not end with all arms at rest")]
    Moving(usize),
    /// The straight way before or after an action is not one that the planner would go.
    #[error("the straight ways of step {0} cannot be followed again")]
    Line(usize),
    /// An object is put down where the mode graph has no place for it.
    #[error("step {0} puts an object down where the mode graph has no place")]
    Place(usize),
}

/// What the actions of a step ask of the arms, and leave behind.
struct Ends {
    goals: Vec<Option<ArmGoal>>,
    arms: Vec<ArmState>,
    objects: Vec<Whereabouts>,
    mode: Vec<NodeId>,
    moves: Vec<Move>,
}

/// The nodes that are still before each object.
type Ways = Vec<VecDeque<NodeId>>;

impl Search<'_> {
    /// Takes the steps of `plan`, which the judge has accepted for this problem, into the tree as the
    /// way of the incumbent.
    ///
    /// # Errors
    /// When the plan is not made of steps as the tree makes them; the tree is then as before.
    pub fn resume(&mut self, plan: &Plan, control: &Control) -> Result<(), NotResumed> {
        let curves: Option<Vec<Curve>> = plan.arms.iter().map(curve_of).collect();
        let curves = curves.ok_or(NotResumed::NoSteps)?;
        let steps = by_step(&plan.actions)?;
        let mut ways = self.ways(&plan.actions)?;
        let mut vertices = vec![self.tree[0].clone()];
        let mut moves = Vec::with_capacity(steps.len());
        let mut from = 0.0;
        for (index, actions) in steps.iter().enumerate() {
            let to = actions.first().map_or(from, |action| action.t);
            let parts: Option<Vec<Curve>> = curves.iter().map(|curve| part(curve, from, to)).collect();
            let parts = parts.ok_or(NotResumed::Moving(index + 1))?;
            let (vertex, moved) = self.step_of(&vertices[index], index + 1, actions, &mut ways, parts)?;
            moves.push(moved);
            vertices.push(vertex);
            from = to;
        }
        self.set_incumbent(plan.metrics.cost(self.problem.options.objective));
        self.enter(vertices, moves, control);
        Ok(())
    }

    /// The nodes that each object passes, action by action.
    fn ways(&self, actions: &[Action]) -> Result<Ways, NotResumed> {
        let start = &self.tree[0].mode;
        let way = |(object, &start): (usize, &NodeId)| {
            let own: Vec<&Action> = actions.iter().filter(|action| action.object.0 == object).collect();
            let mut layers = Vec::with_capacity(own.len());
            for (index, action) in own.iter().enumerate() {
                let layer = match action.kind {
                    ActionKind::Pick { arm, .. } | ActionKind::Handoff { to_arm: arm, .. } => {
                        arm_nodes(self.map, arm)
                    }
                    ActionKind::Place { object_pose, surface, .. } => {
                        nodes_at(self.map, object, (&object_pose, surface), index + 1 == own.len())
                    }
                };
                if layer.is_empty() {
                    return Err(NotResumed::Place(action.step));
                }
                layers.push(layer);
            }
            Ok(thread(self.map, object, start, &layers))
        };
        start.iter().enumerate().map(way).collect()
    }

    /// Puts the vertices after the first, which is the root, into the tree.
    fn enter(&mut self, vertices: Vec<Vertex>, steps: Vec<Vec<Move>>, control: &Control) {
        let network = self.network.clone();
        let solution = network.solution(self.tree[0].mode.clone(), steps);
        if check(network.instance(), &solution).is_ok() {
            self.memo.suggest(&solution);
        }
        self.best_way = vec![0];
        for mut vertex in vertices.into_iter().skip(1) {
            vertex.parent = self.best_way.last().copied();
            let is_goal = vertex.is_goal;
            self.tree.push(vertex);
            let new = self.tree.len() - 1;
            self.best_way.push(new);
            if !is_goal {
                self.guide(new, control);
            }
        }
        if let Some(&goal) = self.best_way.last() {
            self.tree[goal].is_goal = true;
        }
    }

    /// The vertex after one step, and the step on the mode graph.
    fn step_of(
        &self,
        before: &Vertex,
        number: usize,
        actions: &[Action],
        ways: &mut Ways,
        curves: Vec<Curve>,
    ) -> Result<(Vertex, Vec<Move>), NotResumed> {
        let count = curves.len();
        let rests = |curve: &Curve| ArmState {
            q: curve.last().q.clone(),
            departure: None,
            wait_for: None,
            dwell: 0.0,
        };
        let mut ends = Ends {
            goals: vec![None; count],
            arms: curves.iter().map(rests).collect(),
            objects: before.objects.clone(),
            mode: before.mode.clone(),
            moves: Vec::new(),
        };
        for action in actions {
            let way = ways.get_mut(action.object.0).and_then(VecDeque::pop_front);
            self.take(action, way.ok_or(NotResumed::Place(number))?, number, &mut ends)?;
        }
        let Ends { goals, arms, objects, mode, mut moves } = ends;
        moves.sort_unstable();
        let tasks: Vec<ArmTask> = before
            .arms
            .iter()
            .zip(goals)
            .zip(&curves)
            .enumerate()
            .map(|(index, ((arm, goal), curve))| ArmTask {
                start: arm.q.clone(),
                held: held_by(before, ArmId(index)),
                departure: arm.departure.clone(),
                wait_for: arm.wait_for,
                dwell: arm.dwell,
                goal: goal.unwrap_or_else(|| ArmGoal::Toward(curve.last().q.clone())),
            })
            .collect();
        let models = &self.problem.workcell.arms;
        let duration = curves.first().map_or(0.0, Curve::end_time);
        let arc = before.arc.iter().zip(&curves).map(|(sum, curve)| sum + curve.arc_length()).collect();
        let motions = curves.into_iter().zip(&tasks).zip(models).map(|((curve, task), arm)| ArmMotion {
            windows: windows(arm, task.departure.as_ref(), Some(&task.goal), &curve),
            held: task.held,
            curve,
        });
        let motion = StepMotion { arms: motions.collect(), duration };
        let task = StepTask { arms: tasks, scene: scene(before) };
        let actions = actions.iter().map(|action| (action.object, action.kind.clone())).collect();
        let is_goal = self.map.network().instance().is_solved(&mode);
        let vertex = Vertex {
            parent: None,
            step: Some(Arc::new(Step { actions, motion, task })),
            mode,
            objects,
            arms,
            elapsed: before.elapsed + duration,
            arc,
            depth: number,
            guide: None,
            fewest: None,
            guided_at: 0,
            penalty: 0.0,
            chains: BTreeMap::new(),
            expansions: 1,
            failures: 0,
            is_goal,
        };
        Ok((vertex, moves))
    }

    /// One action: the contacts with which the step ends, and how the arms leave them.
    fn take(&self, action: &Action, to: NodeId, number: usize, ends: &mut Ends) -> Result<(), NotResumed> {
        let object = action.object;
        let model = &self.problem.objects[object.0];
        let touching = Exemption { hand_with: Some(object), held_with: None };
        let line = |arm: ArmId, direction: Direction, distance: f64, arms: &[ArmState]| {
            let (own, q) = (&self.problem.workcell.arms[arm.0], &arms[arm.0].q);
            let direction = match direction {
                Direction::Backwards => -(own.tcp_pose(q).rotation * Vec3::z()),
                Direction::Off(surface) => self.problem.workcell.surfaces[surface.0].normal(),
            };
            Line::follow(own, q, &direction, distance).ok_or(NotResumed::Line(number))
        };
        let contact = |q: &Config, approach: Option<Line>, exemption: Exemption, after: Option<ArmId>| {
            Some(ArmGoal::Contact { q: q.clone(), approach, exemption, after })
        };
        let dwell = |arm: ArmId| self.problem.workcell.arms[arm.0].tool.grasp_time;
        match action.kind {
            ActionKind::Pick { arm, object_in_tcp, surface } => {
                let approach = line(arm, Direction::Backwards, model.approach, &ends.arms)?;
                let retreat = line(arm, Direction::Off(surface), model.retreat, &ends.arms)?;
                let state = &mut ends.arms[arm.0];
                ends.goals[arm.0] = contact(&state.q, Some(approach), touching, None);
                let carrier = self.problem.workcell.surfaces[surface.0].carrier;
                let exemption = Exemption { hand_with: Some(object), held_with: carrier };
                state.departure = Some(Departure { line: retreat, exemption });
                state.dwell = dwell(arm);
                ends.objects[object.0] = Whereabouts::Held { arm, object_in_tcp };
            }
            ActionKind::Place { arm, object_pose, surface, .. } => {
                let approach = line(arm, Direction::Off(surface), model.approach, &ends.arms)?;
                let retreat = line(arm, Direction::Backwards, model.retreat, &ends.arms)?;
                let state = &mut ends.arms[arm.0];
                let carrier = self.problem.workcell.surfaces[surface.0].carrier;
                let exemption = Exemption { hand_with: None, held_with: carrier };
                ends.goals[arm.0] = contact(&state.q, Some(approach), exemption, None);
                state.departure = Some(Departure { line: retreat, exemption: touching });
                state.dwell = dwell(arm);
                ends.objects[object.0] = Whereabouts::Resting { pose: object_pose, surface };
            }
            ActionKind::Handoff { arm, to_arm, to_object_in_tcp, .. } => {
                let approach = line(to_arm, Direction::Backwards, model.approach, &ends.arms)?;
                let retreat = line(arm, Direction::Backwards, model.retreat, &ends.arms)?;
                let both = dwell(arm).max(dwell(to_arm));
                let giver = &mut ends.arms[arm.0];
                ends.goals[arm.0] = contact(&giver.q, None, Exemption::default(), None);
                giver.departure = Some(Departure { line: retreat, exemption: touching });
                giver.dwell = both;
                let receiver = &mut ends.arms[to_arm.0];
                ends.goals[to_arm.0] = contact(&receiver.q, Some(approach), touching, Some(arm));
                receiver.wait_for = Some(arm);
                receiver.dwell = both;
                ends.objects[object.0] = Whereabouts::Held { arm: to_arm, object_in_tcp: to_object_in_tcp };
            }
        }
        ends.moves.push(Move { object: object.0, from: ends.mode[object.0], to });
        ends.mode[object.0] = to;
        Ok(())
    }
}

/// The nodes that stand for an arm.
fn arm_nodes(map: &Map, arm: ArmId) -> Vec<NodeId> {
    nodes(map).filter(|&node| map.arm(node) == Some(arm)).collect()
}

fn nodes(map: &Map) -> impl Iterator<Item = NodeId> {
    (0..map.network().instance().nodes.len()).map(NodeId)
}

/// The nodes where `object` stands at a pose on a surface: those of which a placement is the nearest;
/// of its goals alone where it is to stay.
fn nodes_at(map: &Map, object: usize, at: (&Pose, SurfaceId), stays: bool) -> Vec<NodeId> {
    let (pose, surface) = at;
    let instance = map.network().instance();
    let distance = |node: NodeId| {
        let all = map.placements(object, node);
        let here = all.iter().filter(|(_, on)| *on == surface);
        let away = here.map(|(place, _)| (place.translation.vector - pose.translation.vector).norm());
        away.fold(f64::INFINITY, f64::min)
    };
    let fits = nodes(map).filter(|&node| leads_to(map, object, None, node));
    let measured: Vec<(f64, NodeId)> = fits
        .filter(|&node| !stays || instance.meets_goal(object, node))
        .map(|node| (distance(node), node))
        .collect();
    let least = measured.iter().map(|(away, _)| *away).fold(f64::INFINITY, f64::min);
    let near = measured.into_iter().filter(|(away, _)| away.is_finite() && *away <= least + SAME_PLACE);
    near.map(|(_, node)| node).collect()
}

/// Whether there is an edge for `object` to `to`, from `from` or from anywhere.
fn leads_to(map: &Map, object: usize, from: Option<NodeId>, to: NodeId) -> bool {
    let instance = map.network().instance();
    let class = instance.objects.get(object).map(|object| object.class);
    instance.edges.iter().any(|edge| {
        edge.to == to
            && from.is_none_or(|from| edge.from == from)
            && edge.class.is_none_or(|only| class == Some(only))
    })
}

/// A way of `object` from `start` through one node of each layer, along edges where there are such.
fn thread(map: &Map, object: usize, start: NodeId, layers: &[Vec<NodeId>]) -> VecDeque<NodeId> {
    // Backwards: from which nodes the rest of the way can be gone.
    let mut open: Vec<Vec<NodeId>> = layers.to_vec();
    for index in (1..open.len()).rev() {
        let (before, after) = open.split_at_mut(index);
        let (Some(here), Some(next)) = (before.last_mut(), after.first()) else { break };
        let goes_on = |&node: &NodeId| next.iter().any(|&to| leads_to(map, object, Some(node), to));
        if here.iter().any(goes_on) {
            here.retain(goes_on);
        }
    }
    let mut at = start;
    let chosen = open.iter().filter_map(|layer| {
        let on = layer.iter().find(|&&node| leads_to(map, object, Some(at), node));
        at = *on.or_else(|| layer.first())?;
        Some(at)
    });
    chosen.collect()
}

/// Where a straight line leads from a contact.
#[derive(Clone, Copy)]
enum Direction {
    /// Back along the tool.
    Backwards,
    /// Away from a surface.
    Off(SurfaceId),
}

/// The actions of each step, which all happen at one time.
fn by_step(actions: &[Action]) -> Result<Vec<&[Action]>, NotResumed> {
    let steps: Vec<&[Action]> = actions.chunk_by(|a, b| a.step == b.step).collect();
    if steps.is_empty() {
        return Err(NotResumed::NoSteps);
    }
    let mut before = 0.0;
    for (index, step) in steps.iter().enumerate() {
        let t = step[0].t;
        let counted = step[0].step == index + 1;
        if !counted || t <= before || step.iter().any(|action| (action.t - t).abs() > NOTHING) {
            return Err(NotResumed::Moving(index + 1));
        }
        before = t;
    }
    Ok(steps)
}

fn curve_of(arm: &crate::plan::ArmTrajectory) -> Option<Curve> {
    let points = arm.points.iter().map(|point| CurvePoint {
        t: point.t,
        q: Config::from_slice(&point.q),
        qd: Config::from_slice(&point.qd),
    });
    Curve::new(points.collect()).ok()
}

/// The curve from `from` to `to` on a clock that starts with it; `None` when the arm does not rest at
/// both, or two points come too close to each other.
fn part(curve: &Curve, from: f64, to: f64) -> Option<Curve> {
    let rest_at = |t: f64| {
        let point = curve.points().iter().find(|point| (point.t - t).abs() <= NOTHING);
        let (q, qd) = point.map_or_else(|| curve.state_at(t), |point| (point.q.clone(), point.qd.clone()));
        let still = qd.iter().all(|v| v.abs() <= NOTHING);
        still.then(|| CurvePoint { t: t - from, qd: q.iter().map(|_| 0.0).collect(), q })
    };
    let within = curve.points().iter().filter(|point| point.t > from + NOTHING && point.t < to - NOTHING);
    let mut points = vec![rest_at(from)?];
    points.extend(within.map(|point| CurvePoint { t: point.t - from, ..point.clone() }));
    points.push(rest_at(to)?);
    Curve::new(points).ok().filter(Curve::is_spaced)
}

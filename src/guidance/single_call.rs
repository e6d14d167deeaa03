//! The paper's own formulation, for comparison: one binary flow per object on the time-expanded
//! graph, one call with the horizon `T` given, edge costs multiplied by their time.
//!
//! The paper takes `T = r * k`, which is too short for its own 2x2 switch (6 steps, `r * k` = 4); the
//! caller gives a horizon for which a plan is known to exist. Costs that grow with time prefer
//! short plans but do not make the number of steps minimal, so nothing is claimed about it.

use super::check::check;
use super::instance::{InstanceError, NodeId};
use super::network::{FAR, Network};
use super::solution::{Move, Solution};
use good_lp::{
    Expression, ProblemVariables, ResolutionError, Solution as _, SolverModel, Variable, constraint, variable,
};
use std::collections::BTreeMap;

/// Why the single call gave no plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SingleCallError {
    /// The state is none of the instance.
    #[error(transparent)]
    State(#[from] InstanceError),
    /// No plan of at most the given number of steps exists.
    #[error("no plan has {0} steps or fewer")]
    Infeasible(usize),
    /// The solver gave up or failed.
    #[error("the integer program was not solved: {0}")]
    Solver(String),
}

/// Solves `network` from `state` by one integer program with `horizon` steps, for at most
/// `time_limit_s` seconds. It cannot be interrupted.
///
/// # Errors
///
/// See [`SingleCallError`].
pub fn single_call(
    network: &Network,
    state: &[NodeId],
    horizon: usize,
    time_limit_s: f64,
) -> Result<Solution, SingleCallError> {
    network.instance().validate_state(state)?;
    let too_far = |(object, node): (usize, &NodeId)| usize::from(network.to_goal(object, node.0)) > horizon;
    if state.iter().enumerate().any(too_far) {
        return Err(SingleCallError::Infeasible(horizon));
    }
    let nodes = network.node_count();
    let mut variables = ProblemVariables::new();
    let mut cost = Expression::from(0.0);
    let mut flows: Vec<(usize, usize, NodeId, NodeId, Variable)> = Vec::new();
    let mut balance: BTreeMap<(usize, usize, usize), Expression> = BTreeMap::new();
    let width = network.capacities.len();
    let mut draws = vec![Expression::from(0.0); width * horizon];
    let mut enters = vec![Expression::from(0.0); width * horizon];
    let mut initial = vec![0_usize; width];
    for (object, &start) in state.iter().enumerate() {
        for &resource in network.resources.get(start.0) {
            initial[resource as usize] += 1;
        }
        let mut reached = vec![false; nodes];
        reached[start.0] = true;
        balance.insert((object, 0, start.0), Expression::from(-1.0));
        for step in 0..horizon {
            let mut next = vec![false; nodes];
            for (from, &reached) in reached.iter().enumerate() {
                let left = network.to_goal(object, from);
                if !reached || left == FAR || usize::from(left) > horizon - step {
                    continue;
                }
                let moves = network.graph(object).successors(from).iter().map(|&to| to as usize);
                for to in std::iter::once(from).chain(moves) {
                    if usize::from(network.to_goal(object, to)) > horizon - step - 1 {
                        continue;
                    }
                    let flow = variables.add(variable().binary());
                    next[to] = true;
                    *balance.entry((object, step, from)).or_default() += flow;
                    *balance.entry((object, step + 1, to)).or_default() -= flow;
                    for &resource in network.resources.get(from) {
                        draws[step * width + resource as usize] += flow;
                    }
                    if to != from {
                        cost += (step + 1) as f64 * network.weight_of(object, from, to) * flow;
                        let entered = network.resources.get(to).iter().copied();
                        for resource in entered.chain(network.crossing(network.kind_of[object], from, to)) {
                            draws[step * width + resource as usize] += flow;
                            enters[step * width + resource as usize] += flow;
                        }
                        flows.push((step, object, NodeId(from), NodeId(to), flow));
                    }
                }
            }
            reached = next;
        }
    }
    let gates: Vec<Variable> = (0..width * horizon).map(|_| variables.add(variable().binary())).collect();
    let mut model =
        variables.minimise(cost).using(good_lp::highs).set_threads(1).set_time_limit(time_limit_s);
    model.set_verbose(false);
    for ((_, time, _), terms) in balance {
        if time < horizon {
            model = model.with(constraint!(terms == 0));
        }
    }
    for (cell, (drawn, entered)) in draws.into_iter().zip(enters).enumerate() {
        let capacity = f64::from(network.capacities[cell % width]);
        if initial[cell % width] as f64 > capacity {
            let excess = state.len() as f64;
            model = model.with(constraint!(entered <= excess * gates[cell]));
            model = model.with(constraint!(drawn + excess * gates[cell] <= capacity + excess));
        } else {
            model = model.with(constraint!(drawn <= capacity));
        }
    }
    let solved = model.solve().map_err(|error| match error {
        ResolutionError::Infeasible => SingleCallError::Infeasible(horizon),
        other => SingleCallError::Solver(other.to_string()),
    })?;
    let mut steps = vec![Vec::new(); horizon];
    for (step, object, from, to, flow) in flows {
        if solved.value(flow) > 0.5 {
            steps[step].push(Move { object, from, to });
        }
    }
    steps.retain(|moves: &Vec<Move>| !moves.is_empty());
    for moves in &mut steps {
        moves.sort_unstable();
    }
    let weight = network.weight_of_steps(&steps);
    let solution = Solution { start: state.to_vec(), steps, weight };
    // A time limit may leave half a solution behind.
    check(network.instance(), &solution).map_err(|fault| SingleCallError::Solver(fault.to_string()))?;
    Ok(solution)
}

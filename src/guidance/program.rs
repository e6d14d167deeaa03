//! The time-expanded integer program: is there a plan of a given number of steps? Objects that may
//! stand for one another are one commodity; the flows found are taken apart into routes afterwards.
//!
//! For each commodity, node and step there is a flow that stays, for each edge and step one that
//! moves, as far as distances from the starts and to the goals allow. Flow is conserved at every
//! node and time; what draws on a limited resource in a step keeps within its capacity. After Yu and
//! LaValle (2016), with vertex capacities (Surynek 2019).

use super::bounds::Reach;
use super::interruptible::{Limits, solve};
use super::network::{FAR, Network};
use super::timetable::Route;
use crate::run::Part;
use highs::{Col, HighsModelStatus, RowProblem, Sense};
use std::collections::BTreeMap;

/// Which objects make one commodity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Commodities {
    /// Objects of one kind: exact.
    Kinds,
    /// Also objects whose goal slots have the same neighbours: a relaxation where slots conflict, since
    /// they may end on each other's goals.
    Twins,
}

/// What the program came to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Outcome {
    /// Routes of all objects; with [`Commodities::Twins`] they may conflict.
    Routes(Vec<Route>),
    /// No plan has so few steps.
    Infeasible,
    /// The flows found do not come apart into routes of the objects.
    Unclear,
    /// A limit came first, or the program is too large to be worth it.
    Limit,
}

/// Programs with more columns than this are not tried.
const MOST_COLUMNS: usize = 400_000;

/// HiGHS' code for a feasible primal solution.
const FEASIBLE: i64 = 2;

/// Largest slack that still counts as an integer.
const HALF: f64 = 0.5;

struct Commodity {
    objects: Vec<usize>,
    graph: usize,
    /// `usize::MAX` where the objects are of several kinds.
    kind: usize,
    is_goal: Vec<bool>,
    from_start: Vec<u16>,
    to_goal: Vec<u16>,
    supply: BTreeMap<u16, usize>,
}

/// Decides whether a plan of `horizon` steps exists.
pub(super) fn decide(
    network: &Network,
    start: &[u16],
    reach: &Reach,
    horizon: usize,
    merge: Commodities,
    limits: &Limits<'_>,
) -> Outcome {
    let too_far = |(object, &node): (usize, &u16)| network.to_goal(object, node as usize) as usize > horizon;
    if start.iter().enumerate().any(too_far) {
        return Outcome::Infeasible;
    }
    let commodities = commodities(network, start, reach, merge);
    let Some(program) = Program::build(network, start, &commodities, horizon) else {
        return Outcome::Limit;
    };
    let Ok(mut model) = program.problem.try_optimise(Sense::Minimise) else {
        return Outcome::Limit;
    };
    // Any plan will do: the first one found ends the search.
    if model.try_set_option("mip_max_improving_sols", 1).is_err() {
        return Outcome::Limit;
    }
    let solved = limits.control.spent.during(Part::IntegerProgram, || solve(model, limits));
    let Ok(solved) = solved else {
        return Outcome::Limit;
    };
    match solved.status() {
        HighsModelStatus::Infeasible => Outcome::Infeasible,
        // The crate's own accessor panics where HiGHS has no solution status.
        _ if solved.int_info_value(c"primal_solution_status") == Ok(FEASIBLE) => {
            let solution = solved.get_solution();
            match decompose(network, start, &commodities, &program.flows, horizon, solution.columns()) {
                Some(routes) => Outcome::Routes(routes),
                None => Outcome::Unclear,
            }
        }
        _ => Outcome::Limit,
    }
}

fn commodities(network: &Network, start: &[u16], reach: &Reach, merge: Commodities) -> Vec<Commodity> {
    let count = network.node_count();
    let mut groups: BTreeMap<_, Vec<usize>> = BTreeMap::new();
    for (object, &kind_index) in network.kind_of.iter().enumerate() {
        let kind = &network.kinds[kind_index];
        let key = match (merge, kind.goals.as_slice()) {
            (Commodities::Twins, &[goal]) => {
                let graph = &network.graphs[kind.graph];
                let (goal, none) = (goal as usize, usize::MAX);
                (kind.graph, graph.predecessors(goal).to_vec(), graph.successors(goal).to_vec(), none)
            }
            _ => (kind.graph, Vec::new(), Vec::new(), kind_index),
        };
        groups.entry(key).or_default().push(object);
    }
    groups
        .into_values()
        .map(|objects| {
            let mut commodity = Commodity {
                graph: network.kind(objects[0]).graph,
                kind: match objects.iter().all(|&o| network.kind_of[o] == network.kind_of[objects[0]]) {
                    true => network.kind_of[objects[0]],
                    false => usize::MAX,
                },
                is_goal: vec![false; count],
                from_start: vec![FAR; count],
                to_goal: vec![FAR; count],
                supply: BTreeMap::new(),
                objects,
            };
            for &object in &commodity.objects {
                let kind = network.kind(object);
                *commodity.supply.entry(start[object]).or_default() += 1;
                for node in 0..count {
                    commodity.is_goal[node] |= kind.is_goal[node];
                    commodity.from_start[node] =
                        commodity.from_start[node].min(reach.from_start[object][node]);
                    commodity.to_goal[node] = commodity.to_goal[node].min(kind.to_goal[node]);
                }
            }
            commodity
        })
        .collect()
}

/// A column: the flow of one commodity from a node to a node (the same one if it stays) in a step.
#[derive(Debug, Clone, Copy)]
struct Flow {
    commodity: usize,
    step: usize,
    from: u16,
    to: u16,
}

struct Program {
    problem: RowProblem,
    /// What each column stands for; columns beyond are none of them.
    flows: Vec<Flow>,
}

impl Program {
    fn build(network: &Network, start: &[u16], commodities: &[Commodity], horizon: usize) -> Option<Self> {
        let mut problem = RowProblem::default();
        let mut flows = Vec::new();
        let width = network.capacities.len();
        let mut initial = vec![0_usize; width];
        for &node in start {
            for &resource in network.resources.get(node as usize) {
                initial[resource as usize] += 1;
            }
        }
        let mut draws: Vec<Vec<(Col, f64)>> = vec![Vec::new(); width * horizon];
        let mut enters: Vec<Vec<(Col, f64)>> = vec![Vec::new(); width * horizon];
        for (index, commodity) in commodities.iter().enumerate() {
            let graph = &network.graphs[commodity.graph];
            let size = commodity.objects.len() as f64;
            let open = |node: u16, time: usize| {
                usize::from(commodity.from_start[node as usize]) <= time
                    && usize::from(commodity.to_goal[node as usize]) <= horizon - time
            };
            let mut balance: BTreeMap<(usize, u16), Vec<(Col, f64)>> = BTreeMap::new();
            for step in 0..horizon {
                for node in 0..network.node_count() as u16 {
                    if !open(node, step) {
                        continue;
                    }
                    let stays = std::iter::once(node).filter(|&node| open(node, step + 1));
                    let moves = graph.successors(node as usize).iter().copied();
                    for to in stays.chain(moves.filter(|&to| open(to, step + 1))) {
                        let column = if to == node {
                            problem.add_column(0.0, 0.0..=size)
                        } else {
                            problem.add_integer_column(0.0, 0.0..=1.0)
                        };
                        flows.push(Flow { commodity: index, step, from: node, to });
                        balance.entry((step, node)).or_default().push((column, 1.0));
                        balance.entry((step + 1, to)).or_default().push((column, -1.0));
                        for &resource in network.resources.get(node as usize) {
                            draws[step * width + resource as usize].push((column, 1.0));
                        }
                        if to != node {
                            let entered = network.resources.get(to as usize).iter().copied();
                            for resource in
                                entered.chain(network.crossing(commodity.kind, node as usize, to as usize))
                            {
                                draws[step * width + resource as usize].push((column, 1.0));
                                enters[step * width + resource as usize].push((column, 1.0));
                            }
                        }
                    }
                }
                if flows.len() > MOST_COLUMNS {
                    return None;
                }
            }
            for (&node, &supply) in &commodity.supply {
                if !open(node, 0) && supply > 0 {
                    // Cut off already at the start: an empty row that cannot hold says so.
                    balance.entry((0, node)).or_default();
                }
            }
            for ((time, node), terms) in balance {
                if time == horizon {
                    continue;
                }
                let supply = match time {
                    0 => commodity.supply.get(&node).copied().unwrap_or(0) as f64,
                    _ => 0.0,
                };
                problem.add_row(supply..=supply, terms);
            }
        }
        for step in 0..horizon {
            for (resource, &initial) in initial.iter().enumerate() {
                let cell = step * width + resource;
                let capacity = f64::from(network.capacities[resource]);
                if enters[cell].is_empty() {
                    continue;
                }
                let mut terms = std::mem::take(&mut draws[cell]);
                if initial as f64 > capacity {
                    // Fuller than its capacity at the start: the capacity holds once something enters.
                    let entered = problem.add_integer_column(0.0, 0.0..=1.0);
                    let excess = network.object_count() as f64;
                    let mut gate = std::mem::take(&mut enters[cell]);
                    gate.push((entered, -excess));
                    problem.add_row(..=0.0, gate);
                    terms.push((entered, excess));
                    problem.add_row(..=capacity + excess, terms);
                } else {
                    problem.add_row(..=capacity, terms);
                }
            }
        }
        Some(Self { problem, flows })
    }
}

/// Takes flows apart into one route per object. `None` if they are no integer flows, or if an object
/// rests from first to last on a goal that is not its own.
fn decompose(
    network: &Network,
    start: &[u16],
    commodities: &[Commodity],
    flows: &[Flow],
    horizon: usize,
    values: &[f64],
) -> Option<Vec<Route>> {
    let mut moves: BTreeMap<(usize, usize, u16), Vec<u16>> = BTreeMap::new();
    for (flow, &value) in flows.iter().zip(values) {
        if flow.from != flow.to && value > HALF {
            moves.entry((flow.commodity, flow.step, flow.from)).or_default().push(flow.to);
        }
    }
    let mut routes: Vec<Route> = start.iter().map(|&node| vec![node]).collect();
    for (index, commodity) in commodities.iter().enumerate() {
        for step in 0..horizon {
            for &object in &commodity.objects {
                let node = routes[object][step];
                let next = moves.get_mut(&(index, step, node)).and_then(Vec::pop).unwrap_or(node);
                routes[object].push(next);
            }
        }
        // Objects that ended on each other's goals trade their last placement.
        for &object in &commodity.objects {
            let kind = network.kind(object);
            let end = routes[object][horizon];
            if !kind.is_goal[end as usize] {
                let goal = *kind.goals.first()?;
                let route = &mut routes[object];
                let arrival = route.iter().rposition(|&node| node != end)? + 1;
                route[arrival..].fill(goal);
            }
        }
    }
    if moves.values().any(|left| !left.is_empty()) {
        return None;
    }
    Some(routes)
}

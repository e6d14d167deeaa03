//! A planner that does what the problem's name says, and problems for it.

use std::time::Duration;

use quadrille::plan::{ArmTrajectory, Metrics, Plan, StepsProof, TrajectoryPoint};
use quadrille::planner::{Outcome, PlannerEvent, Termination};
use quadrille::problem::Problem;
use quadrille::run::Control;
use serde_json::{Value, json};

/// How often the scripted planner looks whether it shall stop.
const POLL: Duration = Duration::from_millis(2);

/// The switch of two arms, called `name`.
pub fn problem(name: &str) -> Value {
    let text = quadrille::scenario::find("switch/2x2").expect("it ships").text;
    let mut document: Value = serde_json::from_str(text).expect("it is JSON");
    document["name"] = json!(name);
    document
}

/// Names and what they make the planner do:
/// - `improve N`: N ever shorter plans, then the end of the budget;
/// - `wait`: a plan, then signs of life until it is cancelled or the budget ends;
/// - `first`, `optimal`, `infeasible`, `nothing`: the ending of that kind;
/// - `steps N MS`: N ever shorter plans, MS milliseconds apart, then the end of the budget;
/// - `panic`: a plan, then a panic;
/// - `abort`: a plan, then the end of the whole process.
pub fn plan(
    problem: &Problem,
    control: &Control,
    observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
) -> Outcome {
    let mut words = problem.name.split(' ');
    let mut best = None;
    let mut improve = |revision: u64, observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send)| {
        let plan = still_plan(problem, revision);
        observe(PlannerEvent::Incumbent(&plan));
        best = Some(plan);
    };
    let mut diagnosis = None;
    let termination = match words.next() {
        Some("improve") => {
            let count = words.next().and_then(|word| word.parse().ok()).unwrap_or(1);
            (1..=count).for_each(|revision| improve(revision, observe));
            Termination::TimeLimit
        }
        Some("steps") => {
            let mut number = || words.next().and_then(|word| word.parse().ok()).unwrap_or(1);
            let (count, pause) = (number(), Duration::from_millis(number()));
            for revision in 1..=count {
                if control.should_stop() {
                    break;
                }
                std::thread::sleep(pause);
                improve(revision, observe);
            }
            if control.cancel.is_cancelled() { Termination::Cancelled } else { Termination::TimeLimit }
        }
        Some("abort") => {
            improve(1, observe);
            std::process::abort();
        }
        Some("wait") => {
            improve(1, observe);
            let mut iterations = 0;
            while !control.should_stop() {
                iterations += 1;
                observe(PlannerEvent::Progress {
                    elapsed_s: control.deadline.elapsed_s(),
                    phase: "improve",
                    iterations,
                    steps_lower_bound: Some(6),
                });
                std::thread::sleep(POLL);
            }
            if control.cancel.is_cancelled() { Termination::Cancelled } else { Termination::TimeLimit }
        }
        Some("first") => {
            improve(1, observe);
            Termination::FirstSolution
        }
        Some("optimal") => {
            improve(1, observe);
            Termination::Optimal
        }
        Some("infeasible") => {
            diagnosis = Some("red cannot be handed over".to_owned());
            Termination::Infeasible
        }
        Some("nothing") => {
            diagnosis = Some("no way round the post was found".to_owned());
            Termination::NoSolutionFound
        }
        Some("panic") => {
            improve(1, observe);
            panic!("as the script says");
        }
        other => panic!("the script does not know {other:?}"),
    };
    Outcome { termination, best, diagnosis }
}

/// A plan in which nothing moves.
fn still_plan(problem: &Problem, revision: u64) -> Plan {
    let duration_s = 20.0 - 0.01 * revision as f64;
    let arms = problem
        .initial_joints
        .iter()
        .map(|joints| {
            let q: Vec<f64> = joints.iter().copied().collect();
            let still = vec![0.0; q.len()];
            let at = |t| TrajectoryPoint { t, q: q.clone(), qd: still.clone(), qdd: still.clone() };
            ArmTrajectory { points: vec![at(0.0), at(duration_s)] }
        })
        .collect();
    Plan {
        problem_digest: problem.digest.clone(),
        revision,
        metrics: Metrics {
            duration_s,
            duration_synchronous_s: duration_s,
            arc_length: 0.0,
            actions: 0,
            steps: 6,
            mode_graph_optimum: Some(6),
            steps_lower_bound: 6,
            steps_proof: StepsProof::Bounds,
            found_after_s: 0.001 * revision as f64,
        },
        arms,
        actions: Vec::new(),
        verification: None,
    }
}

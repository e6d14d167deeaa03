use quadrille::*;
use std::time::Duration;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let (family, arms, objects, seed, budget) = (
        &args[1],
        args[2].parse().unwrap(),
        args[3].parse().unwrap(),
        args[4].parse::<u64>().unwrap(),
        args[5].parse::<f64>().unwrap(),
    );
    tracing_subscriber::fmt().with_writer(std::io::stderr).init();
    let mut doc = scenario::generate(family.parse().unwrap(), arms, objects, seed).unwrap();
    doc["options"] = serde_json::json!({"seed": seed, "time_budget_s": budget, "stop": {"first_solution": std::env::var("FIRST").is_ok()}});
    let bytes = serde_json::to_vec(&doc).unwrap();
    let t = std::time::Instant::now();
    let read = wire::read_problem(&bytes, &wire::LibraryOnly, &wire::ReadLimits::default())
        .map_err(|f| {
            for x in &f {
                eprintln!("{x:?}")
            }
        })
        .unwrap();
    eprintln!("read in {:?}", t.elapsed());
    let control = run::Control::with_budget(Duration::from_secs_f64(budget));
    let mut iters = 0;
    let out = planner::plan(&read.problem, &control, &mut |e| match e {
        planner::PlannerEvent::Incumbent(p) => eprintln!(
            "seed {seed} found {:.3} steps {}/{:?} lb {} duration {:.2} arc {:.2} clear {:?}",
            p.metrics.found_after_s,
            p.metrics.steps,
            p.metrics.mode_graph_optimum,
            p.metrics.steps_lower_bound,
            p.metrics.duration_s,
            p.metrics.arc_length,
            p.verification.as_ref().unwrap().min_clearance_m
        ),
        planner::PlannerEvent::Progress { iterations, phase, elapsed_s, .. } => {
            if args.len() > 6 {
                eprintln!("  {elapsed_s:.2} {phase} {iterations}");
            }
            iters = iterations;
        }
    });
    println!(
        "seed {seed} {:?} {:?} iterations {iters} duration {:?}",
        out.termination,
        out.diagnosis,
        out.best.map(|b| b.metrics.duration_s)
    );
}

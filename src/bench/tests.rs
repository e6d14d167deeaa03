//! Documents and comparisons of made-up results, and one real run.

use std::collections::BTreeSet;
use std::time::Duration;

use proptest::prelude::*;
use serde_json::Value;

use super::*;
use crate::problem::GuidanceKind;
use crate::run::CancelToken;
use crate::scenario::Family;

/// The fields of a run, which readers of `results.json` rely on.
const FIELDS: [&str; 18] = [
    "family",
    "size",
    "guidance",
    "trial",
    "solved",
    "candidate_s",
    "first_plan_s",
    "steps",
    "mode_graph_optimum",
    "steps_lower_bound",
    "actions",
    "duration_first_s",
    "duration_s",
    "duration_lower_bound_s",
    "arc_length",
    "peak_rss_mb",
    "incumbents",
    "phases",
];

fn solved(family: &str, size: &str, guidance: &str, trial: u64, first_s: f64, duration: f64) -> Run {
    Run {
        family: family.to_owned(),
        size: size.to_owned(),
        guidance: guidance.to_owned(),
        trial,
        solved: true,
        candidate_s: Some(0.8 * first_s),
        first_plan_s: Some(first_s),
        steps: Some(6),
        mode_graph_optimum: Some(6),
        steps_lower_bound: Some(5),
        actions: Some(6),
        duration_first_s: Some(1.2 * duration),
        duration_s: Some(duration),
        duration_lower_bound_s: Some(0.75 * duration),
        arc_length: Some(20.5),
        peak_rss_mb: Some(100.0),
        incumbents: vec![(first_s, 1.2 * duration), (first_s + 1.0, duration)],
        phases: Phases::from_values([
            Some(0.001),
            Some(0.02),
            Some(0.03),
            None,
            Some(0.1),
            Some(0.02),
            Some(0.05),
        ]),
    }
}

fn unsolved(family: &str, size: &str, guidance: &str, trial: u64) -> Run {
    Run {
        solved: false,
        candidate_s: None,
        first_plan_s: None,
        steps: None,
        mode_graph_optimum: None,
        actions: None,
        duration_first_s: None,
        duration_s: None,
        duration_lower_bound_s: None,
        arc_length: None,
        incumbents: Vec::new(),
        ..solved(family, size, guidance, trial, 1.0, 1.0)
    }
}

fn results(runs: Vec<Run>) -> Results {
    Results {
        schema: Results::SCHEMA.to_owned(),
        machine: Machine {
            processor: "Some <CPU>".to_owned(),
            cores: 2,
            memory_gb: Some(8.0),
            system: "linux x86_64".to_owned(),
            version: "0.1.0".to_owned(),
            peak_rss_per_run: true,
        },
        conditions: Conditions::default(),
        setup: Setup {
            trials: 12,
            budget_s: 30.0,
            threads: 1,
            workcell: WorkcellAge::New,
            first_solution: false,
        },
        runs,
        remarks: Vec::new(),
    }
}

/// Something that scatters from trial to trial, but is the same every time.
fn scatter(trial: u64) -> f64 {
    1.0 + 0.3 * (7.3 * trial as f64).sin()
}

fn made_up(speed: f64) -> Results {
    let mut runs = Vec::new();
    for trial in 0..12 {
        let noise = 1.0 + 0.05 * (3.1 * trial as f64 * speed).cos();
        runs.push(solved("switch", "2x2", "smart", trial, speed * scatter(trial), 11.0 * noise));
        runs.push(unsolved("switch", "2x2", "greedy", trial));
        runs.push(solved("random", "9x4", "smart", trial, 0.5 * scatter(trial), 14.0));
    }
    let mut results = results(runs);
    results.remarks.push(Remark {
        family: "switch".to_owned(),
        size: "2x2".to_owned(),
        guidance: "greedy".to_owned(),
        trial: 3,
        rejected: 1,
        cause: Some("all stand & wait".to_owned()),
    });
    results
}

#[test]
fn the_document_has_the_agreed_fields() {
    let results = made_up(1.0);
    let document: Value = serde_json::from_str(&results.to_json().unwrap()).unwrap();
    let names = |value: &Value| -> BTreeSet<String> { value.as_object().unwrap().keys().cloned().collect() };
    for run in document["runs"].as_array().unwrap() {
        assert_eq!(names(run), FIELDS.iter().map(|name| (*name).to_owned()).collect());
    }
    assert_eq!(document["runs"][0]["incumbents"][0][1], 1.2 * (11.0 * 1.05));
    assert_eq!(document["runs"][1]["duration_s"], Value::Null);
    assert_eq!(document["machine"]["processor"], "Some <CPU>");
    let again: Results = serde_json::from_value(document).unwrap();
    assert_eq!(again, results);
}

proptest! {
    #[test]
    fn tables_read_back_as_the_same_runs(
        times in prop::collection::vec((any::<f64>(), 0.0..1e9_f64), 0..5),
        values in prop::array::uniform7(prop::option::of(-1e12..1e12_f64)),
        steps in prop::option::of(any::<usize>()), is_solved: bool, trial: u64,
    ) {
        let finite = times.into_iter().filter(|(t, _)| t.is_finite()).collect();
        let run = Run {
            solved: is_solved,
            steps,
            arc_length: values[0],
            peak_rss_mb: values[1],
            duration_s: values[2],
            incumbents: finite,
            phases: Phases::from_values(values),
            ..solved("side_to_side", "16x50", "sequential", trial, 0.1, 2.0)
        };
        let runs = vec![run, unsolved("switch", "2x2", "greedy", 0)];
        prop_assert_eq!(from_csv(&to_csv(&runs)), Ok(runs));
    }
}

#[test]
fn broken_tables_are_refused_with_the_line() {
    let table = to_csv(&[solved("switch", "2x2", "smart", 0, 0.1, 2.0)]);
    assert_eq!(from_csv(""), Err(CsvError::Columns));
    assert_eq!(from_csv(&table.replace("trial", "trail")), Err(CsvError::Columns));
    assert_eq!(from_csv(&format!("{table}a,b\n")), Err(CsvError::Fields { line: 3, fields: 2 }));
    let wrong = from_csv(&table.replace(",true,", ",perhaps,"));
    assert_eq!(wrong, Err(CsvError::Value { line: 2, column: "solved", value: "perhaps".to_owned() }));
}

#[test]
fn a_real_difference_stands_out_and_noise_does_not() {
    let (a, mut b) = (made_up(1.0), made_up(0.5));
    // In B greedy solves it always, and one group scatters without a direction.
    for run in &mut b.runs {
        if run.guidance == "greedy" {
            *run = solved(&run.family, &run.size, "greedy", run.trial, 1.0, 11.0);
        }
        if run.family == "random" {
            let wobble = if run.trial % 2 == 0 { 1.1 } else { 1.0 / 1.1 };
            run.first_plan_s = run.first_plan_s.map(|s| s * wobble);
        }
    }
    let comparison = compare(&a, &b);
    let group = |family: &str, guidance: &str| {
        comparison.groups.iter().find(|group| group.family == family && group.guidance == guidance).unwrap()
    };
    let of = |group: &Group, measure: Measure| {
        group.differences.iter().find(|difference| difference.measure == measure).cloned().unwrap()
    };
    let first = of(group("switch", "smart"), Measure::FirstPlan);
    assert!((first.ratio - 0.5).abs() < 1e-12 && first.beyond_noise && first.better);
    assert_eq!(first.pairs, 12);
    let steps = of(group("switch", "smart"), Measure::Steps);
    assert!(steps.ratio == 1.0 && !steps.beyond_noise && steps.p == 1.0);
    assert!(!of(group("random", "smart"), Measure::FirstPlan).beyond_noise);
    let greedy = group("switch", "greedy");
    assert_eq!(greedy.success.solved, [0, 12]);
    assert!(greedy.success.beyond_noise);
    // No trial is solved in both, so there is nothing to compare but success.
    assert!(greedy.differences.is_empty());
    let text = comparison.to_string();
    assert!(text.contains("switch/2x2 smart") && text.contains("0.500  better"), "{text}");
    assert!(comparison.caveats.is_empty());
}

#[test]
fn results_that_are_not_alike_are_called_so() {
    let (a, mut b) = (made_up(1.0), made_up(1.0));
    assert!(compare(&a, &b).groups.iter().all(|group| {
        group.differences.iter().all(|d| d.ratio == 1.0 && !d.beyond_noise) && !group.success.beyond_noise
    }));
    b.machine.processor = "Another".to_owned();
    b.setup.workcell = WorkcellAge::Known;
    b.conditions.waited_share = Some(0.25);
    let caveats = compare(&a, &b).caveats.join("\n");
    for said in ["A Some <CPU>, B Another", "A new, B known", "B waited 25 %"] {
        assert!(caveats.contains(said), "{caveats}");
    }
    b.runs.clear();
    assert!(compare(&a, &b).to_string().contains("nothing was run in both"));
}

#[test]
fn the_page_holds_everything_itself() {
    let page = to_html(&made_up(1.0));
    for outside in ["http://", "https://", "<script", "<link", "src=", "@import", "url("] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.contains("Some &lt;CPU&gt;") && !page.contains("Some <CPU>"));
    assert!(page.contains("all stand &amp; wait"));
    assert!(!page.contains("NaN") && !page.contains("inf"), "numbers that cannot be drawn");
    // Four charts and an anytime curve for each of two families with one size.
    assert_eq!(page.matches("<svg").count(), 10);
    let document = page.strip_prefix("<!doctype html>\n").unwrap();
    let xml = document.replace("<br>", "<br/>").replace("<meta charset=\"utf-8\">", "");
    let xml: String = xml.lines().filter(|line| !line.starts_with("<meta")).collect::<Vec<_>>().join("\n");
    roxmltree::Document::parse(&xml).expect("every element is closed");
    assert!(to_html(&results(Vec::new())).contains("0 runs"));
}

#[test]
fn a_run_is_measured() {
    let case = Case { family: Family::Switch, size: "2x2".parse().unwrap() };
    let settings = RunSettings {
        budget: Duration::from_secs(120),
        threads: 1,
        workcell: WorkcellAge::Known,
        first_solution: true,
        cache_dir: None,
    };
    let suite = Suite { cases: vec![case], guidances: vec![GuidanceKind::Smart], trials: 1, settings };
    let mut results = results(Vec::new());
    let mut notices = 0;
    let mut observe = |notice: Notice<'_>| -> Result<(), BenchError> {
        notices += 1;
        if let Notice::Running { done, total, left_s, .. } = notice {
            assert_eq!((done, total), (0, 1));
            assert!((0.0..=120.0).contains(&left_s));
        }
        Ok(())
    };
    assert!(run_suite(&suite, &mut results, &CancelToken::new(), &mut observe).unwrap());
    assert!(notices > 1);
    let [run] = results.runs.as_slice() else { panic!("one run") };
    assert!(run.solved, "{:?}", results.remarks);
    assert_eq!((run.trial, run.incumbents.len(), run.mode_graph_optimum), (0, 1, Some(6)));
    assert!(run.candidate_s <= run.first_plan_s && run.duration_s == run.duration_first_s);
    // The phases make up the time to the first plan.
    let first = run.first_plan_s.unwrap();
    let sum: f64 = run.phases.values().map(|phase| phase.expect("every phase was reached")).iter().sum();
    assert!((0.8 * first..=first + 1e-9).contains(&sum), "{sum} of {first}");
    assert!(run.phases.timing_s > Some(0.0) && run.phases.search_s > Some(0.0));
    // The bound is one, and not an empty one.
    let ratio = run.duration_ratio().unwrap();
    assert!((0.999..5.0).contains(&ratio), "{ratio}");

    // What is there is not run again; what was cancelled is not counted.
    let cancelled = CancelToken::new();
    cancelled.cancel();
    let before = results.clone();
    assert!(run_suite(&suite, &mut results, &cancelled, &mut observe_nothing).unwrap());
    let more = Suite { trials: 2, ..suite };
    assert!(!run_suite(&more, &mut results, &cancelled, &mut observe_nothing).unwrap());
    assert_eq!(results, before);
}

fn observe_nothing(_: Notice<'_>) -> Result<(), BenchError> {
    Ok(())
}

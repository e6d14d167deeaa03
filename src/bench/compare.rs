//! Two results against each other: ratios of medians, and which of them are more than noise.

use std::collections::BTreeMap;
use std::fmt;

use super::results::{Results, Run};
use super::signed_rank::signed_rank;
use super::statistics::median;

/// Of the differences that are called real, at most this share is expected to be chance.
const FALSE_DISCOVERIES: f64 = 0.05;

/// What is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Measure {
    /// Time to the first candidate that is accepted later.
    Candidate,
    /// Time to the first plan.
    FirstPlan,
    /// Synchronised steps of the last plan.
    Steps,
    /// Duration of the first plan.
    FirstDuration,
    /// Duration of the last plan.
    Duration,
    /// The last plan's duration over its lower bound.
    DurationRatio,
    /// Most memory in use.
    PeakMemory,
}

impl Measure {
    /// All of them. Of each, less is better.
    pub const ALL: [Measure; 7] = [
        Measure::Candidate,
        Measure::FirstPlan,
        Measure::Steps,
        Measure::FirstDuration,
        Measure::Duration,
        Measure::DurationRatio,
        Measure::PeakMemory,
    ];

    /// Its name in tables: the field of `results.json`, where it is one.
    pub fn name(self) -> &'static str {
        match self {
            Measure::Candidate => "candidate_s",
            Measure::FirstPlan => "first_plan_s",
            Measure::Steps => "steps",
            Measure::FirstDuration => "duration_first_s",
            Measure::Duration => "duration_s",
            Measure::DurationRatio => "duration/bound",
            Measure::PeakMemory => "peak_rss_mb",
        }
    }

    /// Its value in a solved run.
    pub fn of(self, run: &Run) -> Option<f64> {
        match self {
            _ if !run.solved => None,
            Measure::Candidate => run.candidate_s,
            Measure::FirstPlan => run.first_plan_s,
            Measure::Steps => run.steps.map(|steps| steps as f64),
            Measure::FirstDuration => run.duration_first_s,
            Measure::Duration => run.duration_s,
            Measure::DurationRatio => run.duration_ratio(),
            Measure::PeakMemory => run.peak_rss_mb,
        }
    }
}

/// One measure of one (family, size, guidance), over the trials that both have solved.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The measure.
    pub measure: Measure,
    /// Trials solved in both.
    pub pairs: usize,
    /// The medians of A and B.
    pub medians: [f64; 2],
    /// Median of B over median of A.
    pub ratio: f64,
    /// Probability of so lopsided differences by chance, trial against trial.
    pub p: f64,
    /// Whether B is better, by the mean of the logarithms of the trials' ratios.
    pub better: bool,
    /// Whether it is more than noise, all differences of the comparison taken together.
    pub beyond_noise: bool,
}

/// How many trials were solved.
#[derive(Debug, Clone, PartialEq)]
pub struct SuccessDifference {
    /// Trials that both have run.
    pub pairs: usize,
    /// Solved ones in A and B.
    pub solved: [usize; 2],
    /// Probability of so lopsided differences by chance.
    pub p: f64,
    /// Whether it is more than noise.
    pub beyond_noise: bool,
}

/// One (family, size, guidance).
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    /// The family.
    pub family: String,
    /// The size.
    pub size: String,
    /// The guidance.
    pub guidance: String,
    /// Success.
    pub success: SuccessDifference,
    /// The measures that both have.
    pub differences: Vec<Difference>,
}

/// All that two results have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// What both have run, in A's order.
    pub groups: Vec<Group>,
    /// Reasons why the two are not alike in what they measured.
    pub caveats: Vec<String>,
}

/// Compares `b` with `a`, trial by trial.
///
/// A difference is called more than noise by Wilcoxon's signed-rank test on the logarithms of the trials'
/// ratios (the sign test for success), with the false discovery rate over the whole comparison held at
/// 5 % (Benjamini and Hochberg, 1995). That rules out chance from trial to trial, not a machine that
/// was slower throughout.
pub fn compare(a: &Results, b: &Results) -> Comparison {
    let (left, right) = (by_group(&a.runs), by_group(&b.runs));
    let mut order: Vec<[&str; 3]> = Vec::new();
    for run in &a.runs {
        let name = group_of(run);
        if right.contains_key(&name) && !order.contains(&name) {
            order.push(name);
        }
    }
    let mut groups: Vec<Group> =
        order.into_iter().filter_map(|name| group(name, &left[&name], &right[&name])).collect();
    mark_beyond_noise(&mut groups);
    Comparison { groups, caveats: caveats(a, b) }
}

type Trials<'a> = BTreeMap<u64, &'a Run>;

fn group_of(run: &Run) -> [&str; 3] {
    [&run.family, &run.size, &run.guidance]
}

fn by_group(runs: &[Run]) -> BTreeMap<[&str; 3], Trials<'_>> {
    let mut groups: BTreeMap<[&str; 3], Trials<'_>> = BTreeMap::new();
    for run in runs {
        groups.entry(group_of(run)).or_default().insert(run.trial, run);
    }
    groups
}

fn group(name: [&str; 3], a: &Trials<'_>, b: &Trials<'_>) -> Option<Group> {
    let pairs: Vec<[&Run; 2]> =
        a.iter().filter_map(|(trial, run)| b.get(trial).map(|other| [*run, *other])).collect();
    if pairs.is_empty() {
        return None;
    }
    let solved = [0, 1].map(|side| pairs.iter().filter(|pair| pair[side].solved).count());
    let lopsided: Vec<f64> =
        pairs.iter().map(|[a, b]| f64::from(u8::from(b.solved)) - f64::from(u8::from(a.solved))).collect();
    // Ties all share their rank, which makes it the sign test.
    let p = signed_rank(&lopsided);
    let success = SuccessDifference { pairs: pairs.len(), solved, p, beyond_noise: false };
    let differences = Measure::ALL.into_iter().filter_map(|measure| difference(measure, &pairs)).collect();
    let [family, size, guidance] = name.map(str::to_owned);
    Some(Group { family, size, guidance, success, differences })
}

fn difference(measure: Measure, pairs: &[[&Run; 2]]) -> Option<Difference> {
    let values: Vec<[f64; 2]> =
        pairs.iter().filter_map(|[a, b]| Some([measure.of(a)?, measure.of(b)?])).collect();
    let side = |side: usize| values.iter().map(|pair| pair[side]).collect::<Vec<_>>();
    let medians = [median(&side(0))?, median(&side(1))?];
    let logs: Vec<f64> = values.iter().map(|[a, b]| b.ln() - a.ln()).collect();
    Some(Difference {
        measure,
        pairs: values.len(),
        medians,
        ratio: medians[1] / medians[0],
        p: signed_rank(&logs),
        better: logs.iter().sum::<f64>() < 0.0,
        beyond_noise: false,
    })
}

/// Benjamini and Hochberg: of m tests in order of p, all up to the last whose p is at most k/m of the rate.
fn mark_beyond_noise(groups: &mut [Group]) {
    let mut all: Vec<f64> = groups
        .iter()
        .flat_map(|group| group.differences.iter().map(|d| d.p).chain([group.success.p]))
        .collect();
    all.sort_by(f64::total_cmp);
    let m = all.len() as f64;
    let passes = |(k, p): (usize, &f64)| *p <= (k + 1) as f64 / m * FALSE_DISCOVERIES;
    let threshold = all.iter().enumerate().filter(|(k, p)| passes((*k, *p))).map(|(_, p)| *p).next_back();
    let Some(threshold) = threshold else { return };
    for group in groups {
        group.success.beyond_noise = group.success.p <= threshold;
        for difference in &mut group.differences {
            difference.beyond_noise = difference.p <= threshold;
        }
    }
}

fn caveats(a: &Results, b: &Results) -> Vec<String> {
    let mut caveats = Vec::new();
    let mut differ = |what: &str, a: String, b: String| {
        if a != b {
            caveats.push(format!("{what}: A {a}, B {b}"));
        }
    };
    differ("processor", a.machine.processor.clone(), b.machine.processor.clone());
    differ("budget", format!("{} s", a.setup.budget_s), format!("{} s", b.setup.budget_s));
    differ("threads", a.setup.threads.to_string(), b.setup.threads.to_string());
    let age = |results: &Results| format!("{:?}", results.setup.workcell).to_lowercase();
    differ("workcell", age(a), age(b));
    let ends = |results: &Results| {
        if results.setup.first_solution { "at the first plan" } else { "with the budget" }.to_owned()
    };
    differ("runs end", ends(a), ends(b));
    for (name, results) in [("A", a), ("B", b)] {
        let waited = results.conditions.waited_share.unwrap_or(0.0);
        if waited > 0.02 {
            caveats.push(format!("{name} waited {:.0} % of its time for a processor", 100.0 * waited));
        }
    }
    caveats
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for caveat in &self.caveats {
            writeln!(f, "not alike: {caveat}")?;
        }
        if self.groups.is_empty() {
            return writeln!(f, "nothing was run in both");
        }
        writeln!(
            f,
            "{:<28} {:<18} {:>6} {:>11} {:>11} {:>7}  beyond noise",
            "case", "measure", "trials", "A", "B", "B/A"
        )?;
        for group in &self.groups {
            let case = format!("{}/{} {}", group.family, group.size, group.guidance);
            let success = &group.success;
            writeln!(
                f,
                "{case:<28} {:<18} {:>6} {:>11} {:>11} {:>7}  {}",
                "solved",
                success.pairs,
                success.solved[0],
                success.solved[1],
                "",
                word(success.beyond_noise, success.solved[1] > success.solved[0], success.p)
            )?;
            for d in &group.differences {
                writeln!(
                    f,
                    "{:<28} {:<18} {:>6} {:>11} {:>11} {:>7.3}  {}",
                    "",
                    d.measure.name(),
                    d.pairs,
                    figure(d.medians[0]),
                    figure(d.medians[1]),
                    d.ratio,
                    word(d.beyond_noise, d.better, d.p)
                )?;
            }
        }
        let found = self.groups.iter().flat_map(|group| &group.differences).filter(|d| d.beyond_noise);
        let (gains, losses): (Vec<_>, Vec<_>) = found.partition(|d| d.better);
        writeln!(f, "beyond noise: {} better in B, {} worse", gains.len(), losses.len())
    }
}

fn word(beyond_noise: bool, better: bool, p: f64) -> String {
    let direction = if better { "better" } else { "worse" };
    if beyond_noise { format!("{direction} (p = {p:.1e})") } else { format!("- (p = {p:.2})") }
}

/// Four digits that count.
fn figure(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { 3 - value.abs().log10().floor().clamp(-6.0, 3.0) as i32 };
    format!("{value:.*}", usize::try_from(digits).unwrap_or(0))
}

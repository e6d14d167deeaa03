//! Runs as comma-separated values, and back.

use std::str::FromStr;

use super::results::{Phases, Run};

/// Why a table cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CsvError {
    /// The first line does not name the columns that [`to_csv`] writes.
    #[error("the first line does not name the columns of a table of runs")]
    Columns,
    /// A line has another number of fields than there are columns.
    #[error("line {line} has {fields} fields")]
    Fields {
        /// The line, from 1.
        line: usize,
        /// Its fields.
        fields: usize,
    },
    /// A field is not what its column holds.
    #[error("line {line}: `{value}` does not belong into column `{column}`")]
    Value {
        /// The line, from 1.
        line: usize,
        /// The column.
        column: &'static str,
        /// The field.
        value: String,
    },
}

/// The columns before the phases.
const COLUMNS: [&str; 17] = [
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
];

fn columns() -> impl Iterator<Item = &'static str> {
    COLUMNS.into_iter().chain(Phases::NAMES)
}

/// A table with a line of column names and a line per run; fields without a value are empty, incumbents
/// are `time:duration` with spaces between. Numbers read back as the same numbers.
pub fn to_csv(runs: &[Run]) -> String {
    let mut out = columns().collect::<Vec<_>>().join(",");
    for run in runs {
        let incumbents: Vec<String> =
            run.incumbents.iter().map(|(t, duration)| format!("{t}:{duration}")).collect();
        let mut fields = vec![
            run.family.clone(),
            run.size.clone(),
            run.guidance.clone(),
            run.trial.to_string(),
            run.solved.to_string(),
            text(run.candidate_s),
            text(run.first_plan_s),
            text(run.steps),
            text(run.mode_graph_optimum),
            text(run.steps_lower_bound),
            text(run.actions),
            text(run.duration_first_s),
            text(run.duration_s),
            text(run.duration_lower_bound_s),
            text(run.arc_length),
            text(run.peak_rss_mb),
            incumbents.join(" "),
        ];
        fields.extend(run.phases.values().map(text));
        out.push('\n');
        out.push_str(&fields.join(","));
    }
    out.push('\n');
    out
}

fn text<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Reads what [`to_csv`] has written.
///
/// # Errors
/// [`CsvError`] at the first line that is not as it should be.
pub fn from_csv(table: &str) -> Result<Vec<Run>, CsvError> {
    let mut lines = table.lines().enumerate().map(|(index, line)| (index + 1, line));
    let head = lines.next().map_or("", |(_, line)| line);
    if !head.split(',').eq(columns()) {
        return Err(CsvError::Columns);
    }
    lines.map(|(line, content)| run(line, content)).collect()
}

fn run(line: usize, content: &str) -> Result<Run, CsvError> {
    let fields: Vec<&str> = content.split(',').collect();
    if fields.len() != columns().count() {
        return Err(CsvError::Fields { line, fields: fields.len() });
    }
    let mut row = Row { line, fields: fields.into_iter().zip(columns()) };
    Ok(Run {
        family: row.needed()?,
        size: row.needed()?,
        guidance: row.needed()?,
        trial: row.needed()?,
        solved: row.needed()?,
        candidate_s: row.optional()?,
        first_plan_s: row.optional()?,
        steps: row.optional()?,
        mode_graph_optimum: row.optional()?,
        steps_lower_bound: row.optional()?,
        actions: row.optional()?,
        duration_first_s: row.optional()?,
        duration_s: row.optional()?,
        duration_lower_bound_s: row.optional()?,
        arc_length: row.optional()?,
        peak_rss_mb: row.optional()?,
        incumbents: row.pairs()?,
        phases: Phases {
            validation_s: row.optional()?,
            workcell_s: row.optional()?,
            mode_graph_s: row.optional()?,
            guidance_s: row.optional()?,
            search_s: row.optional()?,
            timing_s: row.optional()?,
            judge_s: row.optional()?,
        },
    })
}

/// The fields of a line that have not been read yet.
struct Row<I> {
    line: usize,
    fields: I,
}

impl<'a, I: Iterator<Item = (&'a str, &'static str)>> Row<I> {
    fn next(&mut self) -> Result<(&'a str, &'static str), CsvError> {
        self.fields.next().ok_or(CsvError::Fields { line: self.line, fields: 0 })
    }

    fn wrong(&self, value: &str, column: &'static str) -> CsvError {
        CsvError::Value { line: self.line, column, value: value.chars().take(40).collect() }
    }

    fn needed<T: FromStr>(&mut self) -> Result<T, CsvError> {
        let (value, column) = self.next()?;
        value.parse().map_err(|_| self.wrong(value, column))
    }

    fn optional<T: FromStr>(&mut self) -> Result<Option<T>, CsvError> {
        let (value, column) = self.next()?;
        if value.is_empty() {
            return Ok(None);
        }
        value.parse().map(Some).map_err(|_| self.wrong(value, column))
    }

    fn pairs(&mut self) -> Result<Vec<(f64, f64)>, CsvError> {
        let (value, column) = self.next()?;
        let pair = |text: &str| {
            let (t, duration) = text.split_once(':')?;
            Some((t.parse().ok()?, duration.parse().ok()?))
        };
        let pairs: Option<Vec<_>> = value.split_whitespace().map(pair).collect();
        pairs.ok_or_else(|| self.wrong(value, column))
    }
}

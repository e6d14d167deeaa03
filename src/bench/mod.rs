//! The paper's evaluation (DESIGN section 12): families x sizes x guidances x trials, measured one
//! run after the other in one process; what came out, as files and as a page; and the comparison of two
//! such results.
//!
//! Nothing here decides how anything is planned: the planner is called as any user calls it.

mod bound;
mod compare;
mod csv;
mod machine;
mod memory;
mod report;
mod results;
mod run;
mod selection;
mod signed_rank;
mod statistics;
mod suite;

pub use bound::duration_lower_bound;
pub use compare::{Comparison, Difference, Group, Measure, SuccessDifference, compare};
pub use csv::{CsvError, from_csv, to_csv};
pub use machine::{Conditions, Machine};
pub use report::to_html;
pub use results::{Phases, Remark, Results, Run, RunKey, Setup, WorkcellAge};
pub use run::{BenchError, RunSettings, measure};
pub use selection::{Case, Selection, Size, SizeError, guidance_name, select};
pub use signed_rank::signed_rank;
pub use statistics::{Summary, median, percentile};
pub use suite::{Notice, Suite, run_suite};

#[cfg(test)]
mod tests;

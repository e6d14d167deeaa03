//! A workcell on its own, as it is registered once and referred to by many problems.

use serde_json::{Map, Value, json};

use super::fault::{Fault, FaultCode};
use super::problem::{ReadLimits, SCHEMA, read_around_workcell};
use super::resources::Resources;
use crate::workcell::Workcell;

/// A workcell, and what its author should know.
#[derive(Debug, Clone)]
pub struct ReadWorkcell {
    /// The workcell.
    pub workcell: std::sync::Arc<Workcell>,
    /// `sha256:...` over the canonical document: it counts what files and the library hold, not what
    /// they are called.
    pub digest: String,
    /// What was assumed or decided on the way.
    pub warnings: Vec<Fault>,
}

/// Reads and validates the value of a problem's `workcell`. Faults have their places below it. What it gives of its arms'
/// homes has to be right; what it leaves out need not be, as a problem may say where the arms start.
///
/// # Errors
/// All faults of the document.
pub fn read_workcell_value(
    document: &Value,
    resources: &dyn Resources,
    limits: &ReadLimits,
) -> Result<ReadWorkcell, Vec<Fault>> {
    let empty = json!({ "schema": SCHEMA, "workcell": document, "objects": [], "initial": {} });
    let below = |faults: Vec<Fault>| faults.into_iter().map(inside).collect::<Vec<_>>();
    let read = read_around_workcell(&empty, resources, limits).map_err(below)?;
    Ok(ReadWorkcell {
        workcell: read.problem.workcell,
        digest: read.problem.workcell_digest,
        warnings: below(read.warnings),
    })
}

/// The fault as it stands in the workcell's own document.
fn inside(fault: Fault) -> Fault {
    let pointer = fault.pointer.strip_prefix("/workcell").map(str::to_owned);
    Fault { pointer: pointer.unwrap_or(fault.pointer), ..fault }
}

/// What a problem's `workcell` refers to when it is text: the id or the digest of a registered one.
pub fn workcell_reference(problem: &Value) -> Option<&str> {
    problem.get("workcell")?.as_str()
}

/// The problem with `workcell` in place of the reference to it.
pub fn with_workcell(problem: &Value, workcell: &Value) -> Value {
    let mut fields: Map<String, Value> = problem.as_object().cloned().unwrap_or_default();
    fields.insert("workcell".to_owned(), workcell.clone());
    Value::Object(fields)
}

/// The fault of a reference that leads nowhere.
pub fn unknown_workcell(pointer: &str, reference: &str) -> Fault {
    let shown: String = reference.chars().take(80).collect();
    Fault {
        pointer: format!("{pointer}/workcell"),
        code: FaultCode::UnresolvedUri,
        message: format!("no workcell `{shown}` is registered; PUT it first, or give the workcell itself"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::LibraryOnly;

    fn cell() -> Value {
        let text = crate::scenario::find("switch/2x2").unwrap().text;
        serde_json::from_str::<Value>(text).unwrap()["workcell"].clone()
    }

    #[test]
    fn a_workcell_stands_alone() {
        let limits = ReadLimits::default();
        let read = read_workcell_value(&cell(), &LibraryOnly, &limits).unwrap();
        assert_eq!(read.workcell.arms.len(), 2);
        assert!(read.digest.starts_with("sha256:"));
        let mut other = cell();
        other["arms"][0]["base"]["position"]["z"] = json!(0.4321);
        let moved = read_workcell_value(&other, &LibraryOnly, &limits);
        assert!(moved.is_err() || moved.unwrap().digest != read.digest);
    }

    #[test]
    fn faults_stand_where_the_workcell_has_them() {
        let mut bad = cell();
        bad["arms"][0]["robot"] = json!("iiwa99");
        let faults = read_workcell_value(&bad, &LibraryOnly, &ReadLimits::default()).unwrap_err();
        assert_eq!((faults[0].pointer.as_str(), faults[0].code), ("/arms/0/robot", FaultCode::UnknownRobot));
    }
}

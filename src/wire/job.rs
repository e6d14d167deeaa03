//! What is POSTed to make a job: a bare problem, or a problem with what belongs to the job around it.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::Value;

use super::fault::{Fault, FaultCode, Faults};
use super::reader::{Node, Range, is_id};

/// Most labels of one job.
pub const MAX_LABELS: usize = 32;
/// Longest value of a label (bytes).
pub const MAX_LABEL_VALUE: usize = 256;
/// Greatest magnitude of a priority.
pub const MAX_PRIORITY: i64 = 10;
/// Longest `queue_ttl_s`.
const MAX_QUEUE_TTL_S: f64 = 1.0e7;

/// A request for a job, as it stands in the document.
#[derive(Debug, Clone)]
pub struct JobFields<'a> {
    /// The problem.
    pub problem: &'a Value,
    /// Where the problem stands: a JSON pointer, empty for a bare problem.
    pub pointer: &'static str,
    /// What the client writes on the job.
    pub labels: BTreeMap<String, String>,
    /// How urgent it is, from -10 to 10; higher goes first.
    pub priority: i32,
    /// How long it may wait before it starts.
    pub queue_ttl: Option<Duration>,
    /// The plan to begin from, at `/warm_start`.
    pub warm_start: Option<&'a Value>,
}

/// Reads a request for a job: `{"problem", "labels", "priority", "queue_ttl_s", "warm_start"}` of which
/// only the first is needed, or a bare problem, told by its `schema`.
///
/// # Errors
/// All faults of what stands around the problem.
pub fn read_job(document: &Value) -> Result<JobFields<'_>, Vec<Fault>> {
    let mut job = JobFields {
        problem: document,
        pointer: "",
        labels: BTreeMap::new(),
        priority: 0,
        queue_ttl: None,
        warm_start: None,
    };
    let wrapped = document.as_object().is_some_and(|map| {
        !map.contains_key("schema")
            && ["problem", "labels", "priority", "queue_ttl_s", "warm_start"]
                .iter()
                .any(|k| map.contains_key(*k))
    });
    if !wrapped {
        return Ok(job);
    }
    let mut faults = Faults::new(100);
    if let Some(mut fields) = Node::root(document).fields(&mut faults) {
        if let Some(node) = fields.required("problem", &mut faults) {
            job.problem = node.value;
            job.pointer = "/problem";
        }
        if let Some(node) = fields.optional("labels") {
            job.labels = read_labels(&node, &mut faults);
        }
        if let Some(node) = fields.optional("priority") {
            let number = node.number(&mut faults, Range::Within(MAX_PRIORITY as f64)).unwrap_or(0.0);
            if number.fract() != 0.0 {
                node.fault(&mut faults, FaultCode::WrongType, "give a whole number");
            }
            job.priority = number as i32;
        }
        if let Some(node) = fields.nullable("queue_ttl_s") {
            let seconds = node.number(&mut faults, Range::Positive(MAX_QUEUE_TTL_S));
            job.queue_ttl = seconds.map(Duration::from_secs_f64);
        }
        job.warm_start = fields.nullable("warm_start").map(|node| node.value);
        fields.finish(&mut faults);
    }
    faults.finish()?;
    Ok(job)
}

fn read_labels(node: &Node<'_>, faults: &mut Faults) -> BTreeMap<String, String> {
    let entries = node.entries(faults);
    if entries.len() > MAX_LABELS {
        let message = format!("{} labels, at most {MAX_LABELS} are taken", entries.len());
        node.fault(faults, FaultCode::TooLarge, message);
        return BTreeMap::new();
    }
    let mut labels = BTreeMap::new();
    for (key, node) in entries {
        if !is_id(key) {
            node.fault(faults, FaultCode::BadId, "the name of a label matches [A-Za-z0-9_.-]{1,64}");
        }
        let Some(value) = node.string(faults) else { continue };
        if value.len() > MAX_LABEL_VALUE {
            let message = format!("the value of a label has at most {MAX_LABEL_VALUE} bytes");
            node.fault(faults, FaultCode::TooLarge, message);
        }
        labels.insert(key.to_owned(), value.to_owned());
    }
    labels
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_bare_problem_is_told_by_its_schema() {
        let bare = json!({"schema": "quadrille.problem/1", "labels": 1});
        let job = read_job(&bare).unwrap();
        assert_eq!((job.problem, job.pointer, job.priority), (&bare, "", 0));
        assert_eq!(read_job(&json!([])).unwrap().pointer, "");
    }

    #[test]
    fn what_stands_around_is_read() {
        let whole = json!({
            "problem": {"schema": "x"}, "labels": {"line": "7"}, "priority": -3, "queue_ttl_s": 1.5,
            "warm_start": {"schema": "y"},
        });
        let job = read_job(&whole).unwrap();
        assert_eq!((job.problem, job.pointer), (&json!({"schema": "x"}), "/problem"));
        assert_eq!(job.labels["line"], "7");
        assert_eq!((job.priority, job.queue_ttl), (-3, Some(Duration::from_millis(1500))));
        assert!(job.warm_start.is_some());
    }

    #[test]
    fn faults_are_told_with_their_places() {
        for (document, pointer, code) in [
            (json!({"priority": 1}), "", FaultCode::MissingField),
            (json!({"problem": {}, "colour": 1}), "/colour", FaultCode::UnknownField),
            (json!({"problem": {}, "priority": 11}), "/priority", FaultCode::OutOfRange),
            (json!({"problem": {}, "priority": 0.5}), "/priority", FaultCode::WrongType),
            (json!({"problem": {}, "queue_ttl_s": 0}), "/queue_ttl_s", FaultCode::OutOfRange),
            (json!({"problem": {}, "labels": {"a b": "x"}}), "/labels/a b", FaultCode::BadId),
            (json!({"problem": {}, "labels": {"a": 1}}), "/labels/a", FaultCode::WrongType),
            (json!({"problem": {}, "labels": {"a": "x".repeat(257)}}), "/labels/a", FaultCode::TooLarge),
        ] {
            let faults = read_job(&document).unwrap_err();
            assert!(faults.iter().any(|fault| fault.pointer == pointer && fault.code == code), "{faults:?}");
        }
    }
}

//! Walks a parsed JSON value and notes every fault on the way instead of stopping at the first.
//!
//! All readers return `None` when the value is no good, after having noted why.

use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde_json::{Map, Value};

use super::fault::{FaultCode, Faults};
use super::json::child;
use crate::geometry::{Pose, Vec3};

/// Greatest magnitude of a length or position that is taken seriously (m).
const MAX_LENGTH: f64 = 1.0e4;

/// Norms this near to 1 are what rounding leaves of a unit quaternion: normalising again would
/// only change bits.
const ROUNDING: f64 = 1.0e-14;

/// A value and its place in the document.
#[derive(Debug, Clone)]
pub struct Node<'a> {
    /// The value.
    pub value: &'a Value,
    /// JSON pointer to it.
    pub pointer: String,
}

/// The members of an object, of which each known one is asked for once; what nobody asked for is
/// an unknown field.
#[derive(Debug)]
pub struct Fields<'a> {
    map: &'a Map<String, Value>,
    /// JSON pointer to the object.
    pub pointer: String,
    known: Vec<&'static str>,
}

/// What happens to members that nobody asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unknown {
    Refused,
    PassedOver,
}

/// What a number must satisfy.
#[derive(Debug, Clone, Copy)]
pub enum Range {
    /// Any finite number.
    Any,
    /// Greater than zero and at most the bound.
    Positive(f64),
    /// Not less than zero and at most the bound.
    NonNegative(f64),
    /// Magnitude at most the bound.
    Within(f64),
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a boolean",
        Value::Number(_) => "a number",
        Value::String(_) => "a string",
        Value::Array(_) => "an array",
        Value::Object(_) => "an object",
    }
}

impl<'a> Node<'a> {
    /// The whole document.
    pub fn root(value: &'a Value) -> Self {
        Self { value, pointer: String::new() }
    }

    /// Notes a fault at this value.
    pub fn fault(&self, faults: &mut Faults, code: FaultCode, message: impl Into<String>) {
        faults.push(self.pointer.clone(), code, message);
    }

    fn wrong_type(&self, faults: &mut Faults, expected: &str) {
        let message = format!("expected {expected}, found {}", kind(self.value));
        self.fault(faults, FaultCode::WrongType, message);
    }

    /// Whether the value is `null`.
    pub fn is_null(&self) -> bool {
        self.value.is_null()
    }

    /// The value as an object.
    pub fn fields(&self, faults: &mut Faults) -> Option<Fields<'a>> {
        match self.value {
            Value::Object(map) => {
                Some(Fields { map, pointer: self.pointer.clone(), known: Vec::with_capacity(8) })
            }
            _ => {
                self.wrong_type(faults, "an object");
                None
            }
        }
    }

    /// The members of an object whose keys are names.
    pub fn entries(&self, faults: &mut Faults) -> Vec<(&'a str, Node<'a>)> {
        match self.value {
            Value::Object(map) => map
                .iter()
                .map(|(key, value)| (key.as_str(), Node { value, pointer: child(&self.pointer, key) }))
                .collect(),
            _ => {
                self.wrong_type(faults, "an object");
                Vec::new()
            }
        }
    }

    /// The elements of an array of at most `max` elements; of a longer one nothing.
    pub fn elements(&self, faults: &mut Faults, what: &str, max: usize) -> Vec<Node<'a>> {
        match self.value {
            Value::Array(list) if list.len() > max => {
                let message = format!("{} {what}, at most {max} are taken; split the problem", list.len());
                self.fault(faults, FaultCode::TooLarge, message);
                Vec::new()
            }
            Value::Array(list) => list
                .iter()
                .enumerate()
                .map(|(index, value)| Node { value, pointer: format!("{}/{index}", self.pointer) })
                .collect(),
            _ => {
                self.wrong_type(faults, "an array");
                Vec::new()
            }
        }
    }

    /// The value as a string.
    pub fn string(&self, faults: &mut Faults) -> Option<&'a str> {
        if let Value::String(text) = self.value {
            return Some(text);
        }
        self.wrong_type(faults, "a string");
        None
    }

    /// The value as a boolean.
    pub fn boolean(&self, faults: &mut Faults) -> Option<bool> {
        if let Value::Bool(value) = self.value {
            return Some(*value);
        }
        self.wrong_type(faults, "true or false");
        None
    }

    /// The value as a finite number in `range`.
    pub fn number(&self, faults: &mut Faults, range: Range) -> Option<f64> {
        let Value::Number(number) = self.value else {
            self.wrong_type(faults, "a number");
            return None;
        };
        let Some(value) = number.as_f64().filter(|value| value.is_finite()) else {
            self.fault(faults, FaultCode::NotFinite, "give a number that a finite f64 can hold");
            return None;
        };
        let (fits, rule) = match range {
            Range::Any => (true, String::new()),
            Range::Positive(max) => (value > 0.0 && value <= max, format!("above 0 and at most {max}")),
            Range::NonNegative(max) => ((0.0..=max).contains(&value), format!("from 0 to {max}")),
            Range::Within(max) => (value.abs() <= max, format!("from -{max} to {max}")),
        };
        if !fits {
            self.fault(
                faults,
                FaultCode::OutOfRange,
                format!("{value} is out of range; give a number {rule}"),
            );
            return None;
        }
        Some(value)
    }

    /// The value as a whole number from `least` to `greatest`.
    pub fn whole(&self, faults: &mut Faults, least: u64, greatest: u64) -> Option<u64> {
        let Value::Number(number) = self.value else {
            self.wrong_type(faults, "a whole number");
            return None;
        };
        let exact = number.as_u64().or_else(|| {
            // 3.0 and 1e3 are whole numbers, too.
            number.as_f64().filter(|v| v.fract() == 0.0 && *v >= 0.0 && *v <= 9.0e15).map(|v| v as u64)
        });
        match exact {
            Some(value) if (least..=greatest).contains(&value) => Some(value),
            _ => {
                let message =
                    format!("{number} is out of range; give a whole number from {least} to {greatest}");
                self.fault(faults, FaultCode::OutOfRange, message);
                None
            }
        }
    }

    /// The value as an id that is well formed.
    pub fn id(&self, faults: &mut Faults) -> Option<&'a str> {
        let text = self.string(faults)?;
        if is_id(text) {
            return Some(text);
        }
        self.fault(faults, FaultCode::BadId, "an id is 1 to 64 letters, digits, `_`, `.` or `-`");
        None
    }

    /// `{x, y, z}` with every component in `range`.
    pub fn vector(&self, faults: &mut Faults, range: Range) -> Option<Vec3> {
        self.vector_with(faults, range, Unknown::Refused)
    }

    fn vector_with(&self, faults: &mut Faults, range: Range, unknown: Unknown) -> Option<Vec3> {
        let mut fields = self.fields(faults)?;
        let mut component = |key| fields.required(key, faults).and_then(|node| node.number(faults, range));
        let (x, y, z) = (component("x"), component("y"), component("z"));
        fields.end(unknown, faults);
        Some(Vec3::new(x?, y?, z?))
    }

    /// A pose; absent parts are zero and the identity.
    pub fn pose(&self, faults: &mut Faults) -> Option<Pose> {
        self.pose_with(faults, Unknown::Refused)
    }

    /// A pose of a document whose unknown fields are passed over.
    pub fn lenient_pose(&self, faults: &mut Faults) -> Option<Pose> {
        self.pose_with(faults, Unknown::PassedOver)
    }

    fn pose_with(&self, faults: &mut Faults, unknown: Unknown) -> Option<Pose> {
        let mut fields = self.fields(faults)?;
        let position = match fields.optional("position") {
            Some(node) => node.vector_with(faults, Range::Within(MAX_LENGTH), unknown),
            None => Some(Vec3::zeros()),
        };
        let orientation = match fields.optional("orientation") {
            Some(node) => node.quaternion(faults, unknown),
            None => Some(UnitQuaternion::identity()),
        };
        fields.end(unknown, faults);
        Some(Pose::from_parts(Translation3::from(position?), orientation?))
    }

    /// A unit quaternion. One that is so up to rounding keeps its bits.
    fn quaternion(&self, faults: &mut Faults, unknown: Unknown) -> Option<UnitQuaternion<f64>> {
        let mut fields = self.fields(faults)?;
        let mut component =
            |key| fields.required(key, faults).and_then(|node| node.number(faults, Range::Any));
        let (x, y, z, w) = (component("x"), component("y"), component("z"), component("w"));
        fields.end(unknown, faults);
        let quaternion = Quaternion::new(w?, x?, y?, z?);
        let norm = quaternion.norm();
        let off = (norm - 1.0).abs();
        if off <= ROUNDING {
            return Some(UnitQuaternion::new_unchecked(quaternion));
        }
        if off <= 1.0e-6 {
            return Some(UnitQuaternion::new_normalize(quaternion));
        }
        let message = format!("the quaternion's norm is {norm}; give a unit quaternion (within 1e-6)");
        self.fault(faults, FaultCode::BadQuaternion, message);
        None
    }

    /// One of the names in `choices`.
    pub fn choice<T: Copy>(&self, faults: &mut Faults, choices: &[(&str, T)]) -> Option<T> {
        let text = self.string(faults)?;
        if let Some((_, value)) = choices.iter().find(|(name, _)| *name == text) {
            return Some(*value);
        }
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        let message = format!("`{}` is not known here; give one of {}", shown(text), names.join(", "));
        self.fault(faults, FaultCode::OutOfRange, message);
        None
    }
}

impl<'a> Fields<'a> {
    /// The member `key`, if it is there.
    pub fn optional(&mut self, key: &'static str) -> Option<Node<'a>> {
        if !self.known.contains(&key) {
            self.known.push(key);
        }
        self.map.get(key).map(|value| Node { value, pointer: child(&self.pointer, key) })
    }

    /// The member `key`, if it is there and not `null`.
    pub fn nullable(&mut self, key: &'static str) -> Option<Node<'a>> {
        self.optional(key).filter(|node| !node.is_null())
    }

    /// The member `key`; its absence is noted.
    pub fn required(&mut self, key: &'static str, faults: &mut Faults) -> Option<Node<'a>> {
        let node = self.optional(key);
        if node.is_none() {
            let message = format!("`{key}` is missing; add it");
            faults.push(self.pointer.clone(), FaultCode::MissingField, message);
        }
        node
    }

    fn end(self, unknown: Unknown, faults: &mut Faults) {
        if unknown == Unknown::Refused {
            self.finish(faults);
        }
    }

    /// Notes every member that nobody asked for.
    pub fn finish(self, faults: &mut Faults) {
        for key in self.map.keys().filter(|key| !self.known.contains(&key.as_str())) {
            let known = self.known.join(", ");
            let message = format!("`{}` is not a field here; known are: {known}", shown(key));
            faults.push(child(&self.pointer, key), FaultCode::UnknownField, message);
        }
    }
}

/// Whether `text` is a well-formed id.
pub fn is_id(text: &str) -> bool {
    (1..=64).contains(&text.len())
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'.' | b'-'))
}

/// `text`, cut to what fits a message.
pub fn shown(text: &str) -> String {
    const MAX: usize = 80;
    if text.chars().count() <= MAX {
        return text.to_owned();
    }
    text.chars().take(MAX).chain("...".chars()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn faults_of(read: impl FnOnce(Node<'_>, &mut Faults), value: Value) -> Vec<(String, FaultCode)> {
        let mut faults = Faults::new(100);
        read(Node::root(&value), &mut faults);
        let listed = faults.finish().err().unwrap_or_default();
        listed.into_iter().map(|fault| (fault.pointer, fault.code)).collect()
    }

    #[test]
    fn notes_every_fault_of_a_pose_at_once() {
        let value = json!({
            "position": {"x": "far", "y": 1e5, "q": 0},
            "orientation": {"x": 0, "y": 0, "z": 0, "w": 2},
            "frame": "world"
        });
        let found = faults_of(|node, faults| assert!(node.pose(faults).is_none()), value);
        let expected = [
            ("/position/x", FaultCode::WrongType),
            ("/position/y", FaultCode::OutOfRange),
            ("/position", FaultCode::MissingField),
            ("/position/q", FaultCode::UnknownField),
            ("/orientation", FaultCode::BadQuaternion),
            ("/frame", FaultCode::UnknownField),
        ];
        assert_eq!(found, expected.map(|(pointer, code)| (pointer.to_owned(), code)));
    }

    #[test]
    fn whole_numbers_may_be_written_as_floats() {
        let mut faults = Faults::new(10);
        assert_eq!(Node::root(&json!(3.0)).whole(&mut faults, 1, 5), Some(3));
        assert!(faults.is_empty());
        assert_eq!(Node::root(&json!(3.5)).whole(&mut faults, 1, 5), None);
        assert_eq!(Node::root(&json!(-1)).whole(&mut faults, 0, 5), None);
        assert_eq!(faults.count(), 2);
    }

    #[test]
    fn ids_follow_their_pattern() {
        assert!(is_id("a") && is_id("A-1_b.c") && is_id(&"x".repeat(64)));
        assert!(!is_id("") && !is_id("a/b") && !is_id("é") && !is_id(&"x".repeat(65)));
    }
}

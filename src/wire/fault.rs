//! Faults of a document: where, which, and what to do about it.

use std::fmt;

/// The stable codes of faults in documents (FORMAT "Errors").
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FaultCode {
    /// The text is no JSON, is nested too deeply, or holds a key twice.
    InvalidJson,
    /// A field that the format does not know.
    UnknownField,
    /// A required field is missing.
    MissingField,
    /// A value of the wrong JSON type, or of a kind that does not fit here.
    WrongType,
    /// A value outside its range.
    OutOfRange,
    /// A number that no finite f64 holds.
    NotFinite,
    /// A quaternion whose norm is off by more than 1e-6.
    BadQuaternion,
    /// An id that does not match `[A-Za-z0-9_.-]{1,64}`.
    BadId,
    /// An id that is used twice.
    DuplicateId,
    /// A robot that `workcell.robots` does not have.
    UnknownRobot,
    /// A link that the robot does not have.
    UnknownLink,
    /// A joint that the robot does not have.
    UnknownJoint,
    /// A body name, or the id of an arm or obstacle, that resolves to nothing.
    UnknownBody,
    /// An object id that resolves to nothing.
    UnknownObject,
    /// A surface id that resolves to nothing.
    UnknownSurface,
    /// A URDF that cannot be used.
    BadUrdf,
    /// An SRDF that cannot be used.
    BadSrdf,
    /// A mesh that cannot be used.
    BadMesh,
    /// A URI that may not be resolved, or does not resolve.
    UnresolvedUri,
    /// An object that does not rest on exactly one surface.
    NotResting,
    /// Objects that overlap each other.
    Overlap,
    /// Bodies that are in contact at the start.
    InitialCollision,
    /// A goal pose in contact with a body that stays where it is.
    GoalCollision,
    /// A goal beyond every arm's greatest reach.
    GoalUnreachable,
    /// More objects than a surface or arm takes.
    CapacityExceeded,
    /// More or larger than the limits allow.
    TooLarge,
    /// In the format, but not in this version.
    NotImplemented,
}

impl FaultCode {
    /// Every code, in FORMAT.md's order.
    pub const ALL: [FaultCode; 27] = [
        FaultCode::InvalidJson,
        FaultCode::UnknownField,
        FaultCode::MissingField,
        FaultCode::WrongType,
        FaultCode::OutOfRange,
        FaultCode::NotFinite,
        FaultCode::BadQuaternion,
        FaultCode::BadId,
        FaultCode::DuplicateId,
        FaultCode::UnknownRobot,
        FaultCode::UnknownLink,
        FaultCode::UnknownJoint,
        FaultCode::UnknownBody,
        FaultCode::UnknownObject,
        FaultCode::UnknownSurface,
        FaultCode::BadUrdf,
        FaultCode::BadSrdf,
        FaultCode::BadMesh,
        FaultCode::UnresolvedUri,
        FaultCode::NotResting,
        FaultCode::Overlap,
        FaultCode::InitialCollision,
        FaultCode::GoalCollision,
        FaultCode::GoalUnreachable,
        FaultCode::CapacityExceeded,
        FaultCode::TooLarge,
        FaultCode::NotImplemented,
    ];

    /// The code as it stands on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            FaultCode::InvalidJson => "invalid_json",
            FaultCode::UnknownField => "unknown_field",
            FaultCode::MissingField => "missing_field",
            FaultCode::WrongType => "wrong_type",
            FaultCode::OutOfRange => "out_of_range",
            FaultCode::NotFinite => "not_finite",
            FaultCode::BadQuaternion => "bad_quaternion",
            FaultCode::BadId => "bad_id",
            FaultCode::DuplicateId => "duplicate_id",
            FaultCode::UnknownRobot => "unknown_robot",
            FaultCode::UnknownLink => "unknown_link",
            FaultCode::UnknownJoint => "unknown_joint",
            FaultCode::UnknownBody => "unknown_body",
            FaultCode::UnknownObject => "unknown_object",
            FaultCode::UnknownSurface => "unknown_surface",
            FaultCode::BadUrdf => "bad_urdf",
            FaultCode::BadSrdf => "bad_srdf",
            FaultCode::BadMesh => "bad_mesh",
            FaultCode::UnresolvedUri => "unresolved_uri",
            FaultCode::NotResting => "not_resting",
            FaultCode::Overlap => "overlap",
            FaultCode::InitialCollision => "initial_collision",
            FaultCode::GoalCollision => "goal_collision",
            FaultCode::GoalUnreachable => "goal_unreachable",
            FaultCode::CapacityExceeded => "capacity_exceeded",
            FaultCode::TooLarge => "too_large",
            FaultCode::NotImplemented => "not_implemented",
        }
    }
}

impl fmt::Display for FaultCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl serde::Serialize for FaultCode {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

/// One fault of a document, or one warning about it.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, thiserror::Error)]
#[error("{pointer}: {message} [{code}]")]
pub struct Fault {
    /// JSON pointer (RFC 6901) to the value at fault, or to the object that lacks one.
    pub pointer: String,
    /// The stable code.
    pub code: FaultCode,
    /// What is wrong and what to do.
    pub message: String,
}

/// Collects faults and warnings while a document is walked.
#[derive(Debug, Default)]
pub struct Faults {
    faults: Vec<Fault>,
    warnings: Vec<Fault>,
    max: usize,
    left_out: usize,
}

impl Faults {
    /// A collector that keeps at most `max` faults and counts the rest.
    pub fn new(max: usize) -> Self {
        Self { max: max.max(1), ..Self::default() }
    }

    /// Records a fault.
    pub fn push(&mut self, pointer: impl Into<String>, code: FaultCode, message: impl Into<String>) {
        if self.faults.len() < self.max {
            self.faults.push(Fault { pointer: pointer.into(), code, message: message.into() });
        } else {
            self.left_out += 1;
        }
    }

    /// Records a warning: the document is usable, but its author should know.
    pub fn warn(&mut self, pointer: impl Into<String>, code: FaultCode, message: impl Into<String>) {
        if self.warnings.len() < self.max {
            self.warnings.push(Fault { pointer: pointer.into(), code, message: message.into() });
        }
    }

    /// How many faults were recorded so far, those left out included.
    pub fn count(&self) -> usize {
        self.faults.len() + self.left_out
    }

    /// Whether nothing is wrong so far.
    pub fn is_empty(&self) -> bool {
        self.faults.is_empty()
    }

    /// The warnings when there is no fault, all faults otherwise.
    ///
    /// # Errors
    /// The faults, in the order in which they were found.
    pub fn finish(mut self) -> Result<Vec<Fault>, Vec<Fault>> {
        if self.faults.is_empty() {
            return Ok(self.warnings);
        }
        if self.left_out > 0 {
            let message = format!("{} more faults are not listed; mend these first", self.left_out);
            self.faults.push(Fault { pointer: String::new(), code: FaultCode::TooLarge, message });
        }
        Err(self.faults)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_distinct_and_snake_case() {
        let names: std::collections::BTreeSet<_> = FaultCode::ALL.iter().map(|code| code.as_str()).collect();
        assert_eq!(names.len(), FaultCode::ALL.len());
        assert!(names.iter().all(|name| name.bytes().all(|b| b.is_ascii_lowercase() || b == b'_')));
    }

    #[test]
    fn surplus_faults_are_counted() {
        let mut faults = Faults::new(2);
        for index in 0..5 {
            faults.push(format!("/{index}"), FaultCode::WrongType, "wrong");
        }
        assert_eq!(faults.count(), 5);
        let listed = faults.finish().unwrap_err();
        assert_eq!(listed.len(), 3);
        assert!(listed[2].message.starts_with("3 more"));
    }
}

//! Ids of jobs.

use std::fmt;
use std::str::FromStr;

use uuid::Uuid;

/// A job's id: a UUID of version 7, so that ids sort by the time of creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JobId(Uuid);

/// The text is no job id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a job id is a UUID such as 01890a5d-ac96-774b-bcce-b302099a8057")]
pub struct BadJobId;

impl JobId {
    /// The id as a number that sorts as the id does.
    pub fn as_u128(self) -> u128 {
        self.0.as_u128()
    }

    /// The id that [`JobId::as_u128`] has given as `number`.
    pub fn from_u128(number: u128) -> Self {
        Self(Uuid::from_u128(number))
    }

    /// A fresh id, greater than every id made before in this process.
    pub fn fresh() -> Self {
        Self(Uuid::now_v7())
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

impl FromStr for JobId {
    type Err = BadJobId;

    fn from_str(text: &str) -> Result<Self, BadJobId> {
        Uuid::try_parse(text).map(Self).map_err(|_| BadJobId)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_grow_and_survive_their_text() {
        let ids: Vec<JobId> = (0..1000).map(|_| JobId::fresh()).collect();
        assert!(ids.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(ids[0].to_string().parse(), Ok(ids[0]));
        assert_eq!("switch".parse::<JobId>(), Err(BadJobId));
    }
}

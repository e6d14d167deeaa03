//! Which problems are measured.

use std::fmt;
use std::str::FromStr;

use crate::problem::GuidanceKind;
use crate::scenario::{CatalogEntry, Family, RobotKind, ScenarioError, catalog, generate};

/// How many arms and how many objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Size {
    /// Arms.
    pub arms: usize,
    /// Objects.
    pub objects: usize,
}

/// A size is written as arms, an `x`, objects.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no size; give arms x objects, such as 9x4")]
pub struct SizeError(String);

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.arms, self.objects)
    }
}

impl FromStr for Size {
    type Err = SizeError;

    fn from_str(text: &str) -> Result<Self, SizeError> {
        let wrong = || SizeError(text.chars().take(40).collect());
        let (arms, objects) = text.split_once('x').ok_or_else(wrong)?;
        let number = |part: &str| part.parse().map_err(|_| wrong());
        Ok(Self { arms: number(arms)?, objects: number(objects)? })
    }
}

/// A family at a size; with a seed it is a problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Case {
    /// The family.
    pub family: Family,
    /// The size.
    pub size: Size,
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.family.name(), self.size)
    }
}

/// What [`select`] found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection {
    /// The cases, family after family.
    pub cases: Vec<Case>,
    /// What was asked for but does not exist, because the family does not take such a size.
    pub skipped: Vec<Case>,
}

/// The cases of `families` at `sizes`; without sizes, at those that ship.
///
/// # Errors
/// When a size cannot be laid out or a problem with one of the seeds below `trials` cannot be generated.
pub fn select(families: &[Family], sizes: &[Size], trials: u64) -> Result<Selection, ScenarioError> {
    let mut selection = Selection { cases: Vec::new(), skipped: Vec::new() };
    for &family in families {
        let shipped = || {
            let usual = |entry: &&CatalogEntry| entry.robots == [RobotKind::Iiwa14];
            let entries = catalog().iter().filter(usual).filter(|entry| entry.family == family.name());
            entries.map(|entry| Size { arms: entry.arms, objects: entry.objects }).collect()
        };
        let wanted: Vec<Size> = if sizes.is_empty() { shipped() } else { sizes.to_vec() };
        for size in wanted {
            let case = Case { family, size };
            if selection.cases.contains(&case) || selection.skipped.contains(&case) {
                continue;
            }
            let all = (0..trials.max(1)).map(|seed| generate(family, size.arms, size.objects, seed));
            match all.collect::<Result<Vec<_>, _>>() {
                Ok(_) => selection.cases.push(case),
                Err(
                    ScenarioError::Objects { .. }
                    | ScenarioError::TooFewArms { .. }
                    | ScenarioError::NoRing(_),
                ) => {
                    selection.skipped.push(case);
                }
                Err(error) => return Err(error),
            }
        }
    }
    Ok(selection)
}

/// A guidance's name on the command line and in documents.
pub fn guidance_name(guidance: GuidanceKind) -> &'static str {
    match guidance {
        GuidanceKind::Smart => "smart",
        GuidanceKind::Sequential => "sequential",
        GuidanceKind::Greedy => "greedy",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_written_as_they_are_read() {
        for text in ["2x2", "16x50"] {
            assert_eq!(text.parse::<Size>().map(|size| size.to_string()), Ok(text.to_owned()));
        }
        for bad in ["", "9", "9x", "x4", "9 x 4", "9x4x2", "-1x2"] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
    }

    #[test]
    fn sizes_that_a_family_does_not_take_are_told_apart_from_those_that_cannot_be() {
        let size = |text: &str| text.parse::<Size>().unwrap();
        let sizes = [size("1x2"), size("2x2"), size("2x4"), size("2x2")];
        let found = select(&[Family::Switch, Family::InPlaceSwap], &sizes, 2).unwrap();
        let names = |cases: &[Case]| cases.iter().map(Case::to_string).collect::<Vec<_>>();
        assert_eq!(
            names(&found.cases),
            ["switch/2x2", "switch/2x4", "in_place_swap/1x2", "in_place_swap/2x2"]
        );
        assert_eq!(names(&found.skipped), ["switch/1x2", "in_place_swap/2x4"]);
        assert_eq!(select(&[Family::Random], &[size("17x2")], 1), Err(ScenarioError::Arms(17)));
    }

    #[test]
    fn without_sizes_it_is_what_ships() {
        let found = select(&Family::ALL, &[], 1).unwrap();
        // Cells of other robots are no families of their own.
        let usual = catalog().iter().filter(|entry| entry.robots == [RobotKind::Iiwa14]);
        assert_eq!(found.cases.len(), usual.count());
        assert!(found.skipped.is_empty());
    }
}

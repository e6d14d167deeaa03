//! The scenarios that ship, as they lie in the repository.

use super::RobotKind;

/// A scenario that ships.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CatalogEntry {
    /// Its name: family and size, such as `switch/2x2`.
    pub name: &'static str,
    /// Its family.
    pub family: &'static str,
    /// Which robots it has, dealt out to the arms in turn.
    pub robots: &'static [RobotKind],
    /// How many arms it has.
    pub arms: usize,
    /// How many objects it has.
    pub objects: usize,
    /// The problem document.
    pub text: &'static str,
}

macro_rules! entries {
    ($($folder:literal = $family:literal of $robots:expr => $($arms:literal x $objects:literal),+;)+) => {
        &[$($(
            CatalogEntry {
                name: concat!($folder, "/", $arms, "x", $objects),
                family: $family,
                robots: $robots,
                arms: $arms,
                objects: $objects,
                text: include_str!(
                    concat!("../../scenarios/", $folder, "/", $arms, "x", $objects, ".json")
                ),
            },
        )+)+]
    };
}

const IIWA: &[RobotKind] = &[RobotKind::Iiwa14];

const CATALOG: &[CatalogEntry] = entries! {
    "switch" = "switch" of IIWA => 2 x 2, 4 x 4, 6 x 4, 9 x 4;
    "side_to_side" = "side_to_side" of IIWA => 2 x 2, 4 x 4, 6 x 4, 9 x 4;
    "random" = "random" of IIWA => 2 x 2, 4 x 4, 6 x 4, 9 x 4, 9 x 20, 16 x 50;
    "in_place_swap" = "in_place_swap" of IIWA => 1 x 2, 2 x 2, 3 x 2;
    "derangement" = "derangement" of IIWA => 1 x 4, 2 x 6;
    "ring" = "ring" of IIWA => 12 x 8;
    "switch_ur_type" = "switch" of &[RobotKind::UrType] => 2 x 2;
    "switch_panda_type" = "switch" of &[RobotKind::PandaType] => 2 x 2;
    "switch_mixed" = "switch" of &RobotKind::ALL => 3 x 2;
};

/// All scenarios that ship.
pub fn catalog() -> &'static [CatalogEntry] {
    CATALOG
}

/// The scenario called `name`.
pub fn find(name: &str) -> Option<&'static CatalogEntry> {
    CATALOG.iter().find(|entry| entry.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Family, generate_with, to_text};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem};

    /// The seed of the files.
    const SEED: u64 = 0;

    #[test]
    fn files_are_what_the_generator_makes_and_read_without_faults() {
        for entry in catalog() {
            let family: Family = entry.family.parse().unwrap();
            let made =
                to_text(&generate_with(family, entry.arms, entry.objects, SEED, entry.robots).unwrap());
            if std::env::var_os("QUADRILLE_WRITE_SCENARIOS").is_some() {
                let path = format!("{}/scenarios/{}.json", env!("CARGO_MANIFEST_DIR"), entry.name);
                std::fs::write(path, &made).unwrap();
                continue;
            }
            assert_eq!(entry.text, made, "{} differs from the generator", entry.name);
            let read = read_problem(entry.text.as_bytes(), &LibraryOnly, &ReadLimits::default());
            assert!(read.is_ok_and(|read| read.warnings.is_empty()), "{}", entry.name);
        }
    }

    #[test]
    fn names_are_found() {
        assert_eq!(find("switch/2x2").map(|entry| entry.objects), Some(2));
        assert!(find("switch/3x3").is_none());
    }
}

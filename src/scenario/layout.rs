//! Where arms and tables stand: a grid of arms (DESIGN section 12), transfer along x, lanes along y,
//! a table at each end; or a ring of arms with a table before each.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use super::ScenarioError;

/// Most arms of a generated cell.
pub const MAX_ARMS: usize = 16;

/// Distance (m) between neighbouring arms.
pub const SPACING: f64 = 1.10;

/// Height (m) of the arms' bases.
pub const PEDESTAL_HEIGHT: f64 = 0.40;

/// Height (m) of the tables' tops.
pub const TABLE_TOP: f64 = 0.65;

/// Depth (m) of a table along x, and its width along y over one lane.
pub const TABLE_DEPTH: f64 = 0.52;

/// Distance (m) along x from the nearest arm's axis to a table's middle.
pub const TABLE_OFFSET: f64 = 0.56;

/// Half of the usable depth of a table, and how far the usable width goes beyond the outer lanes (m).
const PATCH_HALF: f64 = 0.16;

/// Greatest distance (m) of a usable place from the nearest arm's axis: that of the far corners of
/// a lane's patch, within which every pose is reached from above.
const USABLE_RADIUS: f64 = 0.7376;

/// Where arms and tables of a cell stand.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// The arms.
    pub arms: Vec<ArmPlace>,
    /// The tables.
    pub tables: Vec<Table>,
    /// Arms one after the other from table to table in a grid; 0 in a ring.
    pub depth: usize,
}

/// Where an arm stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmPlace {
    /// Its axis (m).
    pub xy: [f64; 2],
    /// How its base is turned about z (rad).
    pub yaw: f64,
}

/// A table.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Its name.
    pub id: String,
    /// Its middle (m).
    pub middle: [f64; 2],
    /// How it is turned about z (rad).
    pub yaw: f64,
    /// Its extents (m) along its own axes.
    pub size: [f64; 2],
    /// Half extents (m) of its usable part around its middle.
    pub usable_half: [f64; 2],
}

impl Table {
    /// The point at `offset` (m, along the table's own axes) from its middle.
    pub fn at(&self, offset: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        [
            self.middle[0] + offset[0] * cos - offset[1] * sin,
            self.middle[1] + offset[0] * sin + offset[1] * cos,
        ]
    }

    /// Where the point `place` is from its middle, along its own axes (m).
    fn offset_of(&self, place: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.yaw.sin_cos();
        let from = [place[0] - self.middle[0], place[1] - self.middle[1]];
        [from[0] * cos + from[1] * sin, from[1] * cos - from[0] * sin]
    }
}

impl Layout {
    /// The grid of `arms` arms that is nearest to a square, deeper than wide; a prime number makes
    /// one row. Table 0 stands before the first arms (negative x), table 1 behind the last; a single
    /// arm has the first only.
    ///
    /// # Errors
    /// For no arms, or more than [`MAX_ARMS`].
    pub fn grid(arms: usize) -> Result<Self, ScenarioError> {
        if !(1..=MAX_ARMS).contains(&arms) {
            return Err(ScenarioError::Arms(arms));
        }
        let lanes = (1..=arms)
            .filter(|lanes| arms.is_multiple_of(*lanes) && lanes * lanes <= arms)
            .max()
            .unwrap_or(1);
        let depth = arms / lanes;
        let yaw = if lanes == 1 { FRAC_PI_2 } else { FRAC_PI_4 };
        let rows = (0..lanes).flat_map(|lane| (0..depth).map(move |i| (i, lane)));
        let place =
            |(i, lane): (usize, usize)| ArmPlace { xy: [SPACING * i as f64, SPACING * lane as f64], yaw };
        let across = SPACING * (lanes - 1) as f64;
        let table = |id: &str, x: f64| Table {
            id: id.to_owned(),
            middle: [x, across / 2.0],
            yaw: 0.0,
            size: [TABLE_DEPTH, TABLE_DEPTH + across],
            usable_half: [PATCH_HALF, across / 2.0 + PATCH_HALF],
        };
        let mut tables = vec![
            table("table_a", -TABLE_OFFSET),
            table("table_b", SPACING * (depth - 1) as f64 + TABLE_OFFSET),
        ];
        tables.truncate(arms.min(2));
        Ok(Self { arms: rows.map(place).collect(), tables, depth })
    }

    /// `arms` arms on a circle, each [`SPACING`] from the next and with its back to the middle, each
    /// with a table of its own before it that no other reaches.
    ///
    /// # Errors
    /// For fewer than 3 arms, or more than [`MAX_ARMS`].
    pub fn ring(arms: usize) -> Result<Self, ScenarioError> {
        if arms > MAX_ARMS {
            return Err(ScenarioError::Arms(arms));
        }
        if arms < 3 {
            return Err(ScenarioError::NoRing(arms));
        }
        let radius = SPACING / (2.0 * (PI / arms as f64).sin());
        let turns = (0..arms).map(|index| TAU * index as f64 / arms as f64);
        let on = |radius: f64, yaw: f64| [radius * yaw.cos(), radius * yaw.sin()];
        let tables = turns.clone().enumerate().map(|(index, yaw)| Table {
            id: format!("table_{}", index + 1),
            middle: on(radius + TABLE_OFFSET, yaw),
            yaw,
            size: [TABLE_DEPTH, TABLE_DEPTH],
            usable_half: [PATCH_HALF, PATCH_HALF],
        });
        Ok(Self {
            tables: tables.collect(),
            arms: turns.map(|yaw| ArmPlace { xy: on(radius, yaw), yaw }).collect(),
            depth: 0,
        })
    }

    /// Whether every arm has a table of its own, all around.
    pub fn is_ring(&self) -> bool {
        self.depth == 0
    }

    /// Whether objects go from one table to the other by one handoff.
    pub fn are_one_handoff_apart(&self, one: usize, other: usize) -> bool {
        let count = self.tables.len();
        match self.depth {
            0 => (one + 1) % count == other || (other + 1) % count == one,
            depth => depth == 2 && one != other,
        }
    }

    /// Whether an object may stand at `place` (x, y) of table `table`.
    pub fn is_usable(&self, table: usize, place: [f64; 2]) -> bool {
        let Some(table) = self.tables.get(table) else { return false };
        let offset = table.offset_of(place);
        let inside = (0..2).all(|axis| offset[axis].abs() <= table.usable_half[axis] + 1.0e-9);
        let distance = |arm: &ArmPlace| (place[0] - arm.xy[0]).hypot(place[1] - arm.xy[1]);
        inside && self.arms.iter().any(|arm| distance(arm) <= USABLE_RADIUS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grids_of_the_design() {
        let grids =
            [(1, 1, 1), (2, 2, 1), (3, 3, 1), (4, 2, 2), (6, 3, 2), (9, 3, 3), (12, 4, 3), (16, 4, 4)];
        for (arms, depth, lanes) in grids {
            let layout = Layout::grid(arms).unwrap();
            assert_eq!((layout.arms.len(), layout.depth), (arms, depth));
            assert!((layout.arms[arms - 1].xy[0] - SPACING * (depth - 1) as f64).abs() < 1e-12);
            assert!((layout.arms[arms - 1].xy[1] - SPACING * (lanes - 1) as f64).abs() < 1e-12);
            assert_eq!(layout.tables.len(), arms.min(2));
        }
        assert_eq!(Layout::grid(0), Err(ScenarioError::Arms(0)));
        assert_eq!(Layout::grid(17), Err(ScenarioError::Arms(17)));
    }

    #[test]
    fn tables_stand_at_both_ends() {
        let layout = Layout::grid(9).unwrap();
        assert!((layout.tables[0].size[1] - 2.72).abs() < 1e-12);
        let [x, y] = layout.tables[1].middle;
        assert!((x - 2.76).abs() < 1e-12 && (y - 1.10).abs() < 1e-12);
        assert!(layout.is_usable(0, [-0.72, 0.16]) && layout.is_usable(0, [-0.40, 1.65]));
        // Too far from both arms, and off the patch.
        assert!(!layout.is_usable(0, [-0.72, 0.55]) && !layout.is_usable(0, [-0.56, -0.17]));
    }

    #[test]
    fn a_ring_closes_and_every_table_is_one_arms_own() {
        let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        for arms in [3, 5, 12, 16] {
            let ring = Layout::ring(arms).unwrap();
            for (index, arm) in ring.arms.iter().enumerate() {
                let next = &ring.arms[(index + 1) % arms];
                assert!((distance(arm.xy, next.xy) - SPACING).abs() < 1e-9);
                assert!(ring.are_one_handoff_apart(index, (index + 1) % arms));
                for (number, table) in ring.tables.iter().enumerate() {
                    let corners = [[-0.16, -0.16], [-0.16, 0.16], [0.16, -0.16], [0.16, 0.16]];
                    for corner in corners.map(|corner| table.at(corner)) {
                        assert!(ring.is_usable(number, corner), "{arms} arms, table {number}");
                        // The arm's reach in the horizontal ends about 0.85 m from its axis.
                        assert_eq!(number == index, distance(arm.xy, corner) < 0.9);
                    }
                }
            }
        }
        assert!(!Layout::ring(12).unwrap().are_one_handoff_apart(0, 2));
        assert_eq!(Layout::ring(2), Err(ScenarioError::NoRing(2)));
        assert_eq!(Layout::ring(17), Err(ScenarioError::Arms(17)));
    }
}

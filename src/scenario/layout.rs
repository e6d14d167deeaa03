//! Where arms and tables stand (DESIGN section 12): a grid of arms, transfer along x, lanes along
//! y, a table at each end.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

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

/// A grid of arms between tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Arms one after the other along the transfer direction.
    pub depth: usize,
    /// Rows beside each other.
    pub lanes: usize,
}

/// One of the two ends of the cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Before the first arms (negative x).
    A,
    /// Behind the last arms.
    B,
}

impl Layout {
    /// The grid of `arms` arms that is nearest to a square, deeper than wide; a prime number makes
    /// one row.
    ///
    /// # Errors
    /// For no arms, or more than [`MAX_ARMS`].
    pub fn new(arms: usize) -> Result<Self, ScenarioError> {
        if !(1..=MAX_ARMS).contains(&arms) {
            return Err(ScenarioError::Arms(arms));
        }
        let lanes = (1..=arms)
            .filter(|lanes| arms.is_multiple_of(*lanes) && lanes * lanes <= arms)
            .max()
            .unwrap_or(1);
        Ok(Self { depth: arms / lanes, lanes })
    }

    /// Positions (x, y) of the arms, row after row.
    pub fn arms(&self) -> Vec<[f64; 2]> {
        let rows = (0..self.lanes).flat_map(|lane| (0..self.depth).map(move |i| (i, lane)));
        rows.map(|(i, lane)| [SPACING * i as f64, SPACING * lane as f64]).collect()
    }

    /// How the arms are turned about z (rad).
    pub fn yaw(&self) -> f64 {
        if self.lanes == 1 { FRAC_PI_2 } else { FRAC_PI_4 }
    }

    /// The ends that have a table: one arm has one.
    pub fn ends(&self) -> &'static [End] {
        if self.depth * self.lanes == 1 { &[End::A] } else { &[End::A, End::B] }
    }

    /// The middle (x, y) of the table at `end`.
    pub fn table(&self, end: End) -> [f64; 2] {
        let x = match end {
            End::A => -TABLE_OFFSET,
            End::B => SPACING * (self.depth - 1) as f64 + TABLE_OFFSET,
        };
        [x, SPACING * (self.lanes - 1) as f64 / 2.0]
    }

    /// Width (m) of a table along y.
    pub fn table_width(&self) -> f64 {
        TABLE_DEPTH + SPACING * (self.lanes - 1) as f64
    }

    /// Half extents (m) of the usable part of a table around its middle.
    pub fn usable_half(&self) -> [f64; 2] {
        [PATCH_HALF, SPACING * (self.lanes - 1) as f64 / 2.0 + PATCH_HALF]
    }

    /// Whether an object may stand at `place` (x, y) of the table at `end`.
    pub fn is_usable(&self, end: End, place: [f64; 2]) -> bool {
        let middle = self.table(end);
        let half = self.usable_half();
        let inside = (0..2).all(|axis| (place[axis] - middle[axis]).abs() <= half[axis] + 1.0e-9);
        inside && self.arms().iter().any(|arm| (place[0] - arm[0]).hypot(place[1] - arm[1]) <= USABLE_RADIUS)
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
            assert_eq!(Layout::new(arms), Ok(Layout { depth, lanes }));
        }
        assert_eq!(Layout::new(0), Err(ScenarioError::Arms(0)));
        assert_eq!(Layout::new(17), Err(ScenarioError::Arms(17)));
    }

    #[test]
    fn tables_stand_at_both_ends() {
        let layout = Layout::new(9).unwrap();
        assert!((layout.table_width() - 2.72).abs() < 1e-12);
        let [x, y] = layout.table(End::B);
        assert!((x - 2.76).abs() < 1e-12 && (y - 1.10).abs() < 1e-12);
        assert!(layout.is_usable(End::A, [-0.72, 0.16]) && layout.is_usable(End::A, [-0.40, 1.65]));
        // Too far from both arms, and off the patch.
        assert!(!layout.is_usable(End::A, [-0.72, 0.55]) && !layout.is_usable(End::A, [-0.56, -0.17]));
    }
}

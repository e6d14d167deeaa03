//! Random places on tables, apart from each other.

use std::f64::consts::PI;

use rand::Rng as _;

use super::layout::{End, Layout};
use crate::run::Rng;

/// Edge (m) of a cube.
pub const CUBE: f64 = 0.06;

/// Least distance (m) between footprints.
const GAP: f64 = 0.005;

/// Attempts to place one footprint before all of them are placed anew.
const TRIES: usize = 2000;

/// Attempts to place all of them.
const RESTARTS: usize = 50;

/// A place of a cube: the middle of its footprint, and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Which table.
    pub end: End,
    /// Middle (m).
    pub xy: [f64; 2],
    /// Turn about z (rad).
    pub yaw: f64,
}

impl Place {
    /// Whether the footprints are apart by the gap at least.
    pub fn is_apart(&self, other: &Self) -> bool {
        self.end != other.end || separation(self, other).max(separation(other, self)) >= GAP
    }
}

/// The largest gap between the two squares along the axes of `one`: a lower bound on their
/// distance.
fn separation(one: &Place, other: &Place) -> f64 {
    let offset = [other.xy[0] - one.xy[0], other.xy[1] - one.xy[1]];
    let turn = other.yaw - one.yaw;
    let reach = CUBE / 2.0 * (1.0 + turn.cos().abs() + turn.sin().abs());
    let (sin, cos) = one.yaw.sin_cos();
    let along = [offset[0] * cos + offset[1] * sin, -offset[0] * sin + offset[1] * cos];
    along[0].abs().max(along[1].abs()) - reach
}

/// One place on each of `ends`, in this order, all apart from each other: uniform over the usable
/// part of the table, turned uniformly. Positions are whole tenths of a millimetre. `None` when
/// there is no room.
pub fn places(layout: &Layout, ends: &[End], rng: &mut Rng) -> Option<Vec<Place>> {
    (0..RESTARTS).find_map(|_| try_places(layout, ends, rng))
}

fn try_places(layout: &Layout, ends: &[End], rng: &mut Rng) -> Option<Vec<Place>> {
    let mut placed: Vec<Place> = Vec::with_capacity(ends.len());
    for end in ends {
        let free = (0..TRIES).find_map(|_| {
            let place = sample(layout, *end, rng)?;
            placed.iter().all(|other| place.is_apart(other)).then_some(place)
        });
        placed.push(free?);
    }
    Some(placed)
}

fn sample(layout: &Layout, end: End, rng: &mut Rng) -> Option<Place> {
    let middle = layout.table(end);
    let half = layout.usable_half();
    let mut coordinate = |axis: usize| {
        let offset = half[axis] * (2.0 * rng.random::<f64>() - 1.0);
        ((middle[axis] + offset) * 1.0e4).round() / 1.0e4
    };
    let xy = [coordinate(0), coordinate(1)];
    let yaw = PI * (2.0 * rng.random::<f64>() - 1.0);
    layout.is_usable(end, xy).then_some(Place { end, xy, yaw })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Seed;

    /// Distance of two convex polygons that do not overlap, by brute force over sampled borders.
    fn border(place: &Place) -> Vec<[f64; 2]> {
        let (sin, cos) = place.yaw.sin_cos();
        let half = CUBE / 2.0;
        let mut points = Vec::new();
        for step in 0..=60 {
            let along = -half + CUBE * f64::from(step) / 60.0;
            for [x, y] in [[along, half], [along, -half], [half, along], [-half, along]] {
                points.push([place.xy[0] + cos * x - sin * y, place.xy[1] + sin * x + cos * y]);
            }
        }
        points
    }

    #[test]
    fn places_are_usable_and_apart() {
        let layout = Layout::new(4).unwrap();
        let ends = [[End::A; 8], [End::B; 8]].concat();
        for seed in 0..5 {
            let placed = places(&layout, &ends, &mut Seed(seed).stream("test")).unwrap();
            for (index, one) in placed.iter().enumerate() {
                assert!(layout.is_usable(one.end, one.xy));
                for other in placed[..index].iter().filter(|other| other.end == one.end) {
                    let (a, b) = (border(one), border(other));
                    let least = a
                        .iter()
                        .flat_map(|p| b.iter().map(move |q| (p[0] - q[0]).hypot(p[1] - q[1])))
                        .fold(f64::INFINITY, f64::min);
                    assert!(least >= GAP - 1e-9, "{least}");
                }
            }
        }
    }

    #[test]
    fn a_full_table_is_told() {
        let layout = Layout::new(1).unwrap();
        assert!(places(&layout, &[End::A; 60], &mut Seed(0).stream("test")).is_none());
    }
}

//! Random places on tables, apart from each other.

use std::f64::consts::PI;

use rand::Rng as _;

use super::layout::Layout;
use crate::run::Rng;

/// Edge (m) of a cube.
pub const CUBE: f64 = 0.06;

/// Least distance (m) between footprints.
const GAP: f64 = 0.005;

/// Attempts to place one footprint before all of them are placed anew.
const TRIES: usize = 2000;

/// Attempts to place all of them.
const RESTARTS: usize = 50;

/// Horizontal distance (m) from a cube to the wrist of an arm that grips it at an edge: 0.276 m from
/// TCP to wrist, at 45 degrees.
const WRIST_AT_CONTACT: f64 = 0.195;

/// The same 8 cm before the contact.
const WRIST_AT_APPROACH: f64 = 0.252;

/// Least and greatest horizontal distance (m) of the wrist from the arm's axis.
const WRIST_NEAREST: f64 = 0.48;
const WRIST_FARTHEST: f64 = 0.76;

/// Greatest cosine of the angle between the direction to the gripped edge and the one away from
/// the arm.
const MOST_OUTWARDS: f64 = 0.58;

/// A place of a cube: the middle of its footprint, and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Which table.
    pub table: usize,
    /// Middle (m).
    pub xy: [f64; 2],
    /// Turn about z (rad).
    pub yaw: f64,
}

impl Place {
    /// Whether the footprints are apart by the gap at least.
    pub fn is_apart(&self, other: &Self) -> bool {
        self.table != other.table || separation(self, other).max(separation(other, self)) >= GAP
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

/// One place on each of `tables`, in this order, all apart from each other: uniform over the usable
/// part of the table, turned uniformly. Positions are whole tenths of a millimetre. `None` when
/// there is no room.
pub fn places(layout: &Layout, tables: &[usize], rng: &mut Rng) -> Option<Vec<Place>> {
    (0..RESTARTS).find_map(|_| try_places(layout, tables, &|_, _| true, rng))
}

/// Starts and goals, as [`places`], of cubes that change tables. Where they go from one arm
/// straight to the next, a start and its goal are drawn again until one handoff can serve them.
pub fn transfers(
    layout: &Layout,
    starts: &[usize],
    goals: &[usize],
    rng: &mut Rng,
) -> Option<(Vec<Place>, Vec<Place>)> {
    let tables = [starts, goals].concat();
    let serves = |placed: &[Place], place: &Place| match placed.len().checked_sub(starts.len()) {
        Some(cube) if layout.are_one_handoff_apart(starts[cube], place.table) => {
            one_handoff_serves(layout, &placed[cube], place)
        }
        _ => true,
    };
    let mut placed = (0..RESTARTS).find_map(|_| try_places(layout, &tables, &serves, rng))?;
    let goals = placed.split_off(starts.len());
    Some((placed, goals))
}

/// Whether the cube can be gripped at an upper edge at `start` and at the opposite edge at `goal`.
/// A cube that stands on a table offers its top and its upper edges; of these only two opposite
/// edges leave room for both hands at once.
fn one_handoff_serves(layout: &Layout, start: &Place, goal: &Place) -> bool {
    let (taken, released) = (grippable_edges(layout, start), grippable_edges(layout, goal));
    (0..4).any(|edge| taken[edge] && released[(edge + 2) % 4])
}

/// Which of the upper edges, counted from the cube's +x counterclockwise, the nearest arm can grip
/// at 45 degrees. Its wrist is farther out on that side: it must neither come too near to the arm's
/// own axis nor too far from it, and the tool must not point back at the base too squarely. The
/// bounds were found by inverse kinematics and collision checks and lie within what is possible.
fn grippable_edges(layout: &Layout, place: &Place) -> [bool; 4] {
    let mut best: Option<(f64, [f64; 2])> = None;
    for arm in &layout.arms {
        let from_axis = [place.xy[0] - arm.xy[0], place.xy[1] - arm.xy[1]];
        let distance = from_axis[0].hypot(from_axis[1]);
        if best.is_none_or(|(least, _)| distance < least) {
            best = Some((distance, from_axis));
        }
    }
    let Some((distance, [x, y])) = best else { return [false; 4] };
    std::array::from_fn(|edge| {
        let (sin, cos) = (place.yaw + PI / 2.0 * edge as f64).sin_cos();
        let at = |offset: f64| (x + offset * cos).hypot(y + offset * sin);
        let outwards = (x * cos + y * sin) / distance;
        at(WRIST_AT_CONTACT).min(at(WRIST_AT_APPROACH)) >= WRIST_NEAREST
            && at(WRIST_AT_APPROACH) <= WRIST_FARTHEST
            && outwards <= MOST_OUTWARDS
    })
}

fn try_places(
    layout: &Layout,
    tables: &[usize],
    suits: &dyn Fn(&[Place], &Place) -> bool,
    rng: &mut Rng,
) -> Option<Vec<Place>> {
    let mut placed: Vec<Place> = Vec::with_capacity(tables.len());
    for &table in tables {
        let free = (0..TRIES).find_map(|_| {
            let place = sample(layout, table, rng)?;
            (placed.iter().all(|other| place.is_apart(other)) && suits(&placed, &place)).then_some(place)
        });
        placed.push(free?);
    }
    Some(placed)
}

fn sample(layout: &Layout, table: usize, rng: &mut Rng) -> Option<Place> {
    let own = layout.tables.get(table)?;
    let mut coordinate = |axis: usize| own.usable_half[axis] * (2.0 * rng.random::<f64>() - 1.0);
    let offset = [coordinate(0), coordinate(1)];
    let xy = own.at(offset).map(|value| (value * 1.0e4).round() / 1.0e4);
    let yaw = PI * (2.0 * rng.random::<f64>() - 1.0);
    layout.is_usable(table, xy).then_some(Place { table, xy, yaw })
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
        let layout = Layout::grid(4).unwrap();
        let tables = [[0; 8], [1; 8]].concat();
        for seed in 0..5 {
            let placed = places(&layout, &tables, &mut Seed(seed).stream("test")).unwrap();
            for (index, one) in placed.iter().enumerate() {
                assert!(layout.is_usable(one.table, one.xy));
                for other in placed[..index].iter().filter(|other| other.table == one.table) {
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
    fn starts_and_goals_offer_opposite_edges() {
        let layout = Layout::grid(2).unwrap();
        for seed in 0..20 {
            let mut rng = Seed(seed).stream("test");
            let (starts, goals) = transfers(&layout, &[0, 1], &[1, 0], &mut rng).unwrap();
            for (start, goal) in starts.iter().zip(&goals) {
                assert!(one_handoff_serves(&layout, start, goal));
            }
        }
        // Both far out and turned by 45 degrees: only the two inner edges can be gripped, and these
        // are the same on both tables once the cube is turned by half a turn.
        let far = |table, x: f64, yaw: f64| Place { table, xy: [x, 0.0], yaw };
        let (here, there) = (far(0, -0.72, PI / 4.0), far(1, 1.82, PI / 4.0 + PI));
        assert!(!one_handoff_serves(&layout, &here, &there));
        assert!(one_handoff_serves(&layout, &here, &far(1, 1.82, PI / 4.0)));
    }

    #[test]
    fn a_full_table_is_told() {
        let layout = Layout::grid(1).unwrap();
        assert!(places(&layout, &[0; 60], &mut Seed(0).stream("test")).is_none());
    }
}

//! Packing of equal footprints on a rectangle around what is already there.

use super::footprint::Footprint;

/// Shifts of the lattice that are tried along each axis.
const SHIFTS: usize = 5;
/// Step (m) of the fine grid on which gaps that the lattice leaves are filled.
const FINE_STEP: f64 = 0.01;
/// The fine grid is coarsened so that it has at most this many nodes.
const MOST_NODES: f64 = 6000.0;

/// Where footprints may go.
#[derive(Debug, Clone)]
pub(super) struct Bed<'a> {
    /// Half extents of the rectangle (m); its centre is the frame's origin.
    pub(super) half_extents: [f64; 2],
    /// What stands there or will stand there.
    pub(super) taken: &'a [Footprint],
    /// Least distance (m) between any two footprints.
    pub(super) gap: f64,
}

impl Bed<'_> {
    fn admits(&self, footprint: &Footprint, placed: &[Footprint]) -> bool {
        let (low, high) = footprint.bounds();
        let inside = (0..2).all(|axis| {
            low[axis] >= -self.half_extents[axis] - 1e-9 && high[axis] <= self.half_extents[axis] + 1e-9
        });
        inside && !self.taken.iter().chain(placed).any(|other| footprint.is_nearer(other, self.gap - 1e-9))
    }

    /// The range (m) of shifts that keep `footprint` inside along `axis`; `None` when it is too large.
    fn range(&self, footprint: &Footprint, axis: usize) -> Option<(f64, f64)> {
        let (low, high) = footprint.bounds();
        let range = (-self.half_extents[axis] - low[axis], self.half_extents[axis] - high[axis]);
        if range.0 <= range.1 {
            return Some(range);
        }
        (range.0 - range.1 < 1e-9).then_some((range.1, range.1))
    }
}

/// Copies of a footprint side by side.
#[derive(Debug, Default)]
pub(super) struct Packing {
    /// How far each copy is shifted (m).
    pub(super) shifts: Vec<[f64; 2]>,
    /// Distance (m) between neighbours on the lattice, the larger of both axes.
    pub(super) pitch: f64,
    /// Whether packing ended because there were copies enough; else no room for another was found.
    pub(super) more_may_fit: bool,
}

/// Shifts at which copies of `footprint` can stand on `bed` all at once, about `wanted` of them if
/// there is room, spread evenly; fewer, packed as tightly as a lattice and a greedy filling find,
/// if not. A bed that holds one copy at a node of the fine grid gets at least one.
///
/// What is free of one lattice, the same for every arrangement of what is taken, is preferred where
/// that is `enough`: reach there need not be found out anew for each arrangement.
pub(super) fn pack(footprint: &Footprint, bed: &Bed<'_>, wanted: usize, enough: usize) -> Packing {
    let (Some(x), Some(y)) = (bed.range(footprint, 0), bed.range(footprint, 1)) else {
        return Packing::default();
    };
    let (low, high) = footprint.bounds();
    let tight = [0, 1].map(|axis| high[axis] - low[axis] + bed.gap);
    // The tightest lattice has (range / pitch + 1) nodes each way; widen it to what is wanted.
    let nodes = ((x.1 - x.0) / tight[0] + 1.0) * ((y.1 - y.0) / tight[1] + 1.0);
    let widen = (nodes / wanted.max(1) as f64).sqrt().max(1.0);
    let pitch = widen * tight[0].max(tight[1]);
    let wide = tight.map(|pitch| pitch * widen);
    let fixed = free_nodes(footprint, bed, [x, y], wide, [0, 0]);
    if fixed.len() >= enough.min(wanted) && !fixed.is_empty() {
        return Packing { shifts: fixed, pitch, more_may_fit: true };
    }
    let mut best = lattice(footprint, bed, [x, y], wide);
    if best.len() < wanted && widen > 1.0 {
        // Much is taken: the room that is left must be used better.
        let dense = lattice(footprint, bed, [x, y], tight);
        if dense.len() > best.len() {
            best = dense;
        }
    }
    let more_may_fit = best.len() >= wanted || !fill(footprint, bed, [x, y], wanted, &mut best);
    Packing { shifts: best, pitch, more_may_fit }
}

/// The largest set of free lattice nodes over a few shifts of the lattice.
fn lattice(footprint: &Footprint, bed: &Bed<'_>, ranges: [(f64, f64); 2], pitch: [f64; 2]) -> Vec<[f64; 2]> {
    let mut best = Vec::new();
    for shift in 0..SHIFTS * SHIFTS {
        let free = free_nodes(footprint, bed, ranges, pitch, [shift % SHIFTS, shift / SHIFTS]);
        if free.len() > best.len() {
            best = free;
        }
    }
    best
}

/// The free nodes of the lattice, shifted along each axis in one of [`SHIFTS`] ways.
fn free_nodes(
    footprint: &Footprint,
    bed: &Bed<'_>,
    ranges: [(f64, f64); 2],
    pitch: [f64; 2],
    shift: [usize; 2],
) -> Vec<[f64; 2]> {
    let [xs, ys] = [0, 1].map(|axis| {
        let (from, to) = ranges[axis];
        let count = ((to - from) / pitch[axis] + 1e-9).floor() as usize;
        // What the lattice leaves at the end is the play of its start; the middle comes first.
        let play = (to - from - count as f64 * pitch[axis]).max(0.0);
        let order = [0.5, 0.0, 1.0, 0.25, 0.75][shift[axis]];
        (0..=count).map(|k| from + play * order + k as f64 * pitch[axis]).collect::<Vec<f64>>()
    });
    let nodes = ys.iter().flat_map(|y| xs.iter().map(move |x| [*x, *y]));
    nodes.filter(|node| bed.admits(&footprint.shifted(*node), &[])).collect()
}

/// Adds copies at nodes of a fine grid, row by row, until there are `wanted`; whether it came to the
/// end of the grid, so that none of its nodes admits another one.
fn fill(
    footprint: &Footprint,
    bed: &Bed<'_>,
    ranges: [(f64, f64); 2],
    wanted: usize,
    spots: &mut Vec<[f64; 2]>,
) -> bool {
    let area = (ranges[0].1 - ranges[0].0) * (ranges[1].1 - ranges[1].0);
    let step = FINE_STEP.max((area / MOST_NODES).sqrt());
    let axis = |(from, to): (f64, f64)| {
        let count = ((to - from) / step).ceil().max(1.0) as usize;
        (0..=count).map(move |k| from + (to - from) * k as f64 / count as f64)
    };
    let mut placed: Vec<Footprint> = spots.iter().map(|spot| footprint.shifted(*spot)).collect();
    for y in axis(ranges[1]) {
        for x in axis(ranges[0]) {
            if spots.len() >= wanted {
                return false;
            }
            let candidate = footprint.shifted([x, y]);
            if bed.admits(&candidate, &placed) {
                placed.push(candidate);
                spots.push([x, y]);
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{PlacedShape, Pose, Shape, Vec3, pose_from_parts};
    use proptest::prelude::*;

    fn cuboid(x: f64, y: f64, at: Pose) -> Footprint {
        let shape = Shape::Box { half_extents: Vec3::new(x, y, 0.03) };
        Footprint::of(&[PlacedShape { shape, pose: Pose::identity() }], &at)
    }

    fn at(x: f64, y: f64, yaw: f64) -> Pose {
        pose_from_parts([x, y, 0.03], [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()])
    }

    proptest! {
        /// Nothing sticks out, and nothing is nearer to anything than the gap.
        #[test]
        fn packings_are_sound(
            w in 0.02..0.4_f64, d in 0.02..0.4_f64, a in 0.01..0.06_f64, b in 0.01..0.06_f64, gap in 0.0..0.03_f64,
            others in prop::collection::vec((-0.4..0.4_f64, -0.4..0.4_f64, 0.0..3.0_f64), 0..6), wanted in 0..60_usize,
        ) {
            let footprint = cuboid(a, b, at(0.0, 0.0, 0.0));
            let taken: Vec<Footprint> = others.iter().map(|&(x, y, yaw)| cuboid(0.03, 0.03, at(x, y, yaw))).collect();
            let bed = Bed { half_extents: [w, d], taken: &taken, gap };
            let packing = pack(&footprint, &bed, wanted, usize::MAX);
            if let (false, Some(x), Some(y)) = (packing.more_may_fit, bed.range(&footprint, 0), bed.range(&footprint, 1)) {
                let mut more = packing.shifts.clone();
                prop_assert!(fill(&footprint, &bed, [x, y], usize::MAX, &mut more));
                prop_assert_eq!(&more, &packing.shifts);
            }
            let spots: Vec<Footprint> = packing.shifts.iter().map(|s| footprint.shifted(*s)).collect();
            for (index, spot) in spots.iter().enumerate() {
                let (low, high) = spot.bounds();
                prop_assert!(low[0] >= -w - 2e-9 && low[1] >= -d - 2e-9 && high[0] <= w + 2e-9 && high[1] <= d + 2e-9);
                for other in taken.iter().chain(&spots[..index]) {
                    prop_assert!(spot.distance(other) >= gap - 2e-9);
                }
            }
        }

        /// An empty bed holds what a lattice holds, if that much is wanted.
        #[test]
        fn empty_beds_are_filled(columns in 1..7_usize, rows in 1..7_usize, a in 0.02..0.06_f64, gap in 0.0..0.03_f64) {
            let side = |count: usize| count as f64 * a + 0.5 * (count as f64 - 1.0) * gap;
            let footprint = cuboid(a, a, at(0.0, 0.0, 0.0));
            let bed = Bed { half_extents: [side(columns), side(rows)], taken: &[], gap };
            let all = pack(&footprint, &bed, 100, usize::MAX);
            prop_assert!(all.shifts.len() >= columns * rows && !all.more_may_fit);
            let few = pack(&footprint, &bed, 1, usize::MAX);
            prop_assert!((1..=4).contains(&few.shifts.len()) && few.more_may_fit);
        }
    }

    #[test]
    fn the_last_gap_is_found() {
        // A row with room for one more, off the lattice.
        let taken = [cuboid(0.03, 0.03, at(-0.12, 0.0, 0.0)), cuboid(0.03, 0.03, at(0.11, 0.0, 0.2))];
        let bed = Bed { half_extents: [0.155, 0.04], taken: &taken, gap: 0.01 };
        assert_eq!(pack(&cuboid(0.03, 0.03, at(0.0, 0.0, 0.0)), &bed, 8, 8).shifts.len(), 2);
        let tight = Bed { half_extents: [0.155, 0.04], taken: &taken, gap: 0.06 };
        assert_eq!(pack(&cuboid(0.03, 0.03, at(0.0, 0.0, 0.0)), &tight, 8, 8).shifts.len(), 0);
        let small = Bed { half_extents: [0.029, 0.1], taken: &[], gap: 0.0 };
        assert!(pack(&cuboid(0.03, 0.03, at(0.0, 0.0, 0.0)), &small, 8, 8).shifts.is_empty());
    }
}

//! The cores of atoms in lanes: capsules and boxes, and how far they are apart.

use crate::collision::atom::{Atom, Core};
use crate::geometry::lanes::{
    Bits8, Box8, Float8, Segment8, V3, box_box_gap, column_sum, dot3, lengths, scale3, segment_box_outside,
    segment_box_squared, segment_segment_squared, splat3, sub3,
};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::Frame8;

/// A core in single precision, in the frame of what carries it.
#[derive(Debug, Clone)]
pub(super) enum LaneCore {
    Capsule(LaneCapsule),
    Box { centre: [f32; 3], axes: [[f32; 3]; 3], half: [f32; 3] },
}

/// A capsule in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneCapsule {
    pub(super) start: [f32; 3],
    pub(super) along: [f32; 3],
    /// The squared length of the axis, and one over that, or something large for a point.
    pub(super) square: f32,
    pub(super) inverse: f32,
    pub(super) radius: f32,
    /// Whether the axis lies on the carrier's z axis, as those of limbs do that lie about a joint's.
    upright: bool,
}

/// A core that stands still, with its bounding box.
#[derive(Debug, Clone)]
pub(in crate::collision) struct LaneStatic {
    core: LaneCore,
    /// A box around the shape, where the core is a capsule that is not the shape itself.
    beside: Option<LaneCore>,
    /// Whether the box's axes are those of the placement.
    aligned: bool,
    low: [f32; 3],
    high: [f32; 3],
    pub(super) exact: bool,
}

/// The bounding boxes of up to eight cores that stand still, side by side.
#[derive(Debug, Clone)]
pub(in crate::collision) struct StaticBlock {
    low: [[f32; 8]; 3],
    high: [[f32; 8]; 3],
    /// Their indices in the list from which they come.
    indices: [u16; 8],
    /// Which of the eight there are.
    pub(super) there: Bits8,
}

impl StaticBlock {
    /// Of those of `all` at `indices`, at most eight.
    pub(super) fn new(indices: &[usize], all: &[LaneStatic]) -> Self {
        // What is not there is nowhere.
        let mut block = Self {
            low: [[f32::INFINITY; 8]; 3],
            high: [[f32::NEG_INFINITY; 8]; 3],
            indices: [0; 8],
            there: 0,
        };
        for (slot, &index) in indices.iter().take(8).enumerate() {
            for k in 0..3 {
                block.low[k][slot] = all[index].low[k];
                block.high[k][slot] = all[index].high[k];
            }
            block.indices[slot] = index as u16;
            block.there |= 1 << slot;
        }
        block
    }

    /// All of `all`, by eights.
    pub(in crate::collision) fn all(all: &[LaneStatic]) -> Vec<Self> {
        let indices: Vec<usize> = (0..all.len()).collect();
        indices.chunks(8).map(|chunk| Self::new(chunk, all)).collect()
    }

    /// Which of the eight boxes meet the box from `low` to `high`.
    #[inline(always)]
    pub(super) fn meet<F: Float8>(&self, (low, high): &([f32; 3], [f32; 3])) -> Bits8 {
        let mut all = F::splat(low[0]).less(F::load(&self.high[0]));
        all = F::both(all, F::splat(low[1]).less(F::load(&self.high[1])));
        all = F::both(all, F::splat(low[2]).less(F::load(&self.high[2])));
        all = F::both(all, F::load(&self.low[0]).less(F::splat(high[0])));
        all = F::both(all, F::load(&self.low[1]).less(F::splat(high[1])));
        all = F::both(all, F::load(&self.low[2]).less(F::splat(high[2])));
        F::bits(all)
    }

    /// The index of one of the eight in the list from which it comes.
    #[inline(always)]
    pub(super) fn index(&self, slot: u32) -> usize {
        usize::from(self.indices[slot as usize])
    }
}

/// Single precision, what is almost 0 exactly 0.
pub(super) fn single(v: &Vec3) -> [f32; 3] {
    [v.x, v.y, v.z].map(|x| if x.abs() < 1e-12 { 0.0 } else { x as f32 })
}

impl LaneCapsule {
    pub(super) fn new(a: &Vec3, b: &Vec3, radius: f64) -> Self {
        let axis = lengths((b - a).norm() as f32);
        Self {
            start: single(a),
            along: single(&(b - a)),
            square: axis.0,
            inverse: axis.1,
            radius: radius as f32,
            upright: [a, b].iter().all(|v| single(v)[..2] == [0.0; 2]),
        }
    }

    /// The axis with its carrier at `frame`; `None` for one that stands still.
    #[inline(always)]
    pub(super) fn place<F: Float8>(&self, frame: Option<&Frame8<F>>) -> Segment8<F> {
        let (start, along) = match frame {
            Some(frame) if self.upright => {
                let (start, along, z) = (F::splat(self.start[2]), F::splat(self.along[2]), &frame.axes[2]);
                (scale3(&frame.origin, z, start), [z[0] * along, z[1] * along, z[2] * along])
            }
            Some(frame) => (
                column_sum(&frame.origin, &frame.axes, &self.start),
                column_sum(&splat3(&[0.0; 3]), &frame.axes, &self.along),
            ),
            None => (splat3(&self.start), splat3(&self.along)),
        };
        Segment8 { start, along, square: F::splat(self.square), inverse: F::splat(self.inverse) }
    }
}

impl LaneCore {
    /// The core of `atom`, whose body stands at `body` in the carrier's frame.
    pub(super) fn new(atom: &Atom, body: &Pose) -> Self {
        let at = |v: &Vec3| body.rotation * v + body.translation.vector;
        match &atom.core {
            Core::Capsule { a, b, radius } => Self::Capsule(LaneCapsule::new(&at(a), &at(b), *radius)),
            Core::Box { pose, half } => Self::of_box(&(body * pose), half),
        }
    }

    /// The box beside that core, where there is one.
    pub(super) fn beside(atom: &Atom, body: &Pose) -> Option<Self> {
        atom.beside.as_ref().map(|(pose, half)| Self::of_box(&(body * pose), half))
    }

    /// A box at `pose` in the carrier's frame with half extents `half` (m).
    fn of_box(pose: &Pose, half: &Vec3) -> Self {
        let rotation = pose.rotation.to_rotation_matrix();
        let axes = [0, 1, 2].map(|k| {
            let column = rotation.matrix().column(k).into_owned();
            // What is meant to be straight comes out of the quaternion almost so.
            single(&column.map(|x: f64| if x.abs() < 1e-9 { 0.0 } else { x }))
        });
        Self::Box { centre: single(&pose.translation.vector), axes, half: single(half) }
    }
}

impl LaneCore {
    /// A capsule that holds the core.
    pub(super) fn hull(&self) -> LaneCapsule {
        match self {
            Self::Capsule(capsule) => *capsule,
            Self::Box { centre, axes, half } => {
                // Along the longest edges; the caps stand beyond the ends.
                let longest = (0..3).fold(0, |best, k| if half[k] > half[best] { k } else { best });
                let (u, v) = ((longest + 1) % 3, (longest + 2) % 3);
                let double = |v: &[f32; 3]| Vec3::new(v[0].into(), v[1].into(), v[2].into());
                let along = double(&axes[longest]) * f64::from(half[longest]);
                let radius = f64::from(half[u]).hypot(half[v].into());
                let centre = double(centre);
                LaneCapsule::new(&(centre - along), &(centre + along), radius * (1.0 + 1e-6) + 1e-7)
            }
        }
    }
}

/// A box with its carrier at `frame`; `None` for one that stands still.
#[inline(always)]
fn place_box<F: Float8>(
    centre: &[f32; 3],
    axes: &[[f32; 3]; 3],
    half: &[f32; 3],
    frame: Option<&Frame8<F>>,
) -> Box8<F> {
    let half = splat3(half);
    let Some(frame) = frame else { return still_box(centre, axes, &half) };
    let zero = splat3(&[0.0; 3]);
    Box8 {
        centre: column_sum(&frame.origin, &frame.axes, centre),
        axes: [
            column_sum(&zero, &frame.axes, &axes[0]),
            column_sum(&zero, &frame.axes, &axes[1]),
            column_sum(&zero, &frame.axes, &axes[2]),
        ],
        half,
    }
}

#[inline(always)]
fn still_box<F: Float8>(centre: &[f32; 3], axes: &[[f32; 3]; 3], half: &V3<F>) -> Box8<F> {
    Box8 { centre: splat3(centre), axes: [splat3(&axes[0]), splat3(&axes[1]), splat3(&axes[2])], half: *half }
}

/// The segment in the frame of the box.
#[inline(always)]
fn in_box<F: Float8>(segment: &Segment8<F>, frame: &Box8<F>) -> Segment8<F> {
    let offset = sub3(&segment.start, &frame.centre);
    let (mut start, mut along) = (offset, segment.along);
    for k in 0..3 {
        start[k] = dot3(&offset, &frame.axes[k]);
        along[k] = dot3(&segment.along, &frame.axes[k]);
    }
    Segment8 { start, along, ..*segment }
}

/// A core and the frame that carries it, `None` where that stands still.
pub(super) type Carried<'a, F> = (&'a LaneCore, Option<&'a Frame8<F>>);

/// A lower bound (m) on how far two cores are apart: their distance, or where both are boxes the
/// widest gap. Not positive when capsule cores overlap.
#[inline(always)]
pub(super) fn separation<F: Float8>(a: Carried<'_, F>, b: Carried<'_, F>) -> F {
    let (capsule, at, (centre, axes, half), box_at) = match (a, b) {
        ((LaneCore::Capsule(p), at), (LaneCore::Capsule(q), other_at)) => {
            let squared = segment_segment_squared(&p.place(at), &q.place(other_at));
            return squared.sqrt() - F::splat(p.radius + q.radius);
        }
        (
            (LaneCore::Box { centre, axes, half }, at),
            (LaneCore::Box { centre: other_centre, axes: other_axes, half: other_half }, other_at),
        ) => {
            let first = place_box(centre, axes, half, at);
            return box_box_gap(&first, &place_box(other_centre, other_axes, other_half, other_at));
        }
        ((LaneCore::Capsule(capsule), at), (LaneCore::Box { centre, axes, half }, box_at))
        | ((LaneCore::Box { centre, axes, half }, box_at), (LaneCore::Capsule(capsule), at)) => {
            (capsule, at, (centre, axes, half), box_at)
        }
    };
    let frame = place_box(centre, axes, half, box_at);
    segment_box_squared(&in_box(&capsule.place(at), &frame), &frame.half).sqrt() - F::splat(capsule.radius)
}

impl LaneStatic {
    /// The core of `atom` with its body at `body` in the frame of the placement.
    pub(in crate::collision) fn new(atom: &Atom, body: &Pose) -> Self {
        let core = LaneCore::new(atom, body);
        let mut aligned = false;
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for k in 0..3 {
            let (least, most) = match &core {
                LaneCore::Capsule(LaneCapsule { start, along, radius, .. }) => {
                    let ends = (start[k], start[k] + along[k]);
                    (ends.0.min(ends.1) - radius, ends.0.max(ends.1) + radius)
                }
                LaneCore::Box { centre, axes, half } => {
                    let extent = (0..3).map(|i| axes[i][k].abs() * half[i]).sum::<f32>();
                    (centre[k] - extent, centre[k] + extent)
                }
            };
            // The callers' inflation is for what they compute, not for this.
            low[k] = least - 1e-6 * (1.0 + least.abs());
            high[k] = most + 1e-6 * (1.0 + most.abs());
        }
        if let LaneCore::Box { axes, .. } = &core {
            aligned = *axes == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        }
        let beside = LaneCore::beside(atom, body);
        Self { core, beside, aligned, low, high, exact: atom.core_is_exact }
    }

    /// Lanes of `among` in which the box from `low` to `high`, grown by `margin` (m), meets this one's.
    #[inline(always)]
    pub(super) fn meets<F: Float8>(&self, low: &V3<F>, high: &V3<F>, margin: F, among: Bits8) -> Bits8 {
        let mut all = low[0].less(F::splat(self.high[0]) + margin);
        all = F::both(all, low[1].less(F::splat(self.high[1]) + margin));
        all = F::both(all, low[2].less(F::splat(self.high[2]) + margin));
        all = F::both(all, (F::splat(self.low[0]) - margin).less(high[0]));
        all = F::both(all, (F::splat(self.low[1]) - margin).less(high[1]));
        all = F::both(all, (F::splat(self.low[2]) - margin).less(high[2]));
        F::bits(all) & among
    }

    /// Lanes of `among` in which the core is within `need` (m) of the segment.
    #[inline(always)]
    pub(super) fn near<F: Float8>(&self, segment: &Segment8<F>, need: F, among: Bits8) -> Bits8 {
        match &self.core {
            LaneCore::Capsule(capsule) => {
                let need = need + F::splat(capsule.radius);
                let squared = segment_segment_squared(segment, &capsule.place(None));
                F::bits(squared.less(need * need)) & among
            }
            LaneCore::Box { centre, axes, half } => {
                let half = splat3(half);
                let inside = if self.aligned {
                    Segment8 { start: sub3(&segment.start, &splat3(centre)), ..*segment }
                } else {
                    in_box(segment, &still_box(centre, axes, &half))
                };
                let limit = need * need;
                if F::bits(segment_box_outside(&inside, &half).less(limit)) & among == 0 {
                    return 0;
                }
                F::bits(segment_box_squared(&inside, &half).less(limit)) & among
            }
        }
    }

    /// Whether the core is a box.
    pub(super) fn is_box(&self) -> bool {
        matches!(self.core, LaneCore::Box { .. })
    }

    /// The box beside the core.
    pub(super) fn beside(&self) -> Option<&LaneCore> {
        self.beside.as_ref()
    }

    /// The core, which nothing carries.
    pub(super) fn core(&self) -> &LaneCore {
        &self.core
    }
}

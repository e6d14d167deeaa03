//! The cores of atoms in lanes: capsules and boxes, and how far they are apart.

use crate::collision::atom::{Atom, Core};
use crate::geometry::lanes::{
    Bits8, Box8, Float8, Segment8, V3, box_box_gap, column_sum, dot3, segment_box_outside,
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
    pub(super) length: f32,
    pub(super) radius: f32,
}

/// A core that stands still, with its bounding box.
#[derive(Debug, Clone)]
pub(in crate::collision) struct LaneStatic {
    core: LaneCore,
    /// Whether the box's axes are those of the placement.
    aligned: bool,
    low: [f32; 3],
    high: [f32; 3],
    pub(super) exact: bool,
}

/// Single precision, what is almost 0 exactly 0.
pub(super) fn single(v: &Vec3) -> [f32; 3] {
    [v.x, v.y, v.z].map(|x| if x.abs() < 1e-12 { 0.0 } else { x as f32 })
}

impl LaneCapsule {
    pub(super) fn new(a: &Vec3, b: &Vec3, radius: f64) -> Self {
        Self {
            start: single(a),
            along: single(&(b - a)),
            length: (b - a).norm() as f32,
            radius: radius as f32,
        }
    }

    /// The axis with its carrier at `frame`; `None` for one that stands still.
    #[inline(always)]
    pub(super) fn place<F: Float8>(&self, frame: Option<&Frame8<F>>) -> Segment8<F> {
        let (start, along) = match frame {
            Some(frame) => (
                column_sum(&frame.origin, &frame.axes, &self.start),
                column_sum(&splat3(&[0.0; 3]), &frame.axes, &self.along),
            ),
            None => (splat3(&self.start), splat3(&self.along)),
        };
        Segment8::with_length(start, along, self.length)
    }
}

impl LaneCore {
    /// The core of `atom`, whose body stands at `body` in the carrier's frame.
    pub(super) fn new(atom: &Atom, body: &Pose) -> Self {
        let at = |v: &Vec3| body.rotation * v + body.translation.vector;
        match &atom.core {
            Core::Capsule { a, b, radius } => Self::Capsule(LaneCapsule::new(&at(a), &at(b), *radius)),
            Core::Box { pose, half } => {
                let pose = body * pose;
                let rotation = pose.rotation.to_rotation_matrix();
                let axes = [0, 1, 2].map(|k| {
                    let column = rotation.matrix().column(k).into_owned();
                    // What is meant to be straight comes out of the quaternion almost so.
                    single(&column.map(|x: f64| if x.abs() < 1e-9 { 0.0 } else { x }))
                });
                Self::Box { centre: single(&pose.translation.vector), axes, half: single(half) }
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
        Self { core, aligned, low, high, exact: atom.core_is_exact }
    }

    /// Lanes in which the box from `low` to `high` meets this one's.
    #[inline(always)]
    pub(super) fn meets<F: Float8>(&self, low: &V3<F>, high: &V3<F>) -> Bits8 {
        let mut all = low[0].less(F::splat(self.high[0]));
        all = F::both(all, low[1].less(F::splat(self.high[1])));
        all = F::both(all, low[2].less(F::splat(self.high[2])));
        all = F::both(all, F::splat(self.low[0]).less(high[0]));
        all = F::both(all, F::splat(self.low[1]).less(high[1]));
        all = F::both(all, F::splat(self.low[2]).less(high[2]));
        F::bits(all)
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

    /// The core, which nothing carries.
    pub(super) fn core(&self) -> &LaneCore {
        &self.core
    }
}

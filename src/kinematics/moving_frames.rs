//! Forward kinematics of eight configurations at a time.
//!
//! Every moving link gets a frame whose z axis is its joint's axis. A frame may be turned about its
//! own z at will; that freedom is used so that the next axis stands at a right angle to x, where
//! only one angle is left between neighbouring frames (Denavit and Hartenberg), mostly a quarter
//! turn that costs nothing.

use nalgebra::{Rotation3, UnitQuaternion};
use smallvec::SmallVec;

use super::model::{ArmModel, Link, LinkMotion};
use crate::geometry::lanes::{Float8, V3, column_sum, scale3, sin_cos, splat3};
use crate::geometry::{Pose, Vec3};

/// The axes of the placement.
const UPRIGHT: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Components below this count as zero where a frame may be chosen.
const ZERO: f64 = 1e-9;

/// A frame in each lane: axes and origin in the frame of the placement.
#[derive(Clone, Copy)]
pub struct Frame8<F> {
    /// Its x, y and z axes.
    pub axes: [V3<F>; 3],
    /// Its origin (m).
    pub origin: V3<F>,
}

/// Frames of one arm, in order; those of most arms need no memory of their own.
pub type Frames8<F> = SmallVec<[Frame8<F>; 8]>;

/// The moving frames of an arm in its place.
#[derive(Debug, Clone)]
pub struct MovingFrames {
    steps: Vec<Step>,
    /// For each link the frame on which it rides, `None` where nothing moves it, and its pose in it.
    riders: Vec<(Option<usize>, Pose)>,
}

#[derive(Debug, Clone)]
struct Step {
    before: Before,
    slides: bool,
    joint: usize,
    multiplier: f32,
    shift: f32,
}

/// The frame before the joint's own motion.
#[derive(Debug, Clone)]
enum Before {
    /// It stands still, its axes those of the placement.
    Upright { origin: [f32; 3] },
    /// It stands still.
    Still { axes: [[f32; 3]; 3], origin: [f32; 3] },
    /// On another frame, mostly that of the step before.
    On { parent: usize, origin: Origin, turn: Turn },
}

/// Where a frame stands in the one before it (m).
#[derive(Debug, Clone)]
enum Origin {
    /// Along one of the other's axes, as most do since frames are chosen so.
    Along { axis: usize, by: f32 },
    /// Anywhere.
    At([f32; 3]),
}

impl Origin {
    fn new(v: [f32; 3]) -> Self {
        let mut others = (0..3).filter(|&k| v[k] != 0.0);
        match (others.next(), others.next()) {
            (first, None) => Self::Along { axis: first.unwrap_or(0), by: first.map_or(0.0, |k| v[k]) },
            _ => Self::At(v),
        }
    }

    fn vector(&self) -> [f32; 3] {
        match self {
            Self::Along { axis, by } => std::array::from_fn(|k| if k == *axis { *by } else { 0.0 }),
            Self::At(v) => *v,
        }
    }
}

/// How a frame is turned against the one on which it stands.
#[derive(Debug, Clone)]
enum Turn {
    /// Not at all.
    Not,
    /// By a quarter about x that takes z to y: as most are, since frames are chosen so.
    Quarter,
    /// About x.
    AboutX { cosine: f32, sine: f32 },
    /// Its axes in the other frame.
    Any([[f32; 3]; 3]),
}

impl MovingFrames {
    /// The frames of `model` with its root link at `base` in the frame of the placement.
    pub fn new(model: &ArmModel, base: &Pose) -> Self {
        let mut steps = Vec::new();
        let mut riders: Vec<(Option<usize>, Pose)> = Vec::with_capacity(model.links.len());
        for (index, link) in model.links.iter().enumerate() {
            let (under, at) = match link.parent {
                Some(parent) => (riders[parent].0, riders[parent].1 * link.origin),
                None => (None, base * link.origin),
            };
            let (slides, axis, joint, multiplier, offset) = match &link.motion {
                LinkMotion::Held => {
                    riders.push((under, at));
                    continue;
                }
                LinkMotion::Revolute { axis, joint, multiplier, offset } => {
                    (false, axis, *joint, *multiplier, *offset)
                }
                LinkMotion::Prismatic { axis, joint, multiplier, offset } => {
                    (true, axis, *joint, *multiplier, *offset)
                }
            };
            let z = at.rotation * axis.into_inner();
            let (frame, turn) = frame_with_z(&z, under.is_some());
            let own = frame.inverse() * at.rotation;
            let spin = if slides { 0.0 } else { spin_for_next(&model.links, index, &own) };
            let origin = single(&at.translation.vector);
            let before = match under {
                Some(parent) => Before::On { parent, origin: Origin::new(origin), turn },
                None if columns(&frame) == UPRIGHT => Before::Upright { origin },
                None => Before::Still { axes: columns(&frame), origin },
            };
            let shift = (offset + spin) as f32;
            riders.push((
                Some(steps.len()),
                Pose::from_parts(
                    Vec3::zeros().into(),
                    UnitQuaternion::from_axis_angle(&Vec3::z_axis(), -spin) * own,
                ),
            ));
            steps.push(Step { before, slides, joint, multiplier: multiplier as f32, shift });
        }
        Self { steps, riders }
    }

    /// The frame on which `link` rides, `None` where nothing moves it (then its pose is in the
    /// frame of the placement), and its pose in it.
    pub fn rider(&self, link: usize) -> (Option<usize>, &Pose) {
        let (frame, pose) = &self.riders[link];
        (*frame, pose)
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether nothing moves.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Whether a frame slides along its z axis instead of turning about it.
    pub fn slides(&self, frame: usize) -> bool {
        self.steps[frame].slides
    }

    /// The joint that drives a frame, and how much the frame moves as the joint does by one.
    pub fn drive(&self, frame: usize) -> (usize, f32) {
        (self.steps[frame].joint, self.steps[frame].multiplier.abs())
    }

    /// The frame on which a frame stands, `None` where that stands still.
    pub fn parent(&self, frame: usize) -> Option<usize> {
        match self.steps[frame].before {
            Before::On { parent, .. } => Some(parent),
            Before::Upright { .. } | Before::Still { .. } => None,
        }
    }

    /// The axis of a frame's joint in the frame on which it stands (in that of the placement where that
    /// is `None`): a point of it (m) and its direction.
    pub fn axis(&self, frame: usize) -> ([f32; 3], [f32; 3]) {
        match &self.steps[frame].before {
            Before::Upright { origin } => (*origin, UPRIGHT[2]),
            Before::Still { axes, origin } => (*origin, axes[2]),
            Before::On { origin, turn, .. } => {
                let direction = match turn {
                    Turn::Not => UPRIGHT[2],
                    Turn::Quarter => UPRIGHT[1],
                    Turn::AboutX { cosine, sine } => [0.0, -sine, *cosine],
                    Turn::Any(columns) => columns[2],
                };
                (origin.vector(), direction)
            }
        }
    }

    /// Places all frames at eight configurations `q[joint][lane]` in `out`; what was there is lost.
    ///
    /// A frame and what it is made of are more than the registers hold: each is worked out where it stays, component
    /// by component.
    #[inline(always)]
    pub fn place<F: Float8>(&self, q: &[[f32; 8]], out: &mut Frames8<F>) {
        out.truncate(self.steps.len());
        for _ in out.len()..self.steps.len() {
            out.push(Frame8::nowhere());
        }
        // Sines and cosines first, which wait for nothing; they are left where their frames will be.
        for (step, frame) in self.steps.iter().zip(out.iter_mut()) {
            let value = F::load(&q[step.joint]).mul_add(F::splat(step.multiplier), F::splat(step.shift));
            let motion = if step.slides { (value, value) } else { sin_cos(value) };
            (frame.origin[0], frame.origin[1]) = motion;
        }
        for (index, step) in self.steps.iter().enumerate() {
            let (before, from_here) = out.split_at_mut(index);
            let Some(frame) = from_here.first_mut() else { break };
            let (sine, cosine) = (frame.origin[0], frame.origin[1]);
            match &step.before {
                Before::On { parent, origin, turn: Turn::Quarter } if !step.slides => {
                    before[*parent].quarter_turn(origin, (sine, cosine), frame);
                }
                Before::Upright { origin } if !step.slides => {
                    let none = F::splat(0.0);
                    frame.axes = [[cosine, sine, none], [-sine, cosine, none], splat3(&UPRIGHT[2])];
                    frame.origin = splat3(origin);
                }
                other => {
                    let at = match other {
                        Before::Upright { origin } => still(&UPRIGHT, origin),
                        Before::Still { axes, origin } => still(axes, origin),
                        Before::On { parent, origin, turn } => before[*parent].follow(origin, turn),
                    };
                    *frame = if step.slides { at.slid(sine) } else { at.turned(sine, cosine) };
                }
            }
        }
    }
}

/// A frame that stands still.
#[inline(always)]
fn still<F: Float8>(axes: &[[f32; 3]; 3], origin: &[f32; 3]) -> Frame8<F> {
    Frame8 { axes: [splat3(&axes[0]), splat3(&axes[1]), splat3(&axes[2])], origin: splat3(origin) }
}

impl<F: Float8> Frame8<F> {
    /// One that is to be placed.
    #[inline(always)]
    fn nowhere() -> Self {
        let zero = [F::splat(0.0); 3];
        Self { axes: [zero; 3], origin: zero }
    }

    /// The frame that stands on this one at `origin`, turned by a quarter about x that takes z to y, once it has
    /// turned about its own z by an angle of this sine and cosine; written to `out`.
    #[inline(always)]
    fn quarter_turn(&self, origin: &Origin, (sine, cosine): (F, F), out: &mut Self) {
        out.origin = match origin {
            Origin::Along { axis, by } => scale3(&self.origin, &self.axes[*axis], F::splat(*by)),
            Origin::At(origin) => column_sum(&self.origin, &self.axes, origin),
        };
        // y goes to -z and z to y, then both x and y turn about that.
        let back = -cosine;
        for k in 0..3 {
            let (x, y, z) = (self.axes[0][k], self.axes[1][k], self.axes[2][k]);
            out.axes[0][k] = z.neg_mul_add(sine, x * cosine);
            out.axes[1][k] = x.neg_mul_add(sine, z * back);
            out.axes[2][k] = y;
        }
    }

    /// The frame that stands on this one at `origin`, turned by `turn`, before its joint moves.
    #[inline(always)]
    fn follow(&self, origin: &Origin, turn: &Turn) -> Self {
        let origin = column_sum(&self.origin, &self.axes, &origin.vector());
        let [x, y, z] = self.axes;
        let axes = match turn {
            Turn::Not => [x, y, z],
            Turn::Quarter => [x, [-z[0], -z[1], -z[2]], y],
            Turn::AboutX { cosine, sine } => {
                let (c, s) = (F::splat(*cosine), F::splat(*sine));
                let mut axes = [x, y, z];
                for k in 0..3 {
                    axes[1][k] = z[k].mul_add(s, y[k] * c);
                    axes[2][k] = y[k].neg_mul_add(s, z[k] * c);
                }
                axes
            }
            Turn::Any(columns) => {
                let zero = splat3(&[0.0; 3]);
                [
                    column_sum(&zero, &self.axes, &columns[0]),
                    column_sum(&zero, &self.axes, &columns[1]),
                    column_sum(&zero, &self.axes, &columns[2]),
                ]
            }
        };
        Self { axes, origin }
    }

    /// The frame after it has slid along its z (m).
    #[inline(always)]
    fn slid(self, way: F) -> Self {
        Self { origin: scale3(&self.origin, &self.axes[2], way), ..self }
    }

    /// The frame after it has turned about its z by an angle of this sine and cosine.
    #[inline(always)]
    fn turned(self, sine: F, cosine: F) -> Self {
        let [x, y, _] = self.axes;
        let mut axes = self.axes;
        for k in 0..3 {
            axes[0][k] = y[k].mul_add(sine, x[k] * cosine);
            axes[1][k] = x[k].neg_mul_add(sine, y[k] * cosine);
        }
        Self { axes, ..self }
    }
}

/// A rotation that takes z to `z`, about x alone where that is possible; with `plain` also as the
/// turn that [`Frame8::follow`] makes.
fn frame_with_z(z: &Vec3, plain: bool) -> (UnitQuaternion<f64>, Turn) {
    let about_x = |angle: f64| UnitQuaternion::from_axis_angle(&Vec3::x_axis(), angle);
    if plain && z.x.abs() < ZERO {
        if z.y.abs() < ZERO && z.z > 0.0 {
            return (UnitQuaternion::identity(), Turn::Not);
        }
        if z.z.abs() < ZERO {
            let quarter = std::f64::consts::FRAC_PI_2;
            // z goes to -y by a quarter about x.
            return if z.y < 0.0 {
                (about_x(quarter), Turn::AboutX { cosine: 0.0, sine: 1.0 })
            } else {
                (about_x(-quarter), Turn::Quarter)
            };
        }
        let angle = (-z.y).atan2(z.z);
        let turn = Turn::AboutX { cosine: angle.cos() as f32, sine: angle.sin() as f32 };
        return (about_x(angle), turn);
    }
    let rotation = Rotation3::rotation_between(&Vec3::z(), z)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI));
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    (rotation, Turn::Any(columns(&rotation)))
}

/// By how much (rad) the frame of `link`, which stands at `own` in it, is to be turned about z so
/// that the axis of the next moving link is at a right angle to x.
fn spin_for_next(links: &[Link], link: usize, own: &UnitQuaternion<f64>) -> f64 {
    let next = links.iter().enumerate().skip(link + 1).find_map(|(_, next)| {
        let axis = match &next.motion {
            LinkMotion::Held => return None,
            LinkMotion::Revolute { axis, .. } | LinkMotion::Prismatic { axis, .. } => axis,
        };
        let mut direction = next.origin.rotation * axis.into_inner();
        let mut at = next.parent?;
        while at != link {
            if !matches!(links[at].motion, LinkMotion::Held) {
                return None;
            }
            direction = links[at].origin.rotation * direction;
            at = links[at].parent?;
        }
        Some(own * direction)
    });
    match next {
        Some(axis) if axis.x.hypot(axis.y) > ZERO => (-axis.x).atan2(axis.y),
        _ => 0.0,
    }
}

fn single(v: &Vec3) -> [f32; 3] {
    [v.x, v.y, v.z].map(|x| if x.abs() < ZERO { 0.0 } else { x as f32 })
}

fn columns(rotation: &UnitQuaternion<f64>) -> [[f32; 3]; 3] {
    let matrix = rotation.to_rotation_matrix();
    [0, 1, 2].map(|k| single(&matrix.matrix().column(k).into_owned()))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::Rng as _;

    use super::*;
    use crate::geometry::lanes::{InstructionSet, Kernel};
    use crate::geometry::pose_from_parts;
    use crate::kinematics::{Config, NoMeshes, library, library_names};

    struct Place<'a>(&'a MovingFrames, &'a [[f32; 8]]);

    impl Kernel for Place<'_> {
        type Output = Vec<([[[f32; 8]; 3]; 3], [[f32; 8]; 3])>;

        #[inline(always)]
        fn run<F: Float8>(self) -> Self::Output {
            let mut frames = Frames8::<F>::new();
            self.0.place(self.1, &mut frames);
            let numbers = |v: &V3<F>| [v[0].store(), v[1].store(), v[2].store()];
            frames.iter().map(|f| (f.axes.map(|axis| numbers(&axis)), numbers(&f.origin))).collect()
        }
    }

    /// A gantry with a slide, a skew axis and a mimic joint.
    const ODD: &str = r#"<robot name="r"><link name="base"/><link name="rail"/><link name="skew"/><link name="fist"/>
        <link name="plate"/><link name="last"/>
        <joint name="a" type="prismatic"><parent link="base"/><child link="rail"/><origin xyz="0.1 0 0.3" rpy="0.3 0 0.1"/>
            <axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
        <joint name="b" type="continuous"><parent link="rail"/><child link="skew"/><origin xyz="0 0.2 0.1"/>
            <axis xyz="0.5 0.7 0.1"/><limit velocity="1" effort="1"/></joint>
        <joint name="m" type="revolute"><parent link="skew"/><child link="fist"/><origin xyz="0 0.1 0.1"/>
            <axis xyz="1 0 0"/><mimic joint="b" multiplier="0.5" offset="0.2"/>
            <limit lower="-9" upper="9" velocity="1" effort="1"/></joint>
        <joint name="f" type="fixed"><parent link="fist"/><child link="plate"/><origin xyz="0 0.1 0" rpy="0 0.4 0.2"/></joint>
        <joint name="c" type="revolute"><parent link="plate"/><child link="last"/><origin xyz="0.2 0 0.1" rpy="1 2 3"/>
            <axis xyz="0 0 -1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"#;

    #[test]
    fn lanes_agree_with_the_model_for_all_robots() {
        let mut rng = crate::run::Seed(4).stream("frames");
        let mut arms: Vec<ArmModel> = library_names()
            .map(|name| {
                let urdf = library(name).unwrap().urdf;
                ArmModel::from_urdf(name, urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0
            })
            .collect();
        arms.push(ArmModel::from_urdf("odd", ODD, "last", &BTreeMap::new(), &NoMeshes).unwrap().0);
        for model in &arms {
            let mut r = || rng.random_range(-1.0..1.0);
            let base = pose_from_parts([r(), r(), r()], [r(), r(), r(), r() + 1.5]);
            let frames = MovingFrames::new(model, &base);
            for _ in 0..2000 {
                let qs: Vec<Config> =
                    (0..8).map(|_| (0..model.dof()).map(|_| rng.random_range(-3.2..3.2)).collect()).collect();
                let lanes: Vec<[f32; 8]> =
                    (0..model.dof()).map(|j| std::array::from_fn(|lane| qs[lane][j] as f32)).collect();
                for set in [InstructionSet::best(), InstructionSet::portable()] {
                    let placed = set.run(Place(&frames, &lanes));
                    for (lane, q) in qs.iter().enumerate() {
                        let mut poses = Vec::new();
                        model.link_poses(q, &mut poses);
                        for (link, pose) in poses.iter().enumerate() {
                            let (frame, local) = frames.rider(link);
                            let pose = base * pose;
                            let Some(frame) = frame else {
                                assert!((pose.translation.vector - local.translation.vector).norm() < 1e-9);
                                continue;
                            };
                            let (axes, origin) = &placed[frame];
                            let point = Vec3::new(0.3, -0.2, 0.4);
                            let inside = local.rotation * point + local.translation.vector;
                            let found = Vec3::from_fn(|k, _| {
                                let along =
                                    (0..3).map(|c| f64::from(axes[c][k][lane]) * inside[c]).sum::<f64>();
                                f64::from(origin[k][lane]) + along
                            });
                            let truth = pose.rotation * point + pose.translation.vector;
                            assert!((found - truth).norm() < 4e-6, "{} {link}: {found} {truth}", model.name);
                        }
                    }
                }
            }
        }
    }
}

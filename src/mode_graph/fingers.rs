//! Room for fingers beside an object that is put down or taken.

use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::problem::Problem;

/// Play (m) on top of what fingers and certified clearance need.
const PLAY: f64 = 2.0e-3;

/// The farthest extent (m) of `shapes`, in a body at `body`, along `direction`.
fn extent(shapes: &[PlacedShape], body: &Pose, direction: &Vec3) -> f64 {
    let along = |placed: &PlacedShape| {
        let at = body * placed.pose;
        placed.shape.support(&(at.rotation.inverse() * direction)) + at.translation.vector.dot(direction)
    };
    shapes.iter().map(along).fold(f64::NEG_INFINITY, f64::max)
}

/// How far (m) objects of `class` must stand apart so that a gripper fits around one of them: the
/// most by which any tool sticks out sideways beyond an object that it grasps, over all grasps and
/// all of the tool's shapes that reach below the object's near end.
pub(super) fn finger_clearance(problem: &Problem, class: usize) -> f64 {
    let mut most = 0.0_f64;
    let Some(object) = problem.objects.iter().find(|object| object.class == class) else { return most };
    let sideways = |shapes: &[PlacedShape], body: &Pose| {
        [Vec3::x(), -Vec3::x(), Vec3::y(), -Vec3::y()].map(|direction| extent(shapes, body, &direction))
    };
    let grasps = object.grasps.iter().map(|grasp| {
        let near_end = -extent(&object.shapes, &grasp.object_in_tcp, &-Vec3::z());
        (grasp, near_end, sideways(&object.shapes, &grasp.object_in_tcp))
    });
    let grasps: Vec<_> = grasps.collect();
    for arm in &problem.workcell.arms {
        let in_tcp = arm.tool.tcp.inverse();
        for shape in arm.tool.shapes.chunks(1) {
            let (tip, reach) = (extent(shape, &in_tcp, &Vec3::z()), sideways(shape, &in_tcp));
            for (grasp, near_end, own) in &grasps {
                if grasp.fits(arm.tool.max_opening) && tip > *near_end {
                    let beyond = reach.iter().zip(own).map(|(tool, object)| tool - object);
                    most = beyond.fold(most, f64::max);
                }
            }
        }
    }
    most + problem.options.clearance_m.max(0.0) + PLAY
}

//! The convex primitives of which every body is a union.

use std::sync::Arc;

use parry3d_f64::shape::{ConvexPolyhedron, SharedShape};

use super::{Pose, Vec3};

/// A convex shape in its own frame, origin at its centre (hulls: as given). Lengths in metres.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A box by its half extents.
    Box {
        /// Half extents along x, y, z.
        half_extents: Vec3,
    },
    /// A ball around the origin.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half of its length along z.
        half_length: f64,
    },
    /// A capsule along z.
    Capsule {
        /// Radius of the caps and the straight part.
        radius: f64,
        /// Half of the straight part's length along z.
        half_length: f64,
    },
    /// A convex hull of points.
    Convex(Arc<ConvexHull>),
}

/// A convex hull with its vertices.
#[derive(Debug)]
pub struct ConvexHull {
    vertices: Vec<Vec3>,
    polyhedron: Arc<ConvexPolyhedron>,
}

/// Why a shape could not be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ShapeError {
    /// The points do not span a volume.
    #[error("the points do not span a volume; give at least four points that are not in one plane")]
    FlatHull,
}

impl PartialEq for ConvexHull {
    /// Equal hulls have the same vertices in the same order.
    fn eq(&self, other: &Self) -> bool {
        self.vertices == other.vertices
    }
}

impl ConvexHull {
    /// The hull of `points` (m).
    ///
    /// # Errors
    /// [`ShapeError::FlatHull`] when they span no volume.
    pub fn new(points: &[Vec3]) -> Result<Self, ShapeError> {
        if points.len() < 4 || spans_no_volume(points) {
            return Err(ShapeError::FlatHull);
        }
        let parry: Vec<parry3d_f64::math::Vector> = points.iter().map(|p| (*p).into()).collect();
        let polyhedron = ConvexPolyhedron::from_convex_hull(&parry).ok_or(ShapeError::FlatHull)?;
        let vertices = polyhedron.points().iter().map(|p| Vec3::new(p.x, p.y, p.z)).collect();
        Ok(Self { vertices, polyhedron: Arc::new(polyhedron) })
    }

    /// The hull's corner points in the shape's frame (m).
    pub fn vertices(&self) -> &[Vec3] {
        &self.vertices
    }

    /// Its volume (m^3).
    pub fn volume(&self) -> f64 {
        use parry3d_f64::shape::Shape as _;
        self.polyhedron.mass_properties(1.0).mass()
    }

    /// The hull as parry holds it.
    pub fn polyhedron(&self) -> &ConvexPolyhedron {
        &self.polyhedron
    }
}

/// Whether all points lie within 1e-9 m of one plane.
fn spans_no_volume(points: &[Vec3]) -> bool {
    let centre = points.iter().sum::<Vec3>() / points.len() as f64;
    let mut scatter = nalgebra::Matrix3::zeros();
    for point in points {
        let offset = point - centre;
        scatter += offset * offset.transpose();
    }
    let least = scatter.symmetric_eigenvalues().min();
    least.max(0.0).sqrt() < 1e-9
}

impl Shape {
    /// The farthest distance of the shape in direction `direction` (need not be unit) from its
    /// frame's origin: the support function, in metres times the direction's norm.
    pub fn support(&self, direction: &Vec3) -> f64 {
        match self {
            Shape::Box { half_extents } => half_extents.dot(&direction.abs()),
            Shape::Sphere { radius } => radius * direction.norm(),
            Shape::Cylinder { radius, half_length } => {
                radius * direction.x.hypot(direction.y) + half_length * direction.z.abs()
            }
            Shape::Capsule { radius, half_length } => {
                radius * direction.norm() + half_length * direction.z.abs()
            }
            Shape::Convex(hull) => {
                hull.vertices.iter().map(|v| v.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
            }
        }
    }

    /// The radius (m) of the ball around the frame's origin that just holds the shape.
    pub fn bounding_radius(&self) -> f64 {
        match self {
            Shape::Box { half_extents } => half_extents.norm(),
            Shape::Sphere { radius } => *radius,
            Shape::Cylinder { radius, half_length } => radius.hypot(*half_length),
            Shape::Capsule { radius, half_length } => radius + half_length,
            Shape::Convex(hull) => hull.vertices.iter().map(|v| v.norm()).fold(0.0, f64::max),
        }
    }

    /// The shape as parry holds it (cylinders and capsules turned from z to parry's axis need the
    /// extra pose of [`PlacedShape::exact_pose`]).
    pub fn to_parry(&self) -> SharedShape {
        match self {
            Shape::Box { half_extents } => {
                SharedShape::cuboid(half_extents.x, half_extents.y, half_extents.z)
            }
            Shape::Sphere { radius } => SharedShape::ball(*radius),
            Shape::Cylinder { radius, half_length } => SharedShape::cylinder(*half_length, *radius),
            Shape::Capsule { radius, half_length } => SharedShape::capsule_z(*half_length, *radius),
            Shape::Convex(hull) => {
                SharedShape(Arc::clone(&hull.polyhedron) as Arc<dyn parry3d_f64::shape::Shape>)
            }
        }
    }
}

/// A shape at a pose in the frame of the body that it belongs to.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedShape {
    /// The shape.
    pub shape: Shape,
    /// Its frame in the body's frame.
    pub pose: Pose,
}

impl PlacedShape {
    /// The radius (m) of the ball around the *body's* origin that holds the shape.
    pub fn bounding_radius(&self) -> f64 {
        match &self.shape {
            Shape::Capsule { radius, half_length } => {
                let axis = self.pose.rotation * Vec3::new(0.0, 0.0, *half_length);
                let centre = self.pose.translation.vector;
                (centre + axis).norm().max((centre - axis).norm()) + radius
            }
            Shape::Convex(hull) => hull
                .vertices()
                .iter()
                .map(|v| (self.pose.rotation * v + self.pose.translation.vector).norm())
                .fold(0.0, f64::max),
            Shape::Box { half_extents: h } => {
                let mut farthest = 0.0_f64;
                for corner in 0..8 {
                    let sign = |bit: i32| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
                    let point = Vec3::new(h.x * sign(0), h.y * sign(1), h.z * sign(2));
                    farthest =
                        farthest.max((self.pose.rotation * point + self.pose.translation.vector).norm());
                }
                farthest
            }
            other => self.pose.translation.vector.norm() + other.bounding_radius(),
        }
    }

    /// The pose at which parry's form of the shape ([`Shape::to_parry`]) stands when the body is
    /// at `body`: parry's cylinder runs along y.
    pub fn exact_pose(&self, body: &Pose) -> Pose {
        let placed = body * self.pose;
        match self.shape {
            Shape::Cylinder { .. } => {
                placed
                    * nalgebra::UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::FRAC_PI_2)
            }
            _ => placed,
        }
    }
}

//! How large a problem may be.

use crate::kinematics::UrdfSize;

/// Bounds on what is read; what is beyond them is `too_large`.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadLimits {
    /// Length of the document (bytes).
    pub max_bytes: usize,
    /// Robot models.
    pub max_robots: usize,
    /// Links of one robot.
    pub max_links: usize,
    /// Collision shapes of all links of one robot; a mesh counts by its convex pieces.
    pub max_link_shapes: usize,
    /// Work, in units of about 10 ns, that may go into finding out which links of a document's robots
    /// overlap almost always: hundreds of links in one clump would take minutes.
    pub max_overlap_work: u64,
    /// Arms.
    pub max_arms: usize,
    /// Obstacles.
    pub max_obstacles: usize,
    /// Surfaces.
    pub max_surfaces: usize,
    /// Objects.
    pub max_objects: usize,
    /// Grasps and generators of one object.
    pub max_grasps: usize,
    /// Collision shapes of one tool.
    pub max_tool_shapes: usize,
    /// Pairs in `allowed_contacts`.
    pub max_allowed_contacts: usize,
    /// Points of one convex shape, or of all convex pieces of one mesh.
    pub max_points: usize,
    /// Triangles of one mesh file; all meshes of a document may have
    /// [four times as many](ReadLimits::max_triangles_together).
    pub max_triangles: usize,
    /// Length of one URDF or SRDF (bytes).
    pub max_urdf_bytes: usize,
    /// Length of one mesh file (bytes).
    pub max_mesh_bytes: usize,
    /// Deepest nesting of the document, at most 127.
    pub max_json_depth: usize,
    /// The `time_budget_s` of a problem that has none.
    pub default_time_budget_s: f64,
    /// Greatest `time_budget_s`.
    pub max_time_budget_s: f64,
    /// Greatest `threads`, at most 64.
    pub max_threads: u64,
    /// Faults that are listed before the rest is only counted.
    pub max_faults: usize,
}

impl ReadLimits {
    /// How large one robot may be.
    pub fn robot_size(&self) -> UrdfSize {
        UrdfSize { links: self.max_links, shapes: self.max_link_shapes }
    }

    /// Triangles of all meshes of one document together. A mesh counts once, however often it is used in
    /// one scale, and as one triangle for every 256 bytes of its file at least.
    pub fn max_triangles_together(&self) -> usize {
        self.max_triangles.saturating_mul(4)
    }
}

impl Default for ReadLimits {
    fn default() -> Self {
        Self {
            max_bytes: 16 << 20,
            max_robots: 32,
            max_links: 256,
            max_link_shapes: 1024,
            max_overlap_work: 250_000_000,
            max_arms: 32,
            max_obstacles: 1000,
            max_surfaces: 200,
            max_objects: 1000,
            max_grasps: 500,
            max_tool_shapes: 100,
            max_allowed_contacts: 10_000,
            max_points: 5000,
            max_triangles: 500_000,
            max_urdf_bytes: 4 << 20,
            max_mesh_bytes: 32 << 20,
            max_json_depth: 64,
            default_time_budget_s: 30.0,
            max_time_budget_s: 3600.0,
            max_threads: 64,
            max_faults: 1000,
        }
    }
}

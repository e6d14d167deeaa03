//! The meshes of one document: each is read and cut in convex pieces once, and all together are bounded.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

use super::ReadLimits;
use super::triangles::announced;
use crate::geometry::Vec3;
use crate::kinematics::{MeshError, MeshPieces, read_mesh};
use crate::wire::digest::sha256;
use crate::wire::fault::FaultCode;
use crate::wire::resources::{ResourceError, Resources};

/// Bytes of a file that count as one triangle at least, so that large files of few triangles count too.
const BYTES_PER_TRIANGLE: usize = 256;

/// What came of one mesh.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// `sha256:...` of the file.
    pub digest: String,
    /// Its convex pieces.
    pub pieces: Result<MeshPieces, MeshError>,
}

/// Loads meshes and remembers them.
pub struct Meshes<'r> {
    resources: &'r dyn Resources,
    limits: &'r ReadLimits,
    /// By path, relative to the document, and the bits of the scale.
    loaded: RefCell<BTreeMap<(String, [u64; 3]), Mesh>>,
    /// Triangles of all that was loaded.
    triangles: Cell<usize>,
}

impl<'r> Meshes<'r> {
    /// None so far.
    pub fn new(resources: &'r dyn Resources, limits: &'r ReadLimits) -> Self {
        Self { resources, limits, loaded: RefCell::default(), triangles: Cell::new(0) }
    }

    /// The mesh in the file at `path`, scaled by `scale`.
    ///
    /// # Errors
    /// When the file cannot be had.
    pub fn get(&self, path: &str, scale: &Vec3) -> Result<Mesh, ResourceError> {
        let key = (path.to_owned(), [scale.x, scale.y, scale.z].map(f64::to_bits));
        if let Some(mesh) = self.loaded.borrow().get(&key) {
            return Ok(mesh.clone());
        }
        let bytes = self.resources.read(path, self.limits.max_mesh_bytes)?;
        let mesh = Mesh { digest: sha256(&bytes), pieces: self.pieces(path, &bytes, scale) };
        self.loaded.borrow_mut().insert(key, mesh.clone());
        Ok(mesh)
    }

    /// The convex pieces of the mesh in `bytes`, counted.
    fn pieces(&self, path: &str, bytes: &[u8], scale: &Vec3) -> Result<MeshPieces, MeshError> {
        let least = (bytes.len() / BYTES_PER_TRIANGLE).max(1);
        let claimed = announced(path, bytes);
        self.check(claimed, claimed.max(least))?;
        let loaded = read_mesh(path, bytes, scale);
        // What is no good counts by what it claims: it was work, too.
        let triangles = loaded.as_ref().map_or(claimed, |content| content.triangles);
        let admitted = self.check(triangles, triangles.max(least));
        self.triangles.set(self.triangles.get().saturating_add(triangles.max(least)));
        let content = loaded?;
        admitted?;
        content.pieces()
    }

    /// Whether a mesh of so many triangles, which count as `counted`, may come on top of the others.
    fn check(&self, triangles: usize, counted: usize) -> Result<(), MeshError> {
        let most = self.limits.max_triangles;
        if triangles > most {
            return Err(MeshError::TooManyTriangles { triangles, most });
        }
        let most = self.limits.max_triangles_together();
        if self.triangles.get().saturating_add(counted) > most {
            return Err(MeshError::TooManyTogether { most });
        }
        Ok(())
    }
}

/// The code of a mesh's fault.
pub fn code_of(error: &MeshError) -> FaultCode {
    match error {
        MeshError::Unresolved => FaultCode::UnresolvedUri,
        MeshError::TooLarge | MeshError::TooManyTriangles { .. } | MeshError::TooManyTogether { .. } => {
            FaultCode::TooLarge
        }
        _ => FaultCode::BadMesh,
    }
}

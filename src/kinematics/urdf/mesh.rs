//! Meshes of a URDF: where their hulls come from, and the corner points of a file.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use crate::geometry::{ConvexHull, ShapeError, Vec3};
use crate::kinematics::xml::check_structure;

/// Longest accepted mesh file (bytes).
pub const MAX_MESH_BYTES: usize = 64 << 20;

/// Where the meshes behind URIs come from: a bundle, a folder, or nowhere.
///
/// Loading never opens a file by itself; what the resolver does not hand out does not exist.
pub trait MeshResolver {
    /// The convex hull of the mesh that `uri` (as it stands in the URDF) names, scaled by `scale`.
    ///
    /// # Errors
    /// [`MeshError::Unresolved`] when there is none; any other when it cannot be used.
    fn hull(&self, uri: &str, scale: &Vec3) -> Result<Arc<ConvexHull>, MeshError>;
}

/// A resolver that knows no mesh at all.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoMeshes;

impl MeshResolver for NoMeshes {
    fn hull(&self, _uri: &str, _scale: &Vec3) -> Result<Arc<ConvexHull>, MeshError> {
        Err(MeshError::Unresolved)
    }
}

/// Why a mesh could not be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// Nothing stands behind the URI.
    #[error("the URI does not resolve to a file of the bundle")]
    Unresolved,
    /// The file is too large.
    #[error("the file is larger than {MAX_MESH_BYTES} bytes")]
    TooLarge,
    /// The mesh has too many triangles.
    #[error("the mesh has up to {triangles} triangles, at most {most} are taken; simplify it")]
    TooManyTriangles {
        /// How many it has at most.
        triangles: usize,
        /// How many it may have.
        most: usize,
    },
    /// Too much has been loaded already.
    #[error("the document's meshes have more than {most} triangles together; simplify them")]
    TooManyTogether {
        /// How many all of them may have.
        most: usize,
    },
    /// The file is no STL, OBJ or COLLADA file, or a broken one.
    #[error("the file is no readable STL, OBJ or COLLADA mesh: {0}")]
    Unreadable(String),
    /// A coordinate is NaN, infinite or absurd.
    #[error("the mesh has a coordinate that is not finite or beyond +-1e6 m")]
    BadCoordinate,
    /// It has no hull.
    #[error(transparent)]
    NoHull(#[from] ShapeError),
}

/// The corner points (m) of the mesh in `bytes`, scaled by `scale`, and its number of triangles. The kind of file (STL, OBJ,
/// COLLADA) is told by the ending of `uri`, else by the content; nothing but `bytes` is read.
///
/// # Errors
/// [`MeshError`] when the file is too large or unreadable, or has unusable coordinates.
pub fn mesh_points(uri: &str, bytes: &[u8], scale: &Vec3) -> Result<(Vec<Vec3>, usize), MeshError> {
    if bytes.len() > MAX_MESH_BYTES {
        return Err(MeshError::TooLarge);
    }
    let name = match kind_of_file(uri, bytes)? {
        MeshFile::Stl => "mesh.stl",
        MeshFile::Collada => "mesh.dae",
        MeshFile::Obj => "mesh.obj",
    };
    // The readers come from outside and have assertions of their own: a panic in one of them is
    // a broken file to us.
    let read = catch_unwind(AssertUnwindSafe(|| {
        let nothing_else = |_: &Path| Err::<Vec<u8>, _>(std::io::Error::from(std::io::ErrorKind::NotFound));
        mesh_loader::Loader::default().load_from_slice_with_reader(bytes, name, nothing_else)
    }));
    let scene = match read {
        Ok(Ok(scene)) => scene,
        Ok(Err(error)) => return Err(MeshError::Unreadable(super::document::cut(&error.to_string()))),
        Err(_) => return Err(MeshError::Unreadable("the reader gave up".to_owned())),
    };
    let (mut points, mut triangles) = (Vec::new(), 0);
    for mesh in &scene.meshes {
        // Points that belong to no triangle are work as well.
        triangles += mesh.faces.len().max(mesh.vertices.len() / 3);
        for vertex in &mesh.vertices {
            let point = Vec3::from(vertex.map(f64::from)).component_mul(scale);
            if !point.iter().all(|c| c.abs() <= 1e6) {
                return Err(MeshError::BadCoordinate);
            }
            points.push(point);
        }
    }
    Ok((points, triangles))
}

enum MeshFile {
    Stl,
    Collada,
    Obj,
}

/// Tells the kind of file, and refuses what its reader would not survive or would misread.
fn kind_of_file(uri: &str, bytes: &[u8]) -> Result<MeshFile, MeshError> {
    let unreadable = |why: &str| MeshError::Unreadable(why.to_owned());
    let ending = uri.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    let kind = match ending.as_str() {
        "stl" => MeshFile::Stl,
        "dae" => MeshFile::Collada,
        "obj" => MeshFile::Obj,
        _ if bytes.trim_ascii_start().starts_with(b"solid") => MeshFile::Stl,
        _ if bytes.windows(8).take(1024).any(|window| window == b"<COLLADA") => MeshFile::Collada,
        _ => return Err(unreadable("the kind of file is unknown")),
    };
    match kind {
        MeshFile::Stl if !bytes.trim_ascii_start().starts_with(b"solid") => {
            // Binary: a header of 80 bytes, the number of triangles, 50 bytes for each.
            let count = bytes
                .get(80..84)
                .and_then(|field| <[u8; 4]>::try_from(field).ok())
                .map(|field| u64::from(u32::from_le_bytes(field)))
                .ok_or_else(|| unreadable("it is shorter than its header"))?;
            if (bytes.len() as u64) < 84 + 50 * count {
                return Err(unreadable("it is shorter than its number of triangles asks for"));
            }
        }
        MeshFile::Collada => {
            let text = std::str::from_utf8(bytes).map_err(|_| unreadable("it is not UTF-8"))?;
            check_structure(text).map_err(|error| unreadable(&error.to_string()))?;
        }
        _ => {}
    }
    Ok(kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron_stl() -> Vec<u8> {
        let corners = [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let faces = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
        let mut bytes = vec![0_u8; 80];
        bytes.extend(4_u32.to_le_bytes());
        for face in faces {
            bytes.extend([0_u8; 12]);
            for corner in face {
                for value in corners[corner] {
                    bytes.extend(value.to_le_bytes());
                }
            }
            bytes.extend([0_u8; 2]);
        }
        bytes
    }

    #[test]
    fn points_of_each_format() {
        let scale = Vec3::new(2.0, 1.0, 1.0);
        let stl = mesh_points("package://p/a.STL", &tetrahedron_stl(), &scale).unwrap();
        let obj =
            mesh_points("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n", &scale).unwrap();
        assert_eq!([stl.1, obj.1], [4, 2]);
        for (points, _) in [stl, obj] {
            assert!(points.iter().any(|p| (p - Vec3::new(2.0, 0.0, 0.0)).norm() < 1e-12));
            assert!(points.iter().all(|p| p.sum() <= 2.0));
        }
    }

    #[test]
    fn broken_files_are_errors() {
        let good = tetrahedron_stl();
        for length in [0, 10, 83, 84, 100] {
            assert!(mesh_points("a.stl", &good[..length], &Vec3::repeat(1.0)).is_err(), "{length}");
        }
        let mut huge_count = good.clone();
        huge_count[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(mesh_points("a.stl", &huge_count, &Vec3::repeat(1.0)).is_err());
        let deep = format!("<COLLADA>{}", "<a>".repeat(100_000));
        assert!(mesh_points("a.dae", deep.as_bytes(), &Vec3::repeat(1.0)).is_err());
        assert!(mesh_points("a.xyz", b"nothing", &Vec3::repeat(1.0)).is_err());
        assert!(mesh_points("a.obj", b"v nan 0 0\nf 1 1 1", &Vec3::repeat(1.0)).is_err());
    }
}

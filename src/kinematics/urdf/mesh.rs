//! Meshes of a URDF: where their convex pieces come from, and what a file holds.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use super::collada::misplaced;
use crate::geometry::{ConvexHull, ShapeError, Vec3};
use crate::kinematics::xml::check_structure;

/// Longest accepted mesh file (bytes).
pub const MAX_MESH_BYTES: usize = 64 << 20;

/// A mesh of more pieces counts as one hull.
pub const MOST_PIECES: usize = 256;

/// A piece whose surface encloses less of its hull than all but this share is not convex.
const CONVEX_TOLERANCE: f64 = 0.02;

/// What a mesh counts as (FORMAT "What may touch"): convex hulls whose union encloses all its triangles.
#[derive(Debug, Clone)]
pub struct MeshPieces {
    /// The hull of each of its pieces, or one of it all.
    pub hulls: Vec<Arc<ConvexHull>>,
    /// Where it counts as more than it is, how.
    pub filled: Option<MeshFilled>,
}

/// How a mesh counts as more than it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MeshFilled {
    /// One hull stands for all of it.
    #[error("has no decomposition into convex pieces and counts as its convex hull")]
    Hull,
    /// It has several pieces, and more than can be taken.
    #[error("has {pieces} pieces, of which at most {MOST_PIECES} are taken; it counts as one convex hull")]
    TooManyPieces {
        /// How many it has.
        pieces: usize,
    },
    /// Some pieces are in one plane or line, or nearly so, or open.
    #[error("has pieces that enclose no volume and counts as one convex hull")]
    FlatPieces,
    /// Some pieces are not convex.
    #[error("has {pieces} pieces that are not convex and count as their convex hulls")]
    Pieces {
        /// How many are not.
        pieces: usize,
    },
}

/// Where the meshes behind URIs come from: a bundle, a folder, or nowhere.
///
/// Loading never opens a file by itself; what the resolver does not hand out does not exist.
pub trait MeshResolver {
    /// The convex pieces of the mesh that `uri` (as it stands in the URDF) names, scaled by `scale`.
    ///
    /// # Errors
    /// [`MeshError::Unresolved`] when there is none; any other when it cannot be used.
    fn pieces(&self, uri: &str, scale: &Vec3) -> Result<MeshPieces, MeshError>;
}

/// A resolver that knows no mesh at all.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoMeshes;

impl MeshResolver for NoMeshes {
    fn pieces(&self, _uri: &str, _scale: &Vec3) -> Result<MeshPieces, MeshError> {
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

/// A part of a mesh that its file tells from the others.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MeshPart {
    /// Corner points (m).
    pub points: Vec<Vec3>,
    /// Its triangles, by the numbers of their corners.
    pub triangles: Vec<[usize; 3]>,
}

impl MeshPart {
    /// Whether its triangles are the surface of its hull, whose volume (m^3) is given: as seen from a point in the middle,
    /// they enclose as much. Which way round they are does not matter.
    fn is_convex(&self, volume: f64) -> bool {
        let centre = self.points.iter().sum::<Vec3>() / self.points.len().max(1) as f64;
        let six = self.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|corner| self.points[corner] - centre);
            a.dot(&b.cross(&c)).abs()
        });
        (six.sum::<f64>() / 6.0 / volume - 1.0).abs() <= CONVEX_TOLERANCE
    }

    /// Whether every edge is one of two triangles, or of four, ...
    fn is_closed(&self) -> bool {
        // The sign of a zero does not tell corners apart.
        let corner = |number: usize| self.points[number].map(|value| (value + 0.0).to_bits()).data.0[0];
        let mut sides: BTreeMap<[[u64; 3]; 2], usize> = BTreeMap::new();
        for &[a, b, c] in &self.triangles {
            for (one, other) in [(a, b), (b, c), (c, a)] {
                let (one, other) = (corner(one), corner(other));
                *sides.entry([one.min(other), one.max(other)]).or_default() += 1;
            }
        }
        sides.values().all(|count| count % 2 == 0)
    }
}

/// A mesh file.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshFileContent {
    /// Its parts: the objects (`o`) of an OBJ file, or its groups (`g`) where it has no objects; the geometries of a COLLADA
    /// file; the solids of an STL file.
    pub parts: Vec<MeshPart>,
    /// How many triangles it has.
    pub triangles: usize,
}

impl MeshFileContent {
    /// The convex pieces: a hull for each part, or one for all where parts have none or are too many.
    ///
    /// # Errors
    /// [`MeshError::NoHull`] when all points are in one plane, [`MeshError::Unreadable`] when they are beyond what hulls can be
    /// made of.
    pub fn pieces(&self) -> Result<MeshPieces, MeshError> {
        let count = self.parts.len();
        if count > 1 && count <= MOST_PIECES {
            let hulls: Result<Vec<_>, _> = self.parts.iter().map(|part| convex_hull(&part.points)).collect();
            if let Ok(hulls) = hulls {
                let both = self.parts.iter().zip(&hulls);
                let others: Vec<&MeshPart> = both
                    .filter(|(part, hull)| !part.is_convex(hull.volume()))
                    .map(|(part, _)| part)
                    .collect();
                // Patches of one surface are no pieces: together they enclose more than each of them.
                if others.iter().all(|part| part.is_closed()) {
                    let filled = (!others.is_empty()).then_some(MeshFilled::Pieces { pieces: others.len() });
                    return Ok(MeshPieces { hulls, filled });
                }
            }
        }
        let points: Vec<Vec3> = self.parts.iter().flat_map(|part| part.points.iter().copied()).collect();
        let filled = match count {
            0 | 1 => MeshFilled::Hull,
            _ if count > MOST_PIECES => MeshFilled::TooManyPieces { pieces: count },
            _ => MeshFilled::FlatPieces,
        };
        Ok(MeshPieces { hulls: vec![convex_hull(&points)?], filled: Some(filled) })
    }
}

fn convex_hull(points: &[Vec3]) -> Result<Arc<ConvexHull>, MeshError> {
    // The hull's code asserts in corners of degenerate input.
    match catch_unwind(|| ConvexHull::new(points)) {
        Ok(hull) => Ok(Arc::new(hull?)),
        Err(_) => Err(MeshError::Unreadable(
            "no convex hull can be made of its points; give cleaner ones".to_owned(),
        )),
    }
}

/// The mesh in `bytes`, scaled by `scale`. The kind of file (STL, OBJ, COLLADA) is told by the ending of `uri`, else by the
/// content; nothing but `bytes` is read.
///
/// # Errors
/// [`MeshError`] when the file is too large or unreadable, or has unusable coordinates.
pub fn read_mesh(uri: &str, bytes: &[u8], scale: &Vec3) -> Result<MeshFileContent, MeshError> {
    if bytes.len() > MAX_MESH_BYTES {
        return Err(MeshError::TooLarge);
    }
    let kind = kind_of_file(uri, bytes)?;
    let name = match kind {
        MeshFile::Stl => "mesh.stl",
        MeshFile::Collada => "mesh.dae",
        MeshFile::Obj => "mesh.obj",
    };
    let by_object = if kind == MeshFile::Obj { groups_for_objects(bytes) } else { None };
    let bytes = by_object.as_deref().unwrap_or(bytes);
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
    let (mut parts, mut triangles) = (Vec::<MeshPart>::new(), 0);
    // An OBJ file may come back to a group, and may change the material within.
    let mut of_group: BTreeMap<&str, usize> = BTreeMap::new();
    for mesh in &scene.meshes {
        // Points that belong to no triangle are work as well.
        triangles += mesh.faces.len().max(mesh.vertices.len() / 3);
        if mesh.vertices.is_empty() {
            continue;
        }
        let known = if kind == MeshFile::Obj {
            *of_group.entry(&mesh.name).or_insert(parts.len())
        } else {
            parts.len()
        };
        if known == parts.len() {
            parts.push(MeshPart::default());
        }
        let part = &mut parts[known];
        let first = part.points.len();
        for vertex in &mesh.vertices {
            let point = Vec3::from(vertex.map(f64::from)).component_mul(scale);
            if !point.iter().all(|c| c.abs() <= 1e6) {
                return Err(MeshError::BadCoordinate);
            }
            part.points.push(point);
        }
        let corners = mesh.faces.iter().map(|face| face.map(|corner| first + corner as usize));
        part.triangles.extend(corners.filter(|face| face.iter().all(|corner| *corner < part.points.len())));
    }
    Ok(MeshFileContent { parts, triangles })
}

/// An OBJ file with a group for each of its objects, which the reader passes over, and no other groups; `None` where it has
/// no objects, or is not of single bytes.
fn groups_for_objects(bytes: &[u8]) -> Option<Vec<u8>> {
    if bytes.starts_with(&[0xfe, 0xff]) || bytes.starts_with(&[0xff, 0xfe]) {
        return None;
    }
    let is = |line: &[u8], keyword: &[u8]| {
        let rest = line.trim_ascii_start().strip_prefix(keyword);
        rest.is_some_and(|rest| rest.first().is_none_or(|byte| byte.is_ascii_whitespace() || *byte == b'\\'))
    };
    let lines = || bytes.split_inclusive(|byte| matches!(byte, b'\n' | b'\r'));
    if !lines().any(|line| is(line, b"o")) {
        return None;
    }
    let (mut out, mut objects, mut written) = (Vec::with_capacity(bytes.len()), 0_usize, 0);
    // Whether the line before goes on in this one, and whether it was left out; whether that ended with the first half of an
    // end of two characters.
    let (mut goes_on, mut is_out, mut after_return) = (false, false, false);
    for line in lines() {
        let is_half = after_return && line == b"\n";
        if !goes_on {
            is_out = is(line, b"o") || is(line, b"g");
            objects += usize::from(is(line, b"o"));
            // An object begins where it has a face.
            if is(line, b"f") && written < objects {
                written = objects;
                out.extend_from_slice(b"g ");
                out.extend_from_slice(objects.to_string().as_bytes());
                out.push(b'\n');
            }
        }
        if !is_out {
            out.extend_from_slice(line);
        }
        let body = line.strip_suffix(b"\n").or_else(|| line.strip_suffix(b"\r")).unwrap_or(line);
        goes_on = body.ends_with(b"\\") || (goes_on && is_half);
        after_return = line.ends_with(b"\r");
    }
    Some(out)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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
            if let Some(why) = misplaced(text) {
                return Err(unreadable(why));
            }
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
        let stl = read_mesh("package://p/a.STL", &tetrahedron_stl(), &scale).unwrap();
        let obj =
            read_mesh("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n", &scale).unwrap();
        assert_eq!([stl.triangles, obj.triangles], [4, 2]);
        for MeshFileContent { parts, .. } in [stl, obj] {
            let [MeshPart { points, .. }] = parts.as_slice() else { panic!("{parts:?}") };
            assert!(points.iter().any(|p| (p - Vec3::new(2.0, 0.0, 0.0)).norm() < 1e-12));
            assert!(points.iter().all(|p| p.sum() <= 2.0));
        }
    }

    /// The faces of a box from `low` to `high` whose first corner has the number `first`.
    fn obj_box(low: [f64; 3], high: [f64; 3], first: usize) -> String {
        let mut text = String::new();
        for i in 0..8 {
            let corner: [f64; 3] = std::array::from_fn(|k| if i >> k & 1 == 0 { low[k] } else { high[k] });
            text.push_str(&format!("v {} {} {}\n", corner[0], corner[1], corner[2]));
        }
        for face in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
            let [a, b, c, d] = face.map(|corner| corner + first);
            text.push_str(&format!("f {a} {b} {c} {d}\n"));
        }
        text
    }

    /// An angle of two boxes, the second one begun by `between`.
    fn angle(before: &str, between: &str) -> String {
        let foot = obj_box([0.0, 0.0, 0.0], [0.4, 0.1, 0.1], 1);
        let wall = obj_box([0.0, 0.0, 0.1], [0.1, 0.1, 0.5], 9);
        format!("{before}{foot}{between}{wall}")
    }

    fn pieces(text: &str) -> MeshPieces {
        read_mesh("a.obj", text.as_bytes(), &Vec3::repeat(1.0)).unwrap().pieces().unwrap()
    }

    #[test]
    fn a_decomposition_counts_as_its_pieces() {
        for (before, between) in [
            ("o foot\n", "o wall\n"),
            ("g foot\n", "g wall\n"),
            // Objects before groups, whatever they are called; materials are no pieces.
            ("o a\ng x\nusemtl red\n", "o a\r\ng x\nusemtl blue\n"),
            ("", "o second\n"),
        ] {
            let found = pieces(&angle(before, between));
            assert_eq!((found.hulls.len(), found.filled), (2, None), "{before}{between}");
            let tops: Vec<f64> = found
                .hulls
                .iter()
                .map(|hull| hull.vertices().iter().map(|v| v.z).fold(f64::MIN, f64::max))
                .collect();
            assert!((tops[0] - 0.1).abs() < 1e-6 && (tops[1] - 0.5).abs() < 1e-6, "{tops:?}");
        }
        // Lines may end and go on in other ways, and objects without faces are none.
        for (from, to) in [
            ("\n", "\r"),
            ("\n", "\r\n"),
            ("o wall\n", "o \\\nwall\n"),
            ("o wall\n", "o wall \\\n\n"),
            ("o wall\n", "o wall\\ \n"),
            ("o wall\n", "o empty\no wall\n"),
        ] {
            let text = angle("o foot\n", "o wall\n").replace(from, to);
            assert_eq!(pieces(&text).hulls.len(), 2, "{text:?}");
        }
        let solid = |at: f64| {
            let corners = [[at, 0.0, 0.0], [at + 1.0, 0.0, 0.0], [at, 1.0, 0.0], [at, 0.0, 1.0]];
            let facet = |face: [usize; 3]| {
                let vertex = |corner: usize| {
                    let [x, y, z] = corners[corner];
                    format!("vertex {x} {y} {z}\n")
                };
                let vertices: String = face.map(vertex).concat();
                format!("facet normal 0 0 1\nouter loop\n{vertices}endloop\nendfacet\n")
            };
            let facets: String = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]].map(facet).concat();
            format!("solid a\n{facets}endsolid a\n")
        };
        let two = format!("{}{}", solid(0.0), solid(5.0));
        let content = read_mesh("a.stl", two.as_bytes(), &Vec3::repeat(1.0)).unwrap();
        assert_eq!(content.pieces().unwrap().hulls.len(), 2);
    }

    #[test]
    fn what_counts_as_more_than_it_is_says_so() {
        // One object of two boxes, with a material each; the same in one group that is come back to.
        for (before, between) in [
            ("", ""),
            ("usemtl red\n", "usemtl blue\n"),
            ("o one\nusemtl red\n", "usemtl blue\n"),
            ("g one\n", "g one\n"),
        ] {
            let found = pieces(&angle(before, between));
            assert_eq!((found.hulls.len(), found.filled), (1, Some(MeshFilled::Hull)), "{before}{between}");
        }
        // An angle and another box: the angle is not convex.
        let third = obj_box([1.0, 1.0, 1.0], [1.1, 1.1, 1.1], 17);
        let found = pieces(&format!("{}o third\n{third}", angle("o angle\n", "")));
        assert_eq!((found.hulls.len(), found.filled), (2, Some(MeshFilled::Pieces { pieces: 1 })));
        // The halves of a box, open where they meet, are no pieces.
        let box_ = obj_box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], 1);
        let mut faces = 0;
        let halves: String = box_
            .lines()
            .map(|line| {
                faces += usize::from(line.starts_with('f'));
                let begins = if line.starts_with('f') && faces % 3 == 1 { "o half\n" } else { "" };
                format!("{begins}{line}\n")
            })
            .collect();
        assert_eq!((pieces(&halves).hulls.len(), pieces(&halves).filled), (1, Some(MeshFilled::FlatPieces)));
        // A flat piece encloses nothing; all together do.
        let flat = format!("{}o flat\nf 1 2 3\n", angle("o foot\n", "o wall\n"));
        assert_eq!(pieces(&flat).filled, Some(MeshFilled::FlatPieces));
        let many: String = (0..=MOST_PIECES)
            .map(|i| {
                let x = i as f64;
                format!("o p{i}\n{}", obj_box([x, 0.0, 0.0], [x + 0.5, 1.0, 1.0], 8 * i + 1))
            })
            .collect();
        let found = pieces(&many);
        assert_eq!(found.filled, Some(MeshFilled::TooManyPieces { pieces: MOST_PIECES + 1 }));
        assert_eq!(found.hulls.len(), 1);
    }

    #[test]
    fn broken_files_are_errors() {
        let good = tetrahedron_stl();
        for length in [0, 10, 83, 84, 100] {
            assert!(read_mesh("a.stl", &good[..length], &Vec3::repeat(1.0)).is_err(), "{length}");
        }
        let mut huge_count = good.clone();
        huge_count[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(read_mesh("a.stl", &huge_count, &Vec3::repeat(1.0)).is_err());
        let twice = "<COLLADA><library_visual_scenes><instance_geometry url='#a'/><instance_geometry url='#a'/>\
                     </library_visual_scenes></COLLADA>";
        let error = read_mesh("a.dae", twice.as_bytes(), &Vec3::repeat(1.0)).unwrap_err();
        assert!(error.to_string().contains("several places"), "{error}");
        let deep = format!("<COLLADA>{}", "<a>".repeat(100_000));
        assert!(read_mesh("a.dae", deep.as_bytes(), &Vec3::repeat(1.0)).is_err());
        assert!(read_mesh("a.xyz", b"nothing", &Vec3::repeat(1.0)).is_err());
        assert!(read_mesh("a.obj", b"v nan 0 0\nf 1 1 1", &Vec3::repeat(1.0)).is_err());
    }
}

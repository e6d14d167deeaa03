//! Where the paths of a document, and those of the files that it refers to, may lead.

use std::path::Path;

use super::*;
use crate::wire::{Folder, ResourceError, Resources};

const TETRAHEDRON: &str = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";

/// The files of a bundle.
struct Files(Vec<(&'static str, String)>);

impl Resources for Files {
    fn read(&self, path: &str, _max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        assert!(
            !path.starts_with('/') && path.split('/').all(|part| !matches!(part, "" | "." | "..")),
            "{path}"
        );
        let found = self.0.iter().find(|(name, _)| *name == path);
        found.map(|(_, text)| text.clone().into_bytes()).ok_or(ResourceError::NotFound)
    }
}

/// The small arm with a mesh for its root.
fn urdf(mesh: &str) -> String {
    SMALL_URDF.replace("<box size=\"0.1 0.1 0.1\"/>", &format!("<mesh filename=\"{mesh}\"/>"))
}

/// The small cell with this robot.
fn cell(robot: Value) -> Value {
    let mut document = small();
    document["workcell"]["robots"]["small"] = robot;
    document
}

fn with(resources: &dyn Resources, document: &Value) -> Result<ReadProblem, Vec<Fault>> {
    read_problem_value(document, resources, &ReadLimits::default())
}

const URDF: &str = "/workcell/robots/small/urdf";

#[test]
fn a_mesh_lies_where_it_lies_as_seen_from_its_urdf() {
    let bundle = |mesh: &str| {
        Files(vec![
            ("robots/urdf/arm.urdf", urdf(mesh)),
            ("robots/meshes/t.obj", TETRAHEDRON.to_owned()),
            ("t.obj", TETRAHEDRON.to_owned()),
        ])
    };
    let plain = cell(json!({ "urdf": "robots/urdf/arm.urdf" }));
    for mesh in ["../meshes/t.obj", "a/../../meshes/t.obj", "../../robots/meshes/t.obj", "../../t.obj"] {
        let read = with(&bundle(mesh), &plain).unwrap_or_else(|faults| panic!("{mesh}: {}", lines(&faults)));
        assert_eq!(read.problem.workcell.arms[0].model.links[0].shapes.len(), 1);
    }
    for mesh in [
        "../../../t.obj",
        "a/../../../../t.obj",
        "../../../robots/meshes/t.obj",
        "/robots/meshes/t.obj",
        "..\\meshes\\t.obj",
        "..%2fmeshes/t.obj",
        "%2e%2e/meshes/t.obj",
        "file:///t.obj",
    ] {
        let faults = with(&bundle(mesh), &plain).unwrap_err();
        assert!(has(&faults, URDF, FaultCode::UnresolvedUri), "{mesh}: {}", lines(&faults));
    }
    // Through a package, and for paths of the document itself.
    let packages = json!({ "parts": "robots/urdf/.." });
    let mapped = cell(json!({ "urdf": "a/../robots/./urdf/arm.urdf", "package_map": packages }));
    with(&bundle("package://parts/meshes/../meshes/t.obj"), &mapped).unwrap();
    for outside in ["../robots/urdf/arm.urdf", "a/../../arm.urdf", "/arm.urdf", "robots\\urdf\\arm.urdf"] {
        let faults = with(&bundle("../meshes/t.obj"), &cell(json!({ "urdf": outside }))).unwrap_err();
        assert!(has(&faults, URDF, FaultCode::UnresolvedUri), "{outside}: {}", lines(&faults));
    }
    let outside = cell(json!({ "urdf": "robots/urdf/arm.urdf", "package_map": { "parts": "robots/../.." } }));
    let faults = with(&bundle("../meshes/t.obj"), &outside).unwrap_err();
    let place = "/workcell/robots/small/package_map/parts";
    assert!(has(&faults, place, FaultCode::UnresolvedUri), "{}", lines(&faults));
}

/// Writes a file and the folders that it needs.
fn write(root: &Path, path: &str, text: &str) {
    let path = root.join(path);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

#[test]
fn files_lie_in_the_folder_of_the_problem_or_below() {
    let place = tempfile::tempdir().unwrap();
    let root = place.path();
    write(root, "robots/urdf/arm.urdf", &urdf("../meshes/t.obj"));
    write(root, "robots/urdf/mapped.urdf", &urdf("package://robots/meshes/t.obj"));
    write(root, "robots/meshes/t.obj", TETRAHEDRON);
    write(root, "robots/arm.srdf", "<robot name=\"small\"/>");
    std::fs::create_dir(root.join("problems")).unwrap();
    let (folder, below) = (Folder::new(root), Folder::new(root.join("problems")));
    let robots = |from: &str| {
        [
            json!({ "urdf": format!("{from}robots/urdf/arm.urdf"), "srdf": format!("{from}robots/arm.srdf") }),
            json!({
                "urdf": format!("{from}robots/urdf/mapped.urdf"),
                "package_map": { "robots": format!("{from}problems/../robots") }
            }),
        ]
    };
    for (inside, above) in robots("problems/../").into_iter().zip(robots("../")) {
        let document = cell(inside);
        let read = with(&folder, &document).unwrap_or_else(|faults| panic!("{}", lines(&faults)));
        assert_eq!(read.problem.workcell.arms[0].model.links[0].shapes.len(), 1);
        let faults = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap_err();
        assert!(has(&faults, URDF, FaultCode::UnresolvedUri), "{}", lines(&faults));
        let faults = with(&below, &cell(above)).unwrap_err();
        assert!(has(&faults, URDF, FaultCode::UnresolvedUri), "{}", lines(&faults));
    }
    let mut document = small();
    document["objects"][0]["shape"] = json!({ "type": "mesh", "uri": "robots/urdf/../meshes/t.obj" });
    document["initial"]["ball"]["pose"]["position"]["z"] = json!(0.1);
    with(&folder, &document).unwrap();
    assert!(has(&read(&document).unwrap_err(), "/objects/0/shape/uri", FaultCode::UnresolvedUri));
    // Relative to the problem it is, here too.
    let absolute = root.join("robots/urdf/arm.urdf");
    for path in [absolute.to_str().unwrap(), "problems\\..\\robots\\urdf\\arm.urdf", "urdf/arm.urdf"] {
        let faults = with(&folder, &cell(json!({ "urdf": path }))).unwrap_err();
        assert!(has(&faults, URDF, FaultCode::UnresolvedUri), "{path}: {}", lines(&faults));
    }
    // Nor does a link lead out.
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(root.join("robots"), root.join("problems/robots")).unwrap();
        let faults = with(&below, &cell(json!({ "urdf": "robots/urdf/arm.urdf" }))).unwrap_err();
        assert!(has(&faults, URDF, FaultCode::UnresolvedUri), "{}", lines(&faults));
    }
}

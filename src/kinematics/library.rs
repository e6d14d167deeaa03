//! Robots that ship with the product.

/// A robot of the library.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LibraryRobot {
    /// Its name, as in `library:NAME`.
    pub name: &'static str,
    /// Its URDF: primitive shapes only, no meshes to resolve.
    pub urdf: &'static str,
    /// Its SRDF.
    pub srdf: &'static str,
}

/// All robots of the library, by name.
const ROBOTS: &[LibraryRobot] = &[LibraryRobot {
    name: "iiwa14",
    urdf: include_str!("../../scenarios/robots/iiwa14.urdf"),
    srdf: include_str!("../../scenarios/robots/iiwa14.srdf"),
}];

/// The library's robot called `name`.
pub fn library(name: &str) -> Option<LibraryRobot> {
    ROBOTS.iter().copied().find(|robot| robot.name == name)
}

/// The names of all robots of the library.
pub fn library_names() -> impl Iterator<Item = &'static str> {
    ROBOTS.iter().map(|robot| robot.name)
}

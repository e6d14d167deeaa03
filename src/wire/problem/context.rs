//! What all parts of the reading share: limits, faults, names, contents of references.

use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;

use super::ReadLimits;
use super::meshes::Meshes;
use crate::geometry::{ConvexHull, Vec3};
use crate::wire::digest::sha256;
use crate::wire::fault::{FaultCode, Faults};
use crate::wire::reader::{Node, is_id, shown};
use crate::wire::resources::{ResourceError, Resources};

/// What an id stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Named {
    /// An arm, by its place in the document.
    Arm(usize),
    /// An obstacle.
    Obstacle(usize),
    /// A surface.
    Surface(usize),
    /// An object.
    Object(usize),
}

/// State of one reading.
pub struct Context<'r> {
    /// Where files come from.
    pub resources: &'r dyn Resources,
    /// How large everything may be.
    pub limits: &'r ReadLimits,
    /// The meshes of the document.
    pub meshes: Rc<Meshes<'r>>,
    /// Whether the document stands around a workcell alone: nobody says where its arms start.
    pub bare: bool,
    /// What is wrong so far.
    pub faults: Faults,
    /// Convex pieces of meshes so far, but for one of each mesh.
    pub pieces: usize,
    /// Digests of the contents of references, by JSON pointer.
    pub contents: BTreeMap<String, String>,
    names: BTreeMap<String, Named>,
    /// Cleared when a list could not be read to its end: then an unknown name may be the fault
    /// of that, and is not noted on top.
    names_complete: bool,
}

impl<'r> Context<'r> {
    /// A fresh reading.
    pub fn new(resources: &'r dyn Resources, limits: &'r ReadLimits) -> Self {
        Self {
            resources,
            limits,
            meshes: Rc::new(Meshes::new(resources, limits)),
            bare: false,
            faults: Faults::new(limits.max_faults),
            pieces: 0,
            contents: BTreeMap::new(),
            names: BTreeMap::new(),
            names_complete: true,
        }
    }

    /// Elements of the list at `node`, which name things.
    pub fn named_elements<'a>(&mut self, node: &Node<'a>, what: &str, max: usize) -> Vec<Node<'a>> {
        let before = self.faults.count();
        let elements = node.elements(&mut self.faults, what, max);
        self.names_complete &= self.faults.count() == before;
        elements
    }

    /// Takes down the id at `node` for `named` and gives it back. A fault when it is malformed or
    /// taken, or absent.
    pub fn register(&mut self, node: Option<Node<'_>>, named: Named) -> Option<String> {
        let Some((node, text)) = node.and_then(|node| node.string(&mut self.faults).map(|text| (node, text)))
        else {
            self.names_complete = false;
            return None;
        };
        if !is_id(text) {
            node.id(&mut self.faults);
        }
        if self.names.contains_key(text) {
            let message = format!("the id `{}` is taken; ids are unique over all kinds", shown(text));
            node.fault(&mut self.faults, FaultCode::DuplicateId, message);
        } else {
            self.names.insert(text.to_owned(), named);
        }
        Some(text.to_owned())
    }

    /// What `name` stands for.
    pub fn named(&self, name: &str) -> Option<Named> {
        self.names.get(name).copied()
    }

    /// Notes that `text` names nothing of the kind that `node` wants.
    pub fn unknown(&mut self, pointer: &str, text: &str, what: &str, code: FaultCode) {
        if self.names_complete {
            let message = format!("there is no {what} `{}`; give one that the problem has", shown(text));
            self.faults.push(pointer, code, message);
        }
    }

    /// The text or bytes at `path` (relative to the document), noted with their digest under
    /// `node`'s pointer.
    pub fn read_file(
        &mut self,
        node: &Node<'_>,
        path: Result<String, ResourceError>,
        max: usize,
    ) -> Option<Vec<u8>> {
        match path.and_then(|path| self.resources.read(&path, max)) {
            Ok(bytes) => {
                self.contents.insert(node.pointer.clone(), sha256(&bytes));
                Some(bytes)
            }
            Err(error) => {
                self.unread(node, &error);
                None
            }
        }
    }

    /// Notes that what `node` refers to cannot be had.
    pub fn unread(&mut self, node: &Node<'_>, error: &ResourceError) {
        let code = match error {
            ResourceError::TooLarge(_) => FaultCode::TooLarge,
            _ => FaultCode::UnresolvedUri,
        };
        let uri = node.value.as_str().unwrap_or_default();
        node.fault(&mut self.faults, code, format!("`{}`: {error}", shown(uri)));
    }

    /// The convex hull of `points`.
    pub fn hull(&mut self, node: &Node<'_>, points: &[Vec3], code: FaultCode) -> Option<Arc<ConvexHull>> {
        // The hull's code asserts in corners of degenerate input.
        let made = std::panic::catch_unwind(|| ConvexHull::new(points));
        match made {
            Ok(Ok(hull)) => Some(Arc::new(hull)),
            Ok(Err(error)) => {
                node.fault(&mut self.faults, code, error.to_string());
                None
            }
            Err(_) => {
                let message = "no convex hull can be made of these points; give cleaner ones";
                node.fault(&mut self.faults, code, message);
                None
            }
        }
    }
}

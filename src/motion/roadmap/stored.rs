//! A roadmap as numbers, so that it can be kept from one process to the next.

use std::sync::Arc;
use std::sync::atomic::AtomicU8;

use crate::kinematics::Config;
use crate::workcell::{Arm, ArmId};

use super::{Roadmap, SharedChecks, Validity};

/// Bits of an edge's word that hold a vertex.
const VERTEX_BITS: u32 = 31;

const VERTEX: u64 = (1 << VERTEX_BITS) - 1;

impl Roadmap {
    /// The roadmap and what anybody found out about its edges so far, for [`Self::from_words`].
    pub fn words(&self) -> Vec<u64> {
        let counts = [self.vertices.len(), self.edges.len()].map(|count| count as u64);
        let mut words = counts.to_vec();
        words.extend(self.vertices.iter().flatten().map(|x| x.to_bits()));
        words.extend(self.edges.iter().enumerate().map(|(number, edge)| {
            let known = match self.validity[number] {
                Validity::Unknown => self.shared.get(number),
                known => Some(known == Validity::Free),
            };
            let check = known.map_or(0, |free| 1 + u64::from(free));
            check << (2 * VERTEX_BITS) | (edge[0] as u64) << VERTEX_BITS | edge[1] as u64
        }));
        words
    }

    /// The roadmap of `arm` that gave [`Self::words`]; clones share what is found out about its edges.
    /// `None` where the numbers are not those of a roadmap for this arm.
    pub fn from_words(id: ArmId, arm: &Arm, words: &mut dyn Iterator<Item = u64>) -> Option<Self> {
        let [vertices, edges] = [words.next()?, words.next()?];
        let mut roadmap = Self::new(id, arm);
        let mut configurations = Vec::new();
        for _ in 0..vertices {
            let mut q = Config::new();
            for _ in 0..arm.limits.len() {
                q.push(f64::from_bits(words.next()?));
            }
            configurations.push(q);
        }
        roadmap.incident = Arc::new(vec![Vec::new(); configurations.len()]);
        let mut checks = Vec::new();
        for _ in 0..edges {
            let word = words.next()?;
            let ends = [word >> VERTEX_BITS & VERTEX, word & VERTEX].map(|end| end as usize);
            let (a, b) = (configurations.get(ends[0])?, configurations.get(ends[1])?);
            roadmap.join(ends[0], ends[1], roadmap.distance(a, b));
            checks.push(AtomicU8::new((word >> (2 * VERTEX_BITS)) as u8));
        }
        configurations.iter().enumerate().for_each(|(vertex, q)| roadmap.push_paced(vertex, q));
        roadmap.vertices = Arc::new(configurations);
        roadmap.shared = Arc::new(SharedChecks(checks));
        Some(roadmap)
    }

    /// Of how many edges it is known to all clones whether they are free.
    pub fn shared_checks(&self) -> usize {
        (0..self.edges.len()).filter(|&edge| self.shared.get(edge).is_some()).count()
    }
}

//! The tree that the joints of a URDF make of its links.

use std::collections::BTreeMap;

use super::document::{RobotElement, cut};
use super::error::UrdfError;

/// Links in an order with parents before children, and the joint above each.
#[derive(Debug)]
pub(super) struct LinkTree {
    /// Indices into the document's links, root first.
    pub order: Vec<usize>,
    /// The joint (index in the document) whose child is the link, by link.
    pub joint_above: Vec<Option<usize>>,
    /// The parent link, by link.
    pub parent: Vec<Option<usize>>,
}

/// Builds the tree.
///
/// # Errors
/// Unknown links, duplicate names, two parents, several roots, cycles.
pub(super) fn link_tree(robot: &RobotElement) -> Result<LinkTree, UrdfError> {
    if robot.links.is_empty() {
        return Err(UrdfError::NoLinks);
    }
    let mut by_name = BTreeMap::new();
    for (index, link) in robot.links.iter().enumerate() {
        if by_name.insert(link.name.as_str(), index).is_some() {
            return Err(UrdfError::DuplicateName { kind: "links", name: cut(&link.name) });
        }
    }
    let mut joint_names = BTreeMap::new();
    let mut joint_above = vec![None; robot.links.len()];
    let mut parent = vec![None; robot.links.len()];
    let mut children = vec![Vec::new(); robot.links.len()];
    for (index, joint) in robot.joints.iter().enumerate() {
        if joint_names.insert(joint.name.as_str(), index).is_some() {
            return Err(UrdfError::DuplicateName { kind: "joints", name: cut(&joint.name) });
        }
        let find = |name: &str| {
            by_name
                .get(name)
                .copied()
                .ok_or_else(|| UrdfError::UnknownLink { joint: cut(&joint.name), link: cut(name) })
        };
        let (above, below) = (find(&joint.parent)?, find(&joint.child)?);
        if let Some(other) = joint_above[below] {
            let first: &super::document::JointElement = &robot.joints[other];
            return Err(UrdfError::TwoParents {
                link: cut(&joint.child),
                first: cut(&first.name),
                second: cut(&joint.name),
            });
        }
        joint_above[below] = Some(index);
        parent[below] = Some(above);
        children[above].push(below);
    }
    let roots: Vec<usize> = (0..robot.links.len()).filter(|l| joint_above[*l].is_none()).collect();
    if roots.len() > 1 {
        return Err(UrdfError::SeveralRoots {
            roots: roots.iter().take(5).map(|l| cut(&robot.links[*l].name)).collect(),
        });
    }
    let mut order = roots;
    let mut next = 0;
    while next < order.len() {
        let link = order[next];
        order.extend(children[link].iter().copied());
        next += 1;
    }
    if order.len() < robot.links.len() {
        let mut reached = vec![false; robot.links.len()];
        order.iter().for_each(|l| reached[*l] = true);
        let lost = reached.iter().position(|r| !r).unwrap_or_default();
        return Err(UrdfError::Cycle { link: cut(&robot.links[lost].name) });
    }
    Ok(LinkTree { order, joint_above, parent })
}

/// The three of `names` that are most similar to `name`, best first.
pub(super) fn closest_names<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> Vec<String> {
    const LONGEST: usize = 64;
    let wanted: Vec<char> = name.chars().take(LONGEST).collect();
    let mut scored: Vec<(usize, &str)> = names
        .take(10_000)
        .map(|candidate| {
            let letters: Vec<char> = candidate.chars().take(LONGEST).collect();
            (edit_distance(&wanted, &letters), candidate)
        })
        .collect();
    scored.sort();
    scored.truncate(3);
    scored.into_iter().map(|(_, candidate)| cut(candidate)).collect()
}

/// Levenshtein's distance.
fn edit_distance(a: &[char], b: &[char]) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closest_names_come_first() {
        let names = ["base", "flange", "link_1", "frange_2"];
        assert_eq!(closest_names("flagne", names.into_iter())[0], "flange");
    }
}

//! SRDF: which pairs of links are never checked against each other.

use std::collections::BTreeSet;

use super::ArmModel;
use super::xml::{XmlError, parse_xml};

/// Why an SRDF could not be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SrdfError {
    /// The text is no acceptable XML.
    #[error(transparent)]
    Xml(#[from] XmlError),
    /// The root element is not `<robot>`.
    #[error("the root element is <{found}>, expected <robot>")]
    NotARobot {
        /// The root element's name.
        found: String,
    },
    /// A `<disable_collisions>` lacks a link.
    #[error("the <disable_collisions> number {number} has no {attribute}")]
    MissingLink {
        /// Which one, from 1.
        number: usize,
        /// `link1` or `link2`.
        attribute: &'static str,
    },
    /// Names that no link of the robot has.
    #[error("<disable_collisions> names links that the robot does not have: {}", .links.join(", "))]
    UnknownLinks {
        /// The names, each once.
        links: Vec<String>,
    },
}

/// The pairs of rigid groups of `model` (lower index first, sorted, each once) that the SRDF's
/// `disable_collisions` exempt. Pairs within one group are left out: they are rigid anyway.
///
/// # Errors
/// [`SrdfError`] for broken XML, a missing attribute, or names of links that do not exist.
pub fn disabled_group_pairs(srdf_xml: &str, model: &ArmModel) -> Result<Vec<(usize, usize)>, SrdfError> {
    let document = parse_xml(srdf_xml)?;
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        return Err(SrdfError::NotARobot { found: root.tag_name().name().chars().take(80).collect() });
    }
    let group_of: std::collections::BTreeMap<&str, usize> =
        model.links.iter().map(|link| (link.name.as_str(), link.group)).collect();
    let mut pairs = BTreeSet::new();
    let mut unknown = BTreeSet::new();
    let elements = root.children().filter(|node| node.tag_name().name() == "disable_collisions");
    for (index, node) in elements.enumerate() {
        let mut groups = [None; 2];
        for (group, attribute) in groups.iter_mut().zip(["link1", "link2"]) {
            let link =
                node.attribute(attribute).ok_or(SrdfError::MissingLink { number: index + 1, attribute })?;
            *group = group_of.get(link).copied();
            if group.is_none() && unknown.len() < 20 {
                unknown.insert(link.chars().take(80).collect::<String>());
            }
        }
        if let [Some(a), Some(b)] = groups
            && a != b
        {
            pairs.insert((a.min(b), a.max(b)));
        }
    }
    if unknown.is_empty() {
        Ok(pairs.into_iter().collect())
    } else {
        Err(SrdfError::UnknownLinks { links: unknown.into_iter().collect() })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::kinematics::{NoMeshes, library};

    fn iiwa() -> ArmModel {
        let robot = library("iiwa14").unwrap();
        ArmModel::from_urdf("iiwa14", robot.urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0
    }

    #[test]
    fn links_become_groups() {
        let model = iiwa();
        let srdf = r#"<robot name="r"><disable_collisions link1="link_7" link2="link_5" reason="Default"/>
            <disable_collisions link1="flange" link2="link_5"/>
            <disable_collisions link1="flange" link2="link_7"/></robot>"#;
        assert_eq!(disabled_group_pairs(srdf, &model), Ok(vec![(5, 7)]));
    }

    #[test]
    fn faults_are_told_apart() {
        let model = iiwa();
        let unknown = r#"<robot><disable_collisions link1="link_9" link2="hand"/></robot>"#;
        let expected = SrdfError::UnknownLinks { links: vec!["hand".into(), "link_9".into()] };
        assert_eq!(disabled_group_pairs(unknown, &model), Err(expected));
        let missing = r#"<robot><disable_collisions link1="link_1"/></robot>"#;
        let expected = SrdfError::MissingLink { number: 1, attribute: "link2" };
        assert_eq!(disabled_group_pairs(missing, &model), Err(expected));
        assert!(matches!(disabled_group_pairs("<robot>", &model), Err(SrdfError::Xml(_))));
        assert!(matches!(disabled_group_pairs("<srdf/>", &model), Err(SrdfError::NotARobot { .. })));
    }
}

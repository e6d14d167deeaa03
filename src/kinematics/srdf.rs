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

/// The pairs of links of `model` (lower index first, sorted, each once) that the SRDF's `disable_collisions` exempt from
/// each other, and no other links of their rigid groups. Pairs within one group are left out: they are rigid anyway.
///
/// # Errors
/// [`SrdfError`] for broken XML, a missing attribute, or names of links that do not exist.
pub fn disabled_link_pairs(srdf_xml: &str, model: &ArmModel) -> Result<Vec<(usize, usize)>, SrdfError> {
    let document = parse_xml(srdf_xml)?;
    let root = document.root_element();
    if root.tag_name().name() != "robot" {
        return Err(SrdfError::NotARobot { found: root.tag_name().name().chars().take(80).collect() });
    }
    let links: std::collections::BTreeMap<&str, usize> =
        model.links.iter().enumerate().map(|(index, link)| (link.name.as_str(), index)).collect();
    let mut pairs = BTreeSet::new();
    let mut unknown = BTreeSet::new();
    let elements = root.children().filter(|node| node.tag_name().name() == "disable_collisions");
    for (index, node) in elements.enumerate() {
        let mut pair = [None; 2];
        for (link, attribute) in pair.iter_mut().zip(["link1", "link2"]) {
            let name =
                node.attribute(attribute).ok_or(SrdfError::MissingLink { number: index + 1, attribute })?;
            *link = links.get(name).copied();
            if link.is_none() && unknown.len() < 20 {
                unknown.insert(name.chars().take(80).collect::<String>());
            }
        }
        if let [Some(a), Some(b)] = pair
            && model.links[a].group != model.links[b].group
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
    fn pairs_are_of_the_links_named_and_of_no_others_in_their_groups() {
        let model = iiwa();
        let link = |name: &str| model.link_index(name).unwrap();
        let srdf = r#"<robot name="r"><disable_collisions link1="link_7" link2="link_5" reason="Default"/>
            <disable_collisions link1="flange" link2="link_7"/></robot>"#;
        assert_eq!(disabled_link_pairs(srdf, &model), Ok(vec![(link("link_5"), link("link_7"))]));
        let srdf = srdf.replace(r#"link2="link_7"/>"#, r#"link2="link_5"/>"#);
        let expected = vec![(link("link_5"), link("link_7")), (link("link_5"), link("flange"))];
        assert_eq!(disabled_link_pairs(&srdf, &model), Ok(expected));
    }

    #[test]
    fn faults_are_told_apart() {
        let model = iiwa();
        let unknown = r#"<robot><disable_collisions link1="link_9" link2="hand"/></robot>"#;
        let expected = SrdfError::UnknownLinks { links: vec!["hand".into(), "link_9".into()] };
        assert_eq!(disabled_link_pairs(unknown, &model), Err(expected));
        let missing = r#"<robot><disable_collisions link1="link_1"/></robot>"#;
        let expected = SrdfError::MissingLink { number: 1, attribute: "link2" };
        assert_eq!(disabled_link_pairs(missing, &model), Err(expected));
        assert!(matches!(disabled_link_pairs("<robot>", &model), Err(SrdfError::Xml(_))));
        assert!(matches!(disabled_link_pairs("<srdf/>", &model), Err(SrdfError::NotARobot { .. })));
    }
}

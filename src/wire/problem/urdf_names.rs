//! Names in the text of a URDF that has been accepted as XML: its joints, and the links that may carry a tool.

use std::collections::BTreeSet;

use roxmltree::{Document, Node};

/// The elements of this name below the root.
fn elements<'a>(document: &'a Document<'a>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    document.root_element().children().filter(move |node| node.tag_name().name() == name)
}

/// The names of all joints; none where the text is no XML.
pub fn joint_names(urdf: &str) -> BTreeSet<String> {
    let Ok(document) = Document::parse(urdf) else { return BTreeSet::new() };
    elements(&document, "joint").filter_map(|joint| joint.attribute("name")).map(str::to_owned).collect()
}

/// The links that may carry a tool, those from which nothing hangs first.
pub fn mount_links(urdf: &str) -> Vec<String> {
    let Ok(document) = Document::parse(urdf) else { return Vec::new() };
    let end = |joint: Node<'_, '_>, which| {
        let link = joint.children().find(|node| node.tag_name().name() == which)?;
        link.attribute("link").map(str::to_owned)
    };
    let ends = |which| elements(&document, "joint").filter_map(move |joint| end(joint, which));
    let parents: BTreeSet<String> = ends("parent").collect();
    let (inner, tips): (Vec<_>, Vec<_>) = ends("child").partition(|link| parents.contains(link));
    tips.into_iter().chain(inner.into_iter().rev()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORK: &str = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
        <joint name="one" type="fixed"><parent link="a"/><child link="b"/></joint>
        <joint name="two" type="fixed"><parent link="b"/><child link="c"/></joint>
        <joint name="three" type="fixed"><parent link="a"/><child link="d"/></joint></robot>"#;

    #[test]
    fn tips_come_first() {
        assert_eq!(joint_names(FORK).into_iter().collect::<Vec<_>>(), ["one", "three", "two"]);
        assert_eq!(mount_links(FORK), ["c", "d", "b"]);
        assert!(joint_names("<robot").is_empty() && mount_links("").is_empty());
    }
}

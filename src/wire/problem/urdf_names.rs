//! Names in the text of a URDF that has been accepted as XML: its joints.

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

#[cfg(test)]
mod tests {
    use super::*;

    const FORK: &str = r#"<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
        <joint name="one" type="fixed"><parent link="a"/><child link="b"/></joint>
        <joint name="two" type="fixed"><parent link="b"/><child link="c"/></joint>
        <joint name="three" type="fixed"><parent link="a"/><child link="d"/></joint></robot>"#;

    #[test]
    fn joints_are_found() {
        assert_eq!(joint_names(FORK).into_iter().collect::<Vec<_>>(), ["one", "three", "two"]);
        assert!(joint_names("<robot").is_empty() && joint_names("").is_empty());
    }
}

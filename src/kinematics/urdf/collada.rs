//! Which COLLADA files the reader would put together wrongly.

use std::collections::BTreeSet;

use roxmltree::{Document, Node};

/// What moves a node.
const TRANSFORMS: [&str; 6] = ["matrix", "translate", "rotate", "scale", "lookat", "skew"];

/// Numbers that differ from those of no motion by less do not count.
const NO_MOTION: f64 = 1e-6;

/// Why the reader would put geometries of the visual scenes where they do not belong: it takes one place for each geometry,
/// composes the transforms of nodes in the wrong order, the unit along with them, and follows no references to nodes.
pub(super) fn misplaced(text: &str) -> Option<&'static str> {
    // What is no XML the reader refuses.
    let document = Document::parse(text).ok()?;
    let of = |name: &'static str| move |node: &Node<'_, '_>| node.tag_name().name() == name;
    let unit = document.descendants().find(of("unit")).and_then(|unit| unit.attribute("meter"));
    let is_metre = unit.and_then(|meter| meter.trim().parse::<f64>().ok()).is_none_or(|meter| meter == 1.0);
    let scenes = document.descendants().find(of("library_visual_scenes"))?;
    let mut seen = BTreeSet::new();
    for node in scenes.descendants() {
        match node.tag_name().name() {
            "instance_geometry" if node.attribute("url").is_some_and(|url| !seen.insert(url)) => {
                return Some("it puts one geometry in several places; export it with a geometry for each");
            }
            "instance_node" | "instance_controller" => {
                return Some(
                    "it refers to nodes or controllers elsewhere; export it with all geometries in place",
                );
            }
            "node" if moves(&node) => {
                if node.ancestors().skip(1).any(|above| moves(&above)) {
                    return Some("its nodes are moved within moved nodes; export it with transforms applied");
                }
                if !is_metre {
                    return Some(
                        "its nodes are moved in units other than metres; export it with transforms applied",
                    );
                }
            }
            _ => {}
        }
    }
    None
}

/// Whether a node of a scene is moved against the one before it.
fn moves(node: &Node<'_, '_>) -> bool {
    let own = node.children().filter(|child| TRANSFORMS.contains(&child.tag_name().name()));
    own.into_iter().any(|transform| {
        let text = transform.text().unwrap_or_default();
        let numbers: Option<Vec<f64>> = text.split_ascii_whitespace().map(|word| word.parse().ok()).collect();
        let Some(numbers) = numbers else { return true };
        let still: &[f64] = match transform.tag_name().name() {
            "matrix" => &[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            "translate" => &[0.0; 3],
            "scale" => &[1.0; 3],
            // The axis does not matter where nothing turns.
            "rotate" => return numbers.len() != 4 || numbers[3].abs() > NO_MOTION,
            _ => return true,
        };
        numbers.len() != still.len() || numbers.iter().zip(still).any(|(a, b)| (a - b).abs() > NO_MOTION)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(unit: &str, nodes: &str) -> String {
        format!(
            "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema'><asset><unit meter='{unit}'/></asset>\
             <library_visual_scenes><visual_scene id='s'>{nodes}</visual_scene></library_visual_scenes>\
             <library_physics_models><instance_geometry url='#a'/></library_physics_models></COLLADA>"
        )
    }

    #[test]
    fn what_the_reader_would_misplace_is_told() {
        let a = "<instance_geometry url='#a'/>";
        let still =
            "<matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</matrix><rotate>0 0 1 0</rotate><scale>1 1 1</scale>";
        let moved = "<translate>0.5 0 0</translate>";
        let good = [
            ("1", format!("<node>{a}</node>")),
            ("0.001", format!("<node>{still}<node>{still}{a}</node></node>")),
            ("1.0", format!("<node>{moved}<node>{still}{a}</node></node>")),
            ("1", format!("<node>{moved}{a}</node><node>{moved}<instance_geometry url='#b'/></node>")),
        ];
        for (unit, nodes) in good {
            assert_eq!(misplaced(&scene(unit, &nodes)), None, "{nodes}");
        }
        let bad = [
            ("1", format!("<node>{a}</node><node>{a}</node>"), "several places"),
            ("1", "<node><instance_node url='#n'/></node>".to_owned(), "refers to nodes"),
            ("1", format!("<node>{moved}<node>{moved}{a}</node></node>"), "within moved nodes"),
            ("0.001", format!("<node>{moved}{a}</node>"), "units other than metres"),
            ("0.001", format!("<node><rotate>0 0 1 90</rotate>{a}</node>"), "units other than metres"),
        ];
        for (unit, nodes, why) in bad {
            assert!(misplaced(&scene(unit, &nodes)).is_some_and(|found| found.contains(why)), "{nodes}");
        }
        assert_eq!(misplaced("no XML"), None);
    }
}

//! SHA-256 digests of documents and files.

use std::collections::BTreeMap;

use serde_json::Value;
use sha2::{Digest, Sha256};

use super::canonical;

/// `sha256:` and the hexadecimal SHA-256 of `bytes`.
pub fn sha256(bytes: &[u8]) -> String {
    let mut out = String::from("sha256:");
    for byte in Sha256::digest(bytes) {
        out.push_str(&format!("{byte:02x}"));
    }
    out
}

/// The digest of the canonical form of `value`; `None` where a number is not finite.
pub fn digest_of(value: &Value) -> Option<String> {
    let mut written = Vec::new();
    canonical::write(value, &mut written)?;
    Some(sha256(&written))
}

/// The digests of a problem document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Digests {
    /// FORMAT's `problem_digest`: over the RFC 8785 canonical JSON of the problem without `options` and `name`.
    pub problem: String,
    /// The same over the workcell alone: problems with equal ones differ at most in their objects and
    /// where these are.
    pub workcell: String,
}

impl Digests {
    /// The digests of `document`, with the values at the JSON pointers in `contents` (file and library references)
    /// replaced by the digests of what they refer to. `None` if it has no canonical form, as where it is no object.
    pub fn of(document: &Value, contents: &BTreeMap<String, String>) -> Option<Self> {
        // The canonical form of an object is that of its members, each of which is written once.
        let mut members = Vec::new();
        for (name, value) in document.as_object()? {
            if name != "options" && name != "name" {
                members.push((name, member(name, value, contents)?));
            }
        }
        members.sort_by(|(a, _), (b, _)| canonical::by_name(a, b));
        let workcell: Vec<_> =
            members.iter().filter(|(name, _)| *name == "workcell").map(|(_, m)| m.as_slice()).collect();
        let all: Vec<_> = members.iter().map(|(_, member)| member.as_slice()).collect();
        Some(Self { problem: digest_of_members(&all), workcell: digest_of_members(&workcell) })
    }
}

/// A member of the document in canonical form.
fn member(name: &str, value: &Value, contents: &BTreeMap<String, String>) -> Option<Vec<u8>> {
    let mut replaced = None;
    for (pointer, digest) in contents {
        let Some(("", rest)) = pointer.split_once('/') else { continue };
        let Some(within) = rest.strip_prefix(name).filter(|rest| rest.is_empty() || rest.starts_with('/'))
        else {
            continue;
        };
        if let Some(place) = replaced.get_or_insert_with(|| value.clone()).pointer_mut(within) {
            *place = Value::String(digest.clone());
        }
    }
    let mut written = Vec::with_capacity(4096);
    canonical::write_string(name, &mut written)?;
    written.push(b':');
    canonical::write(replaced.as_ref().unwrap_or(value), &mut written)?;
    Some(written)
}

/// The digest of an object with these members.
fn digest_of_members(members: &[&[u8]]) -> String {
    sha256(&[b"{", &members.join(&b","[..])[..], b"}"].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn known_value() {
        assert_eq!(sha256(b""), "sha256:e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    }

    fn digests(document: &Value, contents: &BTreeMap<String, String>) -> Digests {
        Digests::of(document, contents).unwrap()
    }

    #[test]
    fn members_written_one_by_one_are_the_canonical_document() {
        let document = json!({
            "objects": [{"mesh": "a.stl", "mass": 0.25}], "\u{fb33}": 1, "\u{1f600}": [], "name": "x",
            "workcell": {"arms": [{"urdf": "b.urdf", "z": 1e-7, "a": {}}]}, "options": {"seed": 1}, "schema": "s",
        });
        let contents = BTreeMap::from([
            ("/objects/0/mesh".to_owned(), sha256(b"mesh")),
            ("/workcell/arms/0/urdf".to_owned(), sha256(b"urdf")),
        ]);
        let mut whole = document.clone();
        for (pointer, digest) in &contents {
            *whole.pointer_mut(pointer).unwrap() = json!(digest);
        }
        let members = whole.as_object_mut().unwrap();
        members.retain(|name, _| name != "options" && name != "name");
        let canonical = |value: &Value| sha256(&serde_json_canonicalizer::to_vec(value).unwrap());
        let workcell = canonical(&json!({ "workcell": whole["workcell"] }));
        let expected = Digests { problem: canonical(&whole), workcell };
        assert_eq!(digests(&document, &contents), expected);
        assert_eq!(Digests::of(&json!([1]), &contents), None);
    }

    #[test]
    fn order_spelling_options_and_name_do_not_matter_the_rest_does() {
        let none = BTreeMap::new();
        let base = digests(&json!({"a": 1, "b": [2.0, 0.5]}), &none);
        let text = r#"{"b": [2, 5e-1], "options": {"seed": 3}, "name": "x", "a": 1.0}"#;
        assert_eq!(digests(&serde_json::from_str(text).unwrap(), &none), base);
        assert_ne!(digests(&json!({"a": 1, "b": [0.5, 2.0]}), &none).problem, base.problem);
    }

    #[test]
    fn objects_do_not_matter_to_the_workcell() {
        let one = json!({"workcell": {"arms": ["a"]}, "objects": [1]});
        let other = json!({"objects": [2], "workcell": {"arms": ["a"]}});
        let third = json!({"workcell": {"arms": ["b"]}, "objects": [1]});
        let none = BTreeMap::from([("/objects/0".to_owned(), sha256(b"mesh"))]);
        let digest = |document| digests(document, &none).workcell;
        assert_eq!(digest(&one), digest(&other));
        assert_ne!(digest(&one), digest(&third));
        let file = BTreeMap::from([("/workcell/arms/0".to_owned(), sha256(b"urdf"))]);
        assert_ne!(digest(&one), digests(&one, &file).workcell);
    }

    #[test]
    fn references_count_by_content() {
        let one = BTreeMap::from([("/file".to_owned(), sha256(b"content"))]);
        let other = BTreeMap::from([("/file".to_owned(), sha256(b"other"))]);
        let (a, b) = (json!({"file": "a.urdf"}), json!({"file": "b.urdf"}));
        assert_eq!(digests(&a, &one), digests(&b, &one));
        assert_ne!(digests(&a, &one), digests(&a, &other));
    }
}

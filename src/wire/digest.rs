//! SHA-256 digests of documents and files.

use std::collections::BTreeMap;

use serde_json::Value;
use sha2::{Digest, Sha256};

/// `sha256:` and the hexadecimal SHA-256 of `bytes`.
pub fn sha256(bytes: &[u8]) -> String {
    let mut out = String::from("sha256:");
    for byte in Sha256::digest(bytes) {
        out.push_str(&format!("{byte:02x}"));
    }
    out
}

/// FORMAT's `problem_digest`: over the RFC 8785 canonical JSON of the problem without `options`
/// and `name`, with the values at the JSON pointers in `contents` (file and library references)
/// replaced by the digests of what they refer to. `None` if the value has no canonical form.
pub fn problem_digest(document: &Value, contents: &BTreeMap<String, String>) -> Option<String> {
    let mut document = document.clone();
    if let Value::Object(map) = &mut document {
        map.remove("options");
        map.remove("name");
    }
    for (pointer, digest) in contents {
        if let Some(value) = document.pointer_mut(pointer) {
            *value = Value::String(digest.clone());
        }
    }
    serde_json_canonicalizer::to_vec(&document).ok().map(|canonical| sha256(&canonical))
}

/// The same over the workcell alone: problems with equal ones differ at most in their objects and
/// where these are. `None` if the value has no canonical form.
pub fn workcell_digest(document: &Value, contents: &BTreeMap<String, String>) -> Option<String> {
    let workcell = document.get("workcell").cloned().unwrap_or_default();
    problem_digest(&serde_json::json!({ "workcell": workcell }), contents)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn known_value() {
        assert_eq!(sha256(b""), "sha256:e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    }

    #[test]
    fn order_spelling_options_and_name_do_not_matter_the_rest_does() {
        let none = BTreeMap::new();
        let base = problem_digest(&json!({"a": 1, "b": [2.0, 0.5]}), &none);
        let text = r#"{"b": [2, 5e-1], "options": {"seed": 3}, "name": "x", "a": 1.0}"#;
        assert_eq!(problem_digest(&serde_json::from_str(text).unwrap(), &none), base);
        assert_ne!(problem_digest(&json!({"a": 1, "b": [0.5, 2.0]}), &none), base);
    }

    #[test]
    fn objects_do_not_matter_to_the_workcell() {
        let one = json!({"workcell": {"arms": ["a"]}, "objects": [1]});
        let other = json!({"objects": [2], "workcell": {"arms": ["a"]}});
        let third = json!({"workcell": {"arms": ["b"]}, "objects": [1]});
        let none = BTreeMap::from([("/objects/0".to_owned(), sha256(b"mesh"))]);
        let digest = |document| workcell_digest(document, &none).unwrap();
        assert_eq!(digest(&one), digest(&other));
        assert_ne!(digest(&one), digest(&third));
        let file = BTreeMap::from([("/workcell/arms/0".to_owned(), sha256(b"urdf"))]);
        assert_ne!(digest(&one), workcell_digest(&one, &file).unwrap());
    }

    #[test]
    fn references_count_by_content() {
        let one = BTreeMap::from([("/file".to_owned(), sha256(b"content"))]);
        let other = BTreeMap::from([("/file".to_owned(), sha256(b"other"))]);
        let a = json!({"file": "a.urdf"});
        let b = json!({"file": "b.urdf"});
        assert_eq!(problem_digest(&a, &one), problem_digest(&b, &one));
        assert_ne!(problem_digest(&a, &one), problem_digest(&a, &other));
    }
}

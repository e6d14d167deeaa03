//! As much of JSON Schema as the interface uses, to hold replies against it. What is not known here
//! fails the test.

use serde_json::Value;

/// Where `value` breaks `schema`, whose references lead into `root`; empty when it does not.
pub fn faults(root: &Value, schema: &Value, value: &Value) -> Vec<String> {
    let mut found = Vec::new();
    check(root, schema, value, "", &mut found);
    found
}

fn check(root: &Value, schema: &Value, value: &Value, at: &str, found: &mut Vec<String>) {
    let Some(rules) = schema.as_object() else { panic!("{schema} is no schema") };
    for (keyword, rule) in rules {
        let mut fault = |what: String| found.push(format!("{at}: {what}"));
        match keyword.as_str() {
            "$ref" => {
                let pointer = rule.as_str().unwrap().trim_start_matches('#');
                check(root, root.pointer(pointer).unwrap(), value, at, found);
            }
            "type" if !is(value, rule.as_str().unwrap()) => fault(format!("not of type {rule}: {value}")),
            "const" if rule != value => fault(format!("not {rule}: {value}")),
            "enum" if !rule.as_array().unwrap().contains(value) => fault(format!("not in {rule}: {value}")),
            "required" => {
                for name in rule.as_array().unwrap().iter().filter_map(Value::as_str) {
                    if value.is_object() && value.get(name).is_none() {
                        fault(format!("`{name}` is missing"));
                    }
                }
            }
            "properties" => {
                for (name, inner) in rule.as_object().unwrap() {
                    if let Some(member) = value.get(name) {
                        check(root, inner, member, &format!("{at}/{name}"), found);
                    }
                }
            }
            "additionalProperties" => {
                let named = rules.get("properties").and_then(Value::as_object);
                let others = value.as_object().into_iter().flatten();
                for (name, member) in others.filter(|(name, _)| named.is_none_or(|n| !n.contains_key(*name)))
                {
                    match rule {
                        Value::Bool(true) => {}
                        Value::Bool(false) => found.push(format!("{at}: `{name}` is unknown")),
                        inner => check(root, inner, member, &format!("{at}/{name}"), found),
                    }
                }
            }
            "items" => {
                for (index, item) in value.as_array().into_iter().flatten().enumerate() {
                    check(root, rule, item, &format!("{at}/{index}"), found);
                }
            }
            "anyOf" | "oneOf" => {
                let tries: Vec<Vec<String>> =
                    rule.as_array().unwrap().iter().map(|one| faults(root, one, value)).collect();
                let fits = tries.iter().filter(|faults| faults.is_empty()).count();
                if fits == 0 || (keyword == "oneOf" && fits > 1) {
                    let best = tries.into_iter().min_by_key(Vec::len).unwrap_or_default();
                    found.push(format!("{at}: fits {fits} of the alternatives; nearest: {best:?}"));
                }
            }
            "minimum" if value.as_f64() < rule.as_f64() => fault(format!("below {rule}: {value}")),
            "exclusiveMinimum" if value.as_f64() <= rule.as_f64() => {
                fault(format!("not above {rule}: {value}"))
            }
            "maximum" if value.as_f64() > rule.as_f64() => fault(format!("above {rule}: {value}")),
            "minItems" | "maxItems" => {
                let (length, bound) = (value.as_array().map_or(0, Vec::len) as u64, rule.as_u64().unwrap());
                if (keyword == "minItems" && length < bound) || (keyword == "maxItems" && length > bound) {
                    fault(format!("{length} items"));
                }
            }
            "pattern" if rule == "^sha256:[0-9a-f]{64}$" => {
                let hex = value.as_str().and_then(|text| text.strip_prefix("sha256:")).unwrap_or_default();
                if hex.len() != 64 || !hex.bytes().all(|byte| byte.is_ascii_hexdigit()) {
                    fault(format!("no digest: {value}"));
                }
            }
            // Bounds on what clients send, which the service checks itself; and what is for people.
            "type" | "const" | "enum" | "minimum" | "exclusiveMinimum" | "maximum" | "pattern" | "format"
            | "description" | "maxLength" | "minLength" | "maxProperties" | "propertyNames"
            | "contentMediaType" | "$schema" | "$defs" | "title" => {}
            other => panic!("the checker does not know `{other}`"),
        }
    }
}

fn is(value: &Value, kind: &str) -> bool {
    match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|number| number.fract() == 0.0),
        other => panic!("no type is called {other}"),
    }
}

#[test]
fn the_checker_sees_what_it_should() {
    use serde_json::json;
    let root = json!({ "a": { "type": "object", "required": ["x"], "additionalProperties": false,
        "properties": { "x": { "anyOf": [{ "type": "integer", "minimum": 1 }, { "type": "null" }] } } } });
    let schema = json!({ "type": "array", "items": { "$ref": "#/a" } });
    assert!(faults(&root, &schema, &json!([{ "x": 1 }, { "x": null }])).is_empty());
    for bad in
        [json!({}), json!([{}]), json!([{ "x": 0 }]), json!([{ "x": "1" }]), json!([{ "x": 1, "y": 1 }])]
    {
        assert!(!faults(&root, &schema, &bad).is_empty(), "{bad}");
    }
}

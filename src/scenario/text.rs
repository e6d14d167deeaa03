//! JSON as text that a person can read: what fits on a line stays on one.

use serde_json::Value;

/// Widest line.
const WIDTH: usize = 110;

/// `value` as indented JSON that ends with a line break. Lists and objects that fit the line are
/// not broken.
pub fn to_text(value: &Value) -> String {
    let mut out = String::new();
    write(value, 0, 0, &mut out);
    out.push('\n');
    out
}

/// Writes `value` at nesting `depth`; `before` characters stand on the line beyond the indent.
fn write(value: &Value, depth: usize, before: usize, out: &mut String) {
    let line = one_line(value);
    let indent = 2 * depth;
    let (open, close, members): (char, char, Vec<(Option<&String>, &Value)>) = match value {
        _ if indent + before + line.len() < WIDTH => return out.push_str(&line),
        Value::Array(list) => ('[', ']', list.iter().map(|value| (None, value)).collect()),
        Value::Object(map) => ('{', '}', map.iter().map(|(key, value)| (Some(key), value)).collect()),
        _ => return out.push_str(&line),
    };
    out.push(open);
    for (index, (key, value)) in members.iter().enumerate() {
        out.push_str(if index == 0 { "\n" } else { ",\n" });
        out.push_str(&" ".repeat(indent + 2));
        let key = key.map(|key| format!("{}: ", Value::String(key.clone()))).unwrap_or_default();
        out.push_str(&key);
        write(value, depth + 1, key.len(), out);
    }
    out.push('\n');
    out.push_str(&" ".repeat(indent));
    out.push(close);
}

fn one_line(value: &Value) -> String {
    match value {
        Value::Array(list) if !list.is_empty() => {
            let parts: Vec<String> = list.iter().map(one_line).collect();
            format!("[{}]", parts.join(", "))
        }
        Value::Object(map) if !map.is_empty() => {
            let parts: Vec<String> = map
                .iter()
                .map(|(key, value)| format!("{}: {}", Value::String(key.clone()), one_line(value)))
                .collect();
            format!("{{ {} }}", parts.join(", "))
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_text_means_the_value() {
        let long: Vec<f64> = (0..60).map(|i| f64::from(i) / 7.0).collect();
        let value = json!({"a \"b\"": {"list": long, "empty": [], "none": {}}, "s": "x\ny", "n": null});
        let text = to_text(&value);
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), value);
        assert!(text.lines().all(|line| line.len() <= WIDTH));
        assert!(text.lines().count() > 10 && text.ends_with("}\n"));
    }
}

//! Documents broken at random never panic, and their faults point at something.

use proptest::prelude::*;

use super::*;

/// Pointers to every value of a document.
fn pointers(value: &Value, at: String, out: &mut Vec<String>) {
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                pointers(value, crate::wire::json::child(&at, key), out);
            }
        }
        Value::Array(list) => {
            for (index, value) in list.iter().enumerate() {
                pointers(value, format!("{at}/{index}"), out);
            }
        }
        _ => {}
    }
    if !at.is_empty() {
        out.push(at);
    }
}

/// Values that have no business in most places.
fn odd_value() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(Value::Null),
        Just(json!(true)),
        Just(json!(0)),
        Just(json!(-1)),
        Just(json!(1e308)),
        Just(json!(-1e-308)),
        Just(json!(18446744073709551615_u64)),
        Just(json!("")),
        Just(json!("arm_1")),
        Just(json!("cube_1")),
        Just(json!("table_a_top")),
        Just(json!("\u{0}/~\u{1F600}")),
        Just(json!("../../etc/passwd")),
        Just(json!("library:")),
        Just(json!([])),
        Just(json!({})),
        Just(json!([[], {}, null])),
        Just(json!({ "x": 1e9, "y": -1e9, "z": 1e9 })),
        Just(json!({ "x": 0, "y": 0, "z": 0, "w": 0 })),
        Just(json!({ "type": "capsule", "radius": 1e-9, "length": 0 })),
        Just(json!({ "type": "convex", "points": [{ "x": 0, "y": 0, "z": 0 }, { "x": 1, "y": 0, "z": 0 },
            { "x": 0, "y": 1, "z": 0 }, { "x": 1e-9, "y": 1e-9, "z": 1e-9 }, { "x": 0, "y": 0, "z": 1e-7 }] })),
        (-2.0..2.0_f64).prop_map(|value| json!(value)),
        "[a-z_/]{0,12}".prop_map(|text| json!(text)),
    ]
}

#[derive(Debug, Clone)]
enum Mutation {
    Replace(Value),
    Remove,
    AddTo(String, Value),
    /// With the value that stands elsewhere.
    Copy(prop::sample::Index),
}

fn mutation() -> impl Strategy<Value = (prop::sample::Index, Mutation)> {
    let what = prop_oneof![
        4 => odd_value().prop_map(Mutation::Replace),
        2 => Just(Mutation::Remove),
        1 => ("[a-z]{1,8}", odd_value()).prop_map(|(key, value)| Mutation::AddTo(key, value)),
        2 => any::<prop::sample::Index>().prop_map(Mutation::Copy),
    ];
    (any::<prop::sample::Index>(), what)
}

fn mutate(document: &mut Value, index: prop::sample::Index, mutation: Mutation) {
    let mut places = Vec::new();
    pointers(document, String::new(), &mut places);
    if places.is_empty() {
        return;
    }
    let place = index.get(&places).clone();
    match mutation {
        Mutation::Replace(value) => *document.pointer_mut(&place).unwrap() = value,
        Mutation::Remove => {
            let (parent, key) = place.rsplit_once('/').unwrap();
            let key = key.replace("~1", "/").replace("~0", "~");
            match document.pointer_mut(parent).unwrap() {
                Value::Object(map) => drop(map.remove(&key)),
                Value::Array(list) => drop(list.remove(key.parse().unwrap())),
                _ => {}
            }
        }
        Mutation::AddTo(key, value) => match document.pointer_mut(&place).unwrap() {
            Value::Object(map) => drop(map.insert(key, value)),
            Value::Array(list) => list.push(value),
            _ => {}
        },
        Mutation::Copy(other) => {
            let other: &String = other.get(&places);
            let value = document.pointer(other).unwrap().clone();
            *document.pointer_mut(&place).unwrap() = value;
        }
    }
}

/// How many documents: `QUADRILLE_FUZZ_CASES` asks for more.
fn cases() -> u32 {
    std::env::var("QUADRILLE_FUZZ_CASES").ok().and_then(|text| text.parse().ok()).unwrap_or(400)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(cases()))]

    #[test]
    fn broken_documents_are_told_where(
        cell in 0..2_u8,
        mutations in prop::collection::vec(mutation(), 1..4),
    ) {
        let mut document = if cell == 0 { switch() } else { small() };
        for (index, mutation) in mutations {
            mutate(&mut document, index, mutation);
        }
        if let Err(faults) = read(&document) {
            prop_assert!(!faults.is_empty());
            for fault in &faults {
                prop_assert!(document.pointer(&fault.pointer).is_some(), "{fault}");
                prop_assert!(!fault.message.is_empty());
            }
        }
    }
}

#[test]
fn pointers_lead_to_their_values() {
    let document = json!({ "a/b": [1, { "c~d": 2 }] });
    let mut places = Vec::new();
    pointers(&document, String::new(), &mut places);
    assert_eq!(places, ["/a~1b/0", "/a~1b/1/c~0d", "/a~1b/1", "/a~1b"]);
    assert!(places.iter().all(|place| document.pointer(place).is_some()));
}

//! Text to JSON, with bounded nesting, no key twice, and the place of a syntax fault.

use std::cell::RefCell;
use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};

use super::fault::{Fault, FaultCode};

/// Parses `bytes` as one JSON value. Nesting is bounded by serde_json's limit of 128.
///
/// # Errors
/// `invalid_json` (not JSON, nested too deeply, a key twice, empty) or `not_finite` (a number
/// beyond f64), with a pointer to where it happened.
pub fn parse(bytes: &[u8]) -> Result<Value, Fault> {
    parse_bounded(bytes, DEEPEST)
}

/// As [`parse`], nested at most `depth` levels deep.
///
/// # Errors
/// As [`parse`].
pub fn parse_bounded(bytes: &[u8], depth: usize) -> Result<Value, Fault> {
    let depth = depth.min(DEEPEST);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(Fault {
            pointer: String::new(),
            code: FaultCode::InvalidJson,
            message: "the document is empty; send a JSON object".to_owned(),
        });
    }
    let path = RefCell::new(Vec::new());
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let parsed = StrictValue { path: &path, depth }
        .deserialize(&mut deserializer)
        .and_then(|value| deserializer.end().map(|()| value));
    parsed.map_err(|error| {
        let text = error.to_string();
        let (code, advice, steps) = if text.starts_with("number out of range") {
            (FaultCode::NotFinite, "give a number that a finite f64 can hold".to_owned(), usize::MAX)
        } else if text.starts_with("recursion limit exceeded") {
            (FaultCode::InvalidJson, format!("nest at most {depth} levels deep"), STEPS_TO_DEPTH)
        } else {
            (FaultCode::InvalidJson, "mend the JSON text".to_owned(), usize::MAX)
        };
        let path = path.borrow();
        let pointer = path.iter().take(steps).fold(String::new(), |pointer, step| child(&pointer, step));
        // A path that deep says nothing.
        let pointer = if pointer.len() > 512 { String::new() } else { pointer };
        Fault { pointer, code, message: format!("{text}; {advice}") }
    })
}

/// The pointer to the member `key` (or element, by its number) of the value at `pointer`.
pub fn child(pointer: &str, key: &str) -> String {
    let mut out = String::with_capacity(pointer.len() + key.len() + 1);
    out.push_str(pointer);
    out.push('/');
    for character in key.chars() {
        match character {
            '~' => out.push_str("~0"),
            '/' => out.push_str("~1"),
            other => out.push(other),
        }
    }
    out
}

/// Builds a [`Value`] and refuses a key that stands twice in one object. `path` leads to the value
/// at hand, and stays where it is when parsing fails.
struct StrictValue<'p> {
    path: &'p RefCell<Vec<String>>,
    depth: usize,
}

/// Deepest nesting, a level above the limit of serde_json.
const DEEPEST: usize = 127;
/// Steps of the pointer to what is nested too deeply: where it begins says more than where it ends.
const STEPS_TO_DEPTH: usize = 8;

impl StrictValue<'_> {
    /// For the values inside the one at hand.
    fn below(&self) -> Self {
        Self { path: self.path, depth: self.depth }
    }

    fn check_depth<E: serde::de::Error>(&self) -> Result<(), E> {
        let deep = self.path.borrow().len() >= self.depth;
        if deep { Err(E::custom("recursion limit exceeded")) } else { Ok(()) }
    }
}

impl<'de> DeserializeSeed<'de> for StrictValue<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for StrictValue<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(Value::Number(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(Value::Number(value.into()))
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Value, E> {
        Number::from_f64(value).map(Value::Number).ok_or_else(|| E::custom("number out of range"))
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(Value::String(value.to_owned()))
    }

    fn visit_string<E>(self, value: String) -> Result<Value, E> {
        Ok(Value::String(value))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut access: A) -> Result<Value, A::Error> {
        self.check_depth()?;
        let mut list = Vec::new();
        self.path.borrow_mut().push("0".to_owned());
        while let Some(value) = access.next_element_seed(self.below())? {
            list.push(value);
            if let Some(last) = self.path.borrow_mut().last_mut() {
                *last = list.len().to_string();
            }
        }
        self.path.borrow_mut().pop();
        Ok(Value::Array(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut access: A) -> Result<Value, A::Error> {
        self.check_depth()?;
        let mut map = Map::new();
        while let Some(key) = access.next_key::<String>()? {
            self.path.borrow_mut().push(key.clone());
            if map.contains_key(&key) {
                return Err(A::Error::custom(format!("the key \"{key}\" stands twice in one object")));
            }
            let value = access.next_value_seed(self.below())?;
            map.insert(key, value);
            self.path.borrow_mut().pop();
        }
        Ok(Value::Object(map))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(text: &str) -> (String, FaultCode) {
        let fault = parse(text.as_bytes()).unwrap_err();
        (fault.pointer, fault.code)
    }

    #[test]
    fn reads_what_serde_json_reads() {
        let text = r#"{"a": [1, -2, 2.5, 18446744073709551615, true, null, "x\u00e9"], "b": {"": {}}}"#;
        let expected: Value = serde_json::from_str(text).unwrap();
        assert_eq!(parse(text.as_bytes()).unwrap(), expected);
    }

    #[test]
    fn refuses_broken_text() {
        for text in
            ["", "  \n", "{", "{\"a\": 1", "[1,]", "nul", "{\"a\": NaN}", "{} {}", "\u{feff}{}", "{'a': 1}"]
        {
            assert_eq!(code(text).1, FaultCode::InvalidJson, "{text:?}");
        }
        assert_eq!(parse(&[0xff, 0xfe]).unwrap_err().code, FaultCode::InvalidJson);
    }

    #[test]
    fn refuses_deep_nesting_without_overflow() {
        assert_eq!(code(&"[".repeat(200_000)).1, FaultCode::InvalidJson);
        assert_eq!(code(&"{\"a\":".repeat(200_000)).1, FaultCode::InvalidJson);
    }

    #[test]
    fn points_at_where_deep_nesting_begins() {
        let text = format!("{{\"a\": {}", "[".repeat(100));
        let fault = parse_bounded(text.as_bytes(), 20).unwrap_err();
        assert_eq!((fault.pointer.as_str(), fault.code), ("/a/0/0/0/0/0/0/0", FaultCode::InvalidJson));
        assert!(fault.message.contains("at most 20 levels"), "{}", fault.message);
    }

    #[test]
    fn points_at_numbers_beyond_f64_and_at_keys_that_stand_twice() {
        assert_eq!(code(r#"{"a": {"b": [1, 1e999]}}"#), ("/a/b/1".to_owned(), FaultCode::NotFinite));
        assert_eq!(code(r#"{"a": {"x/y": 1, "x/y": 2}}"#), ("/a/x~1y".to_owned(), FaultCode::InvalidJson));
    }
}

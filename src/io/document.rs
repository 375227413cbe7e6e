//! Reading JSON and TOML value by value, so that every error names the file, the path of the field, what was
//! expected and what was found.

use crate::{Error, Result};
use serde::de::{Deserialize, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::Value;
use std::fmt;

/// Largest of the whole numbers that are all exact in double precision.
const MOST_EXACT: f64 = (1u64 << 53) as f64;

/// A value of a document together with its location.
pub(crate) struct Node<'a> {
    /// File name, for errors.
    pub origin: &'a str,
    /// Path of the value, as in `wind.velocity[1]`; empty for the document.
    pub path: String,
    /// The value.
    pub value: &'a Value,
}

impl<'a> Node<'a> {
    /// Creates the node of the document itself.
    pub fn root(origin: &'a str, value: &'a Value) -> Self {
        Self { origin, path: String::new(), value }
    }

    /// Returns the error that this value is not `expected`.
    pub fn invalid(&self, expected: impl Into<String>) -> Error {
        let field = if self.path.is_empty() { "document" } else { &self.path };
        Error::invalid(self.origin, field, expected, brief(self.value))
    }

    /// Fails if this is an object with a key of `absent`, each of which comes with a sentence that says what to do
    /// instead.
    pub fn deny_absent(&self, absent: &[(&str, &str)]) -> Result<()> {
        let Some(object) = self.value.as_object() else { return Ok(()) };
        match absent.iter().find(|(name, _)| object.contains_key(*name)) {
            Some((name, instead)) => Err(Error::absent(self.origin, "field", name, instead)),
            None => Ok(()),
        }
    }

    /// Fails unless this is an object whose keys are all among `known`.
    pub fn deny_unknown(&self, known: &[&str]) -> Result<()> {
        self.refuse(known, |_| true)
    }

    /// Fails if this is not an object, or if it has a key that looks like a misspelling of one in `known`.
    pub fn no_misspelling(&self, known: &[&str]) -> Result<()> {
        // Between short names the distance is always small.
        let reach = |name: &str| if name.len() > 4 { 2 } else { 1 };
        self.refuse(known, |key| {
            known.iter().any(|name| strsim::damerau_levenshtein(name, key) <= reach(name))
        })
    }

    /// Fails if this is not an object, or if it has a `refused` key that is not in `known`.
    fn refuse(&self, known: &[&str], refused: impl Fn(&str) -> bool) -> Result<()> {
        let object = self.value.as_object().ok_or_else(|| self.invalid("an object { .. }"))?;
        let Some(key) = object.keys().find(|key| !known.contains(&key.as_str()) && refused(key)) else {
            return Ok(());
        };
        let origin = match self.path.as_str() {
            "" => self.origin.to_owned(),
            path => format!("{}: {path}", self.origin),
        };
        Err(Error::unknown(origin, "field", key, known.iter().copied()))
    }

    /// Returns the member `key` of an object. A null counts as absent and so means the default.
    pub fn get(&self, key: &str) -> Option<Node<'a>> {
        let value = self.value.get(key).filter(|v| !v.is_null())?;
        let path = if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) };
        Some(Node { origin: self.origin, path, value })
    }

    /// Reads the member `key` with `read`, or returns `default` if it is absent.
    pub fn get_or<T>(&self, key: &str, default: T, read: impl Fn(&Node<'a>) -> Result<T>) -> Result<T> {
        self.get(key).map_or(Ok(default), |node| read(&node))
    }

    /// Returns the elements of an array.
    pub fn items(&self) -> Result<Vec<Node<'a>>> {
        let items = self.value.as_array().ok_or_else(|| self.invalid("an array [ .. ]"))?;
        let node = |(k, value)| Node { origin: self.origin, path: format!("{}[{k}]", self.path), value };
        Ok(items.iter().enumerate().map(node).collect())
    }

    /// Reads an array of exactly `N` elements with `read`; `expected` describes the array in errors.
    pub fn array<T, const N: usize>(
        &self,
        expected: &str,
        read: impl Fn(&Node<'a>) -> Result<T>,
    ) -> Result<[T; N]> {
        if self.value.as_array().is_none_or(|items| items.len() != N) {
            return Err(self.invalid(expected));
        }
        let read: Vec<T> = self.items()?.iter().map(read).collect::<Result<_>>()?;
        Ok(read.try_into().unwrap_or_else(|_| unreachable!("the length was checked")))
    }

    /// Reads a finite number.
    pub fn number(&self) -> Result<f64> {
        self.value.as_f64().filter(|v| v.is_finite()).ok_or_else(|| self.invalid("a number"))
    }

    /// Reads a non-negative integer. Programs that have no integers write it as `3.0`.
    pub fn count(&self) -> Result<usize> {
        let whole = |v: &f64| v.fract() == 0.0 && (0.0..=MOST_EXACT).contains(v);
        let value = self.value.as_u64().or(self.value.as_f64().filter(whole).map(|v| v as u64));
        let count = value.and_then(|v| usize::try_from(v).ok());
        count.ok_or_else(|| self.invalid("a whole number, 0 or more"))
    }

    /// Reads a number above 0.
    pub fn positive(&self) -> Result<f64> {
        self.number().ok().filter(|&v| v > 0.0).ok_or_else(|| self.invalid("a number above 0"))
    }

    /// Reads a number that is not negative.
    pub fn not_negative(&self) -> Result<f64> {
        self.number().ok().filter(|&v| v >= 0.0).ok_or_else(|| self.invalid("a number, 0 or more"))
    }

    /// Reads three numbers.
    pub fn vector(&self) -> Result<[f64; 3]> {
        self.array("three numbers [x, y, z]", Node::number)
    }

    /// Reads a truth value.
    pub fn flag(&self) -> Result<bool> {
        self.value.as_bool().ok_or_else(|| self.invalid("true or false"))
    }

    /// Reads a string.
    pub fn text(&self) -> Result<&'a str> {
        self.value.as_str().ok_or_else(|| self.invalid("a text"))
    }
}

/// Formats a value as JSON, shortened to fit on one line.
fn brief(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}

/// Parses a JSON document. Errors report line and column.
pub(crate) fn parse_json(origin: &str, text: &str) -> Result<Value> {
    // Some editors write a byte-order mark.
    let parsed = serde_json::from_str(text.trim_start_matches('\u{feff}'));
    parsed.map(|Once(value)| value).map_err(|e| {
        let place = format!("line {}, column {}", e.line(), e.column());
        let message = e.to_string();
        let mut found = message.split(" at line").next().unwrap_or_default();
        let line = text.lines().nth(e.line().saturating_sub(1)).unwrap_or_default();
        if line.get(e.column().saturating_sub(1)..).is_some_and(|rest| rest.starts_with(['/', '#'])) {
            found = "a comment, which JSON does not have";
        }
        Error::invalid(origin, place, "JSON", found)
    })
}

/// A JSON value without duplicate keys, which are errors here; `serde_json` would silently keep the last one.
struct Once(Value);

impl<'de> Deserialize<'de> for Once {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_any(OnceVisitor).map(Once)
    }
}

struct OnceVisitor;

impl<'de> Visitor<'de> for OnceVisitor {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_bool<E>(self, v: bool) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_i64<E>(self, v: i64) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_u64<E>(self, v: u64) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_f64<E>(self, v: f64) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_str<E>(self, v: &str) -> Result<Value, E> {
        Ok(v.into())
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut array = Vec::new();
        while let Some(Once(item)) = items.next_element()? {
            array.push(item);
        }
        Ok(array.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Value, A::Error> {
        let mut object = serde_json::Map::new();
        while let Some((name, Once(value))) = fields.next_entry::<String, _>()? {
            if object.contains_key(&name) {
                return Err(A::Error::custom(format!("field '{name}' for the second time")));
            }
            object.insert(name, value);
        }
        Ok(object.into())
    }
}

/// Parses a TOML document. Errors report line and column.
#[cfg(feature = "lab")]
pub(crate) fn parse_toml(origin: &str, text: &str) -> Result<Value> {
    let value: Value = toml::from_str(text).map_err(|e| {
        let at = e.span().map_or(0, |span| span.start.min(text.len()));
        let before = &text[..text.floor_char_boundary(at)];
        let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
        let place = format!("line {}, column {column}", before.matches('\n').count() + 1);
        Error::invalid(origin, place, "TOML", e.message())
    })?;
    // TOML has no null, but its `nan` and `inf` become one. They must not pass for an omitted field.
    match missing(&value) {
        Some(path) => Err(Error::invalid(origin, path, "a finite number", "nan or inf")),
        None => Ok(value),
    }
}

/// Returns the path of the first null.
fn missing(value: &Value) -> Option<String> {
    let below = |name: String, value: &Value| {
        let rest = missing(value)?;
        Some(if rest.is_empty() || rest.starts_with('[') { name + &rest } else { format!("{name}.{rest}") })
    };
    match value {
        Value::Null => Some(String::new()),
        Value::Array(items) => items.iter().enumerate().find_map(|(k, v)| below(format!("[{k}]"), v)),
        Value::Object(fields) => fields.iter().find_map(|(key, v)| below(key.clone(), v)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_are_read_as_they_are() {
        let text = r#"{"a": [1, -2, 2.5, null, true, "b"], "c": {"a": {}}}"#;
        assert_eq!(parse_json("scene.json", text).unwrap(), serde_json::from_str::<Value>(text).unwrap());
    }

    /// Earlier versions silently used the last one.
    #[test]
    fn a_duplicate_field_is_refused() {
        for text in [r#"{"grid": 8, "up": "y", "grid": 9}"#, r#"{"wind": [{"grid": 1, "grid": 1}]}"#] {
            let error = parse_json("scene.json", text).unwrap_err().to_string();
            assert!(error.starts_with("scene.json: line 1, column "), "{error}");
            assert!(error.ends_with("expected JSON, found field 'grid' for the second time"), "{error}");
        }
    }
}

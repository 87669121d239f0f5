//! Where a JSON value differs from the expected one.
//!
//! Must not know: what the values mean.

use serde_json::Value;

/// Differences of one value that are listed; the others are counted.
const MAX_LISTED: usize = 12;
/// Characters of a value in a message.
const MAX_SHOWN: usize = 160;

/// A difference, with the key at its place, as in `camera.K[0][2]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Difference {
    pub(super) key: String,
    /// Key, value found and value expected.
    pub(super) text: String,
}

/// The keys that are missing, surplus, of another type or of another value. The order of keys does not matter.
pub(super) fn differences(found: &Value, expected: &Value) -> Vec<Difference> {
    let mut list = Vec::new();
    collect(String::new(), Some(found), Some(expected), &mut list);
    if list.len() > MAX_LISTED {
        let more = list.len() - MAX_LISTED;
        list.truncate(MAX_LISTED);
        if let Some(last) = list.last_mut() {
            last.text += &format!(" (and {more} more differences)");
        }
    }
    list
}

fn collect(key: String, found: Option<&Value>, expected: Option<&Value>, list: &mut Vec<Difference>) {
    let text = match (found, expected) {
        (Some(Value::Object(found)), Some(Value::Object(expected))) => {
            let below = |name: &str| if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") };
            for (name, value) in expected {
                collect(below(name), found.get(name), Some(value), list);
            }
            for (name, value) in found.iter().filter(|(name, _)| !expected.contains_key(*name)) {
                collect(below(name), Some(value), None, list);
            }
            return;
        }
        (Some(Value::Array(found)), Some(Value::Array(expected))) if found.len() == expected.len() => {
            for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                collect(format!("{key}[{i}]"), Some(found), Some(expected), list);
            }
            return;
        }
        (found, expected) if found == expected => return,
        (None, Some(expected)) => format!("{key} is missing; it should be {}", short(expected)),
        (Some(found), None) => format!("{key} is {}; it should not be there", short(found)),
        (Some(found), Some(expected)) => {
            format!("{key} is {}; it should be {}", short(found), short(expected))
        }
        (None, None) => return,
    };
    list.push(Difference { key, text });
}

fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= MAX_SHOWN {
        return text;
    }
    text.chars().take(MAX_SHOWN).chain("...".chars()).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_kind_of_difference_is_named_with_its_key() {
        let texts = |found: Value, expected: Value| -> Vec<String> {
            differences(&found, &expected).into_iter().map(|difference| difference.text).collect()
        };
        let expected = json!({ "a": { "b": [1, 2.0], "c": "x" }, "d": null });
        assert!(texts(expected.clone(), expected.clone()).is_empty());
        assert_eq!(
            texts(json!({ "d": null, "a": { "b": [1, 2], "c": "y", "e": 0 } }), expected.clone()),
            [
                "a.b[1] is 2; it should be 2.0",
                "a.c is \"y\"; it should be \"x\"",
                "a.e is 0; it should not be there"
            ]
        );
        assert_eq!(texts(json!({ "a": 3 }), expected.clone())[1], "d is missing; it should be null");
        assert_eq!(
            texts(json!({ "a": { "b": [1], "c": "x" }, "d": null }), expected),
            ["a.b is [1]; it should be [1,2.0]"]
        );
        let many = texts(vec![0; 99].into(), vec![1; 99].into());
        assert!(many.len() == MAX_LISTED && many[MAX_LISTED - 1].ends_with("(and 87 more differences)"));
    }
}

//! Holds a value against a schema of `/api/openapi.json`. It knows the keywords that this document uses, and panics at any
//! other: the crate `jsonschema` knows all, and brings some fifty crates for it.

use serde_json::{Value, json};

/// What of a value is not as the schema says. What the schema does not describe counts, too: a reader would not know it.
pub(super) fn wrong(document: &Value, schema: &Value, value: &Value) -> Vec<String> {
    let mut check = Check { document, wrong: vec![] };
    check.value(schema, value, "it");
    check.wrong
}

struct Check<'a> {
    document: &'a Value,
    wrong: Vec<String>,
}

impl Check<'_> {
    fn must(&mut self, holds: bool, at: &str, expected: impl FnOnce() -> String) {
        if !holds {
            self.wrong.push(format!("{at}: expected {}", expected()));
        }
    }

    fn value(&mut self, schema: &Value, value: &Value, at: &str) {
        for (keyword, told) in schema.as_object().unwrap() {
            match keyword.as_str() {
                "description" | "properties" | "additionalProperties" => {}
                "$ref" => {
                    let path = told.as_str().unwrap().strip_prefix('#').unwrap();
                    let schema = self.document.pointer(path).unwrap_or_else(|| panic!("nothing is at {told}"));
                    self.value(schema, value, at);
                }
                "type" => {
                    let kinds = told.as_array().map_or(std::slice::from_ref(told), Vec::as_slice);
                    self.must(kinds.iter().any(|kind| is_a(value, kind)), at, || format!("{told}, got {value}"));
                }
                "enum" => self.must(told.as_array().unwrap().contains(value), at, || format!("{told}, got {value}")),
                "const" => self.must(told == value, at, || format!("{told}, got {value}")),
                "required" => {
                    let Value::Object(fields) = value else { continue };
                    for key in told.as_array().unwrap() {
                        self.must(fields.contains_key(key.as_str().unwrap()), at, || format!("{key}, got none"));
                    }
                }
                "items" => {
                    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
                        self.value(told, item, &format!("{at}[{i}]"));
                    }
                }
                "minItems" | "maxItems" => {
                    let (Value::Array(items), Some(limit)) = (value, told.as_u64()) else { continue };
                    let holds =
                        if keyword == "minItems" { items.len() as u64 >= limit } else { items.len() as u64 <= limit };
                    self.must(holds, at, || format!("{keyword} {limit}, got {}", items.len()));
                }
                _ => panic!("{at}: {keyword} is no keyword that is known here"),
            }
        }
        // Fields are described one by one, or all others at once.
        for (key, field) in value.as_object().into_iter().flatten() {
            let at = format!("{at}.{key}");
            match (schema.get("properties").and_then(|known| known.get(key)), schema.get("additionalProperties")) {
                (None, Some(Value::Bool(true))) => {}
                (Some(schema), _) | (None, Some(schema)) => self.value(schema, field, &at),
                (None, None) => self.must(schema.get("$ref").is_some(), &at, || "no such key".into()),
            }
        }
    }
}

fn is_a(value: &Value, kind: &Value) -> bool {
    match kind.as_str().unwrap() {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("{other} is no type"),
    }
}

#[test]
fn a_value_that_is_not_as_its_schema_says_is_told_with_its_place() {
    let document = json!({ "schemas": { "Pair": { "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 } } });
    let schema = json!({
        "type": "object",
        "required": ["at", "by"],
        "properties": {
            "at": { "$ref": "#/schemas/Pair" },
            "by": { "enum": ["pilot", "human"] },
            "lap": { "type": ["integer", "null"] },
            "asked": { "const": true },
            "ms": { "type": "object", "additionalProperties": { "type": "number" } }
        }
    });
    let good = json!({ "at": [1, 2.5], "by": "human", "lap": null, "asked": true, "ms": { "decode": 0.5 } });
    assert_eq!(wrong(&document, &schema, &good), [""; 0]);
    for (key, bad, place) in [
        ("at", json!([1]), "it.at: expected minItems 2"),
        ("at", json!([1, 2, 3]), "it.at: expected maxItems 2"),
        ("at", json!([1, "2"]), "it.at[1]: expected \"number\", got \"2\""),
        ("at", json!({}), "it.at: expected \"array\""),
        ("by", json!("nobody"), "it.by: expected [\"pilot\",\"human\"]"),
        ("lap", json!(1.5), "it.lap: expected [\"integer\",\"null\"]"),
        ("asked", json!(false), "it.asked: expected true"),
        ("ms", json!({ "decode": null }), "it.ms.decode: expected \"number\""),
        ("new", json!(1), "it.new: expected no such key"),
    ] {
        let mut value = good.clone();
        value[key] = bad;
        let wrong = wrong(&document, &schema, &value);
        assert!(wrong.len() == 1 && wrong[0].starts_with(place), "{key}: {wrong:?}");
    }
    assert_eq!(wrong(&document, &schema, &json!({ "by": "pilot" })), ["it: expected \"at\", got none"]);
}

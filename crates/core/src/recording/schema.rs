//! The JSON schemas in a run's file, derived from the types that are written.
//!
//! Viewers support only part of JSON Schema: Foxglove and Lichtblick (`parseJsonSchema.ts`) give up on a channel if a
//! property is a reference, may be null, or is one of several. So each property has one type and is inlined; the
//! `oneOf` of a tagged enum, which they ignore, stays at the root.

use schemars::{JsonSchema, generate::SchemaSettings, transform::transform_subschemas};
use serde_json::{Map, Value, json};

/// The schema of a `T` as it is written.
pub(super) fn of<T: JsonSchema>(description: &str) -> Vec<u8> {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|settings| settings.inline_subschemas = true);
    let mut schema = settings.into_generator().into_root_schema_for::<T>();
    simplify(&mut schema);
    let mut schema = schema.to_value();
    if let Value::Object(fields) = &mut schema {
        gather(fields);
        fields.insert("description".into(), description.into());
    }
    schema.to_string().into_bytes()
}

/// Gives each property one type: an absent value is left out, not null, and a choice of words is an enum.
fn simplify(schema: &mut schemars::Schema) {
    transform_subschemas(&mut simplify, schema);
    let Some(fields) = schema.as_object_mut() else { return };
    if let Some(Value::Array(types)) = fields.get_mut("type") {
        types.retain(|of| of != "null");
        if let [only] = &types[..] {
            fields["type"] = only.clone();
        }
    }
    if let Some(Value::Array(choices)) = fields.get("oneOf") {
        let words: Option<Vec<Value>> = choices.iter().map(|choice| choice.get("const").cloned()).collect();
        if let Some(words) = words {
            fields.remove("oneOf");
            fields.extend([("type".into(), "string".into()), ("enum".into(), words.into())]);
        }
    }
}

/// Repeats the properties of a tagged enum's variants at the root, with `kind` as a choice of words.
fn gather(fields: &mut Map<String, Value>) {
    let Some(Value::Array(variants)) = fields.get("oneOf") else { return };
    let (mut properties, mut kinds) = (Map::new(), vec![]);
    for variant in variants {
        for (name, property) in variant["properties"].as_object().into_iter().flatten() {
            match property.get("const") {
                Some(kind) => kinds.push(kind.clone()),
                // The text of one variant does not describe another's.
                None => drop(properties.insert(name.clone(), json!({ "type": property["type"] }))),
            }
        }
    }
    properties.insert("kind".into(), json!({ "type": "string", "enum": kinds }));
    fields.insert("properties".into(), properties.into());
    fields.insert("required".into(), json!(["kind"]));
    fields.insert("type".into(), "object".into());
}

#[cfg(test)]
mod tests {
    use super::{super::format::Channel, *};

    /// As viewers walk a schema: `parseJsonSchema.ts` of Foxglove Studio and Lichtblick.
    fn shown(name: &str, schema: &Value) {
        assert_eq!(schema["type"], "object", "{name}: {schema}");
        for (field, property) in schema["properties"].as_object().unwrap() {
            let property = match property["type"].as_str() {
                Some("array") => &property["items"],
                _ => property,
            };
            assert!(property.get("oneOf").is_none() && property.get("$ref").is_none(), "{name}.{field}: {property}");
            match property["type"].as_str() {
                Some("object") => shown(&format!("{name}.{field}"), property),
                of => {
                    assert!(matches!(of, Some("boolean" | "string" | "number" | "integer")), "{name}.{field}: {of:?}")
                }
            }
        }
    }

    fn schemas() -> impl Iterator<Item = (&'static str, Value)> {
        let written = Channel::ALL.into_iter().filter(|channel| channel.message_encoding() == "json");
        written.map(|channel| (channel.topic(), serde_json::from_slice(&channel.schema().data).unwrap()))
    }

    #[test]
    fn viewers_take_every_property_of_every_schema() {
        schemas().for_each(|(name, schema)| shown(name, &schema));
    }

    #[test]
    fn a_schema_knows_what_its_type_says() {
        let schemas: std::collections::BTreeMap<_, _> = schemas().collect();
        let command = &schemas["/command"];
        assert_eq!(command["properties"]["by"]["enum"], json!(["pilot", "human", "safe", "off"]));
        assert_eq!(command["properties"]["prediction"]["type"], "number");
    }
}

//! The names, schemas and numbers of the run file, shared by its two ends.

use bytes::Bytes;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

/// The version of the run file that is written, and the latest that is read.
pub const FORMAT_VERSION: u32 = 1;

/// Metadata record that tells how the run was made.
pub(super) const RUN: &str = "lapwing.run";
/// Metadata record of a clean end.
pub(super) const SUMMARY: &str = "lapwing.summary";

/// The channels of a run, in the order in which they are declared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Channel {
    Camera,
    Telemetry,
    Command,
    Event,
}

impl Channel {
    pub(super) const ALL: [Self; 4] = [Self::Camera, Self::Telemetry, Self::Command, Self::Event];

    pub(super) fn topic(self) -> &'static str {
        match self {
            Self::Camera => "/camera/center",
            Self::Telemetry => "/telemetry",
            Self::Command => "/command",
            Self::Event => "/event",
        }
    }

    pub(super) fn message_encoding(self) -> &'static str {
        if self == Self::Camera { "protobuf" } else { "json" }
    }

    /// Name, encoding and data of the schema record.
    pub(super) fn schema(self) -> (&'static str, &'static str, Vec<u8>) {
        match self {
            Self::Camera => ("foxglove.CompressedImage", "protobuf", compressed_image_schema()),
            Self::Telemetry => ("lapwing.Telemetry", "jsonschema", TELEMETRY.into()),
            Self::Command => ("lapwing.Command", "jsonschema", COMMAND.into()),
            Self::Event => ("lapwing.Event", "jsonschema", EVENT.into()),
        }
    }
}

/// A picture as Foxglove defines it: <https://docs.foxglove.dev/docs/sdk/schemas/compressed-image>.
/// The field numbers are those of its published `CompressedImage.proto`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<prost_types::Timestamp>,
    #[prost(string, tag = "4")]
    pub frame_id: String,
    #[prost(bytes = "bytes", tag = "2")]
    pub data: Bytes,
    #[prost(string, tag = "3")]
    pub format: String,
}

/// The message above and what it imports, as viewers want it: a serialised `FileDescriptorSet`.
fn compressed_image_schema() -> Vec<u8> {
    let field = |name: &str, number, kind: Type| FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        ..Default::default()
    };
    let file = |name: &str, package: &str, message: &str, fields| FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        message_type: vec![DescriptorProto { name: Some(message.into()), field: fields, ..Default::default() }],
        syntax: Some("proto3".into()),
        ..Default::default()
    };
    let timestamp = file(
        "google/protobuf/timestamp.proto",
        "google.protobuf",
        "Timestamp",
        vec![field("seconds", 1, Type::Int64), field("nanos", 2, Type::Int32)],
    );
    let image = FileDescriptorProto {
        dependency: timestamp.name.iter().cloned().collect(),
        ..file(
            "foxglove/CompressedImage.proto",
            "foxglove",
            "CompressedImage",
            vec![
                FieldDescriptorProto {
                    type_name: Some(".google.protobuf.Timestamp".into()),
                    ..field("timestamp", 1, Type::Message)
                },
                field("frame_id", 4, Type::String),
                field("data", 2, Type::Bytes),
                field("format", 3, Type::String),
            ],
        )
    };
    prost::Message::encode_to_vec(&FileDescriptorSet { file: vec![timestamp, image] })
}

const TELEMETRY: &str = r#"{
  "title": "lapwing.Telemetry",
  "description": "What the simulator told in one message",
  "type": "object",
  "required": ["steering_deg", "throttle", "speed_mph"],
  "properties": {
    "steering_deg": {"type": "number", "description": "steering angle in effect, positive to the right"},
    "throttle": {"type": "number", "description": "throttle in effect, 0 to 1"},
    "speed_mph": {"type": "number"},
    "truth": {
      "type": "object",
      "description": "what forks tell beyond the stock build",
      "properties": {
        "cte_m": {"type": "number", "description": "cross-track error"},
        "next_cte_m": {"type": "number", "description": "cross-track error a step ahead"},
        "lap": {"type": "integer"},
        "waypoint": {"type": "integer"},
        "sector": {"type": "integer"},
        "crashed": {"type": "boolean"},
        "out_of_bounds": {"type": "integer", "description": "times out of bounds so far"},
        "crashes": {"type": "integer", "description": "crashes so far"},
        "brake": {"type": "number", "description": "brake in effect, 0 to 1"},
        "distance_m": {"type": "number"},
        "sim_time_s": {"type": "number"},
        "time_to_collision_s": {"type": "number", "description": "with other traffic ahead; 60 is so long, or never"},
        "heading_error_deg": {"type": "number"},
        "position_m": {"type": "array", "items": {"type": "number"}, "description": "x right, y up, z forward"},
        "hit": {"type": "string", "description": "the collider that is hit"},
        "track": {"type": "string"},
        "timestamp": {"type": "string", "description": "the simulator's own"}
      }
    }
  }
}"#;

const COMMAND: &str = r#"{
  "title": "lapwing.Command",
  "description": "What the simulator was answered, and how that came about",
  "type": "object",
  "required": ["by", "steering", "throttle"],
  "properties": {
    "by": {"enum": ["pilot", "human", "safe", "off"], "description": "who decided"},
    "steering": {"type": "number", "description": "-1 full left to 1 full right, which is 25 degrees"},
    "throttle": {"type": "number", "description": "1 full power to -1 full brake"},
    "prediction": {"type": ["number", "null"], "description": "what the network said, raw"},
    "p": {"type": ["number", "null"], "description": "proportional part of the speed controller"},
    "i": {"type": ["number", "null"], "description": "integral part of the speed controller"},
    "saturated": {"type": "boolean", "description": "the speed controller asked for more than there is"},
    "decode_ns": {"type": "integer"},
    "preprocess_ns": {"type": "integer"},
    "forward_ns": {"type": "integer"},
    "driver_ns": {"type": "integer"},
    "latency_ns": {"type": "integer", "description": "message in to answer out"}
  }
}"#;

const EVENT: &str = r#"{
  "title": "lapwing.Event",
  "description": "What happened besides telemetry and commands",
  "type": "object",
  "required": ["kind"],
  "properties": {
    "kind": {"enum": ["takeover-began", "takeover-ended", "bad-frame", "braking-to-standstill", "frames-not-recorded", "kick",
                      "pilot-off", "pilot-armed", "simulator", "note", "run-ended"]},
    "duration_s": {"type": "number"},
    "why": {"type": "string"},
    "count_in_row": {"type": "integer"},
    "count": {"type": "integer"},
    "name": {"type": "string"},
    "payload": {"type": "string"},
    "text": {"type": "string"}
  }
}"#;

#[cfg(test)]
mod tests {
    use super::{super::items::EventRecord, *};

    fn properties(channel: Channel) -> serde_json::Value {
        serde_json::from_slice::<serde_json::Value>(&channel.schema().2).unwrap()["properties"].clone()
    }

    #[test]
    fn every_kind_of_event_and_each_of_its_fields_is_in_the_schema() {
        let text = String::new;
        let properties = properties(Channel::Event);
        let mut kinds = Vec::new();
        for event in [
            EventRecord::TakeoverBegan,
            EventRecord::TakeoverEnded { duration_s: 1.0 },
            EventRecord::BadFrame { why: text(), count_in_row: 1 },
            EventRecord::BrakingToStandstill,
            EventRecord::FramesNotRecorded { count: 1 },
            EventRecord::Kick,
            EventRecord::PilotOff { why: text() },
            EventRecord::PilotArmed,
            EventRecord::Simulator { name: text(), payload: text() },
            EventRecord::Note { text: text() },
            EventRecord::RunEnded { why: text() },
        ] {
            let value = serde_json::to_value(event).unwrap();
            for field in value.as_object().unwrap().keys() {
                assert!(properties.get(field).is_some(), "{field}");
            }
            kinds.push(value["kind"].clone());
        }
        assert_eq!(properties["kind"]["enum"], serde_json::Value::Array(kinds));
    }

    #[test]
    fn every_field_of_a_full_command_and_telemetry_is_in_its_schema() {
        let command: super::super::CommandRecord = serde_json::from_str(
            r#"{"by":"pilot","steering":0.1,"throttle":0.2,"prediction":0.1,"p":1.0,"i":1.0,"saturated":true,
                "decode_ns":1,"preprocess_ns":1,"forward_ns":1,"driver_ns":1,"latency_ns":1}"#,
        )
        .unwrap();
        let fields = serde_json::to_value(command).unwrap();
        let known = properties(Channel::Command);
        assert_eq!(
            fields.as_object().unwrap().keys().collect::<Vec<_>>(),
            known.as_object().unwrap().keys().collect::<Vec<_>>()
        );

        // Telemetry refuses fields that it does not know: whatever the schema lists must read.
        let truth = properties(Channel::Telemetry)["truth"]["properties"].clone();
        let example = |schema: &serde_json::Value| match schema["type"].as_str().unwrap() {
            "boolean" => serde_json::json!(true),
            "array" => serde_json::json!([1, 2, 3]),
            "string" => serde_json::json!("x"),
            _ => serde_json::json!(1),
        };
        let full: serde_json::Map<_, _> =
            truth.as_object().unwrap().iter().map(|(name, schema)| (name.clone(), example(schema))).collect();
        let read: crate::protocol::Truth = serde_json::from_value(full.clone().into()).unwrap();
        assert_eq!(serde_json::to_value(read).unwrap().as_object().unwrap().len(), full.len());
    }
}

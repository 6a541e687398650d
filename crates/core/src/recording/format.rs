//! The names, schemas and constants of the run file, shared by its writer and its reader.

use bytes::Bytes;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

use super::schema;
use crate::{
    protocol::Telemetry,
    turn::{CommandRecord, EventRecord},
};

/// The version of the run file that is written, and the latest that is read.
pub const FORMAT_VERSION: u32 = 1;

/// Metadata record that says how the run was made.
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
            Self::Telemetry => (
                "lapwing.Telemetry",
                "jsonschema",
                schema::of::<Telemetry>("What the simulator reported in one message"),
            ),
            Self::Command => (
                "lapwing.Command",
                "jsonschema",
                schema::of::<CommandRecord>("The answer to the simulator, and how it came about"),
            ),
            Self::Event => (
                "lapwing.Event",
                "jsonschema",
                schema::of::<EventRecord>("What happened besides telemetry and commands"),
            ),
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

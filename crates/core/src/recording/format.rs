//! The channels of a run and their schemas, shared by its writer, its reader, and whoever shows a drive as it happens.

use std::borrow::Cow;

use foxglove::{
    Encode,
    messages::{CompressedImage, FrameTransform, Log, SceneUpdate},
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// The pictures.
    Camera,
    /// What the simulator reported.
    Telemetry,
    /// The answers.
    Command,
    /// What else happened.
    Event,
    /// The events again, in words, for viewers' logs.
    Log,
    /// Where the car is, for viewers in 3D.
    Transform,
    /// The road and the car, for viewers in 3D.
    Scene,
}

/// How a channel's messages are to be read.
#[derive(Debug, Clone)]
pub struct Schema {
    /// Its name.
    pub name: &'static str,
    /// `protobuf` or `jsonschema`.
    pub encoding: &'static str,
    /// A serialised `FileDescriptorSet`, or a JSON schema.
    pub data: Cow<'static, [u8]>,
}

impl Channel {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Camera, Self::Telemetry, Self::Command, Self::Event, Self::Log, Self::Transform, Self::Scene];

    /// Those that a run's items are read from; the others only show the same once more.
    const READ: [Self; 4] = [Self::Camera, Self::Telemetry, Self::Command, Self::Event];

    /// The channel with items that is declared so.
    pub(super) fn with_items(topic: &str, encoding: &str) -> Option<Self> {
        Self::READ.into_iter().find(|c| c.topic() == topic && c.message_encoding() == encoding)
    }

    /// Its name.
    pub fn topic(self) -> &'static str {
        match self {
            Self::Camera => "/camera/center",
            Self::Telemetry => "/telemetry",
            Self::Command => "/command",
            Self::Event => "/event",
            Self::Log => "/log",
            Self::Transform => "/tf",
            Self::Scene => "/scene",
        }
    }

    /// `protobuf` or `json`.
    pub fn message_encoding(self) -> &'static str {
        match self {
            Self::Telemetry | Self::Command | Self::Event => "json",
            Self::Camera | Self::Log | Self::Transform | Self::Scene => "protobuf",
        }
    }

    /// How its messages are to be read.
    pub fn schema(self) -> Schema {
        let json = |name, data: Vec<u8>| Schema { name, encoding: "jsonschema", data: data.into() };
        match self {
            Self::Camera => of_foxglove::<CompressedImage>("foxglove.CompressedImage"),
            Self::Telemetry => {
                json("lapwing.Telemetry", schema::of::<Telemetry>("What the simulator reported in one message"))
            }
            Self::Command => json(
                "lapwing.Command",
                schema::of::<CommandRecord>("The answer to the simulator, and how it came about"),
            ),
            Self::Event => {
                json("lapwing.Event", schema::of::<EventRecord>("What happened besides telemetry and commands"))
            }
            Self::Log => of_foxglove::<Log>("foxglove.Log"),
            Self::Transform => of_foxglove::<FrameTransform>("foxglove.FrameTransform"),
            Self::Scene => of_foxglove::<SceneUpdate>("foxglove.SceneUpdate"),
        }
    }
}

/// A schema as Foxglove publishes it.
fn of_foxglove<T: Encode>(name: &'static str) -> Schema {
    let data = T::get_schema().map(|schema| schema.data).unwrap_or_default();
    Schema { name, encoding: "protobuf", data }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_channel_has_the_schema_that_its_name_promises() {
        fn named<T: Encode>() -> String {
            T::get_schema().unwrap().name
        }
        for (channel, name) in [
            (Channel::Camera, named::<CompressedImage>()),
            (Channel::Log, named::<Log>()),
            (Channel::Transform, named::<FrameTransform>()),
            (Channel::Scene, named::<SceneUpdate>()),
        ] {
            let schema = channel.schema();
            assert_eq!((schema.name, schema.encoding), (&*name, "protobuf"));
            assert!(!schema.data.is_empty(), "{name}");
        }
        for (place, channel) in Channel::ALL.into_iter().enumerate() {
            assert_eq!(channel as usize, place);
            assert_eq!(channel.message_encoding() == "json", channel.schema().encoding == "jsonschema");
        }
    }
}

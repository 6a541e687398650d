//! A run's messages: each item as it is written into a file and as viewers get it while it happens, and what is drawn of
//! it besides.

use std::{sync::Arc, time::Duration};

use foxglove::messages::{CompressedImage, Log, Timestamp, log};
use prost::Message;

use super::{
    Item,
    format::Channel,
    items::nanoseconds,
    scene::{Frames, Pointing, Roadway, scene},
};
use crate::{
    protocol::Telemetry,
    turn::{EventRecord, Severity},
};

/// The name under which events are in viewers' logs.
const NAME: &str = "lapwing";

/// A message of a channel.
#[derive(Debug, Clone, Copy)]
pub struct Encoded<'a> {
    /// Which channel's.
    pub channel: Channel,
    /// When, in nanoseconds since 1970.
    pub time_ns: u64,
    /// As the channel's schema says.
    pub data: &'a [u8],
}

/// A message that cannot be encoded, which no item can cause.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// As JSON.
    #[error("a message is no JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// As protobuf.
    #[error("a message is no protobuf: {0}")]
    Protobuf(#[from] prost::EncodeError),
}

/// Makes the messages of one run out of its items.
///
/// A telemetry with a position also gives the car's transform, and the first one on a track the scene: a car, and the
/// road if it is among those that are known here. An event that has words gives a line for the log.
#[derive(Debug)]
pub struct Messages {
    started_ns: u64,
    roads: Arc<[Roadway]>,
    frames: Frames,
    pointing: Pointing,
    /// The track that events tell of.
    course: Option<String>,
    /// The track whose scene was made, once one was.
    drawn: Option<Option<String>>,
    data: Vec<u8>,
}

impl Messages {
    /// Of a run that began then, on one of these roads if it tells its track. The names of its coordinate frames begin
    /// with `prefix`.
    pub fn new(started: jiff::Timestamp, roads: Arc<[Roadway]>, prefix: &str) -> Self {
        Self {
            started_ns: nanoseconds(started),
            roads,
            frames: Frames::of(prefix),
            pointing: Pointing::default(),
            course: None,
            drawn: None,
            data: vec![],
        }
    }

    /// Hands over the messages of an item that happened `at` this time since the run began: its own first.
    ///
    /// # Errors
    /// Those of `put`, and [`EncodeError`].
    pub fn of<E: From<EncodeError>>(
        &mut self,
        at: Duration,
        item: &Item,
        mut put: impl FnMut(Encoded<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let time_ns = self.started_ns.saturating_add(u64::try_from(at.as_nanos()).unwrap_or(u64::MAX));
        let time = timestamp(time_ns);
        let mut data = std::mem::take(&mut self.data);
        let mut give = |channel, fill: &mut dyn FnMut(&mut Vec<u8>) -> Result<(), EncodeError>| {
            data.clear();
            fill(&mut data)?;
            put(Encoded { channel, time_ns, data: &data })
        };
        match item {
            Item::Frame(jpeg) => {
                let image = CompressedImage {
                    timestamp: Some(time),
                    frame_id: self.frames.camera.clone(),
                    data: jpeg.clone(),
                    format: "jpeg".into(),
                };
                give(Channel::Camera, &mut |data| Ok(image.encode(data)?))?;
            }
            Item::Telemetry(telemetry) => {
                give(Channel::Telemetry, &mut |data| Ok(serde_json::to_writer(data, telemetry)?))?;
                if let Some(scene) = self.scene(telemetry, time) {
                    give(Channel::Scene, &mut |data| Ok(scene.encode(data)?))?;
                }
                let position = telemetry.truth.position;
                if let Some(moved) = position.and_then(|at| self.pointing.moved_to(at, time, &self.frames)) {
                    give(Channel::Transform, &mut |data| Ok(moved.encode(data)?))?;
                }
            }
            Item::Command(command) => give(Channel::Command, &mut |data| Ok(serde_json::to_writer(data, command)?))?,
            Item::Event(event) => {
                give(Channel::Event, &mut |data| Ok(serde_json::to_writer(data, event)?))?;
                match event {
                    EventRecord::Course { track, .. } => self.course = Some(track.clone()),
                    EventRecord::Reset { .. } => self.pointing.put_back(),
                    _ => {}
                }
                if let Some(line) = line(event, time) {
                    give(Channel::Log, &mut |data| Ok(line.encode(data)?))?;
                }
            }
        }
        self.data = data;
        Ok(())
    }

    /// The scene of a telemetry that is the first of its track.
    fn scene(&mut self, telemetry: &Telemetry, time: Timestamp) -> Option<foxglove::messages::SceneUpdate> {
        telemetry.truth.position?;
        let track = telemetry.truth.track.as_ref().or(self.course.as_ref());
        if self.drawn.as_ref().is_some_and(|drawn| drawn.as_ref() == track) {
            return None;
        }
        self.drawn = Some(track.cloned());
        let road = track.and_then(|track| self.roads.iter().find(|road| road.name == *track));
        Some(scene(road, time, &self.frames))
    }
}

fn timestamp(time_ns: u64) -> Timestamp {
    let seconds = u32::try_from(time_ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new(seconds, (time_ns % 1_000_000_000) as u32)
}

/// An event as a line of a log; none where it has no words.
fn line(event: &EventRecord, time: Timestamp) -> Option<Log> {
    let level = match event.severity() {
        Severity::Info => log::Level::Info,
        Severity::Warning => log::Level::Warning,
        Severity::Error => log::Level::Error,
    };
    let message = event.in_words()?;
    Some(Log { timestamp: Some(time), level: level.into(), message, name: NAME.into(), ..Log::default() })
}

#[cfg(test)]
mod tests {
    use foxglove::messages::{FrameTransform, SceneUpdate};

    use super::*;
    use crate::{
        protocol::{CameraImage, Truth},
        units::{Degrees, Metres, Mph, Throttle},
    };

    fn telemetry(z: Option<f64>, track: Option<&str>) -> Item {
        let position = z.map(|z| [0.0, 0.0, z].map(Metres::constant));
        let truth = Truth { position, track: track.map(str::to_owned), ..Truth::default() };
        let image = CameraImage::default();
        let (steering, throttle, speed) = (Degrees::ZERO, Throttle::ZERO, Mph::constant(9.0));
        Item::Telemetry(Telemetry { steering, throttle, speed, image, truth })
    }

    fn course(track: &str) -> Item {
        let track = track.to_owned();
        Item::Event(EventRecord::Course {
            track,
            length_m: 100.0,
            waypoints: 3,
            laps: None,
            edge_m: 4.0,
            scenario: None,
        })
    }

    fn roads(names: &[&str]) -> Arc<[Roadway]> {
        let edge = |x: f64| vec![[x, 0.0, 0.0], [x, 0.0, 9.0], [x + 9.0, 0.0, 9.0]];
        let road =
            |name: &&str| Roadway { name: (*name).to_owned(), left: edge(-4.0), right: edge(4.0), line: edge(0.0) };
        names.iter().map(road).collect()
    }

    /// The channels and data of these items' messages.
    fn messages(roads: Arc<[Roadway]>, items: &[Item]) -> Vec<(Channel, Vec<u8>)> {
        let mut messages = Messages::new(jiff::Timestamp::from_second(1_000).unwrap(), roads, "");
        let mut got = vec![];
        for (i, item) in items.iter().enumerate() {
            let at = Duration::from_millis(100 * i as u64);
            let put = |message: Encoded<'_>| {
                assert_eq!(message.time_ns, 1_000_000_000_000 + 100_000_000 * i as u64);
                got.push((message.channel, message.data.to_vec()));
                Ok::<_, EncodeError>(())
            };
            messages.of(at, item, put).unwrap();
        }
        got
    }

    fn channels(got: &[(Channel, Vec<u8>)]) -> Vec<Channel> {
        got.iter().map(|(channel, _)| *channel).collect()
    }

    #[test]
    fn a_road_is_drawn_once_for_each_track_that_is_known_and_never_without_a_position() {
        use Channel as C;
        let items = [
            course("lake"),
            telemetry(Some(0.0), None),
            telemetry(Some(1.0), None),
            telemetry(Some(2.0), Some("jungle")),
        ];
        let got = messages(roads(&["lake", "jungle"]), &items);
        let expected =
            [C::Event, C::Telemetry, C::Scene, C::Telemetry, C::Transform, C::Telemetry, C::Scene, C::Transform];
        assert_eq!(channels(&got), expected);
        let ids = |data: &[u8]| {
            let scene = SceneUpdate::decode(data).unwrap();
            scene.entities.into_iter().map(|entity| (entity.id, entity.frame_id)).collect::<Vec<_>>()
        };
        let pair = |id: &str, frame: &str| (id.to_owned(), frame.to_owned());
        assert_eq!(ids(&got[2].1), [pair("road", "world"), pair("car", "car")]);
        let moved = FrameTransform::decode(&*got[4].1).unwrap();
        assert_eq!((&*moved.parent_frame_id, &*moved.child_frame_id), ("world", "car"));

        let got = messages(roads(&["jungle"]), &items[..2]);
        assert_eq!(ids(&got[2].1), [pair("car", "car")], "an unknown road is not drawn");
        let got = messages(roads(&["lake"]), &[course("lake"), telemetry(None, None), telemetry(None, Some("lake"))]);
        assert_eq!(channels(&got), [C::Event, C::Telemetry, C::Telemetry]);
    }

    #[test]
    fn an_event_with_words_is_a_line_of_the_log_as_bad_as_it_is() {
        let hit = EventRecord::Collision { with: "a tree".into(), speed_mph: 9.0, own_mph: None };
        let got = messages(roads(&[]), &[Item::Event(hit), Item::Event(EventRecord::Kick)]);
        assert_eq!(channels(&got), [Channel::Event, Channel::Log, Channel::Event]);
        let line = Log::decode(&*got[1].1).unwrap();
        assert_eq!((line.level(), &*line.message), (log::Level::Error, "collision with a tree at 9.0 mph"));
        assert_eq!(line.timestamp, Some(Timestamp::new(1_000, 0)));
    }

    #[test]
    fn frames_of_several_drives_are_told_apart_by_their_prefix() {
        let mut messages = Messages::new(jiff::Timestamp::UNIX_EPOCH, roads(&[]), "2/");
        let mut image = None;
        let put = |message: Encoded<'_>| {
            image = Some(CompressedImage::decode(message.data).unwrap());
            Ok::<_, EncodeError>(())
        };
        messages.of(Duration::ZERO, &Item::Frame(vec![1, 2].into()), put).unwrap();
        assert_eq!(image.unwrap().frame_id, "2/camera_center");
    }
}

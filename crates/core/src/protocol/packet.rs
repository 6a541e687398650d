//! Engine.IO 3 packets and Socket.IO 2 events, as one text message each.

use std::borrow::Cow;

use serde_json::value::RawValue;

/// One text message of a simulator.
#[derive(Debug)]
pub enum Packet<'a> {
    /// `0…`, the handshake; a simulator never sends it, a bridge may.
    Open(&'a str),
    /// `1`: the other side leaves.
    Close,
    /// `2…`; answered with `3` and the same rest.
    Ping(&'a str),
    /// `3…`, the answer to a ping.
    Pong,
    /// `40…`: connects to a namespace. Ordinary clients only.
    Connect,
    /// `41…`: leaves a namespace.
    Disconnect,
    /// `42…`: an event.
    Event(Event<'a>),
    /// Known to the protocol but without meaning here: upgrades, no-ops, acknowledgements.
    Other,
}

/// `42["name",payload]`.
#[derive(Debug)]
pub struct Event<'a> {
    /// The event's name.
    pub name: Cow<'a, str>,
    /// Its first argument, not parsed.
    pub payload: Option<&'a RawValue>,
    /// How many arguments there are. Those beyond the first mean nothing to a bridge; the simulator's own client
    /// crashes on them.
    pub arguments: usize,
}

/// Text that is not a packet.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// Nothing in the message.
    #[error("expected an Engine.IO packet, got empty text")]
    Empty,
    /// The first character is no packet type.
    #[error("expected an Engine.IO packet that starts with 0 to 6, got {0:?}")]
    Type(String),
    /// What follows `42` is not `["name", …]`.
    #[error("expected an event [\"name\", {{…}}], got {got:?}: {why}")]
    Event {
        /// The beginning of the text.
        got: String,
        /// What the JSON reader says.
        why: String,
    },
}

fn quote(text: &str) -> String {
    text.chars().take(40).collect()
}

/// The JSON reader's error, shortened for a log: it repeats unexpected text in full.
pub(super) fn cut(why: &str) -> String {
    why.chars().take(200).collect()
}

impl<'a> Packet<'a> {
    /// Reads one text message.
    ///
    /// # Errors
    /// [`PacketError`] with the beginning of the text; the connection can continue.
    pub fn parse(text: &'a str) -> Result<Self, PacketError> {
        let rest = text.get(1..).unwrap_or("");
        Ok(match text.as_bytes().first().ok_or(PacketError::Empty)? {
            b'0' => Self::Open(rest),
            b'1' => Self::Close,
            b'2' => Self::Ping(rest),
            b'3' => Self::Pong,
            b'4' => match rest.as_bytes().first() {
                Some(b'0') => Self::Connect,
                Some(b'1') => Self::Disconnect,
                Some(b'2') => Self::Event(Event::parse(&rest[1..])?),
                _ => Self::Other,
            },
            b'5' | b'6' => Self::Other,
            _ => return Err(PacketError::Type(quote(text))),
        })
    }
}

impl<'a> Event<'a> {
    /// Reads what follows `42`: an optional namespace and acknowledgement number, then the array.
    fn parse(text: &'a str) -> Result<Self, PacketError> {
        let error = |why: String| PacketError::Event { got: quote(text), why: cut(&why) };
        let array = match (text.starts_with('/'), text.find(',')) {
            (true, Some(comma)) => &text[comma + 1..],
            _ => text,
        };
        let array = array.trim_start_matches(|c: char| c.is_ascii_digit());
        // RawValue scans nested JSON in a loop, so depth costs no stack.
        let mut parts: Vec<&RawValue> = serde_json::from_str(array).map_err(|e| error(e.to_string()))?;
        let arguments = parts.len().saturating_sub(1);
        let payload = (arguments > 0).then(|| parts.remove(1));
        let name = parts.first().ok_or_else(|| error("an empty array".into()))?;
        let Name(name) = serde_json::from_str(name.get()).map_err(|e| error(format!("its name: {e}")))?;
        Ok(Self { name, payload, arguments })
    }
}

#[derive(serde::Deserialize)]
struct Name<'a>(#[serde(borrow)] Cow<'a, str>);

#[cfg(test)]
mod tests {
    use super::*;

    fn event(text: &str) -> (String, Option<String>) {
        match Packet::parse(text) {
            Ok(Packet::Event(event)) => (event.name.into_owned(), event.payload.map(|p| p.get().to_owned())),
            other => panic!("{text}: {other:?}"),
        }
    }

    #[test]
    fn the_simulators_packets_are_told_apart() {
        assert!(matches!(Packet::parse("2"), Ok(Packet::Ping(""))));
        assert!(matches!(Packet::parse("2probe"), Ok(Packet::Ping("probe"))));
        assert!(matches!(Packet::parse("3"), Ok(Packet::Pong)));
        assert!(matches!(Packet::parse("41"), Ok(Packet::Disconnect)));
        assert!(matches!(Packet::parse("1"), Ok(Packet::Close)));
        assert!(matches!(Packet::parse("40"), Ok(Packet::Connect)));
        assert!(matches!(Packet::parse("6"), Ok(Packet::Other)));
        assert!(matches!(Packet::parse("0{\"sid\":\"x\"}"), Ok(Packet::Open("{\"sid\":\"x\"}"))));
    }

    #[test]
    fn an_event_has_a_name_and_at_most_one_payload_that_counts() {
        assert_eq!(event(r#"42["telemetry",{"a":"1"}]"#), ("telemetry".into(), Some(r#"{"a":"1"}"#.into())));
        assert_eq!(event(r#"42["telemetry",null]"#), ("telemetry".into(), Some("null".into())));
        assert_eq!(event(r#"42["telemetry"]"#), ("telemetry".into(), None));
        assert_eq!(event(r#"42/sim,17["x",1,2]"#), ("x".into(), Some("1".into())));
        assert_eq!(event(r#"42["te\u006cemetry"]"#), ("telemetry".into(), None));
    }

    #[test]
    fn what_is_no_packet_is_an_error_that_quotes_it() {
        assert_eq!(Packet::parse("").unwrap_err(), PacketError::Empty);
        assert_eq!(Packet::parse("hello").unwrap_err(), PacketError::Type("hello".into()));
        for text in ["42", "42[", "42[]", "42{}", "42[1]", "42[null,{}]", "42[\"a\",{]"] {
            assert!(matches!(Packet::parse(text), Err(PacketError::Event { .. })), "{text}");
        }
    }

    #[test]
    fn an_error_repeats_the_beginning_of_a_long_text_only() {
        for text in [format!("42\"{}\"", "x".repeat(1 << 20)), format!("42[{{\"{}\":1}}]", "x".repeat(1 << 20))] {
            assert!(Packet::parse(&text).unwrap_err().to_string().len() < 400);
        }
    }

    #[test]
    fn deep_json_is_an_error_or_skipped_and_never_a_stack_overflow() {
        let deep = "[".repeat(1_000_000);
        assert!(Packet::parse(&format!("42{deep}")).is_err());
        let closed = format!(r#"42["x",{}{}]"#, deep, "]".repeat(1_000_000));
        assert!(matches!(Packet::parse(&closed), Ok(Packet::Event(_))));
    }

    #[test]
    fn text_that_starts_with_a_wide_character_is_an_error() {
        assert!(matches!(Packet::parse("é"), Err(PacketError::Type(_))));
        assert!(matches!(Packet::parse("4é"), Ok(Packet::Other)));
    }
}

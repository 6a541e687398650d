//! Settings of the server, and of the port for viewers.

use std::{
    net::{IpAddr, Ipv4Addr},
    time::Duration,
};

use serde::{Deserialize, Serialize};

use crate::units::SpeedUnit;

/// `[bridge]`
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BridgeSettings {
    /// Address to listen on. Default 127.0.0.1: this machine only.
    pub bind: IpAddr,
    /// Port to listen on. Default 4567, the only one that the simulator dials; 0 takes a free one.
    pub port: u16,
    /// What the simulator means by `speed`. Default `mph`; some `pos_x` forks send `m/s`.
    pub speed_unit: SpeedUnit,
    /// Silence after which a simulator is sent an unrequested command, s. Default 1; use more for one that renders more
    /// slowly.
    pub kick_after_s: f64,
    /// Events for each simulator as it connects, each `["name"]` or `["name",{…}]` in JSON. Default none. udacity-gym
    /// waits for `["start_episode",{"track_name":…,"weather_name":…,"daytime_name":…}]`; the stock build ignores events
    /// that it does not know.
    pub greet: Vec<String>,
    /// Origins of the web pages that may connect and arm, each `scheme://host[:port]`. Default none:
    /// a simulator sends no `Origin`, and a browser sends one for every page.
    pub allow_origins: Vec<String>,
    /// Names and addresses that clients may use for this machine, besides `localhost` and the listening address.
    /// Default none: a web page could have pointed any other name here (DNS rebinding).
    pub allow_hosts: Vec<String>,
    /// Limits on what clients may use.
    pub limits: Limits,
}

/// `[foxglove]`: the port for Foxglove and Lichtblick.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FoxgloveSettings {
    /// Origins of the web pages that may look at drives there, each `scheme://host[:port]`, besides Foxglove's own. Default none.
    /// They can steer nothing, unlike those of [`BridgeSettings::allow_origins`].
    pub allow_origins: Vec<String>,
}

/// `[bridge.limits]`: limits on what clients may use.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Largest message, MiB. Default 4; a telemetry of the stock build is 0.02.
    pub message_mib: u32,
    /// All messages being received or waiting for an answer, together, MiB. Default 64; at least a quarter of
    /// [`connections`](Self::connections).
    pub in_flight_mib: u32,
    /// Connections at a time. Default 64.
    pub connections: u32,
    /// How long a request's head, its body or a large message may take to arrive, s, and how long a connection other
    /// than a WebSocket may stay idle. Default 10; polling clients leave theirs idle for up to 5.
    pub patience_s: f64,
}

impl Limits {
    /// [`message_mib`](Self::message_mib) in bytes.
    pub fn message(&self) -> usize {
        mib(self.message_mib)
    }

    /// [`in_flight_mib`](Self::in_flight_mib) in bytes.
    pub fn in_flight(&self) -> usize {
        mib(self.in_flight_mib)
    }

    /// [`connections`](Self::connections) as a `usize`.
    pub fn connections(&self) -> usize {
        usize::try_from(self.connections).unwrap_or(usize::MAX)
    }

    /// [`patience_s`](Self::patience_s) as a duration.
    pub fn patience(&self) -> Duration {
        Duration::from_secs_f64(self.patience_s)
    }
}

fn mib(n: u32) -> usize {
    usize::try_from(n).unwrap_or(usize::MAX).saturating_mul(1 << 20)
}

impl Default for BridgeSettings {
    fn default() -> Self {
        Self {
            bind: Ipv4Addr::LOCALHOST.into(),
            port: 4567,
            speed_unit: SpeedUnit::Mph,
            kick_after_s: 1.0,
            greet: vec![],
            allow_origins: vec![],
            allow_hosts: vec![],
            limits: Limits::default(),
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self { message_mib: 4, in_flight_mib: 64, connections: 64, patience_s: 10.0 }
    }
}

/// After a kick the bridge waits for a quarter of a second whether an answer too many is out: with less than twice that, a simulator that is
/// only a little slow would be kicked again and again.
const LEAST_KICK_S: f64 = 0.5;

impl BridgeSettings {
    /// Checks the values; the error says what was expected and what it got.
    pub(super) fn check(&self) -> Result<(), String> {
        if !(LEAST_KICK_S..=3600.0).contains(&self.kick_after_s) {
            let got = self.kick_after_s;
            return Err(format!("bridge.kick_after_s: expected {LEAST_KICK_S} to 3600 seconds, got {got}"));
        }
        for event in &self.greet {
            // Anything else crashes the simulator's client.
            use serde_json::Value::{Array, Object, String};
            let is_event = serde_json::from_str(event).is_ok_and(|value| match value {
                Array(parts) => matches!(parts.as_slice(), [String(_)] | [String(_), Object(_)]),
                _ => false,
            });
            if !is_event {
                return Err(format!(r#"bridge.greet: expected ["name"] or ["name",{{…}}] in JSON, got {event:?}"#));
            }
        }
        check_origins("bridge.allow_origins", &self.allow_origins)?;
        for host in &self.allow_hosts {
            let is_address = host.parse::<IpAddr>().is_ok();
            if host.is_empty() || (!is_address && host.contains([':', '/', '*', '@', ' '])) {
                return Err(format!("bridge.allow_hosts: expected a name or an address without a port, got {host:?}"));
            }
        }
        let Limits { message_mib, in_flight_mib, connections, patience_s } = self.limits;
        if !(0.1..=3600.0).contains(&patience_s) {
            return Err(format!("bridge.limits.patience_s: expected 0.1 to 3600 seconds, got {patience_s}"));
        }
        for (key, most, got) in [
            ("message_mib", 64, message_mib),
            ("in_flight_mib", 4096, in_flight_mib),
            ("connections", 1024, connections),
        ] {
            if !(1..=most).contains(&got) {
                return Err(format!("bridge.limits.{key}: expected 1 to {most}, got {got}"));
            }
        }
        Ok(())
    }

    /// What is wrong with the values together, once all layers are there: the keys, and why.
    pub(super) fn check_together(&self) -> Result<(), (&'static [&'static str], String)> {
        let Limits { message_mib, in_flight_mib, connections, .. } = self.limits;
        if in_flight_mib < 2 * message_mib {
            let why = format!("room for two of the largest messages ({} MiB), got {in_flight_mib}", 2 * message_mib);
            let keys = &["bridge.limits.in_flight_mib", "bridge.limits.message_mib"];
            return Err((keys, format!("bridge.limits.in_flight_mib: expected {why}")));
        }
        // Each connection has 64 KiB of its own, enough for an ordinary message.
        let least = connections.div_ceil(4);
        if in_flight_mib < least {
            let why = format!("at least {least} for {connections} connections, got {in_flight_mib}");
            let keys = &["bridge.limits.in_flight_mib", "bridge.limits.connections"];
            return Err((keys, format!("bridge.limits.in_flight_mib: expected {why}")));
        }
        Ok(())
    }
}

impl FoxgloveSettings {
    /// Checks the values; the error says what was expected and what it got.
    pub(super) fn check(&self) -> Result<(), String> {
        check_origins("foxglove.allow_origins", &self.allow_origins)
    }
}

fn check_origins(key: &str, origins: &[String]) -> Result<(), String> {
    for origin in origins {
        let host = origin.split_once("://").filter(|(scheme, _)| !scheme.is_empty()).map_or("", |(_, host)| host);
        if host.is_empty() || host.contains(['/', '*', '@', ' ']) {
            return Err(format!(
                "{key}: expected scheme://host or scheme://host:port, such as http://localhost:3000, got {origin:?}"
            ));
        }
    }
    Ok(())
}

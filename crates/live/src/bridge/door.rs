//! Who may connect: programs that use this machine's names, and our own page, but no other page in a browser.
//!
//! A browser lets any page of the web talk to this port, and says so in `Origin`. No simulator sends one, so a request
//! with an origin is refused unless the settings allow it or it is this server itself: then our own page asks, or a
//! program that names the server as its origin, as python-socketio's WebSocket does. A page may also point its own name
//! at this machine's address (DNS rebinding) and so share this very origin; its `Host` is then that name, so `Host` must
//! be a name of this machine. The port in it is ignored: a tunnel has another one, and a page cannot choose the address
//! of a name like `localhost`.
//!
//! The port for viewers lets in two origins besides, [`VIEWERS`], and no page of any other.

use std::{net::IpAddr, sync::Arc, time::Instant};

use axum::{
    Extension,
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};

use super::{Bridge, guests::Peer};
use lapwing_core::config;

/// The origins of viewers: Foxglove in a browser, and Foxglove and Lichtblick as programs of their own, whose pages are
/// files. Whoever serves Lichtblick elsewhere puts its origin into `foxglove.allow_origins`.
const VIEWERS: [&str; 2] = ["https://app.foxglove.dev", "file://"];

/// Which port this is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Port {
    /// For simulators, Socket.IO clients and pages.
    Bridge,
    /// For Foxglove and Lichtblick.
    Viewers,
}

/// A port's door.
#[derive(Clone)]
pub(super) struct Door {
    pub bridge: Arc<Bridge>,
    /// The address that is listened on.
    pub bound: IpAddr,
    pub port: Port,
}

/// Why a request is refused.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
enum Refused {
    /// `Host` is not a name of this machine.
    #[error(
        "the Host header: expected localhost, {expected} or a name in bridge.allow_hosts, got {got:?}; if that is this machine, put it into bridge.allow_hosts"
    )]
    Host {
        /// What else it may be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// The request comes from a web page.
    #[error(
        "the Origin header: expected none or one in {list}, got {got:?}; if you trust that page, put its origin into {list}"
    )]
    Page {
        /// The setting that lists origins.
        list: &'static str,
        /// The page's.
        got: String,
    },
    /// The request comes from a web page that does not say which.
    #[error("request from another site: expected a program, or a page whose origin is in {0}")]
    Site(&'static str),
}

/// Checks each request before anything else sees it.
pub(super) async fn ask(
    State(Door { bridge, bound, port }): State<Door>,
    Extension(peer): Extension<Peer>,
    request: Request,
    next: Next,
) -> Response {
    match admit(&request, bound, port, &bridge.settings) {
        Ok(None) => next.run(request).await,
        // A page that may connect may also read the answer.
        Ok(Some(origin)) => {
            let mut response = next.run(request).await;
            response.headers_mut().insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, origin);
            response.headers_mut().insert(header::VARY, HeaderValue::from_static("Origin"));
            response
        }
        Err(why) => {
            if let Some(more) = bridge.refused.due(Instant::now()) {
                let peer = peer.address;
                let (method, path) = (request.method(), request.uri().path());
                tracing::warn!("{peer}: {method} {path} was refused: {why}{more}");
            }
            (StatusCode::FORBIDDEN, format!("refused: {why}\n")).into_response()
        }
    }
}

/// Checks whether the request is allowed; returns the page's origin, if the settings allow it.
fn admit(
    request: &Request,
    bound: IpAddr,
    port: Port,
    settings: &config::Settings,
) -> Result<Option<HeaderValue>, Refused> {
    let (list, origins) = match port {
        Port::Bridge => ("bridge.allow_origins", &settings.bridge.allow_origins),
        Port::Viewers => ("foxglove.allow_origins", &settings.foxglove.allow_origins),
    };
    let headers = request.headers();
    let host = text(headers, header::HOST.as_str());
    if !is_this_machine(name_of(host), bound, &settings.bridge.allow_hosts) {
        let expected = match bound {
            bound if bound.is_unspecified() => "an address".to_owned(),
            bound if bound.is_loopback() => "a loopback address".to_owned(),
            bound => bound.to_string(),
        };
        return Err(Refused::Host { expected, got: host.chars().take(100).collect() });
    }
    // All that there is at the other port is a drive to look at.
    let is_open = port == Port::Bridge && !changes_something(request);
    let Some(origin) = headers.get(header::ORIGIN) else {
        // A browser sends no origin when a page shows a picture or a frame from here; it sends another header instead.
        return match text(headers, "sec-fetch-site") {
            "cross-site" | "same-site" if !is_open => Err(Refused::Site(list)),
            _ => Ok(None),
        };
    };
    let is = |allowed: &str| origin.as_bytes().eq_ignore_ascii_case(allowed.as_bytes());
    let listed = origins.iter().any(|allowed| is(allowed));
    let refused = || Refused::Page { list, got: shortened(origin) };
    if port == Port::Viewers {
        return match listed || VIEWERS.into_iter().any(is) {
            true => Ok(Some(origin.clone())),
            false => Err(refused()),
        };
    }
    // `Host` was checked above, so this is no page whose name was pointed here; and a page of another program on this
    // machine has another port.
    let own = origin.to_str().is_ok_and(|o| o.split_once("://").is_some_and(|(_, o)| o.eq_ignore_ascii_case(host)));
    let simulator = text(headers, header::USER_AGENT.as_str()).starts_with("websocket-sharp/");
    let path = request.uri().path();
    let ours = ["/live", "/socket.io", "/api/"].iter().any(|ours| path.starts_with(ours)) && !simulator;
    match () {
        () if listed => Ok(Some(origin.clone())),
        () if is_open || (own && ours) => Ok(None),
        () => Err(refused()),
    }
}

/// For a message.
fn shortened(origin: &HeaderValue) -> String {
    String::from_utf8_lossy(origin.as_bytes()).chars().take(100).collect()
}

/// True for all requests but the greeting at `/`.
fn changes_something(request: &Request) -> bool {
    !(request.method().is_safe() && request.uri().path() == "/")
}

fn text<'a>(headers: &'a HeaderMap, name: &str) -> &'a str {
    headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or("")
}

/// `Host` without its port.
fn name_of(host: &str) -> &str {
    match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    }
}

fn is_this_machine(name: &str, bound: IpAddr, allowed: &[String]) -> bool {
    if name.eq_ignore_ascii_case("localhost") || allowed.iter().any(|allowed| allowed.eq_ignore_ascii_case(name)) {
        return true;
    }
    // A tunnel to another address of this machine begins at a loopback address. An address, unlike a name, cannot be
    // made to point elsewhere, so when listening on all addresses any will do (behind NAT, clients use addresses that
    // the machine does not have).
    name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback() || bound.is_unspecified() || address == bound)
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn owned(list: &[&str]) -> Vec<String> {
        list.iter().map(|&s| s.to_owned()).collect()
    }

    fn settings(origins: &[&str], hosts: &[&str]) -> config::Settings {
        let mut settings = config::Settings::default();
        (settings.bridge.allow_origins, settings.bridge.allow_hosts) = (owned(origins), owned(hosts));
        settings
    }

    fn asked(method: &str, path: &str, headers: &[(&str, &str)], settings: &config::Settings, bound: &str) -> bool {
        let mut request = Request::builder().method(method).uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        admit(&request.body(Body::empty()).unwrap(), bound.parse().unwrap(), Port::Bridge, settings).is_ok()
    }

    #[test]
    fn the_viewers_port_is_for_viewers_and_no_page_of_another_site() {
        let admits = |headers: &[(&str, &str)], origins: &[&str]| {
            let mut request = Request::builder().uri("/");
            for (name, value) in headers {
                request = request.header(*name, *value);
            }
            let request = request.body(Body::empty()).unwrap();
            // Who may steer is no matter of this port.
            let mut settings = settings(&["http://localhost:3000"], &[]);
            settings.foxglove.allow_origins = owned(origins);
            admit(&request, "127.0.0.1".parse().unwrap(), Port::Viewers, &settings).is_ok()
        };
        let host = ("host", "localhost:8765");
        for origin in ["https://app.foxglove.dev", "file://"] {
            assert!(admits(&[host, ("origin", origin)], &[]), "{origin}");
            assert!(!admits(&[("host", "evil.example:8765"), ("origin", origin)], &[]), "{origin} by another name");
        }
        assert!(admits(&[host], &[]), "a program");
        for origin in [
            "https://evil.example",
            "null",
            "",
            "http://localhost:8765",
            "http://localhost:8080",
            "http://localhost:3000",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev.evil.example",
        ] {
            assert!(!admits(&[host, ("origin", origin)], &[]), "{origin}");
        }
        assert!(admits(&[host, ("origin", "http://localhost:8080")], &["http://localhost:8080"]));
        assert!(!admits(&[host, ("sec-fetch-site", "cross-site")], &[]));
    }

    #[test]
    fn a_host_must_be_a_name_of_this_machine_and_its_port_may_be_any() {
        let admits = |host: &str, bound: &str, hosts: &[&str]| {
            asked("GET", "/", &[("host", host)], &settings(&[], hosts), bound)
        };
        for host in ["localhost:4567", "LOCALHOST", "127.0.0.1:4567", "127.0.0.1:9999", "127.1.2.3", "[::1]:4567"] {
            for bound in ["127.0.0.1", "::1", "192.168.1.5", "0.0.0.0"] {
                assert!(admits(host, bound, &[]), "{host} at {bound}");
            }
        }
        for host in ["evil.example:4567", "localhost.evil.example", "127.0.0.1.evil.example", "", ":4567", "[evil]:1"] {
            for bound in ["127.0.0.1", "0.0.0.0", "::"] {
                assert!(!admits(host, bound, &[]), "{host} at {bound}");
            }
        }
        assert!(!admits("192.168.1.5:4567", "127.0.0.1", &[]), "not what is listened on");
        assert!(admits("192.168.1.5:4567", "192.168.1.5", &[]) && !admits("192.168.1.6:4567", "192.168.1.5", &[]));
        assert!(admits("192.168.1.5:4567", "0.0.0.0", &[]) && admits("[fe80::1]:4567", "::", &[]));
        assert!(admits("car.local:4567", "0.0.0.0", &["Car.local"]), "named in the settings");
        assert!(!asked("GET", "/", &[], &settings(&[], &[]), "127.0.0.1"), "no Host at all");
    }

    #[test]
    fn a_page_is_let_in_only_if_the_settings_name_its_origin() {
        let admits = |method: &str, path: &str, origin: &str, origins: &[&str]| {
            let headers = [("host", "127.0.0.1:4567"), ("origin", origin)];
            asked(method, path, &headers, &settings(origins, &[]), "127.0.0.1")
        };
        for origin in ["http://evil.example", "null", "http://127.0.0.1:8000", "https://localhost:4567", ""] {
            for (method, path) in [("GET", "/socket.io/"), ("POST", "/socket.io/"), ("POST", "/arm"), ("POST", "/")] {
                assert!(!admits(method, path, origin, &[]), "{method} {path} from {origin}");
            }
            assert!(admits("GET", "/", origin, &[]), "the greeting changes nothing");
        }
        assert!(admits("POST", "/arm", "http://localhost:3000", &["http://LOCALHOST:3000"]));
        assert!(!admits("POST", "/arm", "http://localhost:3001", &["http://localhost:3000"]));
    }

    #[test]
    fn a_page_that_may_look_at_the_viewers_port_may_not_steer() {
        let page = [("host", "127.0.0.1:4567"), ("origin", "http://localhost:8080")];
        let mut settings = settings(&[], &[]);
        settings.foxglove.allow_origins = owned(&["http://localhost:8080"]);
        for (method, path) in [("POST", "/api/drives/1/control"), ("POST", "/arm"), ("GET", "/live")] {
            assert!(!asked(method, path, &page, &settings, "127.0.0.1"), "{path}");
        }
    }

    #[test]
    fn who_names_the_bridge_as_its_origin_is_our_page_or_an_ordinary_client_and_no_simulator() {
        let own = [("host", "127.0.0.1:4567"), ("origin", "http://127.0.0.1:4567")];
        let bare = settings(&[], &[]);
        assert!(asked("GET", "/socket.io/", &own, &bare, "127.0.0.1"));
        assert!(!asked("POST", "/arm", &own, &bare, "127.0.0.1"), "the page has a path of its own for this");
        for (method, path) in [("GET", "/live"), ("POST", "/api/drives/1/control")] {
            assert!(asked(method, path, &own, &bare, "127.0.0.1"), "{path}");
            for (host, origin) in [
                ("127.0.0.1:4567", "http://127.0.0.1:8000"),
                ("127.0.0.1:4567", "http://localhost:4567"),
                ("evil.example:4567", "http://evil.example:4567"),
            ] {
                let other = [("host", host), ("origin", origin)];
                assert!(!asked(method, path, &other, &bare, "127.0.0.1"), "{path} from {origin}");
            }
        }
        let simulator = [own[0], own[1], ("user-agent", "websocket-sharp/1.0")];
        assert!(!asked("GET", "/socket.io/", &simulator, &bare, "127.0.0.1"));
        assert!(asked("GET", "/socket.io/", &simulator, &settings(&["http://127.0.0.1:4567"], &[]), "127.0.0.1"));
    }

    #[test]
    fn a_picture_on_a_page_of_another_site_opens_no_session() {
        let picture = |site: &str| {
            let headers = [("host", "localhost:4567"), ("sec-fetch-site", site)];
            asked("GET", "/socket.io/", &headers, &settings(&[], &[]), "127.0.0.1")
        };
        assert!(!picture("cross-site") && !picture("same-site"));
        assert!(picture("none") && picture("same-origin"));
    }
}

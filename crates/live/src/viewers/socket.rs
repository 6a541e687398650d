//! A viewer's connection. Protocol: <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>, which is spoken
//! under its old name, `foxglove.websocket.v1`, and under `foxglove.sdk.v1`, the same messages.
//!
//! To the viewer go the JSON texts `serverInfo` and `advertise`, and each message of a channel as a binary one. It says
//! `subscribe` and `unsubscribe`; all else that the protocol has is for servers that take something, and is ignored.
//!
//! A slow viewer misses pictures, as each that is sent is the newest, and no events as long as the ring holds them. One that
//! reads nothing is dropped.

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
    time::Duration,
};

use axum::{
    extract::Request,
    http::{HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use base64::{Engine, engine::general_purpose::STANDARD};
use bytes::{BufMut, BytesMut};
use futures_util::StreamExt;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        self, Message,
        protocol::{Role, WebSocketConfig},
    },
};

use super::{Channel, ChannelId, News, Published, Viewers};
use crate::{
    page::Token,
    places::Place,
    websocket::{self, Chatter, Socket},
};

/// The names of the protocol, the newer one first.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Viewers that may look at a time.
pub(super) const VIEWERS: u32 = 16;
/// Bytes of a viewer's message: subscriptions to all channels take about 6 KiB.
const LARGEST: usize = 32 << 10;
/// Messages that a viewer may send within a second.
const CHATTY: u32 = 200;
/// Subscriptions that a viewer may have.
const SUBSCRIPTIONS: usize = 256;
/// A viewer that takes nothing for this long is gone.
const TAKES: Duration = Duration::from_secs(10);
/// The first byte of a channel's message.
const MESSAGE_DATA: u8 = 1;

/// The answers to a request without a token where one is wanted, and to one that opens no WebSocket.
const WANTS_TOKEN: &str = "expected the token that was printed at the start, as ?token=TOKEN in the address\n";
const GREETING: &str = "Lapwing is here, for Foxglove and Lichtblick: open this address there, with ws:// before it.\n";
/// The answers to a plain request for `/`, where a token is wanted and where none is; others know this port by them.
pub const GREETINGS: [&str; 2] = [WANTS_TOKEN, GREETING];

/// What a viewer says.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Said {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// Answers a request at the viewers' port.
pub(crate) fn answer(viewers: Arc<Viewers>, token: Option<&Token>, request: Request) -> Response {
    if token.is_some_and(|token| !token.is_known(request.uri(), request.headers())) {
        return (StatusCode::UNAUTHORIZED, [(header::WWW_AUTHENTICATE, "Bearer")], WANTS_TOKEN).into_response();
    }
    if !websocket::is_asked(&request) {
        return (StatusCode::UPGRADE_REQUIRED, GREETING).into_response();
    }
    let Some(protocol) = chosen(&request) else {
        let why = format!("expected the protocol {}, got another or none\n", PROTOCOLS.join(" or "));
        return (StatusCode::BAD_REQUEST, why).into_response();
    };
    let Some(place) = viewers.open.take() else {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{VIEWERS} viewers look already\n")).into_response();
    };
    let mut response = websocket::open(request, move |socket| async move {
        if let Err(error) = serve(socket, viewers, place).await {
            tracing::debug!("a viewer is gone: {error}");
        }
    });
    let name = HeaderName::from_static("sec-websocket-protocol");
    response.headers_mut().insert(name, HeaderValue::from_static(protocol));
    response
}

/// The newest protocol that the viewer offers.
fn chosen(request: &Request) -> Option<&'static str> {
    let lists = request.headers().get_all("sec-websocket-protocol").iter().filter_map(|list| list.to_str().ok());
    let offered: Vec<_> = lists.flat_map(|list| list.split(',')).map(str::trim).collect();
    PROTOCOLS.into_iter().find(|protocol| offered.contains(protocol))
}

async fn serve(socket: Socket, viewers: Arc<Viewers>, _place: Place) -> Result<(), tungstenite::Error> {
    let config = WebSocketConfig::default().read_buffer_size(4 << 10).max_message_size(Some(LARGEST));
    let socket = WebSocketStream::from_raw_socket(socket, Role::Server, Some(config)).await;
    let news = viewers.news.subscribe();
    let viewer = Viewer { socket, viewers, news, subscriptions: BTreeMap::new(), shown: HashMap::new() };
    viewer.run().await
}

struct Viewer {
    socket: WebSocketStream<Socket>,
    viewers: Arc<Viewers>,
    news: broadcast::Receiver<News>,
    /// By the viewer's own numbers.
    subscriptions: BTreeMap<u32, ChannelId>,
    /// The time of the last picture of each drive.
    shown: HashMap<usize, u64>,
}

impl Viewer {
    async fn run(mut self) -> Result<(), tungstenite::Error> {
        self.say(&server_info()).await?;
        let mut offered = self.viewers.offered.subscribe();
        let mut advertised = 0;
        offered.mark_changed();
        let mut chatter = Chatter::of(CHATTY);
        loop {
            tokio::select! {
                message = self.socket.next() => {
                    let text = match message {
                        None | Some(Ok(Message::Close(_))) => return Ok(()),
                        Some(Err(error)) => return Err(error),
                        Some(Ok(Message::Text(text))) => Some(text),
                        Some(Ok(_)) => None,
                    };
                    if chatter.is_too_much() {
                        return self.close("expected fewer messages").await;
                    }
                    let Some(text) = text else { continue };
                    match serde_json::from_str(&text) {
                        Ok(Said::Subscribe { subscriptions }) => {
                            for wanted in subscriptions {
                                self.subscribe(wanted).await?;
                                if self.subscriptions.len() > SUBSCRIPTIONS {
                                    return self.close("expected fewer subscriptions").await;
                                }
                            }
                        }
                        Ok(Said::Unsubscribe { subscription_ids }) => {
                            self.subscriptions.retain(|id, _| !subscription_ids.contains(id));
                        }
                        Ok(Said::Other) => {}
                        Err(_) => return self.close("expected messages of the protocol, as JSON").await,
                    }
                }
                changed = offered.changed() => {
                    if changed.is_err() {
                        return Ok(());
                    }
                    let now = *offered.borrow_and_update();
                    self.say(&advertise(advertised..now)).await?;
                    advertised = now;
                }
                news = self.news.recv() => match news {
                    Ok(News::Message(message)) => self.pass_on(&message).await?,
                    Ok(News::Picture(drive)) => self.picture(drive).await?,
                    Ok(News::End) | Err(RecvError::Closed) => return self.socket.close(None).await,
                    // It is far behind: the next one is the oldest in the ring.
                    Err(RecvError::Lagged(_)) => {}
                }
            }
        }
    }

    async fn subscribe(&mut self, wanted: Subscription) -> Result<(), tungstenite::Error> {
        let Some(channel) = ChannelId::numbered(wanted.channel_id) else { return Ok(()) };
        self.subscriptions.insert(wanted.id, channel);
        match self.viewers.kept(channel) {
            Some(message) => self.send(data(wanted.id, &message)).await,
            None => Ok(()),
        }
    }

    /// Sends the newest picture of a drive, if that was not sent yet.
    async fn picture(&mut self, drive: usize) -> Result<(), tungstenite::Error> {
        let Some(picture) = self.viewers.kept(ChannelId { drive, channel: Channel::Camera }) else { return Ok(()) };
        if self.shown.insert(drive, picture.time_ns) != Some(picture.time_ns) {
            self.pass_on(&picture).await?;
        }
        Ok(())
    }

    async fn pass_on(&mut self, message: &Published) -> Result<(), tungstenite::Error> {
        let wanted = self.subscriptions.iter().filter(|(_, id)| **id == message.id);
        for number in wanted.map(|(number, _)| *number).collect::<Vec<_>>() {
            self.send(data(number, message)).await?;
        }
        Ok(())
    }

    async fn say(&mut self, value: &Value) -> Result<(), tungstenite::Error> {
        self.send(Message::text(value.to_string())).await
    }

    async fn send(&mut self, message: Message) -> Result<(), tungstenite::Error> {
        websocket::send(&mut self.socket, message, TAKES).await
    }

    async fn close(&mut self, why: &'static str) -> Result<(), tungstenite::Error> {
        websocket::turn_away(&mut self.socket, why).await
    }
}

/// A channel's message for this subscription.
fn data(subscription: u32, message: &Published) -> Message {
    let mut bytes = BytesMut::with_capacity(1 + 4 + 8 + message.data.len());
    bytes.put_u8(MESSAGE_DATA);
    bytes.put_u32_le(subscription);
    bytes.put_u64_le(message.time_ns);
    bytes.extend_from_slice(&message.data);
    Message::Binary(bytes.freeze())
}

fn server_info() -> Value {
    // Without capabilities nothing is taken from a viewer.
    json!({ "op": "serverInfo", "name": format!("lapwing {}", env!("CARGO_PKG_VERSION")), "capabilities": [] })
}

/// The channels of these drives.
fn advertise(drives: std::ops::Range<usize>) -> Value {
    let ids = drives.flat_map(|drive| Channel::ALL.map(|channel| ChannelId { drive, channel }));
    let channels: Vec<_> = ids.map(advertised).collect();
    json!({ "op": "advertise", "channels": channels })
}

fn advertised(id: ChannelId) -> Value {
    let schema = id.channel.schema();
    let text = match schema.encoding {
        "protobuf" => STANDARD.encode(&schema.data),
        _ => String::from_utf8_lossy(&schema.data).into_owned(),
    };
    json!({
        "id": id.number(),
        "topic": id.topic(),
        "encoding": id.channel.message_encoding(),
        "schemaName": schema.name,
        "schema": text,
        "schemaEncoding": schema.encoding,
    })
}

//! What several tests need: pictures, telemetry, a bridge, a simulator's end of the wire.

use std::{
    env,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::Duration,
};

use base64::{Engine, engine::general_purpose::STANDARD};
use futures_util::{SinkExt, StreamExt};
use lapwing_core::config::Settings;
use lapwing_learn::models;
use lapwing_live::bridge::{self, Bridge, Listener, Summary};
use tch::{CModule, Device, Kind, Tensor};
use tokio::{net::TcpStream, sync::oneshot, task::JoinHandle, time::timeout};
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{Message, client::IntoClientRequest},
};

/// A folder of shared test data: `$LAPWING_SHARED`, by default beside the project's.
pub fn shared(folder: &str) -> Option<PathBuf> {
    let root = env::var_os("LAPWING_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let folder = root.join(folder);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(env::var_os("LAPWING_REQUIRE_SHARED").is_none_or(|v| v != "1"), "{} is absent", folder.display());
    println!("skipped: {} is absent", folder.display());
    None
}

/// A road of one's own, as its file: a ring of 20 m radius, whose lap takes 14 s at 20 mph.
pub fn ring(name: &str) -> String {
    let points: String = (0..12)
        .map(|i| std::f64::consts::TAU * f64::from(i) / 12.0)
        .map(|turn| format!("[{:.3}, 0.0, {:.3}],", 20.0 * turn.sin(), 20.0 * turn.cos()))
        .collect();
    format!(
        "name = {name:?}\ntheme = \"lake\"\nwidth_m = 8.0\nscenery_seed = 1\n\
         start = {{ x = 0.0, y = 0.0, z = 20.0, yaw_deg = 90.0 }}\ncontrol_points = [{points}]\n"
    )
}

/// A picture as the simulator sends them, 320x160.
pub fn jpeg(shade: u8) -> Vec<u8> {
    let pixels: Vec<u8> = (0..320 * 160 * 3u32).map(|i| shade.wrapping_add((i / 961 % 97) as u8)).collect();
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 75)
        .encode(&pixels, 320, 160, image::ExtendedColorType::Rgb8)
        .unwrap();
    jpeg
}

/// A stock telemetry with this picture, as base64, at this speed.
pub fn telemetry_with(image: &str, speed: &str) -> String {
    format!(r#"42["telemetry",{{"steering_angle":"0.0000","throttle":"0.0000","speed":"{speed}","image":"{image}"}}]"#)
}

/// A good stock telemetry at a speed.
pub fn telemetry(speed: &str) -> String {
    telemetry_with(&STANDARD.encode(jpeg(90)), speed)
}

/// Settings that record into `dir`, with no kick while a busy machine takes its time.
pub fn settings(dir: &Path) -> Settings {
    let mut settings = Settings::default();
    settings.recording.dir = dir.to_owned();
    settings.bridge.kick_after_s = 60.0;
    settings
}

/// The same with kicks as they are by default.
pub fn settings_with_kicks(dir: &Path) -> Settings {
    let mut settings = settings(dir);
    settings.bridge.kick_after_s = Settings::default().bridge.kick_after_s;
    settings
}

/// A bridge that runs until it is stopped.
pub struct Running {
    pub address: SocketAddr,
    pub bridge: Arc<Bridge>,
    pub summaries: Arc<Mutex<Vec<Summary>>>,
    stop: oneshot::Sender<()>,
    server: JoinHandle<std::io::Result<()>>,
}

impl Running {
    /// With the built-in model loaded.
    pub async fn start(settings: Settings) -> Self {
        let running = Self::without_a_model(settings).await;
        running.bridge.model_is_ready(models::built_in(std::time::Instant::now).unwrap());
        running
    }

    pub async fn without_a_model(settings: Settings) -> Self {
        Self::listening(([127, 0, 0, 1], 0).into(), settings).await
    }

    /// Without a model, at this address.
    pub async fn listening(at: SocketAddr, settings: Settings) -> Self {
        let listener = Listener::bind(at).await.unwrap();
        let address = listener.address();
        let summaries = Arc::<Mutex<Vec<Summary>>>::default();
        let sink = summaries.clone();
        let bridge = Bridge::new(settings, move |summary| sink.lock().unwrap().push(summary.clone()));
        let (stop, stopped) = oneshot::channel();
        let server = tokio::spawn(bridge::serve(listener, bridge.clone(), async move {
            let _ = stopped.await;
        }));
        Self { address, bridge, summaries, stop, server }
    }

    /// Ends all runs; returns what was said of them.
    pub async fn stop(self) -> Vec<Summary> {
        self.stop.send(()).unwrap();
        timeout(PATIENCE, self.server).await.expect("the bridge stops").unwrap().unwrap();
        std::mem::take(&mut self.summaries.lock().unwrap())
    }
}

/// The simulator's end of the wire.
pub struct Wire {
    pub socket: WebSocketStream<TcpStream>,
}

/// How long a test waits for what must come: long enough for a processor that other tests keep busy. That something comes in
/// time is for benchmarks to show.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// The user agent of the stock build.
pub const UNITY: &str = "websocket-sharp/1.0";

impl Wire {
    pub async fn dial(address: SocketAddr, user_agent: &str, query: &str) -> Self {
        let mut request = format!("ws://{address}/socket.io/?{query}").into_client_request().unwrap();
        request.headers_mut().insert("User-Agent", user_agent.parse().unwrap());
        let stream = TcpStream::connect(address).await.unwrap();
        let (socket, _) = client_async(request, stream).await.unwrap();
        Self { socket }
    }

    /// As the stock build dials.
    pub async fn simulator(address: SocketAddr) -> Self {
        Self::dial(address, UNITY, "EIO=4&transport=websocket").await
    }

    pub async fn send(&mut self, text: &str) {
        self.socket.send(Message::text(text)).await.unwrap();
    }

    /// The next text.
    pub async fn text(&mut self) -> String {
        self.text_within(PATIENCE).await.expect("a message within a minute, while the connection lasts")
    }

    /// The next text, or `None` if none comes in this time or the connection ends.
    pub async fn text_within(&mut self, wait: Duration) -> Option<String> {
        match timeout(wait, self.socket.next()).await {
            Err(_) => None,
            Ok(Some(Ok(Message::Text(text)))) => Some(text.to_string()),
            Ok(None | Some(Err(_) | Ok(Message::Close(_)))) => None,
            Ok(Some(Ok(other))) => panic!("the simulator dies of {other:?}"),
        }
    }

    /// Sends a message and returns its answer.
    pub async fn ask(&mut self, text: &str) -> String {
        self.send(text).await;
        self.text().await
    }

    /// Whether the other side ends the connection in this time.
    pub async fn ends_within(&mut self, wait: Duration) -> bool {
        let end = async {
            while let Some(Ok(message)) = self.socket.next().await {
                if message.is_close() {
                    return;
                }
            }
        };
        timeout(wait, end).await.is_ok()
    }
}

/// Steering and throttle of a stock `steer`, read by its literal shape.
pub fn steer(text: &str) -> (f64, f64) {
    let rest = text.strip_prefix(r#"42["steer",{"steering_angle":""#).unwrap_or_else(|| panic!("no steer: {text}"));
    let (steering, rest) = rest.split_once(r#"","throttle":""#).unwrap_or_else(|| panic!("no throttle: {text}"));
    let throttle = rest.strip_suffix(r#""}]"#).unwrap_or_else(|| panic!("more than that: {text}"));
    let number = |text: &str| {
        let mantissa = text.strip_suffix("e-4").unwrap_or_else(|| panic!("not in every culture: {text}"));
        mantissa.parse::<i32>().unwrap_or_else(|_| panic!("not in every culture: {text}")) as f64 / 1e4
    };
    (number(steering), number(throttle))
}

/// Writes a TorchScript module that answers what `answer` makes of its input, (1, 3, 4, 8) from 0 to 1, with the file
/// beside it.
pub fn torchscript(path: &Path, answer: impl Fn(&Tensor) -> Tensor) {
    let input = [Tensor::ones([1, 3, 4, 8], (Kind::Float, Device::Cpu))];
    let mut answer = |inputs: &[Tensor]| vec![answer(&inputs[0])];
    let module = CModule::create_by_tracing("Traced", "forward", &input, &mut answer).unwrap();
    module.save(path).unwrap();
    let side = "outputs = [\"steering\"]\n[preprocess]\nresize = { height = 4, width = 8, filter = \
                \"bilinear-antialiased\" }\ncolour = \"rgb\"\nscale = \"x/255\"\nlayout = \"nchw\"\n";
    std::fs::write(path.with_extension("toml"), side).unwrap();
}

/// A finite steering for a blank picture, and none for one with anything in it.
pub fn lost_for_words(input: &Tensor) -> Tensor {
    (input.std(true) * -1.0 + 0.01).sqrt()
}

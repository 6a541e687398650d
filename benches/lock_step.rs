//! The whole loop: a simulator's telemetry in its 21 fragments to the bridge and
//! its answer back. Beside it, as the limit, the same game with a server that
//! answers without looking.

use std::{
    net::{SocketAddr, TcpListener},
    thread,
    time::{Duration, Instant},
};

use divan::{Bencher, counter::ItemsCount};
use lapwing_core::{
    client::{self, ClientOptions},
    config::Settings,
    protocol::{Answer, CameraImage, Observation, Sight, Telemetry, Truth, World},
    units::{Degrees, Mph, Throttle},
};
use lapwing_learn::models;
use lapwing_live::bridge::{self, Bridge, Listener};
use tokio_tungstenite::tungstenite::{Message, accept};

const FRAMES: u32 = 1000;

/// The same telemetry again and again.
struct Standing {
    telemetry: Telemetry,
    left: u32,
}

impl World for Standing {
    type Error = std::convert::Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Self::Error> {
        self.left = match self.left.checked_sub(1) {
            Some(left) => left,
            None => return Ok(None),
        };
        Ok(Some(Observation { at: Duration::ZERO, sight: Sight::Telemetry(self.telemetry.clone()) }))
    }

    fn apply(&mut self, _: Answer) {}
}

pub(super) fn telemetry() -> Telemetry {
    Telemetry {
        steering: Degrees::ZERO,
        throttle: Throttle::ZERO,
        speed: Mph::constant(8.0),
        image: CameraImage::Jpeg(super::jpeg().into()),
        truth: Truth::default(),
    }
}

fn play(bencher: Bencher<'_, '_>, address: SocketAddr) {
    let (telemetry, address) = (telemetry(), address.to_string());
    let options = ClientOptions { greeting: Duration::ZERO, ..ClientOptions::default() };
    bencher.counter(ItemsCount::new(FRAMES)).bench_local(|| {
        let mut world = Standing { telemetry: telemetry.clone(), left: FRAMES };
        client::play(&mut world, &address, &options, |_| {}).unwrap()
    });
}

/// A thousand frames with the shipped PilotNet, recorded as always.
#[divan::bench(sample_size = 1, sample_count = 5)]
fn lock_step_1000_frames(bencher: Bencher<'_, '_>) {
    tch::set_num_threads(1);
    let dir = tempfile::tempdir().unwrap();
    let mut settings = Settings::default();
    settings.recording.dir = dir.path().to_owned();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let bridge = Bridge::new(settings, |_| {});
    bridge.model_is_ready(models::built_in(Instant::now).unwrap());
    let listener = runtime.block_on(Listener::bind(([127, 0, 0, 1], 0).into())).unwrap();
    let address = listener.address();
    let server = runtime.spawn(bridge::serve(listener, bridge, std::future::pending()));
    play(bencher, address);
    server.abort();
}

/// The limit: a server that sends the same answer whatever comes.
#[divan::bench(sample_size = 1, sample_count = 5)]
fn lock_step_1000_frames_unseen(bencher: Bencher<'_, '_>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            stream.set_nodelay(true).unwrap();
            let mut socket = accept(Armed(stream)).unwrap();
            while let Ok(message) = socket.read() {
                if message.to_text().is_ok_and(|text| text.starts_with("42")) {
                    let answer = r#"42["steer",{"steering_angle":"0e-4","throttle":"0e-4"}]"#;
                    socket.send(Message::text(answer)).unwrap();
                }
            }
        }
    });
    play(bencher, address);
}

/// `TCP_QUICKACK` after every read, as the bridge sets it.
struct Armed(std::net::TcpStream);

impl std::io::Read for Armed {
    fn read(&mut self, buf: &mut [u8]) -> std::io::Result<usize> {
        let n = self.0.read(buf)?;
        #[cfg(target_os = "linux")]
        socket2::SockRef::from(&self.0).set_tcp_quickack(true)?;
        Ok(n)
    }
}

impl std::io::Write for Armed {
    fn write(&mut self, buf: &[u8]) -> std::io::Result<usize> {
        self.0.write(buf)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

//! What the allocator keeps: the speed of a training step and of a forward pass, and the memory that large messages
//! leave behind once all clients are gone, by the allocator's settings. Each in a process of its own, for its settings
//! are a process's.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    fs,
    io::Write,
    net::SocketAddr,
    process::Command,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use divan::Bencher;
use lapwing::allocator::Allocator;
use lapwing_core::config::Settings;
use lapwing_learn::models;
use lapwing_learn::nn::{Checkpoint, runtime};
use lapwing_live::bridge::{self, Bridge, Listener};
use tch::{Device, Kind, Tensor};
use tokio_tungstenite::tungstenite::{Message, client::IntoClientRequest};

/// Names the settings that a child process is to measure.
const CHILD: &str = "LAPWING_BENCH_ALLOCATOR";

/// glibc as it comes; told to keep what it has, for libtorch; and that with Rust's large blocks mapped apart.
const SETTINGS: [&str; 3] = ["glibc's own", "all kept", "Lapwing's"];

const STEPS: usize = 6;
const ROUNDS: usize = 14;
/// Clients at a time, each with a message of 4 MiB.
const CLIENTS: usize = 4;

#[divan::bench(args = SETTINGS, sample_count = 1, sample_size = 1)]
fn allocator(bencher: Bencher<'_, '_>, setting: &str) {
    bencher.bench_local(|| {
        let me = std::env::current_exe().unwrap();
        let output = Command::new(me).env(CHILD, setting).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        eprint!("{}", String::from_utf8_lossy(&output.stdout));
    });
}

/// Measures, where this process is a child; `false` where it is not.
pub(super) fn child() -> bool {
    let Ok(setting) = std::env::var(CHILD) else { return false };
    // No large block has been made yet: each is given back as it was made.
    MAPPED.store(setting == "Lapwing's", Ordering::Relaxed);
    if setting != "glibc's own" {
        runtime::keep_tensor_memory();
    }
    let dir = tempfile::tempdir().unwrap();
    let mut trainer = super::training::trainer(dir.path(), "f32");
    let batch = trainer.batches(0, 0).unwrap().next().unwrap().unwrap();
    let tensors = trainer.tensors(batch).unwrap();
    tch::set_num_threads(1);
    let mut step = || {
        cpu_ms(|| {
            for _ in 0..STEPS {
                trainer.learn(&tensors, 1e-3).unwrap();
            }
        }) / STEPS as f64
    };
    let before = step();
    let forward = forward();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let mut settings = Settings::default();
    settings.recording.dir = dir.path().join("runs");
    let bridge = Bridge::new(settings, |_| {});
    bridge.model_is_ready(models::built_in(Instant::now).unwrap());
    let listener = runtime.block_on(Listener::bind(([127, 0, 0, 1], 0).into())).unwrap();
    let address = listener.address();
    runtime.spawn(bridge::serve(listener, bridge, std::future::pending()));
    round(address, 1 << 10);
    let quiet = resident_mib();
    let mut most = quiet;
    for _ in 0..ROUNDS {
        round(address, (4 << 20) - 200);
        thread::sleep(Duration::from_millis(200));
        most = most.max(resident_mib());
    }
    thread::sleep(Duration::from_secs(3));
    let left = resident_mib();
    println!(
        "{setting:14} training step {before:.1} ms, after the rounds {:.1}; forward {forward:.2} ms; \
         memory {quiet:.0} MiB, {most:.0} in the rounds, {left:.0} after",
        step()
    );
    true
}

/// The program's allocator, or the system's alone.
struct Chosen;

static MAPPED: AtomicBool = AtomicBool::new(true);

#[global_allocator]
static ALLOCATOR: Chosen = Chosen;

// SAFETY: one of the two for all of a process's large blocks, and for small ones they are the same.
unsafe impl GlobalAlloc for Chosen {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller has it.
        unsafe { if MAPPED.load(Ordering::Relaxed) { Allocator.alloc(layout) } else { System.alloc(layout) } }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: as the caller has it.
        unsafe {
            if MAPPED.load(Ordering::Relaxed) {
                Allocator.dealloc(block, layout)
            } else {
                System.dealloc(block, layout)
            }
        }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller has it.
        unsafe {
            if MAPPED.load(Ordering::Relaxed) { Allocator.alloc_zeroed(layout) } else { System.alloc_zeroed(layout) }
        }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as the caller has it.
        unsafe {
            if MAPPED.load(Ordering::Relaxed) {
                Allocator.realloc(block, layout, size)
            } else {
                System.realloc(block, layout, size)
            }
        }
    }
}

/// Clients that each send one telemetry of so many bytes, wait for the answer and leave.
fn round(address: SocketAddr, bytes: usize) {
    let clients: Vec<_> = (0..CLIENTS)
        .map(|_| {
            thread::spawn(move || {
                let mut request =
                    format!("ws://{address}/socket.io/?EIO=4&transport=websocket").into_client_request().unwrap();
                request.headers_mut().insert("User-Agent", "websocket-sharp/1.0".parse().unwrap());
                let stream = std::net::TcpStream::connect(address).unwrap();
                let (mut socket, _) = tokio_tungstenite::tungstenite::client(request, stream).unwrap();
                let image = "A".repeat(bytes);
                let text =
                    format!(r#"42["telemetry",{{"steering_angle":"0","throttle":"0","speed":"1","image":"{image}"}}]"#);
                socket.send(Message::text(text)).unwrap();
                socket.read().unwrap();
                let _ = socket.get_mut().flush();
            })
        })
        .collect();
    clients.into_iter().for_each(|client| client.join().unwrap());
}

fn forward() -> f64 {
    const RUNS: usize = 400;
    let network = Checkpoint::load(super::MODEL).unwrap().network;
    let input = Tensor::rand([1, 3, 66, 200], (Kind::Float, Device::Cpu)); // (1, 3, 66, 200)
    let run = || {
        for _ in 0..RUNS {
            network.forward(&input, None, false).unwrap().double_value(&[0, 0]);
        }
    };
    tch::no_grad(|| cpu_ms(run)) / RUNS as f64
}

/// Processor time of a second run, ms: unlike time on the wall it is the same on a busy machine.
fn cpu_ms(mut run: impl FnMut()) -> f64 {
    let ticks = || {
        let text = fs::read_to_string("/proc/self/stat").unwrap();
        let fields: Vec<&str> = text.rsplit(") ").next().unwrap().split(' ').collect();
        fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap() // utime, stime
    };
    run();
    let before = ticks();
    run();
    (ticks() - before) * 10.0
}

fn resident_mib() -> f64 {
    let text = fs::read_to_string("/proc/self/statm").unwrap();
    text.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() * 4096.0 / f64::from(1 << 20)
}

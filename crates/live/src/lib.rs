//! The live server, to which any build of the simulator and any Socket.IO client connects.
//!
//! ```text
//! simulator ─▶ bridge ─▶ Driver ─▶ answer
//!                 └────▶ recorder, scorer
//! ```
//! | module | holds |
//! |---|---|
//! | [`bridge`] | the port, who may connect to it, and a session for each connection |
//! | [`page`] | what drives, shown in a browser, and what a person there may change |
//! | [`viewers`] | what drives, for Foxglove and Lichtblick |
//! | `websocket` | how a WebSocket is opened for any of them |
//! | `places` | how many may look at a time |
//!
//! Callers hand it pilots ([`Model`](lapwing_core::pilot::Model)) and roads; it knows neither networks nor a simulator.
//!
//! # Example
//! A bridge on a free port, and a car at 9 mph that plays to it for three telemetries. Without a model the bridge brakes
//! every car to a standstill.
//! ```
//! use std::{convert::Infallible, time::Duration};
//! use lapwing_core::{
//!     client::{self, ClientOptions},
//!     config::Settings,
//!     protocol::{Answer, CameraImage, Observation, Sight, Telemetry, Truth, World},
//!     units::{Degrees, Mph, Throttle},
//! };
//! use lapwing_live::bridge::{self, Bridge, Listener};
//! use tokio::{sync::oneshot, task::spawn_blocking};
//!
//! #[derive(Default)]
//! struct Car {
//!     throttles: Vec<f64>,
//! }
//!
//! impl World for Car {
//!     type Error = Infallible;
//!
//!     fn observe(&mut self) -> Result<Option<Observation>, Infallible> {
//!         let telemetry = Telemetry {
//!             steering: Degrees::ZERO,
//!             throttle: Throttle::ZERO,
//!             speed: Mph::constant(9.0),
//!             image: CameraImage::Jpeg(Default::default()),
//!             truth: Truth::default(),
//!         };
//!         let at = Duration::from_millis(50 * self.throttles.len() as u64);
//!         Ok((self.throttles.len() < 3).then_some(Observation { at, sight: Sight::Telemetry(telemetry) }))
//!     }
//!
//!     fn apply(&mut self, answer: Answer) {
//!         if let Answer::Steer(command) = answer {
//!             self.throttles.push(command.throttle.get());
//!         }
//!     }
//! }
//!
//! # #[tokio::main]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut settings = Settings::default();
//! settings.recording.enabled = false;
//! let listener = Listener::bind(([127, 0, 0, 1], 0).into()).await?;
//! let address = listener.address().to_string();
//! let bridge = Bridge::new(settings, |summary| println!("{summary}"));
//! let (stop, stopped) = oneshot::channel::<()>();
//! let server = tokio::spawn(bridge::serve(listener, bridge, async { stopped.await.unwrap_or_default() }));
//!
//! let mut car = Car::default();
//! let car = spawn_blocking(move || client::play(&mut car, &address, &ClientOptions::default(), |_| ()).map(|_| car));
//! let car = car.await??;
//! assert_eq!(car.throttles.len(), 3);
//! assert!(car.throttles.iter().all(|throttle| *throttle < 0.0));
//!
//! stop.send(()).map_err(|()| "the bridge stopped by itself")?;
//! server.await??;
//! # Ok(())
//! # }
//! ```

pub mod bridge;
pub mod page;
mod places;
pub mod viewers;
mod websocket;

use std::{net::TcpListener, thread};

use super::*;
use crate::{
    protocol::{Dialect, Observation, Payload, Truth},
    units::{Metres, Mph, SpeedUnit},
};

/// Shows telemetry with truth a number of times, and remembers the answers.
struct Telling {
    left: u32,
    answers: Vec<Answer>,
}

impl World for Telling {
    type Error = std::convert::Infallible;

    fn observe(&mut self) -> Result<Option<Observation>, Self::Error> {
        let Some(left) = self.left.checked_sub(1) else { return Ok(None) };
        self.left = left;
        let telemetry = Telemetry {
            steering: Default::default(),
            throttle: Default::default(),
            speed: Mph::constant(20.0),
            image: CameraImage::Jpeg(vec![0xff; 3000].into()),
            truth: Truth { lap: Some(1), cte: Some(Metres::constant(0.5)), ..Truth::default() },
        };
        Ok(Some(Observation { at: Duration::ZERO, sight: Sight::Telemetry(telemetry) }))
    }

    fn apply(&mut self, answer: Answer) {
        self.answers.push(answer);
    }
}

/// Plays to a bridge that answers as the telemetry's dialect requires; returns what it received.
fn played(stock: bool) -> (Vec<(Dialect, Truth)>, ClientReport) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let bridge = thread::spawn(move || {
        let mut socket = tungstenite::accept(listener.accept().unwrap().0).unwrap();
        let mut heard = vec![];
        while let Ok(Message::Text(text)) = socket.read() {
            let bytes = bytes::Bytes::copy_from_slice(text.as_bytes());
            let Ok(Packet::Event(event)) = Packet::parse(&text) else { continue };
            let payload = Payload::read(event.payload).unwrap().unwrap();
            let dialect = payload.dialect(&event.name).unwrap();
            heard.push((dialect, payload.telemetry(&bytes, SpeedUnit::Mph).unwrap().truth));
            let answer = Answer::Steer(Command::default()).encode(Some(dialect));
            socket.send(Message::Text(answer.into())).unwrap();
        }
        heard
    });
    let mut world = Telling { left: 5, answers: vec![] };
    let options = ClientOptions { stock, greeting: Duration::ZERO, ..ClientOptions::default() };
    let report = play(&mut world, &address, &options, |_| {}).unwrap();
    assert_eq!(world.answers, [Answer::Steer(Command::default()); 5]);
    (bridge.join().unwrap(), report)
}

#[test]
fn ground_truth_reaches_the_bridge() {
    let (heard, report) = played(false);
    let truth = Truth { lap: Some(1), cte: Some(Metres::constant(0.5)), ..Truth::default() };
    assert_eq!(heard, vec![(Dialect::SelfOracle, truth); 5]);
    assert_eq!((report.answers, report.lost_tokens), (5, 0));
}

#[test]
fn a_stock_client_keeps_ground_truth_to_itself() {
    let (heard, _) = played(true);
    assert_eq!(heard, vec![(Dialect::Term1, Truth::default()); 5]);
}

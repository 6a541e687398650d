//! What is drawn into a film for people: speed, lap, offset, and who steers how far.

use lapwing_core::{car::FULL_STEERING_DEG, perception::Frame};
use lapwing_score::drawing::{Colour, LINE_PX, width_of, write_on};

/// A moment of a drive, as its film tells it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment<'a> {
    /// Speed in mph.
    pub mph: f64,
    /// The lap being driven, counted from 1.
    pub lap: u32,
    /// Laps asked for.
    pub laps: Option<u32>,
    /// Distance from the line to drive, in metres, positive to its right.
    pub cte_m: f64,
    /// Who steers.
    pub by: &'a str,
    /// Angle of the front wheels in degrees, positive to the right.
    pub steering_deg: f64,
}

const WORDS: Colour = [255; 3];
const MARK: Colour = [255, 210, 0];
/// Light that comes through the bar, in 256ths.
const THROUGH: u16 = 90;
/// Around the words and between them, in pixels.
const ROOM: f64 = 8.0;
/// Half of the scale of the steering, in pixels.
const REACH: f64 = 36.0;

impl Moment<'_> {
    fn words(&self) -> [String; 4] {
        let Self { mph, lap, laps, cte_m, by, steering_deg } = self;
        let of = laps.map_or_else(String::new, |laps| format!(" of {laps}"));
        // The last lap stays on show while the film runs on.
        let lap = laps.map_or(*lap, |laps| *lap.min(&laps));
        [
            format!("{mph:4.1} mph"),
            format!("lap {lap}{of}"),
            format!("cte {:+.2} m", unsigned_zero(*cte_m, 100.0)),
            format!("{by} steers {:+5.1} deg", unsigned_zero(*steering_deg, 10.0)),
        ]
    }

    /// Draws it over the lower edge of a picture, in as many lines as its width asks for.
    pub fn draw(&self, frame: &mut Frame) {
        let (width, height) = (frame.width() as f64, frame.height() as f64);
        let (mut lines, mut left) = (0, ROOM);
        // Each with its line and its left end; the scale of the steering comes last.
        let mut place = |wide: f64| {
            if left > ROOM && left + wide > width - ROOM {
                (lines, left) = (lines + 1, ROOM);
            }
            let at = (lines, left);
            left += wide + 2.0 * ROOM;
            at
        };
        let words = self.words().map(|words| (place(width_of(&words)), words));
        let (scale_line, scale_left) = place(2.0 * REACH);
        let top = height - ROOM - f64::from(scale_line + 1) * LINE_PX;
        let middle = |line: i32| top + ROOM / 2.0 + (f64::from(line) + 0.5) * LINE_PX;
        let from = 3 * frame.width() * top.max(0.0) as usize;
        for value in &mut frame.rgb_mut()[from..] {
            *value = (u16::from(*value) * THROUGH / 256) as u8;
        }
        for ((line, left), words) in &words {
            write_on(frame, (*left, middle(*line)), words, WORDS);
        }
        let (zero, y) = (scale_left + REACH, middle(scale_line));
        let mark = zero + REACH * (self.steering_deg / FULL_STEERING_DEG).clamp(-1.0, 1.0);
        bar(frame, (zero - REACH, zero + REACH), (y - 1.0, y + 1.0), WORDS);
        bar(frame, (zero - 1.0, zero + 1.0), (y - 4.0, y + 4.0), WORDS);
        bar(frame, (mark - 3.0, mark + 3.0), (y - 6.0, y + 6.0), MARK);
    }
}

/// Rounded to so many parts of one; nothing is +0, not -0.
fn unsigned_zero(value: f64, parts: f64) -> f64 {
    (value * parts).round() / parts + 0.0
}

/// A filled rectangle; what lies beyond the picture is left out.
fn bar(frame: &mut Frame, (left, right): (f64, f64), (top, bottom): (f64, f64), colour: Colour) {
    let (width, height) = (frame.width(), frame.height());
    let within = |at: f64, side: usize| at.clamp(0.0, side as f64) as usize;
    for y in within(top, height)..within(bottom, height) {
        for x in within(left, width)..within(right, width) {
            frame.rgb_mut()[3 * (y * width + x)..][..3].copy_from_slice(&colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOMENT: Moment<'_> =
        Moment { mph: 19.94, lap: 1, laps: Some(2), cte_m: -0.061, by: "network", steering_deg: -3.24 };

    fn drawn(width: usize, height: usize, moment: &Moment<'_>) -> Frame {
        let mut frame = Frame::new(width, height, vec![200; width * height * 3]).unwrap();
        moment.draw(&mut frame);
        frame
    }

    fn first_changed_row(frame: &Frame) -> usize {
        frame.rgb().iter().position(|value| *value != 200).unwrap() / (3 * frame.width())
    }

    #[test]
    fn a_film_tells_speed_lap_offset_and_who_steers() {
        assert_eq!(MOMENT.words(), ["19.9 mph", "lap 1 of 2", "cte -0.06 m", "network steers  -3.2 deg"]);
        let over = Moment { lap: 3, cte_m: -0.001, ..MOMENT };
        assert_eq!(over.words()[1..3], ["lap 2 of 2", "cte +0.00 m"]);
    }

    #[test]
    fn a_narrow_film_has_more_lines_and_none_is_too_small() {
        assert_eq!(first_changed_row(&drawn(640, 360, &MOMENT)), 360 - 24);
        assert!(first_changed_row(&drawn(320, 160, &MOMENT)) < 160 - 24);
        for (width, height) in [(1, 1), (16, 16), (30, 200)] {
            drawn(width, height, &MOMENT);
        }
    }

    #[test]
    fn the_mark_stands_where_the_wheels_point() {
        let column = |steering_deg: f64| {
            let frame = drawn(640, 360, &Moment { steering_deg, ..MOMENT });
            frame.rgb().chunks_exact(3).position(|pixel| pixel == MARK).unwrap() % 640
        };
        assert!(column(-10.0) < column(0.0) && column(0.0) < column(10.0));
        assert_eq!(column(99.0), column(FULL_STEERING_DEG), "the scale ends there");
    }
}

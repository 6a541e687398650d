//! A film as an animated GIF: a palette of its own for each frame, chosen by NeuQuant.

use std::{
    fs::File,
    io::{BufWriter, Write},
};

use gif::{Encoder, Repeat};

use super::{FilmError, Reel};
use lapwing_core::perception::Frame;

/// NeuQuant samples every tenth pixel, as its author recommends for photographs.
const SAMPLING: i32 = 10;

/// The shortest time that viewers show a frame, in hundredths of a second; they treat less as 10.
const SHORTEST: u64 = 2;

#[derive(Default)]
pub(super) struct Gif {
    /// `None` before the first frame.
    encoder: Option<Encoder<BufWriter<File>>>,
    /// The waiting frame and its beginning in hundredths; the next frame decides how long it is shown.
    waiting: Option<(u64, gif::Frame<'static>)>,
}

/// When the frame after this many begins, in hundredths of a second.
fn hundredths(frames: u64, fps: f64) -> u64 {
    (frames as f64 * 100.0 / fps).round() as u64
}

impl Gif {
    pub(super) fn frame(&mut self, reel: &Reel, frame: &Frame) -> Result<(), FilmError> {
        if self.encoder.is_none() {
            let file = File::create(&reel.path).map_err(FilmError::io("create the film", &reel.path))?;
            let (width, height) = (reel.width as u16, reel.height as u16);
            let mut encoder =
                Encoder::new(BufWriter::new(file), width, height, &[]).map_err(FilmError::encode(&reel.path, 0))?;
            encoder.set_repeat(Repeat::Infinite).map_err(FilmError::encode(&reel.path, 0))?;
            self.encoder = Some(encoder);
        }
        let begins = hundredths(reel.frames - 1, reel.fps);
        if self.waiting.as_ref().is_some_and(|(began, _)| begins - began < SHORTEST) {
            return Ok(()); // faster than viewers can show
        }
        self.write(reel, begins)?;
        let picture = gif::Frame::from_rgb_speed(frame.width() as u16, frame.height() as u16, frame.rgb(), SAMPLING);
        self.waiting = Some((begins, picture));
        Ok(())
    }

    /// Writes the waiting frame, to be shown until `until`.
    fn write(&mut self, reel: &Reel, until: u64) -> Result<(), FilmError> {
        let Some(encoder) = &mut self.encoder else { return Ok(()) };
        let Some((began, mut frame)) = self.waiting.take() else { return Ok(()) };
        frame.delay = (until - began).max(SHORTEST) as u16;
        encoder.write_frame(&frame).map_err(FilmError::encode(&reel.path, reel.frames))?;
        encoder.get_mut().flush().map_err(FilmError::io("write the film", &reel.path))
    }

    pub(super) fn finish(mut self, reel: &Reel) -> Result<(), FilmError> {
        self.write(reel, hundredths(reel.frames, reel.fps))?;
        let Some(encoder) = self.encoder else { return Ok(()) };
        let mut file = encoder.into_inner().map_err(FilmError::encode(&reel.path, reel.frames))?;
        file.flush().map_err(FilmError::io("finish the film", &reel.path))
    }
}

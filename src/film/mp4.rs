//! A film as H.264 in MP4.
//!
//! While it is made, the file grows by a fragment every two seconds (`moof` and `mdat`, each beginning with a key frame),
//! so that it can be played so far. At its end it is replaced by a plain MP4 with one index in front, in which every
//! player can seek; until then the encoded frames also stay in memory.

use std::{
    fs::File,
    io::{BufWriter, Write},
};

use muxide::{
    api::{MuxerBuilder, VideoCodec},
    fragmented::{FragmentConfig, FragmentedMuxer},
};
use openh264::{
    OpenH264API,
    encoder::{
        BitRate, Complexity, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, Profile, QpRange,
        RateControlMode, VuiConfig,
    },
    formats::{RgbSliceU8, YUVBuffer},
};

use openh264_sys2::{ENCODER_OPTION_TRACE_LEVEL, WELS_LOG_QUIET};

use super::{FilmError, Reel};
use lapwing_core::{files, perception::Frame};

/// Ticks of the fragments' clock per frame.
const TICKS: u64 = 1000;

/// The largest that OpenH264 encodes, either way up.
const LARGEST: (usize, usize) = (3840, 2160);

/// Bits a second of each pixel: a lap of the lake at 9 mph (285 s, 640x360) then takes less than 25 MB.
const BITS_PER_PIXEL: f64 = 2.5;

/// The fewest bits a second, for small films.
const LEAST_BPS: f64 = 150_000.0;

/// Seconds from one key frame to the next.
const KEY_S: f64 = 2.0;

/// NAL unit types of H.264's table 7-1.
const SEQUENCE_PARAMETERS: u8 = 7;
const PICTURE_PARAMETERS: u8 = 8;

pub(super) struct Mp4 {
    encoder: Encoder,
    picture: YUVBuffer,
    /// `None` before the first frame, which brings the parameter sets.
    fragments: Option<(File, FragmentedMuxer)>,
    /// All frames, encoded, with start codes; and whether one is a key frame.
    encoded: Vec<(Vec<u8>, bool)>,
}

impl Mp4 {
    pub(super) fn new(reel: &Reel) -> Result<Self, FilmError> {
        let &Reel { width, height, fps, .. } = reel;
        let sides = (width.max(height), width.min(height));
        if width % 2 != 0 || height % 2 != 0 || width < 16 || height < 16 || sides.0 > LARGEST.0 || sides.1 > LARGEST.1
        {
            let expected = "an even width and height from 16x16 to 3840x2160";
            return Err(FilmError::Size { path: reel.path.clone(), expected, width, height });
        }
        let config = EncoderConfig::new()
            // By size, not by frames: at 60 frames a second neighbours differ less.
            .rate_control_mode(RateControlMode::Bitrate)
            .bitrate(BitRate::from_bps(((width * height) as f64 * BITS_PER_PIXEL).max(LEAST_BPS) as u32))
            .qp(QpRange::new(18, 46))
            .complexity(Complexity::High)
            .skip_frames(false)
            .profile(Profile::Main)
            .max_frame_rate(FrameRate::from_hz(fps as f32))
            .intra_frame_period(IntraFramePeriod::from_num_frames((KEY_S * fps).round().max(1.0) as u32))
            .vui(VuiConfig::bt601()) // matches the conversion below
            .num_threads(1);
        let mut encoder =
            Encoder::with_api_config(OpenH264API::from_source(), config).map_err(FilmError::encode(&reel.path, 0))?;
        quiet(&mut encoder);
        Ok(Self { encoder, picture: YUVBuffer::new(width, height), fragments: None, encoded: Vec::new() })
    }

    pub(super) fn frame(&mut self, reel: &Reel, frame: &Frame) -> Result<(), FilmError> {
        let fail = |why: String| FilmError::encode(&reel.path, reel.frames)(why);
        self.picture.read_rgb8(RgbSliceU8::new(frame.rgb(), (reel.width, reel.height)));
        let stream = self.encoder.encode(&self.picture).map_err(|e| fail(e.to_string()))?;
        let is_key = stream.frame_type() == FrameType::IDR;
        let encoded = stream.to_vec();
        let units = units(&encoded);
        if encoded.is_empty() || units.is_empty() {
            return Err(fail("the encoder left it out".into()));
        }
        let of_type = |wanted: u8| units.iter().find(|unit| unit[0] & 0x1f == wanted);
        let (file, fragments) = match &mut self.fragments {
            Some(begun) => begun,
            empty @ None => {
                let (Some(sps), Some(pps)) = (of_type(SEQUENCE_PARAMETERS), of_type(PICTURE_PARAMETERS)) else {
                    return Err(fail("the encoder gave no parameter sets".into()));
                };
                let timescale = (reel.fps * TICKS as f64).round() as u32;
                let mut config = FragmentConfig::new(reel.width as u32, reel.height as u32, timescale);
                (config.sps, config.pps) = (sps.to_vec(), pps.to_vec());
                let mut muxer = FragmentedMuxer::new(config).map_err(|e| fail(e.to_string()))?;
                let mut file = File::create(&reel.path).map_err(FilmError::io("create the film", &reel.path))?;
                file.write_all(&muxer.init_segment()).map_err(FilmError::io("write the film", &reel.path))?;
                empty.insert((file, muxer))
            }
        };
        if is_key && let Some(segment) = fragments.flush_segment() {
            file.write_all(&segment).map_err(FilmError::io("write the film", &reel.path))?;
        }
        let mut sample = Vec::with_capacity(encoded.len());
        for unit in units.iter().filter(|u| ![SEQUENCE_PARAMETERS, PICTURE_PARAMETERS].contains(&(u[0] & 0x1f))) {
            sample.extend_from_slice(&(unit.len() as u32).to_be_bytes());
            sample.extend_from_slice(unit);
        }
        let time = (reel.frames - 1) * TICKS;
        fragments.write_video(time, time, &sample, is_key).map_err(|e| fail(e.to_string()))?;
        self.encoded.push((encoded, is_key));
        Ok(())
    }

    pub(super) fn finish(self, reel: &Reel) -> Result<(), FilmError> {
        let io = |e| FilmError::io("finish the film", &reel.path)(e);
        let part = files::partial(&reel.path).map_err(io)?;
        let file = BufWriter::new(part.reopen().map_err(io)?);
        let fail = FilmError::encode(&reel.path, reel.frames);
        let mux = || -> Result<(), muxide::api::MuxerError> {
            let mut muxer = MuxerBuilder::new(file)
                .video(VideoCodec::H264, reel.width as u32, reel.height as u32, reel.fps)
                .with_fast_start(true)
                .build()?;
            for (i, (encoded, is_key)) in self.encoded.into_iter().enumerate() {
                muxer.write_video(i as f64 / reel.fps, &encoded, is_key)?;
            }
            muxer.finish_in_place()?;
            muxer.into_writer().flush()?;
            Ok(())
        };
        // Where either fails, the film so far remains, in fragments.
        mux().map_err(fail)?;
        part.persist(&reel.path).map_err(|e| io(e.error))?;
        Ok(())
    }
}

/// Lets an encoder print nothing: it would complain that it may not leave frames out, which is wanted.
fn quiet(encoder: &mut Encoder) {
    let mut level = WELS_LOG_QUIET;
    // SAFETY: the encoder is alive, takes this option before its first frame, and reads one u32 that outlives the call.
    let refused = unsafe { encoder.raw_api().set_option(ENCODER_OPTION_TRACE_LEVEL, (&raw mut level).cast()) };
    debug_assert_eq!(refused, 0, "the option exists in every version");
}

/// The NAL units between the start codes of an Annex B stream.
fn units(stream: &[u8]) -> Vec<&[u8]> {
    let code = |from: usize| {
        let at = stream.get(from..)?.windows(3).position(|w| w == [0, 0, 1])?;
        Some(from + at)
    };
    let mut units = Vec::new();
    let mut next = code(0);
    while let Some(at) = next {
        let from = at + 3;
        next = code(from);
        let mut unit = &stream[from..next.unwrap_or(stream.len())];
        // The code of four bytes, and padding: no unit ends in a zero.
        while let Some((0, shorter)) = unit.split_last() {
            unit = shorter;
        }
        if !unit.is_empty() {
            units.push(unit);
        }
    }
    units
}

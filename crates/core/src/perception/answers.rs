//! What OpenCV and Pillow themselves answer: `answers.json`, which `tests/interop/perception_answers.py` writes.

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{
    Blur, ColourSpace, Crop, Frame, PixelScale, Preprocess, Preprocessor, Resize, ResizeFilter, TensorLayout,
    resample::{Pixels, resample},
};

#[derive(Deserialize)]
struct Answers {
    resized: Vec<Resized>,
    blurred: Vec<Blurred>,
    coloured: Vec<Coloured>,
}

#[derive(Deserialize)]
struct Answer {
    sha256: String,
    /// In hexadecimal, of small ones.
    bytes: Option<String>,
}

#[derive(Deserialize)]
struct Resized {
    from: [usize; 2],
    to: [usize; 2],
    filter: ResizeFilter,
    #[serde(flatten)]
    answer: Answer,
}

#[derive(Deserialize)]
struct Blurred {
    from: [usize; 2],
    blur: Blur,
    #[serde(flatten)]
    answer: Answer,
}

#[derive(Deserialize)]
struct Coloured {
    colour: ColourSpace,
    #[serde(flatten)]
    answer: Answer,
}

impl Answer {
    /// Whether these are the bytes; shows both of a small picture that differs.
    fn is(&self, got: &[u8], what: &str) -> bool {
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let same = hex(&Sha256::digest(got)) == self.sha256;
        if !same {
            let got = if self.bytes.is_some() { hex(got) } else { String::new() };
            println!("differs: {what}\n  expected {}\n  got      {got}", self.bytes.as_deref().unwrap_or(""));
        }
        same
    }
}

fn answers() -> Answers {
    serde_json::from_str(include_str!("answers.json")).unwrap()
}

/// The picture that the script draws, too.
fn drawn([width, height]: [usize; 2]) -> Vec<u8> {
    let mut state = 1u32;
    let byte = |i: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let slope = (i / 3 % width * 255 / width) as u32;
        if i / 3 / width % 2 == 1 { (state >> 24) as u8 } else { slope.wrapping_add(state >> 30) as u8 }
    };
    (0..width * height * 3).map(byte).collect()
}

#[test]
fn every_filter_gives_the_bytes_of_its_library() {
    let mut wrong = vec![];
    for Resized { from, to, filter, answer } in answers().resized {
        let mut out = vec![0; to[0] * to[1] * 3];
        let bytes = drawn(from);
        resample(Pixels { bytes: &bytes, width: from[0], height: from[1], channels: 3 }, filter, to, &mut out);
        let what = format!("{filter:?} {from:?} to {to:?}");
        if !answer.is(&out, &what) {
            wrong.push(what);
        }
    }
    assert_eq!(wrong, [""; 0]);
}

#[test]
fn every_blur_gives_the_bytes_of_opencv() {
    for Blurred { from, blur, answer } in answers().blurred {
        let (bytes, mut out) = (drawn(from), vec![]);
        blur.apply(Pixels { bytes: &bytes, width: from[0], height: from[1], channels: 3 }, &mut out);
        assert!(answer.is(&out, &format!("{blur:?} of {from:?}")));
    }
}

#[test]
fn every_colour_gives_the_bytes_of_its_library() {
    let levels = (0..=255u8).step_by(5);
    let two = |r: u8| levels.clone().flat_map(move |g| (0..=255u8).step_by(5).map(move |b| [r, g, b]));
    // The order of numpy's meshgrid with indexing="ij".
    let rgb: Vec<[u8; 3]> = levels.clone().flat_map(two).collect();
    for Coloured { colour, answer } in answers().coloured {
        let convert = colour.bytes().unwrap();
        let bytes: Vec<u8> = rgb.iter().flat_map(|rgb| convert(*rgb).into_iter().take(colour.channels())).collect();
        assert!(answer.is(&bytes, &format!("{colour:?}")));
    }
}

#[test]
fn all_steps_are_taken_in_their_order() {
    let frame = Frame::new(8, 6, drawn([8, 6])).unwrap();
    let crop = Some(Crop { top: 1, bottom: 5, left: Some(2), right: Some(7) });
    let resize = Resize { width: 5, height: 4, filter: ResizeFilter::Cv2Nearest };
    let preprocess = Preprocess {
        crop_resized: Some(Crop { top: 1, bottom: 3, left: Some(1), right: None }),
        layout: TensorLayout::Nhwc,
        ..Preprocess::of(crop, resize, ColourSpace::Bgr, PixelScale::None)
    };
    assert_eq!((preprocess.shape(), preprocess.tensor_shape()), ([3, 2, 4], [1, 2, 4, 3]));
    let mut out = vec![];
    let mut apply = |preprocess: &Preprocess| {
        Preprocessor::new(preprocess.clone()).unwrap().apply(&frame, &mut out).unwrap();
        out.clone()
    };
    // Rows 2 and 3 of the frame, columns 3 to 6, blue first.
    let pixels = (2..4).flat_map(|y| (3..7).map(move |x| (x, y)));
    let expected: Vec<f32> =
        pixels.flat_map(|(x, y)| frame.pixel(x, y).unwrap().into_iter().rev()).map(f32::from).collect();
    assert_eq!(apply(&preprocess), expected);
    // The same numbers, channel by channel.
    let planes = apply(&Preprocess { layout: TensorLayout::Nchw, ..preprocess.clone() });
    assert!((0..3).all(|c| (0..8).all(|i| planes[c * 8 + i] == expected[i * 3 + c])));
    // A colour computed before a nearest pixel is chosen is the same; (x - 128) / 128 is what it says.
    let first = Preprocess { colour_first: true, colour: ColourSpace::Cv2Yuv, ..preprocess.clone() };
    let after = Preprocess { colour_first: false, ..first.clone() };
    assert_eq!(apply(&first), apply(&after));
    let shifted = Preprocess { scale: PixelScale::Shifted { mean: 128.0, range: 128.0 }, ..preprocess };
    let close = |(x, y): (f32, &f32)| (x - (y - 128.0) / 128.0).abs() < 1e-6;
    assert!(apply(&shifted).into_iter().zip(&expected).all(close));
}

#[test]
fn one_channel_before_the_resize_is_the_saturation_of_the_63_parameter_network() {
    let frame = Frame::new(320, 160, drawn([320, 160])).unwrap();
    let resize = Resize { width: 32, height: 16, filter: ResizeFilter::Cv2Linear };
    let preprocess =
        Preprocess { colour_first: true, ..Preprocess::of(None, resize, ColourSpace::Cv2Saturation, PixelScale::None) };
    let mut out = vec![];
    Preprocessor::new(preprocess).unwrap().apply(&frame, &mut out).unwrap();
    assert_eq!(out.len(), 32 * 16);
    assert!(out.iter().all(|x| (0.0..=255.0).contains(x) && x.fract() == 0.0));
}

use std::fs;

use openh264::{decoder::Decoder, formats::YUVSource};

use super::*;

const WIDTH: usize = 320;
const HEIGHT: usize = 160;

/// A coloured gradient under which a bright box moves to the right, a step a frame.
fn frame(i: usize) -> Frame {
    let mut rgb = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let inside = (60..100).contains(&y) && (4 * i..4 * i + 40).contains(&x);
            let ground = [(x * 200 / WIDTH) as u8, (y * 200 / HEIGHT) as u8 + 30, 120];
            rgb.extend(if inside { [250, 220, 40] } else { ground });
        }
    }
    Frame::new(WIDTH, HEIGHT, rgb).unwrap()
}

fn film(path: &Path, frames: usize, fps: f64) -> Film {
    let mut film = Film::create(path, WIDTH, HEIGHT, fps).unwrap();
    for i in 0..frames {
        film.frame(&frame(i)).unwrap();
    }
    film
}

/// Peak signal to noise ratio, in dB: 30 is fair, 40 is good.
fn psnr(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum();
    10.0 * (255.0 * 255.0 * a.len() as f64 / squares).log10()
}

/// The boxes of an MP4 or of a box's payload: type and payload.
fn boxes(mut bytes: &[u8]) -> Vec<(String, &[u8])> {
    let mut boxes = vec![];
    while let Some((size, rest)) = bytes.split_first_chunk() {
        let size = u32::from_be_bytes(*size) as usize;
        boxes.push((String::from_utf8_lossy(&rest[..4]).into_owned(), &bytes[8..size]));
        bytes = &bytes[size..];
    }
    boxes
}

fn names(bytes: &[u8]) -> Vec<String> {
    boxes(bytes).into_iter().map(|(name, _)| name).collect()
}

fn inside<'a>(bytes: &'a [u8], path: &[&str]) -> &'a [u8] {
    path.iter().fold(bytes, |bytes, wanted| boxes(bytes).into_iter().find(|(name, _)| name == wanted).unwrap().1)
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// Decodes the pictures of an MP4, whole or in fragments, as RGB.
fn decode(mp4: &[u8]) -> Vec<Vec<u8>> {
    let stsd = &inside(mp4, &["moov", "trak", "mdia", "minf", "stbl", "stsd"])[8..];
    let avcc = inside(&inside(stsd, &["avc1"])[78..], &["avcC"]);
    // Version, profile and level, then one sequence and one picture parameter set, each behind its length.
    let sps = &avcc[8..8 + usize::from(u16::from_be_bytes([avcc[6], avcc[7]]))];
    let pps = &avcc[8 + sps.len() + 3..];
    assert_eq!((sps[0] & 0x1f, pps[0] & 0x1f, &sps[1..4]), (7, 8, &avcc[1..4]));
    let mut decoder = Decoder::new().unwrap();
    let mut pictures = vec![];
    let mut take = |picture: Option<openh264::decoder::DecodedYUV<'_>>| {
        if let Some(picture) = picture {
            assert_eq!(picture.dimensions(), (WIDTH, HEIGHT));
            let mut rgb = vec![0; WIDTH * HEIGHT * 3];
            picture.write_rgb8(&mut rgb);
            pictures.push(rgb);
        }
    };
    let start = [0, 0, 0, 1];
    take(decoder.decode(&[&start, sps, &start, pps].concat()).unwrap());
    for (_, mut mdat) in boxes(mp4).into_iter().filter(|(name, _)| name == "mdat") {
        while !mdat.is_empty() {
            let (unit, rest) = mdat[4..].split_at(u32_at(mdat, 0) as usize);
            take(decoder.decode(&[&start, unit].concat()).unwrap());
            mdat = rest;
        }
    }
    for picture in decoder.flush_remaining().unwrap() {
        take(Some(picture));
    }
    pictures
}

#[test]
fn an_mp4_shows_the_frames_again_at_their_time() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.MP4");
    film(&path, 40, 15.0).finish().unwrap();
    let mp4 = fs::read(&path).unwrap();
    assert_eq!(names(&mp4), ["ftyp", "moov", "mdat"]); // the index in front
    let mdhd = inside(&mp4, &["moov", "trak", "mdia", "mdhd"]);
    let seconds = f64::from(u32_at(mdhd, 16)) / f64::from(u32_at(mdhd, 12));
    assert!((seconds - 40.0 / 15.0).abs() < 1e-3, "{seconds} s");
    let stss = inside(&mp4, &["moov", "trak", "mdia", "minf", "stbl", "stss"]);
    let keys: Vec<u32> = stss[8..].chunks(4).map(|b| u32_at(b, 0)).collect();
    assert_eq!(keys, [1, 31]);
    let pictures = decode(&mp4);
    assert_eq!(pictures.len(), 40);
    for (i, picture) in pictures.iter().enumerate() {
        let (same, next) = (psnr(picture, frame(i).rgb()), psnr(picture, frame(i + 2).rgb()));
        assert!(same > 33.0 && next < same - 3.0, "frame {i}: {same:.1} dB, {next:.1} dB to another");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "nothing is left beside it");
}

#[test]
fn an_interrupted_mp4_plays_up_to_the_last_whole_two_seconds() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.mp4");
    drop(film(&path, 70, 15.0));
    let mp4 = fs::read(&path).unwrap();
    assert_eq!(names(&mp4), ["ftyp", "moov", "moof", "mdat", "moof", "mdat"]);
    assert_eq!(names(inside(&mp4, &["moov"])), ["mvhd", "trak", "mvex"]);
    let pictures = decode(&mp4);
    assert_eq!(pictures.len(), 60);
    assert!(psnr(&pictures[59], frame(59).rgb()) > 33.0);
}

#[test]
fn a_gif_shows_the_frames_again_for_as_long_as_they_took() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.gif");
    film(&path, 15, 15.0).finish().unwrap();
    let pictures = gif_frames(&path);
    assert_eq!(pictures.iter().map(|(delay, _)| u32::from(*delay)).sum::<u32>(), 100);
    assert!(pictures.iter().all(|(delay, _)| (6..=7).contains(delay)));
    for (i, (_, rgb)) in pictures.iter().enumerate() {
        let quality = psnr(rgb, frame(i).rgb());
        assert!(quality > 33.0, "frame {i}: {quality:.1} dB");
    }
}

/// Delays in hundredths of a second and pixels, up to where the file ends.
fn gif_frames(path: &Path) -> Vec<(u16, Vec<u8>)> {
    let mut options = ::gif::DecodeOptions::new();
    options.set_color_output(::gif::ColorOutput::RGBA);
    let mut decoder = options.read_info(fs::File::open(path).unwrap()).unwrap();
    let mut frames = vec![];
    while let Ok(Some(frame)) = decoder.read_next_frame() {
        let rgb = frame.buffer.chunks(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        frames.push((frame.delay, rgb));
    }
    frames
}

#[test]
fn an_interrupted_gif_plays_up_to_the_frame_before_the_last() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.gif");
    let film = film(&path, 5, 15.0);
    assert_eq!(gif_frames(&path).len(), 4); // while it is still being made
    drop(film);
    assert!(gif_frames(&path).len() >= 4);
}

#[test]
fn a_gif_of_more_frames_than_viewers_show_leaves_some_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("out.gif");
    film(&path, 30, 120.0).finish().unwrap();
    let frames = gif_frames(&path);
    assert!((9..=13).contains(&frames.len()), "{}", frames.len());
    assert!(frames.iter().all(|(delay, _)| *delay >= 2));
    // A quarter of a second, and a hundredth for the last one.
    assert!((25..=26).contains(&frames.iter().map(|(delay, _)| delay).sum::<u16>()));
}

#[test]
fn a_folder_holds_numbered_pictures() {
    let dir = tempfile::tempdir().unwrap();
    for (name, file) in [
        ("frames/", "frames/frame_00003.jpg"),
        ("deep/er", "deep/er/frame_00003.jpg"),
        ("v1.5/", "v1.5/frame_00003.jpg"),
        ("lap.png", "lap_00003.png"),
        ("lap.JPG", "lap_00003.JPG"),
    ] {
        let made = film(&dir.path().join(name), 3, 15.0);
        let last = format!(" to {}", dir.path().join(file).display());
        assert!(made.place().contains("_00001.") && made.place().ends_with(&last), "{}", made.place());
        made.finish().unwrap();
        let picture = image::load_from_memory(&fs::read(dir.path().join(file)).unwrap()).unwrap().to_rgb8();
        let quality = psnr(picture.as_raw(), frame(2).rgb());
        assert!(quality > 33.0, "{name}: {quality}");
        assert_eq!(quality.is_infinite(), name.ends_with("png"), "PNG loses nothing");
        let error = Film::create(dir.path().join(name), WIDTH, HEIGHT, 15.0).err().unwrap();
        assert!(error.to_string().starts_with("cannot create the picture"), "{error}");
    }
}

#[test]
fn the_same_frames_make_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    for extension in ["mp4", "gif"] {
        let bytes = ["a", "b"].map(|name| {
            let path = dir.path().join(name).with_extension(extension);
            film(&path, 20, 15.0).finish().unwrap();
            fs::read(path).unwrap()
        });
        assert!(bytes[0] == bytes[1], "{extension}");
    }
}

#[test]
fn what_cannot_be_a_film_is_refused_with_what_can() {
    let dir = tempfile::tempdir().unwrap();
    let error = |name: &str, width: usize, height: usize, fps: f64| {
        let error = Film::create(dir.path().join(name), width, height, fps).err().unwrap().to_string();
        error.replace(&format!("{}/", dir.path().display()), "")
    };
    assert_eq!(
        error("a.avi", 320, 160, 15.0),
        "a.avi: expected a film that ends in .mp4, .gif, .png or .jpg, or a folder's name, got .avi"
    );
    assert_eq!(
        error("a.mp4", 321, 160, 15.0),
        "a.mp4: expected an even width and height from 16x16 to 3840x2160, got 321x160"
    );
    assert_eq!(error("a.gif", 0, 160, 15.0), "a.gif: expected 1 to 4096 pixels each way, got 0x160");
    assert_eq!(error("a.gif", 320, 160, f64::NAN), "a.gif: expected 0.1 to 240 frames a second, got NaN");
    assert!(error("no/such/folder/a.mp4", 320, 160, 15.0).starts_with("cannot create the film no/such/folder/a.mp4: "));

    let mut film = Film::create(dir.path().join("a.mp4"), 320, 162, 15.0).unwrap();
    let error = film.frame(&frame(0)).unwrap_err().to_string();
    assert!(error.ends_with("a.mp4: expected frames of 320x162, got 320x160"), "{error}");
    assert!(film.finish().unwrap_err().to_string().ends_with("a.mp4: expected frames, got none"));
}

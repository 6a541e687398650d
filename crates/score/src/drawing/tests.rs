use std::fs;

use super::*;

fn sheet(shapes: Vec<Shape>) -> Sheet {
    Sheet { width: 40.0, height: 30.0, title: "a <title>".into(), shapes }
}

fn pixels(sheet: &Sheet) -> image::RgbImage {
    image::load_from_memory(&sheet.png().unwrap()).unwrap().to_rgb8()
}

/// 4 x 2, each pixel another colour.
fn frame() -> Frame {
    Frame::new(4, 2, (0..24).map(|i| i * 10).collect()).unwrap()
}

#[test]
fn a_picture_is_painted_in_its_own_pixels() {
    let picture = pixels(&sheet(vec![Shape::Picture { at: (10.0, 5.0), frame: frame() }]));
    assert_eq!(picture.get_pixel(10, 5).0, [0, 10, 20]);
    assert_eq!(picture.get_pixel(13, 6).0, [210, 220, 230]);
    assert_eq!(picture.get_pixel(14, 6).0, PAPER);
}

#[test]
fn what_of_a_picture_lies_beyond_the_sheet_is_left_out() {
    for at in [(-2.0, -1.0), (38.0, 29.0), (500.0, -500.0)] {
        pixels(&sheet(vec![Shape::Picture { at, frame: frame() }]));
    }
    let picture = pixels(&sheet(vec![Shape::Picture { at: (-2.0, -1.0), frame: frame() }]));
    assert_eq!(picture.get_pixel(1, 0).0, [210, 220, 230]);
    assert_eq!(picture.get_pixel(0, 1).0, PAPER);
}

#[test]
fn an_svg_carries_its_pictures_in_itself() {
    let svg = sheet(vec![Shape::Picture { at: (1.0, 2.0), frame: frame() }]).svg().unwrap();
    let from = svg.find("base64,").unwrap() + "base64,".len();
    let encoded = &svg[from..from + svg[from..].find('"').unwrap()];
    let png = base64::Engine::decode(&base64::prelude::BASE64_STANDARD, encoded).unwrap();
    assert_eq!(image::load_from_memory(&png).unwrap().to_rgb8().as_raw(), frame().rgb());
    assert!(svg.contains("<title>a &lt;title&gt;</title>"));
}

#[test]
fn a_file_is_painted_by_its_ending() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| sheet(vec![]).write(dir.path().join(name));
    write("a.SVG").unwrap();
    write("a.png").unwrap();
    assert!(fs::read_to_string(dir.path().join("a.SVG")).unwrap().starts_with("<svg "));
    assert!(fs::read(dir.path().join("a.png")).unwrap().starts_with(b"\x89PNG"));
    let error = write("a.pdf").unwrap_err().to_string();
    assert!(error.ends_with("a.pdf: expected the name of a picture that ends in .svg or .png"), "{error}");
}

#[test]
fn a_png_beyond_what_memory_is_for_is_refused() {
    let error = Sheet { height: 20_000.0, ..sheet(vec![]) }.png().unwrap_err();
    assert_eq!(error.to_string(), "expected 1 to 16384 pixels a side, got 40x20000");
}

use super::*;

const PILOTNET: &str = r#"{"crop":{"top":60,"bottom":135},"resize":{"height":66,"width":200,"filter":"bilinear-antialiased"},"colour":"yuv","scale":"x/127.5-1","layout":"nchw"}"#;

fn read(json: &str) -> Preprocess {
    serde_json::from_str(json).unwrap()
}

#[test]
fn what_is_read_is_what_is_written() {
    assert_eq!(serde_json::to_string(&read(PILOTNET)).unwrap(), PILOTNET);
    let imagenet = PILOTNET
        .replace(r#""crop":{"top":60,"bottom":135},"#, "")
        .replace("yuv", "rgb")
        .replace(r#""x/127.5-1""#, r#"{"standardised":{"mean":[0.485,0.456,0.406],"std":[0.229,0.224,0.225]}}"#);
    assert_eq!(serde_json::to_string(&read(&imagenet)).unwrap(), imagenet);
    assert_eq!(read(&imagenet).validate(), Ok(()));
}

#[test]
fn a_key_or_value_that_is_not_known_is_refused_by_name() {
    let error = |from, to| serde_json::from_str::<Preprocess>(&PILOTNET.replace(from, to)).unwrap_err().to_string();
    assert!(error(r#""layout""#, r#""sharpen":1,"layout""#).starts_with("unknown field `sharpen`, expected one of"));
    assert!(error(r#""top":60"#, r#""top":60,"up":1"#).starts_with("unknown field `up`"));
    assert!(error("yuv", "hsv").starts_with("unknown variant `hsv`, expected one of `rgb`, `bgr`, `yuv`, `grey`"));
    assert!(error("bilinear-antialiased", "nearest").starts_with("unknown variant `nearest`"));
    assert!(
        error(r#""x/127.5-1""#, r#"{"standardised":{"mean":[],"std":[],"var":[]}}"#).starts_with("unknown field `var`")
    );
    assert!(error(r#""layout""#, r#""blur":"gaussian-4x4","layout""#).starts_with("unknown variant `gaussian-4x4`"));
    assert!(error(r#","layout":"nchw""#, "").starts_with("missing field `layout`"));
}

#[test]
fn what_cannot_be_is_named_with_expected_and_got() {
    let error = |from, to| read(&PILOTNET.replace(from, to)).validate().unwrap_err().to_string();
    assert_eq!(error("135", "60"), "expected a crop whose top lies above its bottom, got rows 60 to 60");
    assert_eq!(error("135", "1000"), "expected a crop within a picture's rows, 0 to 480, got rows 60 to 1000");
    assert_eq!(read(&PILOTNET.replace("135", "480")).validate(), Ok(()));
    assert_eq!(
        error("135", r#"135,"left":320,"right":320"#),
        "expected a crop of columns within 0 to 640, left before right, got 320 to 320"
    );
    assert_eq!(
        error(r#""yuv""#, r#""yuv","crop_resized":{"top":0,"bottom":67}"#),
        "expected a crop_resized within 200x66, got Crop { top: 0, bottom: 67, left: None, right: None }"
    );
    assert_eq!(
        error(r#""yuv""#, r#""yuv","colour_first":true"#),
        "expected a colour of whole bytes for colour_first (cv2-yuv, cv2-grey, …), got Yuv"
    );
    assert_eq!(
        error(r#""x/127.5-1""#, r#"{"shifted":{"mean":128,"range":0}}"#),
        "expected a finite mean and a positive finite range, got 128 and 0"
    );
    assert_eq!(error("200", "0"), "expected a resize to 1 to 4096 pixels a side, got 0x66");
    assert_eq!(error("200", "4097"), "expected a resize to 1 to 4096 pixels a side, got 4097x66");
    assert_eq!(
        error(r#""x/127.5-1""#, r#"{"standardised":{"mean":[0.5],"std":[0.5,0.5,0.5]}}"#),
        "expected a mean and a std for each of 3 channels, got 1 and 3"
    );
    assert_eq!(
        error(r#""x/127.5-1""#, r#"{"standardised":{"mean":[0.5,0.5,0.5],"std":[0.5,0,0.5]}}"#),
        "expected finite means and positive finite stds, got 0.5 and 0 for channel 1"
    );
}

#[test]
fn only_weighted_sums_of_pixels_are_plain() {
    let plain = read(PILOTNET);
    assert!(plain.is_plain());
    for (from, to) in [
        ("bilinear-antialiased", "cv2-area"),
        (r#""yuv""#, r#""cv2-yuv""#),
        (r#""layout""#, r#""blur":"gaussian-3x3","layout""#),
        ("nchw", "nhwc"),
        (r#""top":60"#, r#""top":60,"left":1"#),
    ] {
        assert!(!read(&PILOTNET.replace(from, to)).is_plain(), "{to}");
    }
}

#[test]
fn what_our_own_networks_do_is_written_without_the_steps_that_they_do_not_take() {
    let steps = r#"{"crop":{"top":60,"bottom":135,"left":10},"blur":"gaussian-3x3","colour_first":true,"resize":{"height":66,"width":200,"filter":"cv2-area"},"crop_resized":{"top":1,"bottom":65},"colour":"cv2-yuv-3.1","scale":"none","layout":"nhwc"}"#;
    assert_eq!(serde_json::to_string(&read(steps)).unwrap(), steps);
}

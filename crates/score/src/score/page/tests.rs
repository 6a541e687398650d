use super::*;
use crate::score::{SCHEMA, Scorer};
use lapwing_core::{car, protocol::Telemetry};

fn at(s: f64) -> Duration {
    Duration::from_secs_f64(s)
}

/// Ten seconds at 10 Hz, pictures that are their own number, and what happened in them.
fn drawn(events: &[(f64, EventRecord)]) -> Drawn {
    let mut collector = Collector::default();
    let mut events = events.iter().peekable();
    let telemetry: Telemetry = serde_json::from_str(r#"{"steering_deg":-5,"throttle":0.25,"speed_mph":9}"#).unwrap();
    for i in 0..100u8 {
        let now = f64::from(i) / 10.0;
        while let Some((when, event)) = events.next_if(|(when, _)| *when <= now) {
            collector.item(at(*when), &Item::Event(event.clone()));
        }
        collector.item(at(now), &Item::Telemetry(telemetry.clone()));
        collector.item(at(now), &Item::Frame(vec![i].into()));
    }
    collector.finish()
}

fn pictures(event: &Happened) -> Vec<u8> {
    let mut pictures = event.pictures.clone();
    pictures.sort_by(|a, b| a.0.total_cmp(&b.0));
    pictures.iter().map(|(_, jpeg)| STANDARD.decode(jpeg).unwrap()[0]).collect()
}

#[test]
fn an_event_is_shown_with_the_pictures_around_it() {
    let drawn = drawn(&[(0.05, EventRecord::Stuck), (5.05, EventRecord::Stuck), (9.5, EventRecord::Stuck)]);
    // A second before, just before, the first one after, and a while after; as many as there are.
    assert_eq!(pictures(&drawn.events[1]), [40, 47, 51, 58]);
    assert_eq!(pictures(&drawn.events[0]), [1, 8]);
    assert_eq!(pictures(&drawn.events[2]), [85, 92, 95]);
}

#[test]
fn long_series_are_thinned_out_alike() {
    let mut collector = Collector::default();
    let telemetry: Telemetry = serde_json::from_str(r#"{"steering_deg":-5,"throttle":0.25,"speed_mph":9}"#).unwrap();
    for i in 0..2 * POINTS as u32 + 1 {
        collector.item(at(f64::from(i) / 15.0), &Item::Telemetry(telemetry.clone()));
    }
    let drawn = collector.finish();
    assert!(drawn.t.len() <= POINTS && drawn.t.len() > POINTS / 2, "{}", drawn.t.len());
    assert_eq!([drawn.speed.len(), drawn.steering.len(), drawn.cte.len(), drawn.at.len()], [drawn.t.len(); 4]);
}

#[test]
fn a_run_that_tells_no_position_is_drawn_where_it_seems_to_have_been() {
    let mut drawn = drawn(&[]);
    drawn.locate(&[(1.0, [10.0, 0.0]), (1.1, [11.0, 0.0])]);
    let told: Vec<_> = drawn.at.iter().enumerate().filter_map(|(i, at)| Some((i, (*at)?[0]))).collect();
    assert_eq!((told, drawn.on_line), (vec![(10, 10.0), (11, 11.0)], true));
    // What is told counts for more.
    drawn.locate(&[(1.0, [99.0, 0.0])]);
    assert_eq!(drawn.at[10], Some([10.0, 0.0]));
}

#[test]
fn no_text_of_a_run_gets_out_of_its_place_in_the_page() {
    let drawn = drawn(&[(1.0, EventRecord::Note { text: "</script><b>/*PAGE*/".into() })]);
    let card = Scorer::default().finish();
    let shown = Shown { title: "a".into(), card: &card, drawn: &drawn, outline: None, missed: vec![] };
    let page = render(&[shown]).unwrap();
    assert_eq!(page.matches("</script>").count(), 8);
    assert!(page.contains("\\u003c/script>\\u003cb>/*PAGE*/"));
    let data = page.split(r#"id="data">"#).nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(data["runs"][0]["card"]["schema"], SCHEMA);
    assert_eq!(data["runs"][0]["drawn"]["events"][0]["words"], "</script><b>/*PAGE*/");
}

#[test]
fn pages_think_a_car_put_elsewhere_where_the_rest_does() {
    assert!(SHARED.contains(&format!("const PUT_M = {};", car::PUT_M)));
}

#[test]
fn a_page_is_one_file_with_everything_in_it() {
    let (drawn, card) = (drawn(&[]), Scorer::default().finish());
    let page =
        render(&[Shown { title: "a".into(), card: &card, drawn: &drawn, outline: None, missed: vec![] }]).unwrap();
    for part in [
        UPLOT,
        UPLOT_STYLE,
        UPLOT_LICENCE,
        SHARED,
        SORTING,
        include_str!("charts.js"),
        include_str!("map.js"),
        include_str!("tables.js"),
        include_str!("page.js"),
    ] {
        assert!(page.contains(part), "{:.60}", part);
    }
    for place in [
        "/*STYLE*/",
        "/*UPLOT*/",
        "/*SHARED*/",
        "/*SORTING*/",
        "/*CHARTS*/",
        "/*MAP*/",
        "/*TABLES*/",
        "/*PAGE*/",
        "/*DATA*/",
    ] {
        assert!(!page.contains(place), "{place} is empty");
    }
    // Nothing is fetched.
    let tags = ["<link", "<script src", "@import", "url(", "fetch(", "XMLHttpRequest", "import("];
    assert_eq!(tags.map(|tag| page.contains(tag)), [false; 7]);
}

#[test]
fn a_page_has_pictures_along_the_run_and_where_its_road_starts() {
    let (mut plain, mut pictured) = (Collector::default(), Collector::with_pictures());
    for i in 0..10u8 {
        for collector in [&mut plain, &mut pictured] {
            collector.item(at(f64::from(i)), &Item::Frame(vec![i].into()));
        }
    }
    assert!(plain.finish().frames.is_empty(), "a player has the pictures from elsewhere");
    let drawn = pictured.finish();
    assert_eq!(drawn.frames.len(), 10);
    let outline = Outline { left: vec![[0.0, 0.0]; 3], right: vec![[1.0, 0.0]; 3], start: 2 };
    let card = Scorer::default().finish();
    let shown = Shown { title: "a".into(), card: &card, drawn: &drawn, outline: Some(&outline), missed: vec![] };
    let page = render(&[shown]).unwrap();
    assert!(page.contains(r#""start":2}"#) && page.contains(&STANDARD.encode([9])));
}

#[test]
fn the_pictures_of_a_page_have_a_limit_however_large_they_are() {
    let (mut collector, jpeg) = (Collector::with_pictures(), bytes::Bytes::from(vec![0; 1 << 20]));
    for i in 0..200 {
        let now = f64::from(i) / 2.0;
        collector.item(at(now), &Item::Event(EventRecord::Stuck));
        collector.item(at(now), &Item::Frame(jpeg.clone()));
    }
    let drawn = collector.finish();
    let in_base64 = |bytes: usize| bytes.div_ceil(3) * 4 + (1 << 10);
    let bytes = |pictures: &[(f32, String)]| pictures.iter().map(|(_, jpeg)| jpeg.len()).sum::<usize>();
    let of_events: usize = drawn.events.iter().map(|event| bytes(&event.pictures)).sum();
    assert!((1..=in_base64(EVENT_BYTES)).contains(&of_events), "{of_events}");
    assert!((1..=in_base64(STRIP_BYTES)).contains(&bytes(&drawn.frames)), "{}", bytes(&drawn.frames));
}

#[test]
fn uplot_is_as_its_authors_ship_it() {
    let readme = include_str!("uplot/README.md");
    let version = readme.split_whitespace().nth(1).unwrap();
    assert!(UPLOT.starts_with(&format!("/*! https://github.com/leeoniya/uPlot (v{version}) */")), "{version}");
    let files = [("uPlot.iife.min.js", UPLOT), ("uPlot.min.css", UPLOT_STYLE), ("LICENSE", UPLOT_LICENCE)];
    for (name, text) in files {
        let line = format!("{}  {name}", lapwing_core::hash::sha256(text));
        assert!(readme.lines().any(|told| told == line), "{line}");
    }
}

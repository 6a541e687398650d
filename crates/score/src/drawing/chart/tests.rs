use super::{
    super::{PAPER, Shape, width_of},
    *,
};

fn bars(heights: &[f64]) -> Chart {
    let marks = Marks::Bars { from: -1.0, width: 0.5, heights: heights.to_vec() };
    let series = vec![Series { colour: Some([1, 2, 3]), ..Series::new("", marks) }];
    Chart { series, ..Chart::new("Bars", Axis::new("x").from_to(-1.0, 1.0), Axis::new("share (%)")) }
}

/// Left, top, right and bottom of the areas in that colour.
fn areas(sheet: &Sheet, wanted: Colour) -> Vec<[f64; 4]> {
    let area = |shape: &Shape| match shape {
        Shape::Area { points, colour } if *colour == wanted => {
            Some([points[0].0, points[0].1, points[2].0, points[2].1])
        }
        _ => None,
    };
    sheet.shapes.iter().filter_map(area).collect()
}

fn texts(sheet: &Sheet) -> Vec<&str> {
    let text = |shape: &'_ Shape| matches!(shape, Shape::Text { .. });
    sheet
        .shapes
        .iter()
        .filter(|s| text(s))
        .map(|s| if let Shape::Text { text, .. } = s { &**text } else { "" })
        .collect()
}

fn lines(sheet: &Sheet, wanted: Colour) -> Vec<Vec<Point>> {
    let line = |shape: &Shape| match shape {
        Shape::Line { points, colour, .. } if *colour == wanted => Some(points.clone()),
        _ => None,
    };
    sheet.shapes.iter().filter_map(line).collect()
}

#[test]
fn bars_are_as_high_as_their_numbers_and_side_by_side() {
    let sheet = bars(&[10.0, 20.0, 0.0, 40.0]).sheet(800, 400);
    let drawn = areas(&sheet, [1, 2, 3]);
    let height = |i: usize| drawn[i][3] - drawn[i][1];
    assert_eq!(drawn.len(), 3, "a bar of nought is not drawn");
    assert!((height(1) / height(0) - 2.0).abs() < 1e-9 && (height(2) / height(0) - 4.0).abs() < 1e-9);
    assert!((drawn[1][0] - drawn[0][2] - 1.0).abs() < 1e-9 && drawn.iter().all(|b| b[3] == drawn[0][3]));
}

#[test]
fn a_bar_beyond_the_axis_is_cut_and_its_height_written() {
    let mut chart = bars(&[1.0, 72.25, 2.0, 1.0]);
    assert!(!texts(&chart.sheet(800, 400)).contains(&"72.2"));
    chart.y.range = Some((0.0, 3.0));
    let sheet = chart.sheet(800, 400);
    assert!(texts(&sheet).contains(&"72.2"));
    assert_eq!(lines(&sheet, PAPER).len(), 1);
}

#[test]
fn a_line_has_a_gap_where_a_number_is_missing() {
    let points = vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 1.0), (4.0, 0.5)];
    let series = Series { colour: Some([9, 9, 9]), ..Series::new("loss", Marks::Line(points)) };
    let chart = Chart { series: vec![series], ..Chart::new("t", Axis::new("x"), Axis::new("y")) };
    let lengths: Vec<usize> = lines(&chart.sheet(800, 400), [9, 9, 9]).iter().map(Vec::len).collect();
    assert_eq!(lengths, [2, 2]);
}

#[test]
fn everything_lies_on_the_sheet_at_any_size() {
    let points: Vec<Point> = (0..200).map(|i| (f64::from(i) * 13.7, (f64::from(i) * 0.3).sin() * 1e4)).collect();
    for (width, height) in [(1, 1), (240, 160), (1200, 500), (4000, 3000)] {
        let series = vec![
            Series::new("one", Marks::Points(points.clone())),
            Series::new("two", Marks::Line(points.iter().map(|(x, y)| (*x, -y)).collect())),
        ];
        let chart = Chart { series, ..Chart::new("t", Axis::new("x"), Axis::new("y")) };
        let sheet = stack(&[chart.clone(), chart], width, height);
        for shape in &sheet.shapes {
            let points = match shape {
                Shape::Area { points, .. } | Shape::Line { points, .. } => points.clone(),
                Shape::Text { at, text } => vec![*at, (at.0 + width_of(text), at.1)],
                Shape::Picture { at, .. } => vec![*at],
            };
            for (x, y) in points {
                assert!(
                    (0.0..=sheet.width).contains(&x) && (0.0..=sheet.height).contains(&y),
                    "{width}x{height}: {shape:?}"
                );
            }
        }
    }
}

#[test]
fn series_are_named_where_there_are_several() {
    let series = |name: &str| Series::new(name, Marks::Points(vec![(0.0, 1.0), (1.0, 2.0)]));
    let mut chart = Chart::new("t", Axis::new("x"), Axis::new("y"));
    chart.series = vec![series("alone")];
    assert!(!texts(&chart.sheet(800, 400)).contains(&"alone"));
    chart.series.push(series("other"));
    let sheet = chart.sheet(800, 400);
    assert!(texts(&sheet).contains(&"alone") && texts(&sheet).contains(&"other"));
}

#[test]
fn a_chart_is_painted_as_svg_and_as_png() {
    let chart = bars(&[1.0, 2.0, 3.0, 4.0]);
    let svg = chart.sheet(600, 300).svg().unwrap();
    assert!(svg.starts_with("<svg ") && svg.contains("share (%)") && svg.contains("<title>Bars</title>"));
    let png = image::load_from_memory(&chart.sheet(600, 300).png().unwrap()).unwrap().to_rgb8();
    assert_eq!((png.width(), png.height()), (600, 300));
    assert!(png.pixels().filter(|p| p.0 == [1, 2, 3]).count() > 10_000);
}

//! Numbers drawn: bars, lines and points between two axes.
//!
//! A [`Chart`] says what is shown; [`Chart::sheet`] lays it out, and [`stack`] puts several below each other.
//!
//! ```
//! use lapwing_score::drawing::chart::{Axis, Chart, Marks, Series};
//!
//! let loss = Series::new("training", Marks::Line(vec![(0.0, 0.30), (1.0, 0.12), (2.0, 0.07)]));
//! let chart = Chart { series: vec![loss], ..Chart::new("Loss", Axis::new("epoch"), Axis::new("loss")) };
//! assert!(chart.sheet(800, 400).svg().unwrap().contains("epoch"));
//! ```

mod axis;
mod layout;

pub use axis::Axis;

use super::{Colour, Point, Sheet};

/// Something to be seen at a glance.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// From left to right.
    pub x: Axis,
    /// From the bottom up.
    pub y: Axis,
    /// What is drawn, the first at the bottom.
    pub series: Vec<Series>,
}

/// Numbers that belong together.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What the legend calls it; nothing where it is to be left out.
    pub name: String,
    /// What it is drawn in; none takes the next of a palette that colour-blind people tell apart.
    pub colour: Option<Colour>,
    /// What it is drawn as.
    pub marks: Marks,
}

/// What numbers are drawn as. A number that is not finite is left out.
#[derive(Debug, Clone, PartialEq)]
pub enum Marks {
    /// From point to point; what is left out makes a gap.
    Line(Vec<Point>),
    /// A dot each.
    Points(Vec<Point>),
    /// Bars from the x axis up, side by side. One that is higher than the axis is cut, and its height written on it.
    Bars {
        /// Where the first begins, in the x axis' unit.
        from: f64,
        /// How wide each is, in the x axis' unit.
        width: f64,
        /// How high they are, in the y axis' unit.
        heights: Vec<f64>,
    },
}

impl Chart {
    /// A chart without numbers yet.
    pub fn new(title: impl Into<String>, x: Axis, y: Axis) -> Self {
        Self { title: title.into(), x, y, series: Vec::new() }
    }

    /// Laid out on a sheet of that size in pixels, at least 240 x 160.
    pub fn sheet(&self, width: u32, height: u32) -> Sheet {
        stack(std::slice::from_ref(self), width, height)
    }
}

impl Series {
    /// Numbers with a name and a colour of the palette.
    pub fn new(name: impl Into<String>, marks: Marks) -> Self {
        Self { name: name.into(), colour: None, marks }
    }
}

impl Marks {
    /// The points that an axis must reach. Bars also stand on something: see `layout`.
    fn points(&self) -> Vec<Point> {
        match self {
            Self::Line(points) | Self::Points(points) => points.clone(),
            Self::Bars { from, width, heights } => {
                let corners = |(i, height): (usize, &f64)| {
                    let left = from + width * i as f64;
                    [(left, *height), (left + width, *height)]
                };
                heights.iter().enumerate().flat_map(corners).collect()
            }
        }
    }
}

/// Charts below each other on one sheet, each `width` x `height` pixels, at least 240 x 160. Its title is the first's.
pub fn stack(charts: &[Chart], width: u32, height: u32) -> Sheet {
    let (width, height) = (f64::from(width.max(240)), f64::from(height.max(160)));
    let mut shapes = Vec::new();
    for (i, chart) in charts.iter().enumerate() {
        layout::draw(chart, (width, height), height * i as f64, &mut shapes);
    }
    let title = charts.first().map_or_else(String::new, |chart| chart.title.clone());
    Sheet { width, height: height * charts.len().max(1) as f64, title, shapes }
}

#[cfg(test)]
mod tests;

//! A suite's heat map as one page for a browser.

use serde::Serialize;

use super::Outcome;
use crate::score::{Figure, figure::Described};

#[derive(Serialize)]
struct Page<'a> {
    #[serde(flatten)]
    outcome: &'a Outcome,
    figures: Vec<Described>,
}

/// The page, as HTML, everything in it.
///
/// # Errors
/// Where a figure is a number that JSON does not have.
pub fn render(outcome: &Outcome) -> Result<String, serde_json::Error> {
    let page = Page { outcome, figures: Figure::described() };
    // Inside a script element nothing may look like its end.
    let data = serde_json::to_string(&page)?.replace('<', "\\u003c");
    Ok(include_str!("page.html").replace("/*DATA*/", &data))
}

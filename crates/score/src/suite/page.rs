//! A suite's heat map as one page for a browser.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{Group, Over, SuiteOutcome};
use crate::score::{
    Figure,
    figure::Described,
    page::{COLOURS, SORTING},
};

#[derive(Serialize)]
struct SuitePage<'a> {
    planned: Option<usize>,
    missing: usize,
    groups: Vec<PageGroup<'a>>,
    figures: Vec<Described>,
    /// What leads from the page to the folder of the results; empty where the page lies in it.
    folder: &'a str,
}

/// A group with its numbers in words: the page shows what the table shows.
#[derive(Serialize)]
struct PageGroup<'a> {
    #[serde(flatten)]
    group: &'a Group,
    words: BTreeMap<&'static str, Words>,
}

impl<'a> PageGroup<'a> {
    fn of(group: &'a Group) -> Self {
        let words = |figure: Figure| Some((figure.key(), Words::of(figure, group.figures.get(figure.key())?)));
        Self { group, words: Figure::ALL.into_iter().filter_map(words).collect() }
    }
}

#[derive(Serialize)]
struct Words {
    mean: String,
    interval: Option<String>,
    least: String,
    most: String,
}

impl Words {
    fn of(figure: Figure, over: &Over) -> Self {
        let (mean, interval) = over.words(figure);
        let [least, most] = [over.spread.least, over.spread.most].map(|end| figure.unit().show_mean(end));
        Self { mean, interval, least, most }
    }
}

/// The page, as HTML, everything in it. `folder` leads from the page to the folder of the results, and is empty where the
/// page lies in that; the links to runs begin with it.
///
/// # Errors
/// Where a figure is a number that JSON does not have.
pub fn render(outcome: &SuiteOutcome, folder: &str) -> Result<String, serde_json::Error> {
    let groups = outcome.groups.iter().map(PageGroup::of).collect();
    let SuiteOutcome { planned, missing, .. } = *outcome;
    let page = SuitePage { planned, missing, groups, figures: Figure::described(), folder };
    // Inside a script element nothing may look like its end.
    let data = serde_json::to_string(&page)?.replace('<', "\\u003c");
    // The data last: a name may hold any text.
    let page = include_str!("page.html").replace("/*COLOURS*/", COLOURS).replace("/*SORTING*/", SORTING);
    Ok(page.replace("/*DATA*/", &data))
}

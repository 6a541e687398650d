//! A trial as one page for a browser, its films in it.

use std::fmt::Write;

use super::{HARMLESS_HEADS, HAZARD_HEADS, HazardRow, TrialResult};
use crate::score::page::{COLOURS, SORTING};

/// The film of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Film {
    /// What it shows.
    pub title: String,
    /// What came of it.
    pub told: String,
    /// `video/mp4` or `image/gif`.
    pub media: &'static str,
    /// The film's bytes as base64.
    pub base64: String,
}

/// The page, as HTML, everything in it.
pub fn render(result: &TrialResult, films: &[Film]) -> String {
    let guard = result.guarded_by();
    let cut_short = result.cut_short().map(|cut_short| format!("<p>{cut_short}</p>")).unwrap_or_default();
    let hazards = |rows: &mut dyn Iterator<Item = &HazardRow>| {
        let rows = rows.map(|row| (row.what.clone(), row.cells().to_vec(), row.avoided.map(|n| (n, row.avoidable))));
        table(&HAZARD_HEADS, rows)
    };
    let mut each: Vec<&HazardRow> = vec![];
    for total in &result.by_hazard {
        each.extend(result.hazards.iter().filter(|row| row.what == total.what));
        each.push(total);
    }
    let harmless = result.harmless.iter().map(|row| (row.what.clone(), row.cells().to_vec(), None));
    let mut shown = String::new();
    for Film { title, told, media, base64 } in films {
        let source = format!("data:{media};base64,{base64}");
        let moving = match *media {
            "video/mp4" => format!("<video src=\"{source}\" controls muted loop playsinline></video>"),
            _ => format!("<img src=\"{source}\" alt=\"{}\">", escaped(title)),
        };
        let (title, told) = (escaped(title), escaped(told));
        write!(shown, "<figure>{moving}<figcaption><b>{title}</b><br>{told}</figcaption></figure>")
            .expect("writing to a String cannot fail");
    }
    include_str!("page.html")
        .replace("/*COLOURS*/", COLOURS)
        .replace("/*SORTING*/", SORTING)
        .replace("/*GUARD*/", &escaped(&guard))
        .replace("/*PART*/", &escaped(&result.part))
        .replace("/*INTERRUPTED*/", &cut_short)
        .replace("/*HAZARDS*/", &hazards(&mut each.into_iter()))
        .replace("/*LAYERS*/", &hazards(&mut result.by_layer.iter()))
        .replace("/*HARMLESS*/", &table(&HARMLESS_HEADS, harmless))
        .replace("/*FILMS*/", &shown)
}

/// A table; the fifth number after the name is coloured by how many were avoided of the avoidable.
fn table(heads: &[&str], rows: impl Iterator<Item = (String, Vec<String>, Option<(usize, usize)>)>) -> String {
    let mut text = String::from("<table><thead><tr><th>what</th>");
    heads.iter().for_each(|head| text += &format!("<th>{head}</th>"));
    text += "</tr></thead><tbody>";
    for (what, cells, avoided) in rows {
        let total = if cells.first().is_some_and(|cell| cell == "all") { " class=\"total\"" } else { "" };
        text += &format!("<tr{total}><th>{}</th>", escaped(&what));
        for (head, cell) in heads.iter().zip(cells) {
            let colour = match avoided {
                Some((n, of)) if *head == "avoided" && of > 0 => {
                    format!(" style=\"background: hsl({:.0} 55% 75%); color: #22262b\"", 120.0 * n as f64 / of as f64)
                }
                _ => String::new(),
            };
            text += &format!("<td{colour}>{}</td>", escaped(&cell));
        }
        text += "</tr>";
    }
    text + "</tbody></table>"
}

/// Text as HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::{super::TrialGuard, *};

    #[test]
    fn a_page_holds_its_films_and_no_markup_of_others() {
        let guard = TrialGuard { name: "<b>x</b>".into(), threshold: 0.5, sha256: None };
        let result = TrialResult::of(Some(guard), "held-out", vec![]);
        let film = Film { title: "a < b".into(), told: "hit".into(), media: "video/mp4", base64: "AAAA".into() };
        let page = render(&result, &[film]);
        assert!(page.contains("&lt;b&gt;x&lt;/b&gt;") && page.contains("a &lt; b"));
        for place in ["COLOURS", "SORTING", "GUARD", "INTERRUPTED", "HAZARDS", "LAYERS", "HARMLESS", "FILMS"] {
            assert!(!page.contains(&format!("/*{place}*/")), "{place} is empty");
        }
        assert!(page.contains(COLOURS) && page.contains(SORTING));
        assert!(page.contains("data:video/mp4;base64,AAAA"));
    }
}

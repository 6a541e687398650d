//! What a page shows as printed, against what is printed. Times, dates and latencies are this machine's; a network's
//! figures depend on the CPU in their last bits.

/// What may differ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Differing {
    /// Only what a clock says.
    Times,
    /// Numbers a little, too: a network drives.
    Figures,
}

/// Whether a command prints the same on every machine.
pub fn steady(words: &[String]) -> Differing {
    let has = |word: &str| words.iter().any(|w| w == word);
    if (has("drive") || has("replay")) && !has("expert") { Differing::Figures } else { Differing::Times }
}

/// The first line that differs by more than it may. `...` stands for any lines.
pub fn difference(shown: &[String], got: &[String], differing: Differing) -> Option<String> {
    let equal = |shown: &String, got: &String| same(shown, got, differing);
    let lines = |lines: &[String]| lines.join("\n");
    let parts: Vec<_> = shown.split(|line| line == "...").collect();
    if let [whole] = parts[..] {
        let pairs = whole.iter().zip(got).find(|(shown, got)| !equal(shown, got));
        let first = pairs.map(|(shown, got)| format!("expected\n{shown}\ngot\n{got}"));
        let lengths = || format!("expected {} lines, got {}:\n{}", shown.len(), got.len(), lines(got));
        return first.or_else(|| (shown.len() != got.len()).then(lengths));
    }
    // The first part begins where the output does, the last ends where it does, and those between follow one another.
    let mut rest = got;
    let fit = parts.iter().enumerate().all(|(i, part)| {
        let Some(last) = rest.len().checked_sub(part.len()) else { return false };
        let from = if i + 1 == parts.len() { last } else { 0 };
        let to = if i == 0 { 0 } else { last };
        let found = (from..=to).find(|at| part.iter().zip(&rest[*at..]).all(|(a, b)| equal(a, b)));
        found.inspect(|at| rest = &rest[at + part.len()..]).is_some()
    });
    (!fit).then(|| format!("expected\n{}\ngot\n{}", lines(shown), lines(got)))
}

fn same(shown: &str, got: &str, differing: Differing) -> bool {
    let named = |line: &str| line.split_whitespace().next().unwrap_or_default().to_owned();
    match (named(shown).as_str(), differing) {
        ("latency" | "frames" | "run", _) => letters(shown) == letters(got),
        ("fingerprint", Differing::Figures) => named(got) == "fingerprint",
        (_, Differing::Times) => shown == got,
        (_, Differing::Figures) => {
            // A network's steering trembles, and how often it changes its mind hangs on a CPU's last bits.
            let share = if shown.contains("times a minute reversed") { 0.5 } else { 0.1 };
            let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 0.1 + share * a.abs().max(b.abs());
            letters(shown) == letters(got) && numbers(shown).iter().zip(&numbers(got)).all(near)
        }
    }
}

fn is_of_a_number(c: char) -> bool {
    c.is_ascii_digit() || c == '.'
}

/// A line without its numbers and without the width of its columns.
fn letters(line: &str) -> String {
    line.split_whitespace().map(|word| word.replace(is_of_a_number, "")).collect::<Vec<_>>().join(" ")
}

fn numbers(line: &str) -> Vec<f64> {
    line.split(|c| !is_of_a_number(c)).filter_map(|text| text.trim_matches('.').parse().ok()).collect()
}

#[test]
fn times_may_differ_and_a_networks_figures_a_little() {
    let line = |text: &str| vec![text.to_owned()];
    for (shown, got, differing, agree) in [
        ("  frames   9 in 5.8 s", "  frames   9 in 12.25 s", Differing::Times, true),
        (
            "  run   runs/2026-11-22T02-14-05-lake.mcap",
            "  run   runs/2027-01-01T00-00-00-lake.mcap",
            Differing::Times,
            true,
        ),
        ("  cte  0.02 m", "  cte  0.03 m", Differing::Times, false),
        ("  cte  0.02 m", "  cte  0.03 m", Differing::Figures, true),
        ("  speed  19.85 mph", "  speed  12.00 mph", Differing::Figures, false),
        ("  steering  20 times a minute reversed", "  steering  29 times a minute reversed", Differing::Figures, true),
        ("  steering  20 times a minute reversed", "  steering  45 times a minute reversed", Differing::Figures, false),
        ("  collisions  0", "  collisions  1", Differing::Figures, false),
        ("  ended  all laps driven", "  ended  crashed", Differing::Figures, false),
        ("  fingerprint  cb0d", "  fingerprint  47aa", Differing::Figures, true),
        ("  fingerprint  cb0d", "  fingerprint  47aa", Differing::Times, false),
    ] {
        assert_eq!(difference(&line(shown), &line(got), differing).is_none(), agree, "{shown} | {got}");
    }
    let [all, some] = [["a", "b", "c"], ["a", "...", "c"]].map(|lines| lines.map(str::to_owned));
    assert_eq!(difference(&some, &all, Differing::Times), None);
    assert!(difference(&some, &all[..2], Differing::Times).is_some());
    let seven = ["a", "b", "c", "d", "e", "f", "g"].map(str::to_owned);
    for (shown, agree) in [
        (&["...", "c", "d", "...", "f", "..."][..], true),
        (&["a", "...", "c", "...", "g"], true),
        (&["...", "d", "...", "c", "..."], false),
        (&["...", "c", "...", "f"], false),
        (&["b", "...", "d", "..."], false),
    ] {
        let shown: Vec<_> = shown.iter().map(|line| (*line).to_owned()).collect();
        assert_eq!(difference(&shown, &seven, Differing::Times).is_none(), agree, "{shown:?}");
    }
}

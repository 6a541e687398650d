//! Wording that the messages of all modules share.

/// A number of things in words: `1 lap`, `2 laps`, `0 telemetries`.
pub fn count(n: impl TryInto<u64>, what: &str) -> String {
    let n = n.try_into().unwrap_or(u64::MAX);
    match what.strip_suffix('y').filter(|stem| !stem.ends_with(['a', 'e', 'o', 'u'])) {
        _ if n == 1 => format!("1 {what}"),
        Some(stem) => format!("{n} {stem}ies"),
        None => format!("{n} {what}s"),
    }
}

/// A road's name, and the way round if that is not its own: `lake`, `lake, the other way round`.
pub fn road(name: &str, reversed: bool) -> String {
    format!("{name}{}", if reversed { ", the other way round" } else { "" })
}

/// The first five, and how many more there are.
pub fn first_five(mut all: Vec<String>) -> Vec<String> {
    let more = all.len().saturating_sub(5);
    all.truncate(5);
    all.extend((more > 0).then(|| format!("{more} more")));
    all
}

/// `; did you mean "lake"?` if one of the known names is so close to what came that it was likely meant.
pub fn did_you_mean<'a>(got: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    let lower = got.to_lowercase();
    let near = |name: &&str| strsim::jaro_winkler(&lower, &name.to_lowercase());
    let best = known.into_iter().max_by(|a, b| near(a).total_cmp(&near(b)));
    best.filter(|name| *name != got && near(name) >= LIKELY)
        .map_or_else(String::new, |name| format!("; did you mean {name:?}?"))
}

/// A message of serde's in one line and without Rust's names for numbers and tables. If it is about an unknown name, the expected name
/// that was likely meant is added. Other messages stay as they are, and so does one that came from here.
pub fn suggesting(message: &str) -> String {
    let types = [
        ("f64", "a number"),
        ("u16", "a whole number from 0 to 65535"),
        ("u32", "a whole number of at least 0"),
        ("u64", "a whole number of at least 0"),
        ("usize", "a whole number of at least 0"),
    ];
    let plain = |message: String, (rust, words): &(&str, &str)| match message.split_once(&format!("expected {rust}")) {
        Some((before, after)) if !after.starts_with(char::is_alphanumeric) => {
            format!("{before}expected {words}{after}")
        }
        _ => message,
    };
    let message = table(types.iter().fold(message.trim_end().replace("\nin `", ", in `"), plain));
    let named: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    match (message.contains("unknown field `") || message.contains("unknown variant `"), named.split_first()) {
        (true, Some((got, known))) => {
            let meant = did_you_mean(got, known.iter().copied());
            if message.ends_with(&meant) { message } else { message.clone() + &meant }
        }
        _ => message,
    }
}

/// A message of serde's without the name that Rust has for a table.
fn table(message: String) -> String {
    match message.split_once("expected struct ") {
        Some((before, after)) => {
            let rest = after.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_');
            format!("{before}expected a table{rest}")
        }
        None => message,
    }
}

/// From this similarity on (Jaro and Winkler, 0 to 1): two letters swapped, one wrong or missing.
const LIKELY: f64 = 0.8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_one_and_others_are_many() {
        for (n, what, expected) in [
            (1, "intervention", "1 intervention"),
            (0, "intervention", "0 interventions"),
            (2, "telemetry", "2 telemetries"),
            (1, "telemetry", "1 telemetry"),
            (3, "day", "3 days"),
        ] {
            assert_eq!(count(n, what), expected);
        }
        assert_eq!(count(7usize, "lap"), "7 laps");
    }

    #[test]
    fn an_unknown_field_is_known_for_the_one_that_was_meant() {
        let message = "unknown field `sped_mph`, expected one of `speed_law`, `speed_mph`\n";
        assert!(suggesting(message).ends_with("; did you mean \"speed_mph\"?"), "{}", suggesting(message));
        let other = "invalid type: string \"x\", expected a sequence";
        assert_eq!(suggesting(other), other);
    }

    #[test]
    fn a_wrong_type_is_said_in_words_and_in_one_line() {
        let message = "invalid type: string \"fast\", expected f64\nin `control.speed_mph`\n";
        let expected = "invalid type: string \"fast\", expected a number, in `control.speed_mph`";
        assert_eq!(suggesting(message), expected);
    }

    #[test]
    fn no_name_that_only_rust_has_for_a_type_is_left() {
        for (message, expected) in [
            ("invalid type: floating point `1.5`, expected usize", "a whole number of at least 0"),
            ("invalid type: integer `3`, expected struct Rules\nin `simulator.rules`", "a table, in `simulator.rules`"),
        ] {
            let said = suggesting(message);
            assert!(said.ends_with(&format!(", expected {expected}")), "{said}");
        }
    }

    #[test]
    fn what_was_said_in_words_stays_as_it_is() {
        for message in [
            "unknown field `sped_mph`, expected one of `speed_law`, `speed_mph`",
            "invalid type: string \"fast\", expected f64\nin `control.speed_mph`",
            "invalid value: integer `-1`, expected usize",
            "cannot read a.toml: no such file",
        ] {
            let said = suggesting(message);
            assert_eq!(suggesting(&said), said);
        }
    }

    #[test]
    fn a_misspelt_name_is_known_for_what_was_meant_and_another_word_is_not() {
        let tracks = ["lake", "jungle", "mountain"];
        for (got, meant) in
            [("lkae", "lake"), ("laek", "lake"), ("Lake", "lake"), ("jungel", "jungle"), ("mountan", "mountain")]
        {
            assert_eq!(did_you_mean(got, tracks), format!("; did you mean {meant:?}?"));
        }
        for got in ["moon", "", "random:x", "x"] {
            assert_eq!(did_you_mean(got, tracks), "", "{got}");
        }
        assert_eq!(did_you_mean("lake", []), "");
        assert_eq!(did_you_mean("lake", tracks), "", "it was said");
    }
}

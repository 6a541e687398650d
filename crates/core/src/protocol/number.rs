//! Numbers as C# writes and reads them in the player's culture, and the one
//! notation that every culture reads alike.
//!
//! The simulator prints with `ToString("N4")`: four decimals, grouped
//! thousands, separators of the player's culture, a minus sign in front or, in
//! Persian, behind. It reads with `float.Parse`, where a dot is a thousands
//! separator in German and an error in French.

use std::fmt::Write;

/// Text that is not a finite number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected a number, got {0:?}")]
pub struct NotANumber(pub String);

/// How much of an offending text an error repeats.
const QUOTED: usize = 40;

impl NotANumber {
    fn new(text: &str) -> Self {
        Self(text.chars().take(QUOTED).collect())
    }
}

const MINUS_SIGNS: [char; 3] = ['-', '\u{2212}', '\u{2012}'];

/// Reads a number that C#'s `ToString("N4")` wrote in any culture.
///
/// The decimal separator is the fifth character from the end of the digits and
/// all other non-digits but the sign are grouping. Text without four decimals
/// comes from other clients and is read as a plain number, with a decimal comma
/// allowed.
///
/// # Errors
/// [`NotANumber`] if there are no digits, or if the value is not finite (C# prints `NaN` and, by culture, `Infinity`,
/// `∞` and `unendlich`).
pub fn parse(text: &str) -> Result<f64, NotANumber> {
    let error = || NotANumber::new(text);
    let body = text.trim();
    let unsigned = without_signs(text);
    let negative = body.contains(MINUS_SIGNS) && !unsigned.contains(['e', 'E']) || body.starts_with(MINUS_SIGNS);
    // No number of this protocol is longer; a megabyte of digits is not worth reading.
    if unsigned.len() > 400 || !unsigned.contains(|c: char| c.is_ascii_digit()) {
        return Err(error());
    }
    let magnitude = match n4(unsigned) {
        Some((value, _)) => value,
        None if unsigned.starts_with(|c: char| c.is_ascii_alphabetic()) => return Err(error()),
        None => unsigned.replacen(',', ".", 1).parse::<f64>().map_err(|_| error())?,
    };
    if magnitude.is_finite() { Ok(if negative { -magnitude } else { magnitude }) } else { Err(error()) }
}

/// What separates the decimals of a number that C#'s `ToString("N4")` wrote: it tells the player's culture. None for other text.
pub fn decimal_separator(text: &str) -> Option<char> {
    n4(without_signs(text)).map(|(_, separator)| separator)
}

fn without_signs(text: &str) -> &str {
    text.trim().trim_matches(|c| MINUS_SIGNS.contains(&c) || c == '+')
}

/// The value of unsigned digits with exactly four decimals, whatever the separators are, and what separates the decimals.
fn n4(text: &str) -> Option<(f64, char)> {
    let mut from_end = text.char_indices().rev();
    for _ in 0..4 {
        from_end.next().filter(|(_, c)| c.is_ascii_digit())?;
    }
    let (point, separator) = from_end.next().filter(|(_, c)| !c.is_alphanumeric())?;
    let mut digits = String::with_capacity(text.len());
    for c in text[..point].chars() {
        match c {
            '0'..='9' => digits.push(c),
            c if c.is_alphanumeric() || c == separator || c == '+' || MINUS_SIGNS.contains(&c) => return None,
            _ => {} // grouping
        }
    }
    digits.push('.');
    digits.push_str(&text[point + separator.len_utf8()..]);
    Some((digits.parse().ok()?, separator))
}

/// Appends `value` as an integer mantissa and an exponent, `1234e-4`, which `float.Parse` reads correctly in every
/// culture. Four decimals, as many as the simulator itself sends.
pub fn write_universal(out: &mut String, value: f64) {
    write!(out, "{}e-4", (value * 1e4).round() as i64).expect("writing to a String cannot fail");
}

/// C#'s `float.ToString()` where the decimal separator is a point, as the training recorder writes its log:
/// seven significant digits, halves away from zero, no needless zeros, and an exponent where the first
/// digit stands below the fourth decimal or above the millions (`4.540283E-05`, `1.5E+07`).
///
/// Source: .NET's format `G7`, the default of `float` in Unity's runtimes.
pub fn single(value: f64) -> String {
    const DIGITS: usize = 7;
    let value = value as f32;
    if value == 0.0 {
        return "0".into(); // a negative one, too
    }
    if !value.is_finite() {
        return if value.is_nan() { "NaN".into() } else { if value > 0.0 { "Infinity" } else { "-Infinity" }.into() };
    }
    // Enough digits to tell any half from its neighbours; Rust itself would round halves to even.
    let exact = format!("{:.40e}", value.abs());
    let (mantissa, exponent) = exact.split_once('e').expect("an exponent was asked for");
    let mut exponent: i32 = exponent.parse().expect("the exponent of a float");
    let mut digits: Vec<u8> = mantissa.bytes().filter(u8::is_ascii_digit).collect();
    let up = digits[DIGITS] >= b'5';
    digits.truncate(DIGITS);
    if up {
        match digits.iter().rposition(|d| *d != b'9') {
            Some(last) => {
                digits[last] += 1;
                digits.truncate(last + 1);
            }
            None => {
                digits = vec![b'1'];
                exponent += 1;
            }
        }
    }
    while digits.len() > 1 && digits.last() == Some(&b'0') {
        digits.pop();
    }
    let sign = if value < 0.0 { "-" } else { "" };
    let digits: String = digits.into_iter().map(char::from).collect();
    match exponent {
        -4..0 => format!("{sign}0.{}{digits}", "0".repeat((-exponent - 1) as usize)),
        0..7 => {
            let whole = exponent as usize + 1;
            match digits.split_at_checked(whole) {
                Some((whole, "")) => format!("{sign}{whole}"),
                Some((whole, decimals)) => format!("{sign}{whole}.{decimals}"),
                None => format!("{sign}{digits:0<whole$}"),
            }
        }
        _ => {
            let (first, rest) = digits.split_at(1);
            let point = if rest.is_empty() { "" } else { "." };
            format!("{sign}{first}{point}{rest}E{exponent:+03}")
        }
    }
}

/// The separators of a player's culture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Culture {
    /// Its name, as .NET spells it.
    pub name: &'static str,
    group: char,
    decimal: char,
    minus_behind: bool,
}

impl Culture {
    /// The cultures seen among players of the simulator.
    pub const ALL: [Self; 5] = [
        Self { name: "en-US", group: ',', decimal: '.', minus_behind: false },
        Self { name: "de-DE", group: '.', decimal: ',', minus_behind: false },
        Self { name: "fr-FR", group: '\u{a0}', decimal: ',', minus_behind: false },
        Self { name: "de-CH", group: '\'', decimal: '.', minus_behind: false },
        Self { name: "fa-IR", group: ',', decimal: '/', minus_behind: true },
    ];

    /// The culture of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|c| c.name.eq_ignore_ascii_case(name))
    }

    /// C#'s `value.ToString("N4")`.
    pub fn n4(self, value: f64) -> String {
        self.four_decimals(value, true)
    }

    /// C#'s `value.ToString("F4")`: as [`Culture::n4`], without grouping.
    pub fn f4(self, value: f64) -> String {
        self.four_decimals(value, false)
    }

    fn four_decimals(self, value: f64, grouped: bool) -> String {
        let plain = format!("{:.4}", value.abs());
        let (whole, decimals) = plain.split_once('.').expect("four decimals were asked for");
        let mut text = String::with_capacity(plain.len() + 4);
        let negative = value < 0.0 && plain.contains(|c: char| ('1'..='9').contains(&c));
        if negative && !self.minus_behind {
            text.push('-');
        }
        for (i, digit) in whole.chars().enumerate() {
            if grouped && i > 0 && (whole.len() - i) % 3 == 0 {
                text.push(self.group);
            }
            text.push(digit);
        }
        text.push(self.decimal);
        text.push_str(decimals);
        if negative && self.minus_behind {
            text.push('-');
        }
        text
    }

    /// C#'s `float.Parse(text)`: thousands separators are skipped wherever they
    /// stand before the decimal one, an exponent is allowed.
    ///
    /// # Errors
    /// [`NotANumber`] where C# throws, and for NaN and infinities, which its
    /// callers swallow.
    pub fn float_parse(self, text: &str) -> Result<f64, NotANumber> {
        let error = || NotANumber::new(text);
        let (mantissa, exponent) = match text.trim().split_once(['e', 'E']) {
            Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().map_err(|_| error())?),
            None => (text.trim(), 0),
        };
        let mut plain = String::with_capacity(mantissa.len() + 8);
        let mut seen_decimal = false;
        for (i, c) in mantissa.char_indices() {
            match c {
                '0'..='9' => plain.push(c),
                '+' | '-' if i == 0 => plain.push(c),
                c if c == self.group && !seen_decimal => {}
                c if c == self.decimal && !seen_decimal => {
                    seen_decimal = true;
                    plain.push('.');
                }
                _ => return Err(error()),
            }
        }
        write!(plain, "e{exponent}").expect("writing to a String cannot fail");
        plain.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cultures_n4_is_read() {
        for (text, value) in [
            ("-1,234.5000", -1234.5),
            ("-1.234,5000", -1234.5),
            ("-1\u{a0}234,5000", -1234.5),
            ("-1\u{202f}234,5000", -1234.5),
            ("-1'234.5000", -1234.5),
            ("1,234/5000-", -1234.5),
            ("\u{2212}1\u{a0}234,5000", -1234.5),
            ("12,34,567.0000", 1_234_567.0),
            ("30.1903", 30.1903),
            ("0,0000", 0.0),
            ("-0.0001", -0.0001),
        ] {
            assert_eq!(parse(text), Ok(value), "{text}");
        }
    }

    #[test]
    fn other_clients_plain_numbers_are_read() {
        for (text, value) in
            [("0.25", 0.25), ("-0,5", -0.5), ("7", 7.0), ("1.5e-5", 1.5e-5), ("-2E3", -2000.0), (" 1 ", 1.0)]
        {
            assert_eq!((parse(text), decimal_separator(text)), (Ok(value), None), "{text}");
        }
    }

    #[test]
    fn what_is_no_finite_number_is_refused() {
        for text in [
            "",
            "-",
            "NaN",
            "nan",
            "Infinity",
            "-∞",
            "unendlich",
            "1e999",
            "12a.0000",
            "0x10",
            "1.2.3",
            "12-34.0000",
            "e5",
            "٣.٠٠٠٠",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
        assert!(parse(&"9".repeat(1_000_000)).is_err());
        assert_eq!(parse(&"x".repeat(500)).unwrap_err().0.len(), QUOTED);
    }

    #[test]
    fn what_a_culture_prints_is_read_back_in_that_culture_and_by_us() {
        for culture in Culture::ALL {
            for value in [0.0, -0.25, 0.0001, 1.0, 25.0, 999.9999, -1000.0, 1_234_567.891] {
                let text = culture.n4(value);
                assert!((parse(&text).unwrap() - value).abs() < 1e-4, "{} {text}", culture.name);
                assert_eq!(decimal_separator(&text), Some(culture.decimal), "{} {text}", culture.name);
                if !culture.minus_behind {
                    assert!((culture.float_parse(&text).unwrap() - value).abs() < 1e-4, "{} {text}", culture.name);
                }
            }
        }
    }

    #[test]
    fn n4_is_c_sharps() {
        let [us, de, fr, ch, fa] = Culture::ALL;
        assert_eq!(us.n4(-1234.5), "-1,234.5000");
        assert_eq!(de.n4(-1234.5), "-1.234,5000");
        assert_eq!(fr.n4(-1234.5), "-1\u{a0}234,5000");
        assert_eq!(ch.n4(-1234.5), "-1'234.5000");
        assert_eq!(fa.n4(-1234.5), "1,234/5000-");
        assert_eq!(us.n4(-0.000_01), "0.0000");
        assert_eq!(
            Culture::ALL.map(|c| c.f4(-1234.5)),
            ["-1234.5000", "-1234,5000", "-1234,5000", "-1234.5000", "1234/5000-"]
        );
    }

    #[test]
    fn single_is_c_sharps() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (0.649_786_4, "0.6497864"),
            (-0.05, "-0.05"),
            (30.175_23, "30.17523"),
            (4.540_283e-5, "4.540283E-05"),
            (7.968_108e-6, "7.968108E-06"),
            (0.000_485_161_3, "0.0004851613"),
            (1e-5, "1E-05"),
            (0.0001, "0.0001"),
            (-1.25e-12, "-1.25E-12"),
            (1e-30, "1E-30"),
            (100.0, "100"),
            (1_234_567.0, "1234567"),
            (1_234_566.5, "1234567"),
            (12_345_678.0, "1.234568E+07"),
            (1e10, "1E+10"),
            (0.999_999_94, "0.9999999"),
            (9_999_999.5, "1E+07"),
            (0.000_099_999_999, "0.0001"),
            (1.0 / 3.0, "0.3333333"),
            (16_777_217.0, "1.677722E+07"),
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "-Infinity"),
        ] {
            assert_eq!(single(value), text, "{value:e}");
        }
    }

    #[test]
    fn the_universal_notation_means_the_same_in_every_culture() {
        for value in [0.0, 0.1234, -0.1234, 1.0, -1.0, 0.000_04] {
            let mut text = String::new();
            write_universal(&mut text, value);
            for culture in Culture::ALL {
                assert!((culture.float_parse(&text).unwrap() - value).abs() <= 0.5e-4, "{} {text}", culture.name);
            }
        }
    }

    #[test]
    fn a_decimal_point_is_one_in_german_and_an_error_in_french() {
        let [_, de, fr, ..] = Culture::ALL;
        assert_eq!(de.float_parse("0.1"), Ok(1.0));
        assert!(fr.float_parse("0.1").is_err());
    }
}

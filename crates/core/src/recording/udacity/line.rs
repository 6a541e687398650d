//! One line of a driving log: its fields, whatever the locale made of them.
//!
//! In a locale with decimal commas the simulator writes `-0,0858, 0,1286, 0, 12,1822`: a number may take one field or
//! two. If a space follows each separating comma, the spaces decide. If not, all ways to read the fields as the right
//! number of numbers are tried, and a reading is accepted if it is the only one
//!
//! - whose second halves are decimals as C# writes them, without a trailing zero,
//! - whose values lie in their ranges, and
//! - whose brake is a bare 0, as it is in nearly every row of every drive, if
//!   any reading has that.

use std::{borrow::Cow, fmt};

use crate::units::{Mph, OutOfRange, Steering, Throttle};

/// A field that cannot be read.
#[derive(Debug)]
pub(super) struct Bad {
    pub field: String,
    pub expected: String,
    pub got: String,
    pub help: &'static str,
}

impl Bad {
    /// Of a text that is UTF-16, as its first two bytes say.
    pub(super) fn utf_16() -> Self {
        Self {
            field: "text".into(),
            expected: "UTF-8".into(),
            got: "UTF-16".into(),
            help: "save the table as CSV in UTF-8",
        }
    }
}

/// What a column of a driving log holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Column {
    Center,
    Left,
    Right,
    Steering,
    Throttle,
    Brake,
    Speed,
    /// A column that is not read.
    Other,
}

impl Column {
    const ALL: [Self; 7] =
        [Self::Center, Self::Left, Self::Right, Self::Steering, Self::Throttle, Self::Brake, Self::Speed];
    const REQUIRED: [Self; 5] = [Self::Center, Self::Steering, Self::Throttle, Self::Brake, Self::Speed];

    fn is_image(self) -> bool {
        matches!(self, Self::Center | Self::Left | Self::Right)
    }

    /// Whether the number can be one of this column.
    fn holds(self, value: f64) -> bool {
        match self {
            Self::Steering => Steering::new(value).is_ok(),
            Self::Throttle => Throttle::new(value).is_ok(),
            Self::Brake => brake(value).is_ok(),
            Self::Speed => Mph::new(value).is_ok(),
            _ => true,
        }
    }
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Center => "center",
            Self::Left => "left",
            Self::Right => "right",
            Self::Steering => "steering",
            Self::Throttle => "throttle",
            Self::Brake => "brake",
            Self::Speed => "speed",
            Self::Other => "other",
        })
    }
}

fn names(columns: &[Column]) -> String {
    columns.iter().map(Column::to_string).collect::<Vec<_>>().join(", ")
}

/// A brake, 0 to 1.
pub(super) fn brake(value: f64) -> Result<f64, OutOfRange> {
    let wrong = OutOfRange { quantity: "a brake", unit: "", min: 0.0, max: 1.0, got: value };
    if (0.0..=1.0).contains(&value) { Ok(value) } else { Err(wrong) }
}

/// The file name at the end of a path of any system, if it is a picture's.
pub(super) fn file_name(path: &str) -> Option<&str> {
    let name = path.rsplit(['/', '\\']).next()?.trim();
    let (stem, extension) = name.rsplit_once('.')?;
    let is_image = ["jpg", "jpeg", "png"].iter().any(|e| extension.eq_ignore_ascii_case(e));
    (is_image && !stem.is_empty()).then_some(name)
}

/// The columns of a log, in its order.
#[derive(Debug, Clone)]
pub(super) struct Columns(Vec<Column>);

impl Default for Columns {
    /// As the simulator writes it.
    fn default() -> Self {
        Self(Column::ALL.into())
    }
}

/// The fields of a line by column.
pub(super) struct LineFields<'a> {
    layout: &'a Columns,
    values: Vec<Cow<'a, str>>,
}

/// A piece of a line between two commas, without its quotes and the spaces around it.
#[derive(Debug, Clone, Copy)]
struct LinePiece<'a> {
    text: &'a str,
    /// A space before it.
    spaced: bool,
}

impl Columns {
    /// The columns that a header names, `None` if the line is not a header.
    ///
    /// # Errors
    /// A header that lacks columns.
    pub(super) fn from_header(line: &str) -> Result<Option<Self>, Bad> {
        let columns: Vec<Column> = split(line)?
            .iter()
            .map(|piece| {
                let is = |c: &Column| piece.text.eq_ignore_ascii_case(&c.to_string());
                Column::ALL.into_iter().find(is).unwrap_or(Column::Other)
            })
            .collect();
        if !columns.contains(&Column::Center) {
            return Ok(None);
        }
        if Column::REQUIRED.iter().any(|required| !columns.contains(required)) {
            return Err(Bad {
                field: "header".into(),
                expected: format!("the columns {}", names(&Column::REQUIRED)),
                got: line.trim().into(),
                help: "name the columns that are there, or remove the header",
            });
        }
        Ok(Some(Self(columns)))
    }

    /// The line's fields, one for each column.
    ///
    /// # Errors
    /// Too few, too many, or more than one way to join them.
    pub(super) fn fields<'a>(&'a self, line: &'a str) -> Result<LineFields<'a>, Bad> {
        let pieces = split(line)?;
        let columns = &self.0;
        let values = if pieces.len() == columns.len() {
            pieces.iter().map(|p| Cow::Borrowed(p.text)).collect()
        } else if pieces.len() < columns.len() {
            let separated = |by: char| line.matches(by).count() + 1 >= Column::REQUIRED.len();
            return Err(Bad {
                field: "columns".into(),
                expected: format!("{} ({})", columns.len(), names(columns)),
                got: pieces.len().to_string(),
                help: if separated(';') {
                    "commas separate the columns, not semicolons: save the table as CSV with commas"
                } else if separated('\t') {
                    "commas separate the columns, not tabs: save the table as CSV with commas"
                } else {
                    "complete or remove the line; a log in another order needs a header that names its columns"
                },
            });
        } else {
            self.join(&pieces)?
        };
        Ok(LineFields { layout: self, values })
    }

    /// Joins fields that commas within paths and numbers split.
    fn join<'a>(&self, pieces: &[LinePiece<'a>]) -> Result<Vec<Cow<'a, str>>, Bad> {
        let (columns, mut rest) = (&self.0, pieces);
        let mut values = Vec::with_capacity(columns.len());
        let mut from = 0;
        while from < columns.len() {
            if columns[from].is_image() {
                // A folder may have a comma in its name, too: the picture ends the field.
                let end = rest.iter().position(|p| p.text.is_empty() || file_name(p.text).is_some()).unwrap_or(0);
                values.push(Cow::Borrowed(rest.get(end).map_or("", |p| p.text)));
                rest = rest.get(end + 1..).unwrap_or_default();
                from += 1;
            } else {
                let numbers = columns[from..].iter().take_while(|c| !c.is_image()).count();
                let (columns, images_after) = columns[from..].split_at(numbers);
                let end = if images_after.is_empty() {
                    rest.len()
                } else {
                    // The path of the next picture does not begin with a number.
                    rest.iter().position(|p| number(p.text).is_none()).unwrap_or(rest.len())
                };
                values.extend(join_numbers(columns, &rest[..end])?);
                rest = &rest[end..];
                from += numbers;
            }
        }
        Ok(values)
    }
}

/// Joins pieces, which are numbers or halves of them, into as many numbers as there are columns.
fn join_numbers<'a>(columns: &[Column], pieces: &[LinePiece<'a>]) -> Result<Vec<Cow<'a, str>>, Bad> {
    let mut readings = Vec::new();
    // Each further column doubles the ways to try, and a log has four numbers.
    if columns.len() <= 12 {
        extend(columns, pieces, &mut Vec::new(), &mut readings);
    }
    // Where spaces follow separating commas, none follows a decimal comma.
    if pieces.iter().skip(1).any(|p| p.spaced) {
        readings.retain(|reading| {
            let mut pieces = pieces.iter();
            reading.iter().enumerate().all(|(i, (_, halves))| {
                (0..*halves).all(|half| pieces.next().is_some_and(|p| i + half == 0 || p.spaced == (half == 0)))
            })
        });
    }
    let is_brake_0 = |reading: &Reading<'_>| {
        columns.iter().zip(reading).all(|(column, (text, _))| *column != Column::Brake || text == "0")
    };
    if readings.iter().any(is_brake_0) {
        readings.retain(is_brake_0);
    }
    let bad = |expected: String, help| Bad {
        field: "numbers".into(),
        expected,
        got: pieces.iter().map(|p| p.text).collect::<Vec<_>>().join(","),
        help,
    };
    match readings.pop() {
        Some(only) if readings.is_empty() => Ok(only.into_iter().map(|(text, _)| text).collect()),
        Some(_) => Err(bad(
            format!("one way to read {} fields as {}", pieces.len(), names(columns)),
            "decimal commas and separating commas cannot be told apart here: write the log with decimal points",
        )),
        None => Err(bad(
            format!("{} numbers ({})", columns.len(), names(columns)),
            "correct or remove the line; a log with further columns needs a header that names them",
        )),
    }
}

/// The text of each number, and how many pieces it is made of.
type Reading<'a> = Vec<(Cow<'a, str>, usize)>;

/// All ways to read `pieces` as `columns`, continuing from `so_far`.
fn extend<'a>(columns: &[Column], pieces: &[LinePiece<'a>], so_far: &mut Reading<'a>, found: &mut Vec<Reading<'a>>) {
    let Some((column, columns)) = columns.split_first() else {
        if pieces.is_empty() {
            found.push(so_far.clone());
        }
        return;
    };
    if pieces.len() <= columns.len() || pieces.len() > 2 * (columns.len() + 1) {
        return;
    }
    let whole = pieces[0].text;
    if number(whole).is_some_and(|value| column.holds(value)) {
        so_far.push((whole.into(), 1));
        extend(columns, &pieces[1..], so_far, found);
        so_far.pop();
    }
    if let Some(joined) = pieces.get(1).and_then(|decimals| halves(whole, decimals.text))
        && number(&joined).is_some_and(|value| column.holds(value))
    {
        so_far.push((joined.into(), 2));
        extend(columns, &pieces[2..], so_far, found);
        so_far.pop();
    }
}

/// Two halves of a number as C# prints it, joined: digits without needless zeros, then decimals likewise.
fn halves(whole: &str, decimals: &str) -> Option<String> {
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let unsigned = whole.strip_prefix('-').unwrap_or(whole);
    let plain = decimals.split(['e', 'E']).next()?;
    let is_whole = digits(unsigned) && (unsigned == "0" || !unsigned.starts_with('0'));
    (is_whole && digits(plain) && !plain.ends_with('0')).then(|| format!("{whole}.{decimals}"))
}

/// A number as any locale writes it, with a decimal point or one decimal comma.
fn number(text: &str) -> Option<f64> {
    // "inf" and "nan" are numbers to Rust; being out of every range, they are refused there.
    if text.contains('.') { text.parse().ok() } else { text.replacen(',', ".", 1).parse().ok() }
}

impl LineFields<'_> {
    /// The field of a column, `None` where the log has no such column.
    pub(super) fn get(&self, column: Column) -> Option<&str> {
        let i = self.layout.0.iter().position(|c| *c == column)?;
        self.values.get(i).map(AsRef::as_ref)
    }

    /// The number of a column.
    pub(super) fn quantity<Q>(
        &self,
        column: Column,
        check: impl FnOnce(f64) -> Result<Q, OutOfRange>,
    ) -> Result<Q, Bad> {
        let got = self.get(column).unwrap_or_default();
        let bad = |expected: String| Bad {
            field: column.to_string(),
            expected,
            got: got.into(),
            help: "correct or remove the line",
        };
        let value = number(got).ok_or_else(|| bad("a number".into()))?;
        check(value).map_err(|e| bad(format!("{} from {} to {}{}", e.quantity, e.min, e.max, e.unit)))
    }
}

/// A line taken apart at its commas, except those within quotes.
fn split(line: &str) -> Result<Vec<LinePiece<'_>>, Bad> {
    let mut pieces = Vec::new();
    let mut rest = Some(line);
    while let Some(text) = rest {
        let trimmed = text.trim_start();
        let spaced = trimmed.len() < text.len();
        let piece = if let Some(quoted) = trimmed.strip_prefix('"') {
            let Some((inside, behind)) = quoted.split_once('"') else {
                return Err(Bad {
                    field: "fields".into(),
                    expected: "a closing quote".into(),
                    got: trimmed.into(),
                    help: "correct or remove the line",
                });
            };
            rest = behind.split_once(',').map(|(_, rest)| rest);
            inside.trim()
        } else {
            let (piece, behind) = match text.split_once(',') {
                Some((piece, behind)) => (piece, Some(behind)),
                None => (text, None),
            };
            rest = behind;
            piece.trim()
        };
        pieces.push(LinePiece { text: piece, spaced });
    }
    Ok(pieces)
}

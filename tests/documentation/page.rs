//! A page of the documentation, read: fenced blocks, commands in them, code and links in the text.

use std::{fs, path::Path};

/// A page, by its path from the root.
pub struct Page {
    pub name: String,
    pub text: String,
}

/// A fenced block; its lines are counted from 0.
pub struct Block<'a> {
    pub language: &'a str,
    /// Number of the first line inside.
    pub first: usize,
    pub lines: Vec<&'a str>,
}

/// A command of a block.
#[derive(Debug, Clone, PartialEq)]
pub struct Invocation {
    pub line: usize,
    pub words: Vec<String>,
    /// The file that its output goes to.
    pub into: Option<String>,
    /// What the page shows as its output, of a `console` block; the numbers of its lines are `line + 1` and so on.
    pub shown: Option<Vec<String>>,
}

/// The README, the book, and what is next to the models.
pub fn pages(root: &Path) -> Vec<Page> {
    let mut names = vec!["README.md".to_owned(), "models/README.md".to_owned()];
    let mut folders = vec![root.join("docs")];
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                names.push(path.strip_prefix(root).unwrap().to_str().unwrap().to_owned());
            }
        }
    }
    names.sort();
    names.into_iter().map(|name| Page { text: fs::read_to_string(root.join(&name)).unwrap(), name }).collect()
}

impl Page {
    /// All fenced blocks.
    pub fn blocks(&self) -> Vec<Block<'_>> {
        let (mut blocks, mut open): (Vec<Block<'_>>, bool) = (vec![], false);
        for (number, line) in self.text.lines().enumerate() {
            match (line.strip_prefix("```"), open) {
                (Some(language), false) => blocks.push(Block { language, first: number + 1, lines: vec![] }),
                (None, true) => blocks.last_mut().expect("open").lines.push(line),
                (Some(_), true) | (None, false) => {}
            }
            open ^= line.starts_with("```");
        }
        assert!(!open, "{}: a block is not closed", self.name);
        blocks
    }

    /// The text without fenced blocks.
    fn prose(&self) -> String {
        let mut inside = false;
        let outside = |line: &&str| {
            let fence = line.starts_with("```");
            inside ^= fence;
            !inside && !fence
        };
        self.text.lines().filter(outside).collect::<Vec<_>>().join("\n")
    }

    /// What stands between backticks in the text.
    pub fn code(&self) -> Vec<String> {
        self.prose().split('`').skip(1).step_by(2).map(|code| code.replace('\n', " ")).collect()
    }

    /// Text and target of all links and pictures.
    pub fn links(&self) -> Vec<(String, String)> {
        let prose = self.prose();
        let mut links: Vec<_> = prose
            .match_indices("](")
            .map(|(at, _)| {
                let text = &prose[prose[..at].rfind('[').unwrap() + 1..at];
                let target = &prose[at + 2..at + prose[at..].find(')').unwrap()];
                (text.replace('\n', " "), target.to_owned())
            })
            .collect();
        let pictures =
            prose.split("src=\"").skip(1).map(|rest| (String::new(), rest.split('"').next().unwrap().to_owned()));
        links.extend(pictures);
        links
    }

    /// The anchors that links may name.
    pub fn anchors(&self) -> Vec<String> {
        let headings = self.text.lines().filter_map(|line| line.strip_prefix('#'));
        let kept = |c: &char| c.is_alphanumeric() || " -_".contains(*c);
        let anchor =
            |line: &str| line.trim_start_matches('#').trim().to_lowercase().chars().filter(kept).collect::<String>();
        headings.map(|line| anchor(line).replace(' ', "-")).collect()
    }

    /// The commands of all `sh` and `console` blocks.
    pub fn invocations(&self) -> Vec<Invocation> {
        let mut all: Vec<Invocation> = vec![];
        for block in self.blocks() {
            for (number, line) in (block.first..).zip(&block.lines) {
                match block.language {
                    "sh" if !line.is_empty() => all.push(Invocation::read(line, number)),
                    "console" => match line.strip_prefix("$ ") {
                        Some(command) => {
                            all.push(Invocation { shown: Some(vec![]), ..Invocation::read(command, number) });
                        }
                        None => {
                            let last = all.last_mut().and_then(|invocation| invocation.shown.as_mut());
                            last.expect("a command before its output").push((*line).to_owned());
                        }
                    },
                    _ => {}
                }
            }
        }
        all
    }
}

impl Invocation {
    fn read(line: &str, number: usize) -> Self {
        let mut words = words(line);
        let into = words.iter().position(|word| word == ">").map(|at| words.split_off(at)[1].clone());
        Self { line: number, words, into, shown: None }
    }
}

/// The words of a command as a shell splits them, without a comment; single quotes only.
pub fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quoted) = (vec![], None::<String>, false);
    for c in line.chars() {
        match c {
            '\'' => {
                quoted = !quoted;
                word.get_or_insert_default();
            }
            ' ' if !quoted => words.extend(word.take()),
            '#' if !quoted && word.is_none() => break,
            c => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    words
}

#[test]
fn a_page_is_read_with_its_commands_and_what_they_print() {
    let text = "# A, b\nSee [`x`](y.rs#z) and\n```sh\na 'b c' # d\ne > f\n```\n```console\n$ g\nh\n\ni\n$ j\n```\n";
    let page = Page { name: "p".into(), text: text.into() };
    let invocation = |line, words: &[&str], into: Option<&str>, shown: Option<&[&str]>| Invocation {
        line,
        words: words.iter().map(|word| (*word).to_owned()).collect(),
        into: into.map(str::to_owned),
        shown: shown.map(|lines| lines.iter().map(|line| (*line).to_owned()).collect()),
    };
    let expected = [
        invocation(3, &["a", "b c"], None, None),
        invocation(4, &["e"], Some("f"), None),
        invocation(7, &["g"], None, Some(&["h", "", "i"])),
        invocation(11, &["j"], None, Some(&[])),
    ];
    assert_eq!(page.invocations(), expected);
    assert_eq!(page.code(), ["x"]);
    assert_eq!(page.links(), [("`x`".to_owned(), "y.rs#z".to_owned())]);
    assert_eq!(page.anchors(), ["a-b"]);
}

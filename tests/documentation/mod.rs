//! The documentation keeps its word: every command of the README and the book is run, or checked against what it names;
//! what is shown is what is printed; links, files and flags exist.
//!
//! A page's commands run in their order in a folder with the repository's `models/` and `recordings/` and, but for pages
//! that begin with nothing, a data set and a model. `SHORTER` lists how long ones are shortened, `NOT_RUN` those that
//! are not run, with the reason. `LAPWING_DOCS=write` writes the present outputs into the pages.

mod outputs;
mod page;
mod rooms;

use std::{collections::BTreeSet, ffi::OsString, fs, path::Path, sync::Mutex, time::Instant};

use clap::{Command, CommandFactory, error::ErrorKind};
use lapwing::cli::Cli;
use lapwing_core::config::Settings;

use self::{
    page::{Invocation, Page, pages, words},
    rooms::{Outcome, Room},
};

/// Commands that are not run, and why. `lapwing`'s are parsed all the same.
const NOT_RUN: [(&str, &str); 17] = [
    ("lapwing brake record", "drives for hours"),
    ("lapwing brake train", "needs the data of brake record, and takes half an hour"),
    ("lapwing brake evaluate", "needs the data of brake record"),
    ("lapwing marl train", "takes minutes; a short one is in tests/marl.rs"),
    ("lapwing marl study", "takes hours; a short one is in tests/marl.rs"),
    (
        "lapwing model check net.onnx",
        "needs the reader's network, and ONNX Runtime; tests/interop/checks_models.py checks one",
    ),
    (
        "lapwing model rename weights.safetensors",
        "needs the reader's weights; tests/interop/checks_models.py renames some",
    ),
    ("lapwing model check net.safetensors", "needs what model rename makes of the reader's weights"),
    ("lapwing drive --model net.safetensors", "needs what model rename makes of the reader's weights"),
    ("lapwing train --recipe models/", "takes half an hour, and some recipes need the team's recordings"),
    ("lapwing record --page", "waits for a person to drive"),
    ("LAPWING_LANE_ROWS=300 cargo", "is a test, with more rows than CI has time for"),
    ("make", "builds, or runs the other tests; that the Makefile has the target is checked"),
    ("cargo", "builds; that the example, binary, benchmark or test exists is checked"),
    ("cargo run --release --example blind", "drives a hundred runs, for minutes; the example itself is checked"),
    ("LIBTORCH=/path/to/libtorch cargo", "names a libtorch of the reader's"),
    ("LIBTORCH_USE_PYTORCH=1 cargo", "needs a Python environment with torch"),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// All files of a folder with one of these extensions, as one text.
fn texts(folder: &str, extensions: &[&str]) -> String {
    let mut text = String::new();
    for path in fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            text += &texts(path.strip_prefix(root()).unwrap().to_str().unwrap(), extensions);
        } else if extensions.iter().any(|e| path.extension().is_some_and(|found| found == *e)) {
            text += &fs::read_to_string(path).unwrap();
        }
    }
    text
}

/// The reason for which a command is not run.
fn not_run(command: &str) -> Option<&'static str> {
    let begins = |(beginning, _): &&(&str, &str)| command.starts_with(beginning);
    NOT_RUN.iter().filter(begins).max_by_key(|(beginning, _)| beginning.len()).map(|(_, why)| *why)
}

/// Why the command line does not take these words; what a placeholder leaves out is forgiven.
fn refused(words: &[String]) -> Option<String> {
    let placeholders = [("VERB", "drive"), ("MPH", "20")];
    let meant = |word: &String| {
        placeholders.iter().find(|(name, _)| name == word).map_or(word.as_str(), |(_, value)| value).into()
    };
    let words: Vec<OsString> = words.iter().map(meant).collect();
    let error = Cli::read(words.into_iter()).err()?;
    let partial = [
        ErrorKind::DisplayHelp,
        ErrorKind::DisplayVersion,
        ErrorKind::MissingRequiredArgument,
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
    ];
    (!partial.contains(&error.kind())).then(|| error.to_string())
}

/// What a command that is not run names but is not there.
fn missing(words: &[String]) -> Option<String> {
    let words: Vec<&str> = words.iter().map(String::as_str).skip_while(|word| word.contains('=')).collect();
    let has = |text: &str, sought: String| (!text.contains(&sought)).then_some(sought);
    let after = |flag: &str| words.iter().position(|word| *word == flag).map(|at| words[at + 1]);
    match words[..] {
        ["taskset", "-c", _] => None,
        ["lapwing", ..] => refused(&words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>()),
        ["taskset", "-c", _, ..] => missing(&words[3..].iter().map(|word| (*word).to_owned()).collect::<Vec<_>>()),
        ["make", target] => has(&read("Makefile"), format!("\n{target}:")),
        ["cargo", "bench", "--", ref benches @ ..] => {
            let text = texts("benches", &["rs"]);
            let is_file = |bench: &str| root().join("benches").join(bench).with_extension("rs").is_file();
            let absent = |bench: &&&str| !text.contains(&format!("fn {bench}")) && !is_file(bench);
            benches.iter().find(absent).map(|bench| format!("benchmark {bench}"))
        }
        ["cargo", "test", "--release", "-p", _, "--lib", filter, ..] => {
            has(&texts("crates", &["rs"]), format!("fn {filter}"))
        }
        ["cargo", "test", "--release", filter, ..] => has(&texts("tests", &["rs"]), format!("mod {filter}")),
        ["cargo", "run", ..] if words.contains(&"--example") => {
            let name = after("--example").unwrap();
            let path = root().join("examples").join(name);
            (!path.is_dir() && !path.with_extension("rs").is_file()).then(|| name.to_owned())
        }
        ["cargo", "run", ..] if words.contains(&"--bin") => {
            has(&(read("tools/Cargo.toml") + &texts("tools", &["rs"])), after("--bin").unwrap().to_owned())
        }
        ["cargo", "build" | "install" | "test" | "bench", ..] => None,
        [script, ref flags @ ..] if script.ends_with(".py") => {
            let text = texts(Path::new(script).parent().unwrap().to_str().unwrap(), &["py"]);
            assert!(root().join(script).is_file(), "{script}");
            let names = flags.iter().filter(|flag| flag.starts_with("--") || script == "tests/interop/run.py");
            names.copied().find(|name| !text.contains(name)).map(str::to_owned)
        }
        _ => Some(words.join(" ")),
    }
}

/// Whether words in the text are a command, and of which kind.
fn is_command(words: &[String]) -> bool {
    words.first().is_some_and(|word| ["make", "cargo", "taskset"].contains(&word.as_str()) || word.ends_with(".py"))
        && words.len() > 1
}

#[test]
fn every_command_of_the_documentation_runs_and_prints_what_is_shown() {
    let pages = pages(root());
    let (queue, wrong) = (Mutex::new(pages.iter()), Mutex::new(vec![]));
    let work = || {
        while let Some(page) = { queue.lock().unwrap().next() } {
            let found = run(page);
            wrong.lock().unwrap().extend(found);
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(work);
        scope.spawn(work);
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Runs a page's commands; returns what is wrong.
fn run(page: &Page) -> Vec<String> {
    let (room, mut wrong, mut printed) = (Room::of(page), vec![], vec![]);
    for invocation in page.invocations() {
        let command = invocation.words.join(" ");
        let at = format!("{}:{}: {command}", page.name, invocation.line + 1);
        if not_run(&command).is_some() {
            let nothing =
                if invocation.words[0] == "lapwing" { refused(&invocation.words) } else { missing(&invocation.words) };
            wrong.extend(nothing.map(|what| format!("{at}: there is no {what}")));
            continue;
        }
        assert_eq!(invocation.words[0], "lapwing", "{at}: is neither run nor in NOT_RUN");
        let begun = Instant::now();
        let Outcome { status, out, err } = room.run(&invocation);
        println!("{:.1} s: {at}", begun.elapsed().as_secs_f64());
        let judged = ["--min-", "--max-c", "--max-o", "--max-m", "--against"].iter().any(|flag| command.contains(flag));
        if status != 0 && !(status == 3 && judged) {
            wrong.push(format!("{at}: exit status {status}\n{out}{err}"));
        }
        if let Some(shown) = &invocation.shown {
            let got: Vec<_> = out.trim_end().lines().map(str::to_owned).collect();
            if let Some(difference) = outputs::difference(shown, &got, outputs::steady(&invocation.words)) {
                wrong.push(format!("{at}: {difference}"));
                printed.push((invocation, got));
            }
        }
    }
    if std::env::var_os("LAPWING_DOCS").is_some_and(|value| value == "write") {
        write(page, printed);
        return vec![];
    }
    wrong
}

/// Puts what was printed in the place of what the page shows, where they differ.
fn write(page: &Page, printed: Vec<(Invocation, Vec<String>)>) {
    let mut lines: Vec<String> = page.text.lines().map(str::to_owned).collect();
    for (invocation, got) in printed.into_iter().rev() {
        let first = invocation.line + 1;
        lines.splice(first..first + invocation.shown.map_or(0, |shown| shown.len()), got);
    }
    fs::write(root().join(&page.name), lines.join("\n") + "\n").unwrap();
}

#[test]
fn the_archive_of_a_release_holds_what_the_commands_of_its_documentation_name() {
    let archive = read("scripts/dist.py");
    let pages = pages(root());
    let words = pages.iter().flat_map(Page::invocations).flat_map(|invocation| invocation.words);
    let ours = words.filter(|word| word.starts_with("models/") && root().join(word).is_file());
    let left_out: BTreeSet<_> = ours.filter(|file| !archive.contains(&format!("\"{file}\""))).collect();
    assert!(left_out.is_empty(), "scripts/dist.py packs no {left_out:?}");
}

#[test]
fn every_reason_not_to_run_a_command_is_still_needed() {
    let pages = pages(root());
    let commands: Vec<_> = pages.iter().flat_map(Page::invocations).map(|i| i.words.join(" ")).collect();
    let used: BTreeSet<_> = commands.iter().filter_map(|command| not_run(command)).collect();
    let unused: Vec<_> = NOT_RUN.iter().filter(|(_, why)| !used.contains(why)).collect();
    assert!(unused.is_empty(), "{unused:?}");
}

#[test]
fn commands_flags_and_files_in_the_text_exist() {
    let mut wrong = vec![];
    let mut flags = BTreeSet::new();
    let mut verbs = vec![Cli::command()];
    while let Some(verb) = verbs.pop() {
        flags.extend(verb.get_arguments().filter_map(|a| a.get_long().map(|long| format!("--{long}"))));
        verbs.extend(verb.get_subcommands().map(Command::clone));
    }
    let scripts = ["benches", "tests/interop", "examples"].map(|folder| texts(folder, &["py", "rs"])).concat();
    for page in pages(root()) {
        for code in page.code() {
            let words = words(&code);
            let nothing = match words.first().map(String::as_str) {
                Some("lapwing") => refused(&words),
                Some(flag) if flag.starts_with("--") => {
                    let flag = flag.split('=').next().unwrap();
                    (!flags.contains(flag) && !scripts.contains(flag)).then(|| flag.to_owned())
                }
                Some(path) if is_path(path) && words.len() == 1 => {
                    (!root().join(path).exists()).then(|| path.to_owned())
                }
                _ if is_command(&words) => missing(&words),
                _ => None,
            };
            wrong.extend(nothing.map(|what| format!("{}: `{code}`: there is no {what}", page.name)));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Whether this names a file of the repository; what only work makes, and placeholders, do not.
fn is_path(text: &str) -> bool {
    let folders =
        ["benches", "crates", "docs", "examples", "fuzz", "models", "recordings", "scripts", "src", "tests", "tools"];
    let made = ["fuzz/artifacts/", "recordings/DATE-TIME.mcap"];
    text.split_once('/').is_some_and(|(folder, _)| folders.contains(&folder))
        && !made.contains(&text)
        && !text.contains('*')
}

#[test]
fn every_link_leads_somewhere_and_every_page_is_one_click_from_the_readme() {
    let (pages, mut wrong, mut reached) = (pages(root()), vec![], BTreeSet::new());
    for page in &pages {
        let folder = root().join(&page.name).parent().unwrap().to_owned();
        for (text, target) in page.links().into_iter().filter(|(_, target)| !target.starts_with("https://")) {
            let (file, anchor) = target.split_once('#').map_or((target.as_str(), None), |(f, a)| (f, Some(a)));
            let path = if file.is_empty() { root().join(&page.name) } else { folder.join(file) };
            let Ok(path) = path.canonicalize() else {
                wrong.push(format!("{}: there is no {target}", page.name));
                continue;
            };
            let path = path.strip_prefix(root().canonicalize().unwrap()).unwrap().to_str().unwrap().to_owned();
            if let Some(anchor) = anchor {
                let there = pages
                    .iter()
                    .find(|page| page.name == path)
                    .is_some_and(|p| p.anchors().iter().any(|a| a == anchor));
                wrong.extend((!there).then(|| format!("{}: there is no {target}", page.name)));
            }
            // `name` linked to a source must stand in it.
            if let (Some(name), true) =
                (text.strip_prefix('`').and_then(|t| t.strip_suffix('`')), path.ends_with(".rs"))
            {
                let absent = !name.contains('/') && !read(&path).contains(name);
                wrong.extend(absent.then(|| format!("{}: {path} has no {name}", page.name)));
            }
            if page.name == "README.md" {
                reached.insert(path);
            }
        }
    }
    wrong.extend(
        pages
            .iter()
            .filter(|p| !reached.contains(&p.name) && p.name != "README.md")
            .map(|p| format!("README.md does not link to {}", p.name)),
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_readme_shows_what_make_drive_runs() {
    let makefile = read("Makefile");
    let (_, recipe) = makefile.split_once("\ndrive: build\n").expect("the target drive");
    let recipe =
        recipe.lines().take_while(|line| line.starts_with('\t')).map(|line| line.trim().replace("target/release/", ""));
    let shown = Page { name: "README.md".into(), text: read("README.md") };
    let shown = shown.invocations().into_iter().filter(|i| i.shown.is_some()).map(|i| i.words.join(" "));
    // What else the page shows comes later.
    let recipe: Vec<_> = recipe.collect();
    assert_eq!(recipe, shown.take(recipe.len()).collect::<Vec<_>>());
}

#[test]
fn the_settings_page_lists_all_settings_with_their_defaults() {
    let page = Page { name: "settings".into(), text: read("docs/reference/settings.md") };
    let blocks = page.blocks();
    let block = blocks.iter().find(|block| block.language == "toml").unwrap().lines.join("\n");
    let listed: Settings = toml::from_str(&block).unwrap();
    assert_eq!(listed, Settings::default());
    let all = toml::to_string(&Settings::default()).unwrap();
    let keys = all.lines().filter_map(|line| line.split_once(" = ").map(|(key, _)| key));
    let unlisted: Vec<_> = keys.filter(|key| !block.contains(&format!("{key} = "))).collect();
    assert!(unlisted.is_empty(), "{unlisted:?}");
}

//! Runs as files: written, killed, cut, damaged, rewritten and read.

use std::{
    collections::BTreeMap,
    env, fs,
    io::{BufRead, BufReader, Cursor},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::OnceLock,
    thread,
    time::{Duration, Instant},
};

use lapwing_core::{
    pilot::PurePursuit,
    protocol::{CameraImage, Dialect, Telemetry},
    recording::{
        Break, By, CommandRecord, Entry, EventRecord, Item, ModelId, Recorder, RecorderOptions, Recording, RunHeader,
        RunKind, RunReader, Step,
    },
    units::{Steering, Throttle},
};
use mcap::{Compression, WriteOptions, read::MessageStream, records::Metadata};

fn header() -> RunHeader {
    RunHeader {
        kind: RunKind::Driven,
        name_hint: Some("lake".into()),
        dialect: Some(Dialect::Term1),
        decimal_separator: None,
        model: Some(ModelId { name: "pilotnet-lake".into(), sha256: "ab".repeat(32) }),
        seed: Some(7),
        config: serde_json::json!({"control": {"speed_mph": 15.0}}),
        lapwing: "0.1.0".into(),
        started: "2026-11-21T08:15:30.123456789Z".parse().unwrap(),
    }
}

fn telemetry(i: u32) -> Telemetry {
    let text = format!(
        r#"{{"steering_deg":-1.25,"throttle":0.3,"speed_mph":{i}.5,"truth":{{"lap":{i},"position_m":[1.0,2.0,-3.5]}}}}"#
    );
    serde_json::from_str(&text).unwrap()
}

fn jpeg(i: u32) -> Vec<u8> {
    [b"\xff\xd8".as_slice(), &i.to_le_bytes(), &[0x55; 40]].concat()
}

fn command(i: u32) -> CommandRecord {
    CommandRecord {
        by: By::Pilot,
        steering: Steering::new(-0.25).unwrap(),
        throttle: Throttle::new(0.5).unwrap(),
        prediction: Some(-0.2625),
        p: Some(0.75),
        i: None,
        saturated: false,
        brake_due: Some(0.125),
        ahead_ns: Some(140_000_000),
        guard_ns: None,
        decode_ns: 1_000_000,
        preprocess_ns: 200_000,
        forward_ns: u64::from(i),
        driver_ns: 3,
        latency_ns: Some(4),
    }
}

/// The items of step `i`, 66 ms after the one before.
fn step(i: u32) -> Vec<(Duration, Item)> {
    let at = Duration::from_millis(66) * i;
    let later = at + Duration::from_millis(3);
    let mut items = vec![
        (at, Item::Telemetry(telemetry(i))),
        (at, Item::Frame(jpeg(i).into())),
        (later, Item::Command(command(i))),
    ];
    if i % 4 == 3 {
        items.push((later, Item::Event(EventRecord::Note { text: format!("step {i}") })));
    }
    items
}

type Items = Vec<(Duration, Item)>;

/// A run of twelve steps in four chunks, and what is in it. Made once, as chunks take their time.
fn short_run() -> &'static (Vec<u8>, Items) {
    static RUN: OnceLock<(Vec<u8>, Items)> = OnceLock::new();
    RUN.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let recorder = Recorder::create(dir.path(), header(), RecorderOptions::default()).unwrap();
        let mut items = Vec::new();
        for i in 0..12 {
            for (at, item) in step(i) {
                recorder.record(at, item.clone());
                items.push((at, item));
            }
            if i % 3 == 2 {
                let due = Instant::now() + Duration::from_secs(20);
                while recorder.status().items_written < items.len() as u64 {
                    assert!(Instant::now() < due, "no chunk was written");
                    thread::sleep(Duration::from_millis(5));
                }
            }
        }
        let report = recorder.finish();
        assert!(report.error.is_none());
        assert_eq!((report.telemetries, report.frames, report.frames_not_recorded), (12, 12, 0));
        (fs::read(report.path).unwrap(), items)
    })
}

/// All items of a file that are read without an error, and whether the file ends in good order.
fn read(path: &Path) -> Option<(Items, bool)> {
    let mut run = RunReader::open(path).ok()?;
    let items = run.by_ref().filter_map(Result::ok).collect();
    let whole = run.truncated().is_none();
    Some((items, whole))
}

fn on_disk(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("run.mcap");
    fs::write(&path, bytes).unwrap();
    (dir, path)
}

#[test]
fn what_is_recorded_reads_back() {
    let (bytes, items) = short_run();
    let (_dir, path) = on_disk(bytes);
    assert_eq!(*RunReader::open(&path).unwrap().header(), header());
    assert_eq!(read(&path).unwrap(), (items.clone(), true));
}

#[test]
fn a_run_cut_off_at_any_byte_reads_up_to_its_last_whole_chunk() {
    let (bytes, items) = short_run();
    let (_dir, path) = on_disk(bytes);
    let file = fs::File::options().write(true).open(&path).unwrap();
    let (mut last, mut lengths) = (items.len(), std::collections::BTreeSet::new());
    for length in (0..bytes.len()).rev() {
        file.set_len(length as u64).unwrap();
        let Some((read, whole)) = read(&path) else {
            assert!(length < 2000, "{length} bytes are enough for the header");
            last = 0;
            continue;
        };
        assert!(!whole, "{length}");
        assert!(read.len() <= last, "{length}");
        assert_eq!(read[..], items[..read.len()], "{length}");
        last = read.len();
        lengths.insert(last);
    }
    assert_eq!(lengths.into_iter().collect::<Vec<_>>(), [0, 9, 19, 29, 39]);
}

#[test]
fn the_reader_says_where_and_how_a_file_ends_too_early() {
    let (bytes, _) = short_run();
    let (_dir, path) = on_disk(&bytes[..bytes.len() - 3]);
    let mut run = RunReader::open(&path).unwrap();
    assert_eq!(run.by_ref().count(), 39);
    let truncation = run.truncated().unwrap();
    assert_eq!(truncation.why, "expected the end mark, got the file's end");
    assert_eq!(truncation.at + truncation.unread, bytes.len() as u64 - 3);

    let (_dir, path) = on_disk(&[bytes, b"more".as_slice()].concat());
    let mut run = RunReader::open(&path).unwrap();
    assert_eq!(run.by_ref().count(), 39);
    assert_eq!(run.truncated().unwrap().why, "expected the file's end, got 4 more bytes");

    // What file systems leave of a file that grew when the machine went down.
    let (_dir, path) = on_disk(&[&bytes[..bytes.len() - 3], &[0; 5000]].concat());
    assert_eq!(read(&path).unwrap().0.len(), 39);
}

#[test]
fn a_run_that_is_deleted_while_it_is_recorded_is_not_recorded_whole() {
    for delete in [false, true] {
        let dir = tempfile::tempdir().unwrap();
        let recorder = Recorder::create(dir.path(), header(), RecorderOptions::default()).unwrap();
        recorder.record(Duration::ZERO, Item::Telemetry(telemetry(1)));
        if delete {
            fs::remove_file(recorder.path()).unwrap();
        }
        let error = recorder.finish().error.map(|error| error.to_string());
        let told =
            error.as_ref().is_some_and(|error| error.contains("it was deleted or moved away while it was recorded"));
        assert_eq!(told, delete, "{error:?}");
    }
}

/// Where the chunks of a run begin and end.
fn chunks_of(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
    let (mut at, mut chunks) = (mcap::MAGIC.len(), vec![]);
    while bytes[at] != mcap::records::op::DATA_END {
        let end = at + 9 + u64::from_le_bytes(*bytes[at + 1..].first_chunk().unwrap()) as usize;
        if bytes[at] == mcap::records::op::CHUNK {
            chunks.push(at..end);
        }
        at = end;
    }
    chunks
}

#[test]
fn of_a_run_with_damaged_chunks_the_others_are_read() {
    let (bytes, items) = short_run();
    let chunks = chunks_of(bytes);
    assert_eq!(chunks.len(), 4);
    let lengths = [9, 10, 10, 10];
    for damaged in [vec![0], vec![1], vec![3], vec![0, 2], vec![1, 2], vec![0, 1, 2, 3]] {
        let (mut bytes, mut expected, mut left) = (bytes.clone(), vec![], items.as_slice());
        for (i, chunk) in chunks.iter().enumerate() {
            let (inside, rest) = left.split_at(lengths[i]);
            left = rest;
            if damaged.contains(&i) {
                bytes[(chunk.start + chunk.end) / 2] ^= 1;
            } else {
                expected.extend_from_slice(inside);
            }
        }
        let (_dir, path) = on_disk(&bytes);
        let mut run = RunReader::open(&path).unwrap();
        assert_eq!(run.by_ref().map(Result::unwrap).collect::<Vec<_>>(), expected, "{damaged:?}");
        let truncation = run.truncated().unwrap();
        assert!(truncation.why.contains("checksum"), "{truncation}");
        let unread: usize = damaged.iter().map(|i| chunks[*i].len()).sum();
        assert_eq!((truncation.at, truncation.unread), (chunks[damaged[0]].start as u64, unread as u64));

        // Each moment is joined as it was, though another chunk's answer may come next.
        let moments = Recording::open(&path).unwrap().map(Result::unwrap).collect::<Vec<_>>();
        for moment in &moments {
            let is_its = |(at, item): &&(_, _)| *at >= moment.at && matches!(item, Item::Command(_));
            let Some((_, Item::Command(answer))) = items.iter().find(is_its) else { panic!("all are answered") };
            assert!(moment.command.as_ref().is_none_or(|command| command == answer), "{damaged:?} {:?}", moment.at);
        }
        let breaks = moments.iter().filter(|moment| matches!(moment.broken, Some(Break::Gap(_)))).count();
        let inside = damaged.iter().filter(|i| !damaged.contains(&(**i + 1)) && **i > 0 && **i < 3).count();
        assert_eq!(breaks, inside, "{damaged:?}");
    }
}

#[test]
fn where_no_channel_is_known_nothing_is_made_of_what_follows() {
    let (bytes, _) = short_run();
    let first = chunks_of(bytes).remove(0);
    let mut bytes = bytes[..bytes.len() - 3].to_vec(); // so that there is no summary to look them up in
    bytes[(first.start + first.end) / 2] ^= 1;
    let (_dir, path) = on_disk(&bytes);
    let mut run = RunReader::open(&path).unwrap();
    assert_eq!(run.by_ref().count(), 0);
    let truncation = run.truncated().unwrap();
    assert_eq!(truncation.at + truncation.unread, bytes.len() as u64);
    assert!(truncation.why.contains("checksum"), "{truncation}");
}

/// The run as another tool would write it: other chunks, its own channel, our metadata last.
fn rewritten(options: WriteOptions) -> Vec<u8> {
    let (bytes, _) = short_run();
    let mut out = options.chunk_size(Some(500)).create(Cursor::new(Vec::new())).unwrap();
    let foreign = out.add_channel_with_id(900, 0, "/tf", "json", &BTreeMap::new()).unwrap();
    for message in MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: foreign,
            sequence: 0,
            log_time: message.log_time,
            publish_time: 0,
        };
        out.write_to_known_channel(&header, b"{}").unwrap();
        out.write(&message).unwrap();
    }
    for record in mcap::read::LinearReader::new(bytes).unwrap() {
        if let mcap::records::Record::Metadata(Metadata { name, metadata }) = record.unwrap() {
            out.write_metadata(&Metadata { name, metadata }).unwrap();
        }
    }
    out.finish().unwrap();
    out.into_inner().into_inner()
}

pub fn rewritings() -> Vec<Vec<u8>> {
    let options = || WriteOptions::new().compression(None);
    vec![
        rewritten(options()),
        rewritten(options().compression(Some(Compression::Zstd))),
        rewritten(options().compression(Some(Compression::Lz4))),
        rewritten(options().use_chunks(false)),
        rewritten(options().calculate_chunk_crcs(false)),
    ]
}

#[test]
fn files_rewritten_by_other_tools_read_the_same() {
    for bytes in rewritings() {
        let (_dir, path) = on_disk(&bytes);
        assert_eq!(read(&path).unwrap(), (short_run().1.clone(), true));
    }
}

#[test]
fn damaged_files_never_panic_and_what_is_lost_is_told() {
    // Marsaglia's xorshift: any numbers will do, the same every time.
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let mut files = rewritings();
    files.push(short_run().0.clone());
    let (_dir, path) = on_disk(&[]);
    for (kind, original) in files.iter().enumerate() {
        for _ in 0..400 {
            let mut bytes = original.clone();
            for _ in 0..=random(3) {
                let at = random(bytes.len());
                // Lengths that lie are the worst: many bits set as often as any. (Zeros would at
                // times hit just a chunk's checksum, which then means that it has none.)
                let lie = [0xff, 0x7f, 1, random(256) as u8][random(4)];
                let until = (at + 1 + random(8)).min(bytes.len());
                bytes[at..until].fill(lie);
            }
            fs::write(&path, &bytes).unwrap();
            let read = read(&path);
            // Only the recorder's own file has checksums for all messages, though none for the start time.
            if kind == files.len() - 1
                && let Some((items, whole)) = read
            {
                let mut all = short_run().1.iter();
                assert!(items.iter().all(|(_, item)| all.any(|(_, original)| original == item)));
                assert!(!whole || items.len() == short_run().1.len());
            }
        }
    }
}

#[test]
fn what_is_no_run_is_refused_in_words() {
    let dir = tempfile::tempdir().unwrap();
    let error = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        RunReader::open(&path).unwrap_err().to_string()
    };
    assert!(error("empty", b"").ends_with(
        "expected a run (an MCAP file), got an empty file: the disk was full, or whatever made it ended too early"
    ));
    assert!(
        error("log.csv", b"c.jpg,l.jpg").ends_with("got comma-separated text; a driving log is a data set, not a run")
    );
    assert!(error("zeros", &[0; 100]).contains("got zeros"));
    assert!(error("jpeg", b"\xff\xd8\xff\xe0").ends_with("got another kind of file"));
    assert!(error("start", &mcap::MAGIC[..5]).contains("its first bytes only"));
    let foreign = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let bytes = {
        let mut f = foreign;
        f.finish().unwrap();
        f.into_inner().into_inner()
    };
    assert!(
        error("foreign", &bytes)
            .ends_with("expected the metadata record lapwing.run, got none: another program made this file")
    );
    let folder = RunReader::open(dir.path()).unwrap_err().to_string();
    assert!(folder.contains("got a folder"), "{folder}");
    let absent = RunReader::open(dir.path().join("absent")).unwrap_err().to_string();
    assert!(absent.starts_with("cannot read "), "{absent}");
}

#[test]
fn a_message_that_does_not_parse_is_named_and_the_next_one_read() {
    let mut out = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let fields =
        [("format_version", "1"), ("lapwing", "0.1.0"), ("started", "1970-01-01T00:00:00Z"), ("config", "null")];
    let metadata = fields.map(|(k, v)| (k.to_owned(), v.to_owned())).into();
    out.write_metadata(&Metadata { name: "lapwing.run".into(), metadata }).unwrap();
    let channel_id = out.add_channel(0, "/event", "json", &BTreeMap::new()).unwrap();
    for (sequence, text) in [r#"{"kind":"party"}"#, r#"{"kind":"kick"}"#].iter().enumerate() {
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence: sequence as u32,
            log_time: 1_500_000_000,
            publish_time: 0,
        };
        out.write_to_known_channel(&header, text.as_bytes()).unwrap();
    }
    out.finish().unwrap();
    let (_dir, path) = on_disk(&out.into_inner().into_inner());
    let mut run = RunReader::open(&path).unwrap();
    let error = run.next().unwrap().unwrap_err().to_string();
    assert!(error.contains("run.mcap: /event at 1.500 s: unknown variant `party`, expected one of"), "{error}");
    assert_eq!(run.next().unwrap().unwrap(), (Duration::from_millis(1500), Item::Event(EventRecord::Kick)));
    assert!(run.next().is_none());
}

#[test]
fn items_are_joined_into_steps_with_events_between_them() {
    let dir = tempfile::tempdir().unwrap();
    let recorder = Recorder::create(dir.path(), header(), RecorderOptions::default()).unwrap();
    let ms = Duration::from_millis;
    let event = |text: &str| EventRecord::Note { text: text.into() };
    for (at, item) in [
        (0, Item::Event(event("before"))),
        (10, Item::Telemetry(telemetry(1))),
        (10, Item::Frame(jpeg(1).into())),
        (11, Item::Event(event("while it thinks"))),
        (12, Item::Command(command(1))),
        // No frame, no answer: a person drives, and the disk is slow.
        (20, Item::Telemetry(telemetry(2))),
        // A tool that sorts by time may put the frame first.
        (30, Item::Frame(jpeg(3).into())),
        (30, Item::Telemetry(telemetry(3))),
        (33, Item::Command(command(3))),
        (40, Item::Event(event("after"))),
    ] {
        recorder.record(ms(at), item);
    }
    let mut moments = RunReader::open(recorder.finish().path).unwrap().entries();
    let step = |at, i: u32, picture: bool, answered: bool| {
        let mut telemetry = telemetry(i);
        if picture {
            telemetry.image = CameraImage::Jpeg(jpeg(i).into());
        }
        Entry::Step(Step { at: ms(at), telemetry, frame_recorded: picture, command: answered.then(|| command(i)) })
    };
    let note = |at, text: &str| Entry::Event { at: ms(at), event: event(text) };
    assert_eq!(
        moments.by_ref().map(Result::unwrap).collect::<Vec<_>>(),
        [
            note(0, "before"),
            step(10, 1, true, true),
            note(11, "while it thinks"),
            step(20, 2, false, false),
            step(30, 3, true, true),
            note(40, "after"),
        ]
    );
    assert_eq!((moments.without_frame(), moments.unanswered()), (1, 1));
    assert!(moments.truncated().is_none());
}

#[test]
fn a_recording_says_where_it_is_broken_and_why() {
    let dir = tempfile::tempdir().unwrap();
    let recorder = Recorder::create(dir.path(), header(), RecorderOptions::default()).unwrap();
    let ms = Duration::from_millis;
    let seen = |at: u64, i: u32, by: By| {
        let command = CommandRecord { by, ..command(i) };
        [Item::Telemetry(telemetry(i)), Item::Frame(jpeg(i).into()), Item::Command(command)].map(|item| (at, item))
    };
    let event = |at, event| [(at, Item::Event(event))];
    let items = [
        &seen(0, 0, By::Pilot)[..],
        &seen(1000, 1, By::Pilot), // a second is no gap yet
        &seen(2001, 2, By::Human),
        &event(2010, EventRecord::Reset { waypoint: 0 }),
        &seen(2070, 3, By::Safe),
        &event(2080, EventRecord::TakeoverBegan),
        &seen(9000, 4, By::Off),
        &[(9066, Item::Telemetry(telemetry(5)))], // its picture is not recorded, and nobody answers
        &seen(9132, 6, By::Pilot),
        &event(9140, EventRecord::Break { seconds: Some(-3.5) }),
        &seen(9198, 7, By::Pilot),
        &event(9200, EventRecord::RunEnded { why: "the end".into() }),
    ];
    for (at, item) in items.into_iter().flatten() {
        recorder.record(ms(*at), item.clone());
    }
    let path = recorder.finish().path;
    let mut recording = Recording::open(&path).unwrap();
    assert_eq!((recording.left(), recording.log().is_none()), (Some(8), true));
    let moments: Vec<_> = recording.by_ref().map(Result::unwrap).collect();
    let breaks: Vec<_> = moments.iter().map(|moment| moment.broken).collect();
    let expected = [
        None,
        None,
        Some(Break::Gap(ms(1001))),
        Some(Break::PutBack),
        Some(Break::TakenOver),
        None,
        Some(Break::Unseen(1)),
        Some(Break::Back(ms(3500))),
    ];
    assert_eq!(breaks, expected);
    let steered: Vec<_> = moments.iter().map(|moment| moment.steering().is_some()).collect();
    assert_eq!(steered, [true, true, true, false, false, false, true, true], "a pilot or a human steers");
    let rows: Vec<_> = moments.iter().map(|moment| (moment.row, moment.is_seen())).collect();
    assert_eq!((rows[0], rows[5], rows[7]), ((0, true), (5, false), (7, true)));
    assert_eq!(moments[4].before, [(ms(2080), EventRecord::TakeoverBegan)]);
    assert_eq!(recording.events_after(), [(ms(9200), EventRecord::RunEnded { why: "the end".into() })]);
    assert_eq!((recording.left(), recording.truncated()), (Some(0), None));
    // A replay numbers frames as the recording does; a human's driving has the number of what comes after it.
    let answers = crate::replay::answered_by(&path, Box::new(PurePursuit::default())).0;
    let numbers: Vec<_> = answers.answers().iter().map(|answered| answered.frame).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 4, 4, 6, 7]);
}

/// In the environment of the process that is to be killed: where it records to.
const VICTIM: &str = "LAPWING_TEST_RECORD_UNTIL_KILLED";

#[test]
fn at_most_one_second_is_lost_when_the_process_is_killed() {
    if let Some(dir) = env::var_os(VICTIM) {
        record_until_killed(Path::new(&dir));
    }
    let dir = tempfile::tempdir().unwrap();
    // The victim is this very test in another process.
    let mut victim = Command::new(env::current_exe().unwrap())
        .args(["--exact", "recording::at_most_one_second_is_lost_when_the_process_is_killed", "--nocapture"])
        .env(VICTIM, dir.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(victim.stdout.take().unwrap()).lines().map_while(Result::ok);
    let mut recorded = Vec::new();
    while recorded.last().is_none_or(|at| *at < Duration::from_millis(2500)) {
        let line = lines.next().expect("the victim records until it is killed");
        recorded.extend(line.strip_prefix("recorded ").map(|ns| Duration::from_nanos(ns.parse().unwrap())));
    }
    victim.kill().unwrap(); // SIGKILL on Unix
    victim.wait().unwrap();
    recorded.extend(lines.filter_map(|l| Some(Duration::from_nanos(l.strip_prefix("recorded ")?.parse().ok()?))));

    let path = fs::read_dir(dir.path()).unwrap().next().unwrap().unwrap().path();
    let mut run = RunReader::open(path).unwrap();
    let read: Vec<Duration> = run
        .by_ref()
        .map(Result::unwrap)
        .filter_map(|(at, item)| matches!(item, Item::Frame(_)).then_some(at))
        .collect();
    assert!(run.truncated().is_some());
    assert_eq!(read[..], recorded[..read.len()]);
    let lost = recorded.last().unwrap().saturating_sub(*read.last().unwrap());
    assert!(lost <= Duration::from_secs(1), "{lost:?} are lost");
}

fn record_until_killed(dir: &Path) -> ! {
    let recorder = Recorder::create(dir, header(), RecorderOptions::default()).unwrap();
    let start = Instant::now();
    for i in 0.. {
        let at = start.elapsed();
        recorder.record(at, Item::Telemetry(telemetry(i)));
        recorder.record(at, Item::Frame(vec![0; 15_000].into()));
        recorder.record(at, Item::Command(command(i)));
        println!("recorded {}", at.as_nanos());
        thread::sleep(Duration::from_millis(66));
        assert!(start.elapsed() < Duration::from_secs(60), "nobody killed this process");
    }
    unreachable!()
}

/// A run of a header and these chunks.
fn with_chunks(chunks: &[Vec<u8>]) -> Vec<u8> {
    let mut out = WriteOptions::new().use_chunks(false).create(Cursor::new(Vec::new())).unwrap();
    let fields =
        [("format_version", "1"), ("lapwing", "0.1.0"), ("started", "1970-01-01T00:00:00Z"), ("config", "null")];
    let metadata = fields.map(|(k, v)| (k.to_owned(), v.to_owned())).into();
    out.write_metadata(&Metadata { name: "lapwing.run".into(), metadata }).unwrap();
    out.finish().unwrap();
    let whole = out.into_inner().into_inner();
    // Before the record that ends the data.
    let mut at = mcap::MAGIC.len();
    while whole[at] != mcap::records::op::DATA_END {
        at += 9 + u64::from_le_bytes(*whole[at + 1..].first_chunk().unwrap()) as usize;
    }
    [&whole[..at], &chunks.concat(), &whole[at..]].concat()
}

/// A chunk: how its records are packed, the outcome, and what it says of them.
fn chunk(compression: &str, packed: &[u8], says: u64, checksum: u32) -> Vec<u8> {
    let body = [
        &[0; 16][..],
        &says.to_le_bytes(),
        &checksum.to_le_bytes(),
        &(compression.len() as u32).to_le_bytes(),
        compression.as_bytes(),
        &(packed.len() as u64).to_le_bytes(),
        packed,
    ]
    .concat();
    [&[mcap::records::op::CHUNK][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

fn with_chunk(compression: &str, packed: &[u8], says: u64, checksum: u32) -> Vec<u8> {
    with_chunks(&[chunk(compression, packed, says, checksum)])
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    zstd::encode_all(bytes, 3).unwrap()
}

fn lz4(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
    std::io::Write::write_all(&mut encoder, bytes).unwrap();
    let (packed, result) = encoder.finish();
    result.unwrap();
    packed
}

/// So many bytes of a record that means nothing to a run.
fn foreign_record(length: usize) -> Vec<u8> {
    let mut record = vec![0; length];
    record[0] = 0x80;
    record[1..9].copy_from_slice(&(length as u64 - 9).to_le_bytes());
    record
}

/// Why a file is read no further, and how long that took to find out.
fn why(bytes: &[u8]) -> (String, Duration) {
    let (_dir, path) = on_disk(bytes);
    let began = Instant::now();
    let mut run = RunReader::open(&path).unwrap();
    assert_eq!(run.by_ref().count(), 0);
    let why = run.truncated().map(|truncation| truncation.why.clone()).unwrap_or_default();
    (why, began.elapsed())
}

#[test]
fn a_chunk_that_is_as_long_as_it_says_is_read_however_it_is_packed() {
    let records = foreign_record(1000);
    for (compression, packed) in [("", records.clone()), ("zstd", zstd(&records)), ("lz4", lz4(&records))] {
        assert_eq!(why(&with_chunk(compression, &packed, 1000, 0)).0, "", "{compression}");
        let wrong = why(&with_chunk(compression, &packed, 1000, 7)).0;
        assert!(wrong.starts_with("expected a chunk with the checksum 00000007, got "), "{compression}: {wrong}");
    }
    let other = why(&with_chunk("brotli", &records, 1000, 0)).0;
    assert_eq!(other, r#"expected a chunk compressed with lz4 or zstd, or uncompressed, got "brotli""#);
}

#[test]
fn a_chunk_that_holds_more_or_less_than_it_says_is_refused() {
    // A gigabyte in some ten or hundred kilobytes.
    let gigabyte = {
        let mut encoder = zstd::Encoder::new(Vec::new(), 1).unwrap();
        std::io::copy(&mut std::io::Read::take(std::io::repeat(0), 1 << 30), &mut encoder).unwrap();
        encoder.finish().unwrap()
    };
    assert!(gigabyte.len() < 200_000, "{}", gigabyte.len());
    for says in [0, 100, 1000] {
        let (why, took) = why(&with_chunk("zstd", &gigabyte, says, 0));
        assert_eq!(why, format!("expected a chunk of {says} bytes unpacked, as it says, got {} or more", says + 1));
        assert!(took < Duration::from_secs(1), "{took:?}");
    }
    for (compression, packed) in
        [("", foreign_record(100)), ("zstd", zstd(&foreign_record(100))), ("lz4", lz4(&foreign_record(100)))]
    {
        for says in [99, 101] {
            let why = why(&with_chunk(compression, &packed, says, 0)).0;
            let expected = format!("expected a chunk of {says} bytes unpacked, as it says, got 100");
            assert!(why.starts_with(&expected), "{compression}: {why}");
        }
    }
    let too_large = why(&with_chunk("zstd", &gigabyte, 1 << 30, 0)).0;
    assert_eq!(too_large, "expected a chunk that unpacks to 67108864 bytes at most, got 1073741824");
    let absurd = why(&with_chunk("lz4", b"", u64::MAX, 0)).0;
    assert!(absurd.contains("at most, got 18446744073709551615"), "{absurd}");
}

#[test]
fn a_chunk_of_nothing_or_of_pieces_is_refused_however_it_is_packed() {
    let piece = [&foreign_record(50)[..], &foreign_record(50)[..49]].concat();
    for records in [vec![0; 900], piece] {
        for (compression, packed) in [("", records.clone()), ("zstd", zstd(&records)), ("lz4", lz4(&records))] {
            let why = why(&with_chunk(compression, &packed, records.len() as u64, 0)).0;
            assert_eq!(why, "expected whole records in a chunk, got an incomplete one", "{compression}");
        }
    }
}

#[test]
fn a_small_file_of_many_large_chunks_is_read_for_a_moment_only() {
    // Each of them is what it says: 60 MB of one record in some kilobytes, 200 times.
    let packed = zstd(&foreign_record(60_000_000));
    let bytes = with_chunks(&vec![chunk("zstd", &packed, 60_000_000, 0); 200]);
    let (why, took) = why(&bytes);
    assert_eq!(why, "expected chunks that unpack to 67108864 bytes and 64 times the file's length at most, got more");
    assert!(took < Duration::from_secs(3), "{took:?} for {} bytes", bytes.len());
}

#[test]
fn messages_beyond_any_telemetry_or_picture_are_named_and_the_next_one_read() {
    let mut out = WriteOptions::new().compression(Some(Compression::Zstd)).create(Cursor::new(Vec::new())).unwrap();
    let fields =
        [("format_version", "1"), ("lapwing", "0.1.0"), ("started", "1970-01-01T00:00:00Z"), ("config", "null")];
    let metadata = fields.map(|(k, v)| (k.to_owned(), v.to_owned())).into();
    out.write_metadata(&Metadata { name: "lapwing.run".into(), metadata }).unwrap();
    let event = out.add_channel(0, "/event", "json", &BTreeMap::new()).unwrap();
    let camera = out.add_channel(0, "/camera/center", "protobuf", &BTreeMap::new()).unwrap();
    let note = format!(r#"{{"kind":"note","text":"{}"}}"#, "x".repeat(2 << 20));
    // Fields 2 and 3: 17 MiB of data, in the format jpeg.
    let picture = [&b"\x12\x80\x80\xc0\x08"[..], &vec![0; 17 << 20], b"\x1a\x04jpeg"].concat();
    for (channel_id, data) in [(event, note.as_bytes()), (camera, &picture), (event, br#"{"kind":"kick"}"#)] {
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        out.write_to_known_channel(&header, data).unwrap();
    }
    out.finish().unwrap();
    let (_dir, path) = on_disk(&out.into_inner().into_inner());
    let read: Vec<_> = RunReader::open(&path).unwrap().collect();
    let [Err(note), Err(picture), Ok((_, Item::Event(EventRecord::Kick)))] = &read[..] else { panic!("{read:?}") };
    assert!(note.to_string().contains("/event at 0.000 s: expected at most 1048576 bytes of JSON, got "), "{note}");
    assert!(picture.to_string().contains("expected a picture of at most 16777216 bytes, got 17825792"), "{picture}");
}

#[cfg(unix)]
#[test]
fn a_pipe_or_a_device_is_no_run_and_nobody_waits_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe.mcap");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let zeros = dir.path().join("zeros.mcap");
    std::os::unix::fs::symlink("/dev/zero", &zeros).unwrap();
    for path in [pipe, zeros] {
        let error = RunReader::open(&path).unwrap_err().to_string();
        assert!(error.ends_with("expected a run (an MCAP file), got a device or a pipe"), "{error}");
    }
}

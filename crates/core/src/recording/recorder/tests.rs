use std::sync::{Condvar, Mutex};

use super::{
    super::{EventRecord, RunKind, RunReader},
    *,
};
use crate::protocol::Telemetry;

/// A disk in memory that can be made to stall, to fill up and to break.
#[derive(Clone, Default)]
struct Disk(Arc<(Mutex<Platter>, Condvar)>);

#[derive(Default)]
struct Platter {
    bytes: Vec<u8>,
    stands: bool,
    /// A write is waiting for the disk to turn again.
    waits: bool,
    room: Option<usize>,
    broken: bool,
}

impl Disk {
    fn set(&self, change: impl FnOnce(&mut Platter)) {
        change(&mut self.0.0.lock().unwrap());
        self.0.1.notify_all();
    }

    fn await_a_waiting_write(&self) {
        let platter = self.0.0.lock().unwrap();
        drop(self.0.1.wait_while(platter, |p| !p.waits).unwrap());
    }

    /// The items on the disk and how its file ends.
    fn read(&self) -> (Vec<Item>, bool) {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), &self.0.0.lock().unwrap().bytes).unwrap();
        let mut run = RunReader::open(file.path()).unwrap();
        let items = run.by_ref().map(|item| item.unwrap().1).collect();
        (items, run.truncated().is_none())
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut platter = self.0.0.lock().unwrap();
        while platter.stands {
            platter.waits = true;
            self.0.1.notify_all();
            platter = self.0.1.wait(platter).unwrap();
        }
        platter.waits = false;
        if platter.broken {
            return Err(io::Error::other("it broke"));
        }
        let count = bytes.len().min(platter.room.unwrap_or(usize::MAX));
        if count == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        platter.bytes.extend(&bytes[..count]);
        platter.room = platter.room.map(|room| room - count);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        assert_eq!(to, io::SeekFrom::Current(0), "a recorder only asks where it is");
        Ok(self.0.0.lock().unwrap().bytes.len() as u64)
    }
}

fn header() -> RunHeader {
    RunHeader {
        kind: RunKind::Driven,
        name_hint: Some("a/b".into()),
        dialect: None,
        decimal_separator: None,
        model: None,
        seed: None,
        config: serde_json::Value::Null,
        lapwing: "0.1.0".into(),
        started: "2026-11-21T08:15:30Z".parse().unwrap(),
    }
}

fn record_on(disk: &Disk, queue: usize) -> Recorder {
    Recorder::with_sink(
        disk.clone(),
        "run.mcap".into(),
        &header(),
        RecorderOptions { queue, ..RecorderOptions::default() },
    )
    .unwrap()
}

fn telemetry() -> Item {
    Item::Telemetry(serde_json::from_str::<Telemetry>(r#"{"steering_deg":0,"throttle":0,"speed_mph":1}"#).unwrap())
}

fn frame(bytes: usize) -> Item {
    Item::Frame(vec![7; bytes].into())
}

/// A frame that fills a chunk alone, so that it is written at once.
fn large() -> Item {
    frame(CHUNK_BYTES)
}

fn until(what: impl Fn() -> bool) {
    let end = Instant::now() + Duration::from_secs(20);
    while !what() {
        assert!(Instant::now() < end, "waited in vain");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_slow_disk_drops_frames_first_and_keeps_all_telemetry() {
    let disk = Disk::default();
    let recorder = record_on(&disk, 40);
    disk.set(|p| p.stands = true);
    recorder.record(Duration::ZERO, large());
    disk.await_a_waiting_write();
    // The disk stalls from here on; `record` returns, so it does not wait for it.
    for i in 0..25 {
        recorder.record(Duration::from_millis(i), telemetry());
        recorder.record(Duration::from_millis(i), frame(10));
    }
    // 15 telemetries and 15 frames fill three quarters, 10 telemetries the rest.
    let status = recorder.status();
    assert_eq!((status.frames_not_recorded, status.items_not_recorded, status.items_written), (10, 0, 0));
    recorder.record(Duration::from_millis(25), telemetry());
    assert_eq!(recorder.status().items_not_recorded, 1);

    disk.set(|p| p.stands = false);
    until(|| recorder.queue.lock().is_idle());
    recorder.record(Duration::from_millis(26), frame(10));
    let report = recorder.finish();
    assert!(report.error.is_none());
    assert_eq!((report.telemetries, report.frames, report.frames_not_recorded), (25, 17, 10));
    let (items, in_order) = disk.read();
    assert!(in_order);
    assert_eq!(items.iter().filter(|item| **item == telemetry()).count(), 25);
    let gap = Item::Event(EventRecord::FramesNotRecorded { count: 10 });
    assert_eq!(items[items.len() - 2..], [gap, frame(10)]);
}

#[test]
fn frames_lost_at_the_very_end_are_told_in_the_file_too() {
    let disk = Disk::default();
    let recorder = record_on(&disk, 4);
    disk.set(|p| p.stands = true);
    recorder.record(Duration::ZERO, large());
    disk.await_a_waiting_write();
    (0..5).for_each(|_| recorder.record(Duration::ZERO, frame(1)));
    disk.set(|p| p.stands = false);
    drop(recorder);
    let (items, in_order) = disk.read();
    assert!(in_order, "dropping a recorder ends its file");
    assert_eq!(items.last(), Some(&Item::Event(EventRecord::FramesNotRecorded { count: 2 })));
}

#[test]
fn what_was_written_before_the_disk_was_full_is_readable() {
    let disk = Disk::default();
    let recorder = record_on(&disk, 100);
    disk.set(|p| p.room = Some(2 * CHUNK_BYTES + CHUNK_BYTES / 2));
    for _ in 0..4 {
        recorder.record(Duration::ZERO, large());
    }
    until(|| recorder.status().failed.is_some());
    recorder.record(Duration::ZERO, telemetry());
    let report = recorder.finish();
    let error = report.error.unwrap().to_string();
    assert!(error.starts_with("run.mcap: the rest of the run is not recorded: "), "{error}");
    assert_eq!((report.frames, report.frames_not_recorded, report.items_not_recorded), (2, 2, 1));
    assert_eq!(disk.read(), (vec![large(); 2], false));
}

#[test]
fn a_full_disk_with_room_again_loses_nothing() {
    let disk = Disk::default();
    let recorder = record_on(&disk, 100);
    disk.set(|p| p.room = Some(CHUNK_BYTES / 2));
    recorder.record(Duration::ZERO, large());
    until(|| recorder.status().failed.is_some());
    recorder.record(Duration::ZERO, telemetry());
    disk.set(|p| p.room = None);
    until(|| recorder.status().failed.is_none());
    assert!(recorder.finish().error.is_none());
    assert_eq!(disk.read(), (vec![large(), telemetry()], true));
}

#[test]
fn a_world_that_can_stand_still_does_not_wait_for_a_full_disk_and_what_is_lost_is_told() {
    let disk = Disk::default();
    let recorder = record_on(&disk, 4);
    disk.set(|p| p.room = Some(CHUNK_BYTES / 2));
    for second in 0..20 {
        recorder.wait_for_room();
        recorder.record(Duration::from_secs(second), large());
        recorder.record(Duration::from_secs(second), telemetry());
    }
    let report = recorder.finish();
    assert!(report.error.is_some());
    assert_eq!((report.telemetries, report.frames_not_recorded, report.items_not_recorded), (0, 20, 20));
}

#[test]
fn a_broken_disk_ends_the_recording_and_everything_else_is_counted() {
    let disk = Disk::default();
    let recorder = record_on(&disk, 100);
    recorder.record(Duration::ZERO, large());
    until(|| recorder.status().items_written == 1);
    disk.set(|p| p.broken = true);
    recorder.record(Duration::ZERO, large());
    until(|| recorder.status().failed.is_some());
    recorder.record(Duration::ZERO, telemetry());
    let report = recorder.finish();
    assert!(report.error.unwrap().to_string().contains("it broke"));
    assert_eq!((report.frames, report.frames_not_recorded, report.items_not_recorded), (1, 1, 1));
    assert_eq!(disk.read(), (vec![large()], false));
}

#[test]
fn a_disk_that_does_not_take_the_header_is_an_error_at_once() {
    let disk = Disk::default();
    disk.set(|p| p.room = Some(20));
    let result = Recorder::with_sink(disk, "run.mcap".into(), &header(), RecorderOptions::default());
    assert!(matches!(result.unwrap_err(), RecordingError::Write { .. }));
}

#[test]
fn runs_of_the_same_second_get_files_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let runs = dir.path().join("new").join("runs");
    let make = || Recorder::create(&runs, header(), RecorderOptions::default()).unwrap();
    let (first, second) = (make(), make());
    let name = |r: &Recorder| r.path().file_name().unwrap().to_str().unwrap().to_owned();
    assert!(name(&first).ends_with("-30-a-b.mcap"), "{}", name(&first));
    assert!(name(&second).ends_with("-30-a-b_2.mcap"), "{}", name(&second));
    let report = first.finish();
    assert_eq!(report.bytes, fs::metadata(&report.path).unwrap().len());
    assert!(report.bytes > 0);
}

#[test]
fn a_run_that_is_deleted_or_moved_away_is_told_while_it_lasts_and_in_the_end_none_of_it_is_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let (path, elsewhere) = (dir.path().join("run.mcap"), dir.path().join("moved.mcap"));
    let recorder = Recorder::create_file(&path, header(), RecorderOptions::default()).unwrap();
    let told = || (recorder.status().items_written, recorder.status().lost(), recorder.status().failed);
    recorder.record(Duration::ZERO, large());
    until(|| told() == (1, 0, None));
    fs::rename(&path, &elsewhere).unwrap();
    recorder.record(Duration::ZERO, large());
    until(|| told() == (2, 0, Some("it was deleted or moved away while it was recorded".into())));
    fs::rename(&elsewhere, &path).unwrap();
    recorder.record(Duration::ZERO, large());
    until(|| told() == (3, 0, None));
    fs::remove_file(&path).unwrap();
    recorder.record(Duration::ZERO, large());
    until(|| told().2.is_some());
    let report = recorder.finish();
    assert_eq!((report.frames, report.frames_not_recorded, report.bytes), (0, 4, 0));
    let expected = format!("{}: the run is gone: it was deleted or moved away while it was recorded", path.display());
    assert_eq!(report.error.unwrap().to_string(), expected);
}

#[test]
fn a_run_that_is_moved_away_is_whole_where_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let (path, elsewhere) = (dir.path().join("run.mcap"), dir.path().join("moved.mcap"));
    let recorder = Recorder::create_file(&path, header(), RecorderOptions::default()).unwrap();
    fs::rename(&path, &elsewhere).unwrap();
    for _ in 0..3 {
        recorder.record(Duration::ZERO, large());
    }
    until(|| recorder.status().failed.is_some());
    assert!(matches!(recorder.finish().error, Some(RecordingError::Gone { .. })));
    let mut run = RunReader::open(&elsewhere).unwrap();
    assert_eq!((run.by_ref().count(), run.truncated().is_none()), (3, true));
}

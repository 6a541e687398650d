use super::*;

fn rows(text: &str) -> Vec<Row> {
    read(text, Folders { log: Path::new(""), images: Path::new("IMG") })
        .unwrap_or_else(|(line, bad)| panic!("line {line}: {bad:?}"))
}

fn values(row: &Row) -> (f64, f64, f64, f64) {
    (row.steering.get(), row.throttle.get(), row.brake, row.speed.get())
}

/// Opens a file with this text and returns the error's words after the path.
fn error(text: &str) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("driving_log.csv");
    fs::write(&path, text).unwrap();
    let error = DrivingLog::open(dir.path()).unwrap_err().to_string();
    error.strip_prefix(path.to_str().unwrap()).unwrap().to_owned()
}

#[test]
fn a_table_of_another_kind_is_named_for_what_it_is() {
    for text in ["IMG/center_1.jpg;;;0;0;0;9\n", "center;steering;throttle;brake;speed\nIMG/center_1.jpg;0,1;0;0;9,5\n"]
    {
        let told = error(text);
        assert!(
            told.ends_with("commas separate the columns, not semicolons: save the table as CSV with commas"),
            "{told}"
        );
    }
    let told = error("IMG/center_1.jpg\t\t\t0\t0\t0\t9\n");
    assert!(told.ends_with("commas separate the columns, not tabs: save the table as CSV with commas"), "{told}");
    let dir = tempfile::tempdir().unwrap();
    let text: Vec<u8> = "\u{feff}IMG/center_1.jpg,,,0,0,0,9\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    fs::write(dir.path().join("driving_log.csv"), text).unwrap();
    let told = DrivingLog::open(dir.path()).unwrap_err().to_string();
    assert!(told.ends_with("line 1, text: expected UTF-8, got \"UTF-16\": save the table as CSV in UTF-8"), "{told}");
}

#[test]
fn paths_of_every_system_lead_to_the_same_picture() {
    for path in [
        r"C:\Users\user\My drive\data\IMG\",
        "/Users/user/Desktop/car sim/IMG/",
        "/home/user/data/IMG/",
        "IMG/",
        "",
        r"C:\Users\Doe, Jane\IMG\",
    ] {
        for space in ["", " "] {
            let text = format!(
                "{path}center_2018_07_16_17_11_43_382.jpg,{space}{path}left_2018_07_16_17_11_43_382.jpg,\
                 {space}{path}right_2018_07_16_17_11_43_382.jpg,{space}-0.05,{space}0.5,{space}0,{space}7.495027E-05\n"
            );
            let [row] = &rows(&text)[..] else { panic!("{text}") };
            assert_eq!(row.center, Path::new("IMG").join("center_2018_07_16_17_11_43_382.jpg"));
            assert_eq!(row.left, Some(Path::new("IMG").join("left_2018_07_16_17_11_43_382.jpg")));
            assert_eq!(row.right, Some(Path::new("IMG").join("right_2018_07_16_17_11_43_382.jpg")));
            assert_eq!(values(row), (-0.05, 0.5, 0.0, 7.495027e-5));
            assert_eq!(row.taken_at.unwrap().to_string(), "2018-07-16T17:11:43.382");
        }
    }
}

#[test]
fn a_header_says_the_order_of_the_columns() {
    let official =
        rows("center,left,right,steering,throttle,brake,speed\nIMG/c.jpg, IMG/l.jpg, IMG/r.jpg, 0, 0, 0, 22.14829\n");
    assert_eq!((official[0].line, values(&official[0])), (2, (0.0, 0.0, 0.0, 22.14829)));
    let other = rows("\u{feff}\"\",Speed,steering,Throttle,brake,center,lap\r\n0,10,0.25,0.5,0,c.jpg,3\r\n");
    assert_eq!(values(&other[0]), (0.25, 0.5, 0.0, 10.0));
    assert_eq!((other[0].center.as_path(), &other[0].left), (Path::new("IMG/c.jpg"), &None));
}

#[test]
fn lines_may_end_in_carriage_returns_alone() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join(LOG_NAME), "c.jpg,l.jpg,r.jpg,0.1,0.5,0,9\rd.jpg,l.jpg,r.jpg,0.2,0.5,0,9\r").unwrap();
    let log = DrivingLog::open(dir.path()).unwrap();
    assert_eq!(log.rows.iter().map(|row| (row.line, row.steering.get())).collect::<Vec<_>>(), [(1, 0.1), (2, 0.2)]);
    // Joined with a log of another program, and one whose line ends were converted twice.
    let log = "c.jpg,,,0.1,0.5,0,9\rd.jpg,,,0.2,0.5,0,9\re.jpg,,,0.3,0.5,0,9\nf.jpg,,,0.4,0.5,0,9\r\r\ng.jpg,,,0.5,0.5,0,9\r\n";
    fs::write(dir.path().join(LOG_NAME), log).unwrap();
    let log = DrivingLog::open(dir.path()).unwrap();
    assert_eq!(log.rows.iter().map(|row| row.line).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
}

#[test]
fn each_part_of_a_joined_log_may_have_its_own_header() {
    let text = "center,left,right,steering,throttle,brake,speed\nIMG/1.jpg,,,0.1,0.5,0,9\n\
                speed,brake,throttle,steering,center\n8,0,0.5,0.2,IMG/2.jpg\n\
                center,steering,throttle,brake,speed\nIMG/3.jpg,0.3,0.5,0,7\n";
    let told = rows(text);
    assert_eq!(told.iter().map(|row| row.line).collect::<Vec<_>>(), [2, 4, 6]);
    assert_eq!(
        told.iter().map(|row| (row.steering.get(), row.speed.get())).collect::<Vec<_>>(),
        [(0.1, 9.0), (0.2, 8.0), (0.3, 7.0)]
    );
}

#[test]
fn crlf_blank_lines_no_final_newline_and_quotes_are_read() {
    let rows = rows("c.jpg,l.jpg,r.jpg,0,0,0,1\r\n\r\n\"a, b/c.jpg\",\"l.jpg\",\"r.jpg\",\"-0,5\",0,0,25.07162");
    assert_eq!((rows[1].line, values(&rows[1])), (3, (-0.5, 0.0, 0.0, 25.07162)));
    assert_eq!(rows[1].center, Path::new("IMG/c.jpg"));
}

#[test]
fn decimal_commas_are_read_where_spaces_tell_the_fields_apart() {
    let line = "/home/user/IMG/c.jpg, /home/user/IMG/l.jpg, /home/user/IMG/r.jpg, -0,08581576, 0,1286689, 0, 12,1822\n";
    assert_eq!(values(&rows(line)[0]), (-0.08581576, 0.1286689, 0.0, 12.1822));
}

#[test]
fn decimal_commas_without_spaces_are_read_where_only_one_reading_makes_sense() {
    for (numbers, expected) in [
        ("-0,08581576,0,1286689,0,12,1822", (-0.08581576, 0.1286689, 0.0, 12.1822)),
        ("0,0,1286689,0,12,1822", (0.0, 0.1286689, 0.0, 12.1822)),
        ("0,0,0,12,1822", (0.0, 0.0, 0.0, 12.1822)),
        ("-0,25,1,0,30,19029", (-0.25, 1.0, 0.0, 30.19029)),
        ("0,0,0,7,495027E-05", (0.0, 0.0, 0.0, 7.495027e-5)),
        ("0,5,0,25,0,125,12,5", (0.5, 0.25, 0.125, 12.5)),
    ] {
        assert_eq!(values(&rows(&format!("c.jpg,l.jpg,r.jpg,{numbers}"))[0]), expected, "{numbers}");
    }
    assert_eq!(
        error("c.jpg,l.jpg,r.jpg,0,1,0,0,12"),
        r#", line 1, numbers: expected one way to read 5 fields as steering, throttle, brake, speed, got "0,1,0,0,12": decimal commas and separating commas cannot be told apart here: write the log with decimal points"#
    );
}

#[test]
fn a_field_that_cannot_be_read_is_named_with_what_to_do() {
    assert_eq!(
        error("c.jpg,l.jpg,r.jpg,0,0,0,1\nc.jpg,l.jpg,r.jpg,1.5,0,0,1\n"),
        r#", line 2, steering: expected a steering command from -1 to 1, got "1.5": correct or remove the line"#
    );
    assert_eq!(
        error("c.jpg,l.jpg,r.jpg,0,fast,0,1"),
        r#", line 1, throttle: expected a number, got "fast": correct or remove the line"#
    );
    assert_eq!(
        error("c.jpg,l.jpg,r.jpg,0,0,-0.5,1"),
        r#", line 1, brake: expected a brake from 0 to 1, got "-0.5": correct or remove the line"#
    );
    assert_eq!(
        error("c.jpg,l.jpg,r.jpg,0,0,0,NaN"),
        r#", line 1, speed: expected a speed from -1000 to 1000 mph, got "NaN": correct or remove the line"#
    );
    assert!(error("c.jpg,l.jpg,r.jpg,0.5").starts_with(
        r#", line 1, columns: expected 7 (center, left, right, steering, throttle, brake, speed), got "4""#
    ));
    assert!(error("center,steering\nc.jpg,0").starts_with(
        r#", line 1, header: expected the columns center, steering, throttle, brake, speed, got "center,steering""#
    ));
    assert_eq!(
        error("c.jpg,l.jpg,r.jpg,0.5,0.25,0,1.5,7"),
        r#", line 1, numbers: expected 4 numbers (steering, throttle, brake, speed), got "0.5,0.25,0,1.5,7": correct or remove the line; a log with further columns needs a header that names them"#
    );
    assert!(error("a;b;c").starts_with(r#", line 1, columns: expected 7"#));
    assert!(error("a,b,c,0,0,0,1").starts_with(r#", line 1, center: expected the name of a picture"#));
    assert!(error(r#""c.jpg,0"#).contains("expected a closing quote"));
    assert_eq!(error("\n \n"), ": expected rows of a driving log, got none");
    assert_eq!(
        error("center,left,right,steering,throttle,brake,speed\n"),
        ": expected rows of a driving log, got none"
    );
}

#[test]
fn time_passes_by_the_names_and_by_a_fifteenth_second_without() {
    let at = |names: [&str; 3]| {
        let text: String = names.iter().map(|n| format!("{n},,,0,0,0,1\n")).collect();
        rows(&text).iter().map(|row| row.at).collect::<Vec<_>>()
    };
    let ms = Duration::from_millis;
    let days = ["center_2020_12_31_23_59_59_950.jpg", "center_2021_01_01_00_00_00_020.jpg", "x.jpg"];
    assert_eq!(at(days), [ms(0), ms(70), ms(70) + FALLBACK_INTERVAL]);
    let joined = ["2021_01_01_00_00_01_000.jpg", "2020_01_01_00_00_00_000.jpg", "2020_01_01_00_00_00_100.jpg"];
    assert_eq!(at(joined), [ms(0), FALLBACK_INTERVAL, FALLBACK_INTERVAL + ms(100)]);
    let breaks = |names: [&str; 3]| {
        rows(&names.map(|n| format!("{n},,,0,0,0,1\n")).concat()).iter().map(|r| r.broken).collect::<Vec<_>>()
    };
    let year = Duration::from_secs(366 * 24 * 60 * 60 + 1);
    assert_eq!(breaks(joined), [None, Some(Break::Back(year)), None]);
    assert_eq!(breaks(days), [None, None, Some(Break::Joined)]);
    let names = ["2021_01_01_00_00_01_000.jpg", "2021_01_01_00_00_02_000.jpg", "2021_01_01_00_00_03_001.jpg"];
    assert_eq!(at(names), [ms(0), ms(1000), ms(1000) + FALLBACK_INTERVAL], "a second is no gap yet");
    assert_eq!(breaks(names), [None, None, Some(Break::Gap(ms(1001)))]);
    assert_eq!(at(["a_2020_13_01_00_00_00_000.jpg", "b.jpg", "c.jpg"])[2], FALLBACK_INTERVAL * 2);
}

#[test]
fn a_log_counts_the_rows_whose_time_is_assumed_and_a_run_made_from_it_says_so() {
    let untimed = |names: &[&str]| {
        let text: String = names.iter().map(|name| format!("{name},,,0,0,0,1\n")).collect();
        let log = DrivingLog { path: PathBuf::from("driving_log.csv"), rows: rows(&text) };
        let told = log.header().config.get(UNTIMED).and_then(serde_json::Value::as_u64);
        assert_eq!(told.unwrap_or(0), log.untimed() as u64, "{names:?}");
        log.untimed()
    };
    let (timed, later) = ("center_2020_01_01_00_00_00_000.jpg", "center_2020_01_01_00_00_00_100.jpg");
    assert_eq!(untimed(&["a.jpg", "b.jpg", "c.jpg"]), 3);
    assert_eq!(untimed(&[timed, later]), 0);
    assert_eq!(untimed(&[timed, later, "a.jpg", "b.jpg"]), 2);
    assert_eq!(untimed(&[timed, "a.jpg", later]), 0, "it continues from no row, and none from it");
    assert_eq!(untimed(&["a.jpg"]), 0);
}

#[cfg(unix)]
#[test]
fn a_log_that_is_a_device_is_an_error_at_once() {
    let dir = tempfile::tempdir().unwrap();
    std::os::unix::fs::symlink("/dev/zero", dir.path().join("driving_log.csv")).unwrap();
    let error = DrivingLog::open(dir.path()).unwrap_err().to_string();
    assert!(error.ends_with(": expected a driving log, got a device or a pipe"), "{error}");
}

#[cfg(unix)]
#[test]
fn a_log_that_cannot_be_looked_for_is_not_said_to_be_missing() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("driving_log.csv");
    std::os::unix::fs::symlink(&log, &log).unwrap(); // leads to itself
    for path in [dir.path(), &log] {
        let error = DrivingLog::open(path).unwrap_err();
        assert!(matches!(error, RecordingError::Io { .. }), "{error}");
    }
}

#[test]
fn an_error_is_short_however_many_columns_a_header_names() {
    let header = format!("center,steering,throttle,brake,speed{}", ",x".repeat(10_000));
    assert!(error(&format!("{header}\na.jpg,0,0,0\n")).len() < 600);
}

#[test]
fn pictures_are_looked_up_in_img_or_beside_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let log = dir.path().join("log.csv");
    fs::write(&log, "/elsewhere/IMG/c.jpg,,,0,0,0,1").unwrap();
    assert_eq!(DrivingLog::open(&log).unwrap().rows[0].center, dir.path().join("c.jpg"));
    fs::create_dir(dir.path().join("IMG")).unwrap();
    assert_eq!(DrivingLog::open(&log).unwrap().rows[0].center, dir.path().join("IMG").join("c.jpg"));
    fs::rename(dir.path().join("IMG"), dir.path().join("Img")).unwrap();
    assert_eq!(DrivingLog::open(&log).unwrap().rows[0].center, dir.path().join("Img").join("c.jpg"));
    assert!(matches!(DrivingLog::open(dir.path()), Err(RecordingError::NoSource { .. })));
}

#[test]
fn a_folder_of_pictures_alone_is_told_apart_from_one_without_a_log() {
    let dir = tempfile::tempdir().unwrap();
    let error = || DrivingLog::open(dir.path()).unwrap_err().to_string();
    assert!(error().ends_with("got a folder without one"), "{}", error());
    for name in ["1.jpg", "2.JPG"] {
        fs::write(dir.path().join(name), "").unwrap();
    }
    let near = || tempfile::tempdir().unwrap();
    let error_of = |dir: &Path| DrivingLog::open(dir).unwrap_err().to_string();
    let renamed = near();
    fs::write(renamed.path().join("Driving_Log (1).csv"), "").unwrap();
    let told = error_of(renamed.path());
    assert!(told.ends_with("got \"Driving_Log (1).csv\": rename it to driving_log.csv"), "{told}");
    let above = near();
    for name in ["b", "a", "c"] {
        fs::create_dir(above.path().join(name)).unwrap();
    }
    for name in ["b", "a"] {
        fs::write(above.path().join(name).join(LOG_NAME), "").unwrap();
    }
    let told = error_of(above.path());
    let named = ["a", "b"].map(|name| above.path().join(name).display().to_string()).join(" or ");
    assert!(told.ends_with(&format!("got only folders in it that hold recordings: name {named}")), "{told}");
    let alone = near();
    fs::create_dir(alone.path().join(IMAGES)).unwrap();
    fs::write(alone.path().join("IMG/1.jpg"), "").unwrap();
    let told = error_of(alone.path());
    assert!(told.contains("got IMG with 1 picture alone: put the driving_log.csv beside it"), "{told}");
    let words = "got 2 pictures alone, and pictures contain neither speed nor steering: let lapwing serve record";
    assert!(error().contains(words), "{}", error());
}

#[test]
fn a_picture_in_a_folder_below_is_found_by_its_path_where_there_is_none_beside_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let below = dir.path().join("s1/IMG");
    fs::create_dir_all(&below).unwrap();
    fs::write(below.join("c.jpg"), "").unwrap();
    fs::write(dir.path().join(LOG_NAME), "s1/IMG/c.jpg,,,0,0,0,1").unwrap();
    assert_eq!(DrivingLog::open(dir.path()).unwrap().rows[0].center, below.join("c.jpg"));
}

#[test]
fn a_picture_elsewhere_is_found_by_its_absolute_path_where_there_is_none_beside_the_log() {
    let (dir, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let elsewhere = other.path().join("Doe, Jane.jpg");
    let log = dir.path().join("driving_log.csv");
    fs::write(&log, format!("\"{}\",,,0,0,0,1", elsewhere.display())).unwrap();
    let center = || DrivingLog::open(&log).unwrap().rows[0].center.clone();
    assert_eq!(center(), dir.path().join("Doe, Jane.jpg"), "there is none at all");
    fs::write(&elsewhere, "").unwrap();
    assert_eq!(center(), elsewhere);
    fs::write(dir.path().join("Doe, Jane.jpg"), "").unwrap();
    assert_eq!(center(), dir.path().join("Doe, Jane.jpg"), "what is beside the log comes first");
}

//! `lapwing marl`: four agents at an intersection, from flags to films and policies.

use std::fs;

use tempfile::tempdir;

use crate::program::lapwing_in;

#[test]
fn an_episode_is_told_and_filmed_and_the_same_seed_gives_the_same_one() {
    let folder = tempdir().unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    let (status, out, err) = run(&["marl", "watch"]);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.starts_with("seed 0: "), "{out}");
    assert_eq!(out.lines().filter(|line| line.contains("reached its goal")).count(), 4, "{out}");
    assert_eq!(run(&["marl", "watch"]).1, out, "the same seed gives the same episode");
    let flags = ["marl", "watch", "--cars", "12", "--driver", "keep-lane", "--seed", "3", "--video", "frames"];
    let (status, out, err) = run(&flags);
    assert_eq!(status, 0, "{err}");
    assert!(out.contains("crashed with "), "{out}");
    // Ten a second, and the end for a second.
    let seconds: f64 = out.split_whitespace().nth(2).unwrap().parse().unwrap();
    let pictures = fs::read_dir(folder.path().join("frames")).unwrap().count();
    assert_eq!(pictures, (seconds * 10.0).round() as usize + 10, "{out}");
    let (status, _, err) = run(&["marl", "watch", "--video", "film.avi"]);
    assert_eq!(status, 2);
    assert!(err.contains("expected a film that ends in"), "{err}");
}

#[test]
fn agents_learn_into_a_folder_and_drive_with_what_they_learnt() {
    let folder = tempdir().unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    let train = ["marl", "train", "--agent-steps", "2000", "--intersections", "4", "--out", "ppo"];
    let (status, out, err) = run(&train);
    assert_eq!(status, 0, "{err}");
    assert!(out.starts_with("ppo/policy.safetensors ("), "{out}");
    let made: Vec<_> =
        fs::read_dir(folder.path().join("ppo")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(made.len(), 5, "policy, state, log, settings, events: {made:?}");
    let (status, _, err) = run(&train);
    assert_eq!(status, 1);
    assert!(err.contains("add --resume"), "{err}");

    let policy = ["--policy", "ppo/policy.safetensors"];
    let (status, out, err) = run(&[&["marl", "evaluate", "--episodes", "4", "--json"], &policy[..]].concat());
    assert_eq!((status, err.as_str()), (0, ""));
    let found: serde_json::Value = serde_json::from_str(&out).unwrap();
    let rates =
        ["collision_rate", "completion_rate", "off_road_rate", "time_up_rate"].map(|key| found[key].as_f64().unwrap());
    assert!((rates.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{out}");
    let (status, _, err) = run(&["marl", "evaluate", "--policy", "ppo/log.csv"]);
    assert_eq!(status, 1);
    assert!(err.contains("expected a whole safetensors file"), "{err}");
}

#[test]
fn a_study_can_be_stopped_and_goes_on_and_says_what_it_knows() {
    let folder = tempdir().unwrap();
    let run = |more: &[&str]| {
        let study = ["marl", "study", "--out", "study", "--seeds", "1", "--agent-steps", "1000", "--episodes", "10"];
        lapwing_in(folder.path(), "", &[&study[..], more].concat())
    };
    let (status, out, err) = run(&["--most", "1"]);
    assert_eq!(status, 0, "{err}");
    assert!(out.contains("PPO ends better: open: no runs") && err.contains("1 of 28 trainings are done"), "{out}{err}");
    let cell = folder.path().join("study/cells/ppo-smarts-0-0/cell.json");
    let first = fs::read(&cell).unwrap();
    let (status, out, err) = run(&["--most", "2"]);
    assert_eq!(status, 0, "{err}");
    assert!(fs::read(&cell).unwrap() == first, "what is done is kept");
    assert!(out.contains("PPO takes 3 to 3.5 times MADDPG's time: "), "{out}");
    assert_eq!(out.lines().filter(|line| line.starts_with("ppo ") || line.starts_with("maddpg ")).count(), 2, "{out}");
    let rows = fs::read_to_string(folder.path().join("study/study.csv")).unwrap();
    assert!(rows.lines().count() == 3 && rows.lines().nth(2).unwrap().starts_with("maddpg,smarts,0,1,"), "{rows}");
    let page = fs::read_to_string(folder.path().join("study/study.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("SMARTS PPO"), "{page}");
    let (status, _, err) = run(&["--most", "4", "--jobs", "2"]);
    assert!(status == 0 && err.contains("2 of 2: ") && err.contains("4 of 28 trainings are done"), "{err}");
    let left = ["COLOURS", "SORTING", "CLAIMS", "ROWS", "CURVES"].map(|part| page.contains(&format!("/*{part}*/")));
    assert_eq!(left, [false; 5], "{page}");
}

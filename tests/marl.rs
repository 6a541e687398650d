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
    assert!(err.contains("frame_00001.jpg to ") && err.contains(&format!("frame_{pictures:05}.jpg")), "{err}");
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
fn a_training_is_resumed_with_its_own_settings_and_only_made_longer() {
    let folder = tempdir().unwrap();
    let run = |arguments: &[&str]| lapwing_in(folder.path(), "", arguments);
    let read = |name: &str| fs::read_to_string(folder.path().join("ppo").join(name)).unwrap();
    let agent_steps = || {
        let settings: serde_json::Value = serde_json::from_str(&read("settings.json")).unwrap();
        settings["ppo"]["agent_steps"].as_u64()
    };
    let (status, _, err) =
        run(&["marl", "train", "--agent-steps", "2000", "--intersections", "4", "--gamma", "0.9", "--out", "ppo"]);
    assert_eq!(status, 0, "{err}");
    let log = read("log.csv");

    let resume = ["marl", "train", "--resume", "--out", "ppo"];
    let (status, _, err) = run(&resume);
    assert_eq!((status, agent_steps()), (0, Some(2000)), "{err}");
    assert_eq!(read("log.csv"), log, "there is nothing left to train");
    for flags in [["--algorithm", "maddpg"], ["--seed", "1"], ["--recipe", "any.toml"], ["--missions", "random"]] {
        let (status, _, err) = run(&[&resume[..], &flags[..]].concat());
        assert!(status == 2 && err.contains("cannot be used with"), "{flags:?}: {err}");
    }
    let (status, _, err) = run(&[&resume[..], &["--agent-steps", "1000"]].concat());
    assert!(status == 2 && err.contains("--agent-steps: expected at least as many as"), "{err}");

    let (status, _, err) = run(&[&resume[..], &["--agent-steps", "6000"]].concat());
    assert_eq!((status, agent_steps()), (0, Some(6000)), "{err}");
    assert!(read("log.csv").starts_with(&log) && read("log.csv") != log, "it went on");
    let settings = read("settings.json");
    assert!(settings.contains("\"gamma\": 0.9,"), "{settings}");
}

#[test]
fn a_recipe_trains_maddpg_and_one_that_is_wrong_is_refused() {
    let folder = tempdir().unwrap();
    let recipe = "[intersection]\nmissions = \"benchmark\"\ncars = 0\nreward = \"corrected\"\naxes = \"world\"\n\
                  [maddpg]\nagent_steps = 2000\nintersections = 4\nbatch = 16\nwarm_up = 100\nmemory = 5000\n\
                  hidden = 8\n";
    let run = |recipe: &str| {
        fs::write(folder.path().join("recipe.toml"), recipe).unwrap();
        lapwing_in(folder.path(), "", &["marl", "train", "--recipe", "recipe.toml", "--seed", "3", "--out", "maddpg"])
    };
    for (wrong, expected) in [
        ("mixd = true\n".to_owned() + recipe, "did you mean \"mixed\"?"),
        (recipe.replace("cars = 0", "cars = 50"), "recipe.toml: cars: expected 0 to 12, got 50"),
        (recipe.to_owned() + "replai = \"rank\"\n", "unknown field `replai`"),
        ("epochs = 3\n".to_owned(), "recipe.toml: "),
    ] {
        let (status, _, err) = run(&wrong);
        assert!(status == 2 && err.contains(expected), "{expected}: {status}, {err}");
    }
    let (status, out, err) = run(recipe);
    assert_eq!(status, 0, "{err}");
    assert!(out.starts_with("maddpg/policy.safetensors ("), "{out}");
    let settings = fs::read_to_string(folder.path().join("maddpg/settings.json")).unwrap();
    let settings: serde_json::Value = serde_json::from_str(&settings).unwrap();
    assert_eq!((settings["maddpg"]["batch"].as_u64(), settings["maddpg"]["seed"].as_u64()), (Some(16), Some(3)));
    let log = fs::read_to_string(folder.path().join("maddpg/log.csv")).unwrap();
    assert!(log.starts_with("update,") && log.contains("critic_loss"), "{log}");
    let evaluate = ["marl", "evaluate", "--episodes", "2", "--policy", "maddpg/policy.safetensors"];
    let (status, out, err) = lapwing_in(folder.path(), "", &evaluate);
    assert_eq!((status, err.as_str()), (0, ""));
    assert!(out.contains("SMARTS' reward"), "not the one that it learnt from: {out}");
}

#[test]
fn flags_that_a_training_cannot_follow_are_wrong_usage() {
    let folder = tempdir().unwrap();
    for (flags, expected) in [
        (&["--learners", "2"][..], "--learners: expected --algorithm maddpg"),
        (&["--replay", "rank"], "--replay: expected --algorithm maddpg"),
        (&["--actor-rate", "9"], "--actor-rate: expected --algorithm maddpg"),
        (&["--algorithm", "maddpg", "--critic", "central"], "--critic: expected --algorithm ppo"),
        (&["--algorithm", "maddpg", "--gamma-end", "0.9"], "--gamma-end: expected --algorithm ppo"),
        (&["--algorithm", "maddpg", "--collectors", "2"], "--collectors: expected --algorithm ppo"),
        (&["--mixed", "--missions", "random"], "cannot be used with"),
        (&["--gamma", "2"], "--gamma: expected 0 to 1, got 2"),
        (&["--gamma-end", "1"], "--gamma-end: expected below 1, where gamma and gamma_end differ, got 1"),
        (&["--batch", "0"], "--batch: expected 1 to 65536, got 0"),
        (&["--hidden", "5000"], "--hidden: expected 1 to 4096, got 5000"),
        (&["--threads", "0"], "--threads"),
        (&["--agent-steps", "0"], "--agent-steps"),
    ] {
        let train = [&["marl", "train", "--out", "out"][..], flags].concat();
        let (status, _, err) = lapwing_in(folder.path(), "", &train);
        assert!(status == 2 && err.contains(expected), "{flags:?}: {status}, {err}");
    }
}

#[test]
fn a_study_of_no_steps_is_wrong_usage_and_makes_no_folder() {
    let folder = tempdir().unwrap();
    let (status, _, err) = lapwing_in(folder.path(), "", &["marl", "study", "--agent-steps", "0", "--out", "study"]);
    assert!(status == 2 && err.contains("--agent-steps"), "{status}, {err}");
    assert!(!folder.path().join("study").exists());
}

#[test]
fn a_training_of_a_study_ends_with_whoever_holds_it() {
    let folder = tempdir().unwrap();
    let only = |cell: &str| {
        let study = ["marl", "study", "--out", "study", "--agent-steps", "50000000", "--held", "--only", cell];
        lapwing_in(folder.path(), "", &study)
    };
    let (status, _, err) = only("ppo");
    assert!(status == 2 && err.contains("--only: expected one of ppo-smarts-0-0, "), "{err}");
    assert!(!folder.path().join("study").exists());
    // Its standard input is at its end from the beginning.
    let (status, _, err) = only("ppo-smarts-0-0");
    assert_eq!(status, 1, "{err}");
    assert!(!folder.path().join("study/cells/ppo-smarts-0-0/cell.json").exists());
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
    assert!(out.contains("\nThis call finished 1 training ("), "{out}");
    let cell = folder.path().join("study/cells/ppo-smarts-0-0/cell.json");
    let first = fs::read(&cell).unwrap();
    let (status, out, err) = run(&["--most", "1"]);
    assert!(status == 0 && err.contains("2 of 28 trainings are done"), "{err}");
    assert!(fs::read(&cell).unwrap() == first, "what is done is kept");
    assert!(out.contains("PPO takes 3 to 3.5 times MADDPG's time: "), "{out}");
    assert!(out.contains("\nThis call finished 1 training ("), "what was done before does not count: {out}");
    assert_eq!(out.lines().filter(|line| line.starts_with("ppo ") || line.starts_with("maddpg ")).count(), 2, "{out}");
    let rows = fs::read_to_string(folder.path().join("study/study.csv")).unwrap();
    assert!(rows.lines().count() == 3 && rows.lines().nth(2).unwrap().starts_with("maddpg,smarts,0,1,"), "{rows}");
    let page = fs::read_to_string(folder.path().join("study/study.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("SMARTS PPO"), "{page}");
    assert!(page.contains("The call that wrote this page finished 1 training ("), "{page}");
    let (status, out, err) = run(&["--most", "2", "--jobs", "2", "--json"]);
    assert!(status == 0 && err.contains("2 of 2: ") && err.contains("4 of 28 trainings are done"), "{err}");
    let report: serde_json::Value = serde_json::from_str(&out).unwrap();
    let steps_of = |cell: &str| {
        let text = fs::read_to_string(folder.path().join("study/cells").join(cell).join("cell.json")).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap()["agent_steps"].as_u64().unwrap()
    };
    let both = steps_of("proportional-smarts-0-0") + steps_of("rank-smarts-0-0");
    let call = &report["this_call"];
    let counted = ["trainings", "agent_steps", "jobs"].map(|key| call[key].as_u64());
    assert_eq!(counted, [Some(2), Some(both), Some(2)], "{call}");
    assert_eq!(report["rows"].as_array().map(Vec::len), Some(4), "{report}");
    let steps = call["agent_steps_per_s"].as_f64().unwrap() * call["seconds"].as_f64().unwrap();
    assert!((steps - both as f64).abs() < 1.0, "{call}");
    // Once all is done, a call adds nothing and takes nothing away.
    let (status, out, err) = run(&["--tasks", "smarts"]);
    assert!(status == 0 && out.contains("\nThis call finished 3 trainings ("), "{out}{err}");
    let rows = fs::read_to_string(folder.path().join("study/study.csv")).unwrap();
    let (status, out, err) = run(&["--tasks", "smarts", "--most", "2"]);
    assert!(status == 0 && out.contains("\nThis call finished no training in "), "{out}{err}");
    assert_eq!(fs::read_to_string(folder.path().join("study/study.csv")).unwrap(), rows);
    let cells = || fs::read_dir(folder.path().join("study/cells")).unwrap().count();
    let before = cells();
    let study =
        ["marl", "study", "--out", "study", "--seeds", "2", "--agent-steps", "1000", "--episodes", "12", "--jobs", "2"];
    let (status, _, err) = lapwing_in(folder.path(), "", &study);
    assert!(status == 1 && err.contains("expected a training with --episodes 12, got 10"), "{err}");
    assert_eq!(cells(), before, "nothing is trained that could not stand in one table");
    let parts = ["COLOURS", "SORTING", "CLAIMS", "ROWS", "CALL", "CURVES"];
    assert_eq!(parts.map(|part| page.contains(&format!("/*{part}*/"))), [false; 6], "{page}");
}

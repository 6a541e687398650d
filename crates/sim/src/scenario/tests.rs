use super::*;

/// A scenario with these lines about its only actor.
fn with_actor(lines: &str) -> Result<Scenario, ScenarioError> {
    let head = "name = \"x\"\ndescription = \"\"\nduration_s = 10\n[ego]\nspeed_kmh = 36\n[[actor]]\n";
    Scenario::parse(&format!("{head}{lines}"))
}

#[test]
fn every_scenario_that_comes_along_is_whole_and_called_as_its_file() {
    let hazards = [
        ("ccrs", 9),
        ("ccrm", 5),
        ("ccrb", 4),
        ("cpna", 18),
        ("cpfa", 9),
        ("cpla", 14),
        ("child", 9),
        ("cbna", 7),
        ("cbla", 12),
    ];
    let harmless = ["gentle-stop", "parked", "turn-off", "oncoming", "steel-plate", "pass-through", "bystanders"];
    for (name, cases) in hazards.into_iter().chain(harmless.map(|name| (name, 1))) {
        let scenario = Scenario::named(name).unwrap();
        assert_eq!(scenario.name, name);
        assert_eq!(scenario.cases().len(), cases, "{name}");
        assert!(scenario.cases().iter().all(|case| case.ego.speed_mph() < 30.0), "{name} is faster than our car");
    }
    assert_eq!(Scenario::NAMES.len(), hazards.len() + harmless.len());
    let error = Scenario::named("ccrss").unwrap_err().to_string();
    assert_eq!(
        error,
        "unknown scenario: expected ccrs, ccrm, ccrb, cpna, cpfa, cpla, child, cbna, cbla, gentle-stop, parked, turn-off, oncoming, steel-plate, pass-through, bystanders, or a file ending in .toml, got \"ccrss\"; did you mean \"ccrs\"?"
    );
}

#[test]
fn cases_are_all_combinations_once() {
    let mut combinations = vec![];
    for case in Scenario::named("ccrb").unwrap().cases() {
        let Script::Lead { gap_m, deceleration, .. } = &case.actors[0] else { panic!("{case:?}") };
        combinations.push((gap_m.value(), deceleration.value()));
        assert_eq!(case.cases().len(), 1);
    }
    assert_eq!(combinations, [(12.0, 2.0), (12.0, 6.0), (40.0, 2.0), (40.0, 6.0)]);
}

#[test]
fn the_same_seed_draws_the_same_numbers_and_another_seed_others() {
    let scenario = with_actor(
        "script = \"lead\"\ngap_m = [10, 40]\nonset_s = [2.0, 5.0]\ndeceleration = { one_of = [2, 4, 6] }\nspeed_kmh = 30",
    )
    .unwrap();
    let numbers = |seed| {
        let settled = scenario.settle(seed);
        assert_eq!(settled.settle(seed + 1), settled, "settled once and for all");
        let Script::Lead { gap_m, onset_s, deceleration, speed_kmh, .. } = &settled.actors[0] else {
            panic!("{settled:?}")
        };
        assert_eq!(*speed_kmh, Some(Draw::Exactly(30.0)));
        (gap_m.value(), onset_s.value(), deceleration.value())
    };
    assert_eq!(numbers(7), numbers(7));
    let mut sum = 0.0;
    let mut decelerations = [0; 3];
    for seed in 0..300 {
        let (gap, onset, deceleration) = numbers(seed);
        assert!((10.0..40.0).contains(&gap) && (2.0..5.0).contains(&onset), "{gap} {onset}");
        assert_ne!(numbers(seed).0, numbers(seed + 1).0);
        sum += gap;
        decelerations[(deceleration / 2.0) as usize - 1] += 1;
    }
    assert!((sum / 300.0 - 25.0).abs() < 1.5, "gaps are even over their range: mean {}", sum / 300.0);
    assert!(decelerations.iter().all(|&count| count > 70), "{decelerations:?}");
    let reseeded = Scenario { seed: 1, ..scenario.clone() };
    assert_ne!(reseeded.settle(7), Scenario { seed: 1, ..scenario.settle(7) }, "the file's own seed counts too");
}

#[test]
fn wrong_numbers_are_refused_saying_where_what_and_how() {
    let cross = "script = \"cross\"\nahead_m = 50\nfrom_m = 4\nto_m = -4\nspeed_kmh = 5\n";
    for (lines, expected) in [
        ("script = \"parked\"\nkind = \"car\"\nahead_m = nan", "actor 0: ahead_m: expected -500 to 1000, got NaN"),
        (
            "script = \"parked\"\nkind = \"car\"\nahead_m = [5, 2]",
            "actor 0: ahead_m: expected -500 to 1000, got [5, 2]",
        ),
        (
            "script = \"cruise\"\nahead_m = 5\nspeed_kmh = { one_of = [] }",
            "actor 0: speed_kmh: expected 0 to 130, got { one_of = [] }",
        ),
        (
            "script = \"lead\"\ngap_m = 10\nonset_s = 1\ndeceleration = -2",
            "actor 0: deceleration: expected 0.1 to 12, got -2",
        ),
        (cross, "actor 0: at_s, share: expected either at_s or share, got neither"),
        (&format!("{cross}at_s = 1\nshare = 0.5"), "actor 0: at_s, share: expected either at_s or share, got both"),
        (
            &format!("{}at_s = 1", cross.replace("to_m = -4", "to_m = [-4, 5]")),
            "actor 0: to_m: expected the other side of from_m = 4, got [-4, 5]",
        ),
        (&format!("{cross}share = 17"), "actor 0: share: expected -5 to 6, got 17"),
    ] {
        let got = with_actor(lines).unwrap_err().to_string();
        assert_eq!(got, format!("scenario x: {expected}"));
    }
    let long = "name = \"x\"\ndescription = \"\"\nduration_s = inf\n[ego]";
    let got = Scenario::parse(long).unwrap_err().to_string();
    assert_eq!(got, "scenario x: duration_s: expected 0.1 to 3600, got inf");
    assert!(Scenario::parse(&long.replace("\"x\"", "\"a/b\"")).is_err());
}

#[test]
fn what_is_no_scenario_is_refused_with_its_place() {
    for (lines, part) in [
        ("script = \"parked\"\nkind = \"car\"\nahead_m = 5\nahead = 5", "unknown field `ahead`"),
        ("script = \"flies\"", "unknown variant `flies`"),
        ("script = \"parked\"\nkind = \"cow\"\nahead_m = 5", "unknown variant `cow`"),
        ("script = \"parked\"\nkind = \"car\"", "missing field `ahead_m`"),
        (
            "script = \"parked\"\nkind = \"car\"\nahead_m = \"far\"",
            "expected a number, [lowest, highest] or { one_of = [numbers] }",
        ),
        ("script = \"parked\"\nkind = \"car\"\nahead_m = [1, 2, 3]", "expected a number"),
    ] {
        let error = with_actor(lines).unwrap_err();
        assert!(matches!(error, ScenarioError::Toml(_)), "{error}");
        let error = error.to_string();
        assert!(error.contains(part) && error.contains("line "), "{error}");
    }
}

#[test]
fn only_the_scenario_that_comes_with_lapwing_may_be_called_as_it() {
    let ccrs = Scenario::named("ccrs").unwrap();
    assert_eq!(ccrs.clone().with_name_of_its_own().unwrap(), ccrs);
    let other = Scenario { duration_s: ccrs.duration_s + 1.0, ..ccrs };
    let error = other.clone().with_name_of_its_own().unwrap_err().to_string();
    assert!(error.starts_with("scenario ccrs: name: expected a name of its own"), "{error}");
    Scenario { name: "mine".into(), ..other }.with_name_of_its_own().unwrap();
}

#[test]
fn a_scenario_is_written_as_it_is_read() {
    for name in Scenario::NAMES {
        let scenario = Scenario::named(name).unwrap();
        assert_eq!(Scenario::parse(&toml::to_string(&scenario).unwrap()).unwrap(), scenario);
        assert_eq!(Scenario::parse(&toml::to_string(&scenario.settle(3)).unwrap()).unwrap(), scenario.settle(3));
    }
}

#[test]
fn our_car_begins_where_the_track_does_unless_told() {
    let track = Track::named("jungle").unwrap();
    let scenario = Scenario::named("ccrs").unwrap();
    let (s, offset) = scenario.ego.start(&track);
    assert_eq!(offset, track.file().driving_line_m);
    let start = track.file().start;
    assert!(track.at(s).position.distance(glam::DVec3::new(start.x, start.y, start.z)) < 5.0);
    let told = Ego { s_m: Some(Draw::Exactly(12.0)), offset_m: Some(Draw::Exactly(-1.0)), ..scenario.ego };
    assert_eq!(told.start(&track), (12.0, -1.0));
    let rolling = Ego { speed_kmh: Draw::Exactly(48.280_32), ..told };
    assert!((rolling.speed_mph() - 30.0).abs() < 1e-9 && (rolling.target_mph() - 30.0).abs() < 1e-9);
}

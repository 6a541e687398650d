use std::{collections::BTreeSet, convert::Infallible, fs, sync::Arc};

use super::*;
use crate::{
    camera::{Camera, Renderer, Shot},
    conditions::Conditions,
    scene::{Actor, Looks},
    world::Simulation,
};
use lapwing_core::{
    control::BrakeLimits,
    guard::{Guard, GuardError, GuardModel, Watched},
    perception::Frame,
    recording::Recording,
};

fn lake() -> Places {
    let mut places = Places::default();
    places.open(["lake", "random:9"]).unwrap();
    places
}

/// A drive by a human, and the pedal at each telemetry.
fn driven(places: &Places, episode: &Episode) -> (Played, Vec<f64>) {
    let setup = episode.staging().setup(places.get(&episode.track).unwrap()).unwrap();
    let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
    let mut pedal = vec![];
    let played = play(&mut world, &mut Human::new(episode.temper()), |shown| {
        if let Shown::Turn(turn, _) = shown {
            pedal.push(turn.telemetry().and_then(|telemetry| telemetry.truth.brake).unwrap());
        }
        Ok::<(), Infallible>(())
    });
    (played.unwrap(), pedal)
}

fn episode(case: Case, layer: Layer, speed_mph: f64, seed: u64) -> Episode {
    let (part, track) = if seed.is_multiple_of(2) { (Part::Train, "lake") } else { (Part::HeldOut, "random:9") };
    Episode { name: "x".into(), part, case, layer, track: track.into(), speed_mph, reaction_s: 1.0, seed }
}

#[test]
fn every_hazard_is_hit_in_every_layer_if_nobody_brakes() {
    let mut places = Places::default();
    places.open(["random:9"]).unwrap();
    for case in Case::of(Kind::Hazard) {
        for (i, layer) in case.layers().enumerate() {
            for (k, speed_mph) in [10.0, 20.0, 30.0].into_iter().enumerate() {
                let (seed, track) = ((i * 3 + k) as u64, "random:9".to_owned());
                let trial = Trial { case, layer, track, speed_mph, seed, laps: None, part: Part::HeldOut };
                let outcome = trial.drive(&places, Braker::Nobody, &mut |_| Ok(())).unwrap();
                assert!(outcome.impact_mph.is_some(), "{trial:?}: {outcome:?}");
                // At 30 mph the pilot slows down for bends, and brakes for nothing else.
                let most = if speed_mph < 25.0 { 1.5 } else { 12.0 };
                assert!(outcome.reduction_mph < most, "{trial:?}: {outcome:?}");
            }
        }
    }
}

#[test]
fn with_the_eyes_on_the_road_nothing_harmless_is_hit_or_braked_for_in_an_emergency() {
    let places = lake();
    for case in Case::of(Kind::Negative) {
        for (i, layer) in case.layers().enumerate() {
            for speed_mph in [10.0, 20.0, 29.5] {
                let episode = episode(case, layer, speed_mph, i as u64);
                let (played, pedal) = driven(&places, &episode);
                assert_eq!((played.hit_s, played.pressed_s), (None, None), "{episode:?}");
                let quickest = pedal.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max) * 15.0;
                assert!(quickest < 0.35, "{episode:?}: {quickest} pedals per second");
            }
        }
    }
}

#[test]
fn in_a_hazard_the_foot_goes_all_the_way_down_and_a_gentle_stop_takes_a_third_of_the_pedal() {
    let places = lake();
    let (played, pedal) = driven(&places, &episode(Case::Ccrs, Layer::Plain, 20.0, 5));
    let quickest = pedal.windows(5).map(|part| part[4] - part[0]).fold(0.0, f64::max);
    assert!(played.pressed_s.is_some() && played.hit_s.is_none(), "{played:?}");
    assert!(quickest > 0.6 && pedal.contains(&1.0), "{quickest}");
    let (_, pedal) = driven(&places, &episode(Case::GentleStop, Layer::Plain, 25.0, 4));
    let most = pedal.iter().copied().fold(0.0, f64::max);
    assert!((0.1..0.5).contains(&most), "{most}");
}

#[test]
fn a_brake_that_fails_shows_in_the_pedal_and_not_in_the_speed() {
    let places = lake();
    let episode = Episode { part: Part::HeldOut, ..episode(Case::Ccrs, Layer::Plain, 20.0, 4) };
    let setup = episode.staging().setup(places.get(&episode.track).unwrap()).unwrap();
    let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
    let mut seen = vec![];
    let temper = Temper { fails_s: 9.0, ..episode.temper() };
    let played = play(&mut world, &mut Human::new(temper), |shown| {
        if let Shown::Turn(turn, _) = shown {
            seen.extend(turn.telemetry().map(|telemetry| (telemetry.truth.brake.unwrap(), telemetry.speed.get())));
        }
        Ok::<(), Infallible>(())
    });
    assert!(played.unwrap().hit_s.is_some());
    // At the last telemetry the car has hit it and stands.
    let (pedal, mph) = &seen[seen.len() - 2];
    assert!(*pedal == 1.0 && (mph - 20.0).abs() < 1.0, "{pedal} {mph}");
}

#[test]
fn a_slower_reaction_presses_later() {
    let places = lake();
    let at = |reaction_s| {
        let quick = Episode { reaction_s, ..episode(Case::Ccrs, Layer::Plain, 25.0, 2) };
        driven(&places, &quick).0.pressed_s.unwrap()
    };
    assert!((at(1.3) - at(0.6) - 0.7).abs() < 0.14, "{} {}", at(1.3), at(0.6));
}

#[test]
fn each_layer_changes_the_picture_and_what_is_held_out_looks_different() {
    let places = lake();
    let mut pictures: Vec<(String, Vec<u8>)> = vec![];
    for (part, layer) in Layer::ALL.map(|layer| (Part::Train, layer)).into_iter().chain([(Part::HeldOut, Layer::Plain)])
    {
        let staging = Staging { case: Case::Child, layer, part, speed_mph: 10.0, seed: 6 };
        let setup = staging.setup(places.get("lake").unwrap()).unwrap();
        let (mut renderer, mut frame) = (Renderer::new(setup.scenery.clone()), Frame::default());
        let world = Simulation::new(setup).unwrap().seen_by(Blind);
        world.draw(&mut renderer, &Camera::CENTER, &mut frame);
        pictures.push((format!("{part} {layer}"), frame.rgb().to_vec()));
    }
    for (i, (one, a)) in pictures.iter().enumerate() {
        for (other, b) in &pictures[i + 1..] {
            let apart = a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > 12).count() as f64 / a.len() as f64;
            // Its parked cars are some 25 m ahead.
            assert!(apart > 0.0004, "{one} and {other}: {apart}");
        }
    }
    let staging = Staging { case: Case::Ccrs, layer: Layer::Plain, part: Part::HeldOut, speed_mph: 20.0, seed: 6 };
    let world = Simulation::new(staging.setup(places.get("random:9").unwrap()).unwrap()).unwrap();
    assert!(world.actors().iter().all(|actor| Looks::of(actor.look) == Looks::HeldOut));
}

#[test]
fn on_a_road_that_all_parts_share_each_has_its_own_piece() {
    let places = lake();
    // From where to where it may be driven, in each part.
    let driven = |part: Part, case: Case| {
        let staged = (0..60).map(|seed| {
            let speed_mph = [10.0, 20.0, 29.5][seed as usize % 3];
            let place = places.get("lake").unwrap();
            let setup = Staging { case, layer: Layer::Plain, part, speed_mph, seed }.setup(place).unwrap();
            let (scenario, length) = (setup.scenario.unwrap(), place.track().length());
            let s = scenario.ego.s_m.unwrap().value();
            let way_m = scenario.ego.speed_kmh.value() / 3.6 * scenario.duration_s;
            (s / length, (s + way_m) / length, scenario.duration_s)
        });
        staged.fold((f64::MAX, f64::MIN, f64::MAX), |(from, to, least_s), (a, b, s)| {
            (f64::min(from, a), f64::max(to, b), f64::min(least_s, s))
        })
    };
    for case in [Case::Lap, Case::Ccrs, Case::Bends] {
        let [train, validation, held_out] = Part::ALL.map(|part| driven(part, case));
        assert!(
            train.1 <= validation.0 + 1e-9 && validation.1 <= held_out.0 + 1e-9,
            "{case}: {train:?} {validation:?}"
        );
        assert!(held_out.1 <= 1.0 + 1e-9 && held_out.0 >= 0.75, "{case}: {held_out:?}");
        assert!(train.2 > 10.0 && held_out.2 > 10.0, "{case}: no drive is short: {train:?} {held_out:?}");
    }
    let weather = |part| {
        let staging = Staging { case: Case::Lap, layer: Layer::Plain, part, speed_mph: 20.0, seed: 3 };
        staging.setup(places.get("lake").unwrap()).unwrap().conditions
    };
    assert!(weather(Part::Train).haze < 0.1 && weather(Part::HeldOut).haze >= 0.15);
    assert!(weather(Part::Train).brightness >= 0.85 && weather(Part::HeldOut).brightness <= 0.8);
}

#[test]
fn no_rain_low_sun_or_night_that_is_held_out_is_learnt_from() {
    let places = lake();
    let weather = |part, layer| {
        let staged = (0..40).map(|seed| Staging { case: Case::Ccrs, layer, part, speed_mph: 20.0, seed });
        staged.map(|staging| staging.setup(places.get("lake").unwrap()).unwrap().conditions).collect::<Vec<_>>()
    };
    for (layer, strength) in [(Layer::Rain, (|of| of.rain) as fn(&Conditions) -> f64), (Layer::Night, |of| of.night)] {
        let all = |part| weather(part, layer).iter().map(strength).collect::<Vec<_>>();
        let held_out = all(Part::HeldOut);
        let [least, most] =
            [held_out.iter().copied().fold(1.0, f64::min), held_out.iter().copied().fold(0.0, f64::max)];
        assert!(0.7 < least && least < most && most < 1.0, "{layer}: {least} to {most}");
        let learnt = all(Part::Train);
        assert!(learnt.iter().all(|x| !(least..=most).contains(x)), "{layer}: {learnt:?}");
        assert!(learnt.iter().any(|x| *x < least) && learnt.contains(&1.0), "weaker and stronger: {learnt:?}");
    }
    let suns = |part| -> BTreeSet<_> {
        let at = |of: &Conditions| [of.sun_height_deg, of.sun_azimuth_deg].map(|degrees| degrees.unwrap() as i32);
        weather(part, Layer::LowSun).iter().map(at).collect()
    };
    let (learnt, held_out) = (suns(Part::Train), suns(Part::HeldOut));
    assert!(learnt.len() == 6 && held_out.len() == 2 && learnt.is_disjoint(&held_out), "{learnt:?} {held_out:?}");
}

#[test]
fn a_driver_who_looked_away_notices_a_danger_at_a_time_to_collision_of_2_4_s() {
    let places = lake();
    for case in [Case::Ccrs, Case::Ccrm, Case::Cbla] {
        let episode = episode(case, Layer::Plain, 25.0, 5);
        let setup = episode.staging().setup(places.get(&episode.track).unwrap()).unwrap();
        let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
        let mut told = vec![];
        let played = play(&mut world, &mut Human::new(episode.temper()), |shown| {
            if let Shown::Turn(turn, _) = shown {
                let to_go_s = turn.telemetry().and_then(|telemetry| telemetry.truth.time_to_collision_s);
                told.push((turn.at().as_secs_f64(), to_go_s.unwrap_or(f64::INFINITY)));
            }
            Ok::<(), Infallible>(())
        });
        let began_s = played.unwrap().pressed_s.unwrap() - episode.reaction_s;
        let (_, to_go_s) = told.into_iter().rfind(|(at_s, _)| *at_s <= began_s + 1e-6).unwrap();
        assert!((to_go_s - 2.4).abs() < 0.15, "{case}: {to_go_s} s");
    }
}

#[test]
fn what_is_hidden_is_out_of_sight_for_a_while_and_nothing_else_is() {
    let mut places = Places::default();
    places.open(["random:9"]).unwrap();
    // For how long the target cannot be seen in the last six seconds before it is hit, and whether it can at last.
    let unseen = |case: Case, layer: Layer| {
        let trial =
            Trial { case, layer, track: "random:9".into(), speed_mph: 20.0, seed: 1, laps: None, part: Part::HeldOut };
        let mut seen = vec![];
        let mut show = |world: &Simulation| {
            let target = world.actors()[0].position;
            seen.push(sight::Sight::of(world).seen().iter().any(|actor| actor.position == target));
            Ok(())
        };
        trial.drive(&places, Braker::Nobody, &mut show).unwrap();
        let unseen = seen.iter().rev().take(90).filter(|seen| !**seen).count();
        (unseen as f64 / 15.0, seen.last().is_some_and(|seen| *seen))
    };
    for case in Case::of(Kind::Hazard) {
        let (hidden_s, ends_seen) = unseen(case, Layer::Hidden);
        assert!(hidden_s >= 0.3 && ends_seen, "{case}: {hidden_s} s {ends_seen}");
        let (plain_s, _) = unseen(case, Layer::Plain);
        assert!(plain_s == 0.0 || case == Case::Child, "{case}: {plain_s} s");
    }
}

#[test]
fn the_pictures_of_the_hidden_layer_show_little_of_each_target_at_first_and_all_of_it_at_last() {
    let mut places = Places::default();
    places.open(["random:9"]).unwrap();
    for case in Case::of(Kind::Hazard) {
        let layer = Layer::Hidden;
        let trial =
            Trial { case, layer, track: "random:9".into(), speed_mph: 20.0, seed: 1, laps: None, part: Part::HeldOut };
        // The share of the target's pixels that is shown, in every fifth picture of which it would be more than a speck.
        let (mut renderer, mut shares, mut turns) = (None, vec![], 0);
        let mut show = |world: &Simulation| {
            turns += 1;
            if turns % 5 > 0 {
                return Ok(());
            }
            let renderer = renderer.get_or_insert_with(|| Renderer::new(world.setup().scenery.clone()));
            let conditions = Conditions { noise: 0.0, ..world.setup().conditions.clone() };
            let mut drawn = |actors: &[Actor]| {
                let mut frame = Frame::default();
                let shot = Shot { car: world.car(), actors, conditions: &conditions, seed: 1, time_s: world.time_s() };
                renderer.render(&Camera::CENTER, &shot, &mut frame);
                frame.rgb().to_vec()
            };
            let actors = world.actors();
            let differing =
                |a: Vec<u8>, b: Vec<u8>| a.chunks(3).zip(b.chunks(3)).filter(|(a, b)| a != b).count() as f64;
            let whole = differing(drawn(&actors[..1]), drawn(&[]));
            if whole > 12.0 {
                shares.push(differing(drawn(actors), drawn(&actors[1..])) / whole);
            }
            Ok(())
        };
        trial.drive(&places, Braker::Nobody, &mut show).unwrap();
        let (least, last) = (shares.iter().copied().fold(f64::INFINITY, f64::min), *shares.last().unwrap());
        assert!(least < 0.2 && last > 0.9, "{case}: {least} at least, {last} at last, of {}", shares.len());
    }
}

#[test]
fn a_data_set_is_read_back_is_the_same_again_and_goes_on_where_it_was_broken_off() {
    let folder = tempfile::tempdir().unwrap();
    let options = DataOptions { hours: 0.01, seed: 3, ..DataOptions::default() };
    let first = record(folder.path(), options, |_, _| true).unwrap();
    assert!(first.kept == 0 && !first.interrupted && first.episodes.len() >= 2, "{first:?}");
    let table = fs::read_to_string(folder.path().join(EPISODES_NAME)).unwrap();
    assert_eq!((table.lines().next(), table.lines().count()), (Some(HEADING), first.episodes.len() + 1));
    let path = |recorded: &Recorded| folder.path().join(format!("{}.mcap", recorded.episode.name));
    for recorded in &first.episodes {
        let moments: Vec<_> = Recording::open(path(recorded)).unwrap().map(Result::unwrap).collect();
        assert_eq!(moments.len() as u64, recorded.frames);
        for moment in &moments {
            let truth = &moment.telemetry.truth;
            assert!(truth.brake.is_some() && truth.gap.is_some() && truth.time_to_collision_s.is_some());
        }
        let pressed = moments.iter().any(|moment| moment.telemetry.truth.brake == Some(1.0));
        match recorded.episode.case.kind() {
            Kind::Hazard => assert!(pressed || recorded.hit, "{recorded:?}"),
            Kind::Negative => assert!(!pressed && !recorded.hit, "{recorded:?}"),
        }
    }
    let bytes: Vec<_> = first.episodes.iter().map(|recorded| fs::read(path(recorded)).unwrap()).collect();
    fs::remove_file(path(&first.episodes[0])).unwrap();
    // Its rehearsal counts hundreds of telemetries, so this interrupts it afterwards.
    let stopped = record(folder.path(), options, |_, of| of > first.episodes.len()).unwrap();
    assert_eq!((stopped.kept, &stopped.episodes[..]), (first.episodes.len() - 1, &first.episodes[1..]));
    assert!(stopped.interrupted && !path(&first.episodes[0]).exists());
    let again = record(folder.path(), options, |_, _| true).unwrap();
    assert_eq!((again.kept, &again.episodes), (first.episodes.len() - 1, &first.episodes));
    for (recorded, bytes) in first.episodes.iter().zip(&bytes) {
        assert!(fs::read(path(recorded)).unwrap() == *bytes, "{recorded:?}");
    }
    // Of another seed, the episodes have the same names.
    let error = record(folder.path(), DataOptions { seed: 4, ..options }, |_, _| true).unwrap_err().to_string();
    assert!(error.contains("line 2: expected \"0000-") && error.contains("name another folder"), "{error}");
    assert_eq!(fs::read_to_string(folder.path().join(EPISODES_NAME)).unwrap(), table);
}

#[test]
fn a_part_alone_is_the_same_as_in_the_whole_data_set_and_joins_it() {
    let [whole, alone] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let options = DataOptions { hours: 0.01, seed: 3, ..DataOptions::default() };
    let of = |part| DataOptions { part: Some(part), ..options };
    let all = record(whole.path(), options, |_, _| true).unwrap();
    let (held_out, others): (Vec<_>, Vec<_>) =
        all.episodes.iter().cloned().partition(|one| one.episode.part == Part::HeldOut);
    assert!(!held_out.is_empty() && !others.is_empty(), "{all:?}");
    // Its rehearsal counts hundreds of telemetries, so this interrupts it afterwards.
    let stopped = record(alone.path(), of(Part::HeldOut), |_, of| of > all.episodes.len()).unwrap();
    assert!(stopped.interrupted && stopped.episodes.is_empty(), "{stopped:?}");
    let part = record(alone.path(), of(Part::HeldOut), |_, _| true).unwrap();
    assert_eq!((&part.episodes, part.kept, part.interrupted), (&held_out, 0, false));
    for recorded in &held_out {
        let [there, here] = [&whole, &alone]
            .map(|folder| fs::read(folder.path().join(format!("{}.mcap", recorded.episode.name))).unwrap());
        assert!(there == here, "{recorded:?}");
    }
    let rest = record(alone.path(), of(Part::Train), |_, _| true).unwrap();
    assert_eq!((&rest.episodes, rest.kept), (&others, 0));
    let [there, here] = [&whole, &alone].map(|folder| fs::read_to_string(folder.path().join(EPISODES_NAME)).unwrap());
    assert_eq!(there, here);
    let error = record(alone.path(), of(Part::Validation), |_, _| true).unwrap_err().to_string();
    assert_eq!(error, "there is no validation episode in the first 0.01 hours: ask for more hours");
}

#[test]
fn a_shorter_data_set_leaves_a_longer_one_as_it_is_and_an_interrupted_rehearsal_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let options = DataOptions { hours: 0.001, seed: 3, ..DataOptions::default() };
    let table = folder.path().join(EPISODES_NAME);
    let stopped = record(folder.path(), options, |_, _| false).unwrap();
    assert_eq!(stopped, DataReport { interrupted: true, ..DataReport::default() });
    assert!(!table.exists());
    let first = record(folder.path(), options, |_, _| true).unwrap();
    assert_eq!((first.kept, first.more), (0, 0));
    // Two episodes that come later, of which one has its run.
    let later = |name: &str| format!("{name},train,ccrs,hazard,plain,1,lake,20,1,9,0\n");
    let longer = fs::read_to_string(&table).unwrap() + &later("9998-train-ccrs-plain");
    fs::write(folder.path().join("9998-train-ccrs-plain.mcap"), "").unwrap();
    fs::write(&table, longer.clone() + &later("9999-train-ccrs-plain")).unwrap();
    let again = record(folder.path(), options, |_, _| true).unwrap();
    assert_eq!((again.kept, again.more, &again.episodes), (first.episodes.len(), 1, &first.episodes));
    assert_eq!(fs::read_to_string(&table).unwrap(), longer);
}

#[test]
fn runs_that_a_killed_recording_left_are_kept_only_by_the_data_set_that_they_are_of() {
    let folder = tempfile::tempdir().unwrap();
    let options = DataOptions { hours: 0.001, seed: 3, ..DataOptions::default() };
    let first = record(folder.path(), options, |_, _| true).unwrap();
    // Killed before the table was written, and while a run was.
    fs::remove_file(folder.path().join(EPISODES_NAME)).unwrap();
    let [half, other] = ["0001-train-lap-plain.mcap.a8Xk2P.partial", "mine.mcap.a8Xk2P.partial"];
    for name in [half, other] {
        fs::write(folder.path().join(name), "").unwrap();
    }
    let error = record(folder.path(), DataOptions { seed: 2, ..options }, |_, _| true).unwrap_err().to_string();
    assert!(error.contains("0000-") && error.contains("runs of another seed or version of Lapwing"), "{error}");
    assert!(folder.path().join(half).exists() && !folder.path().join(EPISODES_NAME).exists());
    let again = record(folder.path(), options, |_, _| true).unwrap();
    assert_eq!((again.kept, &again.episodes), (first.episodes.len(), &first.episodes));
    assert!(!folder.path().join(half).exists() && folder.path().join(other).exists());
}

#[test]
fn rows_beyond_the_ten_thousandth_episode_come_after_those_before_it() {
    let folder = tempfile::tempdir().unwrap();
    let options = DataOptions { hours: 0.001, seed: 3, ..DataOptions::default() };
    record(folder.path(), options, |_, _| true).unwrap();
    let table = folder.path().join(EPISODES_NAME);
    let shorter = fs::read_to_string(&table).unwrap();
    // As text, 00001 comes before any of four digits, and 10000 after 1.
    let row = |name: &str| format!("{name},train,ccrs,hazard,plain,1,lake,20,1,9,0\n");
    let name = "10000-train-ccrs-plain";
    fs::write(folder.path().join(format!("{name}.mcap")), "").unwrap();
    fs::write(&table, shorter.clone() + &row(name)).unwrap();
    assert_eq!(record(folder.path(), options, |_, _| true).unwrap().more, 1);
    let between = "00000-train-ccrs-plain";
    fs::write(&table, shorter + &row(between)).unwrap();
    let error = record(folder.path(), options, |_, _| true).unwrap_err().to_string();
    assert!(error.contains("expected \"an episode after 0"), "{error}");
}

#[test]
fn the_drives_at_a_speed_are_the_same_whichever_others_are_driven() {
    let at = |speeds_mph: &[f64]| {
        let all = trials(&TrialOptions { speeds_mph: speeds_mph.to_vec(), laps: 0, ..TrialOptions::default() });
        all.into_iter().filter(|trial| trial.speed_mph == 20.0).collect::<Vec<_>>()
    };
    assert!(!at(&[20.0]).is_empty());
    assert_eq!(at(&[20.0]), at(&SPEEDS_MPH));
    assert_eq!(at(&[20.0])[1].seed, (Case::Ccrs as u64) << 32 | 1, "as it always was at one speed");
}

#[test]
fn a_seed_has_the_same_weather_at_every_speed() {
    let places = lake();
    for case in Case::ALL {
        for layer in case.layers() {
            let weather = |speed_mph| {
                let staging = Staging { case, layer, part: Part::HeldOut, speed_mph, seed: 7 };
                staging.setup(places.get("random:9").unwrap()).unwrap().conditions
            };
            assert_eq!(weather(10.0), weather(30.0), "{case} {layer}");
        }
    }
}

#[test]
fn a_case_that_has_none_of_the_layers_is_left_out_and_named() {
    let (cases, layers) = (vec![Case::Ccrs, Case::Parked], vec![Layer::Hidden]);
    let options = TrialOptions { cases, layers, seeds: 2, laps: 0, ..TrialOptions::default() };
    assert_eq!(options.left_out(), [Case::Parked]);
    let planned = trials(&options);
    assert!(planned.iter().all(|trial| (trial.case, trial.layer) == (Case::Ccrs, Layer::Hidden)), "{planned:?}");
    assert_eq!(planned.len(), 2 * SPEEDS_MPH.len());
    assert!(TrialOptions::default().left_out().is_empty());
}

/// Warns for nothing: of 50 s, it does so for five, which holds the car.
struct Nervous;

impl GuardModel for Nervous {
    fn name(&self) -> &str {
        "nervous"
    }

    fn sha256(&self) -> Option<&str> {
        None
    }

    fn guard(&self) -> Box<dyn Guard> {
        Box::new(Self)
    }
}

impl Guard for Nervous {
    fn name(&self) -> &str {
        "nervous"
    }

    fn limits(&self) -> BrakeLimits {
        BrakeLimits { fires: 0.5, releases: 0.25 }
    }

    fn watch(&mut self, now: &Watched<'_>) -> Result<Option<f64>, GuardError> {
        Ok(Some(if now.at.as_secs_f64() % 50.0 > 45.0 { 1.0 } else { 0.0 }))
    }

    fn needs_picture(&self) -> bool {
        false
    }

    fn reset(&mut self) {}
}

#[test]
fn a_lap_goes_on_after_a_guard_that_held_the_car_for_nothing() {
    let mut places = Places::default();
    places.open(["lake"]).unwrap();
    let options = TrialOptions { cases: vec![], laps: 1, ..TrialOptions::default() };
    let lap = trials(&options).into_iter().find(|trial| trial.track == "lake").unwrap();
    let plain = lap.drive(&places, Braker::Nobody, &mut |_| Ok(())).unwrap();
    let held = lap.drive(&places, Braker::Guard(&Nervous), &mut |_| Ok(())).unwrap();
    // Each braking takes its five seconds, and the way back to 20 mph; the car does not drive on while it is held.
    let lost_s = (held.frames as f64 - plain.frames as f64) / 15.0;
    assert!(held.activations >= 2, "{held:?} and {plain:?} without");
    let each_s = lost_s / f64::from(held.activations);
    assert!((4.0..12.0).contains(&each_s), "{each_s} s: {held:?} and {plain:?} without");
}

#[test]
fn what_a_picture_shows_is_told_where_it_is_drawn_and_a_drive_that_is_retold_is_the_same() {
    let places = lake();
    for (case, speed_mph, seed) in [(Case::Cpna, 20.0, 4), (Case::Ccrs, 25.0, 6), (Case::Cbla, 15.0, 8)] {
        let episode = episode(case, Layer::Plain, speed_mph, seed);
        let told = retell(&places, &episode, 15.0).unwrap();
        let setup = episode.staging().setup(places.get("lake").unwrap()).unwrap();
        let mut renderer = Renderer::new(Arc::clone(&setup.scenery));
        let mut world = Simulation::new(setup).unwrap().seen_by(Blind);
        let (mut i, mut compared) = (0, 0);
        play(&mut world, &mut Human::new(episode.temper()), |shown| {
            let Shown::Turn(_, world) = shown else { return Ok::<(), Infallible>(()) };
            let picture = &told[i];
            i += 1;
            assert_eq!(picture.speed_mps, world.car().speed.abs(), "frame {i}");
            let [outline] = &picture.outlines[..] else { return Ok(()) };
            if i % 10 > 0 || !(6.0..40.0).contains(&outline.away_m) {
                return Ok(());
            }
            let (mut with, mut without) = (Frame::default(), Frame::default());
            world.draw(&mut renderer, &Camera::CENTER, &mut with);
            let conditions = &world.setup().conditions;
            let shot =
                Shot { car: world.car(), actors: &[], conditions, seed: world.setup().seed, time_s: world.time_s() };
            renderer.render(&Camera::CENTER, &shot, &mut without);
            let differs = |x: &usize| {
                let column = |frame: &Frame, y: usize| frame.pixel(*x, y);
                // Above the shadow.
                (40..92).filter(|y| column(&with, *y) != column(&without, *y)).count() > 2
            };
            let columns: Vec<usize> = (0..320).filter(differs).collect();
            let (Some(first), Some(last)) = (columns.first(), columns.last()) else { return Ok(()) };
            // The shadow falls to the right.
            let [from, to] = outline.columns;
            let (first, last) = (*first as f32, *last as f32);
            // A person is drawn narrower than the box.
            let most = if case == Case::Ccrs { 2.0 } else { to - from };
            assert!((-1.5..most).contains(&(first - from)) && last > from, "{case}: {outline:?} {first} {last}");
            compared += 1;
            Ok(())
        })
        .unwrap();
        assert_eq!(i, told.len());
        assert!(compared > 3, "{case}: {compared}");
    }
}

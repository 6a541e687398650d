//! `lapwing explain`: which parts of a picture a steering comes from.

use std::time::Instant;

use anyhow::{Context, bail};

use super::{Ended, outputs};
use crate::cli;
use lapwing_core::{
    perception::{Frame, decode_jpeg},
    recording::{Moment, Recording},
};
use lapwing_learn::{
    explain::{Explainer, Method},
    models,
};
use lapwing_score::drawing::{LINE_PX, MARGIN, Shape, Sheet};

pub(super) fn run(arguments: &cli::Explain) -> anyhow::Result<Ended> {
    outputs::check_drawing(&arguments.out)?;
    let model = match &arguments.model {
        // It is not loaded for nothing: its code would run, or its runtime be asked for.
        Some(path) if models::is_foreign(path) && path.is_file() => bail!(
            "{}: expected one of Lapwing's own checkpoints (.safetensors), got a network made elsewhere, whose layers cannot be looked into",
            path.display()
        ),
        Some(path) => models::load(path, Instant::now)?,
        None => models::built_in(Instant::now)?,
    };
    let mut explainer = Explainer::of(&model)?;
    let moment = moment(arguments)?;
    let mut frame = Frame::default();
    let place = || format!("{}: moment {}", arguments.recording.display(), moment.row);
    let picture = moment.pictures[0].as_ref().with_context(|| format!("{}: no picture", place()))?;
    let which = || format!("{}: {picture}", place());
    decode_jpeg(&picture.read().with_context(which)?, &mut frame).with_context(which)?;
    let explained = |explainer: &mut Explainer, method| {
        explainer.explain(&frame, moment.telemetry.speed, method).with_context(place)
    };
    let visual = explained(&mut explainer, Method::VisualBackProp)?;
    let gradients = explained(&mut explainer, Method::IntegratedGradients)?;
    let recorded = moment.steering().map_or(String::new(), |steering| format!(", recorded {:+.3}", steering.get()));
    let told = format!("moment {}: steering {:+.3}{recorded}", moment.row, visual.steering);
    let pictures = [
        (told.clone(), frame.clone()),
        ("what the convolutions react to".into(), visual.over(&frame)),
        ("what turns right (red) and left (blue)".into(), gradients.over(&frame)),
    ];
    sheet(pictures).write(&arguments.out)?;
    // The driver's steering is that for the road from there.
    let ahead = moment.command.as_ref().and_then(|command| command.ahead_ns).map_or(String::new(), |ns| {
        format!(
            "\nas commands took effect late, the network that drove was shown the road from {} ms ahead; this is the picture as it came",
            ns / 1_000_000
        )
    });
    outputs::print(&format!("{}\n{told} ({}){ahead}", arguments.recording.display(), model.name()))?;
    Ok(Ended::Passed)
}

/// The one that is asked for.
fn moment(arguments: &cli::Explain) -> anyhow::Result<Moment> {
    let mut last = None;
    let mut moments = Recording::open(&arguments.recording)?;
    for moment in &mut moments {
        let moment = moment?;
        if moment.row == arguments.frame {
            return Ok(moment);
        }
        last = Some(moment.row);
    }
    let (recording, got) = (arguments.recording.display(), arguments.frame);
    let damage = moments.truncated().map_or_else(String::new, |why| format!("; {why}"));
    match last {
        Some(last) => bail!("{recording}: expected a moment from 0 to {last} (--frame), got {got}{damage}"),
        None => bail!("{recording}: expected moments, got none{damage}"),
    }
}

/// Pictures one below the other, each with a line above it.
fn sheet(pictures: [(String, Frame); 3]) -> Sheet {
    let (mut shapes, mut y, mut width) = (vec![], MARGIN, 0.0);
    for (line, frame) in pictures {
        width = f64::max(width, frame.width() as f64);
        shapes.push(Shape::text((MARGIN, y + LINE_PX / 2.0), 0.0, line));
        let height = frame.height() as f64;
        shapes.push(Shape::Picture { at: (MARGIN, y + LINE_PX), frame });
        y += LINE_PX + height + MARGIN;
    }
    Sheet { width: width + 2.0 * MARGIN, height: y, title: "What the steering comes from".into(), shapes }
}

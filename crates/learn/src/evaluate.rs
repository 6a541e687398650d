//! How far a model's steering is from that of data sets, row by row.

use std::{
    fmt,
    path::{Path, PathBuf},
    sync::Arc,
};

use serde::Serialize;

use crate::{
    dataset::{self, Balance, Blocks, Cache, DatasetError, Inputs, Label, Sample, Samples, Selection, Set},
    models::LoadedModel,
    nn::Network,
    train::{Measured, Metrics, Recipe, TrainError, measure},
};
use lapwing_core::{
    perception::{Frame, ImageError, decode_jpeg},
    pilot::{PilotError, View},
};
use lapwing_score::drawing::chart::{Axis, Chart, Marks, Series};

/// Which rows of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Rows {
    // No comments that clap would show as help.
    #[expect(missing_docs, reason = "its name says it")]
    All,
    #[expect(missing_docs, reason = "those that the checkpoint's training held out")]
    HeldOut,
}

/// Why a model cannot be evaluated on data.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// Held-out rows were asked for, but there are none.
    #[error(
        "{model} was validated on separate data and held out no rows: measure it with --rows all on its validation data: {}",
        paths(validation)
    )]
    NoneHeldOut {
        /// The model.
        model: String,
        /// The data that it was validated on.
        validation: Vec<Selection>,
    },
    /// The data.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The network.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A sample has no picture.
    #[error("a sample without a picture")]
    NoPicture,
    /// A picture that cannot be decoded.
    #[error("{picture}")]
    Image {
        /// The picture.
        picture: String,
        /// What is wrong with it.
        source: ImageError,
    },
    /// A picture that the model cannot answer.
    #[error("{picture}")]
    Pilot {
        /// The picture.
        picture: String,
        /// Why not.
        source: PilotError,
    },
    /// Answers that are not finite numbers.
    #[error(
        "{}: expected finite answers from {model}, got {got} in row {row}; {count} of {rows} are not finite",
        path.display()
    )]
    NotFinite {
        /// The data set.
        path: PathBuf,
        /// The model.
        model: String,
        /// The first such answer.
        got: f64,
        /// Its row.
        row: u32,
        /// How many there are.
        count: usize,
        /// Of how many.
        rows: usize,
    },
}

/// A model evaluated on data sets. In JSON the keys are in alphabetical order, including those of the [`Metrics`]:
/// convert it to a [`serde_json::Value`] first.
#[derive(Debug, Clone, Serialize)]
pub struct Evaluation {
    /// How rows were held out, if only those were used.
    pub held_out: Option<Blocks>,
    /// The model's file, or `built in`.
    pub model: PathBuf,
    /// Each data set.
    pub results: Vec<Compared>,
    /// SHA-256 of the model's file.
    pub sha256: String,
}

/// A model evaluated on one data set.
#[derive(Debug, Clone, Serialize)]
pub struct Compared {
    /// The data set.
    pub data: PathBuf,
    /// How many of these rows the network learnt from, as far as its recipe says; `None` without a recipe, or if data that
    /// it names is not there, which may be the same under another name.
    pub learnt_from: Option<usize>,
    /// Rows that were evaluated.
    pub rows: usize,
    /// How far the answers are from the labels.
    #[serde(flatten)]
    pub measured: Measured,
    /// Each label and its answer.
    #[serde(skip)]
    pub answers: Vec<(f64, f64)>,
}

impl Evaluation {
    /// Evaluates a model, read from this file, on data sets, using at most the rows of each before a given one.
    ///
    /// # Errors
    /// [`EvaluateError`].
    pub fn of(
        model: &LoadedModel,
        file: Option<&Path>,
        data: &[PathBuf],
        rows: Rows,
        before: Option<usize>,
    ) -> Result<Self, EvaluateError> {
        let name = model.name();
        // Models made elsewhere describe their training in their own way, or not at all.
        let recipe: Option<Recipe> = model.training().and_then(|training| serde_json::from_str(training).ok());
        let (set, blocks) = match rows {
            Rows::All => (Set::All, None),
            Rows::HeldOut
                if let Some(Recipe { validation, .. }) = &recipe
                    && !validation.is_empty() =>
            {
                return Err(EvaluateError::NoneHeldOut { model: name.into(), validation: validation.clone() });
            }
            Rows::HeldOut => {
                let blocks = recipe.as_ref().map_or_else(Blocks::default, |recipe| recipe.blocks);
                (Set::Validation, Some(blocks))
            }
        };
        if recipe.is_none() {
            tracing::warn!("{name} has no recipe: whether these rows were held out is unknown");
        }
        let results = data.iter().map(|path| {
            let selection = Selection { rows: before.map(|row| (0, row)), ..Selection::of(path) };
            let samples = Arc::new(Samples::open(&[selection], set, blocks, &Balance::default())?);
            Compared::of(model, path, &samples, recipe.as_ref())
        });
        Ok(Self {
            held_out: blocks,
            model: file.unwrap_or(Path::new("built in")).to_owned(),
            results: results.collect::<Result<_, _>>()?,
            sha256: model.sha256().to_owned(),
        })
    }

    /// Each data set's errors over the steering angle.
    pub fn charts(&self) -> Vec<Chart> {
        self.results.iter().map(|compared| errors(&compared.data.display().to_string(), &compared.answers)).collect()
    }
}

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "model  {}", self.model.display())?;
        write!(f, "{:<32} {:>6}  {:<12}  {:<6}  {:<6}  r", "data", "rows", "label", "MSE", "MAE")?;
        for Compared { data, rows, measured, .. } in &self.results {
            for (label, Metrics { mse, mae, r }) in [("as recorded", measured.raw), ("9-frame mean", measured.smooth)] {
                let r = r.map_or_else(|| "-".to_owned(), |r| format!("{r:.3}"));
                let name = data.display().to_string();
                write!(f, "\n{name:<32} {rows:>6}  {label:<12}  {mse:.4}  {mae:.4}  {r}")?;
            }
        }
        Ok(())
    }
}

impl Compared {
    fn of(
        model: &LoadedModel,
        path: &Path,
        samples: &Arc<Samples>,
        recipe: Option<&Recipe>,
    ) -> Result<Self, EvaluateError> {
        let answers = match model.network() {
            Some(network) => of_network(&network, model, samples)?,
            None => of_pilot(model, samples)?,
        };
        let rows = samples.samples.len();
        let not_finite: Vec<usize> = (0..answers.len()).filter(|i| !answers[*i].is_finite()).collect();
        if let [first, ..] = not_finite[..] {
            return Err(EvaluateError::NotFinite {
                path: path.to_owned(),
                model: model.name().to_owned(),
                got: answers[first],
                row: samples.samples[first].row,
                count: not_finite.len(),
                rows,
            });
        }
        let learnt_from = recipe.and_then(|recipe| {
            let learnt = learnt_from(recipe, path)
                .inspect_err(|gone| {
                    let (path, gone) = (path.display(), gone.display());
                    tracing::info!("{path}: whether the network learnt from it is unknown: its recipe names {gone}, which is not there");
                })
                .ok()?;
            Some(samples.samples.iter().filter(|sample| learnt(sample.row as usize)).count())
        });
        if let Some(learnt) = learnt_from.filter(|learnt| *learnt > 0) {
            let path = path.display();
            let todo = match recipe.map(|recipe| &recipe.validation[..]) {
                Some([]) | None => "see --rows held-out".to_owned(),
                Some(validation) => {
                    format!("measure it on other data, such as its validation data: {}", paths(validation))
                }
            };
            tracing::warn!("{path}: the network learnt from {learnt} of these {rows} rows; {todo}");
        }
        let measured = Measured::of(&answers, samples, Label::Steering);
        let answers = samples.samples.iter().map(|sample| sample.steering).zip(answers).collect();
        Ok(Self { data: path.to_owned(), learnt_from, rows, measured, answers })
    }
}

fn paths(of: &[Selection]) -> String {
    of.iter().map(|selection| selection.path.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// A network's steering for each sample, computed in batches.
fn of_network(network: &Network, model: &LoadedModel, samples: &Arc<Samples>) -> Result<Vec<f64>, TrainError> {
    let inputs = Inputs::plain(model.preprocess().clone(), network.architecture().frames());
    Ok(measure(network, samples, &Cache::new(samples, 0), &inputs)?.1)
}

/// A model's steering for each sample, computed as while driving: a network made elsewhere takes one picture at a time.
fn of_pilot(model: &LoadedModel, samples: &Samples) -> Result<Vec<f64>, EvaluateError> {
    let (mut pilot, mut frame) = (model.pilot(), Frame::default());
    let answer = |sample: &Sample| {
        let row = &samples.sources[sample.source as usize].rows[sample.row as usize];
        let picture = row.pictures[sample.camera as usize].as_ref().ok_or(EvaluateError::NoPicture)?;
        let undecoded = |source| EvaluateError::Image { picture: picture.to_string(), source };
        decode_jpeg(&dataset::read(picture)?, &mut frame).map_err(undecoded)?;
        let view = View { speed: sample.speed, ..View::of(&frame) };
        let unanswered = |source| EvaluateError::Pilot { picture: picture.to_string(), source };
        Ok(pilot.steer(&view).map_err(unanswered)?.steering)
    };
    samples.samples.iter().map(answer).collect()
}

/// Which rows of a data set a training learnt from, judging by paths: a copy elsewhere counts as another data set. The
/// error is a path of the recipe at which there is nothing, if no other is that of the data set.
fn learnt_from<'a>(recipe: &'a Recipe, path: &Path) -> Result<impl Fn(usize) -> bool + 'a, &'a Path> {
    let measured = Selection::of(path).place();
    let same: Vec<&Selection> = recipe.data.iter().filter(|data| data.place() == measured).collect();
    let gone = recipe.data.iter().map(|data| data.path.as_path()).find(|path| !path.exists());
    if let Some(gone) = gone.filter(|_| same.is_empty()) {
        return Err(gone);
    }
    Ok(move |row| {
        let taken = same.iter().any(|data| data.rows.is_none_or(|(first, end)| (first..end).contains(&row)));
        // If there was separate validation data, no blocks were held out.
        taken && !(recipe.validation.is_empty() && recipe.blocks.is_validation(row))
    })
}

/// Width of a bin of steering over which errors are averaged.
const BIN: f64 = 0.1;

/// Each row's error over its label, and the mean of each bin.
fn errors(title: &str, answers: &[(f64, f64)]) -> Chart {
    let points: Vec<(f64, f64)> = answers.iter().map(|(label, answer)| (*label, answer - label)).collect();
    let mean = |bin: i32| {
        let middle = f64::from(bin) * BIN;
        let inside = points.iter().filter(|(label, _)| (label - middle).abs() <= BIN / 2.0);
        let (sum, count) = inside.fold((0.0, 0.0), |(sum, count), (_, error)| (sum + error, count + 1.0));
        (middle, if count > 0.0 { sum / count } else { f64::NAN })
    };
    let means = (-10..=10).map(mean).collect();
    let y = Axis::new("predicted minus recorded").from_to(-1.0, 1.0);
    Chart {
        series: vec![Series::new("rows", Marks::Points(points)), Series::new("mean", Marks::Line(means))],
        ..Chart::new(title, Axis::new("recorded steering").from_to(-1.0, 1.0), y)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn rows_were_learnt_from_where_the_recipe_has_them_and_does_not_hold_them_out() {
        let dir = tempfile::tempdir().unwrap();
        let lake = dir.path().join("lake");
        fs::create_dir(&lake).unwrap();
        let data = vec![Selection { rows: Some((20, 40)), ..Selection::of(&lake) }];
        let mut recipe = Recipe { data, blocks: Blocks { size: 10, every: 3 }, ..Recipe::default() };
        let rows = |recipe: &Recipe, path: &Path| {
            let learnt = learnt_from(recipe, path).unwrap();
            (0..50).filter(|row| learnt(*row)).collect::<Vec<_>>()
        };
        assert_eq!(rows(&recipe, &dir.path().join("./lake")), (20..30).collect::<Vec<_>>());
        assert!(rows(&recipe, dir.path()).is_empty());
        recipe.validation = vec![Selection::of("other")];
        assert_eq!(rows(&recipe, &lake), (20..40).collect::<Vec<_>>());
        // Of two data sets one is gone: it may be the one that is evaluated.
        recipe.data.push(Selection::of("gone"));
        assert_eq!(rows(&recipe, &lake), (20..40).collect::<Vec<_>>());
        assert_eq!(learnt_from(&recipe, dir.path()).err(), Some(Path::new("gone")));
    }
}

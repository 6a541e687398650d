//! Drives a suite: which of its cells are separate drives, driving them on all cores, and the outcome.

use std::{collections::BTreeSet, error::Error, path::Path, time::Instant};

use rayon::{
    ThreadPoolBuildError, ThreadPoolBuilder,
    iter::{ParallelBridge, ParallelIterator},
};

use super::{Cell, Contestant, Done, Plan, Results, ResultsError, Shard, Suite, SuiteOutcome, groups};
use crate::judged::Judged;

/// Drives a suite's cells with pilots and worlds that this module does not know.
pub trait Course: Sync {
    /// Why a cell cannot be driven.
    type Error: Error + Send + Sync + 'static;

    /// SHA-256 of a pilot's model; none for the expert.
    fn model_sha256(&self, pilot: &Contestant) -> Option<String>;

    /// Fills in a cell's settings and world: everything else that its drive depends on.
    ///
    /// # Errors
    /// What is wrong with them, reported before the first drive and not hours later.
    fn resolve(&self, cell: &mut Cell) -> Result<(), Self::Error>;

    /// Whether another seed would change the pictures of a resolved cell.
    fn left_to_chance(&self, cell: &Cell) -> bool;

    /// Drives a cell, into a run if one is wanted, and judges it; `None` if `stop` ended the drive.
    ///
    /// # Errors
    /// If it cannot be driven to its end, or its run not be recorded.
    fn drive(&self, cell: &Cell, run: Option<&Path>, stop: Stop<'_>) -> Result<Option<Judged>, Self::Error>;
}

/// Which drives of a suite leave a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Keep {
    /// Those that did not finish their laps, hit something or left the road
    #[default]
    Failed,
    /// All drives
    All,
    /// None
    None,
}

/// Whether to stop; called again and again.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// A suite's cells, each a drive of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// In the order of driving.
    pub cells: Vec<Cell>,
    /// How many more were left out because another seed would not change their drives.
    pub left_out: usize,
}

impl Planned {
    /// The cells of a suite, with all that they depend on, without any that would only repeat another.
    ///
    /// # Errors
    /// Those of [`Course::resolve`].
    pub fn new<C: Course>(suite: &Suite, course: &C) -> Result<Self, C::Error> {
        let mut cells = suite.cells(|pilot| course.model_sha256(pilot));
        cells.iter_mut().try_for_each(|cell| course.resolve(cell))?;
        let mut ids = BTreeSet::new();
        cells.retain(|cell| ids.insert(cell.id()));
        let all = cells.len();
        let cells = told_apart(cells, |cell| cell, |cell| course.left_to_chance(cell));
        Ok(Self { left_out: all - cells.len(), cells })
    }

    /// The plan to store beside the results.
    pub fn plan(&self) -> Plan {
        Plan::new(&self.cells)
    }

    /// The cells of a part, or of all, that have no result yet, in order, and how many have one.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn open(&self, shard: Option<Shard>, results: &Results) -> Result<(Vec<Cell>, Driven), ResultsError> {
        let (mut open, mut driven) = (vec![], Driven::default());
        for (_, cell) in self.cells.iter().enumerate().filter(|(i, _)| shard.is_none_or(|shard| shard.has(*i))) {
            match results.get(cell)? {
                Some(done) => {
                    driven.cells += 1;
                    driven.without_run += usize::from(done.run.is_none());
                }
                None => open.push(cell.clone()),
            }
        }
        Ok((open, driven))
    }

    /// The outcome of its results. Anything else in the folder does not belong to this suite.
    ///
    /// # Errors
    /// [`ResultsError::Io`].
    pub fn outcome(&self, results: &Results) -> Result<SuiteOutcome, ResultsError> {
        let done: Vec<_> =
            self.cells.iter().filter_map(|cell| results.get(cell).transpose()).collect::<Result<_, _>>()?;
        let missing = self.plan().missing(&done).len();
        Ok(SuiteOutcome::new(groups(&done), Some(self.cells.len()), missing))
    }
}

/// How many cells have a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Driven {
    /// All of them.
    pub cells: usize,
    /// Those whose run was not kept, or is gone.
    pub without_run: usize,
}

/// Those, in order, that do not repeat an earlier drive under another seed.
pub(super) fn told_apart<T>(
    mut all: Vec<T>,
    cell: impl Fn(&T) -> &Cell,
    left_to_chance: impl Fn(&Cell) -> bool,
) -> Vec<T> {
    let mut known = BTreeSet::new();
    all.retain(|one| whatever_the_seed(cell(one), &left_to_chance).is_none_or(|id| known.insert(id)));
    all
}

/// An id for the drive of a cell if it is the same under every seed; none if the seed changes it.
fn whatever_the_seed(cell: &Cell, left_to_chance: impl Fn(&Cell) -> bool) -> Option<String> {
    let mut unseeded = Cell { seed: 0, ..cell.clone() };
    if cell.model_sha256.is_none() {
        // The expert looks at no picture, and conditions change nothing else.
        unseeded.world = unseeded.world["track_sha256"].take();
    } else if left_to_chance(cell) {
        return None;
    }
    Some(unseeded.id())
}

/// Watches cells being driven, from several threads.
pub trait Watch: Sync {
    /// A cell begins.
    fn begins(&self, cell: &Cell);
    /// A result is stored.
    fn done(&self, done: &Done);
}

/// Why a suite was not driven to its end.
#[derive(Debug, thiserror::Error)]
pub enum DriveError<E: Error + 'static> {
    /// A cell cannot be driven.
    #[error("{cell}")]
    Cell {
        /// The cell, by its name for people.
        cell: String,
        /// Why not.
        source: E,
    },
    /// A result cannot be stored.
    #[error("{cell}")]
    Results {
        /// The cell, by its name for people.
        cell: String,
        /// Why not.
        source: ResultsError,
    },
    /// A scorecard cannot be written as JSON.
    #[error("{cell}")]
    Card {
        /// The cell, by its name for people.
        cell: String,
        /// Why not.
        source: serde_json::Error,
    },
    /// The system gives no threads.
    #[error("no threads to drive with")]
    Threads(#[source] ThreadPoolBuildError),
}

/// Drives cells in order, several at a time (by default one per core), and stores each result as soon as it is there,
/// with the runs that are to be kept. The first error ends everything, and so does `stop`: unfinished drives are not
/// stored.
///
/// # Errors
/// [`DriveError`], the first.
pub fn drive_all<C: Course>(
    course: &C,
    open: Vec<Cell>,
    (results, keep): (&Results, Keep),
    jobs: Option<u16>,
    stop: Stop<'_>,
    watch: &impl Watch,
) -> Result<(), DriveError<C::Error>> {
    let jobs = jobs.map_or(0, usize::from); // 0 is one per core
    let pool = ThreadPoolBuilder::new().num_threads(jobs).build().map_err(DriveError::Threads)?;
    pool.install(|| {
        let cells = open.into_iter().par_bridge().take_any_while(|_| !stop());
        cells.try_for_each(|cell| drive_one(course, cell, (results, keep), stop, watch))
    })
}

fn drive_one<C: Course>(
    course: &C,
    cell: Cell,
    (results, keep): (&Results, Keep),
    stop: Stop<'_>,
    watch: &impl Watch,
) -> Result<(), DriveError<C::Error>> {
    watch.begins(&cell);
    let (name, began) = (cell.to_string(), Instant::now());
    let failed = |source| DriveError::Results { cell: name.clone(), source };
    let run = match keep {
        Keep::Failed | Keep::All => Some(results.room_for_run(&cell).map_err(failed)?),
        Keep::None => {
            // What a drive that was killed left there belongs to no result.
            results.drop_run(&cell).map_err(failed)?;
            None
        }
    };
    let driven = course.drive(&cell, run.as_deref(), stop);
    let Ok(Some(Judged { card, driven })) = driven else {
        // What there is of the run belongs to no result.
        run.map_or(Ok(()), |_| results.drop_run(&cell)).map_err(failed)?;
        return driven.map(drop).map_err(|source| DriveError::Cell { cell: name.clone(), source });
    };
    let card = serde_json::to_value(card).map_err(|source| DriveError::Card { cell: name.clone(), source })?;
    let bad_frames = driven.bad_in_words().and_then(Result::err);
    let mut done = Done::new(cell, card, driven.fingerprint, began.elapsed().as_secs_f64());
    done.bad_frames = bad_frames;
    if run.is_some() {
        if keep == Keep::All || done.failed().is_some() {
            done.run = Some(Results::run_name(&done.cell));
        } else {
            results.drop_run(&done.cell).map_err(failed)?;
        }
    }
    results.keep(&done).map_err(failed)?;
    watch.done(&done);
    Ok(())
}

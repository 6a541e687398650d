//! Work that may take its time: networks that are shown a recorded run, and what networks look at.
//!
//! It is done piece by piece on one thread of low priority, which gives way to whatever drives. A piece is small (one picture explained, a few frames shown), so nobody waits long for their turn, and
//! whoever is gone before it has come is skipped.

use std::{
    sync::{
        OnceLock,
        mpsc::{self, Sender},
    },
    thread,
};

use tokio::sync::oneshot;

type Piece = Box<dyn FnOnce() + Send>;

/// Where such work is handed in. Its thread begins with the first piece, and ends with the desk.
#[derive(Debug, Default)]
pub(super) struct Desk(OnceLock<Option<Sender<Piece>>>);

/// The piece was not done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the thread for work beside the drives is gone")]
pub(super) struct Gone;

impl Desk {
    /// Does a piece of work once those before it are done; does nothing if this is dropped before.
    pub async fn work<T: Send + 'static>(&self, piece: impl FnOnce() -> T + Send + 'static) -> Result<T, Gone> {
        let (done, result) = oneshot::channel();
        let piece: Piece = Box::new(move || {
            if !done.is_closed() {
                // An error means that nobody waits any more.
                let _ = done.send(piece());
            }
        });
        let pieces = self.0.get_or_init(start).as_ref().ok_or(Gone)?;
        pieces.send(piece).map_err(|_| Gone)?;
        result.await.map_err(|_| Gone)
    }
}

fn start() -> Option<Sender<Piece>> {
    let (pieces, handed_in) = mpsc::channel::<Piece>();
    let work = move || {
        take_low_priority();
        handed_in.into_iter().for_each(|piece| piece());
    };
    match thread::Builder::new().name("beside the drives".into()).spawn(work) {
        Ok(_) => Some(pieces),
        Err(error) => {
            tracing::warn!("no thread for work beside the drives: {error}");
            None
        }
    }
}

/// Its niceness: where all processors are busy it gets a tenth of what a drive gets. (At 19, the most, it got nothing at
/// all in three seconds beside a dozen other busy programs.)
#[cfg(target_os = "linux")]
const NICE: i32 = 10;

/// The calling thread, and those that libtorch begins from it, give way to others.
#[cfg(target_os = "linux")]
fn take_low_priority() {
    // SAFETY: no pointer is passed; on Linux 0 is the calling thread, not the process.
    if unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICE) } != 0 {
        let error = std::io::Error::last_os_error();
        tracing::warn!("work beside the drives has no lower priority than they have: {error}");
    }
}

/// Elsewhere its priority is the drives'.
#[cfg(not(target_os = "linux"))]
fn take_low_priority() {}

#[cfg(test)]
mod tests {
    use std::{
        sync::atomic::{AtomicBool, Ordering},
        sync::{Arc, Barrier},
    };

    use super::*;

    #[tokio::test]
    async fn pieces_are_done_in_turn_and_none_that_nobody_waits_for() {
        let (desk, was_done) = (Desk::default(), Arc::new(AtomicBool::new(false)));
        let (busy, free) = (Arc::new(Barrier::new(2)), Arc::new(Barrier::new(2)));
        let first = {
            let (busy, free) = (busy.clone(), free.clone());
            desk.work(move || {
                busy.wait();
                free.wait();
                1
            })
        };
        let abandoned = {
            let was_done = was_done.clone();
            desk.work(move || was_done.store(true, Ordering::SeqCst))
        };
        let mut first = Box::pin(first);
        tokio::select! {
            biased;
            _ = &mut first => unreachable!("it waits"),
            () = std::future::ready(()) => {}
        }
        busy.wait();
        {
            let mut abandoned = Box::pin(abandoned);
            tokio::select! {
                biased;
                _ = &mut abandoned => unreachable!("the one before it is not done"),
                () = std::future::ready(()) => {}
            }
        }
        free.wait();
        assert_eq!(first.await, Ok(1));
        assert_eq!(desk.work(|| 3).await, Ok(3));
        assert!(!was_done.load(Ordering::SeqCst));
    }

    #[cfg(target_os = "linux")]
    #[tokio::test]
    async fn its_thread_alone_gives_way() {
        // SAFETY: no pointer is passed.
        let priority = || unsafe { libc::getpriority(libc::PRIO_PROCESS, 0) };
        let before = priority();
        assert_eq!(Desk::default().work(priority).await, Ok(NICE));
        assert_eq!(priority(), before);
    }
}

//! Work that may take its time: networks that are shown a recorded run, and what networks look at.
//!
//! It is done piece by piece on one thread of low priority, which gives way to whatever drives. A piece is small (one
//! picture explained, a few frames shown), so nobody waits long for their turn, and whoever is gone before it has come is
//! skipped.

use std::{
    io,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Sender},
    },
    thread::{self, JoinHandle},
};

use tokio::{sync::oneshot, task::spawn_blocking};

type Piece = Box<dyn FnOnce() + Send>;

/// Where such work is handed in. Its thread begins with the first piece.
#[derive(Debug, Default)]
pub(super) struct Desk(Mutex<Opening>);

#[derive(Debug, Default)]
enum Opening {
    #[default]
    NotYet,
    Open {
        pieces: Sender<Piece>,
        closing: Arc<AtomicBool>,
        thread: JoinHandle<()>,
    },
    Closed,
}

/// The piece was not done.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum Gone {
    #[error("no thread for work beside the drives: {0}")]
    NoThread(io::ErrorKind),
    #[error("the program ends")]
    Closed,
}

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
        self.hand_in(piece)?;
        result.await.map_err(|_| Gone::Closed)
    }

    fn hand_in(&self, piece: Piece) -> Result<(), Gone> {
        let mut opening = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*opening, Opening::NotYet) {
            *opening = Opening::now().map_err(|error| Gone::NoThread(error.kind()))?;
        }
        match &*opening {
            Opening::Open { pieces, .. } => pieces.send(piece).map_err(|_| Gone::Closed),
            Opening::NotYet | Opening::Closed => Err(Gone::Closed),
        }
    }

    /// Takes nothing more, and waits until the piece is done that is being done: a program that ends while a network is at
    /// work takes its memory away from under it.
    pub async fn close(&self) {
        let opening = std::mem::replace(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner), Opening::Closed);
        if let Opening::Open { pieces, closing, thread } = opening {
            closing.store(true, Ordering::Release);
            drop(pieces);
            // Errors would be a panic of the thread, which has told of itself, or of this task.
            let _ = spawn_blocking(|| thread.join()).await;
        }
    }
}

impl Opening {
    fn now() -> io::Result<Self> {
        let (pieces, handed_in) = mpsc::channel::<Piece>();
        let closing = Arc::new(AtomicBool::new(false));
        let is_closing = closing.clone();
        let work = move || {
            take_low_priority();
            handed_in.into_iter().take_while(|_| !is_closing.load(Ordering::Acquire)).for_each(|piece| piece());
        };
        let thread = thread::Builder::new().name("beside the drives".into()).spawn(work)?;
        Ok(Self::Open { pieces, closing, thread })
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
    use std::sync::Barrier;

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

    #[tokio::test]
    async fn a_desk_that_closes_waits_for_the_piece_that_is_being_done_and_takes_no_other() {
        let (desk, busy) = (Arc::new(Desk::default()), Arc::new(Barrier::new(2)));
        let done = Arc::new(AtomicBool::new(false));
        let piece = {
            let (desk, busy, done) = (desk.clone(), busy.clone(), done.clone());
            tokio::spawn(async move {
                let piece = move || {
                    busy.wait();
                    thread::sleep(std::time::Duration::from_millis(50));
                    done.store(true, Ordering::SeqCst);
                };
                desk.work(piece).await
            })
        };
        spawn_blocking(move || busy.wait()).await.unwrap();
        desk.close().await;
        assert!(done.load(Ordering::SeqCst));
        assert_eq!((piece.await.unwrap(), desk.work(|| ()).await), (Ok(()), Err(Gone::Closed)));
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

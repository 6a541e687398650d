//! How many may do something at a time: look at a page, watch in Foxglove, compare runs.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// At most so many places.
#[derive(Debug)]
pub(crate) struct Places<const MOST: u32>(Arc<Semaphore>);

/// One of them, free again when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    _permit: OwnedSemaphorePermit,
}

impl<const MOST: u32> Default for Places<MOST> {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(MOST as usize)))
    }
}

impl<const MOST: u32> Places<MOST> {
    /// A place, if one is free.
    pub fn take(&self) -> Option<Place> {
        let permit = self.0.clone().try_acquire_owned().ok()?;
        Some(Place { _permit: permit })
    }

    /// How many are taken.
    pub fn taken(&self) -> usize {
        (MOST as usize).saturating_sub(self.0.available_permits())
    }

    /// Waits until all are free.
    pub async fn all_free(&self) {
        // It is never closed, so this is no error.
        let _ = self.0.acquire_many(MOST).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn one_who_leaves_makes_room_and_once_all_have_left_all_places_are_free() {
        let places = Places::<2>::default();
        let (first, second) = (places.take(), places.take());
        assert!(first.is_some() && second.is_some() && places.take().is_none());
        assert_eq!(places.taken(), 2);
        drop(first);
        let third = places.take();
        assert!(third.is_some());
        let leave = async { drop((second, third)) };
        tokio::join!(places.all_free(), leave);
        assert_eq!(places.taken(), 0);
    }
}

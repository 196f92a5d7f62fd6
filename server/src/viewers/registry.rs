//! Who is connected.

use std::collections::BTreeMap;
use std::ops::Deref;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, PoisonError, RwLock};

use skycell_protocol::ViewerId;
use thiserror::Error;

use super::pixels::{PixelBudget, TooManyPixels};
use super::viewer::Viewer;
use crate::frame_loop::interface::ViewRequest;

/// As many viewers are connected as may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("{viewers_max} viewers are connected, and no more are allowed; try again later")]
pub struct TooManyViewers {
    /// How many may be.
    pub viewers_max: u32,
}

/// Why nobody more may join.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum JoinError {
    /// As many viewers as may be.
    #[error(transparent)]
    Viewers(#[from] TooManyViewers),
    /// As many pixels as may be.
    #[error(transparent)]
    Pixels(#[from] TooManyPixels),
}

/// The viewers that are connected, at most `viewers_max`.
pub struct ViewerRegistry {
    viewers_max: u32,
    pixels: Arc<PixelBudget>,
    next_id: AtomicU32,
    viewers: RwLock<BTreeMap<ViewerId, Arc<Viewer>>>,
}

impl ViewerRegistry {
    /// An empty registry for at most `viewers_max`.
    pub fn new(viewers_max: u32) -> Arc<Self> {
        Self::with_pixels(viewers_max, u64::MAX)
    }

    /// The same for frames of at most `pixels_max` pixels together.
    pub fn with_pixels(viewers_max: u32, pixels_max: u64) -> Arc<Self> {
        Arc::new(Self {
            viewers_max,
            pixels: PixelBudget::new(pixels_max),
            next_id: AtomicU32::new(1),
            viewers: RwLock::default(),
        })
    }

    /// Adds a viewer, for as long as the membership lives.
    ///
    /// # Errors
    /// If as many are connected as may be, or their frames have as many pixels as may be.
    pub fn join(self: &Arc<Self>, view: ViewRequest) -> Result<ViewerMembership, JoinError> {
        let mut viewers = self.viewers.write().unwrap_or_else(PoisonError::into_inner);
        if viewers.len() >= self.viewers_max as usize {
            return Err(JoinError::Viewers(TooManyViewers {
                viewers_max: self.viewers_max,
            }));
        }
        let pixels = self.pixels.share(u64::from(view.picture_size().pixels()))?;
        // Wraps after 4 thousand million connections; those that are still there are skipped.
        let id = loop {
            let id = ViewerId(self.next_id.fetch_add(1, Ordering::Relaxed));
            if !viewers.contains_key(&id) {
                break id;
            }
        };
        let viewer = Arc::new(Viewer::new(id, view, pixels));
        viewers.insert(id, Arc::clone(&viewer));
        Ok(ViewerMembership {
            registry: Arc::clone(self),
            viewer,
        })
    }

    /// The viewer of that number, if it is connected.
    pub fn get(&self, id: ViewerId) -> Option<Arc<Viewer>> {
        self.viewers
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .get(&id)
            .cloned()
    }

    /// Everyone who is connected, by number.
    pub fn all(&self) -> Vec<Arc<Viewer>> {
        self.viewers
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .values()
            .cloned()
            .collect()
    }

    /// How many are connected.
    pub fn count(&self) -> usize {
        self.viewers
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .len()
    }
}

/// As long as it lives, its viewer is connected.
pub struct ViewerMembership {
    registry: Arc<ViewerRegistry>,
    viewer: Arc<Viewer>,
}

impl Deref for ViewerMembership {
    type Target = Arc<Viewer>;

    fn deref(&self) -> &Arc<Viewer> {
        &self.viewer
    }
}

impl Drop for ViewerMembership {
    fn drop(&mut self) {
        self.registry
            .viewers
            .write()
            .unwrap_or_else(PoisonError::into_inner)
            .remove(&self.viewer.id());
        self.viewer.close();
    }
}

#[cfg(test)]
mod tests {
    use skycell_protocol::{Camera, Codec, FrameSize, RendererKind};

    use super::*;

    fn view() -> ViewRequest {
        ViewRequest {
            size: FrameSize::new(4, 4).expect("in range"),
            fps: 30.0,
            codec: Codec::Jpeg,
            jpeg_quality: 85,
            camera: Camera::default(),
            renderer: RendererKind::Cached,
            quality: None,
            show: skycell_protocol::Show::Picture,
            stereo: None,
            haze: true,
            linear: false,
        }
    }

    #[test]
    fn no_more_viewers_join_than_may_and_who_leaves_makes_room() {
        let registry = ViewerRegistry::new(2);
        let first = registry.join(view()).expect("room");
        let second = registry.join(view()).expect("room");
        assert!(first.id() != second.id());
        assert_eq!(
            registry.join(view()).err(),
            Some(JoinError::Viewers(TooManyViewers { viewers_max: 2 }))
        );
        let gone = first.id();
        drop(first);
        assert!(registry.get(gone).is_none());
        let third = registry.join(view()).expect("room");
        assert!(third.id() != gone, "numbers are not given twice");
        assert_eq!(registry.count(), 2);
    }
}

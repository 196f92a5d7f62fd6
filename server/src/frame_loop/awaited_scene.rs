//! A scene that has been announced and is not shown yet: its pipelines are made on another thread, beside the frames of the
//! scene before it. What the sky misses meanwhile it catches up with (`sky_time`).

use super::renderer::SkyRenderer;
use crate::clock;
use crate::gpu::{GpuError, PipelineKey, blend_key};
use crate::march::{active_layers, placed_weather};
use skycell_protocol::{Moment, Scene};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Pipelines that take longer are made by the render thread: whatever has become of the other one, the scene is shown.
const WAIT_MAX: Duration = Duration::from_secs(60);

/// A scene that is waited for.
pub(super) struct AwaitedScene {
    document: Arc<Scene>,
    revision: u64,
    keys: Vec<PipelineKey>,
    announced: Instant,
}

impl SkyRenderer {
    /// Has a scene shown once all its pipelines are there; a scene that still waited is dropped.
    pub(super) fn await_scene(&mut self, document: Arc<Scene>, revision: u64) {
        let keys = self.keys_of_document(&document, clock::now());
        self.pipelines.prepare_later(&self.gpu, keys.clone());
        // The sky has been held up since the first of those that follow each other.
        let announced = self
            .awaited
            .take()
            .map_or_else(Instant::now, |before| before.announced);
        self.awaited = Some(AwaitedScene {
            document,
            revision,
            keys,
            announced,
        });
    }

    /// Takes over the scene that is waited for when everything is there, or when nobody looks. True when it was.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub(super) fn take_awaited_scene(&mut self) -> Result<bool, GpuError> {
        let is_ready = |awaited: &mut AwaitedScene| {
            self.viewers.is_empty()
                || awaited.announced.elapsed() > WAIT_MAX
                || !awaited.keys.iter().any(|key| self.pipelines.is_coming(key))
        };
        let Some(awaited) = self.awaited.take_if(is_ready) else {
            return Ok(false);
        };
        self.sky_time.hold_up(awaited.announced.elapsed());
        self.set_scene(awaited.document, awaited.revision)?;
        Ok(true)
    }

    /// Pipelines of the scene that a document shows at a moment, and of those that it passes through.
    fn keys_of_document(&self, document: &Scene, now: Moment) -> Vec<PipelineKey> {
        let scene = document.at(now);
        let mut keys = self.pipeline_keys(&scene);
        if placed_weather(&scene, &active_layers(&scene))
            .iter()
            .any(|placed| placed.weather.maps().transition_s() > 0.0)
        {
            keys.push(blend_key());
        }
        if let Some(transition) = document.transition() {
            for moment in [Moment::MIN, transition.ends()] {
                keys.extend(self.pipeline_keys(&document.at(moment)));
            }
        }
        keys
    }
}

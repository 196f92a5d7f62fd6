//! The sky in time: when the scene of the present moment is worked out, and what it costs. A sky that moves ages texels by
//! how far it has moved, and each is mixed towards the present when it is its turn: nothing jumps, and the march's share of
//! the device bounds the cost, not the speed of the sky.

use super::interface::SkyTimeStats;
use super::renderer::SkyRenderer;
use super::sky_steps::{Steps, steps_between};
use crate::cache::SphereId;
use crate::gpu::GpuError;
use crate::march::{ActiveLayer, LayerBlend, active_layers, placed_sheets, placed_weather};
use skycell_protocol::{CellId, Moment, Scene};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The scene of the moment is worked out this often at most: 25 times a second, as often as pictures change.
const EVALUATE_INTERVAL: Duration = Duration::from_millis(40);
/// What has moved by less of a step than this is not taken over: nobody sees it, and a slow sun would cost a frame a time.
const STEP_MIN: f64 = 1.0 / 16.0;

/// How the sky follows its document.
#[derive(Debug)]
pub(super) struct SkyTime {
    /// What the user wrote.
    document: Arc<Scene>,
    /// The moment of the scene that is shown; none for single pictures, whose scene stands still.
    shown: Option<Moment>,
    /// When the scene was worked out last.
    evaluated: Instant,
    /// Seconds of wind that pass in a second.
    wind_rate: f64,
    /// Seconds of sky time that pass in a second.
    rate: f64,
    /// Whether the scene that is shown is not the last one.
    moves: bool,
    evaluations: u64,
    /// Scenes that were taken over.
    taken: u64,
}

impl SkyTime {
    pub(super) fn standing(document: Arc<Scene>) -> Self {
        Self {
            document,
            shown: None,
            evaluated: Instant::now(),
            wind_rate: 1.0,
            rate: 1.0,
            moves: false,
            evaluations: 0,
            taken: 0,
        }
    }

    /// Whether something but clouds in the wind moves.
    pub(super) fn moves(&self) -> bool {
        self.moves
    }

    /// Whether time passes: nobody waits for a frame of a single picture.
    pub(super) fn is_live(&self) -> bool {
        self.shown.is_some()
    }

    pub(super) fn wind_rate(&self) -> f64 {
        self.wind_rate
    }

    pub(super) fn rate(&self) -> f64 {
        self.rate
    }

    /// How fast time passes at a moment.
    fn keep_pace(&mut self, now: Moment) {
        let clock = self.document.clock();
        self.wind_rate = self.document.wind_rate_at(now);
        self.rate = if clock.is_running(now) {
            clock.rate()
        } else {
            0.0
        };
    }

    /// Scenes that the sky passes through which may have other layers than it has now: their pipelines are made before.
    pub(super) fn to_come(&self) -> Vec<Scene> {
        let transition = self.document.transition();
        transition.map_or_else(Vec::new, |transition| {
            vec![
                self.document.at(Moment::MIN),
                self.document.at(transition.ends()),
            ]
        })
    }

    pub(super) fn stats(&self, now: Moment) -> SkyTimeStats {
        let sky_s = self.document.clock().sky_s(now);
        let place = self.document.sun().place_and_time();
        SkyTimeStats {
            sky_s,
            date: place.map(|place| place.date_at(sky_s).to_string()),
            rate: self.document.clock().rate(),
            running: self.document.clock().is_running(now),
            moves: self.moves,
            evaluations: self.evaluations,
            taken: self.taken,
        }
    }
}

impl SkyRenderer {
    /// From now on the scene is that of the present moment.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub(super) fn let_time_pass(
        &mut self,
        document: Arc<Scene>,
        revision: u64,
    ) -> Result<(), GpuError> {
        self.sky_time.shown = Some(Moment::MIN);
        self.set_scene(document, revision)
    }

    /// Takes a document over; returns the scene to show.
    pub(super) fn take_document(&mut self, document: Arc<Scene>, now: Moment) -> Arc<Scene> {
        let time = &mut self.sky_time;
        time.document = document;
        time.evaluated = Instant::now();
        if time.shown.is_none() {
            return time.document.clone();
        }
        time.shown = Some(now);
        time.keep_pace(now);
        time.moves = time.document.is_animated_after(now);
        self.caches.set_calm(!time.moves);
        Arc::new(time.document.at(now))
    }

    /// Brings clouds to where the wind has them now and, when it is time and somebody sees it, the scene to what it is now.
    /// True when something else is to be seen.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub(super) fn follow_time(&mut self, now: Moment, is_seen: bool) -> Result<bool, GpuError> {
        let Some(shown) = self.sky_time.shown else {
            return Ok(false);
        };
        self.drifts = self.sky_time.document.carried_by(self.scene.layers(), now);
        self.sky_time.keep_pace(now);
        let due = self.sky_time.evaluated.elapsed() >= EVALUATE_INTERVAL;
        let document = self.sky_time.document.clone();
        if !due || !is_seen || !(self.sky_time.moves || document.is_animated_after(shown)) {
            return Ok(false);
        }
        self.sky_time.evaluated = Instant::now();
        self.sky_time.evaluations += 1;
        let scene = document.at(now);
        let moves = document.is_animated_after(now);
        let steps = steps_between(&self.scene, &scene);
        let ends = self.sky_time.moves && !moves;
        self.sky_time.moves = moves;
        self.caches.set_calm(!moves);
        let least = if ends { 0.0 } else { STEP_MIN };
        if steps.largest() <= least {
            return Ok(ends);
        }
        self.sky_time.shown = Some(now);
        self.sky_time.taken += 1;
        self.take_moment(Arc::new(scene), &steps)?;
        Ok(true)
    }

    /// Takes over the scene of another moment of the same document.
    fn take_moment(&mut self, scene: Arc<Scene>, steps: &Steps) -> Result<(), GpuError> {
        let ideal = active_layers(&scene);
        let changes = steps.layers_change
            || ideal.len() != self.active.len()
            || ideal.iter().any(|layer| {
                !self
                    .active
                    .iter()
                    .any(|a| a.scene_index == layer.scene_index)
                    || shell(&self.scene, layer) != shell(&scene, layer)
            });
        let blend = LayerBlend::of(&self.scene, &self.active);
        if changes || LayerBlend::of(&scene, &ideal) != blend {
            // Made when the document was taken over, but for a blend that no end of a transition has.
            self.prepare_pipelines(&scene)?;
        }
        if changes {
            let before: Vec<&str> = self
                .active
                .iter()
                .map(|layer| self.scene.layers()[layer.scene_index].name())
                .collect();
            let kept: Vec<Option<usize>> = ideal
                .iter()
                .map(|layer| {
                    let name = scene.layers()[layer.scene_index].name();
                    let place = before.iter().position(|other| *other == name)?;
                    let stays = shell(&self.scene, &self.active[place]) == shell(&scene, layer);
                    stays.then_some(place)
                })
                .collect();
            let active = ideal
                .iter()
                .zip(&kept)
                .map(|(layer, kept)| ActiveLayer {
                    proxy_altitude_m: kept
                        .map_or(layer.proxy_altitude_m, |k| self.active[k].proxy_altitude_m),
                    ..*layer
                })
                .collect();
            self.active = active;
            self.scene = scene;
            self.place_clouds();
            self.inspections = None;
            self.keep_layers(&kept);
        } else {
            // Proxy spheres stay where they are while types change: the texels on them stay where they are.
            self.scene = scene;
        }
        self.ideal_active = ideal;
        // What is other for a layer is told by its steps; places alone may have changed.
        let maps = placed_weather(&self.scene, &self.active);
        let sheets = placed_sheets(&self.scene, &self.active);
        let layout = &self.pipelines.field_layout;
        let change = self
            .field
            .set_maps(&self.gpu, layout, &maps, &sheets, &self.config.maps_dir);
        if change.textures {
            for cell in self.active_cells.values_mut() {
                cell.buffers.set_field_group(&self.field.bind_group);
            }
        }
        let cloud_altitude_m = self
            .active
            .first()
            .map_or(0.0, |layer| layer.proxy_altitude_m);
        self.take_light(cloud_altitude_m);
        self.age_by(steps);
        self.audit.tiles_changed();
        // What exposure follows has moved.
        self.prepare_meters()
    }

    /// The texels of each layer are behind by its steps.
    pub(super) fn age_by(&mut self, steps: &Steps) {
        let of_layers: Vec<f64> = self
            .active
            .iter()
            .map(|layer| steps.of_layer(self.scene.layers()[layer.scene_index].name()))
            .collect();
        self.caches.age_by(&of_layers);
    }

    /// Gives every cell the present layers: of those that were there before, at the given places, the texels stay.
    fn keep_layers(&mut self, kept: &[Option<usize>]) {
        let ids: Vec<CellId> = self.active_cells.keys().copied().collect();
        for id in ids {
            let places: Vec<Option<u32>> = kept
                .iter()
                .map(|kept| kept.map(|place| place as u32))
                .collect();
            self.caches.keep_layers(id, &places);
            if let Some(mut cell) = self.active_cells.remove(&id) {
                self.keep_anchors(&mut cell, kept);
                self.active_cells.insert(id, cell);
            }
            for layer in 0..kept.len() as u32 {
                // Made now, so that its table is written with the others'.
                self.caches
                    .sphere_mut(SphereId { cell: id, layer })
                    .tables_change();
            }
        }
        for viewer in self.viewers.values_mut() {
            viewer.requests.clear();
            viewer.screen_space = None;
        }
    }
}

/// Where a layer begins and ends.
fn shell(scene: &Scene, layer: &ActiveLayer) -> Option<[f64; 2]> {
    let layer = scene.layers().get(layer.scene_index)?;
    Some([layer.base_altitude_m(), layer.top_altitude_m()])
}

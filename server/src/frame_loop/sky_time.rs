//! The sky in time: when the scene of the present moment is worked out, and what it costs. A sky that moves ages texels by
//! how far it has moved, and each is mixed towards the present when it is its turn: nothing jumps, and the march's share of
//! the device bounds the cost, not the speed of the sky.

use super::interface::SkyTimeStats;
use super::renderer::SkyRenderer;
use super::sky_steps::{Steps, steps_between};
use crate::cache::{SkyWay, SphereId};
use crate::gpu::GpuError;
use crate::march::{ActiveLayer, LayerBlend, active_layers, keep_places};
use crate::march::{look_where_clouds_are, placed_sheets, placed_weather};
use skycell_protocol::{CellId, Moment, Scene};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The scene of the moment is worked out this often at most: 25 times a second, as often as pictures change.
const EVALUATE_INTERVAL: Duration = Duration::from_millis(40);
/// What has moved by less of a step than this is not taken over: nobody sees it, and a slow sun would cost a frame a time.
const STEP_MIN: f64 = 1.0 / 16.0;

/// The sky that is shown goes on by no more at once, s: what held it up for longer is caught up with.
const STALL_MAX_S: f64 = 0.25;
/// Pictures that take longer to come from the device are not waited for: they may never come.
const PICTURES_WAIT_MAX: Duration = Duration::from_secs(10);
/// Seconds that are caught up with in a second.
const CATCH_UP_RATE: f64 = 1.0;
/// A sky that is farther behind jumps, s.
const LAG_MAX_S: f64 = 30.0;

/// How far the sky that is shown is behind the present moment because something held it up. It is never longer behind than it
/// takes to catch up, and not at all where nobody has looked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Lag {
    seconds: f64,
}

impl Lag {
    /// The sky was held up.
    fn hold_up(&mut self, seconds: f64) {
        self.seconds = (self.seconds + seconds).min(LAG_MAX_S);
    }

    /// Time has passed since the sky was shown last.
    fn pass(&mut self, seconds: f64) {
        if seconds > STALL_MAX_S {
            self.hold_up(seconds - STALL_MAX_S);
        } else {
            self.seconds = (self.seconds - CATCH_UP_RATE * seconds).max(0.0);
        }
    }

    /// The moment to show.
    fn behind(self, now: Moment) -> Moment {
        now.plus_s(-self.seconds)
    }
}

/// How the sky follows its document.
#[derive(Debug)]
pub(super) struct SkyTime {
    /// What the user wrote.
    document: Arc<Scene>,
    /// The moment of the scene that is shown; none for single pictures, whose scene stands still.
    shown: Option<Moment>,
    /// When the scene was worked out last.
    evaluated: Instant,
    /// Whether somebody has looked since.
    was_seen: bool,
    /// Pictures that had been composited by then.
    composited: u64,
    lag: Lag,
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
            was_seen: false,
            composited: 0,
            lag: Lag::default(),
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

    /// The next document comes late.
    pub(super) fn hold_up(&mut self, time: Duration) {
        self.lag.hold_up(time.as_secs_f64());
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
        self.is_living = true;
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
        time.keep_pace(now);
        let moment = time.lag.behind(now);
        time.shown = Some(moment);
        time.moves = time.document.is_animated_after(moment);
        self.caches.set_calm(!time.moves);
        Arc::new(time.document.at(moment))
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
        if !is_seen {
            self.sky_time.lag = Lag::default();
            self.sky_time.was_seen = false;
        }
        if !due || !is_seen || !(self.sky_time.moves || document.is_animated_after(shown)) {
            return Ok(false);
        }
        let passed = self.sky_time.evaluated.elapsed();
        // A device that is held up (a driver may compile at the first dispatch) shows nothing: the sky waits for it.
        if self.frames_read_back() < self.sky_time.composited && passed < PICTURES_WAIT_MAX {
            return Ok(false);
        }
        self.sky_time.composited = self.counters.frames_composited;
        if std::mem::replace(&mut self.sky_time.was_seen, true) {
            self.sky_time.lag.pass(passed.as_secs_f64());
        }
        self.sky_time.evaluated = Instant::now();
        self.sky_time.evaluations += 1;
        let moment = self.sky_time.lag.behind(now);
        let scene = document.at(moment);
        let moves = document.is_animated_after(moment);
        let steps = steps_between(&self.scene, &scene);
        let ends = self.sky_time.moves && !moves;
        self.sky_time.moves = moves;
        self.caches.set_calm(!moves);
        let least = if ends { 0.0 } else { STEP_MIN };
        if steps.largest() <= least {
            return Ok(ends);
        }
        self.sky_time.shown = Some(moment);
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
        if changes || LayerBlend::of(&scene, &ideal, &self.kept_on) != self.blend() {
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
            self.scene = scene;
            let before = self.proxies.clone();
            self.set_active(active);
            keep_places(
                &mut self.proxies,
                &before,
                &kept,
                self.kept_on.parts() as usize,
            );
            look_where_clouds_are(&mut self.proxies, &self.scene);
            self.place_clouds();
            self.inspections = None;
            self.keep_layers(&kept);
        } else {
            // Proxy spheres stay where they are while types change: the texels on them stay where they are.
            self.scene = scene;
            look_where_clouds_are(&mut self.proxies, &self.scene);
        }
        self.ideal_active = ideal;
        // What is other for a layer is told by its steps; places alone may have changed.
        self.take_maps();
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

    /// Lets marches read the maps that the scene of now names.
    pub(super) fn take_maps(&mut self) {
        let maps = placed_weather(&self.scene, &self.active);
        let sheets = placed_sheets(&self.scene, &self.active);
        let layout = &self.pipelines.field_layout;
        let change = self
            .field
            .set_maps(&self.gpu, layout, &maps, &sheets, &self.config.maps_dir);
        self.field_epoch += u64::from(change.content);
        if change.textures {
            for cell in self.active_cells.values_mut() {
                cell.buffers.set_field_group(&self.field.bind_group);
            }
        }
    }

    /// The texels of each layer are behind by its steps.
    pub(super) fn age_by(&mut self, steps: &Steps) {
        let of_proxies: Vec<SkyWay> = self
            .proxies
            .iter()
            .map(|proxy| steps.of_layer(self.scene.layers()[proxy.scene_index].name()))
            .collect();
        self.caches.age_by(&of_proxies);
    }

    /// Gives every cell the present layers: of those that were there before, at the given places, the texels stay.
    fn keep_layers(&mut self, kept: &[Option<usize>]) {
        let ids: Vec<CellId> = self.active_cells.keys().copied().collect();
        for id in ids {
            let parts = self.kept_on.parts();
            let places: Vec<Option<u32>> = kept
                .iter()
                .flat_map(|kept| {
                    (0..parts).map(move |part| kept.map(|place| place as u32 * parts + part))
                })
                .collect();
            self.caches.keep_proxies(id, &places);
            if let Some(mut cell) = self.active_cells.remove(&id) {
                self.keep_anchors(&mut cell, kept);
                self.active_cells.insert(id, cell);
            }
            for proxy in 0..self.proxies.len() as u32 {
                // Made now, so that its table is written with the others'.
                self.caches
                    .sphere_mut(SphereId { cell: id, proxy })
                    .tables_change();
            }
        }
        for viewer in self.viewers.values_mut() {
            viewer.forget_requests();
            viewer.screen_space = None;
        }
    }
}

/// Where a layer begins and ends.
fn shell(scene: &Scene, layer: &ActiveLayer) -> Option<[f64; 2]> {
    let layer = scene.layers().get(layer.scene_index)?;
    Some([layer.base_altitude_m(), layer.top_altitude_m()])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is shown, s, after steps of time.
    fn shown_s(lag: &mut Lag, now_s: &mut f64, passed_s: f64) -> f64 {
        *now_s += passed_s;
        lag.pass(passed_s);
        *now_s - lag.seconds
    }

    #[test]
    fn a_sky_that_was_held_up_catches_up_without_a_jump() {
        let (mut lag, mut now_s) = (Lag::default(), 0.0);
        let mut before_s = shown_s(&mut lag, &mut now_s, 0.04);
        assert!((before_s - 0.04).abs() < 1e-12, "in time at first");
        let after_stall_s = shown_s(&mut lag, &mut now_s, 4.0);
        assert!((after_stall_s - before_s - STALL_MAX_S).abs() < 1e-12);
        before_s = after_stall_s;
        let mut steps = 0;
        while lag != Lag::default() {
            let next_s = shown_s(&mut lag, &mut now_s, 0.04);
            assert!(next_s > before_s && next_s - before_s < 0.0801);
            before_s = next_s;
            steps += 1;
        }
        // 3.75 s behind, at 0.04 s a step.
        assert_eq!(steps, 94);
        assert!((shown_s(&mut lag, &mut now_s, 0.04) - now_s).abs() < 1e-12);
    }

    #[test]
    fn a_sky_that_was_held_up_for_very_long_jumps_rather_than_stays_behind() {
        let (mut lag, mut now_s) = (Lag::default(), 0.0);
        let shown = shown_s(&mut lag, &mut now_s, 1e9);
        assert!((shown - (1e9 - LAG_MAX_S)).abs() < 1e-3);
    }
}

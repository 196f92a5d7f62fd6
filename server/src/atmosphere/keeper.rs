//! Which tables are shown while the air changes. They take about a second of a core, which no frame waits for: they are made
//! on another thread, and what is shown goes evenly from the last ones to them.

use super::{BaseTables, Medium};
use skycell_protocol::Scene;
use std::sync::Arc;
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Tables change this often at most: as often as a sky in motion is worked out.
const STEP: Duration = Duration::from_millis(40);
/// Bounds of the time over which new tables take the place of old ones. Else it is that in which they were made, so that
/// air in motion flows from one to the next.
const BLEND_MIN: Duration = Duration::from_millis(200);
const BLEND_MAX: Duration = Duration::from_secs(2);

/// Tables under way from one air to another.
#[derive(Debug)]
struct Blend {
    from: Arc<BaseTables>,
    to: Arc<BaseTables>,
    begun: Instant,
    takes: Duration,
    stepped: Instant,
}

/// What a thread has made, and how long that took.
type Made = (Arc<BaseTables>, Duration);

/// The tables of the present air.
#[derive(Debug)]
pub struct AirKeeper {
    sun_radius_rad: f64,
    shown: Option<Arc<BaseTables>>,
    blend: Option<Blend>,
    /// What a thread is making.
    coming: Option<Medium>,
    finished: (mpsc::Sender<Made>, mpsc::Receiver<Made>),
}

impl AirKeeper {
    /// Without air, for a sun of an angular radius.
    #[must_use]
    pub fn new(sun_radius_rad: f64) -> Self {
        Self {
            sun_radius_rad,
            shown: None,
            blend: None,
            coming: None,
            finished: mpsc::channel(),
        }
    }

    /// What is shown; none without air.
    #[must_use]
    pub fn shown(&self) -> Option<&Arc<BaseTables>> {
        self.shown.as_ref()
    }

    /// Whether other tables are on their way.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        self.coming.is_some() || self.blend.is_some()
    }

    /// Makes the tables of a scene's air before it returns: for single pictures.
    pub fn make_now(&mut self, scene: &Scene) {
        self.blend = None;
        self.shown = BaseTables::of(scene, self.sun_radius_rad, self.shown.as_ref());
    }

    /// Follows the scene's air: has its tables made where they are not, and brings what is shown nearer to what has been
    /// made. True where something else is shown now.
    pub fn follow(&mut self, scene: &Scene, now: Instant) -> bool {
        let Some(medium) = Medium::of(scene) else {
            let was = self.shown.take().is_some();
            self.blend = None;
            return was;
        };
        let mut changed = false;
        let fits = |tables: &Arc<BaseTables>| tables.medium.radius_m == medium.radius_m;
        if !self.shown.as_ref().is_some_and(fits) {
            self.blend = None;
            self.shown = Some(Arc::new(BaseTables::draft(medium, self.sun_radius_rad)));
            changed = true;
        }
        for (tables, took) in self.finished.1.try_iter() {
            self.coming = None;
            if fits(&tables)
                && let Some(shown) = &self.shown
            {
                self.blend = Some(Blend {
                    from: shown.clone(),
                    to: tables,
                    begun: now,
                    takes: took.clamp(BLEND_MIN, BLEND_MAX),
                    stepped: now,
                });
            }
        }
        changed |= self.step(now);
        let last = self
            .blend
            .as_ref()
            .map(|blend| &blend.to)
            .or(self.shown.as_ref());
        let known = last.is_some_and(|last| last.medium == medium && last.is_fine());
        if !known && self.coming.is_none() {
            self.have_made(medium);
        }
        changed
    }

    fn step(&mut self, now: Instant) -> bool {
        let Some(blend) = &mut self.blend else {
            return false;
        };
        let share = now.duration_since(blend.begun).as_secs_f64() / blend.takes.as_secs_f64();
        if share < 1.0 {
            if now.duration_since(blend.stepped) < STEP {
                return false;
            }
            blend.stepped = now;
            if let Some(tables) = BaseTables::between(&blend.from, &blend.to, share) {
                self.shown = Some(Arc::new(tables));
                return true;
            }
        }
        self.shown = Some(blend.to.clone());
        self.blend = None;
        true
    }

    fn have_made(&mut self, medium: Medium) {
        let (sun_radius_rad, finished) = (self.sun_radius_rad, self.finished.0.clone());
        let thread = std::thread::Builder::new().name("air".into());
        let spawned = thread.spawn(move || {
            let begun = Instant::now();
            let tables = Arc::new(BaseTables::new(medium, sun_radius_rad));
            // Nobody waits any more once the renderer is gone.
            let _ = finished.send((tables, begun.elapsed()));
        });
        match spawned {
            Ok(_) => self.coming = Some(medium),
            Err(error) => tracing::error!(%error, "tables of the air cannot be made"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn scene(aerosol: f64) -> Scene {
        let document = json!({"version": 1,
            "atmosphere": {"model": "physical", "aerosol_optical_depth": aerosol}});
        Scene::from_json(&document).expect("a scene")
    }

    fn shown_depth(keeper: &AirKeeper) -> f64 {
        let medium = &keeper.shown().expect("tables").medium;
        medium.mie_extinction_per_m.y * medium.mie_scale_m
    }

    /// Follows until nothing moves; returns the optical depths of aerosol that were shown.
    fn follow(keeper: &mut AirKeeper, scene: &Scene) -> Vec<f64> {
        let begun = Instant::now();
        let mut seen = vec![];
        loop {
            if keeper.follow(scene, Instant::now()) {
                seen.push(shown_depth(keeper));
            }
            if !keeper.is_moving() {
                return seen;
            }
            assert!(begun.elapsed() < Duration::from_secs(120));
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn air_that_changes_is_made_beside_frames_and_goes_evenly_to_the_new_one() {
        let mut keeper = AirKeeper::new(0.004_65);
        follow(&mut keeper, &scene(0.1));
        assert!((shown_depth(&keeper) - 0.1).abs() < 1e-12);
        let asked = Instant::now();
        keeper.follow(&scene(0.3), asked);
        // Some of a second's work is not done in a call.
        assert!(asked.elapsed() < Duration::from_millis(50));
        assert!((shown_depth(&keeper) - 0.1).abs() < 1e-12);
        let seen = follow(&mut keeper, &scene(0.3));
        assert!(seen.len() > 2 && seen.is_sorted(), "{seen:?}");
        assert!((shown_depth(&keeper) - 0.3).abs() < 1e-12);
        // And at rest nothing is done.
        assert!(!keeper.follow(&scene(0.3), Instant::now()));
    }

    #[test]
    fn without_such_air_there_are_no_tables() {
        let mut keeper = AirKeeper::new(0.004_65);
        follow(&mut keeper, &scene(0.1));
        let plain = Scene::from_json(&json!({"version": 1})).expect("a scene");
        assert!(keeper.follow(&plain, Instant::now()));
        assert!(keeper.shown().is_none());
    }
}

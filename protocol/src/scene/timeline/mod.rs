//! A scene in time: its clock, what is animated, what it comes from, where the wind has carried it. A scene at a moment is
//! a pure function of its document, so that every server with the document shows the same sky.

mod animation;
mod blend;
mod clock;
mod drift;
mod place;
#[cfg(test)]
mod tests;
mod transition;
mod validation;

use std::collections::BTreeMap;

use glam::DVec3;
use serde_json::Value;

pub use animation::{Animation, AnimationDocument, Ease, KeyframeDocument, Repeat};
pub use clock::{SkyClock, TimeChange, TimeDocument};
pub use drift::Drift;
pub use place::{PlaceAndTime, PlaceAndTimeDocument};
pub use transition::{StillSceneDocument, Transition, TransitionDocument};

use super::document::SceneDocument;
use super::{CloudLayer, DensityModel, Scene, SceneError};
use crate::moment::Moment;
use transition::still_value;
use validation::animations_from;

/// What of a scene has to do with time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Timeline {
    clock: SkyClock,
    animations: Vec<Animation>,
    transition: Option<Transition>,
    drift: Option<Drift>,
    /// Where the wind has carried each layer; empty unless the scene is one of a moment.
    carried_m: Vec<DVec3>,
}

impl Timeline {
    /// Takes what has to do with time out of a document. The rest must be a scene.
    pub(super) fn of(document: &SceneDocument) -> Result<Self, SceneError> {
        let clock = SkyClock::try_from(document.time.clone()).map_err(|e| e.under("/time"))?;
        let transition = document.transition.clone().map(Transition::try_from);
        Ok(Self {
            clock,
            animations: animations_from(document)?,
            transition: transition.transpose().map_err(|e| e.under("/transition"))?,
            drift: document.drift.clone(),
            carried_m: Vec::new(),
        })
    }

    pub(super) fn write_to(&self, document: &mut SceneDocument) {
        document.time = (&self.clock).into();
        document.animation = self.animations.iter().map(Into::into).collect();
        document.transition = self.transition.as_ref().map(Into::into);
        document.drift = self.drift.clone();
    }
}

impl Scene {
    /// The sky's clock.
    pub fn clock(&self) -> &SkyClock {
        &self.timeline.clock
    }

    /// What changes with sky time.
    pub fn animations(&self) -> &[Animation] {
        &self.timeline.animations
    }

    /// What the sky comes from, until it has come.
    pub fn transition(&self) -> Option<&Transition> {
        self.timeline.transition.as_ref()
    }

    /// The scene at a moment: nothing in it moves but the wind. Its clock stands, and [`Self::carried_m`] tells where
    /// clouds are.
    #[must_use]
    pub fn at(&self, now: Moment) -> Self {
        let sky_s = self.clock().sky_s(now);
        let mut still = self.still_at(sky_s, self.transition().map(|t| (t, t.share(now))));
        still.timeline.carried_m = self.carried_by(&still.layers, now);
        still
    }

    /// The scene at a sky time, after its transition. The wind has not blown: it carries clouds for as long as a renderer is
    /// told.
    #[must_use]
    pub fn at_sky_s(&self, sky_s: f64) -> Self {
        self.still_at(sky_s, None)
    }

    /// The same scene with clouds where another one has them.
    #[must_use]
    pub fn carried_like(mut self, other: &Self) -> Self {
        self.timeline
            .carried_m
            .clone_from(&other.timeline.carried_m);
        self
    }

    /// Whether this is the scene of a moment.
    pub fn has_carried(&self) -> bool {
        !self.timeline.carried_m.is_empty()
    }

    /// How far the wind has carried each layer by the moment of a scene that is one of a moment (x and z), and how far its
    /// noise has risen (y), m. Nowhere, for a whole document.
    pub fn carried_m(&self, layer: usize) -> DVec3 {
        self.timeline
            .carried_m
            .get(layer)
            .copied()
            .unwrap_or_default()
    }

    /// Where the wind carries each layer by a moment, m. The layers are those of [`Self::at`] or a scene between.
    pub fn carried_by(&self, layers: &[CloudLayer], now: Moment) -> Vec<DVec3> {
        layers
            .iter()
            .map(|layer| self.carried_layer_m(layer.name(), now))
            .collect()
    }

    /// Where the wind carries the layer of a name by a moment.
    fn carried_layer_m(&self, name: &str, now: Moment) -> DVec3 {
        let Timeline { clock, drift, .. } = &self.timeline;
        let velocity = self
            .drift_m_per_s(name)
            .unwrap_or(self.wind.velocity_m_per_s());
        let (since, start_m) = match drift {
            Some(drift) => {
                let offset = drift.layers_m.get(name).copied().unwrap_or_default();
                (drift.since, DVec3::from_array(offset))
            }
            None => (clock.epoch(), velocity * clock.sky_s_at_epoch()),
        };
        let (from, until) = (clock.running_until(since), clock.running_until(now));
        let seconds = until.seconds_since(from);
        let blown_m = match self.transition() {
            Some(transition) => {
                let before = transition.from().drift_m_per_s(name).unwrap_or(velocity);
                let share_s = transition.share_s(until) - transition.share_s(from);
                before * (seconds - share_s) + velocity * share_s
            }
            None => velocity * seconds,
        };
        start_m + blown_m * clock.wind_rate()
    }

    /// How fast the clouds of a layer go: with the wind, and upwards as their noise rises.
    fn drift_m_per_s(&self, name: &str) -> Option<DVec3> {
        let index = self.layers.iter().position(|layer| layer.name() == name)?;
        let evolution_m_per_s = match self.layers[index].density() {
            DensityModel::Weather(weather) => weather.evolution_m_per_s(),
            _ => 0.0,
        };
        let wind = self.layer_wind(index).velocity_m_per_s();
        Some(wind.with_y(evolution_m_per_s))
    }

    fn wind_of_name(&self, name: &str) -> Option<super::Wind> {
        let index = self.layers.iter().position(|layer| layer.name() == name)?;
        Some(self.layer_wind(index))
    }

    /// Whether something but clouds in the wind can look different after a moment.
    pub fn is_animated_after(&self, now: Moment) -> bool {
        let clock = self.clock();
        let sky_s = clock.sky_s(now);
        let comes = self.transition().is_some_and(|t| now < t.ends());
        let runs = clock.is_running(now)
            && (self.sun.place_and_time().is_some()
                || self
                    .animations()
                    .iter()
                    .any(|animation| animation.moves_after(sky_s, clock.rate())));
        comes || runs
    }

    /// Seconds of wind that pass in a second.
    pub fn wind_rate_at(&self, now: Moment) -> f64 {
        let stands = self.clock().paused_at().is_some_and(|paused| paused <= now);
        if stands {
            0.0
        } else {
            self.clock().wind_rate()
        }
    }

    /// A document that continues this scene's sky: what `next` would show at `now` in other places is carried on from where
    /// it is, by a drift that says so. For changes of winds and clocks.
    pub fn continued_drift(&self, next: &Self, now: Moment) -> Option<Drift> {
        let names = || {
            let coming = next.transition().map(|t| t.from().layers());
            next.layers.iter().chain(coming.into_iter().flatten())
        };
        let jumps = names().any(|layer| {
            let known = self.wind_of_name(layer.name()).is_some();
            let (is, would_be) = (
                self.carried_layer_m(layer.name(), now),
                next.carried_layer_m(layer.name(), now),
            );
            // Less than rounding leaves of places after years.
            known && is.distance(would_be) > 1e-3
        });
        if !jumps {
            return next.timeline.drift.clone();
        }
        let layers_m: BTreeMap<String, [f64; 3]> = names()
            .map(|layer| {
                let source = if self.wind_of_name(layer.name()).is_some() {
                    self
                } else {
                    next
                };
                let at = source.carried_layer_m(layer.name(), now);
                (layer.name().to_owned(), at.to_array())
            })
            .collect();
        Some(Drift {
            since: now,
            layers_m,
        })
    }

    fn still_at(&self, sky_s: f64, transition: Option<(&Transition, f64)>) -> Self {
        let mut still = self.clone();
        still.timeline = Timeline {
            clock: SkyClock::standing_at(sky_s),
            animations: Vec::new(),
            transition: None,
            drift: None,
            carried_m: Vec::new(),
        };
        let transition = transition.filter(|(_, share)| *share < 1.0);
        if !self.animations().is_empty() || transition.is_some() {
            let mut value = still_value(&still.to_document());
            for animation in self.animations() {
                if let Some(number) = value.pointer_mut(animation.path()) {
                    *number = Value::from(animation.shown_at(sky_s, self.clock().rate()));
                }
            }
            if let Some((transition, share)) = transition {
                // The sun of the place takes part in the blend, so it has to stand before.
                if let Some(place) = self.sun.place_and_time() {
                    let [azimuth, elevation] = place.sun_azimuth_elevation_deg(sky_s);
                    value["sun"]["azimuth_deg"] = Value::from(azimuth);
                    value["sun"]["elevation_deg"] = Value::from(elevation);
                    value["sun"]["place_and_time"] = Value::Null;
                    if let Some(moon) = &self.moon
                        && moon.of_place_and_time()
                    {
                        let [azimuth, elevation, phase] =
                            place.moon_azimuth_elevation_phase_deg(sky_s);
                        value["moon"]["azimuth_deg"] = Value::from(azimuth);
                        value["moon"]["elevation_deg"] = Value::from(elevation);
                        value["moon"]["phase_angle_deg"] = Value::from(phase);
                        value["moon"]["of_place_and_time"] = Value::from(false);
                    }
                }
                let from = still_value(&transition.from().to_document());
                value = blend::blend(&from, &value, share);
            }
            // Values between allowed ones are allowed; should a rule between two keys not hold there, the whole sky is shown.
            if let Ok(scene) = Scene::from_json(&value) {
                let clock = still.timeline.clock;
                still = scene;
                still.timeline.clock = clock;
            }
            if let Some((transition, share)) = transition {
                still.blend_winds(self, transition.from(), share);
            }
        }
        if let Some(moon) = &mut still.moon {
            moon.stand_at(still.sun.place_and_time(), sky_s);
        }
        still.sun.stand_at(sky_s);
        still
    }

    /// Gives each layer the wind between those of two scenes: halfway between north and south there is none.
    fn blend_winds(&mut self, to: &Self, from: &Self, share: f64) {
        for layer in &mut self.layers {
            let (before, after) = (
                from.wind_of_name(layer.name()),
                to.wind_of_name(layer.name()),
            );
            let (Some(before), Some(after)) = (before.or(after), after.or(before)) else {
                continue;
            };
            layer.set_wind(before.towards(&after, share));
        }
    }
}

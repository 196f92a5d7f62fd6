//! Where what a ray sees of a layer stands on the mean.

use crate::scattering::FRONT_LENGTH_M;

/// Means over the parts of a ray by the share of its light that each shows.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    /// Share of the ray's light that the parts show.
    pub(super) shown: f64,
    weighted_distance_m: f64,
    weighted_sun_depth: f64,
}

impl Seen {
    fn add(&mut self, weight: f64, distance_m: f64, sun_depth: f64) {
        self.shown += weight;
        self.weighted_distance_m += weight * distance_m;
        self.weighted_sun_depth += weight * sun_depth;
    }

    /// Distance along the ray; only where anything is shown.
    pub(super) fn distance_m(&self) -> f64 {
        self.weighted_distance_m / self.shown
    }

    /// Optical depth towards the sun; only where anything is shown.
    pub(super) fn sun_depth(&self) -> f64 {
        self.weighted_sun_depth / self.shown
    }
}

/// The front of what a ray sees and what lies behind, [`FRONT_LENGTH_M`] from where it first meets cloud.
#[derive(Clone, Copy, Debug)]
pub(super) struct SeenParts {
    parts: [Seen; 2],
    length_m: f64,
    front_end_m: Option<f64>,
}

impl SeenParts {
    /// Of a volume, which has a front and a back.
    pub(super) fn of_volume() -> Self {
        Self::of_length(FRONT_LENGTH_M)
    }

    /// Of a thin sheet: all is front.
    pub(super) fn of_sheet() -> Self {
        Self::of_length(f64::INFINITY)
    }

    fn of_length(length_m: f64) -> Self {
        Self {
            parts: [Seen::default(); 2],
            length_m,
            front_end_m: None,
        }
    }

    /// Adds a part of the ray that shows `weight` of its light; distances grow from call to call.
    pub(super) fn add(&mut self, weight: f64, distance_m: f64, sun_depth: f64) {
        if weight <= 0.0 {
            return;
        }
        let front_end_m = *self.front_end_m.get_or_insert(distance_m + self.length_m);
        let place = usize::from(distance_m >= front_end_m);
        if let Some(part) = self.parts.get_mut(place) {
            part.add(weight, distance_m, sun_depth);
        }
    }

    /// As if every part showed `factor` times as much.
    pub(super) fn scale(&mut self, factor: f64) {
        for part in &mut self.parts {
            part.shown *= factor;
            part.weighted_distance_m *= factor;
            part.weighted_sun_depth *= factor;
        }
    }

    /// The parts that show anything.
    pub(super) fn each(&self) -> impl Iterator<Item = &Seen> {
        self.parts.iter().filter(|part| part.shown > 0.0)
    }

    /// Σ weight × distance, m.
    pub(super) fn weighted_distance_m(&self) -> f64 {
        self.parts.iter().map(|part| part.weighted_distance_m).sum()
    }

    /// Σ weight.
    pub(super) fn shown(&self) -> f64 {
        self.parts.iter().map(|part| part.shown).sum()
    }
}

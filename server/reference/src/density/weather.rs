//! Density from weather maps and noise (A. Schneider, "Nubis", 2015-2023; P. Ford 2024, 3.1):
//! ρ = the shape noise above what the dimensional profile d = c v forbids, its surface eroded by detail noise.
//! The constants are the renderer's model; see `cloud/density.wgsl` for what they were tuned to. What differs between families
//! is the scene's [`CloudForm`].

use crate::{Noise, WeatherMaps};
use skycell_protocol::scene::{CloudForm, WeatherDensity};

/// Width of the rise of coverage around its threshold, in units of the map.
pub const COVERAGE_SOFTNESS: f64 = 0.55;
/// What stands for detail that is too fine to be seen.
pub const DETAIL_MEAN: f64 = 0.5;
/// Half the width of what most of the detail's values lie in.
pub const DETAIL_SPREAD: f64 = 0.3;
/// Half the width of what most of the shape noise's values lie in.
const SHAPE_SPREAD: f64 = 0.5;
/// Share of the map's span that the skip map means at 1.
pub const SKIP_RANGE_SHARE: f64 = 0.25;

/// A place in the field: where the wind has brought it from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldPlace {
    /// East, m.
    pub x_m: f64,
    /// Above the ground, m.
    pub altitude_m: f64,
    /// South, m.
    pub z_m: f64,
}

/// A weather layer's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weather {
    /// Share of the sky that clouds cover.
    pub coverage: f64,
    /// Place among the profile's types, 0…1.
    pub cloud_type: f64,
    /// How noise carves the clouds.
    pub form: CloudForm,
    /// Length after which the maps repeat, m.
    pub map_span_m: f64,
    /// Length after which the shape noise repeats, m.
    pub shape_period_m: f64,
    /// Length after which the detail noise repeats, m.
    pub detail_period_m: f64,
    /// How much the edges are frayed; 0 where detail is left out.
    pub detail_strength: f64,
    /// Altitude of the layer's base, m.
    pub base_altitude_m: f64,
    /// Thickness of the layer, m.
    pub thickness_m: f64,
    /// How far the noise has risen through the clouds, m.
    pub evolved_m: f64,
}

impl Weather {
    /// The parameters of a layer of the scene.
    #[must_use]
    pub fn new(
        density: &WeatherDensity,
        base_altitude_m: f64,
        thickness_m: f64,
        with_detail: bool,
        evolved_m: f64,
    ) -> Self {
        Self {
            coverage: density.coverage(),
            cloud_type: density.cloud_type(),
            form: density.form(),
            map_span_m: density.map_span_m(),
            shape_period_m: density.shape_period_m(),
            detail_period_m: density.detail_period_m(),
            detail_strength: if with_detail {
                density.detail_strength()
            } else {
                0.0
            },
            base_altitude_m,
            thickness_m,
            evolved_m,
        }
    }

    /// Where a place lies in periods of noise, which rises.
    fn noise_place(&self, place: FieldPlace, period_m: f64) -> [f64; 3] {
        [
            place.x_m / period_m,
            (place.altitude_m - self.evolved_m) / period_m,
            place.z_m / period_m,
        ]
    }

    /// Local coverage in 0…1 for what the map holds: 0 at a layer coverage of 0, 1 at 1, whatever the map holds.
    #[must_use]
    pub fn coverage_from_map(&self, map_value: f64) -> f64 {
        let threshold = 1.0 - (1.0 + COVERAGE_SOFTNESS) * self.coverage;
        ((map_value - threshold) / COVERAGE_SOFTNESS).clamp(0.0, 1.0)
    }

    /// Local type for what the map holds, before the dome's share.
    #[must_use]
    pub fn type_from_map(&self, map_value: f64) -> f64 {
        let spread = self.form.type_spread;
        (self.cloud_type * (1.0 - spread + spread * map_value)).clamp(0.0, 1.0)
    }

    /// Local type under a local coverage: where there are domes, rims are flatter than middles.
    #[must_use]
    pub fn domed_type(&self, map_value: f64, coverage: f64) -> f64 {
        self.type_from_map(map_value) * (1.0 - self.form.dome * (1.0 - coverage))
    }

    /// Least dimensional profile at which any noise leaves cloud: below it even noise 1 does not reach the surface.
    #[must_use]
    pub fn profile_min(&self) -> f64 {
        1.0 - self.form.shape_floor - self.form.shape_range
    }

    /// Height fraction of an altitude, not bounded.
    #[must_use]
    pub fn height_fraction(&self, altitude_m: f64) -> f64 {
        (altitude_m - self.base_altitude_m) / self.thickness_m
    }

    /// Dimensional profile d = c v.
    #[must_use]
    pub fn dimensional_profile(
        &self,
        maps: &WeatherMaps,
        place: FieldPlace,
        height_fraction: f64,
    ) -> f64 {
        let (u, v) = (place.x_m / self.map_span_m, place.z_m / self.map_span_m);
        let taps = maps.coverage.taps(u, v);
        let coverage = self.coverage_from_map(maps.coverage.at(taps));
        if coverage == 0.0 {
            return 0.0;
        }
        let map_value = if maps.cloud_type.is_sized_as(&maps.coverage) {
            maps.cloud_type.at(taps)
        } else {
            maps.cloud_type.repeated(u, v)
        };
        let local_type = self.domed_type(map_value, coverage);
        coverage * maps.profile.clamped(height_fraction, local_type)
    }

    /// Horizontal distance in which there is no cloud, m.
    #[must_use]
    pub fn skip_m(&self, maps: &WeatherMaps, place: FieldPlace) -> f64 {
        let share = maps
            .skip
            .repeated(place.x_m / self.map_span_m, place.z_m / self.map_span_m);
        share * self.map_span_m * SKIP_RANGE_SHARE
    }

    /// How much billowy noise there is against wispy noise.
    pub(crate) fn billowy(&self, height_fraction: f64) -> f64 {
        (5.0 * height_fraction).clamp(0.0, 1.0) * (1.0 - self.form.wispiness)
    }

    /// How far the shape noise reaches above what the profile forbids.
    fn carved(&self, noise: &Noise, place: FieldPlace, height_fraction: f64, profile: f64) -> f64 {
        let [billowy, wispy] = noise
            .shape
            .repeated(self.noise_place(place, self.shape_period_m));
        let shape = wispy + (billowy - wispy) * self.billowy(height_fraction);
        self.form.shape_floor + self.form.shape_range * shape - (1.0 - profile)
    }

    /// Density in 0…1 at a place with a dimensional profile. detail_weight: 1 full detail, 0 its mean.
    #[must_use]
    pub fn carved_density(
        &self,
        noise: &Noise,
        place: FieldPlace,
        height_fraction: f64,
        profile: f64,
        detail_weight: f64,
    ) -> f64 {
        if profile <= self.profile_min() {
            return 0.0;
        }
        let carved = self.carved(noise, place, height_fraction, profile);
        // Detail only takes away: where there is nothing before, there is nothing after.
        if carved <= 0.0 {
            return 0.0;
        }
        let detail = if self.detail_strength > 0.0 && detail_weight > 0.0 {
            let [billowy, wispy] = noise
                .detail
                .repeated(self.noise_place(place, self.detail_period_m));
            let fine = wispy + (billowy - wispy) * self.billowy(height_fraction);
            DETAIL_MEAN + (fine - DETAIL_MEAN) * detail_weight
        } else {
            DETAIL_MEAN
        };
        // Detail that is too fine to be seen blurs the surface by as much as it would move it.
        let blur = (1.0 - detail_weight) * self.detail_strength * DETAIL_SPREAD;
        let surface = carved - self.detail_strength * (1.0 - detail);
        ((surface + blur) / (1.0 / self.form.steepness + 2.0 * blur)).clamp(0.0, 1.0)
    }

    /// Density in 0…1 with the detail's mean and no blur: what the march to the sun reads.
    #[must_use]
    pub fn smooth_density(
        &self,
        noise: &Noise,
        place: FieldPlace,
        height_fraction: f64,
        profile: f64,
    ) -> f64 {
        let eroded = self.detail_strength * (1.0 - DETAIL_MEAN);
        if profile <= self.profile_min() + eroded {
            return 0.0;
        }
        let carved = self.carved(noise, place, height_fraction, profile);
        ((carved - eroded) * self.form.steepness).clamp(0.0, 1.0)
    }

    /// Density in 0…1 on the mean of a place's surroundings: with the means of shape and detail, and a surface as wide as
    /// the shape noise would move it.
    #[must_use]
    pub fn broad_density(&self, profile: f64) -> f64 {
        if profile <= 0.0 {
            return 0.0;
        }
        let carved = self.form.shape_floor + 0.5 * self.form.shape_range - (1.0 - profile);
        let surface = carved - self.detail_strength * (1.0 - DETAIL_MEAN);
        let blur = self.form.shape_range * SHAPE_SPREAD;
        ((surface + blur) / (1.0 / self.form.steepness + 2.0 * blur)).clamp(0.0, 1.0)
    }
}

//! Density of a thin sheet of ice: patches, in which fibres or a veil stand; the same at all of its altitudes.

use super::weather::{COVERAGE_SOFTNESS, FieldPlace};
use crate::SheetMaps;
use skycell_protocol::scene::CirrusDensity;

/// A sheet's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheet {
    /// Share of the sky that the sheet covers.
    pub coverage: f64,
    /// 0 a veil to 1 fibres.
    pub cloud_type: f64,
    /// Length after which patches repeat, m.
    pub map_span_m: f64,
    /// Length after which fibres and veil repeat, m.
    pub fibre_period_m: f64,
    /// Unit vector along the fibres: x and z.
    pub axis: [f64; 2],
}

impl Sheet {
    /// The parameters of a layer of the scene.
    #[must_use]
    pub fn new(density: &CirrusDensity) -> Self {
        Self {
            coverage: density.coverage(),
            cloud_type: density.cloud_type(),
            map_span_m: density.map_span_m(),
            fibre_period_m: density.fibre_period_m(),
            axis: density.fibre_axis(),
        }
    }

    /// Density in 0…1 at a place.
    #[must_use]
    pub fn density(&self, maps: &SheetMaps, place: FieldPlace) -> f64 {
        let (x, z) = (place.x_m, place.z_m);
        let patches = maps
            .patches
            .repeated(x / self.map_span_m, z / self.map_span_m);
        // As a weather layer's coverage: 0 is clear and 1 whole, whatever the map holds.
        let threshold = 1.0 - (1.0 + COVERAGE_SOFTNESS) * self.coverage;
        let coverage = ((patches - threshold) / COVERAGE_SOFTNESS).clamp(0.0, 1.0);
        let [axis_x, axis_z] = self.axis;
        let along = (axis_x * x + axis_z * z) / self.fibre_period_m;
        let across = (axis_x * z - axis_z * x) / self.fibre_period_m;
        let veil = maps.veil.repeated(along, across);
        let fibres = maps.fibres.repeated(along, across);
        coverage * (veil + (fibres - veil) * self.cloud_type)
    }
}

//! The renderer's model by marching: the same samples as the shaders, or so many that more change nothing.

mod blend;
mod converged;
mod layer;
mod seen;
mod shade;
mod sheet;

pub use converged::{ConvergeLimit, Converged, converged_ray};
pub use layer::{
    LitPart, LitRay, MarchSteps, detail_weight, gather_layer, lit_ray, sun_optical_depth,
};
pub use shade::{shaded_background, sunlit_share};
pub use sheet::sheet_sun_depth;

use crate::{Ray, RayResult, World};
use blend::blended;

/// What a layer itself counts for in the mean distance of what is seen, so that it is known where nothing is seen.
pub const CLEAR_OPACITY: f64 = 1e-3;

/// Marches one ray with the shaders' discretisation and blends its layers as their composite does: the farthest
/// first.
#[must_use]
pub fn march_ray(world: &World, ray: &Ray, steps: &MarchSteps) -> RayResult {
    let on_ground = world.globe().ground_m(ray).is_some();
    let (mut gathered, mut evaluations) = (Vec::new(), 0);
    let eye_m = world.globe().altitude_m(ray.origin_m);
    for layer in world.layers() {
        if on_ground && steps.ground_hides_layers && eye_m < layer.base_altitude_m {
            continue;
        }
        let (layer, count) = gather_layer(world, layer, ray, steps);
        gathered.push(layer);
        evaluations += count;
    }
    let mut result = blended(
        world,
        ray,
        steps.air_direction.unwrap_or(ray.direction),
        gathered,
    );
    result.steps = evaluations;
    result
}

//! Lists of rays: read from JSON, and what was found along them as JSON.

use anyhow::{Context, bail, ensure};
use glam::DVec3;
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::camera::{POSITION_ALTITUDE_M, POSITION_HORIZONTAL_M};
use skycell_protocol::read_json::{ObjectReader, ReadJson};
use skycell_protocol::{ValueError, number_range::NumberRange};
use skycell_reference::RayResult;
use std::path::Path;

/// Most rays of a list.
const RAYS_MAX: usize = 1 << 20;
/// A direction needs a length that can be divided by.
const DIRECTION: NumberRange = NumberRange::new(-1e9, 1e9);

/// A ray as it stands in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WorldRay {
    /// x, altitude, z.
    pub(super) origin_m: DVec3,
    /// Unit vector.
    pub(super) direction: DVec3,
}

impl ReadJson for WorldRay {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        members.only(&["origin_m", "direction"])?;
        let triple = "an array of 3 numbers";
        let origin_m: [f64; 3] = members.required("origin_m", triple)?;
        let at = members.pointer_of("origin_m");
        POSITION_HORIZONTAL_M.check(&format!("{at}/0"), origin_m[0])?;
        POSITION_ALTITUDE_M.check(&format!("{at}/1"), origin_m[1])?;
        POSITION_HORIZONTAL_M.check(&format!("{at}/2"), origin_m[2])?;
        let direction: [f64; 3] = members.required("direction", triple)?;
        let at = members.pointer_of("direction");
        DIRECTION.check_each(&at, direction)?;
        let length = DVec3::from_array(direction).length();
        if length < 1e-9 {
            return Err(ValueError::new(
                at,
                &Value::from(direction.to_vec()),
                "a direction of some length",
            ));
        }
        Ok(Self {
            origin_m: DVec3::from_array(origin_m),
            direction: DVec3::from_array(direction) / length,
        })
    }
}

/// Reads a file of rays.
pub(super) fn read_rays(path: &Path) -> anyhow::Result<Vec<WorldRay>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("the rays in {} cannot be read", path.display()))?;
    let value: Value = serde_json::from_str(&text)
        .with_context(|| format!("the file of rays {} is no JSON", path.display()))?;
    let read = || -> Result<Vec<WorldRay>, ValueError> {
        let members = ObjectReader::new(&value, "")?;
        members.only(&["rays"])?;
        members.required("rays", "an array of rays")
    };
    let rays = read().with_context(|| format!("the file of rays {}", path.display()))?;
    ensure!(!rays.is_empty(), "{} has no rays", path.display());
    if rays.len() > RAYS_MAX {
        bail!(
            "{} has {} rays; allowed are 1 to {RAYS_MAX}",
            path.display(),
            rays.len()
        );
    }
    Ok(rays)
}

/// What was found along rays, with what the numbers mean.
#[derive(Debug, Serialize)]
pub(super) struct RayReport {
    pub(super) renderer: &'static str,
    pub(super) conventions: &'static str,
    pub(super) settings: Value,
    pub(super) rays: Vec<RayLine>,
}

/// What the numbers of every report mean.
pub(super) const CONVENTIONS: &str = "radiance in W/(m² nm sr) at 680, 550 and 440 nm for the scene's sun irradiance in \
W/(m² nm): an irradiance of 1 gives radiance per unit of irradiance; phase functions in 1/sr, their integral over the \
sphere is 1; every ray starts at its origin, no medium is skipped; transmittance and optical depth are those of all cloud \
along the ray; steps are evaluations of density; null: not known to this renderer";

/// One ray.
#[derive(Debug, Serialize)]
pub(super) struct RayLine {
    pub(super) origin_m: [f64; 3],
    pub(super) direction: [f64; 3],
    pub(super) radiance: [f64; 3],
    pub(super) single_scattered: [f64; 3],
    pub(super) transmittance: f64,
    pub(super) optical_depth: f64,
    pub(super) steps: u64,
    /// Null where nothing is random.
    pub(super) standard_error: Option<RayErrors>,
}

/// Standard errors of one ray.
#[derive(Debug, Serialize)]
pub(super) struct RayErrors {
    pub(super) radiance: [f64; 3],
    pub(super) single_scattered: [f64; 3],
    pub(super) transmittance: f64,
    pub(super) optical_depth: f64,
}

impl RayLine {
    pub(super) fn new(ray: &WorldRay, result: &RayResult, random: bool) -> Self {
        let errors = &result.standard_error;
        Self {
            origin_m: ray.origin_m.to_array(),
            direction: ray.direction.to_array(),
            radiance: result.radiance.to_array(),
            single_scattered: result.single_scattered.to_array(),
            transmittance: result.transmittance,
            optical_depth: result.optical_depth,
            steps: result.steps,
            standard_error: random.then(|| RayErrors {
                radiance: errors.radiance.to_array(),
                single_scattered: errors.single_scattered.to_array(),
                transmittance: errors.transmittance,
                optical_depth: errors.optical_depth,
            }),
        }
    }
}

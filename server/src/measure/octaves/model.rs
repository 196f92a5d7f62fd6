//! The renderer's model of scattered light on the shapes, by the f64 reference's march.

use super::shapes::{Droplets, SUN_ELEVATIONS_DEG, Shape, shapes};
use super::truth::{Estimate, Truth};
use anyhow::Context;
use rayon::prelude::*;
use serde_json::json;
use skycell_protocol::scene::FittedScattering;
use skycell_reference::Ray;
use skycell_reference::march::{LitRay, MarchSteps, lit_ray};
use skycell_reference::phase::{Phase, one_minus_mu};
use skycell_reference::scattering::{diffuse_share, sky_share};

/// Standard errors above this share of their mean say too little: such looks are left out.
const NOISE_MAX: f64 = 0.3;
/// Steps through the layer, and the far end of the march to the sun, as the renderer's defaults.
const STEPS: u32 = 512;
const SUN_MARCH_M: f64 = 1500.0;

/// A look at a shape: what the path tracer sees, and what the model knows.
#[derive(Clone, Debug)]
pub struct Look {
    /// The shape's name.
    pub shape: &'static str,
    /// Whether fits leave it out.
    pub held_out: bool,
    /// The droplets.
    pub droplets: Droplets,
    /// Elevation of the sun.
    pub sun_deg: f64,
    /// Scattered sunlight, 1/sr.
    pub sunlit: Estimate,
    /// Scattered light of an even sky above black ground.
    pub sky: Estimate,
    phase: Phase,
    one_minus_mu: f64,
    ray: LitRay,
}

/// What is made of light that is scattered more than once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// Nothing.
    Single,
    /// Wrenninge's octaves: how many, a, b, c.
    Octaves(u32, f64, f64, f64),
    /// The same, with A. Schneider's powder (2015): lit samples near the surface are dimmed by 1 − e^(−2 τ), all doubled.
    Powder(u32, f64, f64, f64),
    /// The fitted model.
    Fitted(FittedScattering),
}

impl Look {
    /// Scattered sunlight by a model, 1/sr.
    #[must_use]
    pub fn modelled(&self, model: &Model) -> f64 {
        let gathered = |attenuation: f64| -> f64 {
            self.ray
                .samples
                .iter()
                .map(|[weight, sun_depth]| weight * (-attenuation * sun_depth).exp())
                .sum()
        };
        let phase = |eccentricity| self.phase.per_sr(eccentricity, self.one_minus_mu);
        let single = phase(1.0) * gathered(1.0);
        match *model {
            Model::Single => single,
            Model::Octaves(octaves, a, b, c) => (1..octaves).fold(single, |sum, i| {
                let power = |base: f64| base.powi(i as i32);
                sum + power(b) * phase(power(c)) * gathered(power(a))
            }),
            Model::Powder(octaves, a, b, c) => {
                let powder =
                    |attenuation: f64| 2.0 * (gathered(attenuation) - gathered(attenuation + 2.0));
                (0..octaves).fold(0.0, |sum, i| {
                    let power = |base: f64| base.powi(i as i32);
                    sum + power(b) * phase(power(c)) * powder(power(a))
                })
            }
            Model::Fitted(fitted) => {
                let transport_share = self.phase.transport_share();
                let attenuation = (fitted.forward_attenuation * transport_share).min(1.0);
                let diffuse: f64 = self
                    .ray
                    .parts
                    .iter()
                    .map(|part| {
                        let (depth, rising) = (part.sun_depth, part.sun_rising);
                        part.shown
                            * diffuse_share(&fitted, transport_share, depth, rising, &part.around)
                    })
                    .sum();
                single
                    + fitted.forward_strength
                        * phase(fitted.forward_eccentricity)
                        * gathered(attenuation)
                    + diffuse * phase(fitted.diffuse_eccentricity)
            }
        }
    }

    /// Share of the sky that the model scatters towards the eye.
    #[must_use]
    pub fn modelled_sky(&self, fitted: &FittedScattering) -> f64 {
        let transport_share = self.phase.transport_share();
        self.ray
            .parts
            .iter()
            .map(|part| part.shown * sky_share(fitted, transport_share, &part.around, part.rising))
            .sum()
    }

    /// The same by the formula that was tuned by eye before: by height in the layer, half in solid cloud.
    #[must_use]
    pub fn sky_by_height(&self) -> f64 {
        self.opacity() * (0.3 + 0.7 * self.ray.height_fraction) * 0.5
    }

    fn opacity(&self) -> f64 {
        self.ray.samples.iter().map(|[weight, _]| weight).sum()
    }
}

/// How the model marches.
#[derive(Clone, Copy, Debug)]
pub struct SunMarch {
    /// Samples towards the sun.
    pub steps: u32,
    /// How far they reach; the renderer's default without.
    pub distance_m: Option<f64>,
}

/// All looks that are known well enough.
///
/// # Errors
/// When the truth is of other shapes.
pub fn looks(truth: &Truth, sun: SunMarch) -> anyhow::Result<Vec<Look>> {
    let mut pairs = Vec::new();
    for shape in shapes() {
        for sun_deg in SUN_ELEVATIONS_DEG {
            pairs.push((shape, sun_deg));
        }
    }
    let parts: anyhow::Result<Vec<Vec<Look>>> = pairs
        .into_par_iter()
        .map(|(shape, sun_deg)| looks_at(truth, &shape, sun_deg, sun))
        .collect();
    Ok(parts?.into_iter().flatten().collect())
}

fn looks_at(
    truth: &Truth,
    shape: &Shape,
    sun_deg: f64,
    sun: SunMarch,
) -> anyhow::Result<Vec<Look>> {
    let place = SUN_ELEVATIONS_DEG
        .iter()
        .position(|s| *s == sun_deg)
        .unwrap_or(0);
    let light = json!({"sun_march_distance_m": sun.distance_m.unwrap_or(SUN_MARCH_M)});
    let steps = MarchSteps {
        steps: STEPS,
        sun_steps: Some(sun.steps),
        ..MarchSteps::default()
    };
    let mut looks = Vec::new();
    for droplets in Droplets::ALL {
        let known = truth.of(shape, droplets).with_context(|| {
            format!(
                "the truth has no \"{}\" of {}: make it anew with --trace",
                shape.name,
                droplets.name()
            )
        })?;
        let world = shape.world(droplets, sun_deg, &light)?;
        let Some(layer) = world.layers().first() else {
            continue;
        };
        for (view, measured) in shape.views().iter().zip(&known.measured) {
            let ray: &Ray = &view.ray;
            let lit = lit_ray(&world, layer, ray, &steps);
            let x = one_minus_mu(ray.direction, world.light().sun_direction);
            let phase = *world.phase();
            let sunlit = measured.sunlit[place];
            if sunlit.standard_error >= NOISE_MAX * sunlit.mean || lit.samples.is_empty() {
                continue;
            }
            looks.push(Look {
                shape: shape.name,
                held_out: shape.held_out,
                droplets,
                sun_deg,
                sunlit,
                sky: measured.sky,
                phase,
                one_minus_mu: x,
                ray: lit,
            });
        }
    }
    Ok(looks)
}

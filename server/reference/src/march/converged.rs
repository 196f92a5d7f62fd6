//! One ray marched until finer steps change nothing.

use super::blend::{Gathering, blended, surroundings};
use super::layer::{detail_weight, layer_distance_m};
use super::sheet::sheet_surroundings;
use crate::error::checked;
use crate::path::majorant::Majorant;
use crate::shell::Interval;
use crate::transport::one_minus_exp_over;
use crate::world::Medium;
use crate::{LayerGathered, Ray, RayResult, ReferenceError, World, WorldLayer};
use glam::DVec3;
use serde::Serialize;
use skycell_protocol::SunDepth;

/// Once less than this share of the tolerance can still come through, nothing behind is lit any more; only the optical
/// depth is followed to the end.
const DARK: f64 = 1e-3;
/// Below this transmittance only its absolute change counts: what is 1e-3 of the light behind needs no four digits.
const TRANSMITTANCE_FLOOR: f64 = 1e-3;
/// Steps of the first level through the thickness of a layer and towards the sun. Even the first level resolves the
/// coarsest noise; each further one halves both.
const FIRST_STEPS: f64 = 128.0;
const FIRST_SUN_STEPS: f64 = 32.0;
/// By how much longer the first level's steps in a thin sheet are than in other layers of its thickness.
const SHEET_STEPS: f64 = 8.0;
/// Steps that share one march to the sun: optical depth towards the sun is an integral and so smoother than density. The
/// sharing is halved with the steps, so it does not stay behind.
const SHARED_STEPS: u32 = 4;

/// How far a march may be refined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ConvergeLimit {
    /// Most halvings of the steps, 1 to 24.
    pub levels: u32,
    /// Most evaluations of density of one level; a finer level that would take more is not begun.
    pub evaluations: u64,
}

impl Default for ConvergeLimit {
    fn default() -> Self {
        Self {
            levels: 12,
            evaluations: 20_000_000,
        }
    }
}

/// A ray that was marched until its picture no longer changed, or the limit was met.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Converged {
    /// What the finest level saw; its steps are the evaluations of all levels.
    pub result: RayResult,
    /// Halvings of the steps.
    pub levels: u32,
    /// Length of the finest level's steps in the layer whose were longest, m.
    pub step_m: f64,
    /// Length of its steps towards the sun, m.
    pub sun_step_m: f64,
    /// Greatest relative change from the last level but one to the last.
    pub change: f64,
    /// Whether two halvings in a row changed less than the tolerance.
    pub converged: bool,
}

/// Marches a ray by the model (single scattering, octaves, ambient term; towards the sun all layers to their ends, or where
/// the scene's `sun_depth` is the cone, the ray's own layer over the scene's distance), halving the steps until radiance
/// (every channel) and transmittance change by less than `tolerance` (relative) twice in a row.
///
/// Unlike the renderer it never stops in thin cloud, and shows layers in front of the ground. Boxes, balls and grids are
/// met exactly; weather is looked up wherever its upper bound is not 0.
///
/// # Errors
/// If the tolerance is not between 1e-12 and 1, or the limit allows no halving.
pub fn converged_ray(
    world: &World,
    ray: &Ray,
    air_direction: Option<DVec3>,
    tolerance: f64,
    limit: &ConvergeLimit,
) -> Result<Converged, ReferenceError> {
    checked("the tolerance", tolerance, 1e-12..=1.0, "1e-12 to 1")?;
    checked(
        "the limit of levels",
        f64::from(limit.levels),
        1.0..=24.0,
        "1 to 24",
    )?;
    let air_direction = air_direction.unwrap_or(ray.direction);
    let mut evaluations = 0;
    let mut last: Option<RayResult> = None;
    let (mut calm, mut change, mut level) = (0, f64::INFINITY, 0);
    loop {
        let mut result = at_level(world, ray, air_direction, level, tolerance * DARK);
        let cost = result.steps;
        evaluations += cost;
        if let Some(last) = &last {
            change = greatest_change(last, &result);
            calm = if change < tolerance { calm + 1 } else { 0 };
        }
        // Where no layer is met, there is nothing to refine.
        let converged = calm >= 2 || cost == 0;
        if converged || level >= limit.levels || 4 * cost > limit.evaluations {
            result.steps = evaluations;
            let scale = 0.5f64.powi(level as i32);
            let thickest_m = world
                .layers()
                .iter()
                .map(WorldLayer::thickness_m)
                .fold(0.0, f64::max);
            return Ok(Converged {
                result,
                levels: level,
                step_m: thickest_m / FIRST_STEPS * scale,
                sun_step_m: world.scene().light().sun_march_distance_m() / FIRST_SUN_STEPS * scale,
                change: if cost == 0 { 0.0 } else { change },
                converged,
            });
        }
        last = Some(result);
        level += 1;
    }
}

fn greatest_change(before: &RayResult, after: &RayResult) -> f64 {
    let relative = |a: f64, b: f64, floor: f64| {
        let scale = a.abs().max(b.abs()).max(floor);
        if a == b { 0.0 } else { (a - b).abs() / scale }
    };
    let colours = |a: DVec3, b: DVec3| {
        let scale = f64::MIN_POSITIVE;
        relative(a.x, b.x, scale)
            .max(relative(a.y, b.y, scale))
            .max(relative(a.z, b.z, scale))
    };
    colours(before.radiance, after.radiance).max(relative(
        before.transmittance,
        after.transmittance,
        TRANSMITTANCE_FLOOR,
    ))
}

fn at_level(world: &World, ray: &Ray, air_direction: DVec3, level: u32, dark: f64) -> RayResult {
    let scale = 0.5f64.powi(level as i32);
    let (mut gathered, mut evaluations) = (Vec::new(), 0);
    for place in 0..world.layers().len() {
        let (layer, count) = LayerMarch::new(world, place, scale).gather(ray, dark);
        gathered.push(layer);
        evaluations += count;
    }
    let mut result = blended(world, ray, air_direction, gathered);
    result.steps = evaluations;
    result
}

/// Calls back for every part of a ray in which a layer's density may be above 0, nearest first, until told to stop.
fn each_span(
    world: &World,
    place: usize,
    ray: &Ray,
    end_m: f64,
    mut found: impl FnMut(Interval) -> bool,
) {
    let layer = &world.layers()[place];
    let majorant = world.majorant(place);
    for part in world.layer_parts(layer, ray) {
        let part = part.and(Interval::new(0.0, end_m));
        if part.is_empty() {
            continue;
        }
        let Majorant::Cells(cells) = majorant else {
            if !found(part) {
                return;
            }
            continue;
        };
        let mut open: Option<Interval> = None;
        let mut at_m = part.start_m;
        while at_m < part.end_m {
            let next_m = cells.limit_m(world.globe(), ray, layer, at_m, part.end_m);
            let piece = Interval::new(at_m, next_m);
            if cells.bound(world.globe(), ray, layer, piece) > 0.0 {
                let start_m = open.map_or(at_m, |open| open.start_m);
                open = Some(Interval::new(start_m, next_m));
            } else if let Some(span) = open.take()
                && !found(span)
            {
                return;
            }
            at_m = next_m;
        }
        if let Some(span) = open
            && !found(span)
        {
            return;
        }
    }
}

/// One layer at one fineness.
pub(super) struct LayerMarch<'a> {
    world: &'a World,
    layer: &'a WorldLayer,
    place: usize,
    step_m: f64,
    sun_step_m: f64,
    sun_end_m: f64,
}

impl<'a> LayerMarch<'a> {
    pub(super) fn new(world: &'a World, place: usize, scale: f64) -> Self {
        let layer = &world.layers()[place];
        let sun_end_m = world.scene().light().sun_march_distance_m();
        // What a shape or a grid fills may be far smaller than its layer.
        let extent_m = match &layer.medium {
            Medium::Weather(_) | Medium::Full => layer.thickness_m(),
            Medium::Box { min_m, max_m } => (*max_m - *min_m).min_element(),
            Medium::Ball { radius_m, .. } => *radius_m,
            Medium::Grid(grid) => (grid.max_m - grid.min_m).min_element(),
            // Even along the height; what varies is the map.
            Medium::Sheet(_) => SHEET_STEPS * layer.thickness_m(),
        };
        let step_extent_m = match &layer.medium {
            Medium::Sheet(_) => extent_m,
            _ => layer.thickness_m().min(extent_m),
        };
        Self {
            world,
            layer,
            place,
            step_m: step_extent_m / FIRST_STEPS * scale,
            sun_step_m: sun_end_m.min(4.0 * extent_m) / FIRST_SUN_STEPS * scale,
            sun_end_m,
        }
    }

    /// ∫ σ dt towards the sun, and evaluations: of all layers to their ends, or where the scene has the cone, of this one
    /// over the cone's length.
    fn sun_depth(&self, position_m: DVec3) -> (f64, u64) {
        match self.world.scene().light().sun_depth() {
            SunDepth::Cone => self.sun_depth_of(self.place, position_m, self.sun_end_m),
            SunDepth::Volume => (0..self.world.layers().len())
                .map(|place| self.sun_depth_of(place, position_m, f64::INFINITY))
                .fold((0.0, 0), |(depth, count), (more, further)| {
                    (depth + more, count + further)
                }),
        }
    }

    pub(super) fn sun_depth_of(&self, place: usize, position_m: DVec3, end_m: f64) -> (f64, u64) {
        let layer = &self.world.layers()[place];
        let ray = Ray {
            origin_m: position_m,
            direction: self.world.light().sun_direction,
        };
        let exact = matches!(self.world.majorant(place), Majorant::Exact);
        let (mut length_m, mut evaluations) = (0.0, 0);
        each_span(self.world, place, &ray, end_m, |span| {
            if exact {
                length_m += span.length_m();
                evaluations += 1;
                return true;
            }
            let count = (span.length_m() / self.sun_step_m).ceil().max(1.0);
            let step_m = span.length_m() / count;
            let mut sum = 0.0;
            for i in 0..count as u64 {
                let at = ray.at(span.start_m + (i as f64 + 0.5) * step_m);
                sum += self.world.smooth_density(layer, at);
            }
            evaluations += count as u64;
            length_m += sum * step_m;
            true
        });
        (length_m * layer.extinction_per_m, evaluations)
    }

    /// Density as a ray at a distance sees it.
    fn sample(&self, position_m: DVec3, distance_m: f64) -> f64 {
        let place = self.world.field_place(self.layer, position_m);
        let height_fraction = self.layer.height_fraction(place.altitude_m).clamp(0.0, 1.0);
        let Medium::Weather(weather) = &self.layer.medium else {
            // Spans are exact: their samples are inside but for rounding.
            return match self.world.majorant(self.place) {
                Majorant::Exact => 1.0,
                Majorant::Cells(_) => {
                    self.world
                        .density_at(self.layer, place, height_fraction, 1.0)
                }
            };
        };
        let (Some(noise), Some(maps)) = (self.world.noise(), self.world.maps(self.layer)) else {
            return 0.0;
        };
        let profile = weather.dimensional_profile(maps, place, height_fraction);
        let weight = detail_weight(weather.detail_period_m, distance_m);
        weather.carved_density(noise, place, height_fraction, profile, weight)
    }

    fn gather(&self, ray: &Ray, dark: f64) -> (LayerGathered, u64) {
        let mut gathering = Gathering::new(self.world, self.layer, ray);
        let exact = matches!(self.world.majorant(self.place), Majorant::Exact);
        let shared = if exact { 1 } else { SHARED_STEPS };
        let extinction = self.layer.extinction_per_m;
        let (mut transmittance, mut optical_depth) = (1.0, 0.0);
        let mut evaluations = 0;
        each_span(self.world, self.place, ray, f64::INFINITY, |span| {
            if exact && transmittance < dark {
                let depth = extinction * span.length_m();
                optical_depth += depth;
                transmittance *= (-depth).exp();
                evaluations += 1;
                return true;
            }
            let count = (span.length_m() / self.step_m).ceil().max(1.0);
            let step_m = span.length_m() / count;
            let count = count as u64;
            let mut next = 0;
            while next < count {
                let block = u64::from(shared).min(count - next);
                if transmittance < dark {
                    if exact {
                        let depth = extinction * step_m * (count - next) as f64;
                        optical_depth += depth;
                        transmittance *= (-depth).exp();
                        break;
                    }
                    // Nothing is lit here any more: the whole block by its middle.
                    let at_m = span.start_m + (next as f64 + 0.5 * block as f64) * step_m;
                    let density = self.sample(ray.at(at_m), at_m);
                    let depth = density * extinction * step_m * block as f64;
                    optical_depth += depth;
                    transmittance *= (-depth).exp();
                    evaluations += 1;
                    next += block;
                    continue;
                }
                let mut sun_depth = None;
                for i in next..next + block {
                    let at_m = span.start_m + (i as f64 + 0.5) * step_m;
                    let density = self.sample(ray.at(at_m), at_m);
                    evaluations += 1;
                    if density <= 0.0 {
                        continue;
                    }
                    let sun_depth = *sun_depth.get_or_insert_with(|| {
                        let middle_m = span.start_m + (next as f64 + 0.5 * block as f64) * step_m;
                        let (depth, count) = self.sun_depth(ray.at(middle_m));
                        evaluations += count;
                        depth
                    });
                    let depth = density * extinction * step_m;
                    let weight = transmittance * depth * one_minus_exp_over(depth);
                    gathering.add(weight, at_m, sun_depth);
                    optical_depth += depth;
                    transmittance *= (-depth).exp();
                }
                next += block;
            }
            true
        });
        let parts = self.world.globe().layer_intervals(
            self.layer.base_altitude_m,
            self.layer.top_altitude_m,
            ray,
        );
        let gathered = gathering.finished(
            transmittance,
            optical_depth,
            layer_distance_m(parts),
            |place_m, up| match &self.layer.medium {
                Medium::Sheet(_) => sheet_surroundings(self.world, self.layer, place_m),
                _ => surroundings(self.world, self.layer, place_m, up),
            },
        );
        (gathered, evaluations)
    }
}

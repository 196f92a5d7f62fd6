//! Free flights and transmittances through all layers.

use super::Random;
use super::majorant::Majorant;
use crate::density::shape::Parts;
use crate::shell::Interval;
use crate::{Ray, World};
use glam::DVec3;
use std::ops::ControlFlow;

/// Most layers of a scene.
const LAYERS: usize = skycell_protocol::scene::ranges::LAYERS_MAX;
/// Below this transmittance a ratio-tracked ray plays Russian roulette.
const ROULETTE_BELOW: f64 = 0.1;

/// Where a path collides with cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Collision {
    /// Distance along the ray, m.
    pub distance_m: f64,
    /// Where, in the local frame, m.
    pub position_m: DVec3,
    /// Share of extinction that is scattering there, over all layers that overlap.
    pub albedo: f64,
    /// The layer, by its place in the world's, that is densest there.
    pub layer: usize,
    /// The layer whose droplet or crystal it hit: where layers overlap, drawn by their shares of the scattering.
    pub scatterer: usize,
}

/// A place at which a ray may collide.
struct Tentative {
    distance_m: f64,
    position_m: DVec3,
    extinction_per_m: f64,
    scattering_per_m: f64,
    bound_per_m: f64,
    layer: usize,
    scattering_by_layer_per_m: [f64; LAYERS],
}

impl Tentative {
    /// The layer that scatters. No random number is drawn where there is no choice.
    fn scatterer(&self, random: &mut Random) -> usize {
        let scattering = self.scattering_by_layer_per_m.iter().filter(|s| **s > 0.0);
        if scattering.count() < 2 {
            return self.layer;
        }
        let mut left = random.unit() * self.scattering_per_m;
        for (place, own) in self.scattering_by_layer_per_m.iter().enumerate() {
            left -= own;
            if *own > 0.0 && left < 0.0 {
                return place;
            }
        }
        self.layer
    }
}

/// Tracks rays through a world and counts what that takes.
#[derive(Debug)]
pub struct Tracker<'a> {
    world: &'a World,
    majorants: &'a [Majorant],
    /// Factor of every upper bound; only tests change it, to show that too low ones are noticed.
    bound_scale: f64,
    /// Evaluations of density so far.
    pub evaluations: u64,
    /// Evaluations at which density was above its bound.
    pub above_majorant: u64,
}

/// A ray with the parts of all layers that it meets.
struct Course<'a> {
    ray: &'a Ray,
    parts: [Parts; LAYERS],
}

/// A part of a ray with the layers that it is in.
struct Stretch {
    part: Interval,
    inside: [bool; LAYERS],
}

impl Course<'_> {
    /// The next part, from a distance on, in which the set of layers does not change.
    fn next(&self, from_m: f64) -> Option<Stretch> {
        let mut at_m = from_m;
        loop {
            let mut inside = [false; LAYERS];
            let mut end_m = f64::INFINITY;
            for (parts, inside) in self.parts.iter().zip(&mut inside) {
                for part in parts.iter().filter(|p| !p.is_empty() && p.end_m > at_m) {
                    if part.start_m <= at_m {
                        *inside = true;
                        end_m = end_m.min(part.end_m);
                    } else {
                        end_m = end_m.min(part.start_m);
                    }
                }
            }
            if end_m == f64::INFINITY {
                return None;
            }
            if inside.contains(&true) {
                return Some(Stretch {
                    part: Interval::new(at_m, end_m),
                    inside,
                });
            }
            at_m = end_m;
        }
    }
}

impl<'a> Tracker<'a> {
    /// A tracker of a world.
    #[must_use]
    pub fn new(world: &'a World) -> Self {
        Self::with_bound_scale(world, 1.0)
    }

    /// A tracker whose upper bounds are multiplied by a factor. A factor below 1 makes them wrong: for tests.
    #[must_use]
    pub fn with_bound_scale(world: &'a World, bound_scale: f64) -> Self {
        Self {
            world,
            majorants: world.majorants().layers(),
            bound_scale,
            evaluations: 0,
            above_majorant: 0,
        }
    }

    fn course<'r>(&self, ray: &'r Ray, wanted: impl Fn(&Majorant) -> bool) -> Course<'r> {
        let mut parts = [[Interval::EMPTY; 2]; LAYERS];
        for ((layer, majorant), parts) in self
            .world
            .layers()
            .iter()
            .zip(self.majorants)
            .zip(&mut parts)
        {
            if wanted(majorant) {
                *parts = self.world.layer_parts(layer, ray);
            }
        }
        Course { ray, parts }
    }

    /// The longest first part of a stretch over which one bound of all extinctions holds, and that bound, 1/m.
    fn bounded(&self, ray: &Ray, stretch: &Stretch, from_m: f64) -> (f64, f64) {
        let globe = self.world.globe();
        let layers = || {
            self.world
                .layers()
                .iter()
                .zip(self.majorants)
                .zip(stretch.inside)
                .filter(|(_, inside)| *inside)
                .map(|(pair, _)| pair)
        };
        let mut end_m = stretch.part.end_m;
        for (layer, majorant) in layers() {
            if let Majorant::Cells(cells) = majorant {
                end_m = cells.limit_m(globe, ray, layer, from_m, end_m);
            }
        }
        let part = Interval::new(from_m, end_m);
        let bound_per_m = layers()
            .map(|(layer, majorant)| {
                let density = match majorant {
                    Majorant::Exact => 1.0,
                    Majorant::Cells(cells) => cells.bound(globe, ray, layer, part),
                };
                density * layer.extinction_per_m
            })
            .sum::<f64>();
        (end_m, bound_per_m * self.bound_scale)
    }

    /// Extinction at a point, 1/m, its scattering part by layer, and the densest layer.
    fn extinction(&mut self, stretch: &Stretch, position_m: DVec3) -> (f64, [f64; LAYERS], usize) {
        let (mut extinction, mut scattering, mut densest) = (0.0, [0.0; LAYERS], (0.0, 0));
        for (place, layer) in self.world.layers().iter().enumerate() {
            if !stretch.inside[place] {
                continue;
            }
            self.evaluations += 1;
            let density = match self.majorants[place] {
                // The parts of the ray are the medium itself.
                Majorant::Exact => 1.0,
                Majorant::Cells(_) => self.world.density(layer, position_m, 1.0),
            };
            let own = density * layer.extinction_per_m;
            extinction += own;
            scattering[place] = own * layer.albedo;
            if own > densest.0 {
                densest = (own, place);
            }
        }
        (extinction, scattering, densest.1)
    }

    /// Visits the tentative collisions of a ray, nearest first: a Poisson process with the rate of the bounds. Stops when
    /// told to.
    fn visit(
        &mut self,
        course: &Course<'_>,
        random: &mut Random,
        mut visited: impl FnMut(&Tentative, &mut Random) -> ControlFlow<()>,
    ) {
        let mut left = random.exponential();
        let mut at_m = 0.0;
        while let Some(stretch) = course.next(at_m) {
            at_m = stretch.part.start_m;
            while at_m < stretch.part.end_m {
                let (end_m, bound_per_m) = self.bounded(course.ray, &stretch, at_m);
                while at_m + left / bound_per_m < end_m {
                    at_m += left / bound_per_m;
                    left = random.exponential();
                    let position_m = course.ray.at(at_m);
                    let (extinction_per_m, scattering_by_layer_per_m, layer) =
                        self.extinction(&stretch, position_m);
                    if extinction_per_m > bound_per_m * (1.0 + 1e-12) {
                        self.above_majorant += 1;
                    }
                    let tentative = Tentative {
                        distance_m: at_m,
                        position_m,
                        extinction_per_m,
                        scattering_per_m: scattering_by_layer_per_m.iter().sum(),
                        bound_per_m,
                        layer,
                        scattering_by_layer_per_m,
                    };
                    if visited(&tentative, random).is_break() {
                        return;
                    }
                }
                // Rounding may leave a little less than nothing.
                left = (left - bound_per_m * (end_m - at_m)).max(0.0);
                at_m = end_m;
            }
        }
    }

    /// The place of a ray's first collision, distributed as e^(−τ) dτ by delta tracking; `None` where it leaves the clouds.
    pub fn collision(&mut self, ray: &Ray, random: &mut Random) -> Option<Collision> {
        let course = self.course(ray, |_| true);
        let mut found = None;
        self.visit(&course, random, |at, random| {
            if random.unit() * at.bound_per_m >= at.extinction_per_m {
                return ControlFlow::Continue(());
            }
            found = Some(Collision {
                distance_m: at.distance_m,
                position_m: at.position_m,
                albedo: at.scattering_per_m / at.extinction_per_m,
                layer: at.layer,
                scatterer: at.scatterer(random),
            });
            ControlFlow::Break(())
        });
        found
    }

    /// Optical depth of the homogeneous layers along a ray, exactly.
    fn exact_depth(&self, ray: &Ray) -> f64 {
        let layers = self.world.layers().iter().zip(self.majorants);
        layers
            .filter(|(_, majorant)| matches!(majorant, Majorant::Exact))
            .map(|(layer, _)| {
                let parts = self.world.layer_parts(layer, ray);
                let length_m: f64 = parts.iter().map(Interval::length_m).sum();
                length_m * layer.extinction_per_m
            })
            .sum()
    }

    /// An unbiased estimate of a ray's transmittance by ratio tracking; homogeneous layers are exact. Where little is left,
    /// Russian roulette ends it.
    pub fn transmittance(&mut self, ray: &Ray, random: &mut Random) -> f64 {
        let kept = (-self.exact_depth(ray)).exp();
        kept * self.ratio_tracked(ray, random, true).0
    }

    /// Unbiased estimates of a ray's transmittance and optical depth. Follows the ray to its end.
    pub fn transmittance_and_depth(&mut self, ray: &Ray, random: &mut Random) -> (f64, f64) {
        let exact = self.exact_depth(ray);
        let (kept, depth) = self.ratio_tracked(ray, random, false);
        ((-exact).exp() * kept, exact + depth)
    }

    /// Tentative collisions come with the rate of the bound σ̄. The product of 1 − σ/σ̄ over them has the mean e^(−τ), and
    /// the sum of σ/σ̄ the mean τ (Campbell's theorem).
    fn ratio_tracked(&mut self, ray: &Ray, random: &mut Random, roulette: bool) -> (f64, f64) {
        let course = self.course(ray, |majorant| matches!(majorant, Majorant::Cells(_)));
        let (mut kept, mut depth) = (1.0, 0.0);
        self.visit(&course, random, |at, random| {
            let ratio = at.extinction_per_m / at.bound_per_m;
            depth += ratio;
            kept *= 1.0 - ratio;
            if roulette && kept < ROULETTE_BELOW {
                if random.unit() * ROULETTE_BELOW >= kept {
                    kept = 0.0;
                    return ControlFlow::Break(());
                }
                kept = ROULETTE_BELOW;
            }
            ControlFlow::Continue(())
        });
        (kept, depth)
    }
}

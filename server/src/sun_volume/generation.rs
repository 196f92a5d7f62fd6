//! The columns of all layers along one direction.

use super::columns::Columns;
use super::size::SunVolumeSize;
use glam::{DVec2, DVec3};

/// Columns along a direction that is off by more are made anew. At 45° that moves a shadow 1 km below by 3.5 m.
const DIRECTION_TOLERANCE_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Noise that has risen by more has changed the clouds: a fifth of the distance between columns.
const RISE_TOLERANCE_M: f64 = 10.0;
/// Most samples between two slices.
const SUBSTEPS_MAX: u32 = 8;

fn horizontal(v: DVec3) -> DVec2 {
    DVec2::new(v.x, v.z)
}

/// Between which altitudes a layer lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerShell {
    /// m
    pub base_altitude_m: f64,
    /// m
    pub top_altitude_m: f64,
}

/// What a volume is wanted for.
#[derive(Clone, Debug, PartialEq)]
pub struct GenerationInputs {
    /// Towards the sun.
    pub direction: DVec3,
    /// Where viewers are: world x and z, m.
    pub center_m: DVec2,
    /// Radius of the planet.
    pub planet_radius_m: f64,
    /// The shown layers, and how far wind has carried each and its noise has risen, m.
    pub layers: Vec<(LayerShell, DVec3)>,
}

/// Columns to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    /// Place among the shown layers.
    pub layer: usize,
    /// Level of the clipmap.
    pub level: u32,
    /// Which.
    pub columns: Columns,
    /// Density is looked up so often for them.
    pub evaluations: u64,
}

#[derive(Clone, Debug, PartialEq)]
struct LayerVolume {
    shell: LayerShell,
    /// Origin of the frame in which its columns are made, in the layer's field.
    origin_m: DVec2,
    /// How far its noise had risen when it began.
    risen_m: f64,
    known: Vec<Columns>,
}

/// The columns of all layers along one direction: what is known, and what is to be made.
#[derive(Clone, Debug, PartialEq)]
pub struct Generation {
    size: SunVolumeSize,
    direction: DVec3,
    layers: Vec<LayerVolume>,
}

impl Generation {
    /// One in which nothing is known.
    #[must_use]
    pub fn new(size: SunVolumeSize, inputs: &GenerationInputs) -> Self {
        let layers = inputs
            .layers
            .iter()
            .map(|(shell, drift_m)| LayerVolume {
                shell: *shell,
                origin_m: inputs.center_m - horizontal(*drift_m),
                risen_m: drift_m.y,
                known: vec![Columns::default(); size.levels as usize],
            })
            .collect();
        Self {
            size,
            direction: inputs.direction,
            layers,
        }
    }

    /// Direction of the columns.
    #[must_use]
    pub fn direction(&self) -> DVec3 {
        self.direction
    }

    /// Size.
    #[must_use]
    pub fn size(&self) -> SunVolumeSize {
        self.size
    }

    /// How many layers it has.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.layers.len()
    }

    /// Where a layer lies.
    #[must_use]
    pub fn shell(&self, layer: usize) -> LayerShell {
        self.layers[layer].shell
    }

    /// Origin of the frame in which a layer's columns are made, in its field.
    #[must_use]
    pub fn origin_m(&self, layer: usize) -> DVec2 {
        self.layers[layer].origin_m
    }

    /// What is known of a level.
    #[must_use]
    pub fn known(&self, layer: usize, level: u32) -> Columns {
        self.layers[layer].known[level as usize]
    }

    /// By how much its columns are off, rad: the sun has moved, or the clouds so far around the planet that the sun stands
    /// elsewhere over them.
    #[must_use]
    pub fn off_by_rad(&self, inputs: &GenerationInputs) -> f64 {
        let turned = self.direction.angle_between(inputs.direction);
        let tilted = self
            .layers
            .iter()
            .zip(&inputs.layers)
            .map(|(layer, (_, drift_m))| {
                let moved_m = inputs.center_m - horizontal(*drift_m) - layer.origin_m;
                moved_m.length() / inputs.planet_radius_m
            })
            .fold(0.0, f64::max);
        turned + tilted
    }

    /// How far a layer's noise had risen when this began; its columns are all of that time.
    #[must_use]
    pub fn risen_m(&self, layer: usize) -> f64 {
        self.layers[layer].risen_m
    }

    /// Whether its columns no longer run to the sun, or clouds have changed their shapes since.
    #[must_use]
    pub fn is_stale(&self, inputs: &GenerationInputs) -> bool {
        let has_risen = self
            .layers
            .iter()
            .zip(&inputs.layers)
            .any(|(layer, (_, drift_m))| (drift_m.y - layer.risen_m).abs() > RISE_TOLERANCE_M);
        has_risen || self.off_by_rad(inputs) > DIRECTION_TOLERANCE_RAD
    }

    /// Samples between two slices: none further apart than the columns of the finest level.
    #[must_use]
    pub fn substeps(&self, layer: usize) -> u32 {
        let shell = self.layers[layer].shell;
        let slice_m =
            (shell.top_altitude_m - shell.base_altitude_m) / f64::from(self.size.slices - 1);
        let along_m = slice_m / self.direction.y.max(1e-3);
        ((along_m / self.size.spacing_m - 0.5).ceil().max(1.0) as u32).min(SUBSTEPS_MAX)
    }

    fn window(&self, layer: usize, level: u32, inputs: &GenerationInputs) -> Columns {
        let LayerVolume { shell, .. } = self.layers[layer];
        let (_, drift_m) = inputs.layers[layer];
        // Feet of what stands over the viewers at half the layer's height.
        let half_m = 0.5 * (shell.top_altitude_m - shell.base_altitude_m);
        let lean = DVec2::new(self.direction.x, self.direction.z) / self.direction.y.max(1e-3);
        let foot_m = inputs.center_m - horizontal(drift_m) - lean * half_m;
        let at = foot_m / self.size.spacing_of_level_m(level);
        Columns::window(
            at.to_array(),
            i64::from(self.size.columns),
            self.size.strip(),
        )
    }

    /// Takes windows to where they are wanted and tells what is to be made next, the finest level first: strips until
    /// they take about `evaluations_max`, at least one. They count as known from here on.
    pub fn advance(&mut self, inputs: &GenerationInputs, evaluations_max: u64) -> Vec<Strip> {
        let mut strips = Vec::new();
        let mut evaluations = 0;
        for level in 0..self.size.levels {
            for layer in 0..self.layers.len() {
                let window = self.window(layer, level, inputs);
                let samples = u64::from(self.size.slices - 1) * u64::from(self.substeps(layer));
                loop {
                    let strip_size = self.size.strip();
                    let known = &mut self.layers[layer].known[level as usize];
                    // Forgets what is outside also where nothing may be made any more.
                    let Some(columns) = known.next_strip(&window, strip_size) else {
                        break;
                    };
                    if evaluations > 0 && evaluations >= evaluations_max {
                        break;
                    }
                    known.grow(&columns);
                    let strip = Strip {
                        layer,
                        level,
                        columns,
                        evaluations: columns.count() * samples,
                    };
                    evaluations += strip.evaluations;
                    strips.push(strip);
                }
            }
        }
        strips
    }

    /// Whether all windows are full.
    #[must_use]
    pub fn is_complete(&self, inputs: &GenerationInputs) -> bool {
        (0..self.size.levels).all(|level| {
            (0..self.layers.len())
                .all(|layer| self.known(layer, level) == self.window(layer, level, inputs))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs(direction: DVec3, center_m: DVec2, drift_m: DVec3) -> GenerationInputs {
        GenerationInputs {
            direction: direction.normalize(),
            center_m,
            planet_radius_m: 6.36e6,
            layers: vec![(
                LayerShell {
                    base_altitude_m: 1500.0,
                    top_altitude_m: 4000.0,
                },
                drift_m,
            )],
        }
    }

    fn evaluations(strips: &[Strip]) -> u64 {
        strips.iter().map(|strip| strip.evaluations).sum()
    }

    #[test]
    fn a_sky_at_rest_is_swept_once_in_slices_and_then_costs_nothing() {
        let at = inputs(DVec3::new(0.3, 1.0, 0.1), DVec2::ZERO, DVec3::ZERO);
        let size = SunVolumeSize::default();
        let mut volume = Generation::new(size, &at);
        let all = u64::from(size.columns).pow(2) * u64::from(size.slices - 1);
        let all = all * u64::from(size.levels);
        let all = all * u64::from(volume.substeps(0));
        let mut made = 0;
        while !volume.is_complete(&at) {
            let strips = volume.advance(&at, 100_000);
            let step = evaluations(&strips);
            // A slice is no larger than asked for and one strip.
            assert!(step > 0 && step < 100_000 + all / 16);
            made += step;
        }
        assert_eq!(made, all);
        assert_eq!(volume.advance(&at, 100_000), []);
    }

    #[test]
    fn wind_costs_only_what_enters_the_windows() {
        let up = DVec3::new(0.0, 1.0, 0.0);
        let mut volume = Generation::new(
            SunVolumeSize::default(),
            &inputs(up, DVec2::ZERO, DVec3::ZERO),
        );
        let whole = evaluations(&volume.advance(&inputs(up, DVec2::ZERO, DVec3::ZERO), u64::MAX));
        // Ten minutes of 5 m/s: 3 km of a window of 12.8 km at the finest level, half as much of the next.
        let drifted = inputs(up, DVec2::ZERO, DVec3::new(3000.0, 0.0, 0.0));
        assert!(!volume.is_stale(&drifted));
        let entered = evaluations(&volume.advance(&drifted, u64::MAX)) as f64 / whole as f64;
        let expected = (3000.0 / 12_800.0) * (1.0 + 0.5) / 2.0;
        assert!(
            (entered / expected - 1.0).abs() < 0.1,
            "{entered} {expected}"
        );
    }

    #[test]
    fn a_sun_that_has_moved_and_clouds_far_around_the_planet_make_it_stale() {
        let noon = DVec3::new(0.0, 1.0, 0.0);
        let volume = Generation::new(
            SunVolumeSize::default(),
            &inputs(noon, DVec2::ZERO, DVec3::ZERO),
        );
        let later = inputs(DVec3::new(0.003, 1.0, 0.0), DVec2::ZERO, DVec3::ZERO);
        assert!(volume.is_stale(&later));
        let hardly = inputs(DVec3::new(0.001, 1.0, 0.0), DVec2::ZERO, DVec3::ZERO);
        assert!(!volume.is_stale(&hardly));
        let far = inputs(noon, DVec2::new(20_000.0, 0.0), DVec3::ZERO);
        assert!(volume.is_stale(&far));
        // A viewer who drifts with the clouds sees the sun turn over them as well.
        let with_clouds = inputs(
            noon,
            DVec2::new(20_000.0, 0.0),
            DVec3::new(20_000.0, 0.0, 0.0),
        );
        assert!(!volume.is_stale(&with_clouds));
    }

    #[test]
    fn noise_that_has_risen_makes_it_stale() {
        let noon = DVec3::new(0.0, 1.0, 0.0);
        let still = inputs(noon, DVec2::ZERO, DVec3::ZERO);
        let volume = Generation::new(SunVolumeSize::default(), &still);
        let risen = |y_m: f64| inputs(noon, DVec2::ZERO, DVec3::new(0.0, y_m, 0.0));
        assert!(!volume.is_stale(&risen(9.0)) && volume.is_stale(&risen(11.0)));
    }
}

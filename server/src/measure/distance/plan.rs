//! What is measured: from where, which way, how far, and how the cache is read.

use crate::cells::{CellLimit, Storeys};
use crate::config::FrameFilter;
use crate::frame_loop::StillSettings;
use crate::march::{MarchSettings, active_layers, layer_bounds_m};
use crate::quality::default_parallax_steps;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, RendererKind, Scene};

/// Which way the reference point lies from the eye.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// To the right.
    Sideways,
    /// Ahead, level.
    Forward,
    /// Above.
    Up,
}

impl Direction {
    /// Every direction, in the order of the report.
    pub const ALL: [Self; 3] = [Self::Sideways, Self::Forward, Self::Up];

    /// As people read it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sideways => "sideways",
            Self::Forward => "forward",
            Self::Up => "up",
        }
    }

    /// How far the reference goes, m, by rising distance from 0.
    #[must_use]
    pub fn distances_m(self, is_quick: bool) -> &'static [f64] {
        match (self, is_quick) {
            // From 1.5 km on a reference is in the clouds of the default scene.
            (Self::Up, false) => &[0.0, 100.0, 300.0, 600.0, 800.0, 1_100.0, 1_450.0],
            (_, false) => &[0.0, 100.0, 300.0, 1_000.0, 3_000.0, 4_500.0, 5_000.0],
            (Self::Up, true) => &[0.0, 300.0, 1_100.0],
            (_, true) => &[0.0, 1_000.0, 3_000.0],
        }
    }

    /// Those of some distances, m, at which the reference is on the eye's side of each layer of a scene: nobody else shares its cell.
    #[must_use]
    pub fn shared_m(self, scene: &Scene, eye_m: f64, distances_m: &[f64]) -> Vec<f64> {
        let storeys = Storeys::of(&layer_bounds_m(scene, &active_layers(scene)));
        let limit = CellLimit::default().with_storeys(storeys);
        let is_shared = |distance_m: &f64| match self {
            Self::Up => {
                let [eye, reference] = [0.0, *distance_m].map(|up_m| DVec3::Y * (eye_m + up_m));
                limit.share_storey(eye, reference)
            }
            Self::Sideways | Self::Forward => true,
        };
        distances_m.iter().copied().filter(is_shared).collect()
    }

    /// The distance whose error others are asked to reach later, m.
    #[must_use]
    pub const fn compared_at_m(self) -> f64 {
        match self {
            Self::Sideways | Self::Forward => 1_000.0,
            Self::Up => 300.0,
        }
    }

    /// From the eye to the reference: x, altitude, z.
    #[must_use]
    pub fn offset_m(self, camera: &Camera, distance_m: f64) -> DVec3 {
        let way = match self {
            Self::Sideways => camera.right(),
            Self::Forward => DVec3::Y.cross(camera.right()),
            Self::Up => DVec3::Y,
        };
        // No zero has a sign: the same place is told in the same way.
        way * distance_m + DVec3::ZERO
    }
}

/// Where the middle of the picture looks.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum View {
    /// To the sun's side.
    TowardsSun,
    /// The sun behind.
    AwayFromSun,
}

impl View {
    /// Both.
    pub const ALL: [Self; 2] = [Self::TowardsSun, Self::AwayFromSun];

    /// As people read it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TowardsSun => "towards the sun",
            Self::AwayFromSun => "away from the sun",
        }
    }

    /// Clockwise from north, with the sun at `sun_azimuth_deg`.
    #[must_use]
    pub fn yaw_deg(self, sun_azimuth_deg: f64) -> f64 {
        match self {
            Self::TowardsSun => sun_azimuth_deg,
            Self::AwayFromSun => (sun_azimuth_deg + 180.0) % 360.0,
        }
    }
}

/// How a viewer reads the cache.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// On one sphere a layer, with the phase of the reference's ray (Weinrauch et al. 2023).
    Plain,
    /// The same with the phase of the viewer's own ray.
    Phase,
    /// And a search along the viewer's ray, at 16 places.
    Parallax,
    /// Four slabs a layer, each on its sphere alone.
    Slabs,
    /// Four slabs a layer, each searched at 16 places.
    All,
    /// One sphere, searched at 4 places.
    ParallaxFew,
    /// Two slabs, each searched at 16 places.
    TwoSlabs,
    /// Two slabs, each searched at 4 places.
    TwoSlabsFew,
    /// Four slabs, each searched at 4 places.
    AllFew,
}

/// Places of a search where reading the cache is dear.
const FEW_PLACES: u32 = 4;

impl Variant {
    /// Every variant: those that are compared, from the simplest on, and those of which only the curves are needed.
    pub const ALL: [Self; 9] = [
        Self::Plain,
        Self::Phase,
        Self::Parallax,
        Self::Slabs,
        Self::All,
        Self::ParallaxFew,
        Self::TwoSlabs,
        Self::TwoSlabsFew,
        Self::AllFew,
    ];
    /// Those that are measured where nobody says which.
    pub const COMPARED: [Self; 5] = [
        Self::Plain,
        Self::Phase,
        Self::Parallax,
        Self::Slabs,
        Self::All,
    ];

    /// As people read it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Phase => "phase",
            Self::Parallax => "parallax",
            Self::Slabs => "4 slabs",
            Self::All => "all (4 slabs, searched)",
            Self::ParallaxFew => "parallax, 4 places",
            Self::TwoSlabs => "2 slabs, searched",
            Self::TwoSlabsFew => "2 slabs, 4 places",
            Self::AllFew => "4 slabs, 4 places",
        }
    }

    /// As it is asked for, and as files are named.
    ///
    /// # Errors
    /// Never for any of these.
    pub fn file_name(self) -> serde_json::Result<String> {
        let name = serde_json::to_value(self)?;
        serde_json::from_value(name)
    }

    /// Slabs of a layer.
    #[must_use]
    pub const fn slabs(self) -> u32 {
        match self {
            Self::Plain | Self::Phase | Self::Parallax | Self::ParallaxFew => 1,
            Self::TwoSlabs | Self::TwoSlabsFew => 2,
            Self::Slabs | Self::All | Self::AllFew => 4,
        }
    }

    /// Most places of a search in each of them.
    #[must_use]
    pub const fn parallax_steps(self) -> u32 {
        match self {
            Self::Plain | Self::Phase | Self::Slabs => 0,
            Self::Parallax | Self::All | Self::TwoSlabs => default_parallax_steps(),
            Self::ParallaxFew | Self::TwoSlabsFew | Self::AllFew => FEW_PLACES,
        }
    }

    /// Whether a server can be set so: its viewers have their own phase.
    #[must_use]
    pub fn is_served(self) -> bool {
        self != Self::Plain
    }
}

/// How rays are marched, in the cache and on the screen alike.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fineness {
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Samples of a texel or pixel.
    pub samples: u32,
}

impl Fineness {
    /// The picture that all others are compared with: a ray per pixel and sample, from the eye.
    #[must_use]
    pub fn screen_space(self) -> StillSettings {
        StillSettings {
            renderer: RendererKind::ScreenSpace,
            march: MarchSettings {
                steps: self.steps,
                ..MarchSettings::default()
            },
            samples: self.samples,
            frames: 1,
            filter: FrameFilter::CatmullRom,
            ..StillSettings::default()
        }
    }

    /// The same from a cache whose rays start `offset_m` from the eye.
    #[must_use]
    pub fn cached(self, variant: Variant, offset_m: DVec3) -> StillSettings {
        StillSettings {
            renderer: RendererKind::Cached,
            reference_offset_m: offset_m.to_array(),
            parallax_steps: variant.parallax_steps(),
            slabs: variant.slabs(),
            phase_of_reference: variant == Variant::Plain,
            ..self.screen_space()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_in_or_above_the_clouds_is_left_out() {
        let scene = Scene::default();
        let shared_m =
            |direction: Direction| direction.shared_m(&scene, 2.0, direction.distances_m(false));
        assert_eq!(shared_m(Direction::Up).last(), Some(&1_450.0));
        assert_eq!(shared_m(Direction::Forward).last(), Some(&5_000.0));
        let found_m = Direction::Up.shared_m(&scene, 2.0, &[0.0, 1_497.0, 1_499.0, 9_000.0]);
        assert_eq!(found_m, [0.0, 1_497.0]);
    }

    #[test]
    fn directions_are_level_or_upright_and_as_long_as_they_say() {
        // Looking east and up: right is south, forward is east whatever the pitch.
        let camera = Camera::new([5.0, 2.0, 5.0], 90.0, 40.0, 60.0).expect("a camera");
        for (direction, way) in [
            (Direction::Sideways, DVec3::Z),
            (Direction::Forward, DVec3::X),
            (Direction::Up, DVec3::Y),
        ] {
            let offset_m = direction.offset_m(&camera, 300.0);
            assert!(
                offset_m.distance(way * 300.0) < 1e-9,
                "{direction:?}: {offset_m}"
            );
        }
    }

    #[test]
    fn distances_rise_from_nothing_and_hold_the_one_that_is_compared_at() {
        for direction in Direction::ALL {
            for is_quick in [false, true] {
                let distances_m = direction.distances_m(is_quick);
                assert_eq!(distances_m[0], 0.0);
                assert!(distances_m.is_sorted_by(|a, b| a < b));
                assert!(distances_m.contains(&direction.compared_at_m()));
            }
        }
    }

    #[test]
    fn the_sun_is_ahead_or_behind() {
        assert_eq!(View::TowardsSun.yaw_deg(250.0), 250.0);
        assert_eq!(View::AwayFromSun.yaw_deg(250.0), 70.0);
    }
}

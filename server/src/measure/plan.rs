//! What is measured: the sweeps as data.

use super::settings::{PictureCodec, PointSettings};
use crate::config::FrameFilter;
use crate::sun_volume::SunVolumeSize;
use serde::{Deserialize, Serialize};
use skycell_protocol::{RendererKind, SunDepth};

/// What a sweep changes.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// What each way to save work brings, one upon the other.
    Ladder,
    /// Steps through a layer.
    Steps,
    /// Steps towards the sun.
    SunSteps,
    /// Cone and volume towards the sun.
    SunVolume,
    /// Terms of the multiple-scattering sum.
    Octaves,
    /// Frames over which one picture's steps are spread.
    Window,
    /// Sides of the marched picture.
    Resolution,
    /// Halvings of the cache's resolution.
    MipBias,
    /// How far the cache's reference point is from the eye.
    Offset,
    /// Samples that the cache has taken so far.
    Budget,
    /// How the cache stores texels.
    TexelFormat,
    /// How the picture is compressed.
    Codec,
    /// The neighbours of what nothing beats.
    Front,
}

impl Axis {
    /// Every axis, in the order of the report.
    pub const ALL: [Self; 13] = [
        Self::Ladder,
        Self::Steps,
        Self::SunSteps,
        Self::SunVolume,
        Self::Octaves,
        Self::Window,
        Self::Resolution,
        Self::MipBias,
        Self::Offset,
        Self::Budget,
        Self::TexelFormat,
        Self::Codec,
        Self::Front,
    ];

    /// Its heading in the report.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Ladder => "Ladder",
            Self::Steps => "Steps",
            Self::SunSteps => "Sun steps",
            Self::SunVolume => "Sun volume",
            Self::Octaves => "Octaves",
            Self::Window => "Temporal window",
            Self::Resolution => "Resolution",
            Self::MipBias => "Mip bias",
            Self::Offset => "Reference point",
            Self::Budget => "Update budget",
            Self::TexelFormat => "Texel format",
            Self::Codec => "Codec",
            Self::Front => "Along the front",
        }
    }

    /// What it changes and what stays, for the report.
    #[must_use]
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Ladder => {
                "Each rung adds one way to save work to the rungs above it (screen-space renderer). The window has \
                 16 frames; from it on, costs are those of one of them, and the picture is that of a camera at rest."
            }
            Self::Steps => "Steps through a layer's thickness (screen-space renderer).",
            Self::SunSteps => {
                "Steps of the cone march to the sun; the last point is the many-step march that it stands for."
            }
            Self::SunVolume => {
                "Cones of n steps, and sun volumes: distance of the finest columns, samples before the read. Each picture pays for its own volume; a server makes one for all cells and frames."
            }
            Self::Octaves => {
                "Terms of the multiple-scattering sum; the reference has as many as the scene."
            }
            Self::Window => {
                "n frames share the steps of one picture: each takes every n-th, and cuts one in up to four where cloud begins. \
                 Costs are those of a frame."
            }
            Self::Resolution => {
                "The marched picture's sides as a share of the shown one's (screen-space renderer)."
            }
            Self::MipBias => "Halvings of the cache's resolution below the screen's.",
            Self::Offset => "The cache's rays start so far to the right of the eye.",
            Self::Budget => "What the cache shows when it has taken so many samples of each texel.",
            Self::TexelFormat => {
                "How texels are stored. This build has one format: 12 bytes, four half floats and a distance."
            }
            Self::Codec => "The same picture compressed; its cost is its bytes.",
            Self::Front => {
                "Neighbours, one setting changed by one notch, of points that no other beats in cost and FLIP."
            }
        }
    }

    /// What its points stand along.
    #[must_use]
    pub fn quantity(self) -> &'static str {
        match self {
            Self::Ladder => "rung",
            Self::Steps => "steps",
            Self::SunSteps => "sun steps",
            Self::SunVolume => "cone and volume",
            Self::Octaves => "octaves",
            Self::Window => "frames",
            Self::Resolution => "divisor",
            Self::MipBias => "mip bias",
            Self::Offset => "m sideways",
            Self::Budget => "samples",
            Self::TexelFormat => "format",
            Self::Codec => "JPEG quality",
            Self::Front => "point",
        }
    }

    /// Whether it needs the cache, which serves eyes below the clouds only.
    #[must_use]
    pub fn needs_cache(self) -> bool {
        matches!(
            self,
            Self::MipBias | Self::Offset | Self::Budget | Self::TexelFormat
        )
    }
}

/// The rungs of the ladder (P. Ford, "Real-Time Rendering of Atmospheric Clouds", 2024, 5.4), from the plain march down.
pub const RUNGS: [&str; 7] = [
    "plain",
    "early exit",
    "low-density skip",
    "temporal window",
    "adaptive step",
    "half resolution",
    "quarter resolution",
];

/// Frames of the ladder's temporal window: one for each picture pixel of a marched one at a quarter of the resolution.
pub const LADDER_WINDOW_FRAMES: u32 = 16;
/// Parts into which the ladder's window shares out the steps. Each of its frames takes one.
/// Tuned with the refinement: the least FLIP of the whole ladder at 900 times less work (`measure trade --only ladder`).
pub const LADDER_DEPTH_SEGMENTS: u32 = 3;
/// Parts into which a step of the ladder's window is cut where cloud begins.
pub const LADDER_REFINEMENT: u32 = 2;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Extent {
    /// A few points of each axis.
    Quick,
    /// Enough points for curves.
    Default,
    /// Fine curves, and the front until nothing changes.
    Full,
}

impl Extent {
    fn pick<T>(self, quick: T, default: T, full: T) -> T {
        match self {
            Self::Quick => quick,
            Self::Default => default,
            Self::Full => full,
        }
    }

    /// Steps of whatever does not sweep them.
    #[must_use]
    pub fn base_steps(self) -> u32 {
        self.pick(64, 128, 128)
    }

    /// Samples of whatever does not sweep them.
    #[must_use]
    pub fn base_samples(self) -> u32 {
        self.pick(2, 8, 8)
    }

    /// How fine a reference is that a GPU renders: what else is swept must be coarser.
    #[must_use]
    pub fn reference_fineness(self) -> ReferenceFineness {
        let of = |steps, sun_steps, samples, early_exit| ReferenceFineness {
            steps,
            sun_steps,
            samples,
            early_exit,
        };
        self.pick(
            of(128, 16, 16, true),
            of(512, 32, 16, true),
            of(1024, 64, 32, false),
        )
    }

    /// How often the front's neighbours are measured, and how many at most each time.
    #[must_use]
    pub fn front_rounds(self) -> (u32, usize) {
        self.pick((1, 2), (3, 12), (8, 32))
    }
}

/// How fine a reference is that a GPU renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReferenceFineness {
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Steps towards the sun.
    pub sun_steps: u32,
    /// Samples of a pixel.
    pub samples: u32,
    /// Rays end where nothing behind can be seen.
    pub early_exit: bool,
}

/// A point with its place on an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedPoint {
    /// Which axis.
    pub axis: Axis,
    /// What it is called there.
    pub label: String,
    /// Where it stands there.
    pub position: f64,
    /// What is measured.
    pub settings: PointSettings,
}

impl PlannedPoint {
    fn new(
        axis: Axis,
        label: impl ToString,
        position: impl Into<f64>,
        settings: PointSettings,
    ) -> Self {
        Self {
            axis,
            label: label.to_string(),
            position: position.into(),
            settings,
        }
    }
}

/// The points of the axes, in their order; those of the front are only its first, see [`neighbours`].
#[must_use]
pub fn plan(extent: Extent, axes: &[Axis], scene_octaves: u32) -> Vec<PlannedPoint> {
    axes.iter()
        .flat_map(|axis| points_of(*axis, extent, scene_octaves))
        .collect()
}

fn points_of(axis: Axis, extent: Extent, scene_octaves: u32) -> Vec<PlannedPoint> {
    let (steps, samples) = (extent.base_steps(), extent.base_samples());
    let screen = PointSettings::screen_space(steps, samples);
    let cached = PointSettings::cached(steps, samples, 0.0);
    let counts = |values: &[u32], settings: &dyn Fn(u32) -> PointSettings| -> Vec<PlannedPoint> {
        values
            .iter()
            .map(|n| PlannedPoint::new(axis, n, *n, settings(*n)))
            .collect()
    };
    match axis {
        Axis::Ladder => ladder(steps),
        Axis::Steps => counts(
            extent.pick(
                &[16, 64],
                &[8, 16, 32, 64, 128, 256, 512],
                &[4, 8, 16, 32, 64, 96, 128, 192, 256, 512, 1024],
            ),
            &|steps| PointSettings { steps, ..screen },
        ),
        Axis::SunSteps => counts(
            extent.pick(
                &[2, 6, 32],
                &[1, 2, 4, 6, 8, 16, 32, 64],
                &[1, 2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 64],
            ),
            &|n| PointSettings {
                sun_steps: Some(n),
                ..screen
            },
        ),
        Axis::SunVolume => sun_volumes(extent, screen),
        Axis::Octaves => {
            let mut octaves =
                extent.pick(vec![1], vec![1, 2, 3, 4, 6, 8, 12, 16], (1..=16).collect());
            octaves.push(scene_octaves);
            octaves.sort_unstable();
            octaves.dedup();
            counts(&octaves, &|n| PointSettings {
                octaves: Some(n),
                ..screen
            })
        }
        Axis::Window => counts(
            extent.pick(&[1, 4], &[1, 2, 4, 8, 16], &[1, 2, 4, 8, 16]),
            &|n| PointSettings {
                samples: n,
                window_frames: n,
                depth_segments: n,
                refinement: n.min(4),
                ..screen
            },
        ),
        Axis::Resolution => counts(&[1, 2, 4], &|n| PointSettings {
            resolution_divisor: n,
            ..screen
        }),
        Axis::MipBias => {
            let biases: &[f32] = extent.pick(
                &[0.0, 2.0],
                &[0.0, 0.5, 1.0, 1.5, 2.0, 3.0],
                &[0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0],
            );
            let biases = biases.iter();
            biases
                .map(|bias| {
                    PlannedPoint::new(
                        axis,
                        bias,
                        *bias,
                        PointSettings {
                            mip_bias: *bias,
                            ..cached
                        },
                    )
                })
                .collect()
        }
        Axis::Offset => {
            let offsets_m: &[f64] = extent.pick(
                &[0.0, 300.0],
                &[0.0, 100.0, 300.0, 1000.0],
                &[0.0, 30.0, 100.0, 200.0, 300.0, 600.0, 1000.0, 3000.0],
            );
            let offsets_m = offsets_m.iter();
            offsets_m
                .map(|m| {
                    PlannedPoint::new(
                        axis,
                        m,
                        *m,
                        PointSettings {
                            reference_sideways_m: *m,
                            ..cached
                        },
                    )
                })
                .collect()
        }
        Axis::Budget => counts(
            extent.pick(&[1, 4], &[1, 2, 4, 8], &[1, 2, 4, 8, 16]),
            &|samples| PointSettings { samples, ..cached },
        ),
        Axis::TexelFormat => vec![PlannedPoint::new(axis, "rgba16float", 0, cached)],
        Axis::Codec => {
            let qualities: &[u8] = extent.pick(
                &[30, 85],
                &[30, 40, 50, 60, 70, 80, 85, 90, 95],
                &[30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85, 90, 95],
            );
            let with = |codec| PointSettings {
                codec: Some(codec),
                ..screen
            };
            let jpegs = qualities.iter().map(|q| {
                PlannedPoint::new(axis, format!("JPEG {q}"), *q, with(PictureCodec::Jpeg(*q)))
            });
            let png = PlannedPoint::new(axis, "PNG", 100, with(PictureCodec::Png));
            jpegs.chain([png]).collect()
        }
        Axis::Front => front_seeds(extent),
    }
}

/// Cones, then volumes from coarse to fine.
fn sun_volumes(extent: Extent, screen: PointSettings) -> Vec<PlannedPoint> {
    let cones: &[u32] = extent.pick(&[6], &[4, 6, 8, 12, 16], &[2, 3, 4, 6, 8, 12, 16, 24, 32]);
    let cones = cones.iter().map(|steps| {
        let settings = PointSettings {
            sun_steps: Some(*steps),
            sun_depth: Some(SunDepth::Cone),
            ..screen
        };
        (format!("cone {steps}"), settings)
    });
    let spacings_m: &[f64] = extent.pick(&[100.0], &[100.0, 50.0], &[200.0, 100.0, 50.0, 25.0]);
    let near_steps: &[u32] = extent.pick(&[2], &[0, 1, 2, 3], &[0, 1, 2, 3, 4, 6]);
    let volumes = spacings_m.iter().flat_map(|spacing_m| {
        near_steps.iter().map(move |near| {
            let scale = 50.0 / spacing_m;
            let size = SunVolumeSize {
                columns: (256.0 * scale) as u32,
                slices: (64.0 * scale) as u32,
                spacing_m: *spacing_m,
                near_steps: Some(*near),
                ..SunVolumeSize::default()
            };
            let settings = PointSettings {
                sun_depth: Some(SunDepth::Volume),
                sun_volume: size.bounded(),
                ..screen
            };
            (format!("volume {spacing_m} m, {near} near"), settings)
        })
    });
    cones
        .chain(volumes)
        .zip(0u32..)
        .map(|((label, settings), place)| {
            PlannedPoint::new(Axis::SunVolume, label, place, settings)
        })
        .collect()
}

/// The rungs, each with all that those before it have.
fn ladder(steps: u32) -> Vec<PlannedPoint> {
    let mut settings = PointSettings {
        early_exit: false,
        low_density_skip: false,
        adaptive_step: false,
        // As in the thesis: what the volume saves is the sun volume's axis.
        sun_depth: Some(SunDepth::Cone),
        ..PointSettings::screen_space(steps, 1)
    };
    (0u32..)
        .zip(RUNGS)
        .map(|(rung, name)| {
            match name {
                "early exit" => settings.early_exit = true,
                "low-density skip" => settings.low_density_skip = true,
                "temporal window" => {
                    settings.window_frames = LADDER_WINDOW_FRAMES;
                    settings.samples = LADDER_WINDOW_FRAMES;
                    settings.depth_segments = LADDER_DEPTH_SEGMENTS;
                    settings.refinement = LADDER_REFINEMENT;
                }
                "adaptive step" => settings.adaptive_step = true,
                "half resolution" => settings.resolution_divisor = 2,
                "quarter resolution" => settings.resolution_divisor = 4,
                _ => {}
            }
            PlannedPoint::new(Axis::Ladder, name, rung, settings)
        })
        .collect()
}

/// Where the search along the front starts: from draft to more than anybody needs.
fn front_seeds(extent: Extent) -> Vec<PlannedPoint> {
    use FrameFilter::{Bilinear, CatmullRom};
    let seed = |steps, samples, mip_bias, sun_steps, filter| PointSettings {
        sun_steps: Some(sun_steps),
        filter,
        ..PointSettings::cached(steps, samples, mip_bias)
    };
    let by_area = |settings| PointSettings {
        samples_by_area: true,
        ..settings
    };
    let seeds = [
        // As good and as cheap as with all samples by most lenses, and cheaper by long ones: of equals the first is taken.
        by_area(seed(32, 4, 2.0, 4, Bilinear)),
        seed(64, 8, 1.0, 6, Bilinear),
        seed(32, 4, 2.0, 4, Bilinear),
        seed(64, 8, 1.0, 8, CatmullRom),
        seed(64, 8, 0.0, 12, CatmullRom),
        seed(128, 8, 0.0, 8, CatmullRom),
        seed(128, 8, 0.0, 16, CatmullRom),
        seed(512, 8, 0.0, 32, CatmullRom),
        by_area(seed(64, 8, 1.0, 6, Bilinear)),
        by_area(seed(64, 8, 0.0, 6, Bilinear)),
        by_area(seed(64, 8, 0.0, 12, CatmullRom)),
        by_area(seed(128, 8, 0.0, 16, CatmullRom)),
    ];
    let all = seeds.len();
    seeds
        .into_iter()
        .take(extent.pick(2, all, all))
        .map(|settings| front_point(&settings))
        .collect()
}

/// A point of the front with its name.
#[must_use]
pub fn front_point(settings: &PointSettings) -> PlannedPoint {
    let from_scene = |value: Option<u32>| value.map_or("scene's".to_owned(), |n| n.to_string());
    let marched = match settings.renderer {
        RendererKind::Cached => format!(
            "bias {}{} {}",
            settings.mip_bias,
            if settings.samples_by_area {
                " by area"
            } else {
                ""
            },
            filter_name(settings.filter)
        ),
        RendererKind::ScreenSpace => format!("1/{} sides", settings.resolution_divisor),
    };
    let label = format!(
        "{} steps × {}, {}{} sun, {} octaves, {marched}",
        settings.steps,
        settings.samples,
        if settings.sun_depth == Some(SunDepth::Volume) {
            "volume "
        } else {
            ""
        },
        from_scene(settings.sun_steps),
        from_scene(settings.octaves),
    );
    PlannedPoint::new(Axis::Front, label, 0, *settings)
}

/// Name of a filter in labels.
#[must_use]
pub fn filter_name(filter: FrameFilter) -> &'static str {
    match filter {
        FrameFilter::CatmullRom => "Catmull-Rom",
        FrameFilter::Bilinear => "bilinear",
    }
}

const STEPS: [u32; 9] = [8, 16, 32, 48, 64, 96, 128, 256, 512];
const SUN_STEPS: [u32; 8] = [1, 2, 3, 4, 6, 8, 12, 16];
const SAMPLES: [u32; 5] = [1, 2, 4, 8, 16];
const MIP_BIASES: [f32; 7] = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0];

/// The values beside `value` in a sorted list.
fn beside<T: PartialOrd + Copy>(list: &[T], value: T) -> impl Iterator<Item = T> {
    let below = list.iter().rev().find(|v| **v < value).copied();
    let above = list.iter().find(|v| **v > value).copied();
    [below, above].into_iter().flatten()
}

/// Points that differ from one by one notch of one setting, for the search along the front. Only settings of a server are
/// walked: points of the other renderer, or with a displaced reference, have none.
#[must_use]
pub fn neighbours(point: &PointSettings, scene_sun_steps: u32) -> Vec<PointSettings> {
    if !point.is_quality() {
        return Vec::new();
    }
    let mut near = Vec::new();
    near.extend(beside(&STEPS, point.steps).map(|steps| PointSettings { steps, ..*point }));
    near.extend(beside(&SAMPLES, point.samples).map(|samples| PointSettings { samples, ..*point }));
    near.extend(
        beside(&MIP_BIASES, point.mip_bias).map(|mip_bias| PointSettings { mip_bias, ..*point }),
    );
    let sun_steps = point.sun_steps.unwrap_or(scene_sun_steps);
    near.extend(beside(&SUN_STEPS, sun_steps).map(|n| PointSettings {
        sun_steps: Some(n),
        ..*point
    }));
    near.extend(
        [SunDepth::Cone, SunDepth::Volume]
            .into_iter()
            .filter(|depth| point.sun_depth.unwrap_or_default() != *depth)
            .map(|depth| PointSettings {
                sun_depth: Some(depth),
                ..*point
            }),
    );
    let filter = match point.filter {
        FrameFilter::CatmullRom => FrameFilter::Bilinear,
        FrameFilter::Bilinear => FrameFilter::CatmullRom,
    };
    near.push(PointSettings { filter, ..*point });
    near.push(PointSettings {
        samples_by_area: !point.samples_by_area,
        ..*point
    });
    near
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_and_every_rung_is_planned_in_every_extent() {
        for extent in [Extent::Quick, Extent::Default, Extent::Full] {
            let points = plan(extent, &Axis::ALL, 8);
            for axis in Axis::ALL {
                assert!(
                    points.iter().any(|p| p.axis == axis),
                    "{extent:?} has no {axis:?}"
                );
            }
            let rungs: Vec<&str> = points
                .iter()
                .filter(|p| p.axis == Axis::Ladder)
                .map(|p| p.label.as_str())
                .collect();
            assert_eq!(rungs, RUNGS);
        }
    }

    #[test]
    fn each_rung_keeps_what_the_rungs_before_it_have() {
        let rungs = ladder(128);
        for pair in rungs.windows(2) {
            let (above, below) = (pair[0].settings, pair[1].settings);
            assert!(
                below.early_exit >= above.early_exit
                    && below.low_density_skip >= above.low_density_skip
            );
            assert!(
                below.window_frames >= above.window_frames
                    && below.adaptive_step >= above.adaptive_step
            );
            assert!(
                below.resolution_divisor >= above.resolution_divisor
                    && below.depth_segments >= above.depth_segments
                    && below.refinement >= above.refinement
            );
            assert_ne!(above, below);
        }
        let plain = rungs[0].settings;
        assert!(
            !plain.early_exit
                && !plain.low_density_skip
                && !plain.adaptive_step
                && plain.samples == 1
        );
    }

    #[test]
    fn a_window_shares_out_the_steps_of_one_picture() {
        for point in points_of(Axis::Window, Extent::Default, 8) {
            assert_eq!(point.settings.steps, 128, "{}", point.label);
            assert_eq!(
                point.settings.depth_segments, point.settings.window_frames,
                "{}",
                point.label
            );
            assert_eq!(point.settings.samples, point.settings.window_frames);
        }
    }

    #[test]
    fn neighbours_differ_by_one_setting() {
        let point = PointSettings::cached(64, 8, 1.0);
        let near = neighbours(&point, 6);
        assert_eq!(near.len(), 11);
        for other in near {
            let changed = u32::from(other.steps != point.steps)
                + u32::from(other.samples != point.samples)
                + u32::from(other.samples_by_area != point.samples_by_area)
                + u32::from(other.mip_bias != point.mip_bias)
                + u32::from(other.sun_steps != point.sun_steps)
                + u32::from(other.sun_depth != point.sun_depth)
                + u32::from(other.filter != point.filter);
            assert_eq!(changed, 1, "{other:?}");
        }
    }

    #[test]
    fn only_what_needs_the_cache_says_so() {
        for point in plan(Extent::Default, &Axis::ALL, 8) {
            let cached = point.settings.renderer == RendererKind::Cached;
            assert_eq!(
                cached,
                point.axis.needs_cache() || point.axis == Axis::Front,
                "{point:?}"
            );
        }
    }
}

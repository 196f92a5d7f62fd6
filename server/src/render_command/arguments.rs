//! What `skycell-server render` can be told.

use crate::march::{BandEnds, MarchSettings, ProxySetup};
use crate::sun_volume::SunVolumeSize;
use skycell_protocol::{Show, SunDepth};
use skycell_reference::Approximations;
use std::path::PathBuf;

/// What to render, how, and where to.
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArguments {
    /// Scene document; the default scene without it. Files of voxels that it names lie beside it.
    #[arg(long)]
    pub scene: Option<PathBuf>,
    /// A sky that comes with the program, and its camera where no other is given.
    #[arg(long, value_name = "NAME", conflicts_with = "scene")]
    pub preset: Option<String>,
    /// Which renderer.
    #[arg(long, value_enum, default_value_t = StillKind::Cached)]
    pub renderer: StillKind,
    /// Where to write: .png (as it is shown), .exr (linear radiance) or, with --rays, .json.
    #[arg(long)]
    pub out: PathBuf,
    /// Width, pixels.
    #[arg(long, default_value_t = 1280)]
    pub width: u32,
    /// Height, pixels.
    #[arg(long, default_value_t = 720)]
    pub height: u32,
    /// Eye: x (east), altitude, z (south), metres [default: 0,2,0].
    #[arg(
        long,
        value_delimiter = ',',
        num_args = 1,
        value_name = "X,Y,Z",
        allow_negative_numbers = true
    )]
    pub position_m: Option<Vec<f64>>,
    /// Where the middle of the picture looks, clockwise from north [default: 0].
    #[arg(long, allow_negative_numbers = true)]
    pub yaw_deg: Option<f64>,
    /// And above the horizon [default: 15].
    #[arg(long, allow_negative_numbers = true)]
    pub pitch_deg: Option<f64>,
    /// Vertical field of view [default: 60].
    #[arg(long)]
    pub fov_deg: Option<f64>,
    /// Two eyes so far apart, metres, side by side in one picture; width and height are those of one eye. For the device's
    /// renderers.
    #[arg(long, value_name = "M", allow_negative_numbers = true, conflicts_with_all = ["rays", "orthographic_height_m"])]
    pub stereo: Option<f64>,
    /// Parallel rays from a rectangle of this height about the eye, metres, instead of a field of view.
    #[arg(long, value_name = "M", conflicts_with = "rays")]
    pub orthographic_height_m: Option<f64>,
    /// Rays instead of a camera: {"rays": [{"origin_m": [x, altitude, z], "direction": [x, y, z]}, …]}. Directions are in the
    /// axes of the place under the first ray's origin: east, up, south.
    #[arg(long, value_name = "FILE")]
    pub rays: Option<PathBuf>,
    /// Reference point of the cached renderer, when it is not the eye.
    #[arg(
        long,
        value_delimiter = ',',
        num_args = 1,
        value_name = "X,Y,Z",
        allow_negative_numbers = true
    )]
    pub reference_m: Option<Vec<f64>>,
    /// Samples: per texel or pixel, 1 to 16 (without: 8); paths per pixel of the path tracer, up to 1e9 (without: 64).
    #[arg(long)]
    pub samples: Option<u64>,
    /// The path tracer goes on until the largest standard error of a pixel is this share of its radiance (or of a hundredth
    /// of the brightest pixel's), in rounds that double the paths, to 1e6 a pixel at most.
    #[arg(long, value_name = "SHARE", conflicts_with = "samples")]
    pub until_error: Option<f64>,
    /// Another number, other paths. The same number gives the same bits, however many threads there are.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Orders of scattering that the path tracer counts: all, or up to a number; there is no other limit. The marching
    /// renderers know 1 (single scattering) and all (the scene's octaves).
    #[arg(long, default_value = "all", value_name = "all|N")]
    pub orders: String,
    /// The sun of the path tracer.
    #[arg(long, value_enum, default_value_t = SunChoice::Disc)]
    pub sun: SunChoice,
    /// Steps through a layer's thickness, 1 to 4096 (without: 128). With it the reference takes the same samples as the
    /// device; without it its steps are halved until nothing changes.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: Option<u32>,
    /// Samples towards the sun, 1 to 64; without: the scene's.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub sun_steps: Option<u32>,
    /// How optical depth towards the sun comes about on the device; without: the scene's choice.
    #[arg(long, value_enum)]
    pub sun_depth: Option<SunDepthChoice>,
    /// Size of the sun volume as JSON: columns, slices, levels, spacing_m, near_steps, near_columns.
    #[arg(long, value_name = "JSON", value_parser = parsed_sun_volume)]
    pub sun_volume: Option<SunVolumeSize>,
    /// Relative change that counts as none when the reference halves its steps.
    #[arg(long, default_value_t = 1e-4)]
    pub tolerance: f64,
    /// Approximations that take part; what is not named is off. Without: all for .png, none for numbers (.exr, --rays).
    #[arg(long, value_enum, value_delimiter = ',', num_args = 1..)]
    pub approximations: Option<Vec<Approximation>>,
    /// How the device interpolates maps, noise and voxels. Without: sampler for .png, exact for numbers.
    #[arg(long, value_enum)]
    pub interpolation: Option<Interpolation>,
    /// Halvings of the cache's resolution below the screen's.
    #[arg(long, default_value_t = 0.0)]
    pub mip_bias: f32,
    /// What layers are kept on by the cached renderer.
    #[arg(long, value_enum, default_value_t = ProxySetup::InLayer)]
    pub proxies: ProxySetup,
    /// Slabs of altitude of each layer, 1 to 4 (in-layer proxies).
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=4))]
    pub slabs: u32,
    /// Bands of distance of each layer, 2 to 4 (nested domes).
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(2..=4))]
    pub bands: u32,
    /// Where bands end (nested domes).
    #[arg(long, value_enum, default_value_t = BandEnds::Cut)]
    pub band_ends: BandEnds,
    /// Most places at which a viewer away from the reference looks for what texels show, 0 to 64; 0: proxies alone.
    #[arg(long, default_value_t = crate::quality::default_parallax_steps(), value_parser = clap::value_parser!(u32).range(0..=64))]
    pub parallax_steps: u32,
    /// The screen-space renderer marches this many times fewer columns and rows: 1, 2 or 4.
    #[arg(long, default_value_t = 1)]
    pub resolution_divisor: u32,
    /// What the picture shows: picture, single, multiple, ambient, phase-off, transmittance, distance, cache-mip, steps,
    /// coverage, type, profile, density, and of the last four coverage-above … density-above, profile-section and
    /// density-section. For the device's renderers and .png.
    #[arg(long, value_name = "NAME", default_value = "picture", value_parser = show_of)]
    pub show: Show,
    /// The screen-space renderer spreads the picture over a sliding window of so many frames, 1 to 16.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=16))]
    pub window: Option<u32>,
    /// Frames that have been marched when the picture is taken, 1 to 100000; without: as many as the window has.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub frames: Option<u32>,
    /// Parts into which a window shares out the steps, 1 to 16: each frame takes one.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub depth_segments: u32,
    /// Parts into which a window cuts a step where cloud begins, 1 to 16.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub refinement: u32,
    /// Degrees by which the camera turns to the right from frame to frame of a window, to end where it is to look.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub turn_deg_per_frame: f64,
    /// Sky time: seconds for which the wind has blown and the sun has moved.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub time_s: f64,
    /// The sky of a moment, such as 2026-06-21T18:30:00Z, as every server with this scene shows it then.
    #[arg(long, value_name = "DATE", conflicts_with = "time_s")]
    pub at: Option<String>,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print figures as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A view by its name.
fn show_of(name: &str) -> Result<Show, String> {
    Show::from_name(name).map_err(|error| error.to_string())
}

/// Renderers of single pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum StillKind {
    /// One ray per pixel, on the device.
    ScreenSpace,
    /// One ray per texel of the proxy spheres, composited, on the device.
    Cached,
    /// The same model in f64 on the processor, marched until it no longer changes.
    Reference,
    /// Unbiased transport through the same density in f64 on the processor.
    PathTraced,
}

/// The sun as the path tracer looks for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SunChoice {
    /// 0.2666° in radius.
    Disc,
    /// One direction.
    Point,
}

/// How optical depth towards the sun comes about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SunDepthChoice {
    /// A march towards the sun from every step.
    Cone,
    /// One volume for all steps.
    Volume,
}

impl From<SunDepthChoice> for SunDepth {
    fn from(choice: SunDepthChoice) -> Self {
        match choice {
            SunDepthChoice::Cone => Self::Cone,
            SunDepthChoice::Volume => Self::Volume,
        }
    }
}

fn parsed_sun_volume(text: &str) -> Result<SunVolumeSize, String> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// What makes a picture cheaper or nicer and numbers harder to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Approximation {
    /// Noise that frays the edges of clouds, and fades with distance.
    DetailNoise,
    /// Light of sky and ground in clouds.
    Ambient,
    /// Air in front of clouds.
    AerialPerspective,
    /// Samples beside the middles of pixels and steps, averaged over several: temporal reuse.
    Jitter,
    /// Rays end where hardly any light comes through.
    EarlyExit,
    /// A pattern of half an 8-bit step against bands (.png alone).
    Dither,
    /// The tone curve (.png alone; without it linear values are cut off at 1).
    ToneMap,
    /// All of these.
    All,
    /// None of these.
    None,
}

/// How values between texels come about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Interpolation {
    /// By the device's sampler, whose weights have 8 bits or so.
    Sampler,
    /// Loaded and mixed in f32.
    Exact,
}

/// The approximations that take part.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen(Vec<Approximation>);

impl Chosen {
    /// What is named, or all or none of them.
    #[must_use]
    pub fn new(named: Option<&[Approximation]>, numbers: bool) -> Self {
        let default = if numbers {
            Approximation::None
        } else {
            Approximation::All
        };
        Self(named.map_or_else(|| vec![default], <[Approximation]>::to_vec))
    }

    /// Whether one takes part.
    #[must_use]
    pub fn has(&self, wanted: Approximation) -> bool {
        self.0.contains(&wanted) || self.0.contains(&Approximation::All)
    }

    /// Those that the reference knows.
    #[must_use]
    pub fn of_reference(&self) -> Approximations {
        Approximations {
            detail_noise: self.has(Approximation::DetailNoise),
            ambient: self.has(Approximation::Ambient),
            aerial_perspective: self.has(Approximation::AerialPerspective),
        }
    }

    /// Settings of the device's march with them.
    #[must_use]
    pub fn of_march(&self, settings: MarchSettings) -> MarchSettings {
        MarchSettings {
            early_exit: self.has(Approximation::EarlyExit),
            jitter: self.has(Approximation::Jitter),
            detail_noise: self.has(Approximation::DetailNoise),
            ambient: self.has(Approximation::Ambient),
            aerial_perspective: self.has(Approximation::AerialPerspective),
            ..settings
        }
    }
}

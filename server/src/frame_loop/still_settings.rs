//! What a single picture or a list of rays is asked for with, and what comes back.

use crate::config::FrameFilter;
use crate::march::{BandEnds, MarchSettings, ProxySettings, ProxySetup, WindowPlan};
use crate::quality::default_parallax_steps;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use skycell_protocol::{Codec, FrameSize, RendererKind, Show, Stereo};

/// How a single picture is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StillSettings {
    /// Whether two by two pixels share what is behind the clouds, as viewers' frames do on a software driver.
    pub shared_background: bool,
    /// Which renderer.
    pub renderer: RendererKind,
    /// How rays are marched.
    pub march: MarchSettings,
    /// Samples of a texel or pixel, 1 to 16.
    pub samples: u32,
    /// Where several texels make a pixel, it is their samples together that are so many.
    pub samples_by_area: bool,
    /// The screen-space renderer spreads the picture over frames; without, it sums samples up.
    pub window: Option<WindowPlan>,
    /// Frames that a window has slid over when the picture is taken; at least one.
    pub frames: u32,
    /// How many of them, the last ones, are from the camera of the picture.
    pub resting_frames: u32,
    /// By how much the camera turns to the right from frame to frame, to end where the picture is taken.
    pub turn_deg_per_frame: f64,
    /// Halvings of the cache's resolution below the screen's, 0 to 4.
    pub mip_bias: f32,
    /// How the cache is read.
    pub filter: FrameFilter,
    /// Most places along a ray at which a viewer away from the reference looks for what texels show; 0: proxy spheres alone.
    pub parallax_steps: u32,
    /// Slabs of altitude that each layer is cut into, each kept on a proxy sphere of its own, 1 to 4.
    pub slabs: u32,
    /// What layers are kept on.
    pub proxies: ProxySetup,
    /// Bands of distance, 2 to 4 (nested domes).
    pub bands: u32,
    /// Where those end.
    pub band_ends: BandEnds,
    /// How far a reference may go before domes follow it, m (following and nested domes).
    pub dome_follow_m: f64,
    /// Single scattering is coloured with the phase of the marched ray instead of the viewer's own, as where texels keep it
    /// coloured (Weinrauch et al. 2023); exact with one slab.
    pub phase_of_reference: bool,
    /// Reference point of the cache, seen from the eye: x, altitude, z.
    pub reference_offset_m: [f64; 3],
    /// What the picture shows.
    pub show: Show,
    /// Two eyes side by side in the place of one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stereo: Option<Stereo>,
    /// How the picture is going to be compressed, which decides how it is dithered.
    #[serde(skip)]
    pub codec: Codec,
}

impl Default for StillSettings {
    fn default() -> Self {
        Self {
            shared_background: false,
            renderer: RendererKind::Cached,
            march: MarchSettings::default(),
            samples: 8,
            samples_by_area: false,
            window: None,
            frames: 1,
            resting_frames: 1,
            turn_deg_per_frame: 0.0,
            mip_bias: 0.0,
            filter: FrameFilter::CatmullRom,
            parallax_steps: default_parallax_steps(),
            slabs: 1,
            proxies: ProxySetup::InLayer,
            bands: ProxySettings::default().bands,
            band_ends: BandEnds::default(),
            dome_follow_m: ProxySettings::default().follow_m,
            phase_of_reference: false,
            reference_offset_m: [0.0; 3],
            show: Show::Picture,
            stereo: None,
            codec: Codec::Png,
        }
    }
}

impl StillSettings {
    /// What layers are kept on, with all that it is told.
    #[must_use]
    pub fn kept_on(&self) -> ProxySettings {
        ProxySettings {
            setup: self.proxies,
            slabs: self.slabs,
            bands: self.bands,
            band_ends: self.band_ends,
            follow_m: self.dome_follow_m,
        }
    }
}

/// A finished picture, as it is shown and as it is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct StillPicture {
    /// Its size.
    pub size: FrameSize,
    /// Tone-mapped sRGB, 4 bytes a pixel.
    pub display: Vec<u8>,
    /// Linear radiance in W/(m² nm sr), red, green, blue and 1 for each pixel.
    pub linear: Vec<f32>,
    /// What it took.
    pub figures: StillFigures,
}

/// What a picture took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StillFigures {
    /// Rays marched: samples of texels or pixels.
    pub marches: u64,
    /// Texture reads of the march, where they were counted.
    pub texture_reads: Option<u64>,
    /// Evaluations of a density in it, where they were counted.
    pub density_evaluations: Option<u64>,
    /// Look-ups of density for columns of the sun volume.
    #[serde(default)]
    pub sun_volume_evaluations: u64,
    /// Time of the device for marching and compositing, where it can tell.
    pub gpu_ns: Option<u64>,
    /// Time that passed.
    pub wall_s: f64,
}

/// A ray in the frame of its list: origin on the ground under the first ray's start, y up there, x east, z south.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillRay {
    /// Where it starts, m.
    pub origin_m: DVec3,
    /// Unit vector.
    pub direction: DVec3,
}

/// Rays that are marched as the pixels of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct RayPicture {
    /// World place (x, altitude, z) whose ground point is the frame's origin; the altitude does not matter.
    pub frame_m: DVec3,
    /// Width times height rays, row by row.
    pub rays: Vec<StillRay>,
    /// Size of the picture that they are.
    pub size: FrameSize,
    /// What samples move a ray's start by across a pixel and down a pixel, m.
    pub pixel_m: [DVec3; 2],
}

/// What the device found along a ray in one layer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LayerFigures {
    /// Single scattering without its phase.
    pub single: f32,
    /// Octaves from the second on, 1/sr.
    pub octaves: f32,
    /// Ambient light as a share of the sky's mean radiance.
    pub ambient: f32,
    /// Transmittance.
    pub transmittance: f32,
    /// Distance of what is seen times its opacity, m.
    pub opacity_distance_m: f32,
    /// Steps that were lit or only looked at.
    pub steps: f32,
    /// Optical depth.
    pub optical_depth: f32,
}

/// What the device found along listed rays.
#[derive(Clone, Debug, PartialEq)]
pub struct RayFigures {
    /// Radiance of each ray in W/(m² nm sr).
    pub radiance: Vec<[f32; 3]>,
    /// Layers that are shown, lowest first, and in each what was found along each ray.
    pub layers: Vec<Vec<LayerFigures>>,
    /// The picture, where one was asked for.
    pub picture: StillPicture,
}

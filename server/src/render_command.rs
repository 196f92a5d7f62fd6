//! `skycell-server render`: one picture from a scene file and a camera, without a server.

use crate::config::{PlacedCell, RenderConfig};
use crate::frame_loop::{StillPicture, StillRenderer, StillSettings};
use crate::march::MarchSettings;
use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// What to render.
#[derive(Clone, Debug, clap::Args)]
pub struct RenderArguments {
    /// Scene document; the default scene without it.
    #[arg(long)]
    pub scene: Option<PathBuf>,
    /// Which renderer.
    #[arg(long, value_enum, default_value_t = StillKind::Cached)]
    pub renderer: StillKind,
    /// Where to write: .png (tone-mapped) or .exr (linear radiance).
    #[arg(long)]
    pub out: PathBuf,
    /// Width, pixels.
    #[arg(long, default_value_t = 1280)]
    pub width: u32,
    /// Height, pixels.
    #[arg(long, default_value_t = 720)]
    pub height: u32,
    /// Eye: x (east), altitude, z (south), metres.
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "X,Y,Z", default_values_t = [0.0, 2.0, 0.0], allow_negative_numbers = true)]
    pub position_m: Vec<f64>,
    /// Where the middle of the picture looks, clockwise from north.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub yaw_deg: f64,
    /// And above the horizon.
    #[arg(long, default_value_t = 15.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Vertical field of view.
    #[arg(long, default_value_t = 60.0)]
    pub fov_deg: f64,
    /// Reference point of the cached renderer, when it is not the eye.
    #[arg(
        long,
        value_delimiter = ',',
        num_args = 1,
        value_name = "X,Y,Z",
        allow_negative_numbers = true
    )]
    pub reference_m: Option<Vec<f64>>,
    /// Samples per texel or pixel, 1 to 16.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: u32,
    /// Steps through a layer's thickness, 1 to 4096.
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: u32,
    /// Halvings of the cache's resolution below the screen's.
    #[arg(long, default_value_t = 0.0)]
    pub mip_bias: f32,
    /// Seconds for which the wind has blown.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub time_s: f64,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print figures as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Renderers of single pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum StillKind {
    /// One ray per pixel.
    ScreenSpace,
    /// One ray per texel of the proxy spheres, composited.
    Cached,
}

/// Folder for noise when none is named: the user's cache folder.
#[must_use]
pub fn default_noise_cache_dir() -> Option<PathBuf> {
    directories::ProjectDirs::from("", "", "skycell").map(|dirs| dirs.cache_dir().to_owned())
}

fn read_scene(path: Option<&Path>) -> anyhow::Result<Scene> {
    let Some(path) = path else {
        return Ok(Scene::default());
    };
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("the scene file {} cannot be read", path.display()))?;
    let value = serde_json::from_str(&text)
        .with_context(|| format!("the scene file {} is no JSON", path.display()))?;
    Scene::from_json(&value).with_context(|| format!("the scene file {}", path.display()))
}

fn triple(values: &[f64]) -> anyhow::Result<[f64; 3]> {
    <[f64; 3]>::try_from(values).map_err(|_| anyhow::anyhow!("a position has three numbers"))
}

/// Renders the picture and writes it.
///
/// # Errors
/// For an unreadable scene, an impossible camera or size, a missing device, an unwritable file.
pub fn run(arguments: &RenderArguments) -> anyhow::Result<()> {
    let extension = arguments
        .out
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_lowercase();
    let linear = match extension.as_str() {
        "exr" => true,
        "png" => false,
        other => bail!("--out ends in {other:?}; allowed are .png and .exr"),
    };
    if !(0.0..=4.0).contains(&arguments.mip_bias) {
        bail!("--mip-bias is {}; allowed is 0 to 4", arguments.mip_bias);
    }
    let scene = read_scene(arguments.scene.as_deref())?;
    let camera = Camera::new(
        triple(&arguments.position_m)?,
        arguments.yaw_deg,
        arguments.pitch_deg,
        arguments.fov_deg,
    )?;
    let size = FrameSize::new(arguments.width, arguments.height)?;
    let placed: Vec<PlacedCell> = match &arguments.reference_m {
        Some(reference) => vec![PlacedCell {
            name: "reference".into(),
            center_m: triple(reference)?,
            radius_m: 1.0e6,
        }],
        None => Vec::new(),
    };
    let config = RenderConfig {
        cache_memory_mib: 2048,
        ..RenderConfig::new(
            arguments
                .noise_cache_dir
                .clone()
                .or_else(default_noise_cache_dir)
                .unwrap_or_else(|| PathBuf::from("skycell-cache")),
        )
    };
    let kind = match arguments.renderer {
        StillKind::ScreenSpace => RendererKind::ScreenSpace,
        StillKind::Cached => RendererKind::Cached,
    };
    let mut still = StillRenderer::new(config, Arc::new(scene), &placed)?;
    still.advance_time(arguments.time_s);
    let bar = ProgressBar::new(1000);
    bar.set_style(ProgressStyle::with_template(
        "marching [{bar:30}] {percent} % {eta}",
    )?);
    let start = Instant::now();
    let settings = StillSettings {
        renderer: kind,
        march: MarchSettings {
            steps: arguments.steps,
            ..MarchSettings::default()
        },
        samples: arguments.samples,
        mip_bias: arguments.mip_bias,
        ..StillSettings::default()
    };
    let picture = still.render_with(camera, size, &settings, |share| {
        bar.set_position((share * 1000.0) as u64);
    })?;
    let wall_s = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    write_picture(&arguments.out, picture, linear)?;
    let totals = still.totals();
    let [cache_ns, composite_ns, screen_space_ns] = still.gpu_times_ns();
    if arguments.json {
        let figures = serde_json::json!({
            "out": arguments.out, "adapter": still.adapter(), "wall_s": wall_s,
            "texels_updated": totals.texels_updated, "tiles_updated": totals.tiles_updated,
            "screen_space_marches": totals.screen_space_marches, "cache_bytes": totals.cache_bytes,
            "gpu_cache_ns": cache_ns, "gpu_composite_ns": composite_ns, "gpu_screen_space_ns": screen_space_ns,
        });
        println!("{figures}");
    } else {
        println!(
            "{} in {wall_s:.1} s on {}: {} rays, GPU time {:.0} ms march, {:.1} ms composite",
            arguments.out.display(),
            still.adapter(),
            totals.texels_updated + totals.screen_space_marches,
            (cache_ns + screen_space_ns) as f64 / 1e6,
            composite_ns as f64 / 1e6,
        );
    }
    Ok(())
}

fn write_picture(path: &Path, picture: StillPicture, linear: bool) -> anyhow::Result<()> {
    let (width, height) = (picture.size.width(), picture.size.height());
    let wrong = "the device gave a picture of another size";
    let written = if linear {
        image::Rgba32FImage::from_raw(width, height, picture.linear)
            .context(wrong)
            .map(|picture| {
                image::DynamicImage::ImageRgba32F(picture)
                    .to_rgb32f()
                    .save(path)
            })?
    } else {
        image::RgbaImage::from_raw(width, height, picture.display)
            .context(wrong)
            .map(|picture| {
                image::DynamicImage::ImageRgba8(picture)
                    .to_rgb8()
                    .save(path)
            })?
    };
    written.with_context(|| format!("{} cannot be written", path.display()))
}

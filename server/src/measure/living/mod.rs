//! `skycell-server measure living`: viewers who look around under wind, from caches that are kept alive.
//!
//! `crowd` says where they look; this counts texels and compares pictures.

mod crowd;

use super::arguments::parsed_size;
use super::metrics::{ShownErrors, shown_errors};
use super::progress::{Progress, spoken};
use super::reference::without_alpha;
use super::store::write_json;
use crate::config::{AGE_FACTOR, FrameFilter, RenderConfig};
use crate::frame_loop::{LivingViewers, StillRenderer, StillSettings};
use crate::march::MarchSettings;
use crate::quality::default_parallax_steps;
use crate::render_command::{Folders, read_scene};
use anyhow::{Context, ensure};
use crowd::LookingCrowd;
use image::RgbImage;
use serde::Serialize;
use serde_json::{Value, json};
use skycell_protocol::{FrameSize, RendererKind, Scene};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// GPU memory for the cache.
const CACHE_MEMORY_MIB: u32 = 3072;
/// Texels that are audited in a simulated second, as many as a server audits while frames wait.
const AUDITED_PER_S: usize = 64;

/// What `measure living` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct LivingArguments {
    /// Folder of the result.
    #[arg(long, default_value = "skycell-living", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Wind of the scene, m/s.
    #[arg(long, default_value_t = 10.0)]
    pub wind_m_per_s: f64,
    /// Who looks around.
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=128))]
    pub viewers: u32,
    /// Radius of the circle in which they stand, m.
    #[arg(long, default_value_t = 5.0)]
    pub spread_m: f64,
    /// Size of the pictures.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size, default_value = "160x90")]
    pub size: FrameSize,
    /// Simulated seconds.
    #[arg(long, default_value_t = 60.0)]
    pub seconds: f64,
    /// Frames a second of each viewer: what is compared with, and how often viewers turn and tiles are marched.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=120))]
    pub fps: u32,
    /// Texels that may be marched for each ray of the screen-space renderer: the budget. None are left unused that are wanted.
    #[arg(long, default_value_t = 0.05)]
    pub texels_per_ray: f64,
    /// Moments at which pictures are compared, each of two viewers.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub moments: u32,
    /// Halvings of the cache's resolution below the screen's.
    #[arg(long, default_value_t = 0.0)]
    pub mip_bias: f32,
    /// Steps through a layer's thickness, of cache and screen alike.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: u32,
    /// Samples of a texel, and of a pixel of the pictures that are compared with.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: u32,
    /// Where several texels make a pixel, it is their samples together that are so many.
    #[arg(long)]
    pub samples_by_area: bool,
    /// How old what is marched may become until it is marched again, times what is usual: `render.age_factor`, 0.1 to 4.
    #[arg(long, default_value_t = 1.0)]
    pub age_factor: f64,
    /// Most places at which a viewer looks for what texels show; 0: on the spheres alone.
    #[arg(long)]
    pub parallax_steps: Option<u32>,
    /// Write compared pictures into the folder.
    #[arg(long)]
    pub pictures: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A picture from living caches against one of the same moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LivingPicture {
    /// When, s.
    pub at_s: f64,
    /// Whose.
    pub viewer: usize,
    /// How far it is from the screen-space renderer's.
    #[serde(flatten)]
    pub errors: ShownErrors,
}

/// All that is reported.
#[derive(Clone, Debug, Serialize)]
pub struct LivingReport {
    /// What rendered.
    pub adapter: String,
    /// The whole scene document.
    pub scene: Value,
    /// Of the pictures.
    pub size: FrameSize,
    /// Who looks around.
    pub viewers: u32,
    /// Simulated seconds.
    pub seconds: f64,
    /// Frames a second.
    pub fps: u32,
    /// Halvings of the cache's resolution.
    pub mip_bias: f32,
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Samples of a texel.
    pub samples: u32,
    /// Where several texels make a pixel, of these together.
    pub samples_by_area: bool,
    /// How old what is marched may become, times what is usual.
    pub age_factor: f64,
    /// Texels marched until nothing was left to do, before time began.
    pub texels_at_start: u64,
    /// Texels marched while it passed.
    pub texels: u64,
    /// Rays of a screen-space renderer with one ray a pixel, frame and viewer.
    pub rays: u64,
    /// Texels for each of those rays.
    pub texels_per_ray: f64,
    /// Mean FLIP of the pictures before time began, when all was marched: the cache's own error.
    pub flip_at_start: f64,
    /// Mean SSIM of those.
    pub ssim_at_start: f64,
    /// Mean FLIP of all later pictures.
    pub flip: f64,
    /// The largest.
    pub flip_most: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// The smallest.
    pub ssim_least: f64,
    /// Mean deviation of audited texels at the end, percent.
    pub audit_mean_percent: f64,
    /// Every picture.
    pub pictures: Vec<LivingPicture>,
    /// How long the run took, s.
    pub wall_s: f64,
}

impl LivingReport {
    fn told(&self) -> String {
        format!(
            "{} viewers, {}x{}, {} s at {} fps, mip bias {}: {} texels for {} rays, 1/{:.1}\n\
             FLIP {:.4} in the mean, {:.4} at most; SSIM {:.4}, {:.4} at least; before time began {:.4} and {:.4}\n\
             audit: {:.2} % in the mean",
            self.viewers,
            self.size.width(),
            self.size.height(),
            self.seconds,
            self.fps,
            self.mip_bias,
            self.texels,
            self.rays,
            1.0 / self.texels_per_ray.max(1e-9),
            self.flip,
            self.flip_most,
            self.ssim,
            self.ssim_least,
            self.flip_at_start,
            self.ssim_at_start,
            self.audit_mean_percent,
        )
    }
}

/// Measures and writes the report.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub(super) fn run(arguments: &LivingArguments) -> anyhow::Result<()> {
    let report = measured(arguments)?;
    write_json(&arguments.out.join("living.json"), &report)?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        println!(
            "{}\n{}, {}",
            report.told(),
            report.adapter,
            spoken(report.wall_s)
        );
    }
    Ok(())
}

impl LivingArguments {
    /// The scene with the wind that is asked for.
    fn windy_scene(&self) -> anyhow::Result<Scene> {
        let scene = read_scene(self.scene.as_deref())?.at_sky_s(0.0);
        let mut document = serde_json::to_value(scene.to_document())?;
        document["wind"]["speed_m_per_s"] = json!(self.wind_m_per_s);
        Scene::from_json(&document).context("the scene's wind (--wind-m-per-s)")
    }

    fn settings(&self, renderer: RendererKind) -> StillSettings {
        StillSettings {
            renderer,
            march: MarchSettings {
                steps: self.steps,
                ..MarchSettings::default()
            },
            samples: self.samples,
            samples_by_area: self.samples_by_area,
            mip_bias: self.mip_bias,
            filter: FrameFilter::CatmullRom,
            parallax_steps: self.parallax_steps.unwrap_or_else(default_parallax_steps),
            ..StillSettings::default()
        }
    }
}

/// Both renderers, in the same moment.
struct Bench<'a> {
    arguments: &'a LivingArguments,
    crowd: LookingCrowd,
    living: StillRenderer,
    exact: StillRenderer,
    exact_s: f64,
}

impl Bench<'_> {
    fn compared(
        &mut self,
        viewers: &LivingViewers,
        viewer: usize,
        at_s: f64,
    ) -> anyhow::Result<LivingPicture> {
        let size = self.arguments.size;
        let picture = |display: &[u8]| {
            RgbImage::from_raw(size.width(), size.height(), without_alpha(display))
                .context("the device gave a picture of another size")
        };
        let shown = picture(&self.living.show_living(viewers, viewer)?)?;
        self.exact.advance_time(at_s - self.exact_s);
        self.exact_s = at_s;
        let camera = self.crowd.camera(viewer, at_s)?;
        let settings = self.arguments.settings(RendererKind::ScreenSpace);
        let exact = self.exact.render_with(camera, size, &settings, |_| {})?;
        let exact = picture(&exact.display)?;
        let errors = shown_errors(&exact, &shown)?;
        if self.arguments.pictures {
            for (name, picture) in [("living", &shown), ("exact", &exact)] {
                let file = format!("{at_s:05.1}-{viewer}-{name}.png");
                picture.save(self.arguments.out.join(file))?;
            }
        }
        ensure!(
            errors.flip.is_finite(),
            "a picture has values that are no numbers"
        );
        Ok(LivingPicture {
            at_s,
            viewer,
            errors,
        })
    }
}

fn measured(arguments: &LivingArguments) -> anyhow::Result<LivingReport> {
    let begun = Instant::now();
    ensure!(
        arguments.seconds > 0.0 && arguments.seconds <= 3_600.0,
        "--seconds is {}; allowed: above 0, up to 3600",
        arguments.seconds
    );
    ensure!(
        arguments.texels_per_ray > 0.0 && arguments.texels_per_ray <= 100.0,
        "--texels-per-ray is {}; allowed: above 0, up to 100",
        arguments.texels_per_ray
    );
    let scene = Arc::new(arguments.windy_scene()?);
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("--out {} cannot be made", arguments.out.display()))?;
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    let config = RenderConfig {
        age_factor: AGE_FACTOR.check("--age-factor", arguments.age_factor)?,
        ..folders.render_config(CACHE_MEMORY_MIB)
    };
    let mut bench = Bench {
        arguments,
        crowd: LookingCrowd::new(arguments.viewers, arguments.spread_m),
        living: StillRenderer::new(config.clone(), scene.clone(), &[])?,
        exact: StillRenderer::new(config, scene.clone(), &[])?,
        exact_s: 0.0,
    };
    let settings = arguments.settings(RendererKind::Cached);
    let cameras = bench.crowd.cameras(0.0)?;
    let viewers = bench
        .living
        .begin_living(&cameras, arguments.size, &settings)?;
    bench.living.settle_living()?;
    let texels_at_start = bench.living.totals().texels_updated;
    let mut progress = Progress::new(
        u64::from(arguments.moments) + 1,
        f64::from(arguments.moments),
    );
    progress.begin("before time", 0.0);
    let count = arguments.viewers as usize;
    let start = [
        bench.compared(&viewers, 0, 0.0)?,
        bench.compared(&viewers, count / 2, 0.0)?,
    ];
    progress.done(&format!("FLIP {:.4}", start[0].errors.flip));
    let fps = f64::from(arguments.fps);
    let rays_per_frame = u64::from(arguments.viewers) * u64::from(arguments.size.pixels());
    let tiles_per_turn =
        arguments.texels_per_ray * rays_per_frame as f64 / crate::cache::TEXELS_PER_TILE as f64;
    let turns = (arguments.seconds * fps).round().max(1.0) as u64;
    let moments = u64::from(arguments.moments).min(turns);
    let mut pictures = Vec::new();
    let mut deviations = Vec::new();
    let mut credit = 0.0;
    for moment in 0..moments {
        progress.begin(&format!("moment {}", moment + 1), 1.0);
        let before = bench.living.totals().texels_updated;
        let until = (moment + 1) * turns / moments;
        let from = moment * turns / moments;
        for turn in from..until {
            let at_s = (turn + 1) as f64 / fps;
            credit += tiles_per_turn;
            let cameras = bench.crowd.cameras(at_s)?;
            let marched =
                bench
                    .living
                    .turn_living(&viewers, &cameras, 1.0 / fps, credit as usize)?;
            // What is not wanted now is not saved up for later, but for less than a tile.
            credit = (credit - marched as f64).min(1.0);
            if (turn + 1) % u64::from(arguments.fps) == 0 {
                deviations = bench.living.audit_living(AUDITED_PER_S)?;
            }
        }
        let at_s = until as f64 / fps;
        // Those who are shown change from moment to moment.
        for viewer in [0, count / 2] {
            let viewer = (viewer + 3 * moment as usize) % count;
            pictures.push(bench.compared(&viewers, viewer, at_s)?);
        }
        let flip = pictures.last().map_or(0.0, |p| p.errors.flip);
        let marched = bench.living.totals().texels_updated - before;
        let share = marched as f64 / ((until - from) * rays_per_frame) as f64;
        progress.done(&format!("{share:.4} texels per ray, FLIP {flip:.4}"));
    }
    progress.finish();
    let texels = bench.living.totals().texels_updated - texels_at_start;
    let rays = rays_per_frame * turns;
    let mean = |of: &[LivingPicture], value: fn(&ShownErrors) -> f64| {
        of.iter().map(|p| value(&p.errors)).sum::<f64>() / of.len().max(1) as f64
    };
    let flips = pictures.iter().map(|p| p.errors.flip);
    let ssims = pictures.iter().map(|p| p.errors.ssim);
    Ok(LivingReport {
        adapter: bench.living.adapter(),
        scene: serde_json::to_value(scene.to_document())?,
        size: arguments.size,
        viewers: arguments.viewers,
        seconds: arguments.seconds,
        fps: arguments.fps,
        mip_bias: arguments.mip_bias,
        steps: arguments.steps,
        samples: arguments.samples,
        samples_by_area: arguments.samples_by_area,
        age_factor: arguments.age_factor,
        texels_at_start,
        texels,
        rays,
        texels_per_ray: texels as f64 / rays as f64,
        flip_at_start: mean(&start, |e| e.flip),
        ssim_at_start: mean(&start, |e| e.ssim),
        flip: mean(&pictures, |e| e.flip),
        flip_most: flips.fold(0.0, f64::max),
        ssim: mean(&pictures, |e| e.ssim),
        ssim_least: ssims.fold(1.0, f64::min),
        audit_mean_percent: deviations.iter().map(|t| t.deviation_percent).sum::<f64>()
            / deviations.len().max(1) as f64,
        pictures,
        wall_s: begun.elapsed().as_secs_f64(),
    })
}

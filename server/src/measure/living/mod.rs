//! `skycell-server measure living`: viewers who look around under wind, from caches that are kept alive.
//!
//! `crowd` says where they are and look, `caches` are what they read; this lets time pass, counts texels and compares
//! pictures.

mod caches;
mod crowd;

use super::arguments::parsed_size;
use super::metrics::shown_errors;
use super::progress::{Progress, spoken};
use super::reference::without_alpha;
use super::sheet::sheet;
use super::store::{write_json, write_whole};
use crate::cells::CellLimit;
use crate::config::{AGE_FACTOR, FrameFilter, RenderConfig};
use crate::frame_loop::{StillRenderer, StillSettings};
use crate::march::MarchSettings;
use crate::quality::default_parallax_steps;
use crate::render_command::{Folders, read_scene};
use anyhow::{Context, ensure};
use caches::{LivingCaches, LivingFigures, LivingPicture};
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
    /// Radius of the circle in which they are, m.
    #[arg(long, default_value_t = 5.0)]
    pub spread_m: f64,
    /// Speed at which all of them go east together, m/s.
    #[arg(long, default_value_t = 0.0)]
    pub walk_m_per_s: f64,
    /// Measure it a second time, with a cell for each viewer.
    #[arg(long)]
    pub beside_own_cells: bool,
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
    /// Write compared pictures into the folder, and a sheet of four of the first viewer's moments: rows of rays, of shared cells,
    /// and with --beside-own-cells of those.
    #[arg(long)]
    pub pictures: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
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
    /// Radius of the circle in which they are, m.
    pub spread_m: f64,
    /// Speed at which it goes east, m/s.
    pub walk_m_per_s: f64,
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
    /// Rays of a screen-space renderer with one ray a pixel, frame and viewer.
    pub rays: u64,
    /// With cells as they form.
    #[serde(flatten)]
    pub shared: LivingFigures,
    /// With a cell for each viewer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_cells: Option<LivingFigures>,
    /// How long the run took, s.
    pub wall_s: f64,
}

impl LivingReport {
    fn told(&self) -> String {
        let mut told = format!(
            "{} viewers, {}x{}, {} s at {} fps, mip bias {}, age factor {}: {}",
            self.viewers,
            self.size.width(),
            self.size.height(),
            self.seconds,
            self.fps,
            self.mip_bias,
            self.age_factor,
            self.shared.told(self.rays),
        );
        if let Some(own) = &self.own_cells {
            told += &format!(
                "\na cell for each: {}\n{:.1} times as many texels",
                own.told(self.rays),
                own.texels as f64 / (self.shared.texels as f64).max(1.0)
            );
        }
        told
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
    fn check(&self) -> anyhow::Result<()> {
        ensure!(
            self.seconds > 0.0 && self.seconds <= 3_600.0,
            "--seconds is {}; allowed: above 0, up to 3600",
            self.seconds
        );
        ensure!(
            self.texels_per_ray > 0.0 && self.texels_per_ray <= 100.0,
            "--texels-per-ray is {}; allowed: above 0, up to 100",
            self.texels_per_ray
        );
        ensure!(
            (0.0..=1_000.0).contains(&self.walk_m_per_s),
            "--walk-m-per-s is {}; allowed: 0 to 1000",
            self.walk_m_per_s
        );
        Ok(())
    }

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

    fn tiles_per_turn(&self) -> f64 {
        self.texels_per_ray * self.rays_per_frame() as f64 / crate::cache::TEXELS_PER_TILE as f64
    }

    fn rays_per_frame(&self) -> u64 {
        u64::from(self.viewers) * u64::from(self.size.pixels())
    }
}

/// All renderers, in the same moment.
struct Bench<'a> {
    arguments: &'a LivingArguments,
    crowd: LookingCrowd,
    /// Cells as they form, and where that is asked for a cell for each.
    caches: Vec<LivingCaches>,
    exact: StillRenderer,
    exact_s: f64,
    /// The first viewer's pictures: what is exact, then from the caches.
    rows: Vec<(String, Vec<RgbImage>)>,
}

impl<'a> Bench<'a> {
    fn new(arguments: &'a LivingArguments, scene: &Arc<Scene>) -> anyhow::Result<Self> {
        let folders = Folders::of(
            arguments.scene.as_deref(),
            arguments.noise_cache_dir.as_ref(),
        );
        let config = RenderConfig {
            age_factor: AGE_FACTOR.check("--age-factor", arguments.age_factor)?,
            ..folders.render_config(CACHE_MEMORY_MIB)
        };
        let crowd = LookingCrowd::new(
            arguments.viewers,
            arguments.spread_m,
            arguments.walk_m_per_s,
        );
        let mut limits = vec![("shared", CellLimit::default())];
        if arguments.beside_own_cells {
            limits.push(("own-cells", CellLimit::new(0.0, 0.0)));
        }
        let settings = arguments.settings(RendererKind::Cached);
        let cameras = crowd.cameras(0.0)?;
        let caches = limits
            .into_iter()
            .map(|(name, limit)| {
                let still = StillRenderer::new(config.clone(), scene.clone(), &[])?;
                LivingCaches::begin(name, still, &cameras, arguments.size, &settings, limit)
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        let names = caches.iter().map(LivingCaches::name);
        let rows = ["exact"].into_iter().chain(names);
        Ok(Self {
            arguments,
            crowd,
            rows: rows.map(|name| (name.to_owned(), Vec::new())).collect(),
            caches,
            exact: StillRenderer::new(config, scene.clone(), &[])?,
            exact_s: 0.0,
        })
    }

    /// Compares what a viewer sees; returns its mean FLIP from cells as they form.
    fn compare(&mut self, viewer: usize, at_s: f64) -> anyhow::Result<f64> {
        let size = self.arguments.size;
        let picture = |display: &[u8]| {
            RgbImage::from_raw(size.width(), size.height(), without_alpha(display))
                .context("the device gave a picture of another size")
        };
        self.exact.advance_time(at_s - self.exact_s);
        self.exact_s = at_s;
        let camera = self.crowd.camera(viewer, at_s)?;
        let settings = self.arguments.settings(RendererKind::ScreenSpace);
        let exact = self.exact.render_with(camera, size, &settings, |_| {})?;
        let mut shown = vec![picture(&exact.display)?];
        for caches in &mut self.caches {
            let seen = picture(&caches.show(viewer)?)?;
            let errors = shown_errors(&shown[0], &seen)?;
            ensure!(
                errors.flip.is_finite(),
                "a picture has values that are no numbers"
            );
            caches.note(LivingPicture {
                at_s,
                viewer,
                errors,
            });
            shown.push(seen);
        }
        if self.arguments.pictures {
            for ((name, row), picture) in self.rows.iter_mut().zip(shown) {
                let file = format!("{at_s:05.1}-{viewer}-{name}.png");
                picture.save(self.arguments.out.join(file))?;
                if viewer == 0 {
                    row.push(picture);
                }
            }
        }
        Ok(self.caches[0].last_flip())
    }

    /// Lets time pass from one turn to another.
    fn pass(&mut self, turns: std::ops::Range<u64>) -> anyhow::Result<()> {
        let fps = f64::from(self.arguments.fps);
        let tiles = self.arguments.tiles_per_turn();
        for turn in turns {
            let cameras = self.crowd.cameras((turn + 1) as f64 / fps)?;
            for caches in &mut self.caches {
                caches.turn(&cameras, 1.0 / fps, tiles)?;
                if (turn + 1) % u64::from(self.arguments.fps) == 0 {
                    caches.audit()?;
                }
            }
        }
        Ok(())
    }
}

fn measured(arguments: &LivingArguments) -> anyhow::Result<LivingReport> {
    let begun = Instant::now();
    arguments.check()?;
    let scene = Arc::new(arguments.windy_scene()?);
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("--out {} cannot be made", arguments.out.display()))?;
    let mut bench = Bench::new(arguments, &scene)?;
    let mut progress = Progress::new(
        u64::from(arguments.moments) + 1,
        f64::from(arguments.moments),
    );
    progress.begin("before time", 0.0);
    let count = arguments.viewers as usize;
    let flip = bench.compare(0, 0.0)?;
    bench.compare(count / 2, 0.0)?;
    for caches in &mut bench.caches {
        caches.start();
    }
    progress.done(&format!("FLIP {flip:.4}"));
    let fps = f64::from(arguments.fps);
    let turns = (arguments.seconds * fps).round().max(1.0) as u64;
    let moments = u64::from(arguments.moments).min(turns);
    for moment in 0..moments {
        progress.begin(&format!("moment {}", moment + 1), 1.0);
        let before = bench.caches[0].texels();
        let until = (moment + 1) * turns / moments;
        let from = moment * turns / moments;
        bench.pass(from..until)?;
        let at_s = until as f64 / fps;
        // Those who are shown change from moment to moment.
        for viewer in [0, count / 2] {
            let viewer = (viewer + 3 * moment as usize) % count;
            bench.compare(viewer, at_s)?;
        }
        let flip = bench.caches[0].last_flip();
        let marched = bench.caches[0].texels() - before;
        let share = marched as f64 / ((until - from) * arguments.rays_per_frame()) as f64;
        progress.done(&format!("{share:.4} texels per ray, FLIP {flip:.4}"));
    }
    progress.finish();
    if arguments.pictures {
        let sheet = sheet(&bench.rows)?;
        write_whole(&arguments.out.join("sheet.jpg"), &sheet)?;
    }
    let rays = arguments.rays_per_frame() * turns;
    let mut figures = bench.caches.iter().map(|caches| caches.figures(rays));
    Ok(LivingReport {
        adapter: bench.exact.adapter(),
        scene: serde_json::to_value(scene.to_document())?,
        size: arguments.size,
        viewers: arguments.viewers,
        spread_m: arguments.spread_m,
        walk_m_per_s: arguments.walk_m_per_s,
        seconds: arguments.seconds,
        fps: arguments.fps,
        mip_bias: arguments.mip_bias,
        steps: arguments.steps,
        samples: arguments.samples,
        samples_by_area: arguments.samples_by_area,
        age_factor: arguments.age_factor,
        rays,
        shared: figures.next().context("no caches")?,
        own_cells: figures.next(),
        wall_s: begun.elapsed().as_secs_f64(),
    })
}

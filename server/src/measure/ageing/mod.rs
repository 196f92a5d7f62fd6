//! `skycell-server measure ageing`: how fast cached texels age, by each cause.
//!
//! Caches are marched until nothing is left to do. Then a cause has its way, and nobody tells them: an audit says how far texels
//! are from fresh ones, and pictures are compared with those of the screen-space renderer in the changed scene.

mod plan;

use super::arguments::parsed_size;
use super::metrics::{ShownErrors, shown_errors};
use super::progress::{Progress, spoken};
use super::reference::without_alpha;
use super::store::write_json;
use crate::cache::AgeingRates;
use crate::cells::CellLimit;
use crate::config::FrameFilter;
use crate::frame_loop::{AuditedTexel, LivingViewers, StillRenderer, StillSettings};
use crate::march::MarchSettings;
use crate::render_command::{Folders, read_scene};
use anyhow::Context;
use image::RgbImage;
use plan::{Cause, still};
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

/// GPU memory for the cache.
const CACHE_MEMORY_MIB: u32 = 1024;
/// Which way those look whose pictures are compared, clockwise from north.
const YAWS_DEG: [f64; 4] = [0.0, 90.0, 180.0, 270.0];
/// Height of the eyes, m.
const EYE_M: f64 = 2.0;
/// How far up everybody looks, degrees.
const PITCH_DEG: f64 = 20.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;
/// What an audit finds is told with as many texels.
const AUDITED: usize = 2048;
/// The same with --quick.
const AUDITED_QUICK: usize = 512;

/// What `measure ageing` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct AgeingArguments {
    /// Folder of the result.
    #[arg(long, default_value = "skycell-ageing", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it. Wind and evolution are the study's own.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// One amount of each cause, few texels: a minute on two cores.
    #[arg(long)]
    pub quick: bool,
    /// Only these causes; all without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "CAUSE,...")]
    pub causes: Vec<Cause>,
    /// Size of the pictures.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size, default_value = "160x90")]
    pub size: FrameSize,
    /// Steps through a layer's thickness.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: u32,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What an amount of a cause does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct AgeingPoint {
    /// Why.
    pub cause: Cause,
    /// How much, in the cause's unit.
    pub amount: f64,
    /// Steps of the sky that this is.
    pub sky_steps: f64,
    /// Mean angle by which texels are seen from elsewhere or have risen, rad.
    pub off_rad: f64,
    /// Mean deviation of texels, percent.
    pub mean_percent: f64,
    /// 95 of 100 are not above this.
    pub p95_percent: f64,
    /// How fast the mean grows with the angle: least squares over texels through what texels deviate without it, percent/rad.
    pub percent_per_rad: f64,
    /// Mean FLIP of the pictures.
    pub flip: f64,
    /// Mean SSIM of the pictures.
    pub ssim: f64,
}

/// All that is reported.
#[derive(Clone, Debug, Serialize)]
pub(super) struct AgeingReport {
    /// What rendered.
    pub adapter: String,
    /// The whole scene document.
    pub scene: Value,
    /// Of the pictures.
    pub size: FrameSize,
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Before anything ages.
    pub fresh: AgeingPoint,
    /// Every amount.
    pub points: Vec<AgeingPoint>,
    /// What caches reckon with.
    pub reckoned: AgeingRates,
    /// How long the run took, s.
    pub wall_s: f64,
}

/// Measures and writes the report.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, a missing device.
pub(super) fn run(arguments: &AgeingArguments) -> anyhow::Result<()> {
    let report = measured(arguments)?;
    write_json(&arguments.out.join("ageing.json"), &report)?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!("| cause | amount | steps | angle, rad | mean, % | p95, % | %/rad | FLIP | SSIM |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for point in std::iter::once(&report.fresh).chain(&report.points) {
        println!("{}", row(point));
    }
    println!(
        "{:?}\n{}, {}",
        report.reckoned,
        report.adapter,
        spoken(report.wall_s)
    );
    Ok(())
}

fn row(point: &AgeingPoint) -> String {
    format!(
        "| {} | {} {} | {:.1} | {:.4} | {:.2} | {:.2} | {:.0} | {:.4} | {:.4} |",
        point.cause.name(),
        point.amount,
        point.cause.unit(),
        point.sky_steps,
        point.off_rad,
        point.mean_percent,
        point.p95_percent,
        point.percent_per_rad,
        point.flip,
        point.ssim,
    )
}

struct Bench<'a> {
    arguments: &'a AgeingArguments,
    base: Scene,
    cameras: Vec<Camera>,
    living: StillRenderer,
    exact: StillRenderer,
}

impl Bench<'_> {
    fn settings(&self, renderer: RendererKind, samples: u32) -> StillSettings {
        StillSettings {
            renderer,
            march: MarchSettings {
                steps: self.arguments.steps,
                ..MarchSettings::default()
            },
            samples,
            filter: FrameFilter::CatmullRom,
            ..StillSettings::default()
        }
    }

    /// Lets a cause have its way with fresh caches.
    fn aged(
        &mut self,
        cause: Cause,
        amount: f64,
        fresh_percent: f64,
    ) -> anyhow::Result<AgeingPoint> {
        let samples = if cause == Cause::Samples {
            amount as u32
        } else {
            8
        };
        let still_scene = Arc::new(Scene::from_json(&still(&self.base, 0.0)?)?);
        let changed = Arc::new(cause.scene(&self.base, amount)?);
        self.living.set_scene(still_scene)?;
        let settings = self.settings(RendererKind::Cached, samples);
        let size = self.arguments.size;
        let viewers =
            self.living
                .begin_living(&self.cameras, size, &settings, CellLimit::default())?;
        self.living.settle_living()?;
        self.living.pretend_living(changed.clone())?;
        let way_m = match cause {
            Cause::Wind | Cause::Carried | Cause::Evolution => amount,
            _ => 0.0,
        };
        // A metre a second.
        self.living.advance_time(way_m);
        if cause == Cause::Carried {
            let standing = Arc::new(Cause::standing(&self.base)?);
            self.living.pretend_living(standing)?;
            self.living.refresh_living()?;
        }
        let blowing = changed.clone();
        self.exact.set_scene(changed)?;
        self.exact.advance_time(way_m);
        let count = if self.arguments.quick {
            AUDITED_QUICK
        } else {
            AUDITED
        };
        let texels = self.living.audit_living(count)?;
        let errors = self.errors(&viewers)?;
        // The next one begins where this one has: what has drifted is brought back.
        self.living.pretend_living(blowing)?;
        for renderer in [&mut self.living, &mut self.exact] {
            renderer.advance_time(-way_m);
        }
        Ok(point(cause, amount, &texels, fresh_percent, &errors))
    }

    fn errors(&mut self, viewers: &LivingViewers) -> anyhow::Result<Vec<ShownErrors>> {
        let size = self.arguments.size;
        let settings = self.settings(RendererKind::ScreenSpace, 8);
        let picture = |display: &[u8]| {
            RgbImage::from_raw(size.width(), size.height(), without_alpha(display))
                .context("the device gave a picture of another size")
        };
        let mut errors = Vec::new();
        for (viewer, camera) in self.cameras.clone().into_iter().enumerate() {
            let shown = picture(&self.living.show_living(viewers, viewer)?)?;
            let exact = self.exact.render_with(camera, size, &settings, |_| {})?;
            errors.push(shown_errors(&picture(&exact.display)?, &shown)?);
        }
        Ok(errors)
    }
}

fn point(
    cause: Cause,
    amount: f64,
    texels: &[AuditedTexel],
    fresh_percent: f64,
    errors: &[ShownErrors],
) -> AgeingPoint {
    let mean = |values: &mut dyn Iterator<Item = f64>, count: usize| {
        values.sum::<f64>() / count.max(1) as f64
    };
    let mut deviations: Vec<f64> = texels.iter().map(|t| t.deviation_percent).collect();
    deviations.sort_unstable_by(f64::total_cmp);
    let squares: f64 = texels.iter().map(|t| t.off_rad * t.off_rad).sum();
    let rising = texels
        .iter()
        .map(|t| t.off_rad * (t.deviation_percent - fresh_percent));
    let at_95 = (deviations.len() * 95).div_ceil(100).max(1) - 1;
    AgeingPoint {
        cause,
        amount,
        sky_steps: cause.sky_steps(amount),
        off_rad: mean(&mut texels.iter().map(|t| t.off_rad), texels.len()),
        mean_percent: mean(&mut deviations.iter().copied(), texels.len()),
        p95_percent: deviations.get(at_95).copied().unwrap_or_default(),
        percent_per_rad: if squares > 0.0 {
            rising.sum::<f64>() / squares
        } else {
            0.0
        },
        flip: mean(&mut errors.iter().map(|e| e.flip), errors.len()),
        ssim: mean(&mut errors.iter().map(|e| e.ssim), errors.len()),
    }
}

fn measured(arguments: &AgeingArguments) -> anyhow::Result<AgeingReport> {
    let begun = Instant::now();
    let base = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("--out {} cannot be made", arguments.out.display()))?;
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    let config = folders.render_config(CACHE_MEMORY_MIB);
    let cameras = YAWS_DEG
        .iter()
        .map(|yaw_deg| Camera::new([0.0, EYE_M, 0.0], *yaw_deg, PITCH_DEG, FOV_DEG))
        .collect::<Result<Vec<_>, _>>()?;
    let scene = Arc::new(Scene::from_json(&still(&base, 0.0)?)?);
    let mut bench = Bench {
        arguments,
        base,
        cameras,
        living: StillRenderer::new(config.clone(), scene.clone(), &[])?,
        exact: StillRenderer::new(config, scene.clone(), &[])?,
    };
    let causes: Vec<Cause> = Cause::ALL
        .into_iter()
        .filter(|cause| arguments.causes.is_empty() || arguments.causes.contains(cause))
        .collect();
    let all: Vec<(Cause, f64)> = causes
        .iter()
        .flat_map(|cause| {
            cause
                .amounts(arguments.quick)
                .iter()
                .map(|amount| (*cause, *amount))
        })
        .collect();
    let mut progress = Progress::new(all.len() as u64 + 1, all.len() as f64 + 1.0);
    progress.begin("fresh", 1.0);
    let fresh = bench.aged(Cause::Samples, 8.0, 0.0)?;
    progress.done(&format!("{:.2} %", fresh.mean_percent));
    let mut points = Vec::new();
    for (cause, amount) in all {
        progress.begin(&format!("{} {amount}", cause.name()), 1.0);
        let point = bench.aged(cause, amount, fresh.mean_percent)?;
        progress.done(&format!(
            "{:.2} %, FLIP {:.4}",
            point.mean_percent, point.flip
        ));
        points.push(point);
    }
    progress.finish();
    Ok(AgeingReport {
        adapter: bench.living.adapter(),
        scene: serde_json::to_value(scene.to_document())?,
        size: arguments.size,
        steps: arguments.steps,
        fresh,
        points,
        reckoned: AgeingRates::RECKONED,
        wall_s: begun.elapsed().as_secs_f64(),
    })
}

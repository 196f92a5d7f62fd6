//! `skycell-server measure scaling`: what many viewers cost.
//!
//! `crowds` moves cameras about without a device, `tiles` drives the caches' bookkeeping for them; `views` renders viewers at
//! one place, `counts` tells what they ask for without rendering; `page` shows crowds and views.

pub mod counts;
pub mod crowds;
mod page;
pub mod tiles;
pub mod views;

use super::arguments::parsed_size;
use super::progress::{Progress, spoken};
use super::store::{key_of, write_json, write_whole};
use super::trade::version;
use crate::cells::{CellLimit, CrowdMotion, ErrorCurve, ErrorCurves};
use crate::frame_loop::{SharedFigures, StillRenderer};
use crate::quality::default_parallax_steps;
use crate::render_command::{Folders, read_scene};
use anyhow::{Context, ensure};
use crowds::{CrowdOutcome, CrowdSetup, watch};
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::{FrameSize, Scene};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use tiles::TileSetup;
use views::{HORIZONTAL_FOV_MAX_DEG, RingOutcome, RingSetup};

/// GPU memory for the cache: sixteen pictures of 1920×1080 at full resolution side by side.
const CACHE_MEMORY_MIB: u32 = 3072;
/// More viewers than a ring has room for.
const RING_VIEWERS_MAX: u32 = 128;
/// More viewers than a crowd has.
const CROWD_VIEWERS_MAX: usize = 10_000;
/// Work of a crowd's viewer and simulated second beside a ring of one viewer, roughly.
const CROWD_WORK: f64 = 2e-5;

/// What `measure scaling` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct ScalingArguments {
    /// Folder of the results; rings that are there already are not measured again.
    #[arg(long, default_value = "skycell-scaling", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Small crowds for half a minute, few and small pictures: a minute on two cores.
    #[arg(long)]
    pub quick: bool,
    /// Only these parts; crowds and rings without. `counts` stands alone.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "PART,...")]
    pub only: Vec<Part>,
    /// Viewers of crowds [default: 40 with --quick, else 100,1000].
    #[arg(long, value_delimiter = ',', value_name = "N,...")]
    pub crowd_viewers: Vec<usize>,
    /// Only these motions; all without: wander, gather, migrate, fly.
    #[arg(long, value_delimiter = ',', value_name = "MOTION,...", value_parser = parsed_motion)]
    pub motions: Vec<CrowdMotion>,
    /// Simulated minutes of a crowd [default: 0.5 with --quick, else 10].
    #[arg(long, value_name = "MINUTES")]
    pub minutes: Option<f64>,
    /// Decisions on cells in a simulated second.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=120))]
    pub ticks_per_s: u32,
    /// Decisions from one look at the caches to the next.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1200))]
    pub ticks_per_look: u32,
    /// Tiles that a crowd may march in a second; what it then lacks is told.
    #[arg(long, default_value_t = 100_000.0, value_name = "TILES")]
    pub tiles_per_s: f64,
    /// Seed of the crowds.
    #[arg(long, default_value_t = 7)]
    pub seed: u64,
    /// Error that cells are to keep, FLIP: their limit follows from the measured curve. Without it they have the default limit.
    #[arg(long, value_name = "FLIP")]
    pub max_error: Option<f64>,
    /// Size of pictures, a crowd's and a ring's [default: 160x90 with --quick, else 320x180].
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size)]
    pub size: Option<FrameSize>,
    /// Viewers of rings [default: 1,4 with --quick, else 1,4,16].
    #[arg(long, value_delimiter = ',', value_name = "N,...", value_parser = clap::value_parser!(u32).range(1..=i64::from(RING_VIEWERS_MAX)))]
    pub viewers: Vec<u32>,
    /// Shares of the field of view that neighbours of a ring have in common, percent [default: 0,100 with --quick, else
    /// 0,40,80,100].
    #[arg(long, value_delimiter = ',', value_name = "PERCENT,...")]
    pub overlaps: Vec<f64>,
    /// Halvings of the cache's resolution below the screen's, 0 to 4 [default: 1 with --quick, else 0,1,2,3].
    #[arg(long, value_delimiter = ',', value_name = "BIAS,...")]
    pub mip_biases: Vec<f32>,
    /// Steps of rings through a layer's thickness [default: 16 with --quick, else 32].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: Option<u32>,
    /// Samples of a texel [default: 2 with --quick, else 8].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: Option<u32>,
    /// Where several texels make a pixel of a ring, it is their samples together that are so many.
    #[arg(long)]
    pub samples_by_area: bool,
    /// Measure everything anew, whatever is in the folder.
    #[arg(long)]
    pub fresh: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A part of the study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Part {
    /// Cameras that wander, gather, migrate and fly, without a device.
    Crowds,
    /// Viewers at one place, rendered.
    Rings,
    /// What rings of large pictures ask for, without a device; only where it is asked for.
    Counts,
}

fn parsed_motion(text: &str) -> Result<CrowdMotion, String> {
    CrowdMotion::ALL
        .into_iter()
        .find(|motion| motion.name() == text)
        .ok_or_else(|| "allowed: wander, gather, migrate, fly".to_owned())
}

/// All that is reported.
#[derive(Clone, Debug, Serialize)]
pub struct ScalingReport {
    /// Version of the program.
    pub version: &'static str,
    /// What rendered the rings; none where there are none.
    pub adapter: Option<String>,
    /// The whole scene document.
    pub scene: Value,
    /// Of pictures.
    pub size: FrameSize,
    /// Samples of a texel.
    pub samples: u32,
    /// Halvings of the caches' resolution of crowds.
    pub crowd_mip_bias: f32,
    /// How wide cells of crowds may be sideways, m.
    pub limit_m: f64,
    /// Decisions on cells in a simulated second.
    pub ticks_per_s: u32,
    /// Decisions from one look at the caches to the next.
    pub ticks_per_look: u32,
    /// Tiles that a crowd may march in a second.
    pub tiles_per_s: f64,
    /// What came of crowds.
    pub crowds: Vec<CrowdOutcome>,
    /// What came of rings.
    pub rings: Vec<RingOutcome>,
    /// How long the run took, s.
    pub wall_s: f64,
}

/// What is asked for, with every default filled in.
struct Plan {
    scene: Scene,
    crowds: Vec<CrowdSetup>,
    rings: Vec<RingSetup>,
    size: FrameSize,
    samples: u32,
    limit: CellLimit,
}

impl ScalingArguments {
    fn has(&self, part: Part) -> bool {
        (self.only.is_empty() && part != Part::Counts) || self.only.contains(&part)
    }

    fn plan(&self, curve: &ErrorCurve) -> anyhow::Result<Plan> {
        let scene = read_scene(self.scene.as_deref())?;
        let quick = self.quick;
        let size = match self.size {
            Some(size) => size,
            None if quick => FrameSize::new(160, 90)?,
            None => FrameSize::new(320, 180)?,
        };
        let samples = self.samples.unwrap_or(if quick { 2 } else { 8 });
        let limit = match self.max_error {
            Some(flip) => {
                ensure!(
                    (0.0..=1.0).contains(&flip),
                    "--max-error is {flip}; allowed: 0 to 1"
                );
                curve.limit(flip)
            }
            None => CellLimit::default(),
        };
        Ok(Plan {
            crowds: self.crowd_setups(size, samples, limit)?,
            rings: self.ring_setups(size, samples)?,
            scene,
            size,
            samples,
            limit,
        })
    }

    fn crowd_setups(
        &self,
        size: FrameSize,
        samples: u32,
        limit: CellLimit,
    ) -> anyhow::Result<Vec<CrowdSetup>> {
        if !self.has(Part::Crowds) {
            return Ok(Vec::new());
        }
        let minutes = self.minutes.unwrap_or(if self.quick { 0.5 } else { 10.0 });
        ensure!(
            (0.01..=1440.0).contains(&minutes),
            "--minutes is {minutes}; allowed: 0.01 to 1440"
        );
        ensure!(
            (1.0..=1e9).contains(&self.tiles_per_s),
            "--tiles-per-s is {}; allowed: 1 to 1e9",
            self.tiles_per_s
        );
        let viewers = given(
            &self.crowd_viewers,
            if self.quick { &[40] } else { &[100, 1000] },
        );
        let motions = given(&self.motions, &CrowdMotion::ALL);
        let mut setups = Vec::new();
        for viewers in viewers {
            ensure!(
                (1..=CROWD_VIEWERS_MAX).contains(&viewers),
                "--crowd-viewers has {viewers}; allowed: 1 to {CROWD_VIEWERS_MAX}"
            );
            for motion in &motions {
                setups.push(CrowdSetup {
                    motion: *motion,
                    viewers,
                    duration_s: minutes * 60.0,
                    ticks_per_s: self.ticks_per_s,
                    ticks_per_look: self.ticks_per_look,
                    seed: self.seed,
                    limit,
                    tiles: TileSetup {
                        size,
                        mip_bias: f64::from(CROWD_MIP_BIAS),
                        samples,
                        tiles_per_s: self.tiles_per_s,
                    },
                });
            }
        }
        Ok(setups)
    }

    fn ring_setups(&self, size: FrameSize, samples: u32) -> anyhow::Result<Vec<RingSetup>> {
        if !self.has(Part::Rings) {
            return Ok(Vec::new());
        }
        let quick = self.quick;
        let viewers = given(&self.viewers, if quick { &[1, 4] } else { &[1, 4, 16] });
        let overlaps = given(
            &self.overlaps,
            if quick {
                &[0.0, 100.0]
            } else {
                &[0.0, 40.0, 80.0, 100.0]
            },
        );
        let biases = given(
            &self.mip_biases,
            if quick { &[1.0] } else { &[0.0, 1.0, 2.0, 3.0] },
        );
        let steps = self.steps.unwrap_or(if quick { 16 } else { 32 });
        let mut setups = Vec::new();
        for mip_bias in biases {
            ensure!(
                (0.0..=4.0).contains(&mip_bias),
                "--mip-biases has {mip_bias}; allowed: 0 to 4"
            );
            for viewers in &viewers {
                for (place, percent) in overlaps.iter().enumerate() {
                    ensure!(
                        (0.0..=100.0).contains(percent),
                        "--overlaps has {percent}; allowed: 0 to 100"
                    );
                    // One viewer has no neighbour.
                    if *viewers == 1 && place > 0 {
                        continue;
                    }
                    setups.push(RingSetup {
                        viewers: *viewers,
                        overlap: percent / 100.0,
                        mip_bias,
                        size,
                        steps,
                        samples,
                        samples_by_area: self.samples_by_area,
                    });
                }
            }
        }
        Ok(setups)
    }
}

/// Halvings of the caches' resolution of crowds.
const CROWD_MIP_BIAS: f32 = 1.0;
/// Slabs of a layer in crowds' caches.
const CROWD_SLABS: u32 = 1;

fn given<T: Clone>(asked: &[T], default: &[T]) -> Vec<T> {
    if asked.is_empty() { default } else { asked }.to_vec()
}

/// Measures and writes the report.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, a number out of range, a missing device.
pub(super) fn run(arguments: &ScalingArguments) -> anyhow::Result<()> {
    if arguments.only == [Part::Counts] {
        return print_counts(arguments);
    }
    let begun = Instant::now();
    let out = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| format!("--out {} cannot be made", out.display()))?;
    let curves = ErrorCurves::embedded();
    let curve = curves.of(CROWD_SLABS, default_parallax_steps());
    let plan = arguments.plan(curve)?;
    let crowd_work = |setup: &CrowdSetup| CROWD_WORK * setup.viewers as f64 * setup.duration_s;
    let works = plan.crowds.iter().map(crowd_work);
    let works = works.chain(plan.rings.iter().map(RingSetup::expected_work));
    let mut progress = Progress::new((plan.crowds.len() + plan.rings.len()) as u64, works.sum());
    let mut crowds = Vec::new();
    for setup in &plan.crowds {
        let name = format!("{} who {}", setup.viewers, setup.motion.name());
        progress.begin(&name, crowd_work(setup));
        let outcome = watch(setup, &plan.scene, curve, |share| progress.share(share));
        progress.done(&format!(
            "{:.0} cells, {:.2} changes a viewer and minute, {:.0} texels a viewer and second",
            outcome.cells.median,
            outcome.changes_per_viewer_minute,
            outcome.texels.per_viewer_second
        ));
        crowds.push(outcome);
    }
    let (adapter, rings) = rings(arguments, &plan, &mut progress)?;
    progress.finish();
    let report = ScalingReport {
        version: env!("CARGO_PKG_VERSION"),
        adapter,
        scene: serde_json::to_value(plan.scene.to_document())?,
        size: plan.size,
        samples: plan.samples,
        crowd_mip_bias: CROWD_MIP_BIAS,
        limit_m: plan.limit.radius_m(),
        ticks_per_s: arguments.ticks_per_s,
        ticks_per_look: arguments.ticks_per_look,
        tiles_per_s: arguments.tiles_per_s,
        crowds,
        rings,
        wall_s: begun.elapsed().as_secs_f64(),
    };
    write_json(&out.join("scaling.json"), &report)?;
    let page_path = out.join("scaling.html");
    write_whole(&page_path, page::page(&report).as_bytes())?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!(
        "{} crowds and {} rings in {}",
        report.crowds.len(),
        report.rings.len(),
        spoken(report.wall_s)
    );
    println!("{}", page_path.display());
    Ok(())
}

/// Prints what rings of large pictures ask for.
fn print_counts(arguments: &ScalingArguments) -> anyhow::Result<()> {
    let sizes = match arguments.size {
        Some(size) => vec![size],
        None => vec![FrameSize::new(1280, 720)?, FrameSize::new(1920, 1080)?],
    };
    let scene = read_scene(arguments.scene.as_deref())?;
    let mut counts = Vec::new();
    for size in sizes {
        let rings = ScalingArguments {
            only: vec![Part::Rings],
            ..arguments.clone()
        };
        for setup in rings.ring_setups(size, arguments.samples.unwrap_or(8))? {
            let round_deg = 360.0 / f64::from(setup.viewers);
            if round_deg < HORIZONTAL_FOV_MAX_DEG {
                counts.push(counts::count(&setup, round_deg, &scene)?);
            }
            counts.push(counts::count(&setup, HORIZONTAL_FOV_MAX_DEG, &scene)?);
        }
    }
    if arguments.json {
        println!("{}", serde_json::to_string(&counts)?);
    } else {
        print!("{}", counts::table(&counts));
    }
    Ok(())
}

type Rings = (Option<String>, Vec<RingOutcome>);

fn rings(
    arguments: &ScalingArguments,
    plan: &Plan,
    progress: &mut Progress,
) -> anyhow::Result<Rings> {
    if plan.rings.is_empty() {
        return Ok((None, Vec::new()));
    }
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    let config = folders.render_config(CACHE_MEMORY_MIB);
    let scene = plan.scene.at_sky_s(0.0);
    let mut still = StillRenderer::new(config, Arc::new(scene), &[])?;
    let adapter = still.adapter();
    let path = arguments.out.join("rings.json");
    let mut kept = kept(&path, arguments.fresh)?;
    let depends_on = [
        serde_json::to_string(&plan.scene.to_document())?,
        adapter.clone(),
        version(),
    ];
    let mut found = Vec::new();
    for setup in &plan.rings {
        let name = format!(
            "{} viewers, {:.0} % overlap, mip bias {}",
            setup.viewers,
            setup.overlap * 100.0,
            setup.mip_bias
        );
        progress.begin(&name, setup.expected_work());
        let setup_text = serde_json::to_string(setup)?;
        let parts: Vec<&str> = [&setup_text]
            .into_iter()
            .chain(&depends_on)
            .map(String::as_str)
            .collect();
        let key = key_of(&parts);
        if let Some(figures) = kept.get(&key) {
            found.push(setup.outcome(*figures));
            progress.done("is there");
            continue;
        }
        if found.is_empty() {
            // A driver may compile at the first dispatch, which is no cost of any ring.
            let tiny = RingSetup {
                viewers: 1,
                mip_bias: 4.0,
                ..*setup
            };
            tiny.render(&mut still, |_| {})?;
        }
        let figures = setup
            .render(&mut still, |share| progress.share(share))
            .with_context(|| name.clone())?;
        kept.insert(key, figures);
        write_whole(&path, &serde_json::to_vec(&kept)?)?;
        progress.done(&format!(
            "{} texels marched in {:.1} s",
            figures.marches, figures.march_wall_s
        ));
        found.push(setup.outcome(figures));
    }
    Ok((Some(adapter), found))
}

fn kept(path: &Path, is_fresh: bool) -> anyhow::Result<BTreeMap<String, SharedFigures>> {
    if is_fresh || !path.exists() {
        return Ok(BTreeMap::new());
    }
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&bytes)
        .with_context(|| format!("{} is damaged; --fresh measures anew", path.display()))
}

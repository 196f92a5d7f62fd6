//! `skycell-server measure trade`: time against error.

use super::arguments::{ReferenceKind, TradeArguments};
use super::front::{Tradeoff, pareto_front};
use super::metrics::shown_errors;
use super::plan::{Axis, PlannedPoint, front_point, neighbours, plan};
use super::progress::{Progress, spoken};
use super::quality::quality_file;
use super::reference::{FOOTPRINT, kept_path_traced, kept_reference, reference_picture};
use super::report::{CostUnit, Report, ReportPoint, RunFacts, Summary, csv, page};
use super::settings::PointSettings;
use super::store::{Record, Store, write_whole};
use super::sweep::Sweep;
use crate::config::RenderConfig;
use crate::frame_loop::StillRenderer;
use crate::march::active_layers;
use anyhow::Context;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use image::RgbImage;
use image::imageops::FilterType;
use skycell_protocol::Scene;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Of the report's small pictures, pixels.
const THUMBNAIL_WIDTH: u32 = 256;
/// JPEG quality of the report's pictures.
const THUMBNAIL_QUALITY: u8 = 82;
/// GPU memory for the cache: the coarsest to the finest of a sweep must fit.
const CACHE_MEMORY_MIB: u32 = 2048;

/// Measures and writes the report.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub(super) fn run(arguments: &TradeArguments) -> anyhow::Result<()> {
    let begun = Instant::now();
    let scene = arguments.read_scene()?;
    if arguments.fresh {
        forget(&arguments.out)?;
    }
    let (mut sweep, mut progress, notes, planned) = prepared(arguments, &scene)?;
    let mut points = Vec::new();
    for point in planned {
        points.push(measure(&mut sweep, &mut progress, point)?);
    }
    search_front(arguments, &scene, &mut sweep, &mut progress, &mut points)?;
    progress.finish();
    let points = points
        .iter()
        .map(|(point, record)| ReportPoint::new(point, record))
        .collect();
    let report = Report::new(facts(arguments, &scene, &sweep, notes)?, points, |a, b| {
        flip_between(&sweep, a, b)
    });
    write_report(arguments, &report, &sweep)?;
    if let Some(path) = &arguments.write_quality {
        let text = format!("{:#}\n", quality_file(&report, &scene));
        write_whole(path, text.as_bytes())?;
    }
    say(arguments, &report, &sweep, begun.elapsed().as_secs_f64())
}

/// Leaves pictures where they are: without their results they are measured and written anew.
fn forget(out: &Path) -> anyhow::Result<()> {
    let results = out.join("results.jsonl");
    if results.exists() {
        std::fs::remove_file(&results)
            .with_context(|| format!("cannot remove {}", results.display()))?;
    }
    let references = out.join("reference");
    if references.exists() {
        std::fs::remove_dir_all(&references)
            .with_context(|| format!("cannot remove {}", references.display()))?;
    }
    Ok(())
}

type Prepared = (Sweep, Progress, Vec<String>, Vec<PlannedPoint>);

/// Opens folder and device, renders the reference, plans.
fn prepared(arguments: &TradeArguments, scene: &Scene) -> anyhow::Result<Prepared> {
    let (camera, size, extent) = (
        arguments.camera()?,
        arguments.picture_size()?,
        arguments.extent(),
    );
    let store = Store::open(&arguments.out)?;
    for warning in store.warnings() {
        eprintln!("warning: {warning}");
    }
    let mut notes = Vec::new();
    let mut axes = arguments.axes();
    let below_all = active_layers(scene)
        .iter()
        .all(|layer| camera.position_m()[1] < scene.layers()[layer.scene_index].base_altitude_m());
    if !below_all {
        axes.retain(|axis| !axis.needs_cache() && *axis != Axis::Front);
        notes.push(
            "The eye is in or above clouds, where the cache does not reach: its axes are left out."
                .into(),
        );
    }
    let planned = plan(extent, &axes, scene.light().octaves());
    let inputs = arguments.truth_inputs(scene);
    let config = RenderConfig {
        cache_memory_mib: CACHE_MEMORY_MIB,
        grids_dir: inputs.grids_dir.clone(),
        maps_dir: inputs.grids_dir.clone(),
        ..RenderConfig::new(inputs.noise_dir.clone())
    };
    let mut still = StillRenderer::new(config, Arc::new(scene.clone()), &[])?;
    still.advance_time(arguments.time_s);
    if still.is_software() {
        notes.push("A software driver rendered: no time here is a GPU's.".into());
    }
    let depends_on = vec![
        serde_json::to_string(&scene.to_document())?,
        serde_json::to_string(&camera)?,
        serde_json::to_string(&size)?,
        arguments.time_s.to_string(),
        still.adapter(),
        version(),
        crate::field::content_of_maps(scene, &inputs.grids_dir),
    ];
    let source = arguments.reference_source(&camera);
    let work: f64 = planned.iter().map(|p| p.settings.expected_work()).sum();
    let mut progress = Progress::new(planned.len() as u64 + 1, work);
    // Interpolated in f32, or on the processor: its time tells nothing about that of the points.
    progress.begin("reference", 0.0);
    let parts: Vec<&str> = depends_on.iter().map(String::as_str).collect();
    let references = arguments.out.join("reference");
    let reference = kept_reference(&references, &parts, scene, size, &source, || {
        reference_picture(&mut still, &source, &inputs, camera, size, |share| {
            progress.share(share)
        })
    })?;
    progress.done("rendered");
    let path_traced = match arguments.path_traced {
        Some(paths) => {
            progress.add(0.0);
            progress.begin("path tracer", 0.0);
            let share = |share| progress.share(share);
            let traced =
                kept_path_traced(&references, &parts, &inputs, camera, size, paths, share)?;
            progress.done("rendered");
            notes.push(format!(
                "Path tracer: {paths} paths a pixel; the relative MSE of its own noise, {:.2e}, is taken off.",
                traced.noise
            ));
            Some(traced)
        }
        None => None,
    };
    let folder = arguments.out.clone();
    let sweep = Sweep {
        still,
        camera,
        size,
        reference,
        path_traced,
        store,
        folder,
        depends_on,
        measured: 0,
        warm: Vec::new(),
    };
    Ok((sweep, progress, notes, planned))
}

/// Of program and shaders: results of others are not taken for this one's.
pub(super) fn version() -> String {
    let shaders: Vec<&str> = skycell_shaders::sources().map(|(_, text)| text).collect();
    format!(
        "{} {}",
        env!("CARGO_PKG_VERSION"),
        super::store::key_of(&shaders)
    )
}

type Measured = (PlannedPoint, Record);

fn measure(
    sweep: &mut Sweep,
    progress: &mut Progress,
    point: PlannedPoint,
) -> anyhow::Result<Measured> {
    let name = format!("{}: {}", point.axis.title(), point.label);
    progress.begin(&name, point.settings.expected_work());
    let record = sweep
        .measure(&point.settings, |share| progress.share(share))
        .with_context(|| name.clone())?;
    let Record { measurement, .. } = &record;
    progress.done(&format!(
        "FLIP {:.4}, {:.2} s",
        measurement.shown.flip, measurement.cost.wall_s
    ));
    Ok((point, record))
}

/// Measures neighbours of what nothing beats, as long as that finds something or until the rounds are over.
fn search_front(
    arguments: &TradeArguments,
    scene: &Scene,
    sweep: &mut Sweep,
    progress: &mut Progress,
    points: &mut Vec<Measured>,
) -> anyhow::Result<()> {
    if !points.iter().any(|(point, _)| point.axis == Axis::Front) {
        return Ok(());
    }
    let (rounds, most) = arguments.extent().front_rounds();
    let rounds = arguments.front_rounds.unwrap_or(rounds);
    for _ in 0..rounds {
        let found = unmeasured_neighbours(points, scene);
        if found.is_empty() {
            break;
        }
        // Evenly from the whole front, not from its cheap end alone.
        let stride = found.len().div_ceil(most).max(1);
        let chosen: Vec<PointSettings> = found.into_iter().step_by(stride).collect();
        for settings in &chosen {
            progress.add(settings.expected_work());
        }
        for settings in &chosen {
            points.push(measure(sweep, progress, front_point(settings))?);
        }
    }
    Ok(())
}

fn unmeasured_neighbours(points: &[Measured], scene: &Scene) -> Vec<PointSettings> {
    let served: Vec<&Measured> = points
        .iter()
        .filter(|(point, _)| point.settings.is_quality())
        .collect();
    let unit = CostUnit::of(served.iter().map(|(_, record)| &record.measurement));
    let tradeoffs: Vec<Tradeoff> = served
        .iter()
        .map(|(_, record)| Tradeoff {
            cost: unit.cost(&record.measurement).unwrap_or(f64::NAN),
            error: record.measurement.shown.flip,
        })
        .collect();
    let mut found: Vec<PointSettings> = Vec::new();
    for index in pareto_front(&tradeoffs) {
        for near in neighbours(&served[index].0.settings, scene.light().sun_steps()) {
            let known = served.iter().any(|(point, _)| point.settings == near);
            if !known && !found.contains(&near) {
                found.push(near);
            }
        }
    }
    found
}

fn shown_of(sweep: &Sweep, key: &str) -> Option<RgbImage> {
    Some(image::open(sweep.picture_path(key)).ok()?.to_rgb8())
}

fn flip_between(sweep: &Sweep, a: &str, b: &str) -> Option<f64> {
    Some(
        shown_errors(&shown_of(sweep, a)?, &shown_of(sweep, b)?)
            .ok()?
            .flip,
    )
}

fn facts(
    arguments: &TradeArguments,
    scene: &Scene,
    sweep: &Sweep,
    notes: Vec<String>,
) -> anyhow::Result<RunFacts> {
    Ok(RunFacts {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        command: command(arguments, sweep),
        adapter: sweep.still.adapter(),
        size: sweep.size,
        camera: sweep.camera,
        scene: serde_json::to_value(scene.to_document())?,
        extent: arguments.extent(),
        reference: sweep.reference.label.clone(),
        footprint: FOOTPRINT.to_owned(),
        notes,
    })
}

/// The command that measures the same again.
fn command(arguments: &TradeArguments, sweep: &Sweep) -> String {
    let mut words = vec!["skycell-server measure trade".to_owned()];
    words.extend(arguments.quick.then(|| "--quick".to_owned()));
    words.extend(arguments.full.then(|| "--full".to_owned()));
    words.push(format!(
        "--size {}x{}",
        sweep.size.width(),
        sweep.size.height()
    ));
    if arguments.reference == ReferenceKind::Converged {
        words.push(format!(
            "--reference converged --reference-grid {} --tolerance {}",
            arguments.reference_grid, arguments.tolerance
        ));
    }
    words.extend(
        arguments
            .path_traced
            .map(|paths| format!("--path-traced {paths}")),
    );
    words.extend(arguments.scene.as_ref().map(|path| {
        let name = path.file_name().unwrap_or_default();
        format!("--scene {}", name.to_string_lossy())
    }));
    if !arguments.only.is_empty() {
        let axes: Vec<String> = arguments
            .axes()
            .iter()
            .map(super::report::name_of)
            .collect();
        words.push(format!("--only {}", axes.join(",")));
    }
    let [x, y, z] = sweep.camera.position_m();
    words.push(format!(
        "--position-m {x},{y},{z} --yaw-deg {} --pitch-deg {} --fov-deg {} --time-s {}",
        sweep.camera.yaw_deg(),
        sweep.camera.pitch_deg(),
        sweep.camera.vertical_fov_deg(),
        arguments.time_s,
    ));
    words.join(" ")
}

fn write_report(arguments: &TradeArguments, report: &Report, sweep: &Sweep) -> anyhow::Result<()> {
    let out = &arguments.out;
    let text = format!("{}\n", serde_json::to_string_pretty(report)?);
    write_whole(&out.join("results.json"), text.as_bytes())?;
    write_whole(&out.join("results.csv"), &csv(report)?)?;
    let thumbnails = |key: &str| {
        let flip = image::open(sweep.flip_path(key)).ok()?.to_rgb8();
        Some([
            data_uri(&shown_of(sweep, key)?).ok()?,
            data_uri(&flip).ok()?,
        ])
    };
    let reference = data_uri(&sweep.reference.shown)?;
    write_whole(
        &out.join("report.html"),
        page(report, &reference, &thumbnails).as_bytes(),
    )?;
    Ok(())
}

/// A small picture inside the page.
fn data_uri(picture: &RgbImage) -> anyhow::Result<String> {
    let (width, height) = picture.dimensions();
    let shown_height = (THUMBNAIL_WIDTH * height / width.max(1)).max(1);
    let small =
        image::imageops::resize(picture, THUMBNAIL_WIDTH, shown_height, FilterType::Triangle);
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, THUMBNAIL_QUALITY).encode(
        small.as_raw(),
        THUMBNAIL_WIDTH as u16,
        u16::try_from(shown_height)?,
        jpeg_encoder::ColorType::Rgb,
    )?;
    Ok(format!("data:image/jpeg;base64,{}", BASE64.encode(bytes)))
}

fn say(
    arguments: &TradeArguments,
    report: &Report,
    sweep: &Sweep,
    wall_s: f64,
) -> anyhow::Result<()> {
    let page = arguments.out.join("report.html");
    if arguments.json {
        let summary = Summary {
            out: &arguments.out,
            adapter: &report.run.adapter,
            reference: &report.run.reference,
            points: report.points.len(),
            measured_now: sweep.measured,
            cost_unit: report.cost_unit,
            ladder: &report.ladder,
            presets: report
                .presets
                .iter()
                .map(|c| (c.preset, c.point.map(|i| &report.points[i])))
                .collect(),
            wall_s,
        };
        println!("{}", serde_json::to_string(&summary)?);
        return Ok(());
    }
    println!(
        "{} points, {} of them measured now, in {}, on {}",
        report.points.len(),
        sweep.measured,
        spoken(wall_s),
        report.run.adapter
    );
    for choice in &report.presets {
        let found = choice.point.map(|i| &report.points[i]).map_or_else(
            || "no point is good enough".to_owned(),
            |point| {
                format!(
                    "{}, FLIP {:.4}",
                    front_point(&point.settings).label,
                    point.measurement.shown.flip
                )
            },
        );
        println!("{:>9}: {found}", choice.preset.name());
    }
    println!("{}", page.display());
    Ok(())
}

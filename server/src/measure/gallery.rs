//! `skycell-server measure gallery`: a picture of every preset, each beside the same scene by the reference renderer.

use super::arguments::GalleryArguments;
use super::metrics::shown_errors;
use super::progress::{Progress, spoken};
use super::reference::{
    ReferenceSource, TruthInputs, kept_reference, reference_picture, without_alpha,
};
use super::store::{key_of, write_whole};
use super::trade::version;
use crate::config::RenderConfig;
use crate::frame_loop::{StillRenderer, StillSettings};
use crate::march::MarchSettings;
use crate::quality::QualityTable;
use crate::render_command::Folders;
use crate::scene::presets;
use anyhow::{Context, ensure};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use serde::{Deserialize, Serialize};
use serde_json::json;
use skycell_protocol::{Camera, FrameSize, QualityPreset, RendererKind, Scene};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// JPEG quality of the pictures.
const JPEG_QUALITY: u8 = 90;
/// GPU memory for the cache: a picture of 1920×1080 at full resolution.
const CACHE_MEMORY_MIB: u32 = 2048;
/// Relative change of a ray's radiance that counts as none when the reference halves its steps: a tenth of an 8-bit step.
const TOLERANCE: f64 = 4e-4;
/// What `high` has to reach.
const FLIP_MAX: f64 = 0.015;

/// A sky and where it is seen from.
struct Shot {
    name: String,
    title: String,
    about: String,
    scene: Scene,
    camera: Camera,
}

/// What is kept of a finished picture.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Finished {
    /// Hash of all that it depends on.
    key: String,
    /// Mean FLIP of the small pair.
    flip: f64,
    /// Time by the clock.
    picture_s: f64,
    reference_s: f64,
}

/// Makes the gallery.
///
/// # Errors
/// For a folder that cannot be written, a name that is no picture's, a missing device.
pub(super) fn run(arguments: &GalleryArguments) -> anyhow::Result<()> {
    let begun = Instant::now();
    let shots = chosen_shots(arguments)?;
    let folder = &arguments.out;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("the folder {} cannot be made", folder.display()))?;
    let results_path = folder.join("gallery.json");
    let mut results: BTreeMap<String, Finished> = if arguments.fresh {
        BTreeMap::new()
    } else {
        std::fs::read(&results_path)
            .ok()
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_default()
    };
    let folders = Folders::of(None, arguments.noise_cache_dir.as_ref());
    let config = RenderConfig {
        cache_memory_mib: CACHE_MEMORY_MIB,
        ..RenderConfig::new(folders.noise.clone())
    };
    let mut still: Option<StillRenderer> = None;
    let work = shots.len() as f64;
    let mut progress = Progress::new(shots.len() as u64, work);
    for shot in &shots {
        progress.begin(&shot.name, 1.0);
        let key = key_of_shot(shot, arguments)?;
        let is_there = results.get(&shot.name).is_some_and(|kept| kept.key == key)
            && paths(&shot.name)
                .iter()
                .all(|path| folder.join(path).exists());
        if is_there {
            progress.done("is there");
            continue;
        }
        let scene = Arc::new(shot.scene.clone());
        let still = match &mut still {
            Some(still) => {
                still.set_scene(scene)?;
                still
            }
            None => still.insert(StillRenderer::new(config.clone(), scene, &[])?),
        };
        let finished = make(still, shot, key, arguments, &folders, &progress)?;
        let result = format!(
            "FLIP {:.4}, picture in {}, reference in {}",
            finished.flip,
            spoken(finished.picture_s),
            spoken(finished.reference_s)
        );
        results.insert(shot.name.clone(), finished);
        // After every picture: a run that is stopped goes on here.
        write_whole(&results_path, &serde_json::to_vec_pretty(&results)?)?;
        progress.done(&result);
    }
    progress.finish();
    write_whole(
        &folder.join("README.md"),
        page(&self::shots()?, &results, arguments).as_bytes(),
    )?;
    say(arguments, &shots, &results, begun.elapsed().as_secs_f64())
}

/// All pictures, or those that are asked for.
fn chosen_shots(arguments: &GalleryArguments) -> anyhow::Result<Vec<Shot>> {
    let all = shots()?;
    for name in &arguments.only {
        ensure!(
            all.iter().any(|shot| shot.name == *name),
            "--only names {name:?}; allowed are {}",
            all.iter()
                .map(|shot| shot.name.as_str())
                .collect::<Vec<_>>()
                .join(", ")
        );
    }
    let is_asked = |shot: &Shot| arguments.only.is_empty() || arguments.only.contains(&shot.name);
    Ok(all.into_iter().filter(is_asked).collect())
}

fn shots() -> anyhow::Result<Vec<Shot>> {
    let mut shots: Vec<Shot> = presets()
        .iter()
        .map(|preset| Shot {
            name: preset.name.clone(),
            title: preset.title.clone(),
            about: preset.about.clone(),
            scene: preset.scene.at_sky_s(0.0),
            camera: preset.camera,
        })
        .collect();
    for (name, title, about, sun, yaw_deg, pitch_deg) in [
        (
            "default-noon",
            "The default scene at noon",
            "The sun stands 70° high behind the viewer.",
            [180.0, 70.0],
            0.0,
            15.0,
        ),
        (
            "default-low-sun",
            "The default scene under a low sun",
            "The sun stands 5° high on the left.",
            [270.0, 5.0],
            0.0,
            12.0,
        ),
        (
            "default-against-the-sun",
            "The default scene against the sun",
            "The sun stands 14° high before the viewer.",
            [180.0, 14.0],
            180.0,
            14.0,
        ),
    ] {
        let [azimuth_deg, elevation_deg] = sun;
        let document = json!({"version": 1, "sun": {"azimuth_deg": azimuth_deg, "elevation_deg": elevation_deg}});
        shots.push(Shot {
            name: name.into(),
            title: title.into(),
            about: about.into(),
            scene: Scene::from_json(&document)?,
            camera: Camera::new([0.0, 2.0, 0.0], yaw_deg, pitch_deg, 60.0)?,
        });
    }
    Ok(shots)
}

/// How the large pictures are made. A ray for every pixel and nothing beyond them; `high` would take hours for each on a
/// software driver, and at this size the difference cannot be seen.
fn picture_settings(arguments: &GalleryArguments) -> StillSettings {
    StillSettings {
        renderer: RendererKind::ScreenSpace,
        march: MarchSettings {
            steps: arguments.picture_steps,
            ..MarchSettings::default()
        },
        samples: arguments.picture_samples,
        ..StillSettings::default()
    }
}

/// The quality `high`.
fn settings() -> StillSettings {
    let table = QualityTable::embedded();
    let high = table
        .point(table.pick_preset(QualityPreset::High).point)
        .settings;
    StillSettings {
        renderer: RendererKind::Cached,
        march: MarchSettings {
            steps: high.march_steps,
            sun_steps: high.sun_steps,
            octaves: high.octaves,
            ..MarchSettings::default()
        },
        samples: high.samples,
        mip_bias: high.mip_bias as f32,
        filter: high.frame_filter,
        ..StillSettings::default()
    }
}

/// The large picture and the two of the pair, under the gallery's folder.
fn paths(name: &str) -> [String; 3] {
    [
        format!("{name}.jpg"),
        format!("{name}.device.png"),
        format!("{name}.reference.png"),
    ]
}

fn key_of_shot(shot: &Shot, arguments: &GalleryArguments) -> anyhow::Result<String> {
    let [scene, camera, sizes] = [
        serde_json::to_string(&shot.scene.to_document())?,
        serde_json::to_string(&shot.camera)?,
        format!(
            "{:?} {:?} {}",
            arguments.size, arguments.pair_size, arguments.reference_grid
        ),
    ];
    Ok(key_of(&[
        &scene,
        &camera,
        &sizes,
        &serde_json::to_string(&[settings(), picture_settings(arguments)])?,
        &version(),
    ]))
}

fn make(
    still: &mut StillRenderer,
    shot: &Shot,
    key: String,
    arguments: &GalleryArguments,
    folders: &Folders,
    progress: &Progress,
) -> anyhow::Result<Finished> {
    let [large, device, truth] = paths(&shot.name).map(|path| arguments.out.join(path));
    let begun = Instant::now();
    let render = |still: &mut StillRenderer, size, settings: &StillSettings, from: f64, to: f64| {
        let picture = still.render_with(shot.camera, size, settings, |share| {
            progress.share(from + (to - from) * share);
        })?;
        image_of(without_alpha(&picture.display), size)
    };
    let picture = render(
        still,
        arguments.size,
        &picture_settings(arguments),
        0.0,
        0.4,
    )?;
    write_jpeg(&large, &picture)?;
    let picture_s = begun.elapsed().as_secs_f64();
    let small = render(still, arguments.pair_size, &settings(), 0.4, 0.5)?;
    small
        .save(&device)
        .with_context(|| format!("{} cannot be written", device.display()))?;
    let begun = Instant::now();
    let inputs = TruthInputs {
        scene: shot.scene.clone(),
        noise_dir: folders.noise.clone(),
        grids_dir: folders.grids.clone(),
        time_s: 0.0,
    };
    let source = ReferenceSource::Converged {
        grid: arguments.reference_grid,
        tolerance: TOLERANCE,
    };
    let kept_in = arguments
        .work
        .clone()
        .unwrap_or_else(|| folders.noise.join("gallery"));
    let size = arguments.pair_size;
    let reference = kept_reference(&kept_in, &[&key], &shot.scene, size, &source, || {
        reference_picture(still, &source, &inputs, shot.camera, size, |share| {
            progress.share(0.5 + 0.5 * share);
        })
    })?;
    reference
        .shown
        .save(&truth)
        .with_context(|| format!("{} cannot be written", truth.display()))?;
    Ok(Finished {
        key,
        flip: shown_errors(&reference.shown, &small)?.flip,
        picture_s,
        reference_s: begun.elapsed().as_secs_f64(),
    })
}

fn image_of(bytes: Vec<u8>, size: FrameSize) -> anyhow::Result<RgbImage> {
    RgbImage::from_raw(size.width(), size.height(), bytes).context("as many pixels as asked for")
}

fn write_jpeg(path: &Path, picture: &RgbImage) -> anyhow::Result<()> {
    let mut bytes = Vec::new();
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY))?;
    Ok(write_whole(path, &bytes)?)
}

/// The gallery in Markdown, with paths beside it.
fn page(
    shots: &[Shot],
    results: &BTreeMap<String, Finished>,
    arguments: &GalleryArguments,
) -> String {
    let (size, pair) = (arguments.size, arguments.pair_size);
    let mut text = format!(
        "# Gallery\n\nEvery preset and three views of the default scene at {}×{}, {} steps through a \
         layer and {} rays a pixel, as `skycell-server measure gallery` made them. Under each the same view at {}×{} twice: from \
         the cache at quality `high`, and by the reference renderer (f64 on the processor, steps halved until nothing changes, {} rays a pixel), with the mean FLIP \
         between the two.\n",
        size.width(),
        size.height(),
        arguments.picture_steps,
        arguments.picture_samples,
        pair.width(),
        pair.height(),
        arguments.reference_grid * arguments.reference_grid,
    );
    for shot in shots {
        let Some(finished) = results.get(&shot.name) else {
            continue;
        };
        let [large, device, truth] = paths(&shot.name);
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n## {}\n\n{} (`{}`)\n\n![{}]({large})\n\n| `high` | reference | FLIP |\n| --- | --- | --- |\n\
             | ![by the device]({device}) | ![by the reference]({truth}) | {:.4} |\n",
            shot.title, shot.about, shot.name, shot.title, finished.flip,
        );
    }
    text
}

fn say(
    arguments: &GalleryArguments,
    shots: &[Shot],
    results: &BTreeMap<String, Finished>,
    wall_s: f64,
) -> anyhow::Result<()> {
    let of_shots = || {
        shots
            .iter()
            .filter_map(|shot| Some((shot, results.get(&shot.name)?)))
    };
    if arguments.json {
        let lines: Vec<_> = of_shots()
            .map(|(shot, finished)| json!({"name": shot.name, "flip": finished.flip}))
            .collect();
        let report = json!({"pictures": lines, "flip_max": FLIP_MAX, "wall_s": wall_s});
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    for (shot, finished) in of_shots() {
        let verdict = if finished.flip <= FLIP_MAX {
            ""
        } else {
            "  above 0.015"
        };
        println!("{:<26}FLIP {:.4}{verdict}", shot.name, finished.flip);
    }
    println!(
        "{} in {}",
        arguments.out.join("README.md").display(),
        spoken(wall_s)
    );
    Ok(())
}

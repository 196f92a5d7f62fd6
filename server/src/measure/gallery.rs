//! `skycell-server measure gallery`: a picture of every preset, each beside the same scene by the reference renderer.

use super::arguments::GalleryArguments;
use super::metrics::shown_errors;
use super::progress::{Progress, spoken};
use super::reference::{
    ReferenceSource, TruthInputs, kept_reference, reference_picture, without_alpha,
};
use super::store::{key_of, write_whole};
use super::trade::version;
use crate::frame_loop::{RayPicture, StillRay, StillRenderer, StillSettings};
use crate::march::{CellFrame, MarchSettings};
use crate::quality::QualityTable;
use crate::render_command::Folders;
use crate::scene::presets;
use anyhow::{Context, ensure};
use glam::DVec3;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use serde::{Deserialize, Serialize};
use serde_json::json;
use skycell_protocol::{Camera, Codec, FrameSize, QualityPreset, RendererKind, Scene};
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

/// What is kept of a sky.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Finished {
    picture: Option<FinishedPicture>,
    pair: Option<FinishedPair>,
}

/// What is kept of a large picture.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct FinishedPicture {
    /// Hash of all that it depends on.
    key: String,
    steps: u32,
    samples: u32,
    /// Time by the clock.
    wall_s: f64,
}

/// What is kept of a small pair.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct FinishedPair {
    /// Hash of all that it depends on.
    key: String,
    /// Mean FLIP.
    flip: f64,
    size: [u32; 2],
    /// Time by the clock.
    wall_s: f64,
}

/// What is made. All pictures come before the first pair: a pair may take many times as long.
#[derive(Clone, Copy)]
enum Part {
    Picture,
    Pair,
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
    let config = folders.render_config(CACHE_MEMORY_MIB);
    let mut still: Option<StillRenderer> = None;
    let parts: &[Part] = if arguments.without_pairs {
        &[Part::Picture]
    } else {
        &[Part::Picture, Part::Pair]
    };
    let points = shots.len() * parts.len();
    let mut progress = Progress::new(points as u64, points as f64);
    for (part, shot) in parts
        .iter()
        .flat_map(|part| shots.iter().map(move |shot| (*part, shot)))
    {
        progress.begin(&shot.name, 1.0);
        let key = key_of_part(part, shot, arguments)?;
        let kept = results.entry(shot.name.clone()).or_default();
        if is_there(part, kept, &key, folder, &shot.name) {
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
        let result = match part {
            Part::Picture => {
                let made = make_picture(still, shot, key, arguments, &progress)?;
                let result = format!("picture in {}", spoken(made.wall_s));
                kept.picture = Some(made);
                result
            }
            Part::Pair => {
                let made = make_pair(still, shot, key, arguments, &folders, &progress)?;
                let result = format!("FLIP {:.4} in {}", made.flip, spoken(made.wall_s));
                kept.pair = Some(made);
                result
            }
        };
        // After every part: a run that is stopped goes on here, and its page shows what there is.
        write_whole(&results_path, &serde_json::to_vec_pretty(&results)?)?;
        write_whole(
            &folder.join("README.md"),
            page(&self::shots()?, &results, arguments).as_bytes(),
        )?;
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
            25.0,
        ),
        (
            "default-low-sun",
            "The default scene under a low sun",
            "The sun stands 5° high on the left.",
            [270.0, 5.0],
            0.0,
            25.0,
        ),
        (
            "default-against-the-sun",
            "The default scene against the sun",
            "The sun stands 14° high before the viewer.",
            [180.0, 14.0],
            180.0,
            25.0,
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
        codec: Codec::Jpeg,
        ..StillSettings::default()
    }
}

/// The quality `high`, along rays: what a texel of the cache holds.
fn settings() -> StillSettings {
    let table = QualityTable::embedded();
    let high = table
        .point(table.pick_preset(QualityPreset::High).point)
        .settings;
    StillSettings {
        renderer: RendererKind::ScreenSpace,
        march: MarchSettings {
            steps: high.march_steps,
            sun_steps: high.sun_steps,
            octaves: high.octaves,
            ..MarchSettings::default()
        },
        samples: high.samples,
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

fn key_of_part(part: Part, shot: &Shot, arguments: &GalleryArguments) -> anyhow::Result<String> {
    let (settings, size) = match part {
        Part::Picture => (picture_settings(arguments), format!("{:?}", arguments.size)),
        Part::Pair => (settings(), format!("{:?}", arguments.pair_size)),
    };
    Ok(key_of(&[
        &serde_json::to_string(&shot.scene.to_document())?,
        &serde_json::to_string(&shot.camera)?,
        &size,
        &serde_json::to_string(&settings)?,
        &version(),
    ]))
}

/// Whether a part was made as it is asked for, and its files are there.
fn is_there(part: Part, kept: &Finished, key: &str, folder: &Path, name: &str) -> bool {
    let [large, device, truth] = paths(name).map(|path| folder.join(path));
    match part {
        Part::Picture => {
            kept.picture.as_ref().is_some_and(|made| made.key == key) && large.exists()
        }
        Part::Pair => {
            kept.pair.as_ref().is_some_and(|made| made.key == key)
                && device.exists()
                && truth.exists()
        }
    }
}

fn render(
    still: &mut StillRenderer,
    shot: &Shot,
    size: FrameSize,
    settings: &StillSettings,
    progress: impl FnMut(f64),
) -> anyhow::Result<RgbImage> {
    let picture = still.render_with(shot.camera, size, settings, progress)?;
    image_of(without_alpha(&picture.display), size)
}

fn make_picture(
    still: &mut StillRenderer,
    shot: &Shot,
    key: String,
    arguments: &GalleryArguments,
    progress: &Progress,
) -> anyhow::Result<FinishedPicture> {
    let [large, _, _] = paths(&shot.name).map(|path| arguments.out.join(path));
    let begun = Instant::now();
    let settings = picture_settings(arguments);
    let picture = render(still, shot, arguments.size, &settings, |share| {
        progress.share(share);
    })?;
    write_jpeg(&large, &picture)?;
    Ok(FinishedPicture {
        key,
        steps: arguments.picture_steps,
        samples: arguments.picture_samples,
        wall_s: begun.elapsed().as_secs_f64(),
    })
}

fn make_pair(
    still: &mut StillRenderer,
    shot: &Shot,
    key: String,
    arguments: &GalleryArguments,
    folders: &Folders,
    progress: &Progress,
) -> anyhow::Result<FinishedPair> {
    let [_, device, truth] = paths(&shot.name).map(|path| arguments.out.join(path));
    let size = arguments.pair_size;
    let begun = Instant::now();
    // Both march the ray through the middle of each pixel. A small picture's edges depend on where in a pixel its rays
    // stand more than on who marches them.
    let list = middle_rays(&shot.camera, size, &shot.scene);
    let found = still.render_rays(&list, &settings(), |share| progress.share(0.2 * share))?;
    let small = image_of(without_alpha(&found.picture.display), size)?;
    small
        .save(&device)
        .with_context(|| format!("{} cannot be written", device.display()))?;
    let inputs = TruthInputs {
        scene: shot.scene.clone(),
        noise_dir: folders.noise.clone(),
        grids_dir: folders.grids.clone(),
        time_s: 0.0,
    };
    let source = ReferenceSource::Converged {
        grid: 1,
        tolerance: TOLERANCE,
    };
    let kept_in = arguments
        .work
        .clone()
        .unwrap_or_else(|| folders.noise.join("gallery"));
    let reference = kept_reference(&kept_in, &[&key], &shot.scene, size, &source, || {
        reference_picture(still, &source, &inputs, shot.camera, size, |share| {
            progress.share(0.2 + 0.8 * share);
        })
    })?;
    reference
        .shown
        .save(&truth)
        .with_context(|| format!("{} cannot be written", truth.display()))?;
    Ok(FinishedPair {
        key,
        flip: shown_errors(&reference.shown, &small)?.flip,
        size: [size.width(), size.height()],
        wall_s: begun.elapsed().as_secs_f64(),
    })
}

/// The rays through the middles of pixels.
fn middle_rays(camera: &Camera, size: FrameSize, scene: &Scene) -> RayPicture {
    let position_m = DVec3::from_array(camera.position_m());
    let frame_m = position_m.with_y(0.0);
    let frame = CellFrame::at(frame_m, scene.planet().radius_m());
    let [width, height] = [size.width(), size.height()].map(f64::from);
    let half = (0.5 * camera.vertical_fov_deg().to_radians()).tan();
    let rays = (0..size.pixels()).map(|index| {
        let right = (f64::from(index % size.width()) + 0.5) / width * 2.0 - 1.0;
        let up = 1.0 - (f64::from(index / size.width()) + 0.5) / height * 2.0;
        let direction = camera.direction()
            + camera.right() * (right * half * width / height)
            + camera.up() * (up * half);
        StillRay {
            origin_m: frame.from_world(position_m),
            direction: direction.normalize(),
        }
    });
    RayPicture {
        frame_m,
        rays: rays.collect(),
        size,
        pixel_m: [DVec3::ZERO; 2],
    }
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
    let mut text = format!(
        "# Gallery\n\nEvery preset and three views of the default scene at {}×{}, as `skycell-server measure gallery` made them. \
         The large pictures have fewer steps and rays than quality `high`, as is told under each: that would take hours for each \
         on a software driver. Under them, where it was made, the same view in small twice: the ray through the middle of each \
         pixel, marched by the device at quality `high`, and by the reference renderer (f64 on the processor, steps halved \
         until nothing changes), with the mean FLIP between the two.\n",
        arguments.size.width(),
        arguments.size.height(),
    );
    for shot in shots {
        let Some(finished) = results.get(&shot.name) else {
            continue;
        };
        let [large, device, truth] = paths(&shot.name);
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n## {}\n\n{} (`{}`)\n",
            shot.title, shot.about, shot.name
        );
        if let Some(picture) = &finished.picture {
            let _ = write!(
                text,
                "\n![{}]({large})\n\n{} steps through a layer, {} rays a pixel.\n",
                shot.title, picture.steps, picture.samples,
            );
        }
        if let Some(pair) = &finished.pair {
            let [width, height] = pair.size;
            let _ = write!(
                text,
                "\n| `high`, {width}×{height} | reference | FLIP |\n| --- | --- | --- |\n\
                 | ![by the device]({device}) | ![by the reference]({truth}) | {:.4} |\n",
                pair.flip,
            );
        }
    }
    text
}

fn say(
    arguments: &GalleryArguments,
    shots: &[Shot],
    results: &BTreeMap<String, Finished>,
    wall_s: f64,
) -> anyhow::Result<()> {
    let flips = || {
        shots.iter().filter_map(|shot| {
            let pair = results.get(&shot.name)?.pair.as_ref()?;
            Some((&shot.name, pair.flip))
        })
    };
    if arguments.json {
        let lines: Vec<_> = flips()
            .map(|(name, flip)| json!({"name": name, "flip": flip}))
            .collect();
        let report = json!({"pictures": lines, "flip_max": FLIP_MAX, "wall_s": wall_s});
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    for (name, flip) in flips() {
        let verdict = if flip <= FLIP_MAX {
            String::new()
        } else {
            format!("  above {FLIP_MAX}")
        };
        println!("{name:<26}FLIP {flip:.4}{verdict}");
    }
    println!(
        "{} in {}",
        arguments.out.join("README.md").display(),
        spoken(wall_s)
    );
    Ok(())
}

//! Pictures and rays by the device.

use super::arguments::{Approximation, Chosen, Interpolation, RenderArguments, StillKind};
use super::rays::{RayLine, WorldRay};
use super::{Folders, Output, Target, processor, progress_bar, triple, write_exr, write_rays};
use crate::config::PlacedCell;
use crate::frame_loop::{
    LayerFigures, RayFigures, RayPicture, StillPicture, StillRay, StillRenderer, StillSettings,
};
use crate::march::{CellFrame, MarchSettings, WindowPlan};
use anyhow::{Context, bail, ensure};
use glam::DVec3;
use serde_json::json;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene, Show, Stereo};
use skycell_reference::phase::one_minus_mu;
use skycell_reference::{Ray, RayResult, World};
use std::sync::Arc;

/// GPU memory for the cache.
const CACHE_MEMORY_MIB: u32 = 2048;

fn settings(
    arguments: &RenderArguments,
    chosen: &Chosen,
    output: Output,
) -> anyhow::Result<StillSettings> {
    if !(0.0..=4.0).contains(&arguments.mip_bias) {
        bail!("--mip-bias is {}; allowed is 0 to 4", arguments.mip_bias);
    }
    if ![1, 2, 4].contains(&arguments.resolution_divisor) {
        bail!(
            "--resolution-divisor is {}; allowed are 1, 2 and 4",
            arguments.resolution_divisor
        );
    }
    let samples = arguments.samples.unwrap_or(8);
    ensure!(
        (1..=16).contains(&samples),
        "--samples is {samples}; allowed is 1 to 16 on a device"
    );
    ensure!(
        arguments.until_error.is_none(),
        "--until-error is the path tracer's"
    );
    let octaves = match processor::orders(&arguments.orders)? {
        None => None,
        Some(1) => Some(1),
        Some(other) => bail!(
            "--orders is {other}; the marching renderers know 1 (single scattering) and all (the scene's octaves)"
        ),
    };
    let interpolation = arguments.interpolation.unwrap_or(match output {
        Output::Png => Interpolation::Sampler,
        Output::Exr | Output::Json => Interpolation::Exact,
    });
    ensure!(
        arguments.show == Show::Picture || output == Output::Png,
        "--show {} makes colours; --out must end in .png",
        arguments.show.name()
    );
    let stereo = arguments.stereo.map(Stereo::new).transpose();
    let jitter = chosen.has(Approximation::Jitter);
    Ok(StillSettings {
        renderer: match arguments.renderer {
            StillKind::Cached => RendererKind::Cached,
            _ => RendererKind::ScreenSpace,
        },
        march: chosen.of_march(MarchSettings {
            steps: arguments.steps.unwrap_or(128),
            sun_steps: arguments.sun_steps,
            sun_depth: arguments.sun_depth.map(Into::into),
            sun_volume: arguments.sun_volume.unwrap_or_default(),
            octaves,
            exact_interpolation: interpolation == Interpolation::Exact,
            count_reads: arguments.json,
            ..MarchSettings::default()
        }),
        // Samples in one and the same place are one sample; texels always take theirs beside each other.
        samples: if jitter || arguments.renderer == StillKind::Cached {
            samples as u32
        } else {
            1
        },
        window: (arguments.window.is_some() || arguments.resolution_divisor > 1).then_some(
            WindowPlan {
                frames: arguments.window.unwrap_or(samples as u32),
                divisor: arguments.resolution_divisor,
                depth_segments: arguments.depth_segments,
                refinement: arguments.refinement,
            },
        ),
        frames: arguments
            .frames
            .or(arguments.window)
            .unwrap_or(samples as u32),
        turn_deg_per_frame: arguments.turn_deg_per_frame,
        mip_bias: arguments.mip_bias,
        parallax_steps: arguments.parallax_steps,
        proxies: arguments.proxies,
        slabs: arguments.slabs,
        bands: arguments.bands,
        band_ends: arguments.band_ends,
        show: arguments.show,
        stereo: stereo.context("--stereo")?,
        ..StillSettings::default()
    })
}

pub(super) fn run(
    arguments: &RenderArguments,
    scene: Scene,
    folders: &Folders,
    chosen: &Chosen,
    target: Target,
    output: Output,
) -> anyhow::Result<()> {
    let settings = settings(arguments, chosen, output)?;
    let placed: Vec<PlacedCell> = match &arguments.reference_m {
        Some(reference) => vec![PlacedCell {
            name: "reference".into(),
            center_m: triple(reference)?,
            radius_m: 1.0e6,
        }],
        None => Vec::new(),
    };
    let config = folders.render_config(CACHE_MEMORY_MIB);
    let scene = Arc::new(scene);
    let mut still = StillRenderer::new(config, scene.clone(), &placed)?;
    still.advance_time(arguments.time_s);
    let bar = progress_bar()?;
    let progress = |share: f64| bar.set_position((share * 1000.0) as u64);
    let picture = match &target {
        Target::Camera {
            camera,
            size,
            orthographic_height_m: None,
        } => {
            let size = size.for_eyes(settings.stereo)?;
            still.render_with(*camera, size, &settings, progress)?
        }
        Target::Camera {
            camera,
            size,
            orthographic_height_m: Some(height_m),
        } => {
            ensure!(
                arguments.renderer == StillKind::ScreenSpace,
                "--orthographic-height-m needs --renderer screen-space, reference or path-traced"
            );
            let list = orthographic(&scene, camera, *size, *height_m);
            still.render_rays(&list, &settings, progress)?.picture
        }
        Target::Rays(rays) => {
            ensure!(
                arguments.renderer == StillKind::ScreenSpace,
                "--rays needs --renderer screen-space, reference or path-traced"
            );
            let list = listed(&scene, rays)?;
            let figures = still.render_rays(&list, &settings, progress)?;
            let world = processor::world(&scene, arguments, chosen, folders, rays[0].origin_m)?;
            let lines = rays
                .iter()
                .enumerate()
                .map(|(index, ray)| {
                    let result = result_of(&world, &list.rays[index], &figures, index);
                    RayLine::new(ray, &result, false)
                })
                .collect();
            let told = json!({"march": settings.march, "samples": settings.samples, "time_s": arguments.time_s,
                "adapter": still.adapter()});
            write_rays(&arguments.out, "screen-space", told, lines)?;
            figures.picture
        }
    };
    bar.finish_and_clear();
    let figures = picture.figures;
    match output {
        Output::Json => {}
        Output::Exr => {
            let rgb = picture
                .linear
                .chunks_exact(4)
                .flat_map(|p| [p[0], p[1], p[2]]);
            write_exr(&arguments.out, picture.size, rgb.collect())?;
        }
        Output::Png => write_png(arguments, &picture, &scene, chosen)?,
    }
    let totals = still.totals();
    if arguments.json {
        let [cache_ns, composite_ns, screen_space_ns, ..] = still.gpu_times_ns();
        let told = json!({
            "out": arguments.out, "adapter": still.adapter(), "wall_s": figures.wall_s,
            "marches": figures.marches, "sun_volume_evaluations_of_picture": figures.sun_volume_evaluations, "texture_reads": figures.texture_reads,
            "density_evaluations": figures.density_evaluations,
            "texels_updated": totals.texels_updated, "tiles_updated": totals.tiles_updated,
            "screen_space_marches": totals.screen_space_marches,
            "sun_volume_evaluations": totals.sun_volume_evaluations, "sun_volume_columns": totals.sun_volume_columns,
            "sun_volume_bytes": totals.sun_volume_bytes, "gpu_sun_volume_ns": totals.gpu_sun_volume_ns, "cache_bytes": totals.cache_bytes,
            "light_shaft_evaluations": totals.light_shaft_evaluations, "light_shaft_bytes": totals.light_shaft_bytes,
            "gpu_light_shaft_ns": totals.gpu_light_shaft_ns,
            "gpu_cache_ns": cache_ns, "gpu_composite_ns": composite_ns, "gpu_screen_space_ns": screen_space_ns,
            "device": still.inventory(), "reads": still.reads()?,
        });
        println!("{told}");
    } else {
        println!(
            "{} in {:.1} s on {}: {} rays, GPU time {:.0} ms",
            arguments.out.display(),
            figures.wall_s,
            still.adapter(),
            figures.marches,
            figures.gpu_ns.unwrap_or(0) as f64 / 1e6,
        );
    }
    Ok(())
}

fn write_png(
    arguments: &RenderArguments,
    picture: &StillPicture,
    scene: &Scene,
    chosen: &Chosen,
) -> anyhow::Result<()> {
    let (width, height) = (picture.size.width(), picture.size.height());
    let eye_width = arguments.width;
    let (tone_map, dither) = (
        chosen.has(Approximation::ToneMap),
        chosen.has(Approximation::Dither),
    );
    let rgb: Vec<u8> = if (tone_map && dither) || arguments.show != Show::Picture {
        // As the device shows it.
        let pixels = picture.display.chunks_exact(4);
        pixels.flat_map(|p| [p[0], p[1], p[2]]).collect()
    } else {
        let display = super::Display {
            exposure: super::EXPOSURE_AT_ZERO_EV * scene.exposure_ev().exp2(),
            curve: scene.tone().curve(),
            tone_map,
            dither,
        };
        (0..)
            .zip(picture.linear.chunks_exact(4))
            .flat_map(|(index, p)| {
                let radiance = [p[0], p[1], p[2]].map(f64::from);
                // Both eyes have the same pattern, as the device gives them.
                display.bytes(radiance, index % width % eye_width, index / width)
            })
            .collect()
    };
    image::RgbImage::from_raw(width, height, rgb)
        .context("the device gave a picture of another size")?
        .save(&arguments.out)
        .with_context(|| format!("{} cannot be written", arguments.out.display()))
}

/// The rays of an orthographic camera, in the frame under it.
fn orthographic(scene: &Scene, camera: &Camera, size: FrameSize, height_m: f64) -> RayPicture {
    let position_m = DVec3::from_array(camera.position_m());
    let frame = CellFrame::at(position_m, scene.planet().radius_m());
    let middle = frame.from_world(position_m);
    let pixel_m = height_m / f64::from(size.height());
    let (across, down) = (camera.right() * pixel_m, camera.up() * -pixel_m);
    let half = |n: u32| f64::from(n) / 2.0 - 0.5;
    let rays = (0..size.height())
        .flat_map(|row| (0..size.width()).map(move |column| (column, row)))
        .map(|(column, row)| StillRay {
            origin_m: middle
                + across * (f64::from(column) - half(size.width()))
                + down * (f64::from(row) - half(size.height())),
            direction: camera.direction(),
        })
        .collect();
    RayPicture {
        frame_m: position_m,
        rays,
        size,
        pixel_m: [across, down],
    }
}

/// Given rays as the pixels of a picture that is as wide as may be; the last ray fills it up.
fn listed(scene: &Scene, rays: &[WorldRay]) -> anyhow::Result<RayPicture> {
    const WIDTH: u32 = 1024;
    let frame_m = rays[0].origin_m;
    let frame = CellFrame::at(frame_m, scene.planet().radius_m());
    let width = (rays.len() as u32).min(WIDTH);
    let size = FrameSize::new(width, (rays.len() as u32).div_ceil(width))?;
    let mut list: Vec<StillRay> = rays
        .iter()
        .map(|ray| StillRay {
            origin_m: frame.from_world(ray.origin_m),
            direction: ray.direction,
        })
        .collect();
    list.resize(size.pixels() as usize, list[list.len() - 1]);
    Ok(RayPicture {
        frame_m,
        rays: list,
        size,
        pixel_m: [DVec3::ZERO; 2],
    })
}

/// A ray's numbers from what the device gathered: its radiance as composited there, the parts of it summed up here.
fn result_of(world: &World, ray: &StillRay, figures: &RayFigures, index: usize) -> RayResult {
    let light = world.light();
    let x = one_minus_mu(ray.direction, light.sun_direction);
    let reference_ray = Ray {
        origin_m: ray.origin_m,
        direction: ray.direction,
    };
    let background = light.background(&reference_ray, ray.direction);
    let layers: Vec<(&LayerFigures, f64, DVec3, f64)> = figures
        .layers
        .iter()
        .zip(world.layers())
        .map(|(found, layer)| {
            let air = layer.air_extinction_per_m;
            let phase_per_sr = layer.phase.over_disc_per_sr(x, light.sun_one_minus_mu);
            (&found[index], layer.proxy_altitude_m, air, phase_per_sr)
        })
        .collect();
    let eye_m = world.globe().altitude_m(ray.origin_m);
    // The nearest first: layers below the eye from the highest down, then those above it.
    let below = layers
        .iter()
        .rev()
        .filter(|(_, proxy_m, ..)| *proxy_m < eye_m);
    let above = layers.iter().filter(|(_, proxy_m, ..)| *proxy_m >= eye_m);
    let mut result = RayResult {
        radiance: DVec3::from_array(figures.radiance[index].map(f64::from)),
        transmittance: 1.0,
        ..RayResult::default()
    };
    for (found, _, air_extinction_per_m, phase_per_sr) in below.chain(above) {
        let transmittance = f64::from(found.transmittance);
        let distance_m = f64::from(found.opacity_distance_m) / (1.0 - transmittance + 1e-3);
        let kept = if world.settings().approximations.aerial_perspective {
            background
                .haze(light, distance_m, *air_extinction_per_m)
                .kept
        } else {
            DVec3::ONE
        };
        let seen_m = world.globe().altitude_m(reference_ray.at(distance_m));
        let lit_once = light.sun_at(seen_m) * (*phase_per_sr * f64::from(found.single));
        result.single_scattered += result.transmittance * lit_once * kept;
        result.transmittance *= transmittance;
        result.optical_depth += f64::from(found.optical_depth);
        result.steps += found.steps as u64;
    }
    result
}

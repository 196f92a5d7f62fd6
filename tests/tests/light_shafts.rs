//! The shadow of clouds in the air, against f64 integrals and closed forms.

use anyhow::ensure;
use glam::DVec3;
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_reference::air::{Air, Toward};
use skycell_reference::march::{shaded_background, sunlit_share};
use skycell_reference::{Approximations, Ray, World};
use skycell_server::atmosphere::ShaftShares;
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{RayPicture, StillRay, StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use skycell_server::truth::reference_world;
use skycell_shaders::SourceEdit;
use skycell_tests::accuracy::distance;
use skycell_tests::numbers::Random;
use skycell_tests::picture::without_alpha;
use skycell_tests::server::target_dir;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

/// Of the air, for scenes that say nothing else: hazy, so that most of its light is scattered below the clouds.
const AEROSOL: f64 = 0.3;

fn document(elevation_deg: f64, layers: Value) -> Value {
    json!({"version": 1, "layers": layers, "wind": {"speed_m_per_s": 0},
        "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 60},
        "atmosphere": {"model": "physical", "aerosol_optical_depth": AEROSOL, "light_shafts": true}})
}

fn scene(document: &Value) -> Arc<Scene> {
    Arc::new(Scene::from_json(document).expect("a scene"))
}

fn still(scene: &Arc<Scene>) -> StillRenderer {
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    StillRenderer::new(RenderConfig::new(noise), scene.clone(), &[]).expect("a device")
}

fn world(scene: &Scene) -> World {
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    let all = Approximations::ALL;
    reference_world(scene, &noise, Path::new("."), 0.0, DVec3::ZERO, all).expect("a world")
}

/// Radiance of rays from a point over the frame's origin.
fn radiance(still: &mut StillRenderer, rays: &[Ray]) -> Vec<DVec3> {
    let list = RayPicture {
        frame_m: DVec3::ZERO,
        size: FrameSize::new(rays.len() as u32, 1).expect("a size"),
        pixel_m: [DVec3::ZERO; 2],
        rays: rays
            .iter()
            .map(|ray| StillRay {
                origin_m: ray.origin_m,
                direction: ray.direction,
            })
            .collect(),
    };
    // A sampler's weights have few bits, and along a beam through thin cloud what they lack adds up.
    let settings = StillSettings {
        march: MarchSettings {
            exact_interpolation: true,
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    };
    still
        .render_rays(&list, &settings, |_| {})
        .expect("a picture")
        .radiance
        .into_iter()
        .map(|[r, g, b]| DVec3::new(r.into(), g.into(), b.into()))
        .collect()
}

/// The table that an eye at an altitude sees by.
fn table(still: &mut StillRenderer, altitude_m: f64) -> ShaftShares {
    let ray = Ray::new(DVec3::Y * altitude_m, DVec3::X).expect("a ray");
    radiance(still, &[ray]);
    still.light_shafts().expect("a device").expect("a table")
}

/// Directions that are even over the sphere, as f32 tells them.
fn directions(count: usize, lowest: f64) -> Vec<DVec3> {
    let mut random = Random(11);
    (0..count)
        .map(|_| {
            let y = random.between(lowest, 1.0);
            let (sin, cos) = random.between(0.0, 2.0 * PI).sin_cos();
            let across = (1.0 - y * y).max(0.0).sqrt();
            DVec3::new(across * cos, y, across * sin)
                .as_vec3()
                .as_dvec3()
                .normalize()
        })
        .collect()
}

fn toward(world: &World, ray: &Ray) -> (f64, Toward, bool) {
    let up = world.globe().up(ray.origin_m);
    (
        world.globe().altitude_m(ray.origin_m),
        Toward::new(ray.direction, up, world.light().sun_direction),
        world.globe().ground_m(ray).is_some(),
    )
}

/// By f64: what is left of the light of the air as far as each of some distances.
fn shares(world: &World, ray: &Ray, distances_m: &[f64]) -> Vec<DVec3> {
    let air: &Air = world.light().air().expect("air");
    let (altitude_m, toward, on_ground) = toward(world, ray);
    let sunlit = |distance_m: f64| sunlit_share(world, ray.at(distance_m));
    let shaded = air.along_shaded(altitude_m, toward, on_ground, sunlit);
    let lit = air.along_shaded(altitude_m, toward, on_ground, |_| 1.0);
    distances_m
        .iter()
        .map(|d| shaded.until(*d).scattered_per_sr / lit.until(*d).scattered_per_sr)
        .collect()
}

/// Absolute errors of shares, over directions, distances and channels, smallest first.
fn share_errors(
    still: &mut StillRenderer,
    document: &Value,
    altitude_m: f64,
    (count, lowest): (usize, f64),
) -> Vec<f64> {
    let scene = scene(document);
    still.set_scene(scene.clone()).expect("a scene");
    let table = table(still, altitude_m);
    let world = world(&scene);
    let directions = directions(count, lowest);
    let errors_of = |directions: &[DVec3]| -> Vec<f64> {
        let mut errors = Vec::new();
        for direction in directions {
            let ray = Ray::new(DVec3::Y * altitude_m, *direction).expect("a ray");
            let end_m = world.globe().ground_m(&ray).unwrap_or(f64::INFINITY);
            let distances: Vec<f64> = [500.0, 2_000.0, 6_000.0, 20_000.0, f64::INFINITY]
                .into_iter()
                .filter(|d| *d <= end_m)
                .collect();
            for (distance_m, truth) in distances.iter().zip(shares(&world, &ray, &distances)) {
                let off = (table.at(*direction, *distance_m) - truth).abs();
                errors.extend(off.to_array());
            }
        }
        errors
    };
    let (first, second) = directions.split_at(count / 2);
    let mut errors = std::thread::scope(|scope| {
        let other = scope.spawn(|| errors_of(second));
        let mut errors = errors_of(first);
        errors.extend(other.join().expect("no panic"));
        errors
    });
    errors.sort_by(f64::total_cmp);
    errors
}

fn percentile(errors: &[f64], share: f64) -> f64 {
    errors[((errors.len() - 1) as f64 * share) as usize]
}

fn box_of_cloud(name: &str, center_m: [f64; 3], size_m: [f64; 3]) -> Value {
    let (base, top) = (center_m[1] - 0.5 * size_m[1], center_m[1] + 0.5 * size_m[1]);
    json!({"name": name, "base_altitude_m": base, "top_altitude_m": top, "extinction_per_m": 0.02,
        "density": {"model": "homogeneous", "shape": {"form": "box", "center_m": center_m, "size_m": size_m}}})
}

/// Two slabs of finite width at different altitudes: within 42 km of every eye, where shadow is as the f64 twin has it. The
/// twin knows no reach, the table fades shadow out as far as 60 km.
fn boxes() -> Value {
    json!([
        box_of_cloud("near", [900.0, 1500.0, -700.0], [2500.0, 400.0, 3000.0]),
        box_of_cloud("far", [6000.0, 3200.0, -3000.0], [5000.0, 500.0, 4000.0]),
    ])
}

fn broken() -> Value {
    json!([{"family": "cumulus", "density": {"coverage": 0.45}}])
}

#[test]
fn shares_are_those_of_the_f64_integral() {
    let mut still = still(&scene(&document(35.0, boxes())));
    // Median, 95th percentile and largest error: absolute, of a share of 0 to 1.
    for (what, elevation_deg, layers, [altitude_m, lowest], count, bounds) in [
        (
            "boxes, high sun",
            35.0,
            boxes(),
            [2.0, -0.02],
            120,
            [0.002, 0.006, 0.03],
        ),
        (
            "boxes, low sun",
            6.0,
            boxes(),
            [2.0, -0.02],
            120,
            [0.002, 0.012, 0.08],
        ),
        (
            "boxes, from above one",
            35.0,
            boxes(),
            [1_900.0, -0.8],
            80,
            [0.002, 0.02, 0.08],
        ),
        (
            "broken cumulus",
            35.0,
            broken(),
            [2.0, -0.02],
            24,
            [0.002, 0.02, 0.06],
        ),
    ] {
        let document = document(elevation_deg, layers);
        let errors = share_errors(&mut still, &document, altitude_m, (count, lowest));
        let found = [0.5, 0.95, 1.0].map(|share| percentile(&errors, share));
        println!(
            "{what}: p50 {:.4} p95 {:.4} worst {:.4}",
            found[0], found[1], found[2]
        );
        for (found, bound) in found.iter().zip(bounds) {
            assert!(*found <= bound, "{what}: {found} over {bound}");
        }
    }
}

/// A layer that is everywhere the same, over everybody.
fn slab(extinction_per_m: f64) -> Value {
    json!([{"base_altitude_m": 2000, "top_altitude_m": 2500, "extinction_per_m": extinction_per_m,
        "density": {"model": "homogeneous"}}])
}

/// Largest difference between the table and the closed form of air under a slab.
fn off_under_a_slab(still: &mut StillRenderer, extinction_per_m: f64, elevation_deg: f64) -> f64 {
    let scene = scene(&document(elevation_deg, slab(extinction_per_m)));
    still.set_scene(scene.clone()).expect("a scene");
    let table = table(still, 2.0);
    let world = world(&scene);
    let air = world.light().air().expect("air");
    let mut worst = 0.0f64;
    for direction in directions(200, 0.0) {
        // Air that lies under the slab, at most 3 km away: the sun's way through the slab is the same everywhere there.
        let distance_m = (1_500.0 / direction.y.max(1e-6)).min(3_000.0);
        let ray = Ray::new(DVec3::Y * 2.0, direction).expect("a ray");
        let (altitude_m, toward, on_ground) = toward(&world, &ray);
        // Of a sphere: the chord between both shells along the sun's direction.
        let r = 6.36e6;
        let leg = |h: f64| {
            let b = (r + 2.0) * toward.mu_sun;
            let c = (2.0 - h) * (2.0 + h + 2.0 * r);
            (b * b - c).sqrt() - b
        };
        let kept = (-extinction_per_m * (leg(2_500.0) - leg(2_000.0))).exp();
        let until = |share: f64| {
            air.along_shaded(altitude_m, toward, on_ground, |_| share)
                .until(distance_m)
                .scattered_per_sr
        };
        let truth = until(kept) / until(1.0);
        worst = worst.max(
            (table.at(direction, distance_m) - truth)
                .abs()
                .max_element(),
        );
    }
    worst
}

/// The share along rays whose air lies as evenly under the slab as the interpolation of its table, a half float's digits and
/// the change of the sun's way over 3 km allow.
const SLAB_BOUND: f64 = 0.006;

#[test]
fn under_a_slab_over_everything_single_scattering_is_dimmed_by_its_transmittance() {
    let mut still = still(&scene(&document(35.0, slab(1e-3))));
    for (extinction_per_m, elevation_deg) in [
        (1e-8, 50.0),
        (1e-3, 30.0),
        (1e-3, 90.0),
        (4e-3, 55.0),
        (1e3, 40.0),
    ] {
        let off = off_under_a_slab(&mut still, extinction_per_m, elevation_deg);
        println!("{extinction_per_m} per m, sun {elevation_deg}°: {off:.5}");
        assert!(
            off < SLAB_BOUND,
            "{extinction_per_m} per m, sun {elevation_deg}°: {off}"
        );
    }
}

/// Shares of all the air below an eye at 400 km over a slab that lets nothing through, by the angle from the nadir.
fn shares_from_space(still: &mut StillRenderer, angles_deg: [f64; 3]) -> [DVec3; 3] {
    let scene = scene(&document(90.0, slab(1e3)));
    still.set_scene(scene).expect("a scene");
    let table = table(still, 400_000.0);
    angles_deg.map(|angle_deg| {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        table.at(DVec3::new(sin, -cos, 0.0), f64::INFINITY)
    })
}

/// 7 km, 28 km and 73 km away from the line through eye and sun, where the ground is.
const FROM_NADIR_DEG: [f64; 3] = [1.0, 4.0, 10.3];

#[test]
fn beyond_the_last_sunbeam_air_is_lit() {
    let mut still = still(&scene(&document(90.0, slab(1e3))));
    let found = shares_from_space(&mut still, FROM_NADIR_DEG);
    println!("{found:.4?}");
    assert!(
        found[..2].iter().all(|s| s.max_element() < 0.95),
        "{found:?}"
    );
    assert!(found[2].min_element() > 0.999, "{found:?}");
}

/// Mean of all colours' relative differences between radiance and f64, in shaded air beside boxes of cloud.
fn radiance_errors(still: &mut StillRenderer) -> Vec<f64> {
    let scene = scene(&document(35.0, boxes()));
    still.set_scene(scene.clone()).expect("a scene");
    let world = world(&scene);
    let rays: Vec<Ray> = directions(160, -0.3)
        .into_iter()
        .filter_map(|direction| Ray::new(DVec3::Y * 2.0, direction).ok())
        .filter(|ray| {
            let mut layers = world.layers().iter();
            let is_clear = |parts: [skycell_reference::shell::Interval; 2]| {
                parts.iter().all(|part| {
                    (0..400).all(|i| {
                        let at =
                            ray.at(part.start_m + (f64::from(i) + 0.5) / 400.0 * part.length_m());
                        part.is_empty() || layers_are_clear(&world, at)
                    })
                })
            };
            layers.all(|layer| {
                is_clear(world.globe().layer_intervals(
                    layer.base_altitude_m,
                    layer.top_altitude_m,
                    ray,
                ))
            }) && ray.direction.dot(world.light().sun_direction) < 0.99998
        })
        .collect();
    assert!(rays.len() > 80, "{}", rays.len());
    let seen = radiance(still, &rays);
    let mut errors: Vec<f64> = rays
        .iter()
        .zip(seen)
        .flat_map(|(ray, seen)| {
            let truth = shaded_background(&world, ray, ray.direction).without_sun;
            ((seen - truth).abs() / truth).to_array()
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

fn layers_are_clear(world: &World, at: DVec3) -> bool {
    world
        .layers()
        .iter()
        .all(|layer| world.density(layer, at, 1.0) == 0.0)
}

#[test]
fn radiance_of_shaded_air_and_of_the_ground_behind_it_is_that_of_the_f64_integral() {
    let mut still = still(&scene(&document(35.0, boxes())));
    let errors = radiance_errors(&mut still);
    let found = [0.5, 0.95, 1.0].map(|share| percentile(&errors, share));
    println!(
        "p50 {:.4} p95 {:.4} worst {:.4}",
        found[0], found[1], found[2]
    );
    assert!(
        found[0] < 0.006 && found[1] < 0.012 && found[2] < 0.02,
        "{found:?}"
    );
}

#[test]
fn under_a_clear_sky_nothing_changes() {
    // A ball that throws its shadow where nobody looks.
    let layers = json!([{"base_altitude_m": 2000, "top_altitude_m": 2500, "density": {"model": "homogeneous",
        "shape": {"form": "sphere", "center_m": [3.0e6, 2250, 0], "radius_m": 1}}}]);
    let on = document(20.0, layers);
    let mut off = on.clone();
    off["atmosphere"]["light_shafts"] = json!(false);
    let mut still = still(&scene(&on));
    let rays: Vec<Ray> = directions(400, -0.5)
        .into_iter()
        .filter_map(|direction| Ray::new(DVec3::Y * 2.0, direction).ok())
        .collect();
    let shaded = radiance(&mut still, &rays);
    let table = still.light_shafts().expect("a device").expect("a table");
    assert!(table.all().iter().flatten().all(|share| *share == 1.0));
    still.set_scene(scene(&off)).expect("a scene");
    let plain = radiance(&mut still, &rays);
    assert!(still.light_shafts().expect("a device").is_none());
    for (a, b) in shaded.iter().zip(&plain) {
        assert!(
            a.abs_diff_eq(*b, 4e-7 * b.max_element()),
            "{a} instead of {b}"
        );
    }
}

#[test]
fn shares_lie_between_nothing_and_all_at_every_extreme() {
    let mut still = still(&scene(&document(35.0, boxes())));
    for elevation_deg in [-90.0, -6.0, -0.5, 0.0, 0.3, 5.0, 90.0] {
        for (altitude_m, extinction_per_m) in [
            (-100.0, 0.05),
            (2.0, 1e3),
            (2_000.0, 1e-10),
            (2_250.0, 1e3),
            (12_000.0, 0.05),
            (400_000.0, 0.05),
        ] {
            let scene = scene(&document(elevation_deg, slab(extinction_per_m)));
            still.set_scene(scene).expect("a scene");
            let what = format!("{altitude_m} m, sun {elevation_deg}°, {extinction_per_m} per m");
            let rays: Vec<Ray> = directions(64, -1.0)
                .into_iter()
                .filter_map(|direction| Ray::new(DVec3::Y * altitude_m, direction).ok())
                .collect();
            for light in radiance(&mut still, &rays) {
                assert!(
                    light.is_finite() && light.min_element() >= 0.0,
                    "{what}: {light}"
                );
            }
            let table = still.light_shafts().expect("a device").expect("a table");
            let wrong = table
                .all()
                .iter()
                .flatten()
                .find(|share| !(0.0..=1.0).contains(*share));
            assert_eq!(wrong, None, "{what}");
        }
    }
}

/// Shadow without the air's own dimming of what is nearer.
fn undimmed(path: &str, source: &str) -> String {
    match path {
        "sky/light_shafts.wgsl" => source.replace(
            "let kept = exp(-(sum.depth + 0.5 * extinction)) * step;",
            "let kept = vec3f(step);",
        ),
        _ => source.to_owned(),
    }
}

/// Higher orders in the shadow, too.
fn all_shaded(path: &str, source: &str) -> String {
    match path {
        "sky/light_shafts.wgsl" => source.replace(
            "kept * (once * sunlit + often)",
            "kept * (once + often) * sunlit",
        ),
        _ => source.to_owned(),
    }
}

/// Air beyond the last sunbeam in that one's shadow.
fn unfaded(path: &str, source: &str) -> String {
    match path {
        "sky/light_shafts.wgsl" => source.replace("(1.0 - here) * unknown", "0.0 * unknown"),
        _ => source.to_owned(),
    }
}

/// Half-planes that turn the other way.
fn mirrored(path: &str, source: &str) -> String {
    match path {
        "sky/shafts.wgsl" => source.replace("+ frame.up * sin(angle)", "- frame.up * sin(angle)"),
        _ => source.to_owned(),
    }
}

/// A composite that forgets the ground's own light when it shades the air in front of it.
fn shaded_ground(path: &str, source: &str) -> String {
    match path {
        "sky/physical.wgsl" => source.replace(
            "select(view.radiance_per_sr, added, view.on_ground)",
            "view.radiance_per_sr",
        ),
        _ => source.to_owned(),
    }
}

#[test]
fn planted_defects_are_found() {
    let mut still = still(&scene(&document(35.0, boxes())));
    let boxes_off = |still: &mut StillRenderer| {
        let errors = share_errors(still, &document(35.0, boxes()), 2.0, (60, -0.02));
        percentile(&errors, 0.95)
    };
    for (what, edit) in [
        ("undimmed", undimmed as SourceEdit),
        ("all shaded", all_shaded),
        ("mirrored", mirrored),
    ] {
        still.plant(Some(edit)).expect("a shader");
        let off = boxes_off(&mut still);
        println!("{what}: p95 {off:.4}");
        assert!(off > 0.01, "{what}: {off}");
    }
    still.plant(Some(all_shaded)).expect("a shader");
    let off = off_under_a_slab(&mut still, 4e-3, 55.0);
    println!("all shaded, slab: {off:.4}");
    assert!(off > SLAB_BOUND, "{off}");
    still.plant(Some(unfaded)).expect("a shader");
    let found = shares_from_space(&mut still, FROM_NADIR_DEG);
    println!("unfaded: {found:.4?}");
    assert!(found[2].max_element() < 0.95, "{found:?}");
    still.plant(Some(shaded_ground)).expect("a shader");
    let errors = radiance_errors(&mut still);
    assert!(
        percentile(&errors, 0.95) > 0.02,
        "{}",
        percentile(&errors, 0.95)
    );
}

/// A viewer beside the reference, in and above clouds: the composite that searches along its ray, goes down or is in a layer, and has
/// shafts. Mesa 22's software driver crashed over a branch of it.
#[test]
fn beside_the_reference_in_and_above_clouds_the_cache_shows_what_rays_do() -> anyhow::Result<()> {
    let scene = scene(
        &json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [{"name": "low",
            "base_altitude_m": 1500, "top_altitude_m": 2100,
            "density": {"model": "weather", "coverage": 0.5, "type": 0.5}}],
            "atmosphere": {"model": "physical", "aerosol_optical_depth": 0.3, "light_shafts": true}}),
    );
    let mut still = still(&scene);
    let size = FrameSize::new(64, 36)?;
    for (altitude_m, pitch_deg) in [(1_800.0, 5.0), (3_000.0, -20.0), (9_000.0, -30.0)] {
        let camera = Camera::new([200.0, altitude_m, -300.0], 40.0, pitch_deg, 60.0)?;
        let mut picture = |renderer| -> anyhow::Result<RgbImage> {
            let settings = StillSettings {
                renderer,
                samples: 4,
                march: MarchSettings {
                    steps: 32,
                    ..MarchSettings::default()
                },
                reference_offset_m: [100.0, 0.0, 0.0],
                parallax_steps: 8,
                ..StillSettings::default()
            };
            let made = still.render_with(camera, size, &settings, |_| {})?;
            without_alpha(&made.display, size)
        };
        let cached = picture(RendererKind::Cached)?;
        let rays = picture(RendererKind::ScreenSpace)?;
        let flip = distance(&rays, &cached)?.flip;
        println!("{altitude_m} m: FLIP {flip:.4}");
        ensure!(flip < 0.06, "{altitude_m} m: {flip}");
    }
    Ok(())
}

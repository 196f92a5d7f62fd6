//! Radiance of the clear sky.

use glam::DVec3;
use serde_json::json;
use skycell_protocol::{FrameSize, Scene};
use skycell_reference::Ray;
use skycell_reference::sky::SkyLight;
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{RayPicture, StillRay, StillRenderer, StillSettings};
use skycell_shaders::SourceEdit;
use skycell_tests::numbers::Random;
use std::f64::consts::PI;
use std::sync::Arc;

/// Sun elevations.
const SUNS_DEG: [f64; 9] = [-6.0, -4.0, -2.0, 0.0, 2.0, 10.0, 30.0, 60.0, 90.0];
const DIRECTIONS: usize = 200;
/// Largest relative error of nineteen of twenty directions, and of all, for eyes near the ground while the sun is at the
/// horizon, and of half of them while it stands higher. This guards what was measured and is no target: with a high sun the
/// last tenth of a degree above the horizon is up to 25 % off (p95 8 % at 90°), at dusk radiance falls by an e-fold a degree,
/// and from the high air errors are larger. All are printed.
const P95_PERCENT: f64 = 1.0;
const WORST_PERCENT: f64 = 2.0;
const P50_PERCENT: f64 = 1.2;

fn scene(elevation_deg: f64) -> Arc<Scene> {
    let document = json!({"version": 1, "layers": [], "atmosphere": {"model": "physical"},
        "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 90}});
    Arc::new(Scene::from_json(&document).expect("a scene"))
}

/// Directions over the sphere, many around the horizon; without the sun's disc.
fn rays(altitude_m: f64, sun: DVec3) -> Vec<Ray> {
    let mut random = Random(7);
    let radius_m = 6.36e6;
    let horizon = -(altitude_m.max(0.0) * (altitude_m.max(0.0) + 2.0 * radius_m)).sqrt()
        / (radius_m + altitude_m.max(0.0));
    let mut rays = Vec::new();
    while rays.len() < DIRECTIONS {
        let y: f64 = match rays.len() % 4 {
            0 => random.between(horizon - 0.05, horizon + 0.05),
            1 => random.between(horizon, 1.0),
            _ => random.between(-1.0, 1.0),
        };
        let y = y.clamp(-1.0, 1.0);
        let yaw = random.between(0.0, 2.0 * PI);
        let across = (1.0 - y * y).max(0.0).sqrt();
        let direction = DVec3::new(across * yaw.cos(), y, across * yaw.sin());
        // Through f32, as the device sees it.
        let direction = direction.as_vec3().as_dvec3();
        if direction.dot(sun) < 0.3f64.to_radians().cos() {
            rays.push(Ray::new(DVec3::Y * altitude_m, direction).expect("a ray"));
        }
    }
    rays
}

/// Relative errors of all directions and channels, where there is light at all.
fn errors(still: &mut StillRenderer, altitude_m: f64, elevation_deg: f64) -> Vec<(f64, DVec3)> {
    let scene = scene(elevation_deg);
    still.set_scene(scene.clone()).expect("a scene");
    let light = SkyLight::new(&scene, 0.0);
    let rays = rays(altitude_m, light.sun_direction);
    let list = RayPicture {
        frame_m: DVec3::ZERO,
        size: FrameSize::new(DIRECTIONS as u32, 1).expect("a size"),
        pixel_m: [DVec3::ZERO; 2],
        rays: rays
            .iter()
            .map(|ray| StillRay {
                origin_m: ray.origin_m,
                direction: ray.direction,
            })
            .collect(),
    };
    let figures = still
        .render_rays(&list, &StillSettings::default(), |_| {})
        .expect("pictures");
    let truth_of = |rays: &[Ray]| -> Vec<DVec3> {
        rays.iter()
            .map(|ray| light.background(ray, ray.direction).without_sun)
            .collect()
    };
    let (first, second) = rays.split_at(DIRECTIONS / 2);
    let truth = std::thread::scope(|scope| {
        let other = scope.spawn(|| truth_of(second));
        let mut truth = truth_of(first);
        truth.extend(other.join().expect("no panic"));
        truth
    });
    let least = 1e-6 * light.sun_irradiance.min_element();
    let mut errors = Vec::new();
    for ((ray, truth), seen) in rays.iter().zip(&truth).zip(&figures.radiance) {
        for channel in 0..3 {
            let (truth, seen) = (truth[channel], f64::from(seen[channel]));
            errors.push(((seen - truth).abs() / truth.max(least), ray.direction));
        }
    }
    errors
}

fn percentile(errors: &[(f64, DVec3)], share: f64) -> f64 {
    errors[((errors.len() - 1) as f64 * share) as usize].0
}

#[test]
fn the_sky_of_the_tables_is_that_of_the_integral() {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let mut still = StillRenderer::new(config, scene(40.0), &[]).expect("a device");
    let mut failed = false;
    for altitude_m in [2.0, -100.0, 0.0, 5_000.0, 12_000.0, 100_000.0, 400_000.0] {
        for elevation_deg in SUNS_DEG {
            let mut errors = errors(&mut still, altitude_m, elevation_deg);
            errors.sort_by(|a, b| a.0.total_cmp(&b.0));
            let [p50, p95, worst] =
                [0.5, 0.95, 1.0].map(|share| 100.0 * percentile(&errors, share));
            let at = errors[errors.len() - 1].1;
            println!(
                "{altitude_m} m, sun {elevation_deg}°: p50 {p50:.3} % p95 {p95:.3} % worst {worst:.3} % at {at:.4}"
            );
            if (0.0..10.0).contains(&altitude_m) {
                failed |= (-2.0..=2.0).contains(&elevation_deg)
                    && (p95 > P95_PERCENT || worst > WORST_PERCENT);
                failed |= elevation_deg >= -4.0 && p50 > P50_PERCENT;
            }
        }
    }
    assert!(
        !failed,
        "p95 above {P95_PERCENT} %, an error above {WORST_PERCENT} % or a median above {P50_PERCENT} %"
    );
}

/// Aerosol that takes nothing out.
fn without_aerosol(path: &str, source: &str) -> String {
    if path == "sky/air_march.wgsl" {
        source.replace(" + medium.mie_extinction_per_m * here.mie", "")
    } else {
        source.to_owned()
    }
}

/// Aerosol that scatters backwards.
fn backwards(path: &str, source: &str) -> String {
    if path == "sky/physical.wgsl" {
        source.replace(
            "phase_hg_per_sr(medium.mie_asymmetry, angle)",
            "phase_hg_per_sr(-medium.mie_asymmetry, angle)",
        )
    } else {
        source.to_owned()
    }
}

/// Higher orders left out.
fn once_only(path: &str, source: &str) -> String {
    if path == "sky/air_march.wgsl" {
        source.replace("(rayleigh + mie) * higher", "0.0 * higher")
    } else {
        source.to_owned()
    }
}

#[test]
fn defects_of_the_air_are_noticed() {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let mut still = StillRenderer::new(config, scene(30.0), &[]).expect("a device");
    let edits: [SourceEdit; 3] = [without_aerosol, backwards, once_only];
    for (index, edit) in edits.into_iter().enumerate() {
        still.plant(Some(edit)).expect("a shader");
        let mut errors = errors(&mut still, 2.0, 2.0);
        errors.sort_by(|a, b| a.0.total_cmp(&b.0));
        let p95 = percentile(&errors, 0.95);
        println!("defect {index}: p95 {:.1} %", 100.0 * p95);
        assert!(p95 > 0.01 * P95_PERCENT, "defect {index}: {p95}");
    }
}

#[test]
fn at_the_ends_of_all_ranges_the_sky_is_finite_and_never_negative() {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let mut still = StillRenderer::new(config, scene(30.0), &[]).expect("a device");
    let airs = [
        json!({"model": "physical", "aerosol_optical_depth": 0, "rayleigh_density": 0, "ozone_dobson": 0}),
        json!({"model": "physical", "aerosol_optical_depth": 5, "rayleigh_density": 20, "ozone_dobson": 2000}),
        json!({"model": "physical", "aerosol_scale_height_m": 200, "rayleigh_scale_height_m": 200, "aerosol_asymmetry": 0.95}),
        json!({"model": "physical", "aerosol_scale_height_m": 20000, "rayleigh_scale_height_m": 20000, "aerosol_asymmetry": -0.95}),
        json!({"model": "physical", "aerosol_single_scattering_albedo": 0, "aerosol_angstrom_exponent": 4}),
        json!({"model": "physical", "aerosol_single_scattering_albedo": 1, "aerosol_angstrom_exponent": -1}),
    ];
    let mut random = Random(11);
    for (index, air) in airs.into_iter().enumerate() {
        let radius_m = [1.0e4, 6.36e6, 1.0e8][index % 3];
        for elevation_deg in [-90.0, -0.1, 90.0] {
            let document = json!({"version": 1, "layers": [], "atmosphere": air,
                "planet": {"radius_m": radius_m, "ground_albedo": index % 2},
                "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 90}});
            let scene = Arc::new(Scene::from_json(&document).expect("a scene"));
            still.set_scene(scene).expect("a scene");
            for altitude_m in [-100.0, 0.0, 1_000.0, 400_000.0] {
                let rays = (0..64)
                    .map(|i| {
                        let y = match i {
                            0 => 1.0,
                            1 => -1.0,
                            2 => 0.0,
                            _ => random.between(-1.0, 1.0),
                        };
                        let yaw = random.between(0.0, 2.0 * PI);
                        let across = f64::sqrt(1.0 - y * y);
                        StillRay {
                            origin_m: DVec3::Y * altitude_m,
                            direction: DVec3::new(across * yaw.cos(), y, across * yaw.sin()),
                        }
                    })
                    .collect();
                let list = RayPicture {
                    frame_m: DVec3::ZERO,
                    size: FrameSize::new(64, 1).expect("a size"),
                    pixel_m: [DVec3::ZERO; 2],
                    rays,
                };
                let found = still
                    .render_rays(&list, &StillSettings::default(), |_| {})
                    .expect("a picture");
                for radiance in found.radiance.into_iter().flatten() {
                    assert!(
                        radiance.is_finite() && radiance >= 0.0,
                        "{document} from {altitude_m} m: {radiance}"
                    );
                }
            }
        }
    }
}

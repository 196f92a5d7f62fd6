//! Properties of the path tracer that hold whatever the scene.

use crate::support::*;
use glam::DVec3;
use serde_json::json;
use skycell_reference::path::{Orders, PathSettings, Random, SunShape, Tracker, trace_ray};
use skycell_reference::picture::{Projection, Renderer, render};
use skycell_reference::{Approximations, Ray, World};

fn weather() -> World {
    let document = flat_scene(
        weather_layer(0.05, 0.99),
        0.6,
        json!({"model": "hg", "g": 0.8}),
    );
    world_with(&document, weather_field(), Approximations::ALL)
}

/// Rays through a layer from random places in random directions.
fn random_ray(index: u64) -> Ray {
    let value = |k: u64| unit(7 * index + k);
    let origin = DVec3::new(
        20_000.0 * (value(0) - 0.5),
        3_000.0 * value(1),
        20_000.0 * (value(2) - 0.5),
    );
    Ray::new(origin, direction(2.0 * value(3) - 1.0, 360.0 * value(4))).expect("a ray")
}

#[test]
fn density_never_exceeds_its_upper_bound() {
    let grid = json!({"model": "grid", "file": "a.bin", "dimensions": [40, 70, 130],
        "bounds_min_m": [-5000.0, 1100.0, -5000.0], "bounds_max_m": [5000.0, 1900.0, 5000.0]});
    let voxels: Vec<f32> = (0..40 * 70 * 130)
        .map(|i| {
            if unit(i) > 0.97 {
                unit(i + 1) as f32
            } else {
                0.0
            }
        })
        .collect();
    let layers = json!([layer(grid, 0.05, 1.0)]);
    let isotropic = json!({"model": "isotropic"});
    let mut bent = flat_scene(weather_layer(0.05, 1.0), 0.6, isotropic.clone());
    bent["planet"] = json!({"radius_m": 5.0e4});
    // Shape noise that does not repeat with the maps.
    let mut odd = flat_scene(weather_layer(0.05, 1.0), 0.6, isotropic.clone());
    odd["layers"][0]["density"]["shape_period_m"] = json!(2100.0);
    let worlds = [
        weather(),
        world_with(&bent, weather_field(), Approximations::ALL),
        world_with(&odd, weather_field(), Approximations::default()),
        world_of(&flat_scene(layers, 0.6, isotropic), grid_field(voxels)),
    ];
    for (which, world) in worlds.iter().enumerate() {
        let mut tracker = Tracker::new(world);
        for index in 0..2_000 {
            let mut random = Random::new(5, index, 0);
            tracker.transmittance_and_depth(&random_ray(index), &mut random);
        }
        assert!(
            tracker.evaluations > 10_000,
            "{which}: {}",
            tracker.evaluations
        );
        assert_eq!(tracker.above_majorant, 0, "world {which}");
        // Planted: a bound that is too low is counted.
        let mut tracker = Tracker::with_bound_scale(world, 0.5);
        for index in 0..200 {
            let mut random = Random::new(5, index, 0);
            tracker.transmittance_and_depth(&random_ray(index), &mut random);
        }
        assert!(tracker.above_majorant > 0, "world {which}");
    }
}

#[test]
fn tracking_and_marching_agree_on_optical_depth() {
    let document = flat_scene(
        weather_layer(0.004, 0.99),
        0.6,
        json!({"model": "isotropic"}),
    );
    let world = world_of(&document, weather_field());
    let (mut met, mut beyond_two) = (0, 0);
    for index in 0..24 {
        let ray = Ray::new(
            DVec3::new(300.0 * index as f64, 0.0, 0.0),
            direction(0.3 + 0.7 * unit(index), 360.0 * unit(index + 99)),
        )
        .expect("a ray");
        let marched =
            skycell_reference::march::converged_ray(&world, &ray, None, 1e-5, &Default::default())
                .expect("ok")
                .result;
        let traced = trace_ray(
            &world,
            &ray,
            index,
            0..3_000,
            1,
            &PathSettings {
                orders: Orders::UpTo(0),
                ..Default::default()
            },
        );
        let off = traced.transmittance.mean - marched.transmittance;
        let allowed = traced.transmittance.standard_error();
        if marched.optical_depth > 0.01 {
            met += 1;
            assert!(off.abs() < 3.5 * allowed, "{index}: {off} of {allowed}");
            beyond_two += u32::from(off.abs() > 2.0 * allowed);
        } else {
            assert!(off.abs() < 1e-3);
        }
    }
    assert!(met > 10 && beyond_two <= 6, "{met} {beyond_two}");
}

#[test]
fn thread_counts_change_no_bit() {
    let world = weather();
    let rays: Vec<Ray> = (0..64).map(random_ray).collect();
    let projection = Projection::Rays(rays);
    let renderer = Renderer::Path {
        samples: 8,
        seed: 9,
        settings: PathSettings::default(),
    };
    let picture = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a pool");
        pool.install(|| render(&world, &projection, &renderer, || {}).expect("a picture"))
    };
    let one = picture(1);
    assert_eq!(one, picture(2));
    assert!(one.rays.iter().any(|ray| ray.radiance.x > 0.0));
    // Samples that are traced in two goes are the same samples.
    let ray = random_ray(3);
    let settings = PathSettings::default();
    let all = trace_ray(&world, &ray, 3, 0..64, 9, &settings);
    let mut parts = trace_ray(&world, &ray, 3, 0..16, 9, &settings);
    parts.merge(&trace_ray(&world, &ray, 3, 16..64, 9, &settings));
    assert_eq!(parts.evaluations, all.evaluations);
    assert!((parts.radiance[0].mean - all.radiance[0].mean).abs() < 1e-14);
}

#[test]
fn sun_and_eye_may_change_places() {
    // Reflection is reciprocal: L(µ0 → µ) / µ0 = L(µ → µ0) / µ (van de Hulst 1980, § 3).
    let settings = PathSettings {
        sun: SunShape::Point,
        ..PathSettings::default()
    };
    let reflected = |mu0: f64, mu: f64, seed: u64| {
        let phase = json!({"model": "draine", "g": 0.4, "alpha": 10.0});
        let world = world(&flat_scene(slab(4.0, 0.98), mu0, phase));
        let ray = Ray::new(DVec3::new(0.0, 5000.0, 0.0), direction(-mu, 130.0)).expect("a ray");
        let moments = trace_ray(&world, &ray, 0, 0..40_000, seed, &settings);
        let mean = moments.radiance[0];
        (mean.mean / mu0, mean.standard_error() / mu0)
    };
    for (a, b) in [(0.9, 0.3), (0.7, 0.5)] {
        let ((forth, error), (back, other)) = (reflected(a, b, 1), reflected(b, a, 2));
        println!("reciprocity {a} {b}: {forth:.5} ± {error:.5}, {back:.5} ± {other:.5}");
        assert!((forth - back).abs() < 3.0 * error.hypot(other));
        assert!(error < 0.03 * forth);
    }
}

//! In a furnace nothing can be seen: with albedo 1 and the same light from everywhere, all radiance is that light.

use crate::support::*;
use serde_json::{Value, json};
use skycell_reference::path::{PathSettings, trace_ray};
use skycell_reference::{Approximations, Field, Ray, World};

fn furnace(layers: Value, field: Field, phase: Value, approximations: Approximations) -> World {
    let mut document = flat_scene(layers, 0.5, phase);
    document["atmosphere"]["radiance_w_per_m2_nm_sr"] = json!([1.0, 1.0, 1.0]);
    document["sun"]["irradiance_w_per_m2_nm"] = json!([0.0, 0.0, 0.0]);
    world_with(&document, field, approximations)
}

fn check(what: &str, world: &World, rays: &[Ray], settings: &PathSettings) {
    for (index, ray) in rays.iter().enumerate() {
        let moments = trace_ray(world, ray, index as u64, 0..3_000, 11, settings);
        assert_eq!(
            (moments.cut_paths, moments.above_majorant),
            (0, 0),
            "{what}"
        );
        assert!(moments.scatterings > 1000, "{what}: nothing is hit");
        let (mean, error) = (
            moments.radiance[1].mean,
            moments.radiance[1].standard_error(),
        );
        println!("furnace, {what}: {mean:.5} ± {error:.5}");
        assert!(error < 0.01, "{what}: {error}");
        // What is exact has no standard error but rounds.
        assert!(
            (mean - 1.0).abs() < 3.0 * error + 1e-9,
            "{what}: {mean} ± {error}"
        );
    }
}

#[test]
fn clouds_vanish_in_a_furnace() {
    let forward = json!({"model": "hg", "g": 0.8});
    let droplets = json!({"model": "hg-draine", "droplet_diameter_um": 20.0});
    let settings = PathSettings::default();
    let up = ray([-250.0, 0.0, -100.0], [0.2, 1.0, 0.1]);
    let level = ray([-3000.0, 1450.0, 30.0], [1.0, 0.0, 0.0]);
    let off = Approximations::default();
    let world = furnace(slab(3.0, 1.0), Field::default(), forward.clone(), off);
    check("slab", &world, &[up], &settings);
    for shape in [
        json!({"form": "box", "center_m": [0.0, 1500.0, 0.0], "size_m": [600.0, 300.0, 500.0]}),
        json!({"form": "sphere", "center_m": [0.0, 1500.0, 0.0], "radius_m": 300.0}),
    ] {
        let density = json!({"model": "homogeneous", "shape": shape});
        let layers = json!([layer(density, 0.01, 1.0)]);
        let world = furnace(layers, Field::default(), droplets.clone(), off);
        check("shape", &world, &[up, level], &settings);
    }
    let grid = json!({"model": "grid", "file": "a.bin", "dimensions": [3, 2, 2],
        "bounds_min_m": [-300.0, 1200.0, -300.0], "bounds_max_m": [300.0, 1800.0, 300.0]});
    let voxels: Vec<f32> = (0..12).map(|i| unit(i) as f32).collect();
    let layers = json!([layer(grid, 0.02, 1.0)]);
    let world = furnace(layers, grid_field(voxels), forward, off);
    check("grid", &world, &[up, level], &settings);
    for approximations in [off, Approximations::ALL] {
        let layers = weather_layer(0.004, 1.0);
        let world = furnace(layers, weather_field(), droplets.clone(), approximations);
        check("weather", &world, &[up], &settings);
    }
}

#[test]
fn a_furnace_on_a_planet_without_ground_in_sight_is_as_even() {
    let mut document = flat_scene(
        weather_layer(0.02, 1.0),
        0.5,
        json!({"model": "hg", "g": 0.5}),
    );
    document["planet"] = json!({"radius_m": 1.0e5, "ground_albedo": 1.0});
    document["atmosphere"]["radiance_w_per_m2_nm_sr"] = json!([1.0, 1.0, 1.0]);
    document["sun"]["irradiance_w_per_m2_nm"] = json!([0.0, 0.0, 0.0]);
    // A white ground under an even sky is as bright as the sky.
    let world = world_of(&document, weather_field());
    let rays = [
        ray([0.0, 1.0, 0.0], [1.0, 0.1, 0.0]),
        ray([0.0, 1.0, 0.0], [0.0, 1.0, 0.3]),
    ];
    check("planet", &world, &rays, &PathSettings::default());
}

#[test]
fn a_cut_after_64_scatterings_is_noticed() {
    // Planted: a bounce cap, which loses the light of thick clouds.
    let world = furnace(
        slab(200.0, 1.0),
        Field::default(),
        json!({"model": "isotropic"}),
        Approximations::default(),
    );
    let capped = PathSettings {
        scatterings_max: 64,
        ..PathSettings::default()
    };
    let inside = ray([0.0, 1300.0, 0.0], [0.0, 1.0, 0.0]);
    let moments = trace_ray(&world, &inside, 0, 0..200, 1, &capped);
    assert!(moments.cut_paths > 0);
    assert!(moments.radiance[0].mean < 0.9);
    let moments = trace_ray(&world, &inside, 0, 0..200, 1, &PathSettings::default());
    assert_eq!(moments.cut_paths, 0);
    assert!((moments.radiance[0].mean - 1.0).abs() < 1e-9);
}

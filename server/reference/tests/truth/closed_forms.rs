//! Beer and Lambert: transmittance where ∫ σ dt is known.

use crate::support::*;
use serde_json::{Value, json};
use skycell_reference::march::{ConvergeLimit, converged_ray};
use skycell_reference::path::{PathSettings, trace_ray};
use skycell_reference::{Field, Ray, World};

/// Optical depth and transmittance by both renderers.
fn check(what: &str, world: &World, ray: &Ray, depth: f64) {
    let marched = converged_ray(world, ray, None, 1e-5, &ConvergeLimit::default()).expect("ok");
    assert!(marched.converged, "{what}: {marched:?}");
    assert_close(what, marched.result.optical_depth, depth, 1e-4);
    assert_close(what, marched.result.transmittance, (-depth).exp(), 1e-4);
    let traced = trace_ray(world, ray, 0, 0..20_000, 7, &PathSettings::default());
    assert_eq!(traced.above_majorant, 0);
    let off = (traced.transmittance.mean - (-depth).exp()).abs();
    // What is exact has no standard error but rounds.
    let allowed = 3.5 * traced.transmittance.standard_error() + 1e-12;
    assert!(off <= allowed, "{what}: {off} of {allowed}");
    let off = (traced.optical_depth.mean - depth).abs();
    let allowed = 3.5 * traced.optical_depth.standard_error() + 1e-9 * depth;
    assert!(off <= allowed, "{what}: {off} of {allowed}");
}

fn of(density: Value, field: Field) -> World {
    let layers = json!([layer(density, 0.004, 0.0)]);
    world_of(
        &flat_scene(layers, 0.7, json!({"model": "isotropic"})),
        field,
    )
}

#[test]
fn a_slanted_ray_through_a_slab_is_dimmed_by_its_length() {
    let world = of(json!({"model": "homogeneous"}), Field::default());
    for mu in [1.0, 0.5, 0.1] {
        let ray = Ray::new([3.0, 10.0, -5.0].into(), direction(mu, 20.0)).expect("a ray");
        check("slab", &world, &ray, 4.0 / mu);
    }
    // From inside, downwards.
    let inside = Ray::new([0.0, 1250.0, 0.0].into(), direction(-0.5, 0.0)).expect("a ray");
    check("inside", &world, &inside, 0.004 * 250.0 / 0.5);
}

#[test]
fn boxes_and_balls_are_dimmed_by_their_chords() {
    let cube = json!({"model": "homogeneous", "shape": {"form": "box",
        "center_m": [500.0, 1500.0, 0.0], "size_m": [10.0, 600.0, 600.0]}});
    let along = ray([-5000.0, 1500.0, 7.0], [1.0, 0.0, 0.0]);
    check(
        "a thin plate",
        &of(cube.clone(), Field::default()),
        &along,
        0.04,
    );
    let slant = ray([0.0, 1000.0, 0.0], [1.0, 1.0, 0.0]);
    check(
        "slanted",
        &of(cube, Field::default()),
        &slant,
        0.04 * 2f64.sqrt(),
    );
    let ball = json!({"model": "homogeneous", "shape": {"form": "sphere",
        "center_m": [0.0, 1500.0, 0.0], "radius_m": 400.0}});
    let off_middle = ray([-9000.0, 1740.0, 0.0], [1.0, 0.0, 0.0]);
    check(
        "a ball",
        &of(ball.clone(), Field::default()),
        &off_middle,
        0.004 * 640.0,
    );
    let missing = ray([-9000.0, 1900.5, 0.0], [1.0, 0.0, 0.0]);
    check("past a ball", &of(ball, Field::default()), &missing, 0.0);
    // A ball that its layer cuts: only the half above 1000 m is left.
    let cut = json!({"model": "homogeneous", "shape": {"form": "sphere",
        "center_m": [0.0, 1000.0, 0.0], "radius_m": 400.0}});
    let up = ray([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    check("half a ball", &of(cut, Field::default()), &up, 1.6);
}

#[test]
fn a_linear_grid_is_dimmed_by_its_integral() {
    // Density rises with altitude: voxel k of 5 holds (k + 1/2)/5, constant beyond the outermost middles. Straight up the
    // integral is Σ voxels · height; along x density is constant.
    let grid = json!({"model": "grid", "file": "a.bin", "dimensions": [1, 5, 1],
        "bounds_min_m": [-300.0, 1200.0, -300.0], "bounds_max_m": [300.0, 1700.0, 300.0]});
    let voxels: Vec<f32> = (0..5).map(|k| (k as f32 + 0.5) / 5.0).collect();
    let world = of(grid, grid_field(voxels.clone()));
    let up = ray([10.0, 0.0, 20.0], [0.0, 1.0, 0.0]);
    let sum: f64 = voxels.iter().map(|v| f64::from(*v)).sum();
    check("up", &world, &up, 0.004 * 100.0 * sum);
    let across = ray([-5000.0, 1450.0, 0.0], [1.0, 0.0, 0.0]);
    check(
        "across",
        &world,
        &across,
        0.004 * 600.0 * f64::from(voxels[2]),
    );
    let slant = ray([-200.0, 1200.0 - 100.0, 0.0], [0.3, 1.0, 0.1]);
    let longer = (1.0f64 + 0.09 + 0.01).sqrt();
    check("slanted", &world, &slant, 0.004 * 100.0 * sum * longer);
}

#[test]
fn a_bent_layer_is_as_long_as_its_chord() {
    // On a sphere of 100 km the chord between two shells from the ground at a zenith cosine µ, by the plain quadratic.
    let document = json!({"version": 1, "planet": {"radius_m": 1.0e5},
        "atmosphere": {"model": "uniform"}, "wind": {"speed_m_per_s": 0.0},
        "layers": slab(2.0, 0.0)});
    let world = world(&document);
    for mu in [1.0, 0.4, 0.0] {
        let to_shell = |h: f64| {
            let (r, top) = (1.0e5f64, 1.0e5 + h);
            -r * mu + (r * r * mu * mu + top * top - r * r).sqrt()
        };
        let length = to_shell(2000.0) - to_shell(1000.0);
        let ray = Ray::new([0.0; 3].into(), direction(mu, 0.0)).expect("a ray");
        check("bent", &world, &ray, 0.002 * length);
    }
}

#[test]
fn layers_that_overlap_add_up() {
    let homogeneous = json!({"model": "homogeneous"});
    let mut other = layer(homogeneous.clone(), 0.001, 0.0);
    other["name"] = json!("two");
    other["base_altitude_m"] = json!(1500.0);
    other["top_altitude_m"] = json!(2500.0);
    let grid = json!({"model": "grid", "file": "a.bin", "dimensions": [1, 1, 1],
        "bounds_min_m": [-300.0, 1700.0, -300.0], "bounds_max_m": [300.0, 1800.0, 300.0]});
    let mut third = layer(grid, 0.01, 0.0);
    third["name"] = json!("three");
    let layers = json!([layer(homogeneous, 0.002, 0.0), other, third]);
    let mut field = grid_field(vec![0.5]);
    field.layers = vec![
        Default::default(),
        Default::default(),
        field.layers[0].clone(),
    ];
    let scene = flat_scene(layers, 0.7, json!({"model": "isotropic"}));
    let up = ray([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    check("overlap", &world_of(&scene, field), &up, 2.0 + 1.0 + 0.5);
}

#[test]
fn wind_moves_clouds_downwind() {
    let cube = json!({"model": "homogeneous", "shape": {"form": "box",
        "center_m": [500.0, 1500.0, 0.0], "size_m": [100.0, 100.0, 100.0]}});
    let mut document = flat_scene(
        json!([layer(cube, 0.01, 0.0)]),
        0.7,
        json!({"model": "isotropic"}),
    );
    // East is +x.
    document["wind"] = json!({"speed_m_per_s": 10.0, "towards_deg": 90.0});
    let scene = skycell_protocol::Scene::from_json(&document).expect("a scene");
    let settings = skycell_reference::WorldSettings {
        time_s: 60.0,
        origin_xz_m: [1000.0, 0.0],
        ..Default::default()
    };
    let world = World::new(&scene, Default::default(), settings).expect("a world");
    // From 500 m by 600 m of wind to 1100 m, which is 100 m in the frame.
    check(
        "moved",
        &world,
        &ray([100.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
        1.0,
    );
    check(
        "left",
        &world,
        &ray([-500.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
        0.0,
    );
}

#[test]
fn bad_input_is_refused_with_its_name() {
    let weather = flat_scene(weather_layer(0.01, 1.0), 0.5, json!({"model": "isotropic"}));
    let scene = skycell_protocol::Scene::from_json(&weather).expect("a scene");
    let error = World::new(&scene, Default::default(), Default::default()).expect_err("no noise");
    assert!(error.to_string().contains("noise"), "{error}");
    let grid = json!({"model": "grid", "file": "a.bin", "dimensions": [2, 1, 1]});
    let scene = flat_scene(
        json!([layer(grid, 0.01, 1.0)]),
        0.5,
        json!({"model": "isotropic"}),
    );
    let scene = skycell_protocol::Scene::from_json(&scene).expect("a scene");
    for (voxels, named) in [
        (vec![1.0], "1 values"),
        (vec![1.0, f32::NAN], "voxel 1"),
        (vec![-0.5, 1.0], "voxel 0"),
    ] {
        let field = std::sync::Arc::new(grid_field(voxels));
        let error = World::new(&scene, field, Default::default()).expect_err("bad");
        assert!(error.to_string().contains(named), "{error}");
    }
    assert!(Ray::new(glam::DVec3::ZERO, glam::DVec3::ZERO).is_err());
    assert!(Ray::new(glam::DVec3::NAN, glam::DVec3::X).is_err());
}

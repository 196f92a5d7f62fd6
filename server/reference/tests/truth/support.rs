//! Worlds for tests.

use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_protocol::scene::WeatherProfile;
use skycell_reference::{
    Approximations, ByteVolume, Field, LayerField, Noise, Ray, TexelMap, WeatherMaps, World,
    WorldSettings,
};
use std::sync::Arc;

/// A flat world without air and environment, with a sun of irradiance 1 in all channels.
pub(crate) fn flat_scene(layers: Value, mu_sun: f64, phase: Value) -> Value {
    json!({
        "version": 1,
        "planet": null,
        "atmosphere": {"model": "uniform"},
        "sun": {"azimuth_deg": 0.0, "elevation_deg": mu_sun.asin().to_degrees(),
            "irradiance_w_per_m2_nm": [1.0, 1.0, 1.0]},
        "layers": layers,
        "light": {"phase": phase, "octaves": 1, "sun_march_distance_m": 100000.0},
        "wind": {"speed_m_per_s": 0.0},
    })
}

/// One layer of 1 km between 1 and 2 km.
pub(crate) fn layer(density: Value, extinction_per_m: f64, albedo: f64) -> Value {
    json!({"name": "one", "base_altitude_m": 1000.0, "top_altitude_m": 2000.0,
        "density": density, "extinction_per_m": extinction_per_m,
        "single_scattering_albedo": albedo})
}

/// All of the layer, with an optical depth straight up.
pub(crate) fn slab(tau: f64, albedo: f64) -> Value {
    json!([layer(json!({"model": "homogeneous"}), tau / 1000.0, albedo)])
}

pub(crate) fn world_of(document: &Value, field: Field) -> World {
    world_with(document, field, Approximations::default())
}

pub(crate) fn world_with(document: &Value, field: Field, approximations: Approximations) -> World {
    let scene = Scene::from_json(document).expect("a scene");
    let settings = WorldSettings {
        approximations,
        ..WorldSettings::default()
    };
    World::new(&scene, Arc::new(field), settings).expect("a world")
}

pub(crate) fn world(document: &Value) -> World {
    world_of(document, Field::default())
}

pub(crate) fn ray(origin: [f64; 3], direction: [f64; 3]) -> Ray {
    Ray::new(origin.into(), direction.into()).expect("a ray")
}

/// A field of one grid layer.
pub(crate) fn grid_field(voxels: Vec<f32>) -> Field {
    Field {
        noise: None,
        layers: vec![LayerField::Grid(voxels)],
    }
}

/// Even numbers in 0…1 by index, the same in every run (SplitMix64).
pub(crate) fn unit(index: u64) -> f64 {
    let mut z = index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Smooth noise of small volumes and maps: sums of a few waves, which repeat.
pub(crate) fn weather_field() -> Field {
    let wave = |phase: f64, turns: f64| (std::f64::consts::TAU * (turns + phase)).sin();
    let volume = |size: u32, waves: f64, seed: f64| {
        let mut texels = Vec::new();
        for z in 0..size {
            for y in 0..size {
                for x in 0..size {
                    let [x, y, z] = [x, y, z].map(|i| f64::from(i) / f64::from(size));
                    for channel in [0.0, 0.37] {
                        let value = 0.5
                            + 0.2 * wave(seed + channel, waves * x + 2.0 * y)
                            + 0.2 * wave(channel - seed, waves * z - y)
                            + 0.2 * wave(2.0 * channel, waves * (x - z) + 3.0 * y);
                        texels.push((value.clamp(0.0, 1.0) * 255.0) as u8);
                    }
                }
            }
        }
        ByteVolume::new("noise", size, texels).expect("a volume")
    };
    let map = |seed: f64| {
        let mut texels = Vec::new();
        for z in 0..64 {
            for x in 0..64 {
                let (x, z) = (f64::from(x) / 64.0, f64::from(z) / 64.0);
                let value = 0.5
                    + 0.25 * wave(seed, 2.0 * x + z)
                    + 0.25 * wave(2.0 * seed, 3.0 * z - x)
                    + 0.1 * (unit((x * 64.0 + z * 4096.0) as u64) - 0.5);
                texels.push((value.clamp(0.0, 1.0) * 255.0) as u8);
            }
        }
        TexelMap::new("map", 64, 64, texels).expect("a map")
    };
    let mut profile = Vec::new();
    for t in 0..64 {
        for h in 0..128 {
            let value = skycell_reference::density::profile::vertical_profile(
                WeatherProfile::Low,
                (f64::from(t) + 0.5) / 64.0,
                (f64::from(h) + 0.5) / 128.0,
            );
            profile.push((value * 255.0).round() as u8);
        }
    }
    Field {
        noise: Some(Noise {
            shape: volume(32, 3.0, 0.2),
            detail: volume(16, 2.0, 0.6),
        }),
        layers: vec![LayerField::Weather(WeatherMaps {
            coverage: map(0.1),
            cloud_type: map(0.7),
            skip: TexelMap::new("skip", 1, 1, vec![0]).expect("a map"),
            profile: TexelMap::new("profile", 128, 64, profile).expect("a map"),
        })],
    }
}

/// A weather layer that the above field fills.
pub(crate) fn weather_layer(extinction_per_m: f64, albedo: f64) -> Value {
    json!([layer(
        json!({"model": "weather", "coverage": 0.7, "map_span_m": 8000.0,
            "shape_period_m": 2000.0, "detail_period_m": 300.0}),
        extinction_per_m,
        albedo
    )])
}

pub(crate) fn assert_close(what: &str, value: f64, expected: f64, relative: f64) {
    assert!(
        (value - expected).abs() <= relative * expected.abs().max(1e-30),
        "{what}: {value} instead of {expected}"
    );
}

/// A direction by the cosine of its angle from straight up and its azimuth from north (−z) towards east.
pub(crate) fn direction(mu: f64, azimuth_deg: f64) -> DVec3 {
    let across = (1.0 - mu * mu).max(0.0).sqrt();
    let (sine, cosine) = azimuth_deg.to_radians().sin_cos();
    DVec3::new(across * sine, mu, -across * cosine)
}

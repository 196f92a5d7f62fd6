//! Layers that share altitudes: what blending them by their mean distances costs against marching them together.

use super::support::{flat_scene, ray, world};
use serde_json::json;
use skycell_reference::march::{MarchSteps, march_ray};
use std::f64::consts::PI;

/// A layer of even cloud: its altitudes, extinction and albedo.
#[derive(Clone, Copy)]
struct Even {
    base_m: f64,
    top_m: f64,
    extinction_per_m: f64,
    albedo: f64,
}

/// What a ray straight up sees of layers whose droplets all have the sun's light undimmed: exactly, part by part.
fn together(layers: &[Even], phase_per_sr: f64) -> f64 {
    let mut ends: Vec<f64> = layers.iter().flat_map(|l| [l.base_m, l.top_m]).collect();
    ends.sort_by(f64::total_cmp);
    let (mut seen, mut kept) = (0.0, 1.0);
    for part in ends.windows(2) {
        let middle_m = 0.5 * (part[0] + part[1]);
        let inside = layers
            .iter()
            .filter(|l| (l.base_m..l.top_m).contains(&middle_m));
        let (extinction, scattering) = inside.fold((0.0, 0.0), |(e, s), l| {
            (e + l.extinction_per_m, s + l.extinction_per_m * l.albedo)
        });
        let depth: f64 = extinction * (part[1] - part[0]);
        if depth > 0.0 {
            seen += kept * (1.0 - (-depth).exp()) * scattering / extinction * phase_per_sr;
            kept *= (-depth).exp();
        }
    }
    seen
}

#[test]
fn overlapping_layers_are_wrong_by_no_more_than_their_opacities_and_contrast() {
    let low = Even {
        base_m: 1000.0,
        top_m: 2000.0,
        extinction_per_m: 1e-3,
        albedo: 1.0,
    };
    let (mut worst, mut worst_of_bright, mut swapped_is_worse) = (0.0f64, 0.0f64, 0);
    for base_m in [1000.0, 1300.0, 1500.0, 1900.0, 2000.0, 2500.0] {
        for thickness_m in [200.0, 1000.0] {
            for optical_depth in [0.03, 1.0, 8.0] {
                for albedo in [0.0, 0.5, 1.0] {
                    let high = Even {
                        base_m,
                        top_m: base_m + thickness_m,
                        extinction_per_m: optical_depth / thickness_m,
                        albedo,
                    };
                    let document = |name: &str, l: Even| {
                        json!({"name": name, "base_altitude_m": l.base_m,
                            "top_altitude_m": l.top_m, "density": {"model": "homogeneous"},
                            "extinction_per_m": l.extinction_per_m,
                            "single_scattering_albedo": l.albedo})
                    };
                    let mut scene = flat_scene(
                        json!([document("low", low), document("high", high)]),
                        // Not where the ray looks.
                        0.8,
                        json!({"model": "isotropic"}),
                    );
                    // No droplet stands in another's shadow.
                    scene["light"]["sun_march_distance_m"] = json!(1.0);
                    let world = world(&scene);
                    let ray = ray([0.0; 3], [0.0, 1.0, 0.0]);
                    let steps = MarchSteps {
                        steps: 2000,
                        early_exit: false,
                        ..MarchSteps::default()
                    };
                    let found = march_ray(&world, &ray, &steps).radiance.x;
                    let phase = 1.0 / (4.0 * PI);
                    let exact = together(&[low, high], phase);
                    let opacity =
                        |l: Even| 1.0 - (-l.extinction_per_m * (l.top_m - l.base_m)).exp();
                    let both = opacity(low) * opacity(high);
                    let bound = both * (low.albedo - high.albedo).abs() * phase;
                    // The march's own error: its steps, and the metre of shadow.
                    let deepest_per_m = low.extinction_per_m.max(high.extinction_per_m);
                    let march = (0.01 + deepest_per_m) * exact + 1e-6;
                    assert!(
                        (found - exact).abs() <= bound + march,
                        "{base_m} m, {thickness_m} m, {optical_depth}, {albedo}: {found} for {exact}"
                    );
                    worst = worst.max((found - exact).abs() / exact.max(1e-3 * phase));
                    worst_of_bright = worst_of_bright.max((found - exact).abs() / phase);
                    // Planted: the nearer layer behind the farther one.
                    let own = |l: Even| opacity(l) * l.albedo * phase;
                    let swapped = own(high) + (1.0 - opacity(high)) * own(low);
                    let apart = base_m >= 2000.0;
                    if apart && bound > 10.0 * march {
                        assert!((swapped - exact).abs() > march, "the order does not show");
                        swapped_is_worse += 1;
                    }
                }
            }
        }
    }
    println!(
        "blended by mean distance: at most {:.1} % of the exact radiance, {:.3} of a white cloud's",
        100.0 * worst,
        worst_of_bright
    );
    assert!(swapped_is_worse > 0);
}

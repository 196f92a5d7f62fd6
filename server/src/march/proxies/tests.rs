use super::*;
use crate::march::active_layers;
use crate::probe::{FunctionPoint, FunctionProbe, FunctionQuestion};
use serde_json::json;

#[test]
fn slabs_of_a_layer_meet_and_fill_it() {
    let document = json!({"version": 1, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 4000},
        {"name": "high", "base_altitude_m": 5000, "top_altitude_m": 6000}]});
    let scene = Scene::from_json(&document).expect("valid");
    let active = active_layers(&scene);
    for slabs in 1..=4usize {
        let settings = ProxySettings {
            slabs: slabs as u32,
            ..ProxySettings::default()
        };
        let proxies = proxies_of(&scene, &active, &settings);
        assert_eq!(proxies.len(), 2 * slabs);
        for (layer, (base_m, top_m)) in [(1_500.0, 4_000.0), (5_000.0, 6_000.0)]
            .into_iter()
            .enumerate()
        {
            let parts = &proxies[layer * slabs..(layer + 1) * slabs];
            assert!(parts.iter().all(|part| part.layer == layer));
            assert_eq!(parts[0].between_m[0], base_m);
            assert_eq!(parts[slabs - 1].between_m[1], top_m);
            for pair in parts.windows(2) {
                assert_eq!(pair[0].between_m[1], pair[1].between_m[0]);
            }
            for part in parts {
                assert!(part.between_m[0] < part.altitude_m);
                assert!(part.altitude_m < part.between_m[1]);
            }
        }
    }
}

#[test]
fn bands_meet_and_each_dome_stands_in_its_own() {
    for ends in [BandEnds::Gaps, BandEnds::Cut] {
        for n in 1..=4 {
            let bands: Vec<Dome> = (0..n).map(|k| Dome::of_band(k, n, ends)).collect();
            assert_eq!(bands[0].between[0], 0.0);
            assert_eq!(bands[n as usize - 1].between[1], FAR_M);
            for pair in bands.windows(2) {
                assert_eq!(pair[0].between[1], pair[1].between[0]);
                // Both sides of an end decide by the same limit.
                assert_eq!(pair[0].between_gaps[1], pair[1].between_gaps[0]);
            }
            for band in &bands {
                assert!(band.between[0] < band.radius && band.radius < band.between[1]);
            }
        }
    }
    assert_eq!(Dome::of_band(0, 1, BandEnds::Gaps).radius, 2.0);
}

/// The closed form of the default radius: over directions that are even over the sky, no other radius has a smaller mean
/// square of the angle by which what is seen is off.
#[test]
fn a_domes_radius_is_off_least_over_its_part_of_the_sky() {
    for n in 1..=4 {
        for k in 0..n {
            let radius = Dome::of_band(k, n, BandEnds::Cut).radius;
            // Sines of elevation at which a layer at height 1 is in the band.
            let [high, low] = [k, k + 1].map(|i| 1.0 - f64::from(i) / f64::from(n));
            let off = |radius: f64| {
                let count = 1000;
                (0..count)
                    .map(|i| {
                        let mu = low + (high - low) * (f64::from(i) + 0.5) / f64::from(count);
                        (mu - 1.0 / radius).powi(2)
                    })
                    .sum::<f64>()
            };
            for other in [0.95, 1.05] {
                assert!(off(radius) < off(radius * other), "band {k} of {n}");
            }
        }
    }
}

#[test]
fn a_domes_surface_is_its_radius_away_from_its_anchor() {
    let frame = CellFrame::at(DVec3::ZERO, 6.36e6);
    let (anchor, surface) = (
        DVec3::new(300.0, 10.0, -200.0),
        Surface::Dome { radius_m: 4_000.0 },
    );
    for from in [anchor, DVec3::ZERO, DVec3::new(3_000.0, 500.0, 1_000.0)] {
        for direction in [DVec3::Y, DVec3::X, DVec3::new(0.6, 0.0, 0.8), -DVec3::Y] {
            let distance_m = surface.distance_m(&frame, anchor, from, direction);
            let at = from + direction * distance_m;
            assert!(distance_m > 0.0 && (at.distance(anchor) - 4_000.0).abs() < 1e-6);
        }
    }
}

#[test]
fn domes_with_slabs_are_refused() {
    for (name, setup) in ProxySetup::NAMES {
        let settings = ProxySettings {
            setup,
            slabs: 2,
            ..ProxySettings::default()
        };
        match settings.checked() {
            Ok(_) => assert_eq!(setup, ProxySetup::InLayer),
            Err(error) => assert!(error.to_string().contains(name), "{error}"),
        }
    }
}

/// The shaders' function against its twin, from places up to nine tenths of the radius away from the middle. There the root of
/// the discriminant is at least 0.43 r, and what rounding takes from either is some ten times U r.
#[test]
fn the_shaders_find_a_dome_where_its_twin_does() {
    const U: f64 = 1.0 / (1u64 << 24) as f64;
    let frame = CellFrame::at(DVec3::ZERO, 6.36e6);
    let mut random = fastrand::Rng::with_seed(5);
    let mut between = |low: f64, high: f64| low + (high - low) * random.f64();
    let points: Vec<FunctionPoint> = (0..10_000)
        .map(|index| {
            let radius_m = 10f64.powf(between(2.0, 6.0));
            let unit = |yaw: f64, mu: f64| {
                let across = (1.0 - mu * mu).sqrt();
                DVec3::new(across * yaw.cos(), mu, across * yaw.sin())
            };
            let from = unit(between(0.0, 6.3), between(-1.0, 1.0));
            let direction = unit(between(0.0, 6.3), between(-1.0, 1.0)).as_vec3();
            let share = if index % 10 == 0 {
                0.0
            } else {
                between(0.0, 0.9)
            };
            let from = (from * share * radius_m).as_vec3();
            [
                [from.x, from.y, from.z, radius_m as f32],
                [direction.x, direction.y, direction.z, 0.0],
            ]
        })
        .collect();
    let probe = FunctionProbe::open().expect("a device");
    let values = probe
        .ask(FunctionQuestion::DomeDistance, &points)
        .expect("answers");
    let mut worst: f64 = 0.0;
    for (point, value) in points.iter().zip(&values) {
        let vector = |v: [f32; 4]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        let radius_m = f64::from(point[0][3]);
        let surface = Surface::Dome { radius_m };
        let twin_m = surface.distance_m(&frame, DVec3::ZERO, vector(point[0]), vector(point[1]));
        worst = worst.max((f64::from(value[0]) - twin_m).abs() / (U * radius_m));
    }
    println!("off by {worst:.1} U r at most");
    assert!(worst < 16.0, "{worst}");
}

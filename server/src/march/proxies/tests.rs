use super::*;
use crate::march::active_layers;
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

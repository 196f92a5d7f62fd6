//! Air that is opaque, and air of every kind and amount around planets of every size.

use super::line::Line;
use super::stage::{SCREEN, Stage, eye, merged, small, weather};
use serde_json::json;
use std::f64::consts::PI;

/// Nothing of any air is NaN, infinite or negative, from the ground, from high in it and from outside, by day and at dusk,
/// with clouds in it; and no way through it takes long, however many radii of its planet it has.
pub(crate) fn anywhere(stage: &mut Stage) -> Line {
    let mut line = Line::new("air");
    let none = json!({"aerosol_optical_depth": 0, "rayleigh_density": 0, "ozone_dobson": 0});
    let most = json!({"aerosol_optical_depth": 5, "rayleigh_density": 20, "ozone_dobson": 2000,
        "aerosol_scale_height_m": 2e4, "rayleigh_scale_height_m": 2e4});
    let low = json!({"aerosol_optical_depth": 5, "rayleigh_density": 20, "aerosol_asymmetry": 0.95,
        "aerosol_scale_height_m": 200, "rayleigh_scale_height_m": 200});
    let trace = json!({"aerosol_optical_depth": 1e-9, "rayleigh_density": 1e-9, "ozone_dobson": 1e-9,
        "aerosol_asymmetry": -0.95, "aerosol_single_scattering_albedo": 0, "aerosol_scale_height_m": 200,
        "rayleigh_scale_height_m": 2e4});
    for (what, radius_m, air, suns_deg) in [
        (
            "as much air as can be around a tiny planet",
            1e4,
            most.clone(),
            &[40.0, -2.0] as &[f64],
        ),
        ("low air around a tiny planet", 1e4, low.clone(), &[5.0]),
        ("traces of air around a tiny planet", 1e4, trace, &[40.0]),
        ("no air around a vast planet", 1e8, none, &[40.0]),
        (
            "as much air as can be around a vast planet",
            1e8,
            most,
            &[5.0],
        ),
        ("low air around a vast planet", 1e8, low, &[40.0]),
    ] {
        for sun_deg in suns_deg {
            let mut scene = weather(json!({"planet": {"radius_m": radius_m},
                "sun": {"elevation_deg": sun_deg}, "atmosphere": {"model": "physical"}}));
            scene["atmosphere"] = merged(scene["atmosphere"].clone(), air.clone());
            stage.scene(&scene);
            for (altitude_m, pitch_deg) in [(2.0, 10.0), (400_000.0, -60.0)] {
                let camera = eye([0.0, altitude_m, 0.0], 30.0, pitch_deg, 70.0);
                let picture = stage.look(camera, small(), SCREEN);
                line.picture(
                    format!("{what}, the sun at {sun_deg}, from {altitude_m} m"),
                    &picture,
                );
            }
        }
    }
    line
}

/// Under the sun in the zenith, air that takes nothing away sends back what two streams of light have it send back: over black
/// ground the nadir's radiance is that of a white surface of this albedo, within the half that their evenness is wrong by.
pub(crate) fn opaque(stage: &mut Stage) -> Line {
    let mut line = Line::new("opaque air");
    for scale_height_m in [200.0, 1_000.0, 8_000.0] {
        stage.scene(&weather(json!({
            "layers": [],
            "atmosphere": {"model": "physical", "aerosol_optical_depth": 0, "ozone_dobson": 0,
                "rayleigh_density": 20, "rayleigh_scale_height_m": scale_height_m},
            "planet": {"radius_m": 6.36e6, "ground_albedo": 0},
            "sun": {"elevation_deg": 90, "irradiance_w_per_m2_nm": [1, 1, 1]}
        })));
        // Blue, of which most is scattered.
        let blue_depth = 20.0 * 1.240_62e-6 / 0.44f64.powi(4) * scale_height_m;
        let camera = eye([0.0, 400_000.0, 0.0], 0.0, -90.0, 2.0);
        let picture = stage.look(camera, small(), SCREEN);
        line.picture(format!("scale height {scale_height_m} m"), &picture);
        let middle = picture.linear.len() / 8 * 4 + 2;
        let albedo = PI * f64::from(picture.linear[middle]);
        // Eddington's two streams over black ground, where nothing is lost and light scatters evenly: τ / (τ + 4/3).
        let two_streams = blue_depth / (blue_depth + 4.0 / 3.0);
        line.holds(
            format!("scale height {scale_height_m} m: {albedo} for {two_streams}"),
            (albedo / two_streams - 1.0).abs(),
            0.5,
        );
    }
    line
}

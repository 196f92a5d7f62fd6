//! Air of any coefficients around any planet, seen from below the sea to orbit, under any sun.

use super::line::Line;
use super::stage::{SCREEN, Stage, eye, merged, small, weather};
use serde_json::{Value, json};
use skycell_server::frame_loop::StillPicture;
use std::f64::consts::PI;

/// Airs at the ends of what the document allows, and the Earth's.
fn airs() -> Vec<(&'static str, Value)> {
    vec![
        ("the Earth's", json!({})),
        (
            "none",
            json!({"aerosol_optical_depth": 0, "rayleigh_density": 0, "ozone_dobson": 0}),
        ),
        (
            "thickest",
            json!({"aerosol_optical_depth": 5, "rayleigh_density": 20, "ozone_dobson": 2000}),
        ),
        (
            "thickest and flattest",
            json!({"aerosol_optical_depth": 5, "rayleigh_density": 20, "aerosol_scale_height_m": 200,
                "rayleigh_scale_height_m": 200, "aerosol_asymmetry": 0.95}),
        ),
        (
            "highest",
            json!({"aerosol_scale_height_m": 20000, "rayleigh_scale_height_m": 20000, "aerosol_asymmetry": -0.95}),
        ),
        (
            "black aerosol",
            json!({"aerosol_single_scattering_albedo": 0, "aerosol_angstrom_exponent": 4}),
        ),
        (
            "white aerosol",
            json!({"aerosol_single_scattering_albedo": 1, "aerosol_angstrom_exponent": -1}),
        ),
    ]
}

const SUNS_DEG: [f64; 7] = [-90.0, -18.0, -6.0, -0.1, 0.1, 30.0, 90.0];
const ALTITUDES_M: [f64; 5] = [-100.0, 0.0, 2_000.0, 60_000.0, 400_000.0];
const RADII_M: [f64; 3] = [1.0e4, 6.36e6, 1.0e8];

fn brightest(picture: &StillPicture) -> f64 {
    let rgb = picture.linear.chunks_exact(4).flat_map(|p| &p[..3]);
    rgb.fold(0.0f64, |a, b| a.max((*b).into()))
}

fn document(air: &Value, elevation_deg: f64, radius_m: f64) -> Value {
    let model = merged(json!({"model": "physical"}), air.clone());
    weather(json!({"layers": [], "atmosphere": model,
        "planet": {"radius_m": radius_m, "ground_albedo": 0},
        "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 90, "irradiance_w_per_m2_nm": [1, 1, 1]}}))
}

/// Finite and nothing negative; where a sun that is up stands over air that scatters, the picture that holds horizon, sky
/// and ground is not black.
pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("air");
    for (index, (name, air)) in airs().into_iter().enumerate() {
        for (turn, elevation_deg) in SUNS_DEG.into_iter().enumerate() {
            let radius_m = RADII_M[(index + turn) % 3];
            stage.scene(&document(&air, elevation_deg, radius_m));
            for altitude_m in ALTITUDES_M {
                let camera = eye([0.0, altitude_m, 0.0], 60.0, 0.0, 120.0);
                let picture = stage.look(camera, small(), SCREEN);
                let what = format!(
                    "{name} around {radius_m} m, sun at {elevation_deg}°, from {altitude_m} m"
                );
                line.picture(&what, &picture);
                // Seen from orbit, small planets fill little of the picture and great ones all below it.
                if elevation_deg > 0.0 && name != "none" && altitude_m < 1e5 {
                    let seen = brightest(&picture);
                    line.is(format!("{what}: black, {seen:e}"), seen > 1e-5);
                }
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
        let air = json!({"aerosol_optical_depth": 0, "ozone_dobson": 0, "rayleigh_density": 20,
            "rayleigh_scale_height_m": scale_height_m});
        // Blue, of which most is scattered.
        let blue_depth = 20.0 * 1.240_62e-6 / 0.44f64.powi(4) * scale_height_m;
        stage.scene(&document(&air, 90.0, 6.36e6));
        let camera = eye([0.0, 400_000.0, 0.0], 0.0, -90.0, 2.0);
        let picture = stage.look(camera, small(), SCREEN);
        line.picture(format!("scale height {scale_height_m} m"), &picture);
        let middle = picture.linear.len() / 8 * 4 + 2;
        let albedo = PI * f64::from(picture.linear[middle]);
        // Eddington's two streams over black ground, where nothing is lost and light scatters evenly: τ / (τ + 4/3).
        let two_stream = blue_depth / (blue_depth + 4.0 / 3.0);
        line.holds(
            format!("scale height {scale_height_m} m: {albedo} for {two_stream}"),
            (albedo / two_stream - 1.0).abs(),
            0.5,
        );
    }
    line
}

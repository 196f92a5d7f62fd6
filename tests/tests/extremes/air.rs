//! Air that is opaque. That air at the ends of all ranges is finite and never negative is among the tests of `atmosphere`.

use super::line::Line;
use super::stage::{SCREEN, Stage, eye, small, weather};
use serde_json::json;
use std::f64::consts::PI;

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

//! The sun from nadir to zenith, on the horizon, and in the middle of the picture.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, pixel, size, slab, small, weather};
use serde_json::json;
use skycell_reference::sky::limb;
use skycell_tests::numbers::U;
use std::f64::consts::PI;

/// Angular radius of the sun, deg.
const RADIUS_DEG: f64 = 0.2666;

const ELEVATIONS_DEG: [f64; 17] = [
    -90.0,
    -45.0,
    -18.0,
    -6.0,
    -2.0,
    -1.0,
    -RADIUS_DEG,
    -1e-6,
    0.0,
    1e-6,
    RADIUS_DEG,
    1.0,
    10.0,
    45.0,
    80.0,
    89.9999,
    90.0,
];

/// Towards the sun, away from it and up, with both renderers.
pub(crate) fn anywhere(stage: &mut Stage) -> Line {
    let mut line = Line::new("sun");
    for elevation_deg in ELEVATIONS_DEG {
        stage.scene(&weather(json!({"sun": {"elevation_deg": elevation_deg}})));
        for (yaw_deg, pitch_deg) in [(150.0, elevation_deg), (330.0, 5.0), (0.0, 90.0)] {
            for renderer in [SCREEN, CACHED] {
                let camera = eye([0.0, 2.0, 0.0], yaw_deg, pitch_deg, 60.0);
                let picture = stage.look(camera, small(), renderer);
                let what =
                    format!("{renderer:?}, sun at {elevation_deg}°, view {yaw_deg}° {pitch_deg}°");
                line.picture(&what, &picture);
                // The sky is lit down to -5.74°, the highest cloud by the sun over its own horizon down to -2.1°.
                if elevation_deg <= -6.0 {
                    let brightest = picture
                        .linear
                        .chunks_exact(4)
                        .flat_map(|p| &p[..3])
                        .fold(0.0f32, |a, b| a.max(*b));
                    line.holds(format!("{what}: night"), brightest.into(), 1e-30);
                }
            }
        }
    }
    line
}

/// Radiance of the disc, E / (2π (1 - cos r)) times what its limb leaves the middle, through the middle of a picture, behind nothing and behind a known
/// transmittance; and the disc's irradiance in a picture that shows all of it.
pub(crate) fn along_the_ray(stage: &mut Stage) -> Line {
    let mut line = Line::new("sun along the ray");
    let disc_sr = 4.0 * PI * (0.5 * RADIUS_DEG.to_radians()).sin().powi(2);
    // Straight up through 1000 m; the steps fit the slab, so that its optical depth is exact.
    for (depth, elevation_deg) in [(1e-8, 90.0f64), (1.0, 90.0), (10.0, 90.0), (1.0, 30.0)] {
        stage.scene(&slab(json!({
            "sun": {"elevation_deg": elevation_deg},
            "layers": [{"base_altitude_m": 1000, "top_altitude_m": 2000, "extinction_per_m": depth / 1000.0,
                "density": {"model": "homogeneous"}}]
        })));
        let camera = eye([0.0, 0.0, 0.0], 150.0, elevation_deg, 2.0);
        let mut settings = super::stage::settings(SCREEN);
        settings.march.jitter = false;
        settings.march.early_exit = false;
        settings.march.steps = 25;
        let picture = stage.look_with(camera, size(9, 9), &settings);
        line.picture(format!("depth {depth} at {elevation_deg}°"), &picture);
        let sine = elevation_deg.to_radians().sin();
        let along = depth / sine;
        let seen = pixel(&picture, 4, 4)[0];
        // The middle of the disc is brighter than its mean, by its limb.
        let disc = limb(1.0).x * (-along).exp() / disc_sr;
        // In-scattered light is between nothing and all that the opacity can scatter towards the eye, 1 - T over 4π; a
        // slanted ray begins and ends within a step.
        let scattered = -(-along).exp_m1() / (4.0 * PI);
        let steps = if elevation_deg == 90.0 {
            0.0
        } else {
            0.001 * depth * 40.0 * 1.2
        };
        line.holds(
            format!("disc behind depth {along}"),
            (seen - disc).abs(),
            disc * (steps.exp_m1() + 64.0 * U * (1.0 + along)) + scattered,
        );
    }
    for elevation_deg in [0.5, 10.0, 45.0, 90.0] {
        stage.scene(&slab(
            json!({"sun": {"elevation_deg": elevation_deg}, "layers": []}),
        ));
        let picture = stage.look(
            eye([0.0, 0.0, 0.0], 150.0, elevation_deg, 1.0),
            size(64, 64),
            SCREEN,
        );
        line.picture(format!("whole disc at {elevation_deg}°"), &picture);
        let half = 0.5f64.to_radians().tan();
        let mut irradiance = 0.0;
        for row in 0..64 {
            for column in 0..64 {
                let [x, y] =
                    [column, row].map(|i| half * (2.0 * (f64::from(i) + 0.5) / 64.0 - 1.0));
                // Solid angle of a pixel of a plane at distance 1.
                let pixel_sr = (2.0 * half / 64.0).powi(2) / (1.0 + x * x + y * y).powf(1.5);
                irradiance += pixel(&picture, column, row)[0] * pixel_sr;
            }
        }
        // The rim's smoothstep is 1.4 pixels wide and 107 long: the midpoint rule knows its area to the variation of a
        // pixel's share, 1/12 of a pixel each, of 916 pixels' disc; half of them cancel by symmetry.
        line.holds(
            format!("irradiance of the disc at {elevation_deg}°"),
            (irradiance - 1.0).abs(),
            0.01,
        );
    }
    line
}

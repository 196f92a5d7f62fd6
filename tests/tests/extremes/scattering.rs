//! Light that is scattered many times, from clouds thin as nothing to solid ones, under any sun: as the f64 twin has it, and
//! in a furnace, where everything shines alike, no cloud is seen.

use super::line::Line;
use super::stage::{Stage, ray, slab};
use glam::DVec3;
use serde_json::json;
use skycell_protocol::Scene;
use skycell_protocol::scene::FITTED;
use skycell_reference::march::{MarchSteps, gather_layer};
use skycell_reference::{Approximations, Field, Ray, World, WorldSettings};
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::U;
use std::sync::Arc;

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("scattering");
    for exponent in [-8, -4, -2, -1, 0, 1, 2, 4, 6] {
        for elevation_deg in [-90.0, 0.0, 5.0, 45.0, 90.0] {
            for g in [-0.999, 0.0, 0.85] {
                let document = slab(json!({
                    "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 20},
                    "light": {"phase": {"model": "hg", "g": g}, "octaves": 4, "ambient": 1, "sun_steps": 6,
                        "sun_march_distance_m": 1500},
                    "layers": [{"base_altitude_m": 1000, "top_altitude_m": 2000,
                        "extinction_per_m": 10f64.powi(exponent) / 1000.0, "single_scattering_albedo": 1,
                        "density": {"model": "homogeneous"}}],
                }));
                stage.scene(&document);
                let direction = DVec3::new(0.3, 0.9, 0.2).normalize();
                let mut settings = MarchSettings::plain(25);
                settings.ambient = true;
                let found = stage.rays(
                    DVec3::ZERO,
                    vec![ray([0.0; 3], direction.to_array())],
                    settings,
                );
                let layer = &found.layers[0][0];
                line.case();
                let what = format!("depth 1e{exponent}, sun at {elevation_deg}, g {g}");
                // Both phases are broader than the droplets', which is at most (1 + g) / (4π (1 - g)²).
                let sharp = f64::abs(g) * FITTED.forward_eccentricity;
                let peak = (1.0 + sharp) / (4.0 * std::f64::consts::PI * (1.0 - sharp).powi(2));
                let most = (FITTED.forward_strength + FITTED.diffuse_strength) * peak;
                line.layer(&what, layer, most, 1.0);
                let scene = Scene::from_json(&document).expect("a scene");
                let world = World::new(
                    &scene,
                    Arc::new(Field::default()),
                    WorldSettings {
                        approximations: Approximations::ALL,
                        ..WorldSettings::default()
                    },
                )
                .expect("a world");
                let steps = MarchSteps {
                    steps: 25,
                    early_exit: false,
                    ..MarchSteps::default()
                };
                let eye = Ray::new(DVec3::ZERO, direction).expect("a ray");
                let (twin, _) = gather_layer(&world, &world.layers()[0], &eye, &steps);
                // A place that is known to a tenth of a millimetre of a slab's thousand metres moves a sample across its
                // edge in no case here; what is left are the exponentials of the sun's depth, each known to its argument's
                // rounding, which counts where its value does.
                let rounding = 2e-3;
                for (name, found, twin) in [
                    ("octaves", layer.octaves, twin.octaves),
                    ("ambient", layer.ambient, twin.ambient),
                ] {
                    line.holds(
                        format!("{what}: {name}"),
                        (f64::from(found) - twin).abs(),
                        rounding * twin + 1e-12,
                    );
                }
            }
        }
    }
    line
}

/// Sky and ground of radiance 1 and clouds that absorb nothing: every ray sees 1.
pub(crate) fn furnace(stage: &mut Stage) -> Line {
    let mut line = Line::new("furnace");
    for exponent in [-8, -3, -1, 0, 1, 3] {
        stage.scene(&slab(json!({
            "sun": {"irradiance_w_per_m2_nm": [0, 0, 0]},
            "atmosphere": {"radiance_w_per_m2_nm_sr": [1, 1, 1]},
            "light": {"octaves": 4, "ambient": 1, "sun_steps": 6, "sun_march_distance_m": 1500},
            "layers": [{"base_altitude_m": 1000, "top_altitude_m": 2000,
                "extinction_per_m": 10f64.powi(exponent) / 1000.0, "single_scattering_albedo": 1,
                "density": {"model": "homogeneous"}}],
        })));
        let mut settings = MarchSettings::plain(25);
        settings.ambient = true;
        let rays = [[0.0, 1.0, 0.0], [0.9, 0.4, 0.1], [1.0, 0.1, 0.0]].map(|d| ray([0.0; 3], d));
        let found = stage.rays(DVec3::ZERO, rays.to_vec(), settings);
        for (index, radiance) in found.radiance.iter().enumerate() {
            line.case();
            line.holds(
                format!("depth 1e{exponent}, ray {index}"),
                (f64::from(radiance[0]) - 1.0).abs(),
                64.0 * U,
            );
        }
    }
    line
}

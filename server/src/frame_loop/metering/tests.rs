//! What meters read.

use super::*;
use crate::config::RenderConfig;
use crate::frame_loop::{StillRenderer, StillSettings};
use serde_json::{Value, json};
use skycell_protocol::{RendererKind, Scene};

/// Steps of the marches.
const STEPS: u32 = 32;
/// Reading and picture differ in where their rays start and in what the cache rounds, stops.
const APART_EV: f64 = 0.02;

fn still(document: &Value) -> StillRenderer {
    let scene = Scene::from_json(document).expect("a scene");
    let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
    StillRenderer::new(RenderConfig::new(noise.into()), Arc::new(scene), &[]).expect("a device")
}

fn settings(renderer: RendererKind) -> StillSettings {
    StillSettings {
        renderer,
        samples: 4,
        march: crate::march::MarchSettings {
            steps: STEPS,
            ..crate::march::MarchSettings::default()
        },
        ..StillSettings::default()
    }
}

/// The oracle has no cache, no domes and no near part: what is above the eye, by rays alone.
#[test]
fn in_a_layer_exposure_follows_the_light_that_is_seen_from_there() {
    let layer = |share: f64, auto: Value| {
        let sun = [1.474, 1.8504, 1.91198].map(|value| value * share);
        json!({"version": 1, "sun": {"irradiance_w_per_m2_nm": sun}, "wind": {"speed_m_per_s": 0},
            "tone": {"auto_exposure": auto},
            "layers": [{"name": "low", "base_altitude_m": 1000, "top_altitude_m": 2000,
                "density": {"model": "weather", "coverage": 0.6, "type": 0.6}}]})
    };
    let position_m = [200.0, 1500.0, -300.0];
    let size = FrameSize::new(EDGE, EDGE).expect("a size");
    for share in [1.0, 1.0 / 32.0] {
        let eye = Camera::new(position_m, 0.0, 5.0, 60.0).expect("a camera");
        let mut metered = still(&layer(share, json!({})));
        let cached = settings(RendererKind::Cached);
        let picture = metered.render_with(eye, size, &cached, |_| {});
        picture.expect("a picture");
        let cells = &metered.renderer.active_cells;
        let cell = cells.values().next().expect("a cell");
        assert_ne!(metered.renderer.near_layers_of(cell), 0, "in the layer");
        let found = cell.auto_exposure_ev();
        let up = Camera::new(position_m, 0.0, 90.0, FOV_DEG).expect("a camera");
        let rays = settings(RendererKind::ScreenSpace);
        let seen = still(&layer(share, Value::Null)).render_with(up, size, &rays, |_| {});
        let wanted = adaptation::MIDDLE.log2() - mean_log2(&seen.expect("a picture").linear);
        println!("sun × {share}: {found:.3} EV, by rays {wanted:.3}");
        assert!(
            (found - wanted).abs() <= APART_EV,
            "{found} instead of {wanted}"
        );
    }
}

#[test]
fn the_mean_is_geometric_and_weighs_solid_angles() {
    let even = [0.2f32, 0.2, 0.2, 1.0].repeat((EDGE * EDGE) as usize);
    let exact = (0.2 * EXPOSURE_AT_ZERO_EV).log2();
    assert!((mean_log2(&even) - exact).abs() < 1e-6);
    // Half of the sky sixteen times as bright: half of four stops.
    let halves: Vec<f32> = (0..EDGE * EDGE)
        .flat_map(|i| {
            let value = if i % EDGE < EDGE / 2 { 0.05 } else { 0.8 };
            [value, value, value, 1.0]
        })
        .collect();
    assert!((mean_log2(&halves) - exact).abs() < 1e-6);
}

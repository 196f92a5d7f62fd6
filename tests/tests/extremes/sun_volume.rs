//! The sun volume at its ends: suns at the zenith, low and set, worlds without curvature, cells far apart and a month of
//! wind; slabs from thin to solid, alone and above one another, by their closed forms.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, relative_l2, settings, slab, small, weather};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::SunDepth;
use skycell_server::frame_loop::StillSettings;
use skycell_server::march::MarchSettings;
use skycell_server::sun_volume::SunVolumeSize;
use skycell_tests::numbers::U;

/// Steps through a slab.
const STEPS: u32 = 25;

/// Small, so that many cases cost little.
fn size() -> SunVolumeSize {
    SunVolumeSize {
        columns: 32,
        slices: 9,
        levels: 3,
        spacing_m: 200.0,
        near_steps: Some(0),
        near_columns: 1.0,
    }
}

fn with_volume(march: MarchSettings) -> MarchSettings {
    MarchSettings {
        sun_depth: Some(SunDepth::Volume),
        sun_volume: size(),
        ..march
    }
}

fn pictures(renderer: skycell_protocol::RendererKind) -> StillSettings {
    let plain = settings(renderer);
    StillSettings {
        march: with_volume(plain.march),
        ..plain
    }
}

/// A slab of an optical depth, and another above it.
fn slabs(elevation_deg: f64, depth: f64, above: f64) -> Value {
    // The thickest needs 100 km at the document's highest extinction.
    let thickness_m = if depth > 1e6 { 1e5 } else { 1e3 };
    let layer = |base_m: f64, thickness_m: f64, depth: f64| {
        json!({"name": format!("at {base_m} m"), "base_altitude_m": base_m, "top_altitude_m": base_m + thickness_m,
            "extinction_per_m": depth / thickness_m, "single_scattering_albedo": 1,
            "density": {"model": "homogeneous"}})
    };
    let mut layers = vec![layer(thickness_m, thickness_m, depth)];
    if above > 0.0 {
        layers.push(layer(3000.0, 1000.0, above));
    }
    slab(json!({"sun": {"elevation_deg": elevation_deg}, "layers": layers}))
}

/// Single scattering straight up through the lower slab, as the steps have it: the sun's depth is known in their middles.
fn stepped(depth: f64, above: f64, mu_sun: f64) -> f64 {
    let step = depth / f64::from(STEPS);
    (0..STEPS)
        .map(|i| {
            let seen = f64::from(i) * step;
            let lit = (depth - seen - 0.5 * step + above) / mu_sun;
            (-seen).exp() * -(-step).exp_m1() * (-lit).exp()
        })
        .sum()
}

pub(crate) fn anywhere(stage: &mut Stage) -> Line {
    let mut line = Line::new("sun volume");
    for planet in [json!({}), json!("flat")] {
        for elevation_deg in [90.0, 45.0, 10.0 + 1e-9, 10.0, 1.0, 0.0, -5.0] {
            let mut scene = weather(json!({"sun": {"elevation_deg": elevation_deg}}));
            scene["planet"] = planet.clone();
            stage.scene(&scene);
            for renderer in [SCREEN, CACHED] {
                let camera = eye([0.0, 2.0, 0.0], 330.0, 15.0, 60.0);
                let picture = stage.look_with(camera, small(), &pictures(renderer));
                line.picture(
                    format!("{renderer:?}, {planet} planet, sun at {elevation_deg}°"),
                    &picture,
                );
            }
        }
    }
    // Columns stand in the clouds' own field: whole periods of clouds (840 km) and strips (1.6 km) away other columns hold the
    // same. Feet are rounded in f32 to U of 25 km, 1.5 mm, of which density feels 0.1 per metre.
    stage.scene(&weather(json!({})));
    let look = |stage: &mut Stage, x_m: f64| {
        let camera = eye([x_m, 2.0, 0.0], 90.0, 25.0, 60.0);
        stage.look_with(camera, small(), &pictures(SCREEN))
    };
    let here = look(stage, 0.0);
    for away in [1.0, 11.0, -11.0] {
        let there = look(stage, away * 1_680_000.0);
        let what = format!("{} km away", away * 1680.0);
        line.picture(&what, &there);
        line.holds(&what, relative_l2(&here, &there), 3e-4);
    }
    // An eye that goes along with a month of wind sees the same columns.
    let seconds = 30.0 * 86_400.0;
    stage.at_time(seconds);
    let there = look(stage, 5.0 * seconds);
    stage.at_time(0.0);
    line.picture("a month of wind", &there);
    line.holds("a month of wind", relative_l2(&here, &there), 3e-4);
    line
}

/// Straight up through slabs whose amount of cloud towards the sun is linear in altitude, which the volume holds exactly.
pub(crate) fn through_slabs(stage: &mut Stage) -> Line {
    let mut line = Line::new("sun volume through slabs");
    for elevation_deg in [90.0f64, 30.0, 11.0] {
        for (depth, aboves) in [
            (1e-8, [0.0, 1e-3, 2.0].as_slice()),
            (1.0, &[0.0, 1e-3, 2.0]),
            (10.0, &[0.0, 2.0]),
            (1e6, &[0.0, 2.0]),
            (1e8, &[0.0]),
        ] {
            for above in aboves.iter().copied() {
                stage.scene(&slabs(elevation_deg, depth, above));
                let up = ray([0.0; 3], [0.0, 1.0, 0.0]);
                let march = with_volume(MarchSettings::plain(STEPS));
                let found = stage.rays(DVec3::ZERO, vec![up], march);
                let layer = &found.layers[0][0];
                let what = format!("sun {elevation_deg}°, depth {depth:e} under {above}");
                line.case();
                line.layer(&what, layer, 0.0, 0.0);
                let mu_sun = elevation_deg.to_radians().sin();
                let single = stepped(depth, above, mu_sun);
                // The place among slices is known to 8 U of the texture's (two layers, three levels, nine slices), which
                // counts as so much depth; sums and exponentials of f32 as in "optical depth".
                let read = 8.0 * U * 54.0 / 8.0 * (depth + above) / mu_sun;
                let rounding = 128.0 * U * (1.0 + (depth + above) / mu_sun);
                line.holds(
                    format!("{what}: single scattering"),
                    (f64::from(layer.single) - single).abs(),
                    single * (read + rounding).exp_m1().min(1e3) + 1e-30,
                );
            }
        }
    }
    line
}

//! Clear air, the sun's disc, the ground, and clouds over them.

use super::support::{SceneProbe, judge};
use glam::DVec3;
use serde_json::json;
use skycell_reference::Ray;
use skycell_reference::sky::{ClearSky, limb};
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_tests::numbers::{
    Random, U, distance, grazes_ground, shell_bound, shell_twin, unit, wide, worst,
};
use std::f64::consts::PI;

const NONE: [f32; 4] = [0.0; 4];

fn probe(elevation_deg: f64) -> SceneProbe {
    SceneProbe::open(
        &json!({"version": 1, "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 90}}),
        true,
    )
}

fn directions(count: usize, lowest: f64) -> Vec<[f32; 4]> {
    let mut random = Random(31);
    (0..count)
        .map(|index| {
            let sine = match index % 4 {
                0 => random.one_of(&[0.0, 1e-6, 1e-3, 0.5, 1.0, lowest]),
                1 => random.between(lowest.max(-0.05), 0.05),
                _ => random.between(lowest, 1.0),
            };
            let yaw = random.between(0.0, 2.0 * PI);
            let across = (1.0 - sine * sine).max(0.0).sqrt();
            let direction = unit([across * yaw.cos(), sine, across * yaw.sin()]).map(|v| v as f32);
            [direction[0], direction[1], direction[2], 0.0]
        })
        .collect()
}

/// Relative budget of clear_sky's radiance in a channel, where X are the columns towards viewer and sun.
fn sky_bound(view: f64, sun: f64) -> f64 {
    // e^-x is known to 3 + 2 x units of 2 U. The columns feel the cosine's rounding by up to 80 U near the horizon, where
    // the air mass of the aerosol changes fastest. The slab's quotient divides by the columns' difference, by the series
    // below 0.02, whose error is its next term, d³/24.
    let columns = view.max(sun);
    let exponentials = (4.0 + 80.0 * columns) * 2.0 * U;
    let quotient = 2.0 + 1.0 / (view - sun).abs().max(0.02);
    // The aerosol's phase, g = 0.76, feels 1 - µ's rounding of 4 U by 3 g / (1 - g)² = 40.
    exponentials * quotient + 0.02f64.powi(3) / 24.0 + (64.0 + 160.0) * U
}

fn columns(sky: &ClearSky) -> [f64; 3] {
    sky.transmittance.to_array().map(|t| -t.ln())
}

#[test]
fn the_clear_sky_is_its_formula_from_dawn_to_noon_and_down_to_the_horizon() {
    for elevation_deg in [-3.0, 0.0, 2.0, 40.0, 90.0] {
        let probe = probe(elevation_deg);
        let light = probe.world.light();
        let points: Vec<FieldPoint> = directions(10_000, 0.0)
            .into_iter()
            .map(|d| [d, NONE, NONE, NONE])
            .collect();
        let values = probe.ask(FieldQuestion::ClearSky, &points);
        let sun = columns(&light.clear_sky(light.sun_direction));
        let check = |mirrored: bool| {
            worst(points.iter().zip(&values).flat_map(|(point, value)| {
                let mut direction = DVec3::from_array(unit(wide(point[0])));
                if mirrored {
                    direction.y = (1.1 * direction.y).min(1.0);
                }
                let sky = light.clear_sky(direction);
                let view = columns(&sky);
                [0, 1, 2]
                    .into_iter()
                    .flat_map(|c| {
                        let radiance = sky.radiance.to_array()[c];
                        let transmittance = sky.transmittance.to_array()[c];
                        [
                            (
                                (f64::from(value[0][c]) - radiance).abs(),
                                radiance * sky_bound(view[c], sun[c]) + 1e-30,
                            ),
                            (
                                (f64::from(value[1][c]) - transmittance).abs(),
                                transmittance * (4.0 + 80.0 * view[c]) * 2.0 * U,
                            ),
                        ]
                    })
                    .collect::<Vec<_>>()
            }))
        };
        // Planted: directions a tenth too steep.
        judge(
            &format!("clear sky, sun at {elevation_deg}°"),
            points.len(),
            check(false),
            check(true),
        );
    }
}

#[test]
fn air_masses_and_the_suns_disc_are_their_formulas() {
    let probe = probe(40.0);
    let mut random = Random(32);
    let disc = 2.0 * (0.5 * 0.2666f64.to_radians()).sin().powi(2);
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|index| {
            let radius_m = random.one_of(&[1e4, 6.36e6, 1e8, 1e12]);
            let height_m = random.one_of(&[1_200.0, 8_000.0]);
            let mu = if index % 2 == 0 {
                random.one_of(&[-1.0, 0.0, 1e-6, 1e-3, 1.0])
            } else {
                random.unit()
            };
            let angle = disc * random.one_of(&[0.0, 0.5, 0.85, 1.0, 1.15, 2.0])
                + disc * 0.3 * random.unit();
            [
                [radius_m as f32, height_m as f32, mu as f32, angle as f32],
                NONE,
                NONE,
                NONE,
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::AirMassAndDisc, &points);
    let irradiance = probe.world.light().sun_irradiance.x;
    let check = |per_sr: f64, round: bool| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let [radius_m, height_m, mu, angle] = point[0].map(f64::from);
            // The way through a shell of height H from its ground, |o + t d| = R + H, in units of H; flat: 1 / µ.
            let b = radius_m * mu.max(0.0);
            let c = height_m * (2.0 * radius_m + height_m);
            let mass = if round {
                c / (b + (b * b + c).sqrt()) / height_m
            } else {
                1.0 / mu.max(1e-9)
            };
            let t = ((angle / disc - 0.85) / 0.3).clamp(0.0, 1.0);
            let mu = (1.0 - angle / disc).max(0.0).sqrt();
            let radiance =
                (1.0 - t * t * (3.0 - 2.0 * t)) * limb(mu).x * irradiance / (per_sr * disc);
            [
                ((f64::from(value[0][0]) / mass - 1.0).abs(), 16.0 * U),
                // The rim is 0.3 of the disc wide: t is known to 8 U / 0.3 and rises by 1.5.
                (
                    (f64::from(value[1][0]) - radiance).abs(),
                    irradiance / (2.0 * PI * disc) * 64.0 * U,
                ),
            ]
        }))
    };
    // Planted: a flat atmosphere; a disc of π r² with r² twice too small.
    judge(
        "air mass",
        points.len(),
        check(2.0 * PI, true),
        check(2.0 * PI, false),
    );
    judge(
        "disc of the sun",
        points.len(),
        check(2.0 * PI, true),
        check(PI, true),
    );
}

/// Eyes from the ground to space, looking anywhere.
fn eyes(count: usize) -> Vec<FieldPoint> {
    let mut random = Random(33);
    directions(count, -1.0)
        .into_iter()
        .map(|direction| {
            let altitude_m = random.one_of(&[2.0, 500.0, 12_000.0, 400_000.0]);
            let cloud = [
                random.unit(),
                0.3 * random.unit(),
                random.unit(),
                random.one_of(&[0.0, 0.5, 1.0, 1e-3]),
            ];
            let distance_m = random.between(0.0, 1e5) * (1.0 - cloud[3] + 1e-3);
            let d = [direction[0], direction[1], direction[2], distance_m as f32];
            let behind = [random.unit(), random.unit(), random.unit(), 0.0];
            [
                [0.0, altitude_m as f32, 0.0, 0.0],
                d,
                cloud.map(|v| v as f32),
                behind.map(|v| v as f32),
            ]
        })
        .collect()
}

#[test]
fn sky_sun_and_ground_stand_behind_all_clouds() {
    let probe = probe(20.0);
    let light = probe.world.light();
    let points = eyes(12_000);
    let values = probe.ask(FieldQuestion::Background, &points);
    let sun = columns(&light.clear_sky(light.sun_direction));
    let extinction_per_m = light.air_extinction_per_m(0.0).max_element();
    let disc = light.sun_disc_radiance(light.sun_direction);
    let check = |lift_m: f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let (origin, direction) = (wide(point[0]), unit(wide(point[1])));
            // A tangent within rounding may be called either way.
            if grazes_ground(origin, direction) {
                return Vec::new();
            }
            let eye = DVec3::from_array(origin) + DVec3::Y * lift_m;
            let ray = Ray {
                origin_m: eye,
                direction: DVec3::from_array(direction),
            };
            let back = light.background(&ray, ray.direction);
            let on_ground = f64::from(u8::from(back.on_ground));
            let view = columns(&light.clear_sky(ray.direction));
            let twin = shell_twin(origin, direction, 0.0);
            let near_m = shell_bound(origin, direction, 0.0, &twin).near_m;
            let mut pairs = vec![((f64::from(value[0][3]) - on_ground).abs(), 0.5)];
            for c in 0..3 {
                let (radiance, air) = (back.radiance.to_array()[c], back.air.to_array()[c]);
                // The air's own budget; the share of it before the ground is a difference of numbers near 1 times at most
                // 1 / (1 - T); the ground's distance times its extinction; the disc's rim, where it is seen.
                let share = back.air_share.to_array()[c];
                let lit = radiance + air;
                let bound = lit * sky_bound(view[c], sun[c])
                    + air * share * 8.0 * U
                    + lit * extinction_per_m * near_m * (1.0 + share)
                    + if radiance > 2.0 * air + 1.0 {
                        disc.to_array()[c] * 64.0 * U * 8.0
                    } else {
                        0.0
                    };
                pairs.push(((f64::from(value[0][c]) - radiance).abs(), bound));
            }
            pairs
        }))
    };
    // Planted: an eye that stands 100 m higher.
    judge("background", points.len(), check(0.0), check(100.0));
}

#[test]
fn a_cloud_hides_what_is_behind_it_once() {
    let probe = probe(20.0);
    let light = probe.world.light();
    // The function's inputs as the device has them; how they come about is not its matter.
    let given = probe.device.uniform();
    let irradiance = given.sun.irradiance_at_clouds.map(f64::from);
    let mean_radiance = given.sky.mean_radiance.map(f64::from);
    let ground_radiance = given.sky.ground_radiance.map(f64::from);
    let even = f64::from(given.layers[0].single_scattering_albedo) * f64::from(given.light.ambient);
    let air_extinction_per_m = given.layers[0].air_extinction_per_m.map(f64::from);
    let points = eyes(12_000);
    let values = probe.ask(FieldQuestion::LayerOver, &points);
    let sun = columns(&light.clear_sky(light.sun_direction));
    let check = |twice: bool| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let direction = DVec3::from_array(unit(wide(point[1])));
            let [single, octaves, ambient, transmittance] = point[2].map(f64::from);
            let behind = wide(point[3]);
            let sky = light.clear_sky(direction);
            let view = columns(&sky);
            let x = 0.5 * distance(direction.to_array(), light.sun_direction.to_array()).powi(2);
            let phase = probe
                .world
                .phase()
                .over_disc_per_sr(x, light.sun_one_minus_mu);
            let seen_m = f64::from(point[1][3]) / (1.0 - transmittance + 1e-3);
            let opacity = 1.0 - transmittance;
            [0, 1, 2].map(|c| {
                let kept = (-seen_m * air_extinction_per_m[c]).exp();
                let whole = sky.transmittance.to_array()[c];
                let share = ((1.0 - kept) / (1.0 - whole)).min(1.0);
                let sunlit = irradiance[c] * (phase * single + octaves);
                let from_below = (even * opacity - ambient).max(0.0);
                let lit = sunlit + mean_radiance[c] * ambient + ground_radiance[c] * from_below;
                let air = sky.radiance.to_array()[c];
                // Planted: opacity counted twice.
                let lit_seen = if twice { lit * opacity } else { lit };
                let exact = lit_seen * kept + air * share * opacity + behind[c] * transmittance;
                // The phase of droplets of 20 µm has a base of (1 - g)² = 3e-5 at its peak, of which 1 - µ's 4 U times the
                // angle's cosine is felt by 3 / base; elsewhere nothing cancels but 1 - kept, times 1 / (1 - T).
                let base = 3e-5 + 2.0 * x;
                let angle_error = 4.0 * U * (2.0 * x).sqrt() + 16.0 * U * U;
                // g = 0.9946 itself is rounded to f32, and 1 - g with it.
                let phase_error = (64.0 + 3.0 / (1.0 - 0.9946)) * U + 3.0 * angle_error / base;
                // The column's transmittance, as in sky_bound, is subtracted from 1; so is what the air keeps.
                let share_error = ((4.0 + 80.0 * view[c]) * 2.0 * whole + 8.0) * U / (1.0 - whole);
                // Compilers may add 1 and 1e-3 before they subtract the transmittance: the distance is then rounded at 1.
                let way = seen_m * air_extinction_per_m[c] * kept * 2.0 * U / (opacity + 1e-3);
                let bound = (sunlit * phase_error + lit * 64.0 * U) * kept
                    + air * opacity * (sky_bound(view[c], sun[c]) + share_error)
                    + way * (lit + air * opacity / (1.0 - whole))
                    + (lit + air) * 64.0 * U
                    + behind[c] * 4.0 * U;
                ((f64::from(value[0][c]) - exact).abs(), bound)
            })
        }))
    };
    judge(
        "cloud over background",
        points.len(),
        check(false),
        check(true),
    );
}

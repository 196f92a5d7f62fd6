//! Proxies that are read from above: where rays meet their surface, and that each ray finds the texel that was marched for it.

use super::support::{Point, Probe, judge};
use glam::DVec3;
use skycell_server::cache::ProxySphere;
use skycell_server::march::{CellFrame, Surface};
use skycell_server::probe::FunctionQuestion as Question;
use skycell_tests::numbers::{RADIUS_M, Random, U, worst};
use std::f64::consts::PI;

/// Rays from above a sphere, down to it and over it, from an eye beside the anchor.
fn rays() -> Vec<Point> {
    let mut random = Random(17);
    (0..60_000)
        .map(|_| {
            let sphere_m = random.one_of(&[200.0, 2_200.0, 8_000.0]);
            // A sphere is in the middle of a layer, and whoever sees it from above is over the layer's top.
            let height_m = random.one_of(&[20.0, 1_000.0, 2_000.0, 1e4, 1e5, 4e5]);
            let eye_m = sphere_m + height_m;
            // Of that height so much is below the top, and of what is above it an anchor may be half lower.
            let under_top = random.between(0.0, 0.9);
            let anchor_least = 0.5 * (1.0 + under_top) + 0.05 * (1.0 - under_top);
            let anchor_m = sphere_m + height_m * random.between(anchor_least, 1.4);
            let aside_m = random.between(0.0, 1.0) * (0.1 * height_m).min(4_000.0);
            // Where the ray touches the sphere, and the top.
            let touching = ((RADIUS_M + sphere_m) / (RADIUS_M + eye_m)).acos();
            let lowest = (1.0 - under_top).sqrt() * touching;
            let dip = match (random.unit() * 4.0) as u32 {
                0 => random.between(lowest, PI / 2.0),
                1 => random.one_of(&[touching, lowest, PI / 2.0]),
                2 => random.between(lowest, 1.2 * touching),
                _ => (touching * (1.0 + random.between(-1e-3, 1e-3))).max(lowest),
            };
            let yaw = random.between(0.0, 2.0 * PI);
            let direction = [dip.cos() * yaw.cos(), -dip.sin(), dip.cos() * yaw.sin()];
            // What is at an altitude beside the middle is a little lower there.
            let fall_m = aside_m * aside_m / (2.0 * (RADIUS_M + eye_m));
            [
                [anchor_m, aside_m, eye_m - fall_m, RADIUS_M].map(|v| v as f32),
                [direction[0], direction[1], direction[2], sphere_m].map(|v| v as f32),
            ]
        })
        .collect()
}

fn place(point: &Point) -> (ProxySphere, DVec3, DVec3) {
    let [[anchor_y, x, y, _], [dx, dy, dz, sphere_m]] = point.map(|p| p.map(f64::from));
    let eye = DVec3::new(x, y, 0.0);
    let (frame, anchor) = (
        CellFrame::at(DVec3::ZERO, RADIUS_M),
        DVec3::new(0.0, anchor_y, 0.0),
    );
    let Surface::ShellFromAbove { altitude_m, .. } = Surface::shell(&frame, anchor, sphere_m)
    else {
        panic!("the anchor is above");
    };
    let sphere = ProxySphere {
        frame,
        anchor,
        // As the probe has it.
        surface: Surface::ShellFromAbove {
            altitude_m,
            least_m: 1e-3,
        },
        top_m: Some(sphere_m),
        reference: eye,
        seen_between_m: None,
        band: None,
    };
    (sphere, eye, DVec3::new(dx, dy, dz))
}

/// Where rays touch a surface, the place along them is known to the root of a rounding: as an angle, rad, for who looks at it
/// from beside the anchor.
fn touching(point: &Point, place_m: f64, distance_m: f64) -> f64 {
    let (sphere, eye, _) = place(point);
    U.sqrt() * place_m * (eye - sphere.anchor).length() / distance_m.max(1.0).powi(2)
}

#[test]
fn a_ray_from_above_reads_the_texel_that_was_marched_for_it() {
    let points = rays();
    let values = Probe::open().ask(Question::ProxyFromAbove, &points);
    // Angles between where a ray goes and where the texel's goes that it reads, as f32 knows directions and places: some
    // roundings of a place, seen from the distance of the surface.
    let bound = |point: &Point, distance_m: f64| {
        let place_m = f64::from(point[0][2]).abs() + distance_m;
        32.0 * U * (1.0 + place_m / distance_m.max(1.0)) + touching(point, place_m, distance_m)
    };
    let gpu = worst(points.iter().zip(&values).map(|(point, value)| {
        let (_, _, direction) = place(point);
        let [x, y, z, distance_m] = value.map(f64::from);
        let apart = (DVec3::new(x, y, z) - direction.normalize()).length();
        (apart, bound(point, distance_m))
    }));
    // The far side of the sphere, as from below.
    let defect = worst(points.iter().map(|point| {
        let (sphere, eye, direction) = place(point);
        let far_m =
            sphere
                .frame
                .distance_to_shell_m(eye, direction.normalize(), point[1][3].into());
        let address = (eye + direction * far_m - sphere.anchor).normalize();
        let texel = (sphere.point(address) - eye).normalize();
        (
            (texel - direction.normalize()).length(),
            bound(point, far_m.abs()),
        )
    }));
    judge("texel of a ray from above", points.len(), gpu, defect);
}

#[test]
fn the_surface_seen_from_above_is_where_its_twin_has_it() {
    // An anchor that is higher than the eye sees places behind the eye's limb: there rays that hit the sphere and those that pass
    // over it are far apart.
    let points: Vec<Point> = rays()
        .into_iter()
        .filter(|point| point[0][0] < point[0][2])
        .collect();
    let values = Probe::open().ask(Question::ProxyFromAbove, &points);
    // Compared by the direction from the anchor, which is what a texel is found by: along a ray that grazes, the place itself
    // hangs on the last digit.
    let apart = |point: &Point, distance_m: f64| {
        let (sphere, eye, direction) = place(point);
        let direction = direction.normalize();
        let twin_m = (sphere.point_along(eye, direction) - eye).dot(direction);
        let from_anchor = |m: f64| (eye + direction * m - sphere.anchor).normalize_or_zero();
        let place_m = f64::from(point[0][2]).abs() + twin_m;
        let bound = 32.0 * U * (1.0 + place_m / twin_m.max(1.0)) + touching(point, place_m, twin_m);
        (
            (from_anchor(distance_m) - from_anchor(twin_m)).length(),
            bound,
        )
    };
    let gpu = worst(
        points
            .iter()
            .zip(&values)
            .map(|(p, v)| apart(p, v[3].into())),
    );
    // Where its own ray comes closest, and not where one from the anchor does.
    let defect = worst(points.iter().map(|point| {
        let (_, eye, direction) = place(point);
        let closest_m = -direction.dot(eye + DVec3::Y * RADIUS_M);
        apart(point, closest_m)
    }));
    judge("surface from above", points.len(), gpu, defect);
}

//! Homogeneous shapes in the field's coordinates (x, altitude, z), and where rays meet them.

use crate::Ray;
use crate::shell::{Globe, Interval};
use glam::{DVec2, DVec3};

/// Most parts of a ray inside a box or a ball: a shell's inside is not convex, so there may be two.
pub type Parts = [Interval; 2];

/// Keeps what of each part lies in an interval.
fn clipped(parts: Parts, by: Interval) -> Parts {
    let mut kept = [Interval::EMPTY; 2];
    let mut count = 0;
    for part in parts.map(|part| part.and(by)) {
        if !part.is_empty() {
            kept[count] = part;
            count += 1;
        }
    }
    kept
}

/// Where one coordinate of a line lies between two values.
fn between(origin: f64, direction: f64, low: f64, high: f64) -> Interval {
    if direction == 0.0 {
        return if (low..=high).contains(&origin) {
            Interval::new(f64::NEG_INFINITY, f64::INFINITY)
        } else {
            Interval::EMPTY
        };
    }
    let (a, b) = ((low - origin) / direction, (high - origin) / direction);
    Interval::new(a.min(b), a.max(b))
}

/// The parts of a ray inside a box along the field's axes. `offset_xz_m` leads from the frame to the field.
#[must_use]
pub fn box_parts(
    globe: &Globe,
    ray: &Ray,
    offset_xz_m: DVec2,
    min_m: DVec3,
    max_m: DVec3,
) -> Parts {
    let x = ray.origin_m.x + offset_xz_m.x;
    let z = ray.origin_m.z + offset_xz_m.y;
    let across = between(x, ray.direction.x, min_m.x, max_m.x).and(between(
        z,
        ray.direction.z,
        min_m.z,
        max_m.z,
    ));
    clipped(globe.layer_intervals(min_m.y, max_m.y, ray), across)
}

/// The parts of a ray inside a ball of the field: (x − x₀)² + (altitude − a₀)² + (z − z₀)² ≤ r². Only what lies in `within`
/// is looked at.
///
/// In a flat world this is a quadratic. On a sphere altitude bends, and the parts are found by halving: altitude is convex
/// along a ray and so bounded over every part by its ends and its lowest point, which bounds the distance to the middle;
/// what is surely inside or outside is not halved on. Nothing is missed that is longer than 1e-9 of the radius.
#[must_use]
pub fn ball_parts(
    globe: &Globe,
    ray: &Ray,
    offset_xz_m: DVec2,
    center_m: DVec3,
    radius_m: f64,
    within: Interval,
) -> Parts {
    if within.is_empty() {
        return [Interval::EMPTY; 2];
    }
    let from = DVec3::new(
        ray.origin_m.x + offset_xz_m.x - center_m.x,
        ray.origin_m.y - center_m.y,
        ray.origin_m.z + offset_xz_m.y - center_m.z,
    );
    if matches!(globe, Globe::Flat) {
        let b = from.dot(ray.direction);
        // The distance of the line from the middle, squared, from the rejected vector: no cancellation far away.
        let reject = from - ray.direction * b;
        let half_squared = radius_m * radius_m - reject.length_squared();
        if half_squared <= 0.0 {
            return [Interval::EMPTY; 2];
        }
        let half = half_squared.sqrt();
        return clipped(
            [Interval::new(-b - half, -b + half), Interval::EMPTY],
            within,
        );
    }
    let across = DVec2::new(from.x, from.z);
    let across_direction = DVec2::new(ray.direction.x, ray.direction.z);
    let speed_squared = across_direction.length_squared();
    let nearest_m = if speed_squared > 0.0 {
        -across.dot(across_direction) / speed_squared
    } else {
        0.0
    };
    let across_squared = |t: f64| (across + across_direction * t).length_squared();
    // Least and greatest squared distance from the middle over a part.
    let bounds = |part: Interval| {
        let (a, b) = (across_squared(part.start_m), across_squared(part.end_m));
        let nearest = nearest_m.clamp(part.start_m, part.end_m);
        let least = across_squared(nearest);
        let [low, high] = globe
            .altitude_range_m(ray, part)
            .map(|altitude_m| altitude_m - center_m.y);
        let least_up = if low > 0.0 {
            low
        } else if high < 0.0 {
            -high
        } else {
            0.0
        };
        let most_up = low.abs().max(high.abs());
        (least + least_up * least_up, a.max(b) + most_up * most_up)
    };
    let limit = radius_m * radius_m;
    let smallest_m = 1e-9 * radius_m;
    let mut parts = [Interval::EMPTY; 2];
    let mut count = 0;
    let mut add = |part: Interval| {
        if count > 0 && part.start_m <= parts[count - 1].end_m {
            parts[count - 1].end_m = part.end_m;
        } else if count < 2 {
            parts[count] = part;
            count += 1;
        }
    };
    // A stack of halves, nearest on top: at most one waits for every halving.
    let mut waiting = vec![within];
    while let Some(part) = waiting.pop() {
        let (least, most) = bounds(part);
        if least > limit {
            continue;
        }
        if most <= limit {
            add(part);
            continue;
        }
        let middle = 0.5 * (part.start_m + part.end_m);
        if part.length_m() <= smallest_m || middle <= part.start_m || middle >= part.end_m {
            continue;
        }
        waiting.push(Interval::new(middle, part.end_m));
        waiting.push(Interval::new(part.start_m, middle));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    const EARTH: Globe = Globe::Sphere {
        radius_m: 6_360_000.0,
    };

    #[test]
    fn halving_agrees_with_the_quadratic_where_the_world_is_nearly_flat() {
        let globe = Globe::Sphere { radius_m: 1e12 };
        let ray = Ray::new(DVec3::new(10.0, 0.0, -20.0), DVec3::new(0.3, 0.9, 0.2)).expect("a ray");
        let center = DVec3::new(700.0, 2_000.0, 400.0);
        let within = Interval::new(0.0, 1e5);
        let flat = ball_parts(&Globe::Flat, &ray, DVec2::ZERO, center, 300.0, within);
        let bent = ball_parts(&globe, &ray, DVec2::ZERO, center, 300.0, within);
        assert!(!flat[0].is_empty());
        assert!((flat[0].start_m - bent[0].start_m).abs() < 1e-4);
        assert!((flat[0].end_m - bent[0].end_m).abs() < 1e-4);
        assert!(bent[1].is_empty());
    }

    #[test]
    fn parts_of_boxes_and_balls_begin_and_end_on_their_surfaces() {
        let eye = Ray::new(DVec3::new(0.0, 2.0, 0.0), DVec3::new(1.0, 0.045, 0.02)).expect("a ray");
        let offset = DVec2::new(100.0, -50.0);
        let center = DVec3::new(40_100.0, 2_000.0, 750.0);
        let place = |t: f64| {
            let p = eye.at(t);
            DVec3::new(p.x + offset.x, EARTH.altitude_m(p), p.z + offset.y)
        };
        let [ball, _] = ball_parts(&EARTH, &eye, offset, center, 600.0, Interval::new(0.0, 1e6));
        assert!(!ball.is_empty());
        for t in [ball.start_m, ball.end_m] {
            assert!(((place(t) - center).length() - 600.0).abs() < 1e-5);
        }
        let half = DVec3::new(500.0, 400.0, 600.0);
        let [inside, _] = box_parts(&EARTH, &eye, offset, center - half, center + half);
        assert!(!inside.is_empty());
        for t in [inside.start_m, inside.end_m] {
            let off = (place(t) - center).abs() - half;
            assert!(off.max_element().abs() < 1e-5, "{off}");
        }
    }

    #[test]
    fn a_speck_far_away_is_not_missed() {
        let center = EARTH.altitude_m(DVec3::new(30_000.0, 1_000.0, 0.0));
        let eye = Ray::new(DVec3::ZERO, DVec3::new(30_000.0, 1_000.0, 0.0)).expect("a ray");
        let speck = DVec3::new(30_000.0, center, 0.0);
        let [part, _] = ball_parts(
            &EARTH,
            &eye,
            DVec2::ZERO,
            speck,
            1e-3,
            Interval::new(0.0, 1e6),
        );
        assert!((part.length_m() - 2e-3).abs() < 1e-6);
    }
}

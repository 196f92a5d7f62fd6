//! A crowd that migrates: groups that travel together, meet and part, with stragglers, while everybody looks around. A closed
//! form of time, so that a run can be repeated.

use skycell_protocol::Camera;
use skycell_protocol::value_error::ValueError;
use std::f64::consts::TAU;

/// Viewers of a group.
const GROUP: usize = 3;
/// All travel east at this speed, m/s: a convoy's.
const TRAVEL_M_PER_S: f64 = 30.0;
/// Groups swing north and south by so much, m, in this time, s: they meet twice in it.
const SWING_M: f64 = 1_500.0;
const SWING_S: f64 = 200.0;
/// The last of a group falls so far behind, m, and catches up again in this time, s.
const STRAGGLE_M: f64 = 900.0;
const STRAGGLE_S: f64 = 150.0;
/// Everybody walks round in a circle in the group, m and s.
const CIRCLE_M: f64 = 120.0;
const CIRCLE_S: f64 = 120.0;
/// How fast everybody turns, degrees a second, ...
const TURN_DEG_PER_S: f64 = 6.0;
/// ... and how often everybody turns round at once, s.
const ABOUT_FACE_S: f64 = 45.0;
/// Height of eyes, m.
const EYES_M: f64 = 2.0;
/// How far up everybody looks, degrees.
const PITCH_DEG: f64 = 15.0;
/// Opening of pictures, degrees.
const VERTICAL_FOV_DEG: f64 = 60.0;

/// Where a viewer is and looks after a time, s.
///
/// # Errors
/// After days, when it would have left the world.
pub(super) fn camera(viewer: usize, time_s: f64) -> Result<Camera, ValueError> {
    let (group, place) = (viewer / GROUP, viewer % GROUP);
    let turns = |period_s: f64, of_all: f64| TAU * (time_s / period_s + of_all);
    let is_last = if place == GROUP - 1 { 1.0 } else { 0.0 };
    let behind_m = is_last * STRAGGLE_M * 0.5 * (1.0 - turns(STRAGGLE_S, 0.0).cos());
    let about = turns(CIRCLE_S, place as f64 / GROUP as f64);
    // Neighbouring groups swing to opposite sides.
    let side = if group % 2 == 0 { 1.0 } else { -1.0 };
    let swing_m = side * SWING_M * (1.0 + 0.25 * (group / 2) as f64) * turns(SWING_S, 0.0).sin();
    let position_m = [
        TRAVEL_M_PER_S * time_s - behind_m + CIRCLE_M * about.cos(),
        EYES_M,
        swing_m + CIRCLE_M * about.sin(),
    ];
    let faces = (time_s / ABOUT_FACE_S + viewer as f64 * 0.37).floor();
    let yaw_deg = 40.0 * viewer as f64 + TURN_DEG_PER_S * time_s + 180.0 * faces;
    Camera::new(
        position_m,
        yaw_deg.rem_euclid(360.0),
        PITCH_DEG,
        VERTICAL_FOV_DEG,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apart_m(a: usize, b: usize, time_s: f64) -> f64 {
        let [a, b] = [a, b].map(|viewer| camera(viewer, time_s).expect("a camera").position_m());
        (a[0] - b[0]).hypot(a[2] - b[2])
    }

    #[test]
    fn groups_meet_and_part_stragglers_fall_behind_and_all_get_far() {
        let times = || (0..600).map(f64::from);
        let [least, most] = [f64::min as fn(f64, f64) -> f64, f64::max].map(|pick| {
            let apart = times().map(|time_s| apart_m(0, 3, time_s));
            apart.reduce(pick).expect("times")
        });
        assert!(least < 100.0 && most > 2_500.0, "{least} {most}");
        let behind = times().map(|time_s| apart_m(0, 2, time_s));
        assert!(behind.fold(0.0, f64::max) > 800.0);
        let end = camera(0, 600.0).expect("a camera").position_m();
        assert!(end[0] > 17_000.0);
    }

    #[test]
    fn nobody_jumps() {
        for viewer in 0..12 {
            for tick in 0..3_000 {
                let [was, is] = [0.0, 0.2].map(|s| camera(viewer, f64::from(tick) * 0.2 + s));
                let [was, is] = [was, is].map(|c| c.expect("a camera").position_m());
                let way_m = (was[0] - is[0]).hypot(was[2] - is[2]);
                assert!(way_m < 30.0, "{viewer}: {way_m} m in 0.2 s");
            }
        }
    }
}

//! A camera's way through time.
//!
//! As JSON, a list of at least one key, in order of time:
//!
//! ```json
//! [
//!   {"time_s": 0, "camera": {"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 12, "vertical_fov_deg": 60}},
//!   {"time_s": 8, "camera": {"position_m": [500, 80, 0], "yaw_deg": 360, "pitch_deg": 20, "vertical_fov_deg": 40}}
//! ]
//! ```
//!
//! Between two keys every number goes in a straight line: position, angles, field of view. A yaw
//! therefore takes the way that is written, not the shorter one: 0 to 360 is a full turn. Before the
//! first and after the last key the camera stands still.

use serde_json::Value;
use skycell_protocol::{Camera, ValueError};

/// A path is held in memory and written by people: no recording needs more keys.
pub const CAMERA_KEYS_MAX: usize = 10_000;
/// A day.
const TIME_MAX_S: f64 = 86_400.0;
const TIME_ALLOWED: &str = "0 to 86400, later than the key before";

/// A camera at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraKey {
    /// Seconds since the path's beginning.
    pub time_s: f64,
    /// Where it stands and looks then.
    pub camera: Camera,
}

/// At least one key, in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    keys: Vec<CameraKey>,
}

impl CameraPath {
    /// A path through `keys`.
    ///
    /// # Errors
    /// If there is none or too many, or one is not later than the key before it.
    pub fn new(keys: Vec<CameraKey>) -> Result<Self, ValueError> {
        if keys.is_empty() || keys.len() > CAMERA_KEYS_MAX {
            let allowed = format!("1 to {CAMERA_KEYS_MAX} keys");
            return Err(ValueError::new("", &Value::from(keys.len()), allowed));
        }
        let mut earliest_s = 0.0;
        for (index, key) in keys.iter().enumerate() {
            let in_order = index == 0 || key.time_s > earliest_s;
            // False for NaN as well.
            let in_range = (earliest_s..=TIME_MAX_S).contains(&key.time_s);
            if !(in_order && in_range) {
                let pointer = format!("/{index}/time_s");
                return Err(ValueError::of_number(pointer, key.time_s, TIME_ALLOWED));
            }
            earliest_s = key.time_s;
        }
        Ok(Self { keys })
    }

    /// Reads a path as the module describes it.
    ///
    /// # Errors
    /// Names the value that is not allowed by its JSON pointer.
    pub fn from_json(document: &Value) -> Result<Self, ValueError> {
        let Value::Array(entries) = document else {
            return Err(ValueError::new("", document, "a list of {time_s, camera}"));
        };
        let keys = entries
            .iter()
            .take(CAMERA_KEYS_MAX + 1)
            .enumerate()
            .map(|(index, entry)| {
                read_key(entry).map_err(|error| error.under(&format!("/{index}")))
            })
            .collect::<Result<_, _>>()?;
        Self::new(keys)
    }

    /// A slow turn to the right: `turn_deg` within `duration_s`, from `start`.
    ///
    /// # Errors
    /// If the duration is not above 0, or the yaw at the end is out of range.
    pub fn turn(start: Camera, turn_deg: f64, duration_s: f64) -> Result<Self, ValueError> {
        let end = Camera::new(
            start.position_m(),
            start.yaw_deg() + turn_deg,
            start.pitch_deg(),
            start.vertical_fov_deg(),
        )?;
        Self::new(vec![
            CameraKey {
                time_s: 0.0,
                camera: start,
            },
            CameraKey {
                time_s: duration_s,
                camera: end,
            },
        ])
    }

    /// When the last key is reached.
    pub fn duration_s(&self) -> f64 {
        self.keys.last().map_or(0.0, |key| key.time_s)
    }

    /// The camera at a moment.
    pub fn at(&self, time_s: f64) -> Camera {
        // The first key that is not before the moment.
        let next = self.keys.partition_point(|key| key.time_s < time_s);
        let (Some(before), Some(after)) = (
            self.keys.get(next.saturating_sub(1)),
            self.keys.get(next).or(self.keys.last()),
        ) else {
            return Camera::default(); // A path has a key.
        };
        let span_s = after.time_s - before.time_s;
        if span_s <= 0.0 {
            return after.camera;
        }
        between(
            &before.camera,
            &after.camera,
            ((time_s - before.time_s) / span_s).clamp(0.0, 1.0),
        )
    }
}

fn read_key(entry: &Value) -> Result<CameraKey, ValueError> {
    let Value::Object(members) = entry else {
        return Err(ValueError::new("", entry, "{time_s, camera}"));
    };
    if let Some((key, value)) = members
        .iter()
        .find(|(key, _)| !["time_s", "camera"].contains(&key.as_str()))
    {
        return Err(ValueError::new(
            format!("/{key}"),
            value,
            "no such key; known: time_s, camera",
        ));
    }
    let time = members
        .get("time_s")
        .ok_or_else(|| ValueError::missing("/time_s", TIME_ALLOWED))?;
    let camera = members
        .get("camera")
        .ok_or_else(|| ValueError::missing("/camera", "a camera"))?;
    Ok(CameraKey {
        time_s: time
            .as_f64()
            .ok_or_else(|| ValueError::new("/time_s", time, TIME_ALLOWED))?,
        camera: Camera::from_json(camera).map_err(|error| error.under("/camera"))?,
    })
}

fn between(a: &Camera, b: &Camera, share: f64) -> Camera {
    let mix = |a: f64, b: f64| a * (1.0 - share) + b * share;
    let (from_m, to_m) = (a.position_m(), b.position_m());
    Camera::new(
        std::array::from_fn(|axis| mix(from_m[axis], to_m[axis])),
        mix(a.yaw_deg(), b.yaw_deg()),
        mix(a.pitch_deg(), b.pitch_deg()),
        mix(a.vertical_fov_deg(), b.vertical_fov_deg()),
    )
    // Every range is convex; only the rounding of the mix could leave it.
    .unwrap_or(*b)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn camera(x_m: f64, yaw_deg: f64) -> Camera {
        Camera::new([x_m, 2.0, 0.0], yaw_deg, 12.0, 60.0).expect("in range")
    }

    fn key(time_s: f64, yaw_deg: f64) -> CameraKey {
        CameraKey {
            time_s,
            camera: camera(0.0, yaw_deg),
        }
    }

    #[test]
    fn a_camera_half_way_in_time_is_half_way_in_every_number() {
        let path = CameraPath::new(vec![
            CameraKey {
                time_s: 1.0,
                camera: camera(0.0, 10.0),
            },
            CameraKey {
                time_s: 3.0,
                camera: camera(100.0, 370.0),
            },
        ])
        .expect("a path");
        assert_eq!(path.at(2.0), camera(50.0, 190.0));
        assert_eq!(path.duration_s(), 3.0);
    }

    #[test]
    fn keys_are_met_exactly_and_the_ends_stand_still() {
        let path =
            CameraPath::new(vec![key(0.0, 0.0), key(1.0, 7.0), key(4.0, -3.0)]).expect("a path");
        for (time_s, yaw_deg) in [
            (-1.0, 0.0),
            (0.0, 0.0),
            (1.0, 7.0),
            (4.0, -3.0),
            (99.0, -3.0),
        ] {
            assert_eq!(path.at(time_s).yaw_deg(), yaw_deg, "at {time_s} s");
        }
        assert_eq!(path.at(f64::NAN).yaw_deg(), 0.0);
    }

    #[test]
    fn one_key_is_a_camera_that_stands_still() {
        let path = CameraPath::new(vec![key(5.0, 42.0)]).expect("a path");
        assert_eq!(
            (path.at(0.0), path.at(9.0)),
            (camera(0.0, 42.0), camera(0.0, 42.0))
        );
    }

    #[test]
    fn a_turn_ends_where_it_says() {
        let path = CameraPath::turn(camera(0.0, 350.0), 60.0, 10.0).expect("a path");
        assert_eq!(path.at(5.0).yaw_deg(), 380.0);
        assert!(CameraPath::turn(camera(0.0, 0.0), 60.0, 0.0).is_err());
    }

    #[test]
    fn bad_paths_are_refused_by_the_place_of_the_mistake() {
        let good =
            json!({"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 12, "vertical_fov_deg": 60});
        let mut steep = good.clone();
        steep["pitch_deg"] = json!(91);
        for (document, pointer) in [
            (json!({}), ""),
            (json!([]), ""),
            (json!([3]), "/0"),
            (json!([{"camera": good}]), "/0/time_s"),
            (json!([{"time_s": 0}]), "/0/camera"),
            (json!([{"time_s": -1, "camera": good}]), "/0/time_s"),
            (json!([{"time_s": 1e9, "camera": good}]), "/0/time_s"),
            (
                json!([{"time_s": 0, "camera": good}, {"time_s": 0, "camera": good}]),
                "/1/time_s",
            ),
            (
                json!([{"time_s": 0, "camera": steep}]),
                "/0/camera/pitch_deg",
            ),
            (
                json!([{"time_s": 0, "camera": good, "speed": 1}]),
                "/0/speed",
            ),
        ] {
            let error = CameraPath::from_json(&document).expect_err("not allowed");
            assert_eq!(error.pointer, pointer, "{document}");
        }
    }

    #[test]
    fn the_example_of_the_documentation_is_a_path() {
        let document = json!([
            {"time_s": 0, "camera": {"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 12, "vertical_fov_deg": 60}},
            {"time_s": 8, "camera": {"position_m": [500, 80, 0], "yaw_deg": 360, "pitch_deg": 20, "vertical_fov_deg": 40}}
        ]);
        assert_eq!(
            CameraPath::from_json(&document).map(|path| path.duration_s()),
            Ok(8.0)
        );
    }
}

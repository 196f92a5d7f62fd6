//! A viewer with two eyes: how far apart they are, and where each of them stands.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::number_range::NumberRange;
use crate::read_json::{ObjectReader, ReadJson};
use crate::{Camera, FrameSize, ValueError};

/// How far apart two eyes may stand. People's are 0.05 to 0.08 m apart and see clouds flat; a depth of clouds shows from some
/// metres on. At the upper end the nearest clouds (1.5 km) stand 3.8° apart in the two pictures, which nobody fuses any more.
pub const EYE_DISTANCE_M: NumberRange = NumberRange::new(0.0, 100.0);

const KEYS: &[&str] = &["eye_distance_m"];

/// Two eyes that look in parallel, at both sides of the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "StereoDocument")]
#[schemars(!try_from, deny_unknown_fields)]
pub struct Stereo {
    /// From the middle of one eye to that of the other.
    #[schemars(range(min = EYE_DISTANCE_M.min, max = EYE_DISTANCE_M.max))]
    eye_distance_m: f64,
}

/// A pair of eyes as it stands in JSON.
#[derive(Deserialize)]
struct StereoDocument {
    eye_distance_m: f64,
}

impl Stereo {
    /// Eyes so far apart.
    ///
    /// # Errors
    /// Names `/eye_distance_m`, the number and the range.
    pub fn new(eye_distance_m: f64) -> Result<Self, ValueError> {
        Ok(Self {
            eye_distance_m: EYE_DISTANCE_M.check("/eye_distance_m", eye_distance_m)?,
        })
    }

    /// From the middle of one eye to that of the other.
    pub fn eye_distance_m(self) -> f64 {
        self.eye_distance_m
    }

    /// The cameras of the left and the right eye of a viewer, whose own stands in their middle. They look the same way.
    pub fn eyes(self, camera: &Camera) -> [Camera; 2] {
        [-0.5, 0.5].map(|side| camera.moved_right(side * self.eye_distance_m))
    }
}

impl TryFrom<StereoDocument> for Stereo {
    type Error = ValueError;

    fn try_from(document: StereoDocument) -> Result<Self, ValueError> {
        Self::new(document.eye_distance_m)
    }
}

impl ReadJson for Stereo {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let allowed = format!("null, or an object with eye_distance_m, {EYE_DISTANCE_M}");
        let members = ObjectReader::new(value, pointer)
            .map_err(|_| ValueError::new(pointer, value, allowed))?;
        members.only(KEYS)?;
        let eye_distance_m = members.required("eye_distance_m", &EYE_DISTANCE_M.to_string())?;
        Self::new(eye_distance_m).map_err(|error| error.under(pointer))
    }
}

impl FrameSize {
    /// The size of an eye's picture, if a frame can hold as many as there are eyes.
    ///
    /// # Errors
    /// Names `/width`, the number and the range, if two pictures of the size are wider than a frame may be.
    pub fn for_eyes(self, stereo: Option<Stereo>) -> Result<Self, ValueError> {
        let widest = crate::view::FRAME_WIDTH_MAX / 2;
        if stereo.is_some() && self.width() > widest {
            return Err(ValueError::of_number(
                "/width",
                self.width().into(),
                format!("1 to {widest} for each of two eyes"),
            ));
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use serde_json::json;

    #[test]
    fn a_pair_stands_level_at_both_sides_of_the_camera_and_looks_as_it_does() {
        let camera = Camera::new([10.0, 2.0, -20.0], 37.0, 50.0, 60.0).expect("in range");
        let pair = Stereo::new(5.0).expect("in range");
        let [left, right] = pair.eyes(&camera);
        let [from, to] = [left, right].map(|eye| DVec3::from_array(eye.position_m()));
        assert!((to - from - 5.0 * camera.right()).length() < 1e-12);
        let middle = DVec3::from_array(camera.position_m());
        assert!(((from + to) / 2.0 - middle).length() < 1e-12);
        for eye in [left, right] {
            assert_eq!(eye.position_m()[1], 2.0);
            assert_eq!(eye.direction(), camera.direction());
            assert_eq!(eye.vertical_fov_deg(), camera.vertical_fov_deg());
        }
        // A yaw of 90° looks east: the right eye stands farther south.
        let east = Camera::new([0.0; 3], 90.0, 0.0, 60.0).expect("in range");
        let [left, right] = pair.eyes(&east).map(|eye| eye.position_m()[2]);
        assert!((left + 2.5).abs() < 1e-12 && (right - 2.5).abs() < 1e-12);
        assert_eq!(
            Stereo::new(0.0).map(|none| none.eyes(&camera)),
            Ok([camera; 2])
        );
    }

    #[test]
    fn what_is_no_pair_is_named_by_pointer_value_and_what_is_allowed() {
        for (value, pointer, message) in [
            (
                json!({"eye_distance_m": -0.1}),
                "/stereo/eye_distance_m",
                "is -0.1; allowed: 0 to 100",
            ),
            (
                json!({"eye_distance_m": 100.5}),
                "/stereo/eye_distance_m",
                "is 100.5; allowed: 0 to 100",
            ),
            (
                json!({"eye_distance_m": "far"}),
                "/stereo/eye_distance_m",
                "a number",
            ),
            (
                json!({"eye_distance_m": null}),
                "/stereo/eye_distance_m",
                "a number",
            ),
            (json!({}), "/stereo/eye_distance_m", "0 to 100"),
            (
                json!({"eye_distance": 0.064}),
                "/stereo/eye_distance",
                "did you mean \"eye_distance_m\"?",
            ),
            (
                json!(0.064),
                "/stereo",
                "an object with eye_distance_m, 0 to 100",
            ),
            (
                json!(true),
                "/stereo",
                "an object with eye_distance_m, 0 to 100",
            ),
        ] {
            let error = Stereo::read_json(&value, "/stereo").expect_err("no pair");
            assert_eq!(error.pointer, pointer, "{value}");
            assert!(error.to_string().contains(message), "{value}: {error}");
        }
        assert!(Stereo::new(f64::NAN).is_err());
        assert!(serde_json::from_value::<Stereo>(json!({"eye_distance_m": 1e9})).is_err());
    }

    #[test]
    fn two_eyes_share_the_width_of_a_frame() {
        let pair = Stereo::new(0.064).ok();
        let size = |width| FrameSize::new(width, 2160).expect("in range");
        assert_eq!(size(3840).for_eyes(None), Ok(size(3840)));
        assert_eq!(size(1920).for_eyes(pair), Ok(size(1920)));
        assert_eq!(size(1920).pair().width(), 3840);
        let error = size(1921).for_eyes(pair).expect_err("too wide");
        assert_eq!(
            error.to_string(),
            "/width is 1921; allowed: 1 to 1920 for each of two eyes"
        );
    }
}

//! Where a viewer stands and looks.

use glam::DVec3;
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::Serialize;
use serde_json::Value;

use crate::ValueError;
use crate::number_range::NumberRange;
use crate::read_json::{ObjectReader, ReadJson};
use crate::schema;

/// How far a position may lie from the world's origin along x or z: half the way round the Earth.
pub const POSITION_HORIZONTAL_M: NumberRange = NumberRange::new(-2.0e7, 2.0e7);
/// The altitude of a position: from places that lie below the sea to a low orbit. The ground is a sphere at altitude 0 and
/// has no dents: who stands below it sees the sky above a level horizon, through the denser air there, and under that
/// horizon the lit ground at his feet.
pub const POSITION_ALTITUDE_M: NumberRange = NumberRange::new(-100.0, 4.0e5);
/// A yaw may count turns, but not so many that degrees lose their fractions.
pub const YAW_DEG: NumberRange = NumberRange::new(-1.0e6, 1.0e6);
/// From straight down to straight up.
pub const PITCH_DEG: NumberRange = NumberRange::new(-90.0, 90.0);
/// A flat picture cannot show 180 degrees.
pub const VERTICAL_FOV_DEG: NumberRange = NumberRange::new(1.0, 170.0);

/// A camera as it stands in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct CameraDocument {
    /// x (east), altitude above the ground sphere, z (south), in metres.
    #[schemars(transform = schema::position)]
    pub position_m: [f64; 3],
    /// Clockwise from north.
    #[schemars(range(min = YAW_DEG.min, max = YAW_DEG.max))]
    pub yaw_deg: f64,
    /// Up from the horizon.
    #[schemars(range(min = PITCH_DEG.min, max = PITCH_DEG.max))]
    pub pitch_deg: f64,
    /// The angle between the picture's upper and lower edge.
    #[schemars(range(min = VERTICAL_FOV_DEG.min, max = VERTICAL_FOV_DEG.max))]
    pub vertical_fov_deg: f64,
}

impl ReadJson for CameraDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        members.only(&["position_m", "yaw_deg", "pitch_deg", "vertical_fov_deg"])?;
        Ok(Self {
            position_m: members.required("position_m", "an array of 3 numbers")?,
            yaw_deg: members.required("yaw_deg", &YAW_DEG.to_string())?,
            pitch_deg: members.required("pitch_deg", &PITCH_DEG.to_string())?,
            vertical_fov_deg: members
                .required("vertical_fov_deg", &VERTICAL_FOV_DEG.to_string())?,
        })
    }
}

/// A camera whose every number is in range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "CameraDocument")]
pub struct Camera {
    position_m: [f64; 3],
    yaw_deg: f64,
    pitch_deg: f64,
    vertical_fov_deg: f64,
}

impl Camera {
    /// A camera at `position_m` (x, altitude, z).
    ///
    /// # Errors
    /// Names the first number that is out of range.
    pub fn new(
        position_m: [f64; 3],
        yaw_deg: f64,
        pitch_deg: f64,
        vertical_fov_deg: f64,
    ) -> Result<Self, ValueError> {
        POSITION_HORIZONTAL_M.check("/position_m/0", position_m[0])?;
        POSITION_ALTITUDE_M.check("/position_m/1", position_m[1])?;
        POSITION_HORIZONTAL_M.check("/position_m/2", position_m[2])?;
        Ok(Self {
            position_m,
            yaw_deg: YAW_DEG.check("/yaw_deg", yaw_deg)?,
            pitch_deg: PITCH_DEG.check("/pitch_deg", pitch_deg)?,
            vertical_fov_deg: VERTICAL_FOV_DEG.check("/vertical_fov_deg", vertical_fov_deg)?,
        })
    }

    /// Reads a camera from JSON.
    ///
    /// # Errors
    /// Names the first value that is not allowed.
    pub fn from_json(value: &Value) -> Result<Self, ValueError> {
        Self::read_json(value, "")
    }

    /// x (east), altitude above the ground sphere, z (south), in metres.
    pub fn position_m(&self) -> [f64; 3] {
        self.position_m
    }

    /// Clockwise from north.
    pub fn yaw_deg(&self) -> f64 {
        self.yaw_deg
    }

    /// Up from the horizon.
    pub fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }

    /// The angle between the picture's upper and lower edge.
    pub fn vertical_fov_deg(&self) -> f64 {
        self.vertical_fov_deg
    }

    /// The unit vector along the middle of the picture.
    pub fn direction(&self) -> DVec3 {
        direction_of_angles(self.yaw_deg, self.pitch_deg)
    }

    /// The unit vector towards the picture's right edge; horizontal, as a camera has no roll.
    pub fn right(&self) -> DVec3 {
        let yaw_rad = self.yaw_deg.to_radians();
        DVec3::new(yaw_rad.cos(), 0.0, yaw_rad.sin())
    }

    /// The same camera somewhat to the right, or to the left by a negative distance. It may stand that far outside of what
    /// is allowed.
    pub(crate) fn moved_right(&self, by_m: f64) -> Self {
        let moved_m = DVec3::from_array(self.position_m) + by_m * self.right();
        Self {
            position_m: moved_m.to_array(),
            ..*self
        }
    }

    /// The unit vector towards the picture's upper edge.
    pub fn up(&self) -> DVec3 {
        self.right().cross(self.direction())
    }
}

impl JsonSchema for Camera {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        CameraDocument::schema_name()
    }

    fn schema_id() -> std::borrow::Cow<'static, str> {
        CameraDocument::schema_id()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        CameraDocument::json_schema(generator)
    }
}

impl Default for Camera {
    /// Two metres above the origin, a little above the northern horizon.
    fn default() -> Self {
        Self {
            position_m: [0.0, 2.0, 0.0],
            yaw_deg: 0.0,
            pitch_deg: 15.0,
            vertical_fov_deg: 60.0,
        }
    }
}

impl TryFrom<CameraDocument> for Camera {
    type Error = ValueError;

    fn try_from(document: CameraDocument) -> Result<Self, ValueError> {
        Self::new(
            document.position_m,
            document.yaw_deg,
            document.pitch_deg,
            document.vertical_fov_deg,
        )
    }
}

impl From<Camera> for CameraDocument {
    fn from(camera: Camera) -> Self {
        Self {
            position_m: camera.position_m,
            yaw_deg: camera.yaw_deg,
            pitch_deg: camera.pitch_deg,
            vertical_fov_deg: camera.vertical_fov_deg,
        }
    }
}

impl ReadJson for Camera {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        Self::try_from(CameraDocument::read_json(value, pointer)?)
            .map_err(|error| error.under(pointer))
    }
}

/// The unit vector at `yaw_deg` clockwise from north (-z) and `pitch_deg` above the horizon.
pub fn direction_of_angles(yaw_deg: f64, pitch_deg: f64) -> DVec3 {
    let (yaw_sin, yaw_cos) = yaw_deg.to_radians().sin_cos();
    let (pitch_sin, pitch_cos) = pitch_deg.to_radians().sin_cos();
    DVec3::new(yaw_sin * pitch_cos, pitch_sin, -yaw_cos * pitch_cos)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn yaw_turns_from_north_to_east_and_pitch_lifts() {
        assert!(near(direction_of_angles(0.0, 0.0), DVec3::NEG_Z));
        assert!(near(direction_of_angles(90.0, 0.0), DVec3::X));
        assert!(near(direction_of_angles(123.0, 90.0), DVec3::Y));
    }

    #[test]
    fn a_camera_that_looks_north_has_east_at_its_right_and_the_zenith_above() {
        let camera = Camera::new([0.0; 3], 0.0, 0.0, 60.0).expect("in range");
        assert!(near(camera.right(), DVec3::X));
        assert!(near(camera.up(), DVec3::Y));
    }

    #[test]
    fn numbers_out_of_range_are_refused_by_name() {
        for (bad, pointer) in [
            (
                json!({"position_m": [0, -101, 0], "yaw_deg": 0, "pitch_deg": 0, "vertical_fov_deg": 60}),
                "/position_m/1",
            ),
            (
                json!({"position_m": [0, 0, 3e7], "yaw_deg": 0, "pitch_deg": 0, "vertical_fov_deg": 60}),
                "/position_m/2",
            ),
            (
                json!({"position_m": [0, 0, 0], "yaw_deg": 0, "pitch_deg": 90.5, "vertical_fov_deg": 60}),
                "/pitch_deg",
            ),
            (
                json!({"position_m": [0, 0, 0], "yaw_deg": 0, "pitch_deg": 0, "vertical_fov_deg": 0}),
                "/vertical_fov_deg",
            ),
            (
                json!({"position_m": [0, 0, 0], "yaw_deg": null, "pitch_deg": 0, "vertical_fov_deg": 60}),
                "/yaw_deg",
            ),
            (
                json!({"position_m": [0, 0], "yaw_deg": 0, "pitch_deg": 0, "vertical_fov_deg": 60}),
                "/position_m",
            ),
            (
                json!({"yaw_deg": 0, "pitch_deg": 0, "vertical_fov_deg": 60}),
                "/position_m",
            ),
            (
                json!({"position_m": [0, 0, 0], "yaw": 0, "pitch_deg": 0, "vertical_fov_deg": 60}),
                "/yaw",
            ),
        ] {
            assert_eq!(Camera::from_json(&bad).expect_err("bad").pointer, pointer);
        }
        assert!(Camera::new([0.0; 3], f64::NAN, 0.0, 60.0).is_err());
    }

    proptest! {
        #[test]
        fn the_axes_of_a_camera_are_orthonormal_and_right_handed(
            yaw_deg in -720.0..720.0f64, pitch_deg in -90.0..=90.0f64,
        ) {
            let camera = Camera::new([0.0; 3], yaw_deg, pitch_deg, 60.0).expect("in range");
            let (right, up, ahead) = (camera.right(), camera.up(), camera.direction());
            prop_assert!((right.dot(up)).abs() < 1e-12 && right.dot(ahead).abs() < 1e-12);
            prop_assert!((up.length() - 1.0).abs() < 1e-12);
            // Looking along -z of a right-handed frame: right x up points backwards.
            prop_assert!(near(right.cross(up), -ahead));
        }

        #[test]
        fn a_camera_survives_the_wire(
            x in -2e7..2e7f64, y in -100.0..4e5f64, yaw_deg in -1e6..1e6f64,
            pitch_deg in -90.0..=90.0f64, fov_deg in 1.0..=170.0f64,
        ) {
            let camera = Camera::new([x, y, -x], yaw_deg, pitch_deg, fov_deg).expect("in range");
            let json = serde_json::to_value(camera).expect("serialises");
            prop_assert_eq!(Camera::from_json(&json), Ok(camera));
        }
    }
}

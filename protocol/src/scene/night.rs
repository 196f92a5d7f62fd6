//! Moon and stars.

use glam::{DMat3, DVec3};

use super::PlaceAndTime;
use super::document::{MoonDocument, StarsDocument};
use super::ranges;
use crate::ValueError;
use crate::camera::direction_of_angles;

/// Apparent visual magnitude of the sun.
const SUN_MAGNITUDE: f64 = -26.74;

/// Direction and phase of the moon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moon {
    azimuth_deg: f64,
    elevation_deg: f64,
    phase_angle_deg: f64,
    of_place_and_time: bool,
}

impl Moon {
    /// Mean angular radius as seen from the Earth, degrees.
    pub const ANGULAR_RADIUS_DEG: f64 = 0.2590;

    /// The unit vector towards the moon.
    pub fn direction(&self) -> DVec3 {
        direction_of_angles(self.azimuth_deg, self.elevation_deg)
    }

    /// Whether a place and a date say where it stands.
    pub fn of_place_and_time(&self) -> bool {
        self.of_place_and_time
    }

    /// Leaves the moon where it stands at a place and a sky time, if they say so.
    pub(super) fn stand_at(&mut self, place: Option<&PlaceAndTime>, sky_s: f64) {
        if std::mem::take(&mut self.of_place_and_time)
            && let Some(place) = place
        {
            [self.azimuth_deg, self.elevation_deg, self.phase_angle_deg] =
                place.moon_azimuth_elevation_phase_deg(sky_s);
        }
    }

    /// The angle between sun and viewer as seen from the moon: 0 full, 180 or -180 new.
    pub fn phase_angle_deg(&self) -> f64 {
        self.phase_angle_deg
    }

    /// Its light above the atmosphere over the sun's: magnitude -12.73 + 0.026 |a| + 4e-9 a^4 with the phase angle a in
    /// degrees (Krisciunas & Schaefer 1991, eq. 9), 1/400 000 when full.
    pub fn share_of_sunlight(&self) -> f64 {
        let a = self.phase_angle_deg.abs();
        let magnitude = -12.73 + 0.026 * a + 4.0e-9 * a.powi(4);
        10f64.powf(-0.4 * (magnitude - SUN_MAGNITUDE))
    }
}

impl TryFrom<MoonDocument> for Moon {
    type Error = ValueError;

    fn try_from(document: MoonDocument) -> Result<Self, ValueError> {
        Ok(Self {
            azimuth_deg: ranges::AZIMUTH_DEG.check("/azimuth_deg", document.azimuth_deg)?,
            elevation_deg: ranges::ELEVATION_DEG.check("/elevation_deg", document.elevation_deg)?,
            phase_angle_deg: ranges::PHASE_ANGLE_DEG
                .check("/phase_angle_deg", document.phase_angle_deg)?,
            of_place_and_time: document.of_place_and_time,
        })
    }
}

impl From<&Moon> for MoonDocument {
    fn from(moon: &Moon) -> Self {
        Self {
            azimuth_deg: moon.azimuth_deg,
            elevation_deg: moon.elevation_deg,
            phase_angle_deg: moon.phase_angle_deg,
            of_place_and_time: moon.of_place_and_time,
        }
    }
}

/// The field of stars.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stars {
    brightness: f64,
    latitude_deg: f64,
    turn_deg: f64,
}

impl Stars {
    /// Factor of their light.
    pub fn brightness(&self) -> f64 {
        self.brightness
    }

    /// What turns a direction of the world into one of the field, whose y points to the celestial pole in the north.
    pub fn field_from_world(&self) -> DMat3 {
        // North is -z: the pole stands there, as high as the latitude.
        let tilt = DMat3::from_rotation_x((90.0 - self.latitude_deg).to_radians());
        DMat3::from_rotation_y(self.turn_deg.to_radians()) * tilt
    }
}

impl TryFrom<StarsDocument> for Stars {
    type Error = ValueError;

    fn try_from(document: StarsDocument) -> Result<Self, ValueError> {
        Ok(Self {
            brightness: ranges::STAR_BRIGHTNESS.check("/brightness", document.brightness)?,
            latitude_deg: ranges::LATITUDE_DEG.check("/latitude_deg", document.latitude_deg)?,
            turn_deg: ranges::TURN_DEG.check("/turn_deg", document.turn_deg)?,
        })
    }
}

impl From<&Stars> for StarsDocument {
    fn from(stars: &Stars) -> Self {
        Self {
            brightness: stars.brightness,
            latitude_deg: stars.latitude_deg,
            turn_deg: stars.turn_deg,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pole_of_the_stars_stands_in_the_north_as_high_as_the_latitude() {
        let stars = Stars {
            brightness: 1.0,
            latitude_deg: 50.0,
            turn_deg: 77.0,
        };
        let pole = direction_of_angles(0.0, 50.0);
        assert!((stars.field_from_world() * pole - DVec3::Y).length() < 1e-12);
    }

    #[test]
    fn the_full_moon_gives_a_four_hundred_thousandth_of_the_sun() {
        let moon = |phase_angle_deg| Moon {
            azimuth_deg: 0.0,
            elevation_deg: 0.0,
            of_place_and_time: false,
            phase_angle_deg,
        };
        assert!((1.0 / moon(0.0).share_of_sunlight() / 4.0e5 - 1.0).abs() < 0.02);
        // A half moon gives a tenth of a full one (Krisciunas & Schaefer 1991).
        let half = moon(90.0).share_of_sunlight() / moon(0.0).share_of_sunlight();
        assert!((0.08..0.12).contains(&half), "{half}");
    }
}

//! Where sun and moon stand at a place and a time.

use glam::{DVec2, DVec3};
use solar_positioning::time::JulianDate;
use solar_positioning::{Location, SolarPositions};

use crate::ValueError;
use crate::moment::Moment;
use crate::read_json::document;
use crate::scene::ranges;

document! {
    /// A place and a date, which say where the sun stands, and the moon that follows them.
    pub struct PlaceAndTimeDocument {
        /// North positive.
        "latitude_deg" => latitude_deg: f64 = 51.4769; ranges::LATITUDE_DEG,
        /// East positive.
        "longitude_deg" => longitude_deg: f64 = 0.0; ranges::LONGITUDE_DEG,
        /// Date and time there at sky time 0.
        "date" => date: Moment = Moment::from_unix_us(1_782_043_200_000_000),
    }
}

/// A place and a date, which say where the sun stands, and the moon that follows them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceAndTime {
    latitude_deg: f64,
    longitude_deg: f64,
    date: Moment,
}

/// Julian dates of noon on 2000-01-01 and of a century's days.
const JULIAN_DATE_OF_2000: f64 = 2_451_545.0;
const DAYS_PER_CENTURY: f64 = 36_525.0;
/// Distance of the sun in radii of the Earth.
const SUN_DISTANCE_RADII: f64 = 23_455.0;

/// The moon as the Earth's middle sees it: longitude and latitude from the ecliptic and equinox of the date, and the angle
/// that the Earth's radius takes as seen from the moon, degrees. `centuries` of dynamical time since noon of 2000-01-01.
///
/// The Astronomical Almanac's low-precision formulae (section D, "Low-precision formulae for geocentric coordinates of the
/// Moon"): longitude to 0.3°, latitude to 0.2°, parallax to 0.003° between 1900 and 2100. The moon's disc has a radius of
/// 0.26°.
fn moon_ecliptic_deg(centuries: f64) -> [f64; 3] {
    let t = centuries;
    let angle = |at: f64, rate: f64| (at + rate * t).to_radians();
    let longitude = 218.32 + 481_267.881 * t + 6.29 * angle(135.0, 477_198.87).sin()
        - 1.27 * angle(259.3, -413_335.36).sin()
        + 0.66 * angle(235.7, 890_534.22).sin()
        + 0.21 * angle(269.9, 954_397.74).sin()
        - 0.19 * angle(357.5, 35_999.05).sin()
        - 0.11 * angle(186.5, 966_404.03).sin();
    let latitude = 5.13 * angle(93.3, 483_202.02).sin() + 0.28 * angle(228.2, 960_400.89).sin()
        - 0.28 * angle(318.3, 6_003.15).sin()
        - 0.17 * angle(217.6, -407_332.21).sin();
    let parallax = 0.9508
        + 0.0518 * angle(135.0, 477_198.87).cos()
        + 0.0095 * angle(259.3, -413_335.36).cos()
        + 0.0078 * angle(235.7, 890_534.22).cos()
        + 0.0028 * angle(269.9, 954_397.74).cos();
    [longitude.rem_euclid(360.0), latitude, parallax]
}

/// Julian date of 1970-01-01T00:00:00Z.
const JULIAN_DATE_OF_1970: f64 = 2_440_587.5;
const SECONDS_PER_DAY: f64 = 86_400.0;

impl PlaceAndTime {
    /// Date and time at a sky time. The calendar ends with the years 1900 and 2100: beyond, the sun stands still.
    pub fn date_at(&self, sky_s: f64) -> Moment {
        self.date.plus_s(sky_s)
    }

    /// North positive.
    pub fn latitude_deg(&self) -> f64 {
        self.latitude_deg
    }

    /// East positive.
    pub fn longitude_deg(&self) -> f64 {
        self.longitude_deg
    }

    /// Julian date of a sky time, and by how many seconds dynamical time is ahead of it.
    fn julian_date(&self, sky_s: f64) -> (f64, f64) {
        let unix_s = self.date_at(sky_s).unix_s();
        let year = 1970.0 + unix_s / (365.2425 * SECONDS_PER_DAY);
        // ΔT is about a minute; without it the sun is 0.0003° off.
        let delta_t_s = solar_positioning::delta_t::estimate(year).unwrap_or(69.0);
        (JULIAN_DATE_OF_1970 + unix_s / SECONDS_PER_DAY, delta_t_s)
    }

    /// Azimuth (clockwise from north) and elevation of the moon at a sky time as seen from the place on a round Earth
    /// without air, and its phase angle (0 full, 180 new), degrees. Right to about 0.3°, see `moon_ecliptic_deg`.
    pub fn moon_azimuth_elevation_phase_deg(&self, sky_s: f64) -> [f64; 3] {
        let (julian_date, delta_t_s) = self.julian_date(sky_s);
        let days = julian_date - JULIAN_DATE_OF_2000;
        let centuries = (days + delta_t_s / SECONDS_PER_DAY) / DAYS_PER_CENTURY;
        let [longitude, latitude, parallax] = moon_ecliptic_deg(centuries).map(f64::to_radians);
        // In radii of the Earth, from the ecliptic to the equator: obliquity and sidereal time by J. Meeus (Astronomical
        // Algorithms, 1998), 22.2 and 12.4, without what is less than an arc second.
        let flat = DVec2::from_angle(longitude) * latitude.cos();
        let obliquity = (23.439_29 - 0.013_00 * centuries).to_radians();
        let raised = DVec2::from_angle(obliquity).rotate(DVec2::new(flat.y, latitude.sin()));
        let moon = DVec3::new(flat.x, raised.x, raised.y) / parallax.sin();
        let sidereal = 280.460_618_37 + 360.985_647_366_29 * days + self.longitude_deg;
        let meridian = DVec2::from_angle(sidereal.rem_euclid(360.0).to_radians());
        let (sine, cosine) = self.latitude_deg.to_radians().sin_cos();
        let up = DVec3::new(meridian.x * cosine, meridian.y * cosine, sine);
        let east = DVec3::new(-meridian.y, meridian.x, 0.0);
        let north = up.cross(east);
        // The moon is near: from the place it stands up to a degree lower than from the Earth's middle.
        let seen = moon - up;
        let direction = seen.normalize();
        let azimuth = direction.dot(east).atan2(direction.dot(north)).to_degrees();
        let elevation = direction.dot(up).clamp(-1.0, 1.0).asin().to_degrees();
        let [sun_azimuth, sun_elevation] = self.sun_azimuth_elevation_deg(sky_s);
        let (azimuth_rad, elevation_rad) = (sun_azimuth.to_radians(), sun_elevation.to_radians());
        let sun = (north * azimuth_rad.cos() + east * azimuth_rad.sin()) * elevation_rad.cos()
            + up * elevation_rad.sin();
        // Meeus 48.2 and 48.3, as vectors.
        let to_sun = SUN_DISTANCE_RADII * sun - seen;
        let phase = to_sun.angle_between(-seen).to_degrees();
        [azimuth.rem_euclid(360.0), elevation, phase]
    }

    /// Azimuth (clockwise from north) and elevation of the sun at a sky time, degrees, as seen without air.
    ///
    /// By NREL's Solar Position Algorithm (Reda & Andreas 2003, ±0.0003°). Refraction is left out: light in the scene
    /// goes straight, and so must its source.
    pub fn sun_azimuth_elevation_deg(&self, sky_s: f64) -> [f64; 2] {
        let (julian_date, delta_t_s) = self.julian_date(sky_s);
        let location = Location {
            latitude: self.latitude_deg,
            longitude: self.longitude_deg,
        };
        JulianDate::new(julian_date, delta_t_s)
            .and_then(|time| SolarPositions::new().at_from_julian(time, location, 0.0, None))
            .map_or([180.0, 0.0], |sun| [sun.azimuth(), sun.elevation_angle()])
    }
}

impl TryFrom<PlaceAndTimeDocument> for PlaceAndTime {
    type Error = ValueError;

    fn try_from(document: PlaceAndTimeDocument) -> Result<Self, ValueError> {
        Ok(Self {
            latitude_deg: ranges::LATITUDE_DEG.check("/latitude_deg", document.latitude_deg)?,
            longitude_deg: ranges::LONGITUDE_DEG.check("/longitude_deg", document.longitude_deg)?,
            date: document.date,
        })
    }
}

impl From<&PlaceAndTime> for PlaceAndTimeDocument {
    fn from(place: &PlaceAndTime) -> Self {
        Self {
            latitude_deg: place.latitude_deg,
            longitude_deg: place.longitude_deg,
            date: place.date,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_moon_stands_where_the_theory_of_chapront_has_it_to_what_the_formula_states() {
        // Meeus, example 47.a: 1992-04-12, 0h dynamical time.
        let centuries = (2_448_724.5 - JULIAN_DATE_OF_2000) / DAYS_PER_CENTURY;
        let [longitude, latitude, parallax] = moon_ecliptic_deg(centuries);
        assert!((longitude - 133.167_265).abs() < 0.3, "{longitude}");
        assert!((latitude + 3.229_126).abs() < 0.2, "{latitude}");
        assert!((parallax - 0.991_990).abs() < 0.003, "{parallax}");
    }

    fn place(latitude_deg: f64, longitude_deg: f64, date: &str) -> PlaceAndTime {
        PlaceAndTime {
            latitude_deg,
            longitude_deg,
            date: Moment::parse(date, "").expect("a date"),
        }
    }

    #[test]
    fn the_moon_has_the_phase_of_its_date_and_stands_before_the_sun_in_an_eclipse() {
        // Meeus, example 48.a, from the Earth's middle; from its surface up to a degree more or less.
        let [_, _, phase] =
            place(0.0, 0.0, "1992-04-12T00:00:00Z").moon_azimuth_elevation_phase_deg(0.0);
        assert!((phase - 69.0756).abs() < 1.3, "{phase}");
        // Nazas, Mexico, in the middle of the total eclipse of 2024-04-08 (NASA): both discs in one place.
        let nazas = place(25.29, -104.14, "2024-04-08T18:17:00Z");
        let [azimuth, elevation, phase] = nazas.moon_azimuth_elevation_phase_deg(0.0);
        let [sun_azimuth, sun_elevation] = nazas.sun_azimuth_elevation_deg(0.0);
        let across = (azimuth - sun_azimuth) * elevation.to_radians().cos();
        let apart = across.hypot(elevation - sun_elevation);
        assert!(
            apart < 0.4,
            "{apart}: {azimuth} {elevation}, {sun_azimuth} {sun_elevation}"
        );
        assert!(phase > 179.0, "{phase}");
        // The total lunar eclipse of 2025-09-07, 18:12 UTC (NASA): full, and opposite to the sun.
        let [_, _, full] =
            place(20.0, 80.0, "2025-09-07T18:12:00Z").moon_azimuth_elevation_phase_deg(0.0);
        assert!(full < 1.5, "{full}");
    }
}

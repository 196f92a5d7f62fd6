//! Where the sun stands at a place and a time.

use solar_positioning::time::JulianDate;
use solar_positioning::{Location, SolarPositions};

use crate::ValueError;
use crate::moment::Moment;
use crate::read_json::document;
use crate::scene::ranges;

document! {
    /// A place and a date, which say where the sun stands.
    pub struct PlaceAndTimeDocument {
        /// North positive.
        "latitude_deg" => latitude_deg: f64 = 51.4769,
        /// East positive.
        "longitude_deg" => longitude_deg: f64 = 0.0,
        /// Date and time there at sky time 0.
        "date" => date: Moment = Moment::from_unix_us(1_782_043_200_000_000),
    }
}

/// A place and a date, which say where the sun stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceAndTime {
    latitude_deg: f64,
    longitude_deg: f64,
    date: Moment,
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

    /// Azimuth (clockwise from north) and elevation of the sun at a sky time, degrees, as seen without air.
    ///
    /// By NREL's Solar Position Algorithm (Reda & Andreas 2003, ±0.0003°). Refraction is left out: light in the scene
    /// goes straight, and so must its source.
    pub fn sun_azimuth_elevation_deg(&self, sky_s: f64) -> [f64; 2] {
        let unix_s = self.date_at(sky_s).unix_s();
        let julian_date = JULIAN_DATE_OF_1970 + unix_s / SECONDS_PER_DAY;
        let year = 1970.0 + unix_s / (365.2425 * SECONDS_PER_DAY);
        // ΔT is about a minute; without it the sun is 0.0003° off.
        let delta_t_s = solar_positioning::delta_t::estimate(year).unwrap_or(69.0);
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

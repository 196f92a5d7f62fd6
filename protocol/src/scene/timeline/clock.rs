//! The sky's own clock: a line through an epoch, so that any server that knows the document tells the same time.

use crate::ValueError;
use crate::moment::Moment;
use crate::read_json::document;
use crate::scene::ranges;

document! {
    /// The sky's clock. Sky time is `sky_s_at_epoch` + `rate` × (now − `epoch`), and stands still from `paused_at` on.
    pub struct TimeDocument {
        /// A moment at which sky time is known.
        "epoch" => epoch: Moment = Moment::UNIX_EPOCH,
        /// Sky time at the epoch, s.
        "sky_s_at_epoch" => sky_s_at_epoch: f64 = 0.0; ranges::SKY_TIME_S,
        /// Seconds of sky time in a second; 24 shows a day in an hour, a negative number runs backwards.
        "rate" => rate: f64 = 1.0; ranges::TIME_RATE,
        /// When the sky was stopped; null while it runs.
        "paused_at" => paused_at: Option<Moment> = None,
        /// Seconds of wind in a second while the sky runs; null for `rate`. A day in an hour with a wind_rate of 1 has
        /// clouds that pass as quietly as ever.
        "wind_rate" => wind_rate: Option<f64> = None; ranges::TIME_RATE,
    }
}

/// The sky's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyClock {
    epoch: Moment,
    sky_s_at_epoch: f64,
    rate: f64,
    paused_at: Option<Moment>,
    wind_rate: Option<f64>,
}

impl SkyClock {
    /// A clock that stands at a sky time.
    pub(super) fn standing_at(sky_s: f64) -> Self {
        Self {
            epoch: Moment::UNIX_EPOCH,
            sky_s_at_epoch: sky_s,
            rate: 0.0,
            paused_at: None,
            wind_rate: None,
        }
    }

    /// Sky time at a moment, s. It stops at the ends of what a document may say, three thousand years away, so that every
    /// moment of a sky is a document as well.
    pub fn sky_s(&self, now: Moment) -> f64 {
        let since_s = self.running_until(now).seconds_since(self.epoch);
        (self.sky_s_at_epoch + self.rate * since_s)
            .clamp(ranges::SKY_TIME_S.min, ranges::SKY_TIME_S.max)
    }

    /// The last moment up to `now` at which the sky ran.
    pub(super) fn running_until(&self, now: Moment) -> Moment {
        self.paused_at.map_or(now, |paused| paused.min(now))
    }

    /// Whether sky time goes on at a moment.
    pub fn is_running(&self, now: Moment) -> bool {
        self.rate != 0.0 && self.paused_at.is_none_or(|paused| now < paused)
    }

    /// When the sky was stopped, if it was.
    pub fn paused_at(&self) -> Option<Moment> {
        self.paused_at
    }

    /// Seconds of sky time in a second while it runs.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Seconds of wind in a second while the sky runs.
    pub fn wind_rate(&self) -> f64 {
        self.wind_rate.unwrap_or(self.rate)
    }

    pub(super) fn epoch(&self) -> Moment {
        self.epoch
    }

    pub(super) fn sky_s_at_epoch(&self) -> f64 {
        self.sky_s_at_epoch
    }
}

impl TimeDocument {
    /// The same sky time at `now`, told from there: the place to change what follows.
    fn rebased(&self, now: Moment) -> Self {
        let clock = SkyClock {
            epoch: self.epoch,
            sky_s_at_epoch: self.sky_s_at_epoch,
            rate: self.rate,
            paused_at: self.paused_at,
            wind_rate: self.wind_rate,
        };
        Self {
            epoch: now,
            sky_s_at_epoch: clock.sky_s(now),
            paused_at: self.paused_at.map(|_| now),
            ..self.clone()
        }
    }

    /// From `now` on another sky time, another rate, or stopped or running, where given.
    #[must_use]
    pub fn changed(&self, now: Moment, change: &TimeChange) -> Self {
        let mut time = self.rebased(now);
        if let Some(sky_s) = change.sky_s {
            time.sky_s_at_epoch = sky_s;
        }
        if let Some(rate) = change.rate {
            time.rate = rate;
        }
        if let Some(wind_rate) = change.wind_rate {
            time.wind_rate = wind_rate;
        }
        if let Some(paused) = change.paused {
            time.paused_at = paused.then_some(now);
        }
        time
    }
}

/// What of a sky's clock is to be another from now on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimeChange {
    /// Sky time, s.
    pub sky_s: Option<f64>,
    /// Seconds of sky time in a second.
    pub rate: Option<f64>,
    /// Seconds of wind in a second; none inside for the rate.
    pub wind_rate: Option<Option<f64>>,
    /// Stopped or running.
    pub paused: Option<bool>,
}

impl TryFrom<TimeDocument> for SkyClock {
    type Error = ValueError;

    fn try_from(document: TimeDocument) -> Result<Self, ValueError> {
        let wind_rate = document
            .wind_rate
            .map(|rate| ranges::TIME_RATE.check("/wind_rate", rate));
        Ok(Self {
            epoch: document.epoch,
            sky_s_at_epoch: ranges::SKY_TIME_S.check("/sky_s_at_epoch", document.sky_s_at_epoch)?,
            rate: ranges::TIME_RATE.check("/rate", document.rate)?,
            paused_at: document.paused_at,
            wind_rate: wind_rate.transpose()?,
        })
    }
}

impl From<&SkyClock> for TimeDocument {
    fn from(clock: &SkyClock) -> Self {
        Self {
            epoch: clock.epoch,
            sky_s_at_epoch: clock.sky_s_at_epoch,
            rate: clock.rate,
            paused_at: clock.paused_at,
            wind_rate: clock.wind_rate,
        }
    }
}

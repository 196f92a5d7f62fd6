//! How exposure follows what a meter reads.

use skycell_protocol::scene::AutoExposure;

/// Geometric mean of exposed luminance that calls for no change. Tuned: the default scene has it.
pub(super) const MIDDLE: f64 = 0.22;
/// Exposure does not follow a smaller change, stops: noise of the meter and a passing cloud do not move it.
const DEAD_BAND_EV: f64 = 0.15;
/// And ends when it is this close.
const ARRIVED_EV: f64 = 0.01;
/// Fastest change, stops per second: a fifth of a second for the sun going behind a cloud would be a flash.
const RATE_MAX_EV_PER_S: f64 = 2.0;

/// Where exposure is, where it goes, and how. Plain arithmetic.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::frame_loop) struct Adaptation {
    /// Exposure that pictures have, stops; none before the first reading.
    present_ev: Option<f64>,
    target_ev: f64,
    moves: bool,
}

impl Adaptation {
    /// Exposure of pictures, stops.
    pub(in crate::frame_loop) fn ev(&self) -> f64 {
        self.present_ev.unwrap_or(0.0)
    }

    /// Takes a reading of the meter: mean of the logarithm to the base 2 of luminance at 0 EV. The first one counts at once.
    pub(in crate::frame_loop) fn read(&mut self, mean_log2: f64, limits: &AutoExposure) {
        if !mean_log2.is_finite() {
            return;
        }
        let wanted = (MIDDLE.log2() - mean_log2).clamp(limits.min_ev(), limits.max_ev());
        match self.present_ev {
            None => {
                self.present_ev = Some(wanted);
                self.target_ev = wanted;
            }
            Some(present) if self.moves || (wanted - present).abs() > DEAD_BAND_EV => {
                self.target_ev = wanted;
                self.moves = true;
            }
            Some(_) => {}
        }
    }

    /// Lets time pass; true when exposure has changed.
    pub(in crate::frame_loop) fn advance(&mut self, seconds: f64, limits: &AutoExposure) -> bool {
        let Some(present) = self.present_ev else {
            return false;
        };
        if !self.moves {
            return false;
        }
        let share = if limits.adaptation_s() > 0.0 {
            1.0 - (-seconds / limits.adaptation_s()).exp()
        } else {
            1.0
        };
        let most = if limits.adaptation_s() > 0.0 {
            RATE_MAX_EV_PER_S * seconds
        } else {
            f64::INFINITY
        };
        let step = ((self.target_ev - present) * share).clamp(-most, most);
        let mut next = present + step;
        if (self.target_ev - next).abs() <= ARRIVED_EV {
            next = self.target_ev;
            self.moves = false;
        }
        self.present_ev = Some(next);
        next != present
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use skycell_protocol::Scene;

    fn limits(min_ev: f64, max_ev: f64) -> AutoExposure {
        let document = json!({"version": 1, "tone": {"auto_exposure":
            {"min_ev": min_ev, "max_ev": max_ev, "adaptation_s": 1.0}}});
        let scene = Scene::from_json(&document).expect("valid");
        scene.tone().auto_exposure().expect("automatic")
    }

    fn log2_of(ev: f64) -> f64 {
        MIDDLE.log2() - ev
    }

    #[test]
    fn a_step_in_brightness_is_followed_without_overshoot_within_the_rate_and_then_rests() {
        let limits = limits(-4.0, 8.0);
        let mut adaptation = Adaptation::default();
        adaptation.read(log2_of(0.0), &limits);
        assert_eq!(adaptation.ev(), 0.0);
        let (mut last, mut frames) = (0.0, 0);
        loop {
            adaptation.read(log2_of(3.0), &limits);
            if !adaptation.advance(0.05, &limits) {
                break;
            }
            let ev = adaptation.ev();
            assert!(ev > last && ev <= 3.0 && ev - last <= RATE_MAX_EV_PER_S * 0.05 + 1e-12);
            (last, frames) = (ev, frames + 1);
            assert!(frames < 1000, "it never rests");
        }
        assert!((last - 3.0).abs() <= ARRIVED_EV, "{last}");
        // Rest: the same reading, and the noise of a meter, change nothing ever after.
        for noise in [0.0, 0.1, -0.1, 0.14] {
            adaptation.read(log2_of(3.0 + noise), &limits);
            assert!(!adaptation.advance(0.05, &limits));
        }
    }

    #[test]
    fn exposure_stays_within_its_bounds_whatever_is_read() {
        let limits = limits(-1.0, 2.0);
        let mut adaptation = Adaptation::default();
        for reading in [
            f64::NEG_INFINITY,
            -200.0,
            200.0,
            f64::NAN,
            0.0,
            f64::INFINITY,
            -50.0,
        ] {
            adaptation.read(reading, &limits);
            for _ in 0..200 {
                adaptation.advance(0.1, &limits);
                assert!((-1.0..=2.0).contains(&adaptation.ev()), "{reading}");
            }
        }
    }
}

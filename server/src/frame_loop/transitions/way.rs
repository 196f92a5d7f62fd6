//! How far a viewer's picture is on its way from one view cell's to another's. Pure decisions; seconds are told.

/// A viewer that stands is shown the way between two references that are a radian apart, seen from the lowest clouds, in this
/// time, s. Tuned: so slowly that no frame differs from the one before by twice what wind makes it (`transitions/tests.rs`).
const STANDING_RADIAN_S: f64 = 40.0;
/// Pictures differ less than in proportion to how far references are apart: by this power of it.
const STANDING_POWER: f64 = 0.75;
/// A way takes never less or more than this, s.
const STANDING_S: std::ops::RangeInclusive<f64> = 4.0..=45.0;
/// By rays of the viewer's own never more than this, s: each of these frames is marched for it alone.
const RAYS_STANDING_MAX_S: f64 = 600.0;
/// Share of the way in which it sets out, and in which it arrives; in between it is even, since the fastest part sets the time.
const EASE: f64 = 0.15;
/// One that moves, however fast, in this time at least, s.
const HURRIED_S: f64 = 0.2;
/// Time that passes between two pictures at most, s: a loop that was held up shows no jump.
const FRAME_MAX_S: f64 = 0.1;
/// Motion tells whether somebody moves for so long, s: who stood still again before the way began is shown it slowly.
const MOTION_KEPT_S: f64 = 0.3;
/// A motion by more than so many ways at once is a jump: what was seen before has nothing to do with what is seen now.
const JUMP: f64 = 6.0;
/// A cell is shown that still lacks tiles when its viewer has waited so long for them, s.
const FINE_WAIT_S: f64 = 6.0;
/// Who has waited so long, s, is shown the new cell as it is: there is no room for both.
const WAIT_MAX_S: f64 = 12.0;
/// A turn that hides a whole way, rad.
const TURN_RAD: f64 = 0.45;
/// A motion that does, as an angle seen from the lowest clouds, rad: walking takes minutes for it, a plane less than a second.
const MOTION_RAD: f64 = 0.05;

/// What a viewer's cell can show of what it looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::frame_loop) enum Readiness {
    /// Less than the whole sky.
    Missing,
    /// The coarse level.
    Coarse,
    /// All that is asked for.
    Fine,
}

/// What is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::frame_loop) enum Stage {
    /// The old cell, until the new one can be.
    Waits,
    /// Both.
    Fades,
    /// The new one.
    Arrived,
    /// The new one at once, because it took too long.
    GivenUp,
}

/// The way between two pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::frame_loop) struct Way {
    stage: Stage,
    standing_s: f64,
    waited_s: f64,
    /// Share of the way, 0…1, even in time while the viewer stands.
    gone: f64,
    /// Ways that the last motions hide.
    motion: f64,
    jumped: bool,
}

impl Way {
    /// A way between cells whose references are apart by an angle, seen from the lowest clouds.
    pub(super) fn new(apart_rad: f64) -> Self {
        let standing_s = STANDING_RADIAN_S * apart_rad.powf(STANDING_POWER);
        Self {
            stage: Stage::Waits,
            standing_s: standing_s.clamp(*STANDING_S.start(), *STANDING_S.end()),
            waited_s: 0.0,
            gone: 0.0,
            motion: 0.0,
            jumped: false,
        }
    }

    /// The same after a jump: what was seen before is shown until there is anything else.
    pub(super) fn of_a_jump(apart_rad: f64) -> Self {
        Self {
            jumped: true,
            ..Self::new(apart_rad)
        }
    }

    /// A way that rays of the viewer's own make, so long while it stands, s.
    pub(super) fn of_rays(standing_s: f64) -> Self {
        Self {
            standing_s: standing_s.clamp(*STANDING_S.start(), RAYS_STANDING_MAX_S),
            ..Self::new(0.0)
        }
    }

    /// The same when rays are shown already.
    pub(super) fn shown(self) -> Self {
        Self {
            stage: Stage::Fades,
            ..self
        }
    }

    pub(in crate::frame_loop) fn stage(&self) -> Stage {
        self.stage
    }

    /// Whether the viewer has jumped since it left the old cell.
    pub(in crate::frame_loop) fn has_jumped(&self) -> bool {
        self.jumped
    }

    /// Share of the new picture, 0…1: sets out and arrives without a jolt.
    pub(in crate::frame_loop) fn share(&self) -> f64 {
        let nearer_end = self.gone.min(1.0 - self.gone);
        let from_end = if nearer_end < EASE {
            0.5 * nearer_end * nearer_end / EASE
        } else {
            nearer_end - 0.5 * EASE
        } / (1.0 - EASE);
        if self.gone < 0.5 {
            from_end
        } else {
            1.0 - from_end
        }
    }

    /// Ways that a turn and a motion seen from the clouds hide, both rad.
    pub(super) fn hidden_by(turned_rad: f64, moved_rad: f64) -> f64 {
        turned_rad / TURN_RAD + moved_rad / MOTION_RAD
    }

    /// Whether a motion is a jump that hides so many ways.
    pub(super) fn is_a_jump(motion: f64) -> bool {
        motion > JUMP
    }

    /// Lets time pass in which the viewer has moved so that `motion` ways are hidden, with what the new cell can show.
    pub(super) fn pass(&mut self, passed_s: f64, motion: f64, ready: Readiness) {
        self.jumped |= Self::is_a_jump(motion);
        self.motion = self.motion * (-passed_s / MOTION_KEPT_S).exp() + motion;
        match self.stage {
            Stage::Waits => {
                self.waited_s += passed_s;
                let is_late = self.waited_s >= FINE_WAIT_S || self.jumped;
                if ready == Readiness::Fine || (ready == Readiness::Coarse && is_late) {
                    self.stage = Stage::Fades;
                } else if self.waited_s >= WAIT_MAX_S {
                    self.stage = Stage::GivenUp;
                }
            }
            Stage::Fades => {
                let passed_s = passed_s.min(FRAME_MAX_S);
                let most = passed_s / HURRIED_S;
                let hidden = if self.jumped {
                    most
                } else {
                    self.motion.min(most)
                };
                self.motion -= hidden.min(self.motion);
                self.gone += (passed_s / self.standing_s + hidden).min(most);
                if self.gone >= 1.0 {
                    self.gone = 1.0;
                    self.stage = Stage::Arrived;
                }
            }
            Stage::Arrived | Stage::GivenUp => {}
        }
    }

    /// The same of rays of the viewer's own, which are `ready` when they show all that the old cell's cache does. After a jump they
    /// show the new place at once.
    pub(super) fn pass_rays(&mut self, passed_s: f64, motion: f64, ready: bool) {
        let ready = if ready {
            Readiness::Fine
        } else {
            Readiness::Missing
        };
        self.pass(passed_s, motion, ready);
        if self.jumped && self.stage != Stage::GivenUp {
            self.gone = 1.0;
            self.stage = Stage::Arrived;
        }
    }

    /// Goes to a place of the way, 0…1 in time.
    #[cfg(test)]
    pub(in crate::frame_loop) fn hold_at(&mut self, gone: f64) {
        self.gone = gone;
    }

    /// Shows the new cell at once.
    pub(super) fn give_up(&mut self) {
        self.stage = Stage::GivenUp;
    }

    /// The way back from where it is: the same picture with both cells exchanged.
    pub(super) fn turn_round(&mut self) {
        self.gone = 1.0 - self.gone;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A way that has begun.
    fn begun() -> Way {
        let mut way = Way::new(0.0);
        way.pass(0.1, 0.0, Readiness::Fine);
        assert_eq!(way.stage(), Stage::Fades);
        way
    }

    /// Seconds that a way takes when every frame of 10 ms hides so much.
    fn takes_s(motion: f64) -> f64 {
        let mut way = begun();
        let mut frames = 0;
        while way.stage() == Stage::Fades {
            way.pass(0.01, motion, Readiness::Fine);
            frames += 1;
        }
        0.01 * f64::from(frames)
    }

    #[test]
    fn a_way_is_slow_at_rest_and_the_faster_the_faster_one_turns_or_flies() {
        let turn = |deg_per_s: f64| takes_s(Way::hidden_by(0.01 * deg_per_s.to_radians(), 0.0));
        let flight = |m_per_s: f64| takes_s(Way::hidden_by(0.0, 0.01 * m_per_s / 2_000.0));
        assert!((takes_s(0.0) - STANDING_S.start()).abs() < 0.02);
        assert!(flight(1.4) > 3.5, "walking hides little: {}", flight(1.4));
        let (slow, fast) = (turn(30.0), turn(90.0));
        assert!(fast < slow && slow < 1.0 && (0.2..0.5).contains(&fast));
        assert!(flight(250.0) < 0.5 && flight(250.0) < flight(50.0));
        assert!((takes_s(1e6) - HURRIED_S).abs() < 0.02, "never at once");
    }

    #[test]
    fn who_turned_before_the_way_began_and_stands_is_shown_it_slowly() {
        let mut way = Way::new(0.0);
        way.pass(0.05, 1.0, Readiness::Missing);
        for _ in 0..40 {
            way.pass(0.05, 0.0, Readiness::Missing);
        }
        way.pass(0.05, 0.0, Readiness::Fine);
        way.pass(0.05, 0.0, Readiness::Fine);
        assert!(way.share() < 0.001, "{way:?}");
    }

    #[test]
    fn the_old_cell_is_shown_until_the_new_one_can_be_and_no_longer_than_a_limit() {
        let waits = |ready: Readiness, jump: f64| {
            let mut way = Way::new(0.0);
            let mut waited_s = 0.0;
            while way.stage() == Stage::Waits {
                assert_eq!(way.share(), 0.0);
                way.pass(0.1, jump, ready);
                waited_s += 0.1;
            }
            (waited_s, way.stage())
        };
        let (coarse_s, stage) = waits(Readiness::Coarse, 0.0);
        assert!((coarse_s - FINE_WAIT_S).abs() < 0.11 && stage == Stage::Fades);
        let (missing_s, stage) = waits(Readiness::Missing, 0.0);
        assert!((missing_s - WAIT_MAX_S).abs() < 0.11 && stage == Stage::GivenUp);
        // After a jump the coarse sky is better than that of elsewhere.
        assert!(waits(Readiness::Coarse, 10.0).0 < 0.2);
    }

    proptest! {
        #[test]
        fn a_way_never_goes_back_and_no_frame_goes_far(motions in proptest::collection::vec(0.0..20.0f64, 1..200)) {
            let mut way = begun();
            for motion in motions {
                let before = way.share();
                way.pass(0.02, motion, Readiness::Coarse);
                let most = 0.02 / HURRIED_S / (1.0 - EASE);
                prop_assert!(way.share() >= before && way.share() - before <= most + 1e-12);
            }
        }

        #[test]
        fn turning_round_shows_the_same_picture(frames in 0..60u32) {
            let mut way = begun();
            for _ in 0..frames {
                way.pass(0.05, 0.0, Readiness::Fine);
            }
            let before = way.share();
            way.turn_round();
            prop_assert!((way.share() - (1.0 - before)).abs() < 1e-12);
        }
    }
}

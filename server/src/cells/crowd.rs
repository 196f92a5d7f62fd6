//! Simulated viewers who walk, meet, migrate and fly: what cells have to hold, without pictures.

use fastrand::Rng;
use glam::DVec3;
use std::f64::consts::TAU;

/// Side of the square in which a crowd begins, m.
const TOWN_M: f64 = 20_000.0;
/// Height of eyes, m.
const EYES_M: f64 = 2.0;
/// Walking pace, m/s.
const WALK_M_PER_S: f64 = 1.5;
/// A car in town, m/s.
const DRIVE_M_PER_S: f64 = 14.0;
/// Pace of a convoy, m/s.
const CONVOY_M_PER_S: f64 = 30.0;
/// Pace of an aircraft, m/s, and how high it goes, m.
const FLIGHT_M_PER_S: f64 = 230.0;
const FLIGHT_ALTITUDE_M: f64 = 3_000.0;
/// Rate of climb, m/s.
const CLIMB_M_PER_S: f64 = 12.0;
/// Viewers of a convoy or a flight.
const GROUP: usize = 25;
/// How often somebody who wanders turns elsewhere, 1/s.
const TURNS_PER_S: f64 = 0.05;

/// What a crowd does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CrowdMotion {
    /// Each goes somewhere, and after a while somewhere else; some walk, some drive.
    Wander,
    /// All walk or drive to three squares and stay there.
    Gather,
    /// Convoys that set out to all sides.
    Migrate,
    /// Flights in formation that climb, cross the sky and come down again.
    Fly,
}

impl CrowdMotion {
    /// Every motion.
    pub const ALL: [Self; 4] = [Self::Wander, Self::Gather, Self::Migrate, Self::Fly];

    /// As people write it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Wander => "wander",
            Self::Gather => "gather",
            Self::Migrate => "migrate",
            Self::Fly => "fly",
        }
    }
}

#[derive(Clone, Debug)]
struct Walker {
    position_m: DVec3,
    heading_rad: f64,
    speed_m_per_s: f64,
}

/// Viewers that move. The same numbers give the same way, whatever the machine.
#[derive(Clone, Debug)]
pub struct Crowd {
    motion: CrowdMotion,
    walkers: Vec<Walker>,
    rng: Rng,
    time_s: f64,
}

impl Crowd {
    /// A crowd at its start.
    #[must_use]
    pub fn new(count: usize, motion: CrowdMotion, seed: u64) -> Self {
        let mut rng = Rng::with_seed(seed);
        let in_town = |rng: &mut Rng| {
            let [x, z] = [0; 2].map(|_| (rng.f64() - 0.5) * TOWN_M);
            DVec3::new(x, EYES_M, z)
        };
        let mut start_m = DVec3::ZERO;
        let mut heading_rad = 0.0;
        let walkers = (0..count).map(|index| {
            let in_groups = matches!(motion, CrowdMotion::Migrate | CrowdMotion::Fly);
            if !in_groups || index % GROUP == 0 {
                start_m = in_town(&mut rng);
                heading_rad = rng.f64() * TAU;
            }
            let beside = |rng: &mut Rng| (rng.f64() - 0.5) * 400.0;
            let position_m = if in_groups {
                start_m + DVec3::new(beside(&mut rng), 0.0, beside(&mut rng))
            } else {
                start_m
            };
            let speed_m_per_s = match motion {
                CrowdMotion::Migrate => CONVOY_M_PER_S,
                CrowdMotion::Fly => FLIGHT_M_PER_S,
                _ if rng.bool() => WALK_M_PER_S,
                _ => DRIVE_M_PER_S,
            };
            Walker {
                position_m,
                heading_rad,
                speed_m_per_s,
            }
        });
        let walkers = walkers.collect();
        Self {
            motion,
            walkers,
            rng,
            time_s: 0.0,
        }
    }

    /// Where everybody is: x, altitude, z.
    pub fn positions_m(&self) -> impl Iterator<Item = DVec3> {
        self.walkers.iter().map(|walker| walker.position_m)
    }

    /// Time passes, s.
    pub fn advance(&mut self, passed_s: f64) {
        self.time_s += passed_s;
        let count = self.walkers.len().max(1);
        for (index, walker) in self.walkers.iter_mut().enumerate() {
            let ahead = DVec3::new(walker.heading_rad.sin(), 0.0, -walker.heading_rad.cos());
            let step_m = walker.speed_m_per_s * passed_s;
            match self.motion {
                CrowdMotion::Wander => {
                    if self.rng.f64() < TURNS_PER_S * passed_s {
                        walker.heading_rad = self.rng.f64() * TAU;
                    }
                    walker.position_m += ahead * step_m;
                    // Town has an edge, at which people turn round.
                    let half = DVec3::new(TOWN_M / 2.0, EYES_M, TOWN_M / 2.0);
                    let inside = walker.position_m.clamp(-half, half).with_y(EYES_M);
                    if inside != walker.position_m {
                        walker.heading_rad += TAU / 2.0;
                        walker.position_m = inside;
                    }
                }
                CrowdMotion::Gather => {
                    let square = index % 3;
                    let angle = square as f64 * TAU / 3.0;
                    let place = index as f64 / count as f64 * TAU * 7.0;
                    let goal_m = DVec3::new(angle.sin(), 0.0, angle.cos()) * 4_000.0
                        + DVec3::new(place.sin(), 0.0, place.cos()) * 60.0
                        + DVec3::Y * EYES_M;
                    let way_m = goal_m - walker.position_m;
                    walker.position_m += way_m.clamp_length_max(step_m);
                }
                CrowdMotion::Migrate => walker.position_m += ahead * step_m,
                CrowdMotion::Fly => {
                    walker.position_m += ahead * step_m;
                    let climbs = self.time_s % 600.0 < 300.0;
                    let goal_m = if climbs { FLIGHT_ALTITUDE_M } else { EYES_M };
                    let climb_m = CLIMB_M_PER_S * passed_s;
                    let up_m = (goal_m - walker.position_m.y).clamp(-climb_m, climb_m);
                    walker.position_m.y += up_m;
                }
            }
        }
    }
}

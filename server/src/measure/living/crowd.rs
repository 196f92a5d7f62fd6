//! Viewers who stand together and look around.

use anyhow::Context;
use skycell_protocol::Camera;
use std::f64::consts::TAU;

/// Height of everybody's eyes, m.
const EYE_M: f64 = 2.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;
/// How far up everybody looks in the mean, and how much more or less, degrees.
const PITCH_DEG: [f64; 2] = [20.0, 8.0];

/// Viewers in a circle. Every fourth turns round and round; the others look to and fro about directions that are even around the
/// horizon, each at a speed of its own: neighbours share much of what they see, and at times nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct LookingCrowd {
    viewers: u32,
    spread_m: f64,
    walk_m_per_s: f64,
}

impl LookingCrowd {
    /// So many, in a circle of this radius that goes east.
    #[must_use]
    pub(super) fn new(viewers: u32, spread_m: f64, walk_m_per_s: f64) -> Self {
        Self {
            viewers,
            spread_m,
            walk_m_per_s,
        }
    }

    /// Where one looks.
    ///
    /// # Errors
    /// When there is no such camera: never for finite times, spreads and speeds.
    pub(super) fn camera(&self, viewer: usize, at_s: f64) -> anyhow::Result<Camera> {
        let place = viewer as f64 / f64::from(self.viewers.max(1));
        let towards_deg = 360.0 * place;
        // Periods from 9 to 24 s that fit into none of the others.
        let period_s = 9.0 + (viewer as f64 * 0.618).fract() * 15.0;
        let phase = at_s / period_s + place * 5.0;
        let yaw_deg = if viewer.is_multiple_of(4) {
            towards_deg + 360.0 * at_s / (2.0 * period_s)
        } else {
            towards_deg + 50.0 * (TAU * phase).sin()
        };
        let pitch_deg = PITCH_DEG[0] + PITCH_DEG[1] * (TAU * phase * 0.7).cos();
        let (sin, cos) = (TAU * place).sin_cos();
        // The golden ratio again: they fill the circle, not its rim.
        let away_m = self.spread_m * (viewer as f64 * 0.618).fract().sqrt();
        Camera::new(
            [away_m * sin + self.walk_m_per_s * at_s, EYE_M, away_m * cos],
            yaw_deg.rem_euclid(360.0),
            pitch_deg,
            FOV_DEG,
        )
        .context("a viewer (--spread-m, --walk-m-per-s)")
    }

    /// Where all look.
    ///
    /// # Errors
    /// As above.
    pub(super) fn cameras(&self, at_s: f64) -> anyhow::Result<Vec<Camera>> {
        (0..self.viewers as usize)
            .map(|viewer| self.camera(viewer, at_s))
            .collect()
    }
}

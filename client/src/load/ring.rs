//! Viewers at one place, turned about the vertical axis (Clouds in the Cloud, 6.4).
//!
//! n viewers get a horizontal field of view of at most 360/n degrees, so that at 0 % overlap they
//! stand side by side all round without meeting again behind; neighbours are turned by
//! (1 - overlap) times that. The nominal overlap counts angles at the horizon: the upper corners of
//! pictures that look up reach further round, so what the server measures is a little more.

use skycell_protocol::{Camera, FrameSize, ValueError};

/// How many viewers a ring may have: more have fields of view near the smallest lawful one.
pub const RING_VIEWERS_MAX: u32 = 128;
/// A wider picture stretches so much towards its edges that no viewer would wish it.
const HORIZONTAL_FOV_MAX_DEG: f64 = 90.0;
const HORIZONTAL_FOV_MIN_DEG: f64 = 1.0;

/// The geometry that all overlaps of a test share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewerRing {
    viewers: u32,
    position_m: [f64; 3],
    pitch_deg: f64,
    horizontal_fov_deg: f64,
    vertical_fov_deg: f64,
}

impl ViewerRing {
    /// A ring of `viewers` at a place. Without a wish the field of view is 360/n degrees, 90 at
    /// most.
    ///
    /// # Errors
    /// If the field of view is wider than 360/n degrees, or a camera would not be allowed.
    pub fn new(
        viewers: u32,
        size: FrameSize,
        position_m: [f64; 3],
        pitch_deg: f64,
        wished_fov_deg: Option<f64>,
    ) -> Result<Self, ValueError> {
        if viewers == 0 || viewers > RING_VIEWERS_MAX {
            let allowed = format!("1 to {RING_VIEWERS_MAX}");
            return Err(ValueError::of_number("/viewers", viewers.into(), allowed));
        }
        let widest_deg = (360.0 / f64::from(viewers)).min(HORIZONTAL_FOV_MAX_DEG);
        let horizontal_fov_deg = wished_fov_deg.unwrap_or(widest_deg);
        if !(HORIZONTAL_FOV_MIN_DEG..=widest_deg).contains(&horizontal_fov_deg) {
            return Err(ValueError::of_number(
                "/horizontal_fov_deg",
                horizontal_fov_deg,
                format!("{HORIZONTAL_FOV_MIN_DEG} to {widest_deg} with {viewers} viewers"),
            ));
        }
        let ring = Self {
            viewers,
            position_m,
            pitch_deg,
            horizontal_fov_deg,
            vertical_fov_deg: vertical_fov_deg(horizontal_fov_deg, size),
        };
        // Yaw alone differs between the cameras of a ring, and every yaw of it is in range.
        Camera::new(position_m, 0.0, pitch_deg, ring.vertical_fov_deg)?;
        Ok(ring)
    }

    /// How many viewers.
    pub fn viewers(&self) -> u32 {
        self.viewers
    }

    /// Where all stand.
    pub fn position_m(&self) -> [f64; 3] {
        self.position_m
    }

    /// How far up all look.
    pub fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }

    /// Across a picture.
    pub fn horizontal_fov_deg(&self) -> f64 {
        self.horizontal_fov_deg
    }

    /// Between a picture's upper and lower edge.
    pub fn vertical_fov_deg(&self) -> f64 {
        self.vertical_fov_deg
    }

    /// How far neighbours are turned against each other. `overlap`: 0 to 1.
    pub fn turn_between_neighbours_deg(&self, overlap: f64) -> f64 {
        (1.0 - overlap) * self.horizontal_fov_deg
    }

    /// Share of the requested sky that is left when what several request is counted once, by
    /// angles alone: 1 without overlap, 1/n with all of it.
    pub fn unique_share(&self, overlap: f64) -> f64 {
        let viewers = f64::from(self.viewers);
        (1.0 + (viewers - 1.0) * (1.0 - overlap)) / viewers
    }

    /// The camera of a viewer. The whole ring may be turned besides.
    pub fn camera(&self, viewer: u32, overlap: f64, ring_turn_deg: f64) -> Camera {
        let yaw_deg = f64::from(viewer) * self.turn_between_neighbours_deg(overlap) + ring_turn_deg;
        Camera::new(
            self.position_m,
            yaw_deg.rem_euclid(360.0),
            self.pitch_deg,
            self.vertical_fov_deg,
        )
        // Checked with another yaw when the ring was made; a NaN turn keeps the default.
        .unwrap_or_default()
    }
}

/// The angle between upper and lower edge of a flat picture of square pixels.
pub fn vertical_fov_deg(horizontal_fov_deg: f64, size: FrameSize) -> f64 {
    let half_width = (horizontal_fov_deg.to_radians() / 2.0).tan();
    let half_height = half_width * f64::from(size.height()) / f64::from(size.width());
    2.0 * half_height.atan().to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size() -> FrameSize {
        FrameSize::new(640, 360).expect("in range")
    }

    fn ring(viewers: u32) -> ViewerRing {
        ViewerRing::new(viewers, size(), [0.0, 2.0, 0.0], 12.0, None).expect("a ring")
    }

    #[test]
    fn without_overlap_the_viewers_close_the_circle_and_no_more() {
        for viewers in [4, 5, 16, 128] {
            let ring = ring(viewers);
            let round_deg = f64::from(viewers) * ring.turn_between_neighbours_deg(0.0);
            assert!((round_deg - 360.0).abs() < 1e-9, "{viewers}: {round_deg}");
        }
        assert_eq!(ring(1).horizontal_fov_deg(), 90.0);
        assert_eq!(ring(2).horizontal_fov_deg(), 90.0);
    }

    #[test]
    fn full_overlap_is_one_camera_for_all() {
        let ring = ring(16);
        let first = ring.camera(0, 1.0, 0.0);
        assert!((1..16).all(|viewer| ring.camera(viewer, 1.0, 0.0) == first));
    }

    #[test]
    fn neighbours_share_the_overlap_of_their_angle() {
        let ring = ring(16);
        let turn_deg = ring.camera(1, 0.8, 0.0).yaw_deg() - ring.camera(0, 0.8, 0.0).yaw_deg();
        assert!((turn_deg - 0.2 * 22.5).abs() < 1e-9, "{turn_deg}");
    }

    #[test]
    fn the_unique_share_goes_from_all_to_one_viewers_part() {
        let ring = ring(16);
        assert_eq!(ring.unique_share(0.0), 1.0);
        assert_eq!(ring.unique_share(1.0), 1.0 / 16.0);
        assert!((ring.unique_share(0.6) - 7.0 / 16.0).abs() < 1e-12);
    }

    #[test]
    fn a_picture_has_square_pixels() {
        // 90 degrees across: the half width is 1, the half height 9/16.
        let expected_deg = 2.0 * (9.0f64 / 16.0).atan().to_degrees();
        assert!((vertical_fov_deg(90.0, size()) - expected_deg).abs() < 1e-9);
    }

    #[test]
    fn the_whole_ring_turns_and_yaw_stays_within_a_turn() {
        let ring = ring(16);
        let turned = ring.camera(15, 0.0, 30.0);
        assert!((turned.yaw_deg() - (15.0 * 22.5 + 30.0 - 360.0)).abs() < 1e-9);
        assert!((0.0..360.0).contains(&ring.camera(0, 0.0, -10.0).yaw_deg()));
    }

    #[test]
    fn impossible_rings_are_refused_by_name() {
        let refused = |viewers, pitch_deg, fov_deg| {
            ViewerRing::new(viewers, size(), [0.0, 2.0, 0.0], pitch_deg, fov_deg)
                .expect_err("not allowed")
                .pointer
        };
        assert_eq!(refused(0, 12.0, None), "/viewers");
        assert_eq!(refused(129, 12.0, None), "/viewers");
        assert_eq!(refused(16, 12.0, Some(30.0)), "/horizontal_fov_deg");
        assert_eq!(refused(16, 12.0, Some(f64::NAN)), "/horizontal_fov_deg");
        assert_eq!(refused(16, 91.0, None), "/pitch_deg");
        let flat = FrameSize::new(3840, 10).expect("in range");
        let error = ViewerRing::new(16, flat, [0.0, 2.0, 0.0], 12.0, None).expect_err("too flat");
        assert_eq!(error.pointer, "/vertical_fov_deg");
    }
}

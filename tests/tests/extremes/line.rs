//! One line of the list of extremes: its cases, how near each came to its bound, and what broke.

use skycell_server::frame_loop::{LayerFigures, StillPicture};
use skycell_tests::numbers::{U, share};
use std::fmt::Display;

/// Cases of one line.
#[derive(Debug)]
pub(crate) struct Line {
    name: &'static str,
    cases: usize,
    worst: f64,
    worst_case: String,
    broken: Vec<String>,
}

impl Line {
    pub(crate) fn new(name: &'static str) -> Self {
        Self {
            name,
            cases: 0,
            worst: 0.0,
            worst_case: String::from("-"),
            broken: Vec::new(),
        }
    }

    /// One more case begins; its checks follow.
    pub(crate) fn case(&mut self) {
        self.cases += 1;
    }

    /// An error and the bound that it must not exceed.
    pub(crate) fn holds(&mut self, what: impl Display, error: f64, bound: f64) {
        let share = share(error, bound);
        if share > self.worst {
            self.worst = share;
            self.worst_case = what.to_string();
        }
        if share > 1.0 {
            self.broken
                .push(format!("{what}: error {error:.4e}, bound {bound:.4e}"));
        }
    }

    /// A claim without a number.
    pub(crate) fn is(&mut self, what: impl Display, holds: bool) {
        if !holds {
            self.worst = f64::INFINITY;
            self.worst_case = what.to_string();
            self.broken.push(what.to_string());
        }
    }

    /// A case that is a picture: finite, nothing negative.
    pub(crate) fn picture(&mut self, what: impl Display, picture: &StillPicture) {
        self.case();
        let bad = picture
            .linear
            .iter()
            .find(|value| !value.is_finite() || **value < 0.0);
        self.is(
            format!("{what}: a radiance is {bad:?}"),
            bad.is_none() && !picture.linear.is_empty(),
        );
    }

    /// What a ray gathered in a layer: transmittance in 0...1, no more light than the opacity can scatter.
    /// `octaves_max_per_sr` bounds the sum of the higher octaves' phases, `ambient` is the scene's factor.
    pub(crate) fn layer(
        &mut self,
        what: impl Display,
        found: &LayerFigures,
        octaves_max_per_sr: f64,
        ambient: f64,
    ) {
        let figures = [
            found.single,
            found.octaves,
            found.ambient,
            found.transmittance,
            found.opacity_distance_m,
            found.optical_depth,
        ];
        self.is(
            format!("{what}: {found:?}"),
            figures.iter().all(|v| v.is_finite() && *v >= 0.0) && found.transmittance <= 1.0,
        );
        // Sums of up to `steps` terms, each rounded a few times, against 1 - T, whose own rounding is U.
        let opacity = 1.0 - (-f64::from(found.optical_depth)).exp();
        let rounding = 8.0 * U * (f64::from(found.steps) + 16.0);
        for (name, value, factor) in [
            ("single", found.single, 1.0),
            ("octaves", found.octaves, octaves_max_per_sr),
            ("ambient", found.ambient, ambient),
        ] {
            self.holds(
                format!("{what}: {name} beyond what the opacity scatters"),
                (f64::from(value) - factor * opacity).max(0.0),
                factor * rounding + 1e-30,
            );
        }
    }

    /// How far the worst case went, in units of its bound.
    pub(crate) fn worst(&self) -> f64 {
        self.worst
    }

    /// Prints the line and fails where a case broke its bound or cases are missing.
    pub(crate) fn finish(&self, expected_cases: usize) {
        println!("{}", self.row());
        assert!(
            self.broken.is_empty(),
            "{} of {}: {:#?}",
            self.broken.len(),
            self.name,
            &self.broken[..self.broken.len().min(12)]
        );
        assert_eq!(self.cases, expected_cases, "cases of {}", self.name);
    }

    fn row(&self) -> String {
        format!(
            "{:<28} {:>4} cases, worst at {:>9.3e} of its bound: {}",
            self.name, self.cases, self.worst, self.worst_case
        )
    }
}

//! Emission and extinction along a step.

/// (1 − e^−x) / x for x ≥ 0, by `expm1`, which keeps all digits; 1 at 0.
#[must_use]
pub fn one_minus_exp_over(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { -(-x).exp_m1() / x }
}

/// ∫ e^(−σ s) ds over a step of length L, m: the share of a constant source that the step adds (S. Hillaire 2016).
#[must_use]
pub fn step_source_length_m(extinction_per_m: f64, step_m: f64) -> f64 {
    step_m * one_minus_exp_over(extinction_per_m * step_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quotient_agrees_with_its_series_and_its_limits() {
        assert_eq!(one_minus_exp_over(0.0), 1.0);
        for x in [1e-300, 1e-12, 1e-6, 1e-3] {
            let series = 1.0 - x / 2.0 + x * x / 6.0 - x * x * x / 24.0;
            assert!((one_minus_exp_over(x) - series).abs() < 1e-13, "{x}");
        }
        assert!((one_minus_exp_over(1e8) - 1e-8).abs() < 1e-20);
        assert_eq!(one_minus_exp_over(f64::INFINITY), 0.0);
        assert!((step_source_length_m(0.05, 1e6) - 20.0).abs() < 1e-12);
    }
}

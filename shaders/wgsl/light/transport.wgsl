#define_import_path skycell::transport

/// (1 - e^-x) / x for x >= 0; by series below 1e-2, where the quotient loses digits (its error there is below x³/24).
fn one_minus_exp_over(x: f32) -> f32 {
    let series = 1.0 - x * (0.5 - x * (1.0 / 6.0));
    return select((1.0 - exp(-x)) / max(x, 1e-9), series, x < 1e-2);
}

/// Share of a constant source that a step of length step_m adds: ∫ e^(-σ s) ds over the step, m. (Energy-conserving
/// integration: S. Hillaire, "Physically Based Sky, Atmosphere and Cloud Rendering in Frostbite", 2016.)
fn step_source_length_m(extinction_per_m: f32, step_m: f32) -> f32 {
    return step_m * one_minus_exp_over(extinction_per_m * step_m);
}

#define_import_path skycell::phase
#import skycell::scene::Phase

const FOUR_PI: f32 = 12.566370614359172;

/// 1 - cos of the angle between two unit vectors, exact to rounding for small angles: |a - b|² / 2.
fn one_minus_mu(a: vec3f, b: vec3f) -> f32 {
    let difference = a - b;
    return 0.5 * dot(difference, difference);
}

/// Henyey-Greenstein phase, 1/sr. The denominator 1 + g² - 2gµ is taken as (1-|g|)² + 2|g|x with x = 1-µ for a forward
/// and 1+µ for a backward peak: a sum of positive terms, which keeps its digits in either peak.
/// |g| < 1, so the base is at least (1-|g|)² > 0.
fn phase_hg_per_sr(g: f32, one_minus_mu: f32) -> f32 {
    let sharpness = abs(g);
    let from_peak = select(2.0 - one_minus_mu, one_minus_mu, g >= 0.0);
    let base = (1.0 - sharpness) * (1.0 - sharpness) + 2.0 * sharpness * from_peak;
    return (1.0 - sharpness) * (1.0 + sharpness) / (FOUR_PI * base * sqrt(base));
}

/// Draine's phase, 1/sr: HG · (1 + α µ²) / (1 + α (1 + 2 g²) / 3). B. Draine, ApJ 598 (2003), eq. 4.
fn phase_draine_per_sr(g: f32, alpha: f32, one_minus_mu: f32) -> f32 {
    let mu = 1.0 - one_minus_mu;
    let numerator = 1.0 + alpha * mu * mu;
    let denominator = 1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0;
    return phase_hg_per_sr(g, one_minus_mu) * numerator / denominator;
}

/// A layer's phase function, its asymmetry scaled by `eccentricity` (1 = as it is), 1/sr.
/// The blend is Jendersie & d'Eon 2023, eq. 3.
fn phase_per_sr(phase: Phase, eccentricity: f32, one_minus_mu: f32) -> f32 {
    let hg = phase_hg_per_sr(phase.g_hg * eccentricity, one_minus_mu);
    let draine = phase_draine_per_sr(phase.g_draine * eccentricity, phase.alpha_draine, one_minus_mu);
    // The weights make all models one expression: isotropic is HG with g = 0, set on the CPU.
    return mix(hg, draine, phase.draine_weight);
}

/// The phase averaged over the sun's disc, to first order: at the mean of 1-µ over it. The mean of µ over a cap of angular
/// radius r is µ (1 + cos r)/2, so that of 1-µ is (1-µ) + µ (1 - cos r)/2. This tames a peak that is narrower than the sun,
/// forward or backward.
fn phase_over_disc_per_sr(phase: Phase, eccentricity: f32, one_minus_mu: f32, one_minus_mu_disc: f32) -> f32 {
    return phase_per_sr(phase, eccentricity, one_minus_mu + (1.0 - one_minus_mu) * 0.5 * one_minus_mu_disc);
}

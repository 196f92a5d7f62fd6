//! Where droplets scatter light to. Angles enter as x = 1 − cos θ, which keeps its digits in a forward peak.

use glam::DVec3;
use skycell_protocol::scene::PhaseFunction;
use std::f64::consts::PI;

/// 1 − cos of the angle between two unit vectors, |a − b|² / 2.
#[must_use]
pub fn one_minus_mu(a: DVec3, b: DVec3) -> f64 {
    0.5 * (a - b).length_squared()
}

/// 1 − cos of an angular radius, 2 sin²(r/2).
#[must_use]
pub fn one_minus_mu_of_radius(radius_rad: f64) -> f64 {
    2.0 * (0.5 * radius_rad).sin().powi(2)
}

/// Henyey & Greenstein 1941, 1/sr: (1 − g²) / (4π (1 + g² − 2 g µ)^(3/2)). The base is (1 − |g|)² + 2 |g| x from the peak.
#[must_use]
pub fn hg_per_sr(g: f64, one_minus_mu: f64) -> f64 {
    let sharp = g.abs();
    let from_peak = if g >= 0.0 {
        one_minus_mu
    } else {
        2.0 - one_minus_mu
    };
    let base = (1.0 - sharp).powi(2) + 2.0 * sharp * from_peak;
    (1.0 - sharp) * (1.0 + sharp) / (4.0 * PI * base * base.sqrt())
}

/// B. Draine 2003, eq. 4, 1/sr: HG (1 + α µ²) / (1 + α (1 + 2 g²) / 3).
#[must_use]
pub fn draine_per_sr(g: f64, alpha: f64, one_minus_mu: f64) -> f64 {
    let mu = 1.0 - one_minus_mu;
    hg_per_sr(g, one_minus_mu) * (1.0 + alpha * mu * mu) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
}

/// Mean cosine of Draine's phase: g (1 + α (3 + 2 g²) / 5) / (1 + α (1 + 2 g²) / 3) (Draine 2003, eq. 5).
#[must_use]
pub fn draine_mean_cosine(g: f64, alpha: f64) -> f64 {
    g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
}

/// x = 1 − µ of a direction that HG scatters to, for an even random number in [0, 1): the inverse of its distribution,
/// in the form that divides by no g and subtracts nothing in the peak.
#[must_use]
pub fn sample_hg(g: f64, random: f64) -> f64 {
    let sharp = g.abs();
    let base = (1.0 - sharp) + 2.0 * sharp * random;
    let s = (1.0 - sharp) * (1.0 + sharp) / base;
    let from_peak = (1.0 - sharp) * (1.0 - random) * (s + (1.0 - sharp)) / base;
    let from_peak = from_peak.clamp(0.0, 2.0);
    if g >= 0.0 { from_peak } else { 2.0 - from_peak }
}

/// A phase function: (1 − w) HG(g) + w Draine(g_D, α). Isotropic is HG with g = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Asymmetry of the Henyey-Greenstein part.
    pub g_hg: f64,
    /// Asymmetry of Draine's part.
    pub g_draine: f64,
    /// α of Draine's part.
    pub alpha: f64,
    /// Share of Draine's part, 0…1.
    pub draine_weight: f64,
}

impl Phase {
    /// The scene's phase function. The blend for droplets of diameter d in µm: J. Jendersie & E. d'Eon, "An Approximate
    /// Mie Scattering Function for Fog and Cloud Rendering", 2023, eq. 4 to 7, for 5 ≤ d ≤ 50.
    #[must_use]
    pub fn of(function: &PhaseFunction) -> Self {
        let [g_hg, g_draine, alpha, draine_weight] = match *function {
            PhaseFunction::Isotropic => [0.0; 4],
            // Two Henyey-Greenstein lobes: Draine's with alpha 0 is one.
            PhaseFunction::Ice => {
                let [narrow, broad, share] = PhaseFunction::ICE_LOBES;
                [narrow, broad, 0.0, share]
            }
            PhaseFunction::Hg { g } => [g, 0.0, 0.0, 0.0],
            PhaseFunction::Draine { g, alpha } => [0.0, g, alpha, 1.0],
            PhaseFunction::HgDraine {
                droplet_diameter_um: d,
            } => [
                (-0.099_056_7 / (d - 1.671_54)).exp(),
                (-2.206_79 / (d + 3.910_29) - 0.428_934).exp(),
                (3.624_89 - 8.292_88 / (d + 5.525_82)).exp(),
                (-0.599_085 / (d - 0.641_583) - 0.665_888).exp(),
            ],
        };
        Self {
            g_hg,
            g_draine,
            alpha,
            draine_weight,
        }
    }

    /// The phase, 1/sr, its asymmetries scaled by `eccentricity` (Wrenninge's c; 1 leaves it as it is).
    #[must_use]
    pub fn per_sr(&self, eccentricity: f64, one_minus_mu: f64) -> f64 {
        (1.0 - self.draine_weight) * hg_per_sr(self.g_hg * eccentricity, one_minus_mu)
            + self.draine_weight
                * draine_per_sr(self.g_draine * eccentricity, self.alpha, one_minus_mu)
    }

    /// The phase averaged over a small disc to first order, as the renderer does: at the mean of 1 − µ over a cap of
    /// angular radius r, which is 1 − µ (1 + cos r)/2.
    #[must_use]
    pub fn over_disc_per_sr(&self, one_minus_mu: f64, one_minus_mu_disc: f64) -> f64 {
        self.per_sr(
            1.0,
            one_minus_mu + (1.0 - one_minus_mu) * 0.5 * one_minus_mu_disc,
        )
    }

    /// Mean cosine.
    #[must_use]
    pub fn mean_cosine(&self) -> f64 {
        (1.0 - self.draine_weight) * self.g_hg
            + self.draine_weight * draine_mean_cosine(self.g_draine, self.alpha)
    }

    /// 1 − mean cosine: by how much less a cloud counts for light that was scattered often.
    #[must_use]
    pub fn transport_share(&self) -> f64 {
        1.0 - self.mean_cosine()
    }

    /// x = 1 − µ of a scattered direction, exactly distributed. Draine's part takes HG's directions with probability
    /// (1 + α µ²) / (1 + α), at least a third of them. `random` gives even numbers in [0, 1).
    pub fn sample(&self, mut random: impl FnMut() -> f64) -> f64 {
        if self.draine_weight == 0.0 || random() >= self.draine_weight {
            return sample_hg(self.g_hg, random());
        }
        loop {
            let x = sample_hg(self.g_draine, random());
            let mu = 1.0 - x;
            if random() * (1.0 + self.alpha) < 1.0 + self.alpha * mu * mu {
                return x;
            }
        }
    }
}

/// The unit vector at 1 − cos θ = x and an azimuth from another one.
#[must_use]
pub fn turned(from: DVec3, x: f64, azimuth_rad: f64) -> DVec3 {
    // T. Duff et al., "Building an Orthonormal Basis, Revisited", 2017.
    let sign = 1.0f64.copysign(from.z);
    let a = -1.0 / (sign + from.z);
    let b = from.x * from.y * a;
    let right = DVec3::new(1.0 + sign * from.x * from.x * a, sign * b, -sign * from.x);
    let up = DVec3::new(b, sign + from.y * from.y * a, -from.y);
    let sine = (x * (2.0 - x)).max(0.0).sqrt();
    let (sin_azimuth, cos_azimuth) = azimuth_rad.sin_cos();
    let side = right * cos_azimuth + up * sin_azimuth;
    (from * (1.0 - x) + side * sine).normalize_or(from)
}

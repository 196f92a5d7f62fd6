//! The vertical profile v(t, h): how much of its coverage a cloud of type t keeps at height fraction h of its layer.

/// Texels along the height and the type.
pub const PROFILE_SIZE: [u32; 2] = [128, 64];

/// Height fraction below which the flat base is reached.
const BASE_RISE: f64 = 0.045;
/// Height fraction of the top of the flattest clouds.
const STRATUS_TOP: f64 = 0.14;

/// v(t, h) for t and h in 0…1; from stratus to cumulus the top rises with the square root of the type (P. Ford 2024,
/// 4.2.1). Zero at both ends of the layer.
#[must_use]
pub fn vertical_profile(cloud_type: f64, height_fraction: f64) -> f64 {
    let top = STRATUS_TOP + (1.0 - STRATUS_TOP) * cloud_type.sqrt();
    let rise = smoothstep(0.0, BASE_RISE, height_fraction);
    // A dome: narrows slowly at first, then closes.
    let along = (height_fraction / top).clamp(0.0, 1.0);
    let dome = (1.0 - along.powf(1.6)).max(0.0);
    rise * dome
}

fn smoothstep(from: f64, to: f64, at: f64) -> f64 {
    let t = ((at - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// The profile as a map of bytes: height along a row, type down the rows, the first and last texel at 0 and 1.
#[must_use]
pub fn profile_texels() -> Vec<u8> {
    let [heights, types] = PROFILE_SIZE;
    let mut texels = Vec::with_capacity((heights * types) as usize);
    for t in 0..types {
        for h in 0..heights {
            let cloud_type = (f64::from(t) + 0.5) / f64::from(types);
            let height = (f64::from(h) + 0.5) / f64::from(heights);
            let value = vertical_profile(cloud_type, height);
            texels.push((value * 255.0).round() as u8);
        }
    }
    texels
}

/// Height fraction that stands for the whole layer: the profile's mean, where the proxy sphere has the smallest error.
#[must_use]
pub fn mean_height_fraction(cloud_type: f64) -> f64 {
    const STEPS: u32 = 256;
    let (mut weighted, mut sum) = (0.0, 0.0);
    for i in 0..STEPS {
        let h = (f64::from(i) + 0.5) / f64::from(STEPS);
        let v = vertical_profile(cloud_type, h);
        weighted += h * v;
        sum += v;
    }
    weighted / sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_type_is_empty_at_both_ends_and_full_somewhere() {
        for t in 0..=10 {
            let t = f64::from(t) / 10.0;
            assert!(vertical_profile(t, 0.0) == 0.0);
            assert!(vertical_profile(t, 1.0) < 1e-9);
            let peak = (0..100)
                .map(|h| vertical_profile(t, f64::from(h) / 100.0))
                .fold(0.0, f64::max);
            assert!(peak > 0.7, "type {t}: {peak}");
        }
    }

    #[test]
    fn taller_types_stand_higher() {
        assert!(mean_height_fraction(0.0) < mean_height_fraction(0.5));
        assert!(mean_height_fraction(0.5) < mean_height_fraction(1.0));
    }
}

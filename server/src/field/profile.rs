//! The vertical profile v(t, h): how much of its coverage a cloud of type t keeps at height fraction h of its layer.

use skycell_protocol::scene::WeatherProfile;

/// Texels along the height and the type.
pub const PROFILE_SIZE: [u32; 2] = [128, 64];

/// Height fraction below which the flat base is reached.
const BASE_RISE: f64 = 0.045;
/// Height fraction of the top of the flattest clouds.
const STRATUS_TOP: f64 = 0.14;

/// v(t, h) for t and h in 0…1. Zero at both ends of the layer.
///
/// Low: from stratus to cumulus the top rises with the square root of the type (P. Ford 2024, 4.2.1); towers stand in a
/// narrower column, and the tallest spread out in an anvil. High: from a veil as thick as the layer to lenses. Shapes are tuned by eye.
#[must_use]
pub fn vertical_profile(profile: WeatherProfile, cloud_type: f64, height_fraction: f64) -> f64 {
    let h = height_fraction;
    match profile {
        WeatherProfile::Low => {
            let top = STRATUS_TOP + (1.0 - STRATUS_TOP) * cloud_type.sqrt();
            let rise = smoothstep(0.0, BASE_RISE, h);
            // A dome: narrows slowly at first, then closes.
            let heap = 1.0 - (h / top).clamp(0.0, 1.0).powi(6);
            let column = 1.0 - 0.4 * smoothstep(0.2, 0.6, h);
            let anvil = smoothstep(0.66, 0.82, h);
            let tower = (column + (1.0 - column) * anvil) * (1.0 - smoothstep(0.9, 1.0, h));
            // Towers that have reached the tropopause: half their base's coverage in the column, all of it in the anvil.
            let shaft = mix(0.68, 0.42, smoothstep(0.12, 0.45, h));
            let spread_out = mix(shaft, 1.0, smoothstep(0.74, 0.81, h));
            let storm = spread_out * (1.0 - smoothstep(0.87, 1.0, h));
            let heap_or_tower = mix(heap, tower, smoothstep(0.68, 0.82, cloud_type));
            rise * mix(heap_or_tower, storm, smoothstep(0.85, 0.95, cloud_type))
        }
        WeatherProfile::High => {
            let veil = smoothstep(0.0, 0.3, h) * (1.0 - smoothstep(0.6, 1.0, h));
            let lens = smoothstep(0.0, 0.35, h) * (1.0 - smoothstep(0.35, 1.0, h));
            mix(veil, lens, cloud_type)
        }
    }
}

fn mix(a: f64, b: f64, share: f64) -> f64 {
    a + (b - a) * share
}

fn smoothstep(from: f64, to: f64, at: f64) -> f64 {
    let t = ((at - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A profile as a map of bytes: height along a row, type down the rows.
#[must_use]
pub fn profile_texels(profile: WeatherProfile) -> Vec<u8> {
    let [heights, types] = PROFILE_SIZE;
    let mut texels = Vec::with_capacity((heights * types) as usize);
    for t in 0..types {
        for h in 0..heights {
            let cloud_type = (f64::from(t) + 0.5) / f64::from(types);
            let height = (f64::from(h) + 0.5) / f64::from(heights);
            let value = vertical_profile(profile, cloud_type, height);
            texels.push((value * 255.0).round() as u8);
        }
    }
    texels
}

/// Height fraction that stands for the whole layer: the profile's mean, where the proxy sphere has the smallest error.
#[must_use]
pub fn mean_height_fraction(profile: WeatherProfile, cloud_type: f64) -> f64 {
    const STEPS: u32 = 256;
    let (mut weighted, mut sum) = (0.0, 0.0);
    for i in 0..STEPS {
        let h = (f64::from(i) + 0.5) / f64::from(STEPS);
        let v = vertical_profile(profile, cloud_type, h);
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
        for profile in [WeatherProfile::Low, WeatherProfile::High] {
            for t in 0..=20 {
                let t = f64::from(t) / 20.0;
                assert!(vertical_profile(profile, t, 0.0) == 0.0);
                assert!(vertical_profile(profile, t, 1.0) < 1e-9);
                let values = (0..100).map(|h| vertical_profile(profile, t, f64::from(h) / 100.0));
                let peak = values.fold(0.0, f64::max);
                assert!(peak > 0.7 && peak <= 1.0, "type {t}: {peak}");
            }
        }
    }

    #[test]
    fn taller_types_stand_higher_up_to_cumulus() {
        let mean = |t: f64| mean_height_fraction(WeatherProfile::Low, t);
        assert!(mean(0.0) < mean(0.33));
        assert!(mean(0.33) < mean(0.67));
    }

    #[test]
    fn an_anvil_overhangs_its_tower() {
        let tower = |h: f64| vertical_profile(WeatherProfile::Low, 1.0, h);
        assert!(tower(0.86) > tower(0.6) + 0.2);
        let heap = |h: f64| vertical_profile(WeatherProfile::Low, 0.6, h);
        assert!(heap(0.7) < heap(0.5));
    }
}

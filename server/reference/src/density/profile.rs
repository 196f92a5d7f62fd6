//! The vertical profile in closed form: where a layer's middle of mass is.

use skycell_protocol::scene::WeatherProfile;

/// Height fraction below which the flat base is reached.
const BASE_RISE: f64 = 0.045;
/// Height fraction of the top of the flattest clouds.
const STRATUS_TOP: f64 = 0.14;
/// Places at which the model takes the profile's mean.
const MEAN_STEPS: u32 = 256;

/// 3 t² − 2 t³ between two heights.
fn step(from: f64, to: f64, h: f64) -> f64 {
    let t = ((h - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// How much of its coverage a cloud keeps: type 0…1 of a profile, height fraction 0…1 of the layer.
///
/// Low: the top rises with the square root of the type (P. Ford 2024, 4.2.1) and closes with the sixth power of the height; above
/// type 0.7 heaps become towers, which keep 0.6 in their middle, and above 0.85 storms, which keep 0.68 at their base, 0.42 in
/// their shaft and all in their anvil. High: a veil that
/// thins above 0.6 becomes a lens.
#[must_use]
pub fn vertical_profile(profile: WeatherProfile, cloud_type: f64, h: f64) -> f64 {
    match profile {
        WeatherProfile::Low => {
            let top = STRATUS_TOP + (1.0 - STRATUS_TOP) * cloud_type.sqrt();
            let heap = 1.0 - (h / top).min(1.0).powi(6);
            let narrowed = 0.4 * step(0.2, 0.6, h) * (1.0 - step(0.66, 0.82, h));
            let tower = (1.0 - narrowed) * (1.0 - step(0.9, 1.0, h));
            let towering = step(0.68, 0.82, cloud_type);
            let heap_or_tower = heap * (1.0 - towering) + tower * towering;
            let shaft = 0.68 - 0.26 * step(0.12, 0.45, h);
            let in_anvil = step(0.74, 0.81, h);
            let storm = (shaft * (1.0 - in_anvil) + in_anvil) * (1.0 - step(0.87, 1.0, h));
            let storming = step(0.85, 0.95, cloud_type);
            step(0.0, BASE_RISE, h) * (heap_or_tower * (1.0 - storming) + storm * storming)
        }
        WeatherProfile::High => {
            let veil = step(0.0, 0.3, h) * (1.0 - step(0.6, 1.0, h));
            let lens = step(0.0, 0.35, h) * (1.0 - step(0.35, 1.0, h));
            veil * (1.0 - cloud_type) + lens * cloud_type
        }
    }
}

/// Mean height fraction of a type, weighted by its profile: where the layer's proxy sphere stands.
#[must_use]
pub fn mean_height_fraction(profile: WeatherProfile, cloud_type: f64) -> f64 {
    let (weighted, sum) = (0..MEAN_STEPS)
        .map(|i| (f64::from(i) + 0.5) / f64::from(MEAN_STEPS))
        .map(|h| (h, vertical_profile(profile, cloud_type, h)))
        .fold((0.0, 0.0), |(weighted, sum), (h, v)| {
            (weighted + h * v, sum + v)
        });
    weighted / sum
}

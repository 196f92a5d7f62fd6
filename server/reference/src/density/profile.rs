//! The vertical profile in closed form: where a layer's middle of mass is.

/// Height fraction below which the flat base is reached.
const BASE_RISE: f64 = 0.045;
/// Height fraction of the top of the flattest clouds.
const STRATUS_TOP: f64 = 0.14;
/// Places at which the model takes the profile's mean.
const MEAN_STEPS: u32 = 256;

/// How much of its coverage a cloud keeps: type 0 (stratus) … 1 (cumulus), height fraction 0…1 of the layer. The top rises
/// with the square root of the type (P. Ford 2024, 4.2.1).
#[must_use]
pub fn vertical_profile(cloud_type: f64, height_fraction: f64) -> f64 {
    let top = STRATUS_TOP + (1.0 - STRATUS_TOP) * cloud_type.sqrt();
    let t = (height_fraction / BASE_RISE).clamp(0.0, 1.0);
    let rise = t * t * (3.0 - 2.0 * t);
    rise * (1.0 - (height_fraction / top).clamp(0.0, 1.0).powf(1.6))
}

/// Mean height fraction of a type, weighted by its profile: where the layer's proxy sphere stands.
#[must_use]
pub fn mean_height_fraction(cloud_type: f64) -> f64 {
    let (weighted, sum) = (0..MEAN_STEPS)
        .map(|i| (f64::from(i) + 0.5) / f64::from(MEAN_STEPS))
        .map(|h| (h, vertical_profile(cloud_type, h)))
        .fold((0.0, 0.0), |(weighted, sum), (h, v)| {
            (weighted + h * v, sum + v)
        });
    weighted / sum
}

#define_import_path skycell::shafts

// Light shafts: how much of the light that the air along a ray scatters is left where clouds shade it. Everything is told
// by half-planes that the line through the eye towards the sun bounds (epipolar planes: Engelhardt & Dachsbacher 2010). Rays
// of a half-plane pass the same sunbeams, so a beam's edge, which is a plane through the eye and the sun, is as sharp as the
// half-planes are dense, and along one of them all is smooth.

/// Where half-planes are counted from, and which way the sun stands.
struct ShaftFrame {
    /// Unit vector towards the sun when the shadows were made.
    sun: vec3f,
    /// Altitude of the origin above the ground, m.
    altitude_m: f32,
    /// The half-plane with the azimuth 0, and the one a quarter turn on: across the sun's direction.
    right: vec3f,
    /// Distance by which half of the slices are used up, m.
    distance_scale_m: f32,
    up: vec3f,
    /// 1, or 0 where no shadow is known: the air is then lit everywhere.
    is_known: f32,
    /// Where the half-planes meet, in the cell's frame, m.
    origin: vec3f,
    pad_origin: f32,
}

const TWO_PI: f32 = 6.283185307179586;

/// Half-planes around the sun's direction.
const SHAFT_AZIMUTHS: u32 = 384u;
/// Angles from the sun of the table of shares, 0…π.
const SHAFT_ANGLES: u32 = 128u;
/// Its distances.
const SHAFT_SLICES: u32 = 24u;
/// Sunbeams of a half-plane in the table of shadows, by their distance from the line through the eye.
const SHADOW_BEAMS: u32 = 256u;
/// Altitudes of a layer in it.
const SHADOW_SLICES: u32 = 16u;
/// Distances of sunbeams are even below this, m, and grow evenly in their logarithm beyond; and the farthest.
const BEAM_NEAR_M: f32 = 150.0;
const BEAM_FAR_M: f32 = 60000.0;

/// A half-plane's place 0…1 on the circle; it wraps round.
fn azimuth_place(frame: ShaftFrame, direction: vec3f) -> f32 {
    // Along the sun's direction the azimuth means nothing, and what is read there does not depend on it.
    let across = vec2f(dot(direction, frame.right), dot(direction, frame.up));
    let angle = atan2(across.y, select(across.x, 1e-20, all(across == vec2f(0.0))));
    return (angle / TWO_PI * f32(SHAFT_AZIMUTHS) + 0.5) / f32(SHAFT_AZIMUTHS);
}

/// The unit vector from the line into a half-plane, across the sun's direction.
fn across_of_azimuth(frame: ShaftFrame, azimuth: u32) -> vec3f {
    let angle = f32(azimuth) * (TWO_PI / f32(SHAFT_AZIMUTHS));
    return frame.right * cos(angle) + frame.up * sin(angle);
}

/// Angle from the sun, 0…π. In this form it keeps its digits around the sun, where the cosine has none.
fn angle_from_sun(frame: ShaftFrame, direction: vec3f) -> f32 {
    return atan2(length(cross(direction, frame.sun)), dot(direction, frame.sun));
}

/// A sunbeam's place 0…1 by its distance from the line through the eye.
fn beam_place(offset_m: f32) -> f32 {
    return saturate(log(1.0 + offset_m / BEAM_NEAR_M) / log(1.0 + BEAM_FAR_M / BEAM_NEAR_M));
}

fn offset_of_beam_m(place: f32) -> f32 {
    return BEAM_NEAR_M * (exp(place * log(1.0 + BEAM_FAR_M / BEAM_NEAR_M)) - 1.0);
}

/// A distance's place 0…1 among the slices; the last is the air's end.
fn slice_place(frame: ShaftFrame, distance_m: f32) -> f32 {
    let d = max(distance_m, 0.0);
    return d / (d + frame.distance_scale_m);
}

/// The inverse; no number for 1.
fn distance_of_slice_m(frame: ShaftFrame, place: f32) -> f32 {
    return frame.distance_scale_m * place / (1.0 - place);
}

/// Middle of a texel.
fn texel_of(place: f32, texels: u32) -> f32 {
    return (0.5 + saturate(place) * f32(texels - 1u)) / f32(texels);
}

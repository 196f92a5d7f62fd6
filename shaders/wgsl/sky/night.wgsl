#define_import_path skycell::night
#import skycell::scene::Night
#import skycell::phase::one_minus_mu
#import skycell::octahedral::{octahedral_from_direction, direction_from_octahedral}

// Moon and stars, before the atmosphere dims them.

/// Radiance of the moon's disc towards a direction: its surface scatters by the law of Lommel and Seeliger,
/// µ_i / (µ_i + µ_e) with the cosines of the sun's and the viewer's angles to it, which makes the full disc even.
fn moon_disc_radiance(night: Night, direction: vec3f) -> vec3f {
    let disc = night.moon_one_minus_mu_disc;
    let angle = one_minus_mu(direction, night.moon_direction);
    let inside = 1.0 - smoothstep(0.85 * disc, 1.15 * disc, angle);
    // Radii of the moon across the line of sight: |d - m|² = 2 (1 - cos).
    let across = (direction - night.moon_direction) * inverseSqrt(2.0 * disc);
    let mu_view = sqrt(max(1.0 - angle / disc, 0.0025));
    let normal = across - mu_view * night.moon_direction;
    let mu_sun = max(dot(normal, night.moon_to_sun), 0.0);
    return night.moon_radiance * (inside * mu_sun / (mu_sun + mu_view));
}

/// Cells along the octahedral square, and share of them with a star: 9216 stars, about as many as are brighter than
/// magnitude 6.5.
const STAR_CELLS: f32 = 160.0;
const STAR_SHARE: f32 = 0.36;
/// Irradiance of a star of magnitude 6.5: 3.63e-11 W/(m² nm) at magnitude 0 (Bessell 1998).
const FAINTEST_STAR: f32 = 9.12e-14;

/// Two numbers in 0…1 for a cell (M. Jarzynski & M. Olano 2020, pcg2d).
fn cell_noise(cell: vec2u) -> vec2f {
    var v = cell * 1664525u + 1013904223u;
    v.x += v.y * 1664525u;
    v.y += v.x * 1664525u;
    v = v ^ (v >> vec2u(16u));
    v.x += v.y * 1664525u;
    v.y += v.x * 1664525u;
    v = v ^ (v >> vec2u(16u));
    return vec2f(v >> vec2u(8u)) * (1.0 / 16777216.0);
}

/// Radiance of stars towards a direction, spread over about a pixel. As many are brighter than a magnitude m as
/// 10^(0.51 m), so a star's light goes with an even random number to the power of -0.4 / 0.51.
fn star_radiance(night: Night, direction: vec3f, pixel_angle_rad: f32) -> vec3f {
    let turned = vec3f(dot(night.star_x, direction), dot(night.star_y, direction), dot(night.star_z, direction));
    let cell = floor(octahedral_from_direction(turned) * STAR_CELLS);
    let noise = cell_noise(vec2u(cell) + 7u);
    let more = cell_noise(vec2u(cell) + 4099u);
    let star = direction_from_octahedral((cell + 0.5 + 0.6 * (noise - 0.5)) / STAR_CELLS);
    let spread = 0.6 * pixel_angle_rad;
    let shape = exp(-one_minus_mu(turned, star) / (spread * spread)) / (6.2831853 * spread * spread);
    let there = select(0.0, 1.0, fract(noise.x * 64.0 + more.x * 8.0) < STAR_SHARE);
    let light = there * FAINTEST_STAR * pow(max(more.x, 1e-5), -0.784);
    // From orange to blue-white.
    let colour = mix(vec3f(1.35, 0.95, 0.7), vec3f(0.8, 1.0, 1.25), more.y);
    return night.star_brightness * light * shape * colour;
}

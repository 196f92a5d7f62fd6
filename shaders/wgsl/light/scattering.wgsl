#define_import_path skycell::scattering

// Light that clouds scatter many times. Its constants are fitted to a path tracer (`skycell-server measure octaves`);
// optical depths enter it times 1 - g, by which a cloud of peaked droplets is thinner for such light (van de Hulst's
// similarity): transport_share is 1 - g. Diffusing light falls in a straight line through a slab that absorbs nothing, from its lit to its dark
// side: the quotients of optical depths below are that line between two boundaries that let light out.

struct Diffusion {
    /// Strength of diffuse sunlight; 0: none.
    strength: f32,
    /// Factor of the phase's eccentricity for it.
    eccentricity: f32,
    /// How fast it falls from the lit to the dark side.
    slope: f32,
    /// Thickness of a cloud that has half of a thick one's.
    thickness: f32,
    /// How fast it leaks out of the sides.
    leak: f32,
    /// What is added to a cloud's width before that.
    width: f32,
    /// How fast the sky's light falls from top to base.
    sky_slope: f32,
    /// How fast a cloud stops passing the sky's light onwards.
    sky_thinness: f32,
    /// How much of what a thin cloud passes on comes from where the ray goes.
    sky_forward: f32,
    /// Samples of each of the five ways that measure what is around; 0: nobody asks.
    samples: u32,
    pad_uniform: vec2f,
}

/// Optical depths from a place in a cloud outwards.
struct Surroundings {
    /// Away from the sun.
    behind: f32,
    above: f32,
    below: f32,
    /// Both horizontal ways across the sun's direction together.
    beside: f32,
}

/// Diffuse sunlight at a place, in units of the phase; 0...strength. sun_depth: towards the sun; sun_rising: sine of its
/// elevation there.
fn diffuse_share(light: Diffusion, transport_share: f32, sun_depth: f32, sun_rising: f32, around: Surroundings) -> f32 {
    let near = transport_share * sun_depth;
    let far = transport_share * around.behind;
    let along = near + far;
    let upright = transport_share * (around.above + around.below);
    let across = transport_share * around.beside;
    let least = min(along, upright);
    // A slab takes less light from a low sun, by the cosine of its incidence: as cloud along the sun's way is to cloud
    // upright, and where cloud reaches farther than is looked, as the sun stands.
    let incidence = min(upright / max(along, 1e-6), 1.0);
    let flatness = saturate(1.0 - upright / max(across, 1e-6));
    let taken = mix(incidence, min(incidence, max(sun_rising, 0.0)), flatness);
    let fall = (light.slope * far + 1.0) / (light.slope * along + 2.0);
    let kept = exp(-light.leak * near / (across + light.width));
    return light.strength * fall * kept * taken * least / (least + light.thickness);
}

/// Share of an even sky above a black ground that reaches a ray from a place in a cloud; the rest of 1 is the ground's.
/// rising: sine of the ray's elevation.
fn sky_share(light: Diffusion, transport_share: f32, around: Surroundings, rising: f32) -> f32 {
    let above = transport_share * around.above;
    let below = transport_share * around.below;
    let even = (light.sky_slope * below + 1.0) / (light.sky_slope * (above + below) + 2.0);
    // Where cloud is thin, most light goes on as it came: from where the ray goes.
    let ahead = 0.5 + 0.5 * light.sky_forward * clamp(2.5 * rising, -1.0, 1.0);
    return mix(even, ahead, exp(-light.sky_thinness * (above + below)));
}

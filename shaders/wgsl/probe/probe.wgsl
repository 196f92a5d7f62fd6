// The physical functions at given points, one thread per point, for comparison with their f64 twins.
#import skycell::shell::{altitude_m, shell_roots}
#import skycell::scene::Proxy
#import skycell::cubic::{softness, cubic_weights}
#import skycell::octahedral::{octahedral_from_direction, direction_from_octahedral}
#import skycell::phase::{phase_hg_per_sr, phase_draine_per_sr}
#import skycell::transport::one_minus_exp_over
#import skycell::tone::srgb_from_linear
#import skycell::surface::{dome_distance_m, distance_from_above_m}

@group(0) @binding(0) var<storage, read> points: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> values: array<vec4f>;
/// x: which function, see below; y: number of points.
@group(0) @binding(2) var<uniform> question: vec4u;

/// Each point is two vectors, each answer one.
@compute @workgroup_size(64, 1, 1)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= question.y { return; }
    let first = points[2u * id.x];
    let second = points[2u * id.x + 1u];
    var value = vec4f(0.0);
    switch question.x {
        // altitude_m(R = first.w, p = first.xyz)
        case 0u: { value.x = altitude_m(first.w, first.xyz); }
        // shell_roots(R = first.w, H = second.w, p = first.xyz, d = second.xyz)
        case 1u: {
            let roots = shell_roots(first.w, second.w, first.xyz, altitude_m(first.w, first.xyz), second.xyz);
            value = vec4f(roots.near_m, roots.far_m, select(0.0, 1.0, roots.hit), 0.0);
        }
        // octahedral_from_direction(first.xyz) and back
        case 2u: {
            let square = octahedral_from_direction(first.xyz);
            value = vec4f(direction_from_octahedral(square), 0.0);
        }
        // direction_from_octahedral(first.xy)
        case 3u: { value = vec4f(direction_from_octahedral(first.xy), 0.0); }
        // HG and Draine: g = first.x, alpha = first.y, 1 - mu = first.z
        case 4u: {
            value = vec4f(phase_hg_per_sr(first.x, first.z), phase_draine_per_sr(first.x, first.y, first.z), 0.0, 0.0);
        }
        // (1 - e^-x) / x
        case 5u: { value.x = one_minus_exp_over(first.x); }
        // sRGB of first.xyz
        case 6u: { value = vec4f(srgb_from_linear(first.xyz), 0.0); }
        // dome_distance_m(r = first.w, p = first.xyz, d = second.xyz)
        case 7u: { value.x = dome_distance_m(first.w, first.xyz, second.xyz); }
        // From above: R = first.w, H = second.w, d = second.xyz, the anchor at y = first.x, the eye at (first.y, first.z, 0).
        // The direction that the texel has which a ray reads, and the ray's distance to the surface.
        case 8u: {
            var proxy: Proxy;
            proxy.anchor = vec3f(0.0, first.x, 0.0);
            proxy.altitude_m = second.w;
            proxy.from_above = 1u;
            proxy.least_m = 1e-3;
            let eye = vec3f(first.y, first.z, 0.0);
            let sphere = shell_roots(first.w, second.w, eye, altitude_m(first.w, eye), second.xyz);
            let distance_m = distance_from_above_m(first.w, proxy, eye, sphere, second.xyz);
            let address = normalize(eye + second.xyz * distance_m - proxy.anchor);
            let of_anchor = shell_roots(first.w, second.w, proxy.anchor, altitude_m(first.w, proxy.anchor), address);
            let texel = proxy.anchor + address * distance_from_above_m(first.w, proxy, proxy.anchor, of_anchor, address);
            value = vec4f(normalize(texel - eye), distance_m);
        }
        // The weights of a read at first.y for a pixel of first.x texels.
        case 9u: { value = cubic_weights(first.y, softness(first.x)); }
        default: {}
    }
    values[id.x] = value;
}

#define_import_path skycell::blend

/// Coverage, type and skip level of a texel when `share` of the way from old to new maps is gone. Where the mix of two
/// coverages can hold cloud, one of both can: the shorter skip of both reaches no cloud at any share.
fn blended_map(earlier: vec3f, later: vec3f, share: f32) -> vec3f {
    return vec3f(mix(earlier.xy, later.xy, share), min(earlier.z, later.z));
}

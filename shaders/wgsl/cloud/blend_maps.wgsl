// Old maps on their way to new ones: mixed once into the texture that marches read, one thread per texel.
#import skycell::blend::blended_map

struct Blend {
    /// Share of the new maps.
    share: f32,
    /// 1: the texture holds half floats; 0: bytes.
    halves: u32,
    texels: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> blend: Blend;
/// x: coverage and type in 65 535ths; y: skip distance in levels, 0...255.
@group(0) @binding(1) var<storage, read> old_maps: array<vec2u>;
@group(0) @binding(2) var<storage, read> new_maps: array<vec2u>;
/// Texels of the texture: a word of bytes, or two words of halves.
@group(0) @binding(3) var<storage, read_write> mixed_maps: array<u32>;

fn unpacked(texel: vec2u) -> vec3f {
    return vec3f(unpack2x16unorm(texel.x), f32(texel.y));
}

@compute @workgroup_size(64, 1, 1)
fn blend_maps(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= blend.texels { return; }
    let texel = blended_map(unpacked(old_maps[id.x]), unpacked(new_maps[id.x]), blend.share);
    if blend.halves == 1u {
        mixed_maps[2u * id.x] = pack2x16float(texel.xy);
        // 256ths are exact in a half: a skip is never rounded up.
        mixed_maps[2u * id.x + 1u] = pack2x16float(vec2f(texel.z / 256.0, 0.0));
    } else {
        mixed_maps[id.x] = pack4x8unorm(vec4f(texel.xy, texel.z / 255.0, 0.0));
    }
}

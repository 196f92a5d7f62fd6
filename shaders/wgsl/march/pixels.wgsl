// One ray per pixel of one viewer: the screen-space renderer.
#import skycell::march::{scene, march_layer, sample_offset, sample_start_fraction, LayerRadiance}
#import skycell::view::{View, pixel_direction}

@group(2) @binding(0) var<storage, read_write> marched: array<f32>;
@group(3) @binding(0) var<uniform> view: View;

/// Adds one jittered sample to a strip of rows; z of the group is the layer.
@compute @workgroup_size(8, 8, 1)
fn march_pixels(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2u(id.x, id.y + view.first_row);
    if pixel.x >= view.width || pixel.y >= view.height { return; }
    let direction = pixel_direction(view, vec2f(pixel) + 0.5 + sample_offset(view.sample_index));
    let start = sample_start_fraction(vec2f(pixel), view.sample_index);
    let sample = march_layer(view.layer, view.position, direction, start);
    let at = ((view.layer * view.height + pixel.y) * view.width + pixel.x) * 5u;
    let weight = view.sample_weight;
    if view.sample_is_first == 1u {
        marched[at] = sample.single;
        marched[at + 1u] = sample.octaves;
        marched[at + 2u] = sample.ambient;
        marched[at + 3u] = sample.transmittance;
        marched[at + 4u] = sample.opacity_distance_m;
        return;
    }
    marched[at] = mix(marched[at], sample.single, weight);
    marched[at + 1u] = mix(marched[at + 1u], sample.octaves, weight);
    marched[at + 2u] = mix(marched[at + 2u], sample.ambient, weight);
    marched[at + 3u] = mix(marched[at + 3u], sample.transmittance, weight);
    marched[at + 4u] = mix(marched[at + 4u], sample.opacity_distance_m, weight);
}

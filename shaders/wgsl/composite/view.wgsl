#define_import_path skycell::view

/// Where a layer's tiles are found: entry of tile (x, y) at offset + y * tiles_per_side + x.
struct PageTable {
    offset: u32,
    /// Tiles along the octahedral square at the finest level that the table resolves; 0: no tile at all.
    tiles_per_side: u32,
    /// That level.
    level: u32,
    pad_level: u32,
}

/// One viewer's camera in the frame of its cell.
struct View {
    position: vec3f,
    width: u32,
    forward: vec3f,
    height: u32,
    /// Half the picture's width and height at distance 1.
    right: vec3f,
    sample_index: u32,
    up: vec3f,
    /// Share of this sample in the pixel's new value (screen-space renderer).
    sample_weight: f32,
    tables: array<PageTable, 16>,
    /// First row of a strip of the picture and angle of a pixel at its centre.
    first_row: u32,
    pixel_angle_rad: f32,
    sample_is_first: u32,
    /// Layer that a pass of the screen-space renderer marches.
    layer: u32,
    /// Altitude of the position above the ground, m.
    altitude_m: f32,
    /// Size of the marched pixels, where it is not that of the picture.
    marched_width: u32,
    marched_height: u32,
    /// 1: samples stand beside the middles of pixels and steps; 0: in the middle.
    jitter: f32,
    /// Squares of 2^dither_shift pixels are dithered as one.
    dither_shift: u32,
    /// Most places along a ray at which it is searched for what cached texels show; 0: proxy spheres alone.
    parallax_steps: u32,
    /// Columns of the picture that is written: more than the view's where two eyes stand side by side in it.
    picture_width: u32,
    /// Which of them is the view's first.
    first_column: u32,
    /// Where rays end that only go through the near part of a layer (screen-space renderer): at this distance, m, ...
    reach_m: f32,
    /// ... over this way, in which there is less and less of the layer in them, m. 0: they go on to the end.
    reach_fade_m: f32,
    /// Among what is marched, the place of the layer that a pass marches.
    place: u32,
    /// One bit for each layer whose near part is marched for this view.
    near_layers: u32,
    /// ... from here.
    reach_from: vec3f,
    pad_reach: f32,
    /// Where rays start instead of the eye, to go through what it sees on proxy surfaces (screen-space renderer).
    start: vec3f,
    pad_end: f32,
}

/// A ray of a picture that is no pinhole camera's, in the frame of its cell.
struct ListedRay {
    origin: vec3f,
    pad_origin: f32,
    direction: vec3f,
    pad_direction: f32,
}

/// Direction of the ray through a point of the picture, in pixels from its upper left corner.
fn pixel_direction(view: View, pixel: vec2f) -> vec3f {
    let size = vec2f(f32(view.width), f32(view.height));
    let ndc = (2.0 * pixel / size - 1.0) * vec2f(1.0, -1.0);
    return normalize(view.forward + ndc.x * view.right + ndc.y * view.up);
}

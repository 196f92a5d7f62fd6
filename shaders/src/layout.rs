//! The Rust side of every struct that the shaders read, in the layout of WGSL's uniform address space.
//!
//! Fields carry the names of the WGSL's; padding is spelled out as `_pad…` and has no counterpart there. A test compares
//! names, offsets and sizes with what naga parses.

use bytemuck::{Pod, Zeroable};

/// Offsets of a struct's fields, for the comparison with the WGSL.
pub trait GpuLayout: Pod {
    /// Name in the WGSL.
    const NAME: &'static str;
    /// Name and byte offset of every field that is not padding.
    fn fields() -> Vec<(&'static str, usize)>;
}

macro_rules! gpu_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident : $type:ty),* $(,)? }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
        pub struct $name { $($(#[$field_doc])* pub $field: $type),* }

        impl GpuLayout for $name {
            const NAME: &'static str = stringify!($name);
            fn fields() -> Vec<(&'static str, usize)> {
                [$((stringify!($field), std::mem::offset_of!($name, $field))),*]
                    .into_iter()
                    .filter(|(name, _)| !name.starts_with("_pad"))
                    .collect()
            }
        }
    };
}

gpu_struct! {
    /// Where the half-planes of light shafts are counted from, and which way the sun stands.
    ShaftFrame {
        /// Unit vector towards the sun when the shadows were made.
        sun: [f32; 3],
        /// Altitude of the origin above the ground, m.
        altitude_m: f32,
        /// The half-plane with the azimuth 0, across the sun's direction.
        right: [f32; 3],
        /// Distance by which half of the slices are used up, m.
        distance_scale_m: f32,
        /// The half-plane a quarter turn on.
        up: [f32; 3],
        /// 1, or 0 where no shadow is known.
        is_known: f32,
        /// Where the half-planes meet, in the cell's frame, m.
        origin: [f32; 3],
        /// Fills to 16 bytes.
        pad_origin: f32,
    }
}

gpu_struct! {
    /// Sunbeams of one layer whose shadow is made at once.
    ShadowWork {
        /// Where they stand.
        frame: ShaftFrame,
        /// First half-plane.
        first_azimuth: u32,
        /// How many.
        azimuths: u32,
        /// Place among the shown layers.
        layer: u32,
        /// Samples between two slices.
        substeps: u32,
    }
}

gpu_struct! {
    /// Half-planes of the table of light shafts that are made at once.
    ShaftWork {
        /// Where they stand.
        frame: ShaftFrame,
        /// Base and top of the layers, m.
        layers: [[f32; 4]; 4],
        /// How many layers there are.
        layer_count: u32,
        /// First half-plane.
        first_azimuth: u32,
        /// How many.
        azimuths: u32,
        /// Fills to 16 bytes.
        pad_work: u32,
    }
}

gpu_struct! {
    /// The sphere on which the scene stands.
    Planet {
        /// Radius of the ground, m.
        radius_m: f32,
        /// Diffuse reflectance of the ground, 0…1.
        ground_albedo: f32,
        /// 1, or 0 where nothing lies below.
        has_ground: f32,
        /// Fills the struct to 16 bytes, as uniforms demand of nested ones.
        pad_uniform: f32,
    }
}

gpu_struct! {
    /// The sun as the cell sees it.
    Sun {
        /// Unit vector towards the sun.
        direction: [f32; 3],
        /// Angular radius, rad.
        angular_radius_rad: f32,
        /// Spectral irradiance above the atmosphere, W/(m² nm).
        irradiance: [f32; 3],
        /// 1 − cos(angular radius).
        one_minus_mu_disc: f32,
        /// Spectral irradiance at cloud height, facing the sun, W/(m² nm).
        irradiance_at_clouds: [f32; 3],
        /// Cosine factor of the sun on the ground, 0…1.
        ground_irradiance_factor: f32,
    }
}

gpu_struct! {
    /// The plain analytic sky.
    Sky {
        /// Optical depth of the air straight up, per channel.
        rayleigh_optical_depth: [f32; 3],
        /// Optical depth of the aerosol straight up.
        aerosol_optical_depth: f32,
        /// Mean radiance of the sky above, W/(m² nm sr).
        mean_radiance: [f32; 3],
        /// Henyey-Greenstein asymmetry of the aerosol.
        aerosol_asymmetry: f32,
        /// Radiance of the lit ground, W/(m² nm sr).
        ground_radiance: [f32; 3],
        /// How much of the sun's light the sky still has, 0…1.
        lit: f32,
        /// Optical depth of the whole column towards the sun, per channel.
        sun_column: [f32; 3],
        /// Fills to 16 bytes.
        pad_column: f32,
        /// e to the negative of `sun_column`.
        sun_column_kept: [f32; 3],
        /// Fills to 16 bytes.
        pad_kept: f32,
        /// Higher orders of scattering per unit of what the view's column takes out, 1/sr.
        diffuse_per_sr: [f32; 3],
        /// Fills to 16 bytes.
        pad_diffuse: f32,
        /// Extinction of the air at the ground, 1/m.
        ground_air_extinction_per_m: [f32; 3],
        /// Fills to 16 bytes.
        pad_ground: f32,
        /// Radiance from every direction beside that of the air, W/(m² nm sr).
        environment_radiance: [f32; 3],
        /// Fills to 16 bytes.
        pad_environment: f32,
    }
}

gpu_struct! {
    /// Air, aerosol and ozone, and from where a view's tables look.
    Air {
        /// Rayleigh scattering at the ground, 1/m.
        rayleigh_per_m: [f32; 3],
        /// Height over which air falls to 1/e, m.
        rayleigh_scale_m: f32,
        /// Scattering by aerosol at the ground, 1/m.
        mie_scattering_per_m: [f32; 3],
        /// Height over which aerosol falls to 1/e, m.
        mie_scale_m: f32,
        /// Extinction by aerosol at the ground, 1/m.
        mie_extinction_per_m: [f32; 3],
        /// Mean cosine of the aerosol's phase.
        mie_asymmetry: f32,
        /// Absorption by ozone where it is densest, 1/m.
        ozone_per_m: [f32; 3],
        /// Altitude above which there is no air, m.
        top_m: f32,
        /// Radius of the ground, m.
        radius_m: f32,
        /// Altitude of the tables' eye, m.
        altitude_m: f32,
        /// Cosine of the sun's zenith angle there.
        mu_sun: f32,
        /// Lowest one for which the higher orders are tabulated.
        mu_sun_lowest: f32,
        /// Angular radius of the sun, rad.
        sun_angular_radius_rad: f32,
        /// Weight of the aerosol's phase in what divides the haze's radiance.
        haze_mie_weight: f32,
        /// First row that a pass makes.
        first_row: u32,
        /// Fills to 16 bytes.
        row_scale_m: f32,
    }
}

gpu_struct! {
    /// Where droplets or crystals scatter light to.
    Phase {
        /// Asymmetry of the Henyey-Greenstein part.
        g_hg: f32,
        /// Asymmetry of the Draine part.
        g_draine: f32,
        /// Draine's α.
        alpha_draine: f32,
        /// Weight of the Draine part, 0…1.
        draine_weight: f32,
    }
}

gpu_struct! {
    /// Light that is scattered many times.
    Diffusion {
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
        /// Fills to 16 bytes.
        pad_uniform: [f32; 2],
    }
}

gpu_struct! {
    /// How light scatters in cloud.
    Light {
        /// What layers have that have none of their own.
        phase: Phase,
        /// Scattering octaves, 1…16.
        octaves: u32,
        /// Samples towards the sun.
        sun_steps: u32,
        /// Length of the march towards the sun, m.
        sun_march_distance_m: f32,
        /// Strength of ambient light.
        ambient: f32,
        /// a^i.
        octave_attenuation: [[f32; 4]; 4],
        /// b^i, 0 beyond the last octave.
        octave_contribution: [[f32; 4]; 4],
        /// c^i.
        octave_eccentricity: [[f32; 4]; 4],
        /// What is scattered many times.
        diffusion: Diffusion,
    }
}

gpu_struct! {
    /// One cloud layer.
    Layer {
        /// Lower altitude, m.
        base_altitude_m: f32,
        /// Upper altitude, m.
        top_altitude_m: f32,
        /// Extinction at density 1, 1/m.
        extinction_per_m: f32,
        /// Share of extinction that scatters, 0…1.
        single_scattering_albedo: f32,
        /// Offset into the map, in periods.
        map_offset: [f32; 2],
        /// Periods of the map per metre.
        map_per_m: f32,
        /// 1: the shape is the ball in the bounds, else all of them.
        is_ball: u32,
        /// Offset into the shape noise, in periods.
        shape_offset: [f32; 3],
        /// Periods of the shape noise per metre.
        shape_per_m: f32,
        /// Offset into the detail noise, in periods.
        detail_offset: [f32; 3],
        /// Periods of the detail noise per metre.
        detail_per_m: f32,
        /// Coverage of the layer, 0…1.
        coverage: f32,
        /// Cloud type, 0 stratus … 1 cumulus.
        cloud_type: f32,
        /// Strength of the detail's erosion, 0…1.
        detail_strength: f32,
        /// What the map's skip channel means at 1, m.
        skip_range_m: f32,
        /// Index in the map array.
        map_index: u32,
        /// Mean altitude of its clouds, m.
        proxy_altitude_m: f32,
        /// Unit vector along the fibres of a sheet, x and z.
        fibre_axis: [f32; 2],
        /// Shortest step inside cloud, m.
        step_min_m: f32,
        /// Step per distance from the ray's origin.
        step_per_distance: f32,
        /// Largest number of lit samples of a ray.
        steps_max: u32,
        /// Padding.
        _pad_air: u32,
        /// Mean extinction of the air up to that altitude, 1/m.
        air_extinction_per_m: [f32; 3],
        /// A ray stops below this transmittance; 0: never.
        transmittance_min: f32,
        /// Lower corner of what has density without maps: x and z in the cell's frame, y an altitude, m.
        bounds_min: [f32; 3],
        /// 1: every step is lit, empty or not.
        lights_empty_steps: u32,
        /// 1 over the edges of the bounds, 1/m.
        bounds_per_m: [f32; 3],
        /// First slice of the layer's voxels in the texture of all.
        grid_first_slice: u32,
        /// Voxels along x, y and z.
        grid_dimensions: [u32; 3],
        /// Fills to 16 bytes.
        pad_grid: u32,
        /// Where the droplets or crystals scatter light to.
        phase: Phase,
        /// What shape noise is squeezed to begin at.
        shape_floor: f32,
        /// What it is squeezed into above that.
        shape_range: f32,
        /// How steeply density rises from a cloud's surface inwards.
        steepness: f32,
        /// How much of the local type hangs on the local coverage, 0…1.
        dome: f32,
        /// Share of wispy noise above the base, 0…1.
        wispiness: f32,
        /// 1 − mean cosine of the phase.
        transport_share: f32,
        /// Share of the type map in the local type, 0…1.
        type_spread: f32,
        /// Fills to 16 bytes.
        pad_form: f32,
        /// Optical depth of the air towards the sun at the layer's base.
        sun_depth_at_base: [f32; 3],
        /// The layer's thickness over the height in which air falls to 1/e.
        air_folds: f32,
        /// How much more it is at the layer's top.
        sun_depth_rise: [f32; 3],
        /// The layer's thickness over the height in which aerosol falls to 1/e.
        aerosol_folds: f32,
        /// What is added in between, per difference of both constituents' shares.
        sun_depth_bend: [f32; 3],
        /// 1; 0 where air in front of the layer is left out.
        has_haze: f32,
    }
}

gpu_struct! {
    /// Which part of a ray through a layer counts.
    Part {
        /// Lower altitude, m.
        low_altitude_m: f32,
        /// Upper altitude, m.
        high_altitude_m: f32,
        /// Least distance from the ray's origin, m.
        near_m: f32,
        /// Largest distance from the ray's origin, m.
        far_m: f32,
        /// The same in cloud, where it begins after the next gap, m.
        near_gap_m: f32,
        /// The same in cloud, where it ends with the next gap, m.
        far_gap_m: f32,
        /// From this distance on it has all of the density, m; from `near_m` on that goes up evenly.
        full_near_m: f32,
        /// Up to this distance, m; to `far_m` it goes down evenly.
        full_far_m: f32,
    }
}

gpu_struct! {
    /// A surface on which a part of a layer is kept.
    Proxy {
        /// Centre of the octahedral addresses in the cell's frame, m.
        anchor: [f32; 3],
        /// Altitude of a shell; of a dome, the mean altitude of what it keeps, m.
        altitude_m: f32,
        /// What of a ray is kept.
        part: Part,
        /// Index of the layer.
        layer: u32,
        /// Radius of a dome, m.
        radius_m: f32,
        /// 1: anchor and reference are above the layer, and rays go down to it.
        from_above: u32,
        /// From above: rays that pass over the shell have their places no nearer than this, m.
        least_m: f32,
        /// Lowest altitude of cloud to be looked for, m.
        seen_low_altitude_m: f32,
        /// Highest altitude of it, m.
        seen_high_altitude_m: f32,
        /// Fills to 16 bytes.
        pad_x: u32,
        /// Fills to 16 bytes.
        pad_y: u32,
    }
}

gpu_struct! {
    /// What is seen at night beside sky and clouds.
    Night {
        /// Unit vector towards the moon.
        moon_direction: [f32; 3],
        /// 1 − cos of the moon's angular radius.
        moon_one_minus_mu_disc: f32,
        /// Twice the radiance of the full disc's surface, W/(m² nm sr).
        moon_radiance: [f32; 3],
        /// 1, or 0 where the moon takes the sun's place.
        sun_disc: f32,
        /// Unit vector from the moon to the sun.
        moon_to_sun: [f32; 3],
        /// Factor of the stars' light.
        star_brightness: f32,
        /// First row of the matrix from the cell to the stars' field.
        star_x: [f32; 3],
        /// Fills to 16 bytes.
        pad_x: f32,
        /// Second row.
        star_y: [f32; 3],
        /// Fills to 16 bytes.
        pad_y: f32,
        /// Third row.
        star_z: [f32; 3],
        /// Fills to 16 bytes.
        pad_z: f32,
    }
}

gpu_struct! {
    /// Everything that the shaders know of the scene, in the frame of one cell.
    Scene {
        /// The planet.
        planet: Planet,
        /// Layers in use, sorted by the altitude of their proxy spheres.
        layer_count: u32,
        /// Factor from radiance to the tone curve.
        exposure: f32,
        /// Padding.
        _pad_sun: [f32; 2],
        /// The sun.
        sun: Sun,
        /// The sky.
        sky: Sky,
        /// Light in clouds.
        light: Light,
        /// The layers.
        layers: [Layer; 4],
        /// Proxies of one layer after another, each with as many.
        proxies: [Proxy; 16],
        /// Moon and stars.
        night: Night,
    }
}

gpu_struct! {
    /// One picture on its way to another.
    Fade {
        /// Share of the new one, 0…1.
        share: f32,
        /// Pixels along a row.
        width: u32,
        /// Rows.
        height: u32,
        /// Binary logarithm of the side of the squares that are rounded alike, pixels.
        dither_shift: u32,
        /// Columns of one eye's part of the picture.
        eye_width: u32,
        /// What the light of the old picture is multiplied by to be told as that of the new one (clouds alone).
        old_scale: f32,
    }
}

gpu_struct! {
    /// One tile about a new anchor.
    ResampleWork {
        /// Column and row of the tile at its level.
        tile: [u32; 2],
        /// Texels along the octahedral square at that level.
        texels_per_side: f32,
        /// Place on the working page that is written.
        place: u32,
        /// Where the old tiles are found.
        table: PageTable,
    }
}

gpu_struct! {
    /// Old and new addresses of a part of a layer.
    Resample {
        /// About the new anchor, in the new frame.
        new_proxy: Proxy,
        /// About the old anchor, in the old frame.
        old_proxy: Proxy,
        /// Where rays start about the new anchor, in the new frame.
        reference: [f32; 3],
        /// Radius of the ground, m.
        planet_radius_m: f32,
        /// From the old frame's origin to the new one's, x and z, m.
        moved: [f32; 2],
        /// Most places of a search for what the old texels show.
        parallax_steps: u32,
        /// Angle of a texel of the old tiles, rad.
        texel_angle_rad: f32,
    }
}

gpu_struct! {
    /// One tile that takes one more sample.
    TileWork {
        /// Column and row of the tile at its level.
        tile: [u32; 2],
        /// Texels along the octahedral square at that level.
        texels_per_side: f32,
        /// Slot in the atlas.
        slot: u32,
        /// Where the rays of the sample start, in the cell's frame, m.
        origin: [f32; 3],
        /// Index among the scene's proxies.
        proxy: u32,
        /// Where those of the old texels started.
        old_origin: [f32; 3],
        /// Index of the jittered sample.
        sample_index: u32,
        /// Share of the sample in the new value; 1 replaces.
        weight: f32,
        /// Place of the old texels on the working page.
        previous: u32,
        /// Padding.
        _pad_end: [u32; 2],
    }
}

gpu_struct! {
    /// One texel that is marched again to see how wrong the cache is.
    AuditWork {
        /// Column and row of the tile at its level.
        tile: [u32; 2],
        /// Column and row in the stored tile, gutters included.
        texel: [u32; 2],
        /// Texels along the octahedral square at that level.
        texels_per_side: f32,
        /// Slot in the atlas.
        slot: u32,
        /// Index among the scene's proxies.
        proxy: u32,
        /// Padding.
        _pad_end: u32,
    }
}

gpu_struct! {
    /// A texel as the cache holds it, and one sample of it marched anew: single scattering, octaves, ambient,
    /// transmittance.
    AuditSample {
        /// What the cache holds.
        cached: [f32; 4],
        /// The sample.
        fresh: [f32; 4],
        /// Distance times opacity that the cache holds, m.
        cached_distance: f32,
        /// The same of the sample.
        fresh_distance: f32,
        /// Padding.
        _pad_end: [f32; 2],
    }
}

gpu_struct! {
    /// Where the rays of a cell start.
    Reference {
        /// In the cell's frame, m.
        position: [f32; 3],
        /// Padding.
        _pad_end: f32,
    }
}

gpu_struct! {
    /// One level of a layer's sun volume, as seen from one cell.
    SunLevel {
        /// Place on the torus of the frame's origin, in periods.
        offset: [f32; 2],
        /// Least x and z of the known feet in the cell's frame, m.
        feet_min_m: [f32; 2],
        /// Largest x and z of the known feet, m.
        feet_max_m: [f32; 2],
        /// Periods of the torus per metre.
        per_m: f32,
        /// Where the level's slices begin along the texture's depth, 0…1.
        first_w: f32,
    }
}

gpu_struct! {
    /// One layer's sun volume, as seen from one cell.
    SunLayer {
        /// Direction of the columns.
        direction: [f32; 3],
        /// Lower altitude of the layer, m.
        base_altitude_m: f32,
        /// Upper altitude of the layer, m.
        top_altitude_m: f32,
        /// Extinction at density 1, 1/m.
        extinction_per_m: f32,
        /// Length of the samples before the read, in periods of the torus.
        near_periods: f32,
        /// A slice as a share of the texture's depth.
        slice_w: f32,
        /// Distance between the lowest and the highest slice, in slices.
        slices: f32,
        /// Samples before the read.
        near_steps: u32,
        /// Fills to 16 bytes.
        pad_levels: [u32; 2],
        /// Finest first.
        levels: [SunLevel; 5],
    }
}

gpu_struct! {
    /// The sun volumes of the shown layers, as seen from one cell.
    SunVolume {
        /// As in the scene.
        layers: [SunLayer; 4],
    }
}

gpu_struct! {
    /// Columns of one level of one layer's sun volume that are made together.
    SunColumns {
        /// Unit vector towards the sun.
        direction: [f32; 3],
        /// Distance between feet, m.
        spacing_m: f32,
        /// Foot of the first column in the frame: x and z, m.
        first_foot_m: [f32; 2],
        /// Its texel.
        first_texel: [u32; 2],
        /// How many along x and z.
        columns: [u32; 2],
        /// Texels along the torus.
        columns_per_side: u32,
        /// Lowest slice in the texture.
        first_slice: u32,
        /// Slices of the level.
        slices: u32,
        /// Samples between two slices.
        substeps: u32,
        /// Place among the shown layers.
        layer: u32,
        /// Fills to 16 bytes.
        pad_layer: u32,
    }
}

gpu_struct! {
    /// Where a layer's tiles are found.
    PageTable {
        /// First entry.
        offset: u32,
        /// Tiles along the octahedral square.
        tiles_per_side: u32,
        /// The level that it resolves.
        level: u32,
        /// Fills an element of a uniform array to 16 bytes.
        pad_level: u32,
    }
}

gpu_struct! {
    /// One viewer's camera in the frame of its cell.
    View {
        /// Eye, m.
        position: [f32; 3],
        /// Width of the picture, pixels.
        width: u32,
        /// Unit vector through the middle of the picture.
        forward: [f32; 3],
        /// Height of the picture, pixels.
        height: u32,
        /// Half the picture's width at distance 1.
        right: [f32; 3],
        /// Index of the jittered sample (screen-space renderer).
        sample_index: u32,
        /// Half the picture's height at distance 1.
        up: [f32; 3],
        /// Share of the sample in the pixel's new value.
        sample_weight: f32,
        /// Page tables of the proxies.
        tables: [PageTable; 16],
        /// First row of a strip.
        first_row: u32,
        /// Angle of a pixel at the middle of the picture, rad.
        pixel_angle_rad: f32,
        /// 1 when the sample replaces what is there.
        sample_is_first: u32,
        /// Layer that a pass marches.
        layer: u32,
        /// Altitude of the position above the ground, m.
        altitude_m: f32,
        /// Columns of the marched pixels, where they are not the picture's.
        marched_width: u32,
        /// Rows of them.
        marched_height: u32,
        /// 1: samples stand beside the middles of pixels and steps; 0: in the middle.
        jitter: f32,
        /// Binary logarithm of the side of the squares that are dithered as one, pixels.
        dither_shift: u32,
        /// Most places along a ray at which it is searched for what cached texels show; 0: proxy spheres alone.
        parallax_steps: u32,
        /// Columns of the picture that is written: more than the view's where two eyes stand side by side in it.
        picture_width: u32,
        /// First column of this view in the picture.
        first_column: u32,
        /// Where rays end that only go through the near part of a layer, m from `reach_from`.
        reach_m: f32,
        /// Over so long a way there is less and less of the layer in them, m. 0: rays go on to the end.
        reach_fade_m: f32,
        /// Among what is marched, the place of the layer that a pass marches.
        place: u32,
        /// One bit for each layer whose near part is marched for this view.
        near_layers: u32,
        /// Where the rays of the far part start.
        reach_from: [f32; 3],
        /// Padding.
        pad_reach: f32,
        /// Where rays start instead of the eye, to go through what it sees on proxy surfaces (screen-space renderer).
        start: [f32; 3],
        /// Padding.
        pad_end: f32,
    }
}

gpu_struct! {
    /// What a pass of the inspection adds to the picture.
    Inspection {
        /// Index of the layer.
        layer: u32,
        /// 1 when nothing has been left in the picture yet.
        is_first: u32,
        /// 1 when the picture is to hold colours now.
        is_last: u32,
        /// Top of the highest layer, m.
        highest_top_m: f32,
    }
}

gpu_struct! {
    /// A ray of a picture that is no pinhole camera's, in the frame of its cell.
    ListedRay {
        /// Where it starts, m.
        origin: [f32; 3],
        /// Fills to 16 bytes.
        pad_origin: f32,
        /// Unit vector.
        direction: [f32; 3],
        /// Fills to 16 bytes.
        pad_direction: f32,
    }
}

gpu_struct! {
    /// One frame of a temporal window.
    WindowSlice {
        /// Eye, m.
        position: [f32; 3],
        /// Share of a step by which all samples are moved.
        segment: f32,
        /// Unit vector through the middle of the picture.
        forward: [f32; 3],
        /// 1: the camera is the shown one's.
        is_same_view: u32,
        /// Half the picture's width at distance 1, over its square.
        across: [f32; 3],
        /// 0: nothing that can be shown.
        weight: f32,
        /// Half the picture's height at distance 1, over its square.
        upward: [f32; 3],
        /// How far from where the shown rays start its own did, m, where that is not the eye.
        start_moved_m: f32,
        /// Which of a marched pixel's picture pixels has the sample.
        pixel: [f32; 2],
        /// Where in it, 0…1.
        within: [f32; 2],
        /// Movement of the clouds since, m: x and z of two layers each.
        drift: [[f32; 4]; 2],
    }
}

gpu_struct! {
    /// The sliding window of one viewer.
    Window {
        /// Its frames.
        slices: [WindowSlice; 16],
        /// Slices in the ring.
        frames: u32,
        /// The slice that is marched, or the newest one.
        newest: u32,
        /// Picture pixels along a marched pixel.
        divisor: u32,
        /// 1: gaps are filled from the marched pixels around them.
        fills_gaps: u32,
        /// 1 / (2 σ²) of a sample's weight by its distance in picture pixels.
        sharpness: f32,
        /// How many steps of the whole march one step of a frame is long.
        step_scale: f32,
        /// Into how many parts such a step is cut where cloud begins.
        refinement: f32,
        /// Share of a picture pixel over which its samples are spread.
        spread: f32,
        /// Which of a marched pixel's picture pixels the newest slice has samples of.
        newest_pixel: [f32; 2],
        /// How many slices have samples of one and the same picture pixel.
        slices_per_pixel: u32,
        /// Fills to 16 bytes.
        pad_end: u32,
        /// Slices by the picture pixel that they have samples of.
        order: [[u32; 4]; 4],
    }
}

//! Skycell's WGSL modules, composed, validated and described.
//!
//! The folder `wgsl/` holds one module per concern. [`compose`] links a [`Kernel`] with the modules that it imports,
//! specialised to [`Features`]: what a scene lacks is not compiled in. [`layout`] is the Rust side of every struct that
//! both sides see; a test compares the two.

pub mod layout;
mod resources;
mod shown;

pub use resources::resources_of;
pub use shown::{Quantity, Seen, Shown};

use naga_oil::compose::{
    ComposableModuleDescriptor, Composer, NagaModuleDescriptor, ShaderDefValue,
};
use std::collections::HashMap;

/// What the kernels ask of a device beside WGSL's core: packing two half floats into a word, which everything but old GLES
/// can do.
pub const CAPABILITIES: naga::valid::Capabilities =
    naga::valid::Capabilities::SHADER_FLOAT16_IN_FLOAT32;

/// A compute program: one WGSL file with one entry point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// One ray per texel of a tile: fills the cache.
    MarchTexels,
    /// One ray per pixel of a viewer: the screen-space renderer.
    MarchPixels,
    /// The temporal window's slices summed up for the shown camera.
    ResolveWindow,
    /// Texels marched once more, beside what the cache holds of them.
    AuditTexels,
    /// Columns of the sun volume.
    SunColumns,
    /// One picture for one viewer.
    Composite,
    /// What the cloud field holds, as a picture.
    Inspect,
    /// Physical functions evaluated at given points, for tests.
    Probe,
    /// Functions of the scene and its cloud field evaluated at given points.
    ProbeField,
    /// Old maps on their way to new ones.
    BlendMaps,
    /// The sky's table for an altitude.
    MakeAirView,
    /// The haze's table for an altitude.
    MakeAirHaze,
    /// The shadow that a layer throws into the air.
    CloudShadows,
    /// The table of light shafts for a place.
    MakeLightShafts,
    /// One cell's picture on its way to another's.
    FadePictures,
    /// Tiles about a new anchor filled from those about the old one.
    ResampleTiles,
}

impl Kernel {
    /// Every kernel.
    pub const ALL: [Self; 16] = [
        Self::MarchTexels,
        Self::MarchPixels,
        Self::ResolveWindow,
        Self::AuditTexels,
        Self::SunColumns,
        Self::Composite,
        Self::Inspect,
        Self::Probe,
        Self::ProbeField,
        Self::BlendMaps,
        Self::MakeAirView,
        Self::MakeAirHaze,
        Self::CloudShadows,
        Self::MakeLightShafts,
        Self::FadePictures,
        Self::ResampleTiles,
    ];

    /// Name of the entry point.
    #[must_use]
    pub const fn entry_point(self) -> &'static str {
        match self {
            Self::MarchTexels => "march_texels",
            Self::MarchPixels => "march_pixels",
            Self::ResolveWindow => "resolve_window",
            Self::AuditTexels => "audit_texels",
            Self::SunColumns => "sun_columns",
            Self::Composite => "composite",
            Self::Inspect => "inspect",
            Self::Probe => "probe",
            Self::ProbeField => "probe_field",
            Self::BlendMaps => "blend_maps",
            Self::MakeAirView => "make_air_view",
            Self::MakeAirHaze => "make_air_haze",
            Self::CloudShadows => "cloud_shadows",
            Self::MakeLightShafts => "make_light_shafts",
            Self::FadePictures => "fade_pictures",
            Self::ResampleTiles => "resample_tiles",
        }
    }

    const fn source(self) -> (&'static str, &'static str) {
        match self {
            Self::MarchTexels => (
                "march/texels.wgsl",
                include_str!("../wgsl/march/texels.wgsl"),
            ),
            Self::MarchPixels => (
                "march/pixels.wgsl",
                include_str!("../wgsl/march/pixels.wgsl"),
            ),
            Self::ResolveWindow => (
                "march/resolve.wgsl",
                include_str!("../wgsl/march/resolve.wgsl"),
            ),
            Self::AuditTexels => ("march/audit.wgsl", include_str!("../wgsl/march/audit.wgsl")),
            Self::SunColumns => (
                "march/sun_columns.wgsl",
                include_str!("../wgsl/march/sun_columns.wgsl"),
            ),
            Self::Composite => (
                "composite/composite.wgsl",
                include_str!("../wgsl/composite/composite.wgsl"),
            ),
            Self::Inspect => (
                "march/inspect.wgsl",
                include_str!("../wgsl/march/inspect.wgsl"),
            ),
            Self::Probe => ("probe/probe.wgsl", include_str!("../wgsl/probe/probe.wgsl")),
            Self::ProbeField => ("probe/field.wgsl", include_str!("../wgsl/probe/field.wgsl")),
            Self::BlendMaps => (
                "cloud/blend_maps.wgsl",
                include_str!("../wgsl/cloud/blend_maps.wgsl"),
            ),
            Self::MakeAirView => (
                "sky/air_view.wgsl",
                include_str!("../wgsl/sky/air_view.wgsl"),
            ),
            Self::MakeAirHaze => (
                "sky/air_haze.wgsl",
                include_str!("../wgsl/sky/air_haze.wgsl"),
            ),
            Self::CloudShadows => (
                "march/cloud_shadows.wgsl",
                include_str!("../wgsl/march/cloud_shadows.wgsl"),
            ),
            Self::MakeLightShafts => (
                "sky/light_shafts.wgsl",
                include_str!("../wgsl/sky/light_shafts.wgsl"),
            ),
            Self::FadePictures => (
                "composite/fade.wgsl",
                include_str!("../wgsl/composite/fade.wgsl"),
            ),
            Self::ResampleTiles => (
                "march/resample.wgsl",
                include_str!("../wgsl/march/resample.wgsl"),
            ),
        }
    }
}

/// How a layer's density comes about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Density {
    /// A shape that is filled.
    Homogeneous,
    /// Maps and noise.
    #[default]
    Weather,
    /// Voxels.
    Grid,
    /// A thin sheet.
    Cirrus,
}

/// From radiance to what a screen shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Tone {
    /// Narkowicz's fit of ACES.
    #[default]
    Aces,
    /// AgX.
    Agx,
    /// Khronos PBR Neutral.
    Neutral,
}

/// Whether a composite writes clouds alone, for a renderer that has a background of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CloudsAlone {
    /// It writes the picture.
    #[default]
    Off,
    /// Clouds with the haze in front of them.
    InHaze,
    /// Clouds as they are without air in front of them.
    WithoutHaze,
}

/// What a kernel is specialised to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Features {
    /// Groups of four scattering octaves, 1 to 4.
    pub octave_vectors: u32,
    /// Layers that are composited, 0 to 4.
    pub layers: u32,
    /// Parts that each layer is kept in, 1 to 4 (composite of the cache).
    pub proxies: u32,
    /// They lie on domes about their anchors instead of shells about the planet (march of texels, composite of the cache).
    pub domes: bool,
    /// They are bands of distance that end in gaps between clouds (march of texels).
    pub bands: bool,
    /// How density comes about.
    pub density: Density,
    /// Catmull-Rom instead of bilinear reads of the cache.
    pub catmull_rom: bool,
    /// Linear radiance instead of tone-mapped bytes.
    pub linear_output: bool,
    /// Composite of marched pixels instead of cached texels.
    pub screen_space: bool,
    /// Maps, noise and voxels are interpolated in f32 instead of by the sampler's few bits.
    pub exact_interpolation: bool,
    /// Texture reads of the march, or of the cache by the composite, are counted.
    pub count_reads: bool,
    /// Viewers look for what cached texels show along their own rays (composite).
    pub parallax: bool,
    /// Some layer is below the viewer (march of texels, which may be below; composite of the cache).
    pub above: bool,
    /// Rays of some layer's far part start in it, and its near part is marched for each viewer (march of texels, which may start
    /// there; composite of the cache).
    pub inside: bool,
    /// Single scattering is coloured with the phase of the ray that was marched instead of the viewer's own, as where the
    /// phase is kept in texels (composite of the cache, one part a layer).
    pub phase_of_reference: bool,
    /// Rays come from a list instead of a pinhole camera (screen-space renderer).
    pub ray_list: bool,
    /// Rays start beside the eye and go through what it sees on shells, one of each layer (screen-space renderer).
    pub moved_start: bool,
    /// Rays fill a frame of a temporal window (screen-space renderer).
    pub window: bool,
    /// Frames of the window that is summed up, 1 to 16.
    pub window_frames: u32,
    /// All frames of the window are from the shown camera.
    pub window_at_rest: bool,
    /// Layers scatter light each in its own way; else all as the first (composite).
    pub own_phases: bool,
    /// Layers share altitudes: what is seen nearer hides the other, not what lies lower (composite).
    pub overlap: bool,
    /// Layers whose sun volumes the march reads; 0: the cone alone.
    pub sun_layers: u32,
    /// Two by two pixels share what is behind the clouds, evaluated where they meet.
    pub shared_background: bool,
    /// From radiance to what a screen shows.
    pub tone: Tone,
    /// What is shown instead of the picture.
    pub shown: Shown,
    /// Clouds alone instead of the picture (composite, fade).
    pub clouds_alone: CloudsAlone,
    /// The air is read from tables instead of being a closed formula (composite).
    pub physical_sky: bool,
    /// Clouds throw their shadow into the air that is read from tables (composite).
    pub light_shafts: bool,
    /// The scene has a moon (composite).
    pub moon: bool,
    /// The scene has stars (composite).
    pub stars: bool,
}

impl Default for Features {
    fn default() -> Self {
        Self {
            octave_vectors: 1,
            layers: 1,
            proxies: 1,
            domes: false,
            bands: false,
            density: Density::Weather,
            catmull_rom: true,
            linear_output: false,
            screen_space: false,
            parallax: false,
            above: false,
            inside: false,
            phase_of_reference: false,
            exact_interpolation: false,
            count_reads: false,
            ray_list: false,
            moved_start: false,
            window: false,
            window_frames: 1,
            window_at_rest: false,
            own_phases: false,
            overlap: false,
            sun_layers: 0,
            shared_background: false,
            tone: Tone::Aces,
            shown: Shown::Picture,
            clouds_alone: CloudsAlone::Off,
            physical_sky: false,
            light_shafts: false,
            moon: false,
            stars: false,
        }
    }
}

impl Features {
    /// Every value of every feature, and every pair of those that meet in one function: octave vectors and layers, which
    /// no kernel reads both, step together, and so do features of the march and of the composite.
    pub fn all() -> impl Iterator<Item = Self> {
        let densities = [
            Density::Homogeneous,
            Density::Weather,
            Density::Grid,
            Density::Cirrus,
        ];
        (0..=4u32).flat_map(move |count| {
            (0..16u32).map(move |bits| Self {
                octave_vectors: count.max(1),
                layers: count,
                proxies: 1 + (bits + count) % 4,
                domes: (bits + count) % 3 != 0,
                bands: (bits + count) % 3 == 1,
                density: densities[((bits + count) % 4) as usize],
                catmull_rom: bits & 1 != 0,
                exact_interpolation: bits & 1 != 0,
                linear_output: bits & 2 != 0,
                count_reads: bits & 2 != 0,
                screen_space: bits & 4 != 0,
                parallax: bits & 8 != 0,
                above: (bits ^ (bits >> 2) ^ count) & 1 != 0,
                inside: (bits ^ (bits >> 2) ^ count) & 3 == 1,
                phase_of_reference: bits & 12 == 0,
                ray_list: bits & 12 == 4,
                moved_start: (bits ^ count) & 1 != 0,
                window: bits & 12 == 12,
                window_frames: bits + 1,
                window_at_rest: bits & 8 != 0,
                own_phases: bits & 8 != 0,
                overlap: bits & 2 != 0,
                sun_layers: if bits & 2 == 0 { 0 } else { count },
                shared_background: bits & 1 != 0,
                tone: [Tone::Aces, Tone::Agx, Tone::Neutral][((bits + count) % 3) as usize],
                shown: Shown::Picture,
                clouds_alone: [
                    CloudsAlone::Off,
                    CloudsAlone::InHaze,
                    CloudsAlone::WithoutHaze,
                ][((bits / 2 + count) % 3) as usize],
                physical_sky: (bits ^ count) & 1 != 0,
                light_shafts: (bits ^ count) & 3 == 1,
                moon: bits & 8 != 0,
                stars: bits & 2 != 0,
            })
        })
    }

    fn definitions(self) -> HashMap<String, ShaderDefValue> {
        // With layers on domes, rays of a viewer's own go on to the end.
        let inside = self.inside && self.above && !self.screen_space && !self.domes;
        let mut definitions = HashMap::from([
            (
                "OCTAVE_VECTORS".to_owned(),
                ShaderDefValue::UInt(self.octave_vectors.clamp(1, 4)),
            ),
            (
                "SUN_LAYERS".to_owned(),
                ShaderDefValue::UInt(self.sun_layers.min(4)),
            ),
            (
                "LAYERS".to_owned(),
                ShaderDefValue::UInt(self.layers.min(4)),
            ),
            (
                "PROXIES".to_owned(),
                ShaderDefValue::UInt(self.proxies.clamp(1, 4)),
            ),
            (
                "WINDOW_FRAMES".to_owned(),
                ShaderDefValue::UInt(self.window_frames.clamp(1, 16)),
            ),
        ]);
        for (name, set) in [
            ("DENSITY_WEATHER", self.density == Density::Weather),
            ("DENSITY_GRID", self.density == Density::Grid),
            ("DENSITY_CIRRUS", self.density == Density::Cirrus),
            (
                "DENSITY_SHAPE",
                matches!(self.density, Density::Homogeneous | Density::Grid),
            ),
            ("DOMES", self.domes),
            ("BANDS", self.bands && !self.window),
            ("CATMULL_ROM", self.catmull_rom),
            ("LINEAR_OUTPUT", self.linear_output),
            ("SCREEN_SPACE", self.screen_space),
            ("PARALLAX", self.parallax && !self.screen_space),
            ("ABOVE", self.above && !self.screen_space),
            ("INSIDE", inside),
            // Parts of layers are told by distances.
            ("DISTANCES", self.domes || inside),
            // Parts of a layer stand in front of one another.
            ("PARTS", self.proxies >= 2 || inside),
            ("MARCHED", self.screen_space || inside),
            (
                "PHASE_OF_REFERENCE",
                self.phase_of_reference && !self.screen_space,
            ),
            (
                "SLOT_ORIGINS",
                (self.parallax || self.phase_of_reference) && !self.screen_space,
            ),
            ("EXACT_INTERPOLATION", self.exact_interpolation),
            ("COUNT_READS", self.count_reads),
            (
                "CACHE_READS",
                self.count_reads
                    && self.linear_output
                    && !self.screen_space
                    && self.shown == Shown::Picture,
            ),
            (
                "CLOUDS_ALONE",
                self.clouds_alone != CloudsAlone::Off && !self.linear_output,
            ),
            (
                "WITHOUT_HAZE",
                self.clouds_alone == CloudsAlone::WithoutHaze,
            ),
            ("RAY_LIST", self.ray_list),
            (
                "MOVED_START",
                self.moved_start && !self.ray_list && !self.domes,
            ),
            ("WINDOW", self.window),
            ("WINDOW_AT_REST", self.window_at_rest),
            ("OWN_PHASES", self.own_phases),
            ("LAYERS_OVERLAP", self.overlap),
            ("SUN_VOLUME", self.sun_layers > 0),
            ("SHARED_BACKGROUND", self.shared_background),
            ("TONE_AGX", self.tone == Tone::Agx),
            ("TONE_NEUTRAL", self.tone == Tone::Neutral),
            ("PHYSICAL_SKY", self.physical_sky),
            ("LIGHT_SHAFTS", self.physical_sky && self.light_shafts),
            ("MOON", self.moon),
            ("STARS", self.stars),
            (
                "HAZE_OF_SPHERES",
                self.physical_sky && self.shared_background && !self.ray_list,
            ),
        ] {
            if set {
                definitions.insert(name.to_owned(), ShaderDefValue::Bool(true));
            }
        }
        for name in self.shown.definitions() {
            definitions.insert(name.to_owned(), ShaderDefValue::Bool(true));
        }
        definitions
    }
}

/// Modules in an order in which each finds what it imports.
const MODULES: &[(&str, &str)] = &[
    (
        "light/scattering.wgsl",
        include_str!("../wgsl/light/scattering.wgsl"),
    ),
    ("scene/scene.wgsl", include_str!("../wgsl/scene/scene.wgsl")),
    (
        "geometry/shell.wgsl",
        include_str!("../wgsl/geometry/shell.wgsl"),
    ),
    (
        "geometry/octahedral.wgsl",
        include_str!("../wgsl/geometry/octahedral.wgsl"),
    ),
    (
        "geometry/cubic.wgsl",
        include_str!("../wgsl/geometry/cubic.wgsl"),
    ),
    (
        "geometry/surface.wgsl",
        include_str!("../wgsl/geometry/surface.wgsl"),
    ),
    ("light/phase.wgsl", include_str!("../wgsl/light/phase.wgsl")),
    (
        "light/transport.wgsl",
        include_str!("../wgsl/light/transport.wgsl"),
    ),
    ("cloud/blend.wgsl", include_str!("../wgsl/cloud/blend.wgsl")),
    (
        "cloud/density.wgsl",
        include_str!("../wgsl/cloud/density.wgsl"),
    ),
    (
        "march/sun_column.wgsl",
        include_str!("../wgsl/march/sun_column.wgsl"),
    ),
    (
        "march/sun_volume.wgsl",
        include_str!("../wgsl/march/sun_volume.wgsl"),
    ),
    ("march/march.wgsl", include_str!("../wgsl/march/march.wgsl")),
    (
        "march/accumulate.wgsl",
        include_str!("../wgsl/march/accumulate.wgsl"),
    ),
    (
        "march/temporal.wgsl",
        include_str!("../wgsl/march/temporal.wgsl"),
    ),
    (
        "march/texel_ray.wgsl",
        include_str!("../wgsl/march/texel_ray.wgsl"),
    ),
    (
        "sky/analytic.wgsl",
        include_str!("../wgsl/sky/analytic.wgsl"),
    ),
    ("sky/night.wgsl", include_str!("../wgsl/sky/night.wgsl")),
    ("sky/air.wgsl", include_str!("../wgsl/sky/air.wgsl")),
    ("sky/shafts.wgsl", include_str!("../wgsl/sky/shafts.wgsl")),
    (
        "sky/air_march.wgsl",
        include_str!("../wgsl/sky/air_march.wgsl"),
    ),
    (
        "sky/physical.wgsl",
        include_str!("../wgsl/sky/physical.wgsl"),
    ),
    (
        "composite/view.wgsl",
        include_str!("../wgsl/composite/view.wgsl"),
    ),
    (
        "composite/cached.wgsl",
        include_str!("../wgsl/composite/cached.wgsl"),
    ),
    (
        "composite/shade.wgsl",
        include_str!("../wgsl/composite/shade.wgsl"),
    ),
    (
        "composite/colour_scale.wgsl",
        include_str!("../wgsl/composite/colour_scale.wgsl"),
    ),
    (
        "composite/show.wgsl",
        include_str!("../wgsl/composite/show.wgsl"),
    ),
    (
        "composite/clouds.wgsl",
        include_str!("../wgsl/composite/clouds.wgsl"),
    ),
    (
        "composite/tone.wgsl",
        include_str!("../wgsl/composite/tone.wgsl"),
    ),
];

/// Path and text of every WGSL file: what a picture depends on beside its scene.
pub fn sources() -> impl Iterator<Item = (&'static str, &'static str)> {
    MODULES
        .iter()
        .copied()
        .chain(Kernel::ALL.map(Kernel::source))
}

/// A kernel that does not compose; only a change of the WGSL can bring it about.
#[derive(Debug, thiserror::Error)]
#[error("{kernel:?} with {features:?}: {message}")]
pub struct ShaderError {
    kernel: Kernel,
    features: Features,
    message: String,
}

/// What stands in the place of a module's source: gets its path and its text. Tests plant defects with it, to show that
/// they are found.
pub type SourceEdit = fn(&str, &str) -> String;

/// Links a kernel with its modules.
///
/// # Errors
/// When the WGSL does not parse or validate; the message points to the place.
pub fn compose(kernel: Kernel, features: Features) -> Result<naga::Module, ShaderError> {
    compose_edited(kernel, features, |_, source| source.to_owned())
}

/// As [`compose`], of edited sources.
///
/// # Errors
/// When what comes of the edit does not parse or validate.
pub fn compose_edited(
    kernel: Kernel,
    features: Features,
    edit: SourceEdit,
) -> Result<naga::Module, ShaderError> {
    let error = |message: String| ShaderError {
        kernel,
        features,
        message,
    };
    // Only the picture itself is composited with the air's tables, moon and stars.
    let is_picture = kernel == Kernel::Composite && features.shown == Shown::Picture;
    let definitions = Features {
        physical_sky: features.physical_sky && is_picture,
        moon: features.moon && is_picture,
        stars: features.stars && is_picture,
        phase_of_reference: features.phase_of_reference && is_picture,
        clouds_alone: if is_picture || kernel == Kernel::FadePictures {
            features.clouds_alone
        } else {
            CloudsAlone::Off
        },
        ..features
    }
    .definitions();
    let mut composer = Composer::default().with_capabilities(CAPABILITIES);
    for (path, source) in MODULES {
        let added = composer.add_composable_module(ComposableModuleDescriptor {
            source: &edit(path, source),
            file_path: path,
            shader_defs: definitions.clone(),
            ..Default::default()
        });
        if let Err(failure) = added {
            return Err(error(failure.emit_to_string(&composer)));
        }
    }
    let (path, source) = kernel.source();
    composer
        .make_naga_module(NagaModuleDescriptor {
            source: &edit(path, source),
            file_path: path,
            shader_defs: definitions,
            ..Default::default()
        })
        .map_err(|failure| error(failure.emit_to_string(&composer)))
}

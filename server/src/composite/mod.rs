//! The pass that makes one viewer's picture: intersect, read, colour, blend back to front, tone map, dither.

mod clouds;
mod fade;
mod inspect;

pub use clouds::{CLOUDS_PIXEL_BYTES, clouds_key, pre_exposure};
pub use fade::{Mix, PictureFade, fade_key, fade_key_of};
pub use inspect::{InspectionInputs, Inspections, inspect_key, shown_key, shown_of};

use crate::cache::ViewFrustum;
use crate::config::FrameFilter;
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use crate::march::{CellFrame, LayerBlend};
use glam::DVec3;
use skycell_protocol::scene::ToneCurve;
use skycell_protocol::{Camera, Codec, FrameSize, Scene};
use skycell_shaders::{Density, Features, Kernel, Tone, layout};

/// A composite in which two by two pixels share what is behind the clouds: an error of half a pixel's worth of clear sky,
/// for a third of the time on a software driver.
#[must_use]
pub fn with_shared_background(key: PipelineKey) -> PipelineKey {
    PipelineKey {
        features: Features {
            shared_background: true,
            ..key.features
        },
        ..key
    }
}

/// A composite that looks for what texels show along the viewer's own rays.
#[must_use]
pub fn with_parallax(key: PipelineKey) -> PipelineKey {
    PipelineKey {
        features: Features {
            parallax: true,
            ..key.features
        },
        ..key
    }
}

/// A composite for a viewer above some layer.
#[must_use]
pub fn with_above(key: PipelineKey) -> PipelineKey {
    PipelineKey {
        features: Features {
            above: true,
            ..key.features
        },
        ..key
    }
}

/// A composite for a viewer in some layer, whose near part is marched for it.
#[must_use]
pub fn with_inside(key: PipelineKey) -> PipelineKey {
    PipelineKey {
        features: Features {
            above: true,
            inside: true,
            ..key.features
        },
        ..key
    }
}

/// What a composite is specialised to.
#[must_use]
pub fn composite_key(
    scene: &Scene,
    filter: FrameFilter,
    blend: LayerBlend,
    screen_space: bool,
    linear_output: bool,
) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::Composite,
        features: Features {
            octave_vectors: 1,
            layers: blend.layers as u32,
            proxies: if screen_space { 1 } else { blend.proxies },
            domes: !screen_space && blend.domes,
            own_phases: blend.own_phases,
            overlap: blend.overlap,
            density: Density::Homogeneous,
            catmull_rom: !screen_space && filter == FrameFilter::CatmullRom,
            linear_output,
            screen_space,
            tone: tone_of(scene.tone().curve()),
            physical_sky: scene.physical_air().is_some(),
            light_shafts: scene.light_shafts() && blend.layers > 0,
            moon: scene.moon().is_some(),
            stars: scene.stars().is_some(),
            ..Features::default()
        },
    }
}

/// A composite of linear radiance: no curve of its own is compiled in.
#[must_use]
pub fn linear_key(key: PipelineKey) -> PipelineKey {
    PipelineKey {
        features: Features {
            linear_output: true,
            tone: Tone::default(),
            ..key.features
        },
        ..key
    }
}

/// What the shaders call a curve.
fn tone_of(curve: ToneCurve) -> Tone {
    match curve {
        ToneCurve::Agx => Tone::Agx,
        ToneCurve::Aces => Tone::Aces,
        ToneCurve::Neutral => Tone::Neutral,
    }
}

/// A camera in the frame of a cell.
#[must_use]
pub fn view_frustum(camera: &Camera, size: FrameSize, frame: &CellFrame) -> ViewFrustum {
    let half_height = (camera.vertical_fov_deg().to_radians() / 2.0).tan();
    let (width, height) = (f64::from(size.width()), f64::from(size.height()));
    ViewFrustum {
        position: frame.from_world(DVec3::from_array(camera.position_m())),
        forward: camera.direction(),
        right: camera.right() * half_height * width / height,
        up: camera.up() * half_height,
        pixel_angle_rad: 2.0 * half_height / height,
    }
}

/// Binary logarithm of the side of the squares that are dithered as one, pixels. A JPEG keeps of 8 × 8 pixels little but the
/// mean where the sky is smooth: noise from pixel to pixel would be quantised away, and the bands would be back. A video's
/// encoder takes the noise of pixels out, and who decodes puts it in again.
#[must_use]
pub fn dither_shift(codec: Codec) -> u32 {
    match codec {
        Codec::Png | Codec::H264 | Codec::Clouds => 0,
        Codec::Jpeg => 3,
    }
}

/// A view as the shaders read it; tables and strips are the caller's to fill in.
#[must_use]
pub fn view_uniform(frustum: &ViewFrustum, frame: &CellFrame, size: FrameSize) -> layout::View {
    let f32s = |v: DVec3| v.as_vec3().to_array();
    layout::View {
        position: f32s(frustum.position),
        width: size.width(),
        forward: f32s(frustum.forward),
        height: size.height(),
        right: f32s(frustum.right),
        up: f32s(frustum.up),
        pixel_angle_rad: frustum.pixel_angle_rad as f32,
        altitude_m: frame.altitude_m(frustum.position) as f32,
        marched_width: size.width(),
        marched_height: size.height(),
        jitter: 1.0,
        picture_width: size.width(),
        ..Default::default()
    }
}

/// The specialisation for the rows in which nothing but ground is seen.
#[must_use]
pub fn ground_key(key: PipelineKey) -> PipelineKey {
    PipelineKey {
        features: Features {
            layers: 0,
            proxies: 1,
            domes: false,
            own_phases: false,
            overlap: false,
            catmull_rom: false,
            parallax: false,
            above: false,
            phase_of_reference: false,
            moon: false,
            stars: false,
            ..key.features
        },
        ..key
    }
}

/// Pixels along a workgroup's part of a picture.
const GROUP_WIDTH: u32 = 32;
/// Rows of a workgroup's part of a picture.
const GROUP_ROWS: u32 = 16;

/// The first row, a multiple of `GROUP_ROWS`, from which on every pixel shows the ground: no cloud needs to be looked
/// up there. A ray meets the ground where it points further down than the horizon's dip.
#[must_use]
pub fn first_ground_row(view: &layout::View, planet_radius_m: f64) -> u32 {
    let [forward, right, up] =
        [view.forward, view.right, view.up].map(|v| glam::Vec3::from_array(v).as_dvec3());
    let altitude_m = f64::from(view.altitude_m);
    if altitude_m < 0.0 {
        return view.height;
    }
    let from_centre_m = planet_radius_m + altitude_m;
    let dip_sin = (altitude_m * (2.0 * planet_radius_m + altitude_m)).sqrt() / from_centre_m;
    // Directions are in the cell's frame, whose up is the viewer's but for the angle between the two on the planet.
    let tilt = glam::dvec2(f64::from(view.position[0]), f64::from(view.position[2])).length()
        / planet_radius_m;
    let margin = 1e-4 + tilt;
    let is_ground = |row: u32| {
        let ndc_y = 1.0 - 2.0 * (f64::from(row) + 0.5) / f64::from(view.height);
        [-1.0, 1.0].iter().all(|ndc_x| {
            let direction = forward + right * *ndc_x + up * ndc_y;
            direction.y < -(dip_sin + margin) * direction.length()
        })
    };
    (0..=view.height / GROUP_ROWS)
        .map(|group| group * GROUP_ROWS)
        .find(|row| *row < view.height && is_ground(*row) && is_ground(view.height - 1))
        .unwrap_or(view.height)
}

/// What a composite reads for one eye.
#[derive(Clone, Copy, Debug)]
pub struct CompositeInputs<'a> {
    /// Which specialisation.
    pub key: PipelineKey,
    /// Group 0: the scene in the frame of the viewer's cell.
    pub scene: &'a wgpu::BindGroup,
    /// Group 1: the air as it is seen from the viewer's altitude, where it is read from tables.
    pub air: Option<&'a wgpu::BindGroup>,
    /// Group 2: the cell's cache or the viewer's marched pixels.
    pub layers: &'a wgpu::BindGroup,
    /// The eye's camera.
    pub view: &'a layout::View,
    /// Radius of the ground, m, where there is one.
    pub ground_radius_m: Option<f64>,
}

/// What a pixel of a picture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureFormat {
    /// Red, green, blue and alpha, tone-mapped, 8 bits each.
    Display,
    /// Linear radiance of red, green and blue and 1, in f32.
    Linear,
    /// Clouds alone, half floats: see [`skycell_protocol::clouds`].
    Clouds,
}

impl PictureFormat {
    /// That of a codec's frames.
    #[must_use]
    pub fn of(codec: Codec) -> Self {
        match codec {
            Codec::Clouds => Self::Clouds,
            _ => Self::Display,
        }
    }

    /// Bytes of a pixel.
    #[must_use]
    pub fn pixel_bytes(self) -> u64 {
        match self {
            Self::Display => 4,
            Self::Linear => 16,
            Self::Clouds => CLOUDS_PIXEL_BYTES as u64,
        }
    }
}

/// Where a viewer's picture is written.
#[derive(Debug)]
pub struct Picture {
    pixels: wgpu::Buffer,
    format: PictureFormat,
    /// One, or the left and the right one.
    eyes: Vec<EyeParts>,
    /// Of one eye's part.
    eye_size: FrameSize,
}

/// What one eye sees.
#[derive(Debug)]
struct EyeParts {
    /// The whole of it, or the part of it in which there is sky.
    sky: Part,
    /// Rows in which there is only ground.
    ground: Part,
}

/// Rows of a picture that one dispatch shades.
#[derive(Debug)]
struct Part {
    view: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl Part {
    fn new(
        gpu: &Gpu,
        pipelines: &Pipelines,
        pixels: &wgpu::Buffer,
        rays: Option<&wgpu::Buffer>,
    ) -> Self {
        let view = gpu.uniform_buffer("view", size_of::<layout::View>());
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &pipelines.picture_layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: view.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: pixels.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: rays.unwrap_or(&pipelines.no_rays).as_entire_binding(),
                },
            ],
        });
        Self { view, group }
    }
}

impl Picture {
    /// A picture of bytes, or of linear radiance (16 bytes a pixel).
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines, size: FrameSize, linear: bool) -> Self {
        Self::of_eyes(gpu, pipelines, size, 1, linear)
    }

    /// A picture of so many eyes side by side, each of a size.
    #[must_use]
    pub fn of_eyes(
        gpu: &Gpu,
        pipelines: &Pipelines,
        eye_size: FrameSize,
        eyes: usize,
        linear: bool,
    ) -> Self {
        Self::with_rays(gpu, pipelines, eye_size, eyes, linear, None)
    }

    /// A picture of listed rays, if there are any.
    #[must_use]
    pub fn with_rays(
        gpu: &Gpu,
        pipelines: &Pipelines,
        eye_size: FrameSize,
        eyes: usize,
        linear: bool,
        rays: Option<&wgpu::Buffer>,
    ) -> Self {
        let format = if linear {
            PictureFormat::Linear
        } else {
            PictureFormat::Display
        };
        Self::of_format(gpu, pipelines, eye_size, eyes, format, rays)
    }

    /// A picture of a format, of so many eyes and of listed rays, if there are any.
    #[must_use]
    pub fn of_format(
        gpu: &Gpu,
        pipelines: &Pipelines,
        eye_size: FrameSize,
        eyes: usize,
        format: PictureFormat,
        rays: Option<&wgpu::Buffer>,
    ) -> Self {
        let pixels = u64::from(eye_size.pixels()) * eyes as u64;
        let bytes = pixels * format.pixel_bytes();
        // Where there is nothing to inspect, black is copied to it.
        let usage = wgpu::BufferUsages::STORAGE
            | wgpu::BufferUsages::COPY_SRC
            | wgpu::BufferUsages::COPY_DST;
        let pixels = gpu.buffer("picture", bytes, usage);
        let part = || Part::new(gpu, pipelines, &pixels, rays);
        let parts = |_| EyeParts {
            sky: part(),
            ground: part(),
        };
        Self {
            eyes: (0..eyes).map(parts).collect(),
            pixels,
            format,
            eye_size,
        }
    }

    /// What its pixels are.
    #[must_use]
    pub fn format(&self) -> PictureFormat {
        self.format
    }

    /// Size of one eye's part of the picture, and how many eyes it has.
    #[must_use]
    pub fn eyes(&self) -> (FrameSize, usize) {
        (self.eye_size, self.eyes.len())
    }

    /// Where an eye's part stands in the picture.
    fn placed(&self, eye: usize, view: &layout::View) -> layout::View {
        let width = self.eye_size.width();
        layout::View {
            picture_width: width * self.eyes.len() as u32,
            first_column: width * eye as u32,
            ..*view
        }
    }

    /// The pixels on the device.
    #[must_use]
    pub fn pixels(&self) -> &wgpu::Buffer {
        &self.pixels
    }

    /// Records the composite: one pass, in which each eye reads what is its own.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        eyes: &[CompositeInputs<'_>],
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("composite"),
            timestamp_writes: timing.pass(TimedPass::Composite, 1),
        });
        for (eye, inputs) in eyes.iter().enumerate() {
            self.record_eye(gpu, &mut pass, pipelines, eye, inputs);
        }
    }

    fn record_eye(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        pipelines: &Pipelines,
        eye: usize,
        inputs: &CompositeInputs<'_>,
    ) {
        let (Some(parts), Some(pipeline), Some(ground_pipeline)) = (
            self.eyes.get(eye),
            pipelines.get(inputs.key),
            pipelines.get(ground_key(inputs.key)),
        ) else {
            return;
        };
        let height = self.eye_size.height();
        // Listed rays have no rows that the horizon could lie between.
        let ground_row = match inputs.ground_radius_m {
            Some(radius_m) if !inputs.key.features.ray_list => {
                first_ground_row(inputs.view, radius_m)
            }
            _ => height,
        };
        pass.set_bind_group(0, inputs.scene, &[]);
        pass.set_bind_group(1, inputs.air.unwrap_or(&pipelines.empty_group), &[]);
        pass.set_bind_group(2, inputs.layers, &[]);
        for (part, pipeline, rows) in [
            (&parts.sky, pipeline, 0..ground_row),
            (&parts.ground, ground_pipeline, ground_row..height),
        ] {
            if rows.is_empty() {
                continue;
            }
            let view = layout::View {
                first_row: rows.start,
                ..self.placed(eye, inputs.view)
            };
            gpu.queue
                .write_buffer(&part.view, 0, bytemuck::bytes_of(&view));
            pass.set_pipeline(pipeline);
            pass.set_bind_group(3, &part.group, &[]);
            pass.dispatch_workgroups(
                self.eye_size.width().div_ceil(GROUP_WIDTH),
                (rows.end - rows.start).div_ceil(GROUP_ROWS),
                1,
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RADIUS_M: f64 = 6.36e6;

    /// The oracle: the ray's line meets the ground sphere in front of the eye.
    fn is_ground(position: DVec3, direction: DVec3) -> bool {
        let from_centre = position + DVec3::Y * RADIUS_M;
        let along = from_centre.dot(direction);
        let closest = (from_centre - along * direction).length();
        along < 0.0 && closest <= RADIUS_M
    }

    proptest! {
        #[test]
        fn where_the_composite_leaves_clouds_out_every_pixel_is_ground(
            pitch in -89.0..60.0f64, fov in 5.0..120.0f64, altitude_m in 0.5..20_000.0f64, across_m in 0.0..5_000.0f64,
        ) {
            let frame = CellFrame::at(DVec3::ZERO, RADIUS_M);
            let size = FrameSize::new(160, 96).expect("a size");
            let camera = Camera::new([across_m, altitude_m, 0.0], 90.0, pitch, fov).expect("a camera");
            let view = view_uniform(&view_frustum(&camera, size, &frame), &frame, size);
            let [position, forward, right, up] = [view.position, view.forward, view.right, view.up]
                .map(|v| glam::Vec3::from_array(v).as_dvec3());
            let first = first_ground_row(&view, RADIUS_M);
            prop_assert!(first.is_multiple_of(GROUP_ROWS) || first == 96);
            for row in first..96 {
                for column in 0..160 {
                    let x = 2.0 * (f64::from(column) + 0.5) / 160.0 - 1.0;
                    let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / 96.0;
                    let direction = (forward + right * x + up * y).normalize();
                    prop_assert!(is_ground(position, direction), "pixel {column} {row}");
                }
            }
        }
    }

    #[test]
    fn half_of_a_level_view_needs_no_clouds() {
        let frame = CellFrame::at(DVec3::ZERO, RADIUS_M);
        let size = FrameSize::new(640, 352).expect("a size");
        let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 0.0, 60.0).expect("a camera");
        let view = view_uniform(&view_frustum(&camera, size, &frame), &frame, size);
        // The horizon lies in the middle, row 176, which a group of rows begins with.
        assert_eq!(first_ground_row(&view, RADIUS_M), 176);
    }
}

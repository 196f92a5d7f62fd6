//! The picture that all others are measured against.
//!
//! Every picture averages its samples over the same box, one pixel of the shown size: the reference has more of them, at
//! the places of the same pattern, whose mean is the pixel's middle. So sub-pixel detail is averaged in both, and a
//! tested picture with few samples is charged for its aliasing.

use super::plan::ReferenceFineness;
use super::settings::PointSettings;
use super::store::{StoreError, key_of, write_whole};
use crate::frame_loop::{StillRenderer, StillSettings};
use crate::gpu::GpuError;
use crate::march::EXPOSURE_AT_ZERO_EV;
use crate::render_command::display::Display;
use crate::truth::{TruthError, reference_world};
use glam::{DVec2, DVec3};
use image::{ImageFormat, Rgb32FImage, RgbImage};
use rayon::prelude::*;
use skycell_protocol::{Camera, FrameSize, Scene, SunDepth};
use skycell_reference::march::{ConvergeLimit, converged_ray};
use skycell_reference::path::{Moments, PathSettings, trace_ray};
use skycell_reference::picture::Projection;
use skycell_reference::{Approximations, World};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use thiserror::Error;

/// How the pictures' pixels are made comparable, for the report.
pub const FOOTPRINT: &str = "Each picture averages its samples over the same box, one pixel of the shown size; the \
    reference has more samples, in the same pattern, whose mean is the pixel's middle. Pictures that were marched at a \
    lower resolution are enlarged to the shown size before they are compared. Shown pictures of the device share the clear sky \
    among two by two pixels, the reference does not: in small pictures that is a floor of FLIP, not of relative MSE.";

/// Why there is no reference.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReferenceError {
    /// The device cannot render it.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// It cannot be kept.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The scene cannot be given to the f64 renderers.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// It cannot be written as EXR.
    #[error("the reference cannot be written as EXR: {0}")]
    Exr(image::ImageError),
}

/// Which renderer is the truth, and how it is set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReferenceSource {
    /// The screen-space renderer, finer than all that is swept.
    ScreenSpace(StillSettings),
    /// The same model on the processor in f64.
    Converged {
        /// Rays across and down a pixel.
        grid: u32,
        /// Relative change of a ray's radiance that counts as none when steps are halved.
        tolerance: f64,
    },
}

impl ReferenceSource {
    /// The screen-space renderer with many steps and samples, and noise interpolated in f32. Clear sky is skipped all the
    /// same: what is skipped holds nothing.
    #[must_use]
    pub fn screen_space(camera: &Camera, fineness: ReferenceFineness) -> Self {
        let exact = PointSettings {
            sun_steps: Some(fineness.sun_steps),
            sun_depth: Some(SunDepth::Cone),
            early_exit: fineness.early_exit,
            exact_interpolation: true,
            ..PointSettings::screen_space(fineness.steps, fineness.samples)
        };
        Self::ScreenSpace(exact.still_settings(camera, false))
    }

    /// What the report calls it.
    #[must_use]
    pub fn label(&self) -> String {
        match self {
            Self::ScreenSpace(StillSettings { march, samples, .. }) => {
                let ends = if march.early_exit {
                    "rays end where nothing behind can be seen"
                } else {
                    "rays go to their ends"
                };
                let sun_steps = march
                    .sun_steps
                    .map_or("the scene's".to_owned(), |n| n.to_string());
                format!(
                    "screen-space renderer, f32 on the GPU, {} steps, {sun_steps} sun steps, {samples} samples a pixel, \
                     {ends}, noise interpolated in f32",
                    march.steps,
                )
            }
            Self::Converged { grid, tolerance } => format!(
                "f64 on the processor, each ray's steps halved until it changes by less than {tolerance}, {} rays a pixel",
                grid * grid,
            ),
        }
    }
}

/// What the f64 renderers need beside a camera.
#[derive(Clone, Debug)]
pub struct TruthInputs {
    /// The scene.
    pub scene: Scene,
    /// Folder in which noise is kept.
    pub noise_dir: PathBuf,
    /// Folder of voxels.
    pub grids_dir: PathBuf,
    /// For how long the wind has blown, s.
    pub time_s: f64,
}

impl TruthInputs {
    fn world(&self, camera: &Camera) -> Result<World, TruthError> {
        let origin_m = DVec3::from_array(camera.position_m());
        reference_world(
            &self.scene,
            &self.noise_dir,
            &self.grids_dir,
            self.time_s,
            origin_m,
            Approximations::ALL,
        )
    }
}

/// A reference with what it is.
#[derive(Clone, Debug)]
pub struct Reference {
    /// What the report calls it.
    pub label: String,
    /// Hash of all that it depends on.
    pub key: String,
    /// Linear radiance, three values a pixel.
    pub linear: Vec<f32>,
    /// The same as it is shown.
    pub shown: RgbImage,
}

/// The reference of a scene and camera, linear radiance, three values a pixel.
///
/// # Errors
/// When it cannot be rendered.
pub fn reference_picture(
    still: &mut StillRenderer,
    source: &ReferenceSource,
    inputs: &TruthInputs,
    camera: Camera,
    size: FrameSize,
    progress: impl Fn(f64) + Sync,
) -> Result<Vec<f32>, ReferenceError> {
    match source {
        ReferenceSource::ScreenSpace(settings) => {
            let picture = still.render_with(camera, size, settings, progress)?;
            Ok(without_alpha(&picture.linear))
        }
        ReferenceSource::Converged { grid, tolerance } => {
            converged_picture(inputs, camera, size, *grid, *tolerance, progress)
        }
    }
}

/// Calls `shoot` for every pixel on all cores, in an order that does not show.
fn for_each_pixel<T: Send>(
    size: FrameSize,
    progress: impl Fn(f64) + Sync,
    shoot: impl Fn(usize, DVec2) -> Result<T, ReferenceError> + Sync,
) -> Result<Vec<T>, ReferenceError> {
    let (pixels, width) = (size.pixels() as usize, size.width() as usize);
    let done = AtomicUsize::new(0);
    (0..pixels)
        .into_par_iter()
        .map(|index| {
            let corner = DVec2::new((index % width) as f64, (index / width) as f64);
            let shot = shoot(index, corner);
            progress((done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / pixels as f64);
            shot
        })
        .collect()
}

fn converged_picture(
    inputs: &TruthInputs,
    camera: Camera,
    size: FrameSize,
    grid: u32,
    tolerance: f64,
    progress: impl Fn(f64) + Sync,
) -> Result<Vec<f32>, ReferenceError> {
    let world = inputs.world(&camera)?;
    let projection = Projection::Pinhole { camera, size };
    let pixels = for_each_pixel(size, progress, |_, corner| {
        let mut sum = DVec3::ZERO;
        for place in 0..grid * grid {
            let within = DVec2::new(f64::from(place % grid) + 0.5, f64::from(place / grid) + 0.5);
            if let Some(ray) = projection.ray(&world, corner + within / f64::from(grid)) {
                let limit = ConvergeLimit::default();
                sum += converged_ray(&world, &ray, None, tolerance, &limit)
                    .map_err(TruthError::from)?
                    .result
                    .radiance;
            }
        }
        Ok((sum / f64::from(grid * grid)).as_vec3().to_array())
    })?;
    Ok(pixels.into_flattened())
}

/// A picture by the path tracer: transport without the model's approximations.
#[derive(Clone, Debug)]
pub struct PathTraced {
    /// Linear radiance, three values a pixel.
    pub linear: Vec<f32>,
    /// Relative MSE that chance alone accounts for: mean of the squared standard errors over mean(b²). It is taken off what
    /// is measured against the picture.
    pub noise: f64,
    /// Paths of a pixel.
    pub paths: u64,
}

/// Grid of the places that paths of a pixel start at, so that they cover it evenly.
const PATH_PLACES: u64 = 4;

/// The path-traced picture, from `folder` if it is there, else rendered and kept there.
///
/// # Errors
/// When it can be neither read nor rendered, or not be kept.
pub fn kept_path_traced(
    folder: &Path,
    depends_on: &[&str],
    inputs: &TruthInputs,
    camera: Camera,
    size: FrameSize,
    paths: u64,
    progress: impl Fn(f64) + Sync,
) -> Result<PathTraced, ReferenceError> {
    let settings = format!("path-traced {paths}");
    let parts: Vec<&str> = depends_on
        .iter()
        .copied()
        .chain([settings.as_str()])
        .collect();
    std::fs::create_dir_all(folder).map_err(|e| StoreError::of("make", folder, e))?;
    let path = folder.join(format!("{}.exr", key_of(&parts)));
    let noise_path = path.with_extension("noise");
    let kept_noise = std::fs::read_to_string(&noise_path)
        .ok()
        .and_then(|text| text.trim().parse().ok());
    if let (Some(linear), Some(noise)) = (read_exr(&path, size), kept_noise) {
        return Ok(PathTraced {
            linear,
            noise,
            paths,
        });
    }
    let world = inputs.world(&camera)?;
    let projection = Projection::Pinhole { camera, size };
    let pixels = for_each_pixel(size, progress, |index, corner| {
        let mut moments = Moments::default();
        for sample in 0..paths {
            let place = sample % (PATH_PLACES * PATH_PLACES);
            let within = DVec2::new(
                (place % PATH_PLACES) as f64 + 0.5,
                (place / PATH_PLACES) as f64 + 0.5,
            );
            if let Some(ray) = projection.ray(&world, corner + within / PATH_PLACES as f64) {
                moments.merge(&trace_ray(
                    &world,
                    &ray,
                    index as u64,
                    sample..sample + 1,
                    1,
                    &PathSettings::default(),
                ));
            }
        }
        let result = moments.result();
        Ok((result.radiance, result.standard_error.radiance))
    })?;
    let squares = |f: &dyn Fn(&(DVec3, DVec3)) -> DVec3| {
        pixels.iter().map(|p| f(p).length_squared()).sum::<f64>()
    };
    let noise = squares(&|p| p.1) / squares(&|p| p.0).max(f64::MIN_POSITIVE);
    let linear: Vec<f32> = pixels
        .iter()
        .flat_map(|p| p.0.as_vec3().to_array())
        .collect();
    write_exr(&path, size, &linear)?;
    write_whole(&noise_path, noise.to_string().as_bytes())?;
    Ok(PathTraced {
        linear,
        noise,
        paths,
    })
}

/// The reference, from `folder` if it is there, else rendered and kept there. `depends_on` is all that the picture
/// depends on beside the source.
///
/// # Errors
/// When it can be neither read nor rendered, or not be kept.
pub fn kept_reference(
    folder: &Path,
    depends_on: &[&str],
    scene: &Scene,
    size: FrameSize,
    source: &ReferenceSource,
    render: impl FnOnce() -> Result<Vec<f32>, ReferenceError>,
) -> Result<Reference, ReferenceError> {
    let label = source.label();
    let settings = format!("{source:?}");
    let parts: Vec<&str> = depends_on
        .iter()
        .copied()
        .chain([settings.as_str()])
        .collect();
    let key = key_of(&parts);
    std::fs::create_dir_all(folder).map_err(|e| StoreError::of("make", folder, e))?;
    let path = folder.join(format!("{key}.exr"));
    let linear = match read_exr(&path, size) {
        Some(linear) => linear,
        None => {
            let linear = render()?;
            write_exr(&path, size, &linear)?;
            linear
        }
    };
    let shown = shown_picture(&linear, size, scene);
    Ok(Reference {
        label,
        key,
        linear,
        shown,
    })
}

/// Linear radiance as a viewer would see it: the composite's tone curve and dither.
#[must_use]
pub fn shown_picture(linear: &[f32], size: FrameSize, scene: &Scene) -> RgbImage {
    let display = Display {
        exposure: EXPOSURE_AT_ZERO_EV * scene.exposure_ev().exp2(),
        curve: scene.tone().curve(),
        tone_map: true,
        dither: true,
    };
    RgbImage::from_fn(size.width(), size.height(), |x, y| {
        let first = 3 * (y as usize * size.width() as usize + x as usize);
        let radiance = [0, 1, 2]
            .map(|channel| f64::from(linear.get(first + channel).copied().unwrap_or_default()));
        image::Rgb(display.bytes(radiance, x, y))
    })
}

/// None for a file that is missing, damaged or of another size: then it is rendered anew.
fn read_exr(path: &Path, size: FrameSize) -> Option<Vec<f32>> {
    let bytes = std::fs::read(path).ok()?;
    let picture = image::load_from_memory_with_format(&bytes, ImageFormat::OpenExr)
        .ok()?
        .to_rgb32f();
    (picture.dimensions() == (size.width(), size.height())).then(|| picture.into_raw())
}

fn write_exr(path: &Path, size: FrameSize, linear: &[f32]) -> Result<(), ReferenceError> {
    let picture = Rgb32FImage::from_raw(size.width(), size.height(), linear.to_vec())
        .ok_or_else(|| GpuError::Device("the reference came in another size".into()))?;
    let mut bytes = Cursor::new(Vec::new());
    picture
        .write_to(&mut bytes, ImageFormat::OpenExr)
        .map_err(ReferenceError::Exr)?;
    Ok(write_whole(path, bytes.get_ref())?)
}

/// RGB of RGBA.
#[must_use]
pub fn without_alpha<T: Copy>(rgba: &[T]) -> Vec<T> {
    rgba.chunks_exact(4)
        .flat_map(|p| [p[0], p[1], p[2]])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::plan::Extent;
    use super::*;

    #[test]
    fn a_kept_reference_is_the_one_that_was_rendered() {
        let folder = tempfile::tempdir().expect("a folder");
        let size = FrameSize::new(4, 3).expect("a size");
        let source =
            ReferenceSource::screen_space(&Camera::default(), Extent::Quick.reference_fineness());
        let rendered: Vec<f32> = (0..36).map(|i| i as f32 * 0.01 + 1e-6).collect();
        let get = |parts: &[&str], render: Option<Vec<f32>>| {
            kept_reference(
                folder.path(),
                parts,
                &Scene::default(),
                size,
                &source,
                || render.ok_or_else(|| GpuError::Device("rendered again".into()).into()),
            )
        };
        get(&["a"], Some(rendered.clone())).expect("rendered");
        assert_eq!(get(&["a"], None).expect("kept").linear, rendered);
        assert!(
            get(&["b"], None).is_err(),
            "another scene has another reference"
        );
    }
}

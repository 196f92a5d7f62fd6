//! The picture that all others are measured against.
//!
//! Every picture averages its samples over the same box, one pixel of the shown size: the reference has more of them, at
//! the places of the same pattern, whose mean is the pixel's middle. So sub-pixel detail is averaged in both, and a
//! tested picture with few samples is charged for its aliasing.

use super::plan::ReferenceFineness;
use super::settings::PointSettings;
use super::store::{StoreError, key_of, write_whole};
use super::tone::shown_picture;
use crate::frame_loop::{StillPicture, StillRenderer, StillSettings};
use crate::gpu::GpuError;
use image::{ImageFormat, Rgb32FImage, RgbImage};
use skycell_protocol::{Camera, FrameSize, Scene};
use std::io::Cursor;
use std::path::Path;
use thiserror::Error;

/// How the pictures' pixels are made comparable, for the report.
pub const FOOTPRINT: &str = "Each picture averages its samples over the same box, one pixel of the shown size; the \
    reference has more samples, in the same pattern, whose mean is the pixel's middle. Pictures that were marched at a \
    lower resolution are enlarged to the shown size before they are compared.";

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
    /// It cannot be written as EXR.
    #[error("the reference cannot be written as EXR: {0}")]
    Exr(image::ImageError),
}

/// Which renderer is the truth, and how it is set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceSource(StillSettings);

impl ReferenceSource {
    /// The screen-space renderer with many steps and samples, and noise interpolated in f32.
    /// Clear sky is skipped all the same: what is skipped holds nothing.
    #[must_use]
    pub fn screen_space(camera: &Camera, fineness: ReferenceFineness) -> Self {
        let exact = PointSettings {
            sun_steps: Some(fineness.sun_steps),
            early_exit: fineness.early_exit,
            exact_interpolation: true,
            ..PointSettings::screen_space(fineness.steps, fineness.samples)
        };
        Self(exact.still_settings(camera, false))
    }

    /// What the report calls it.
    #[must_use]
    pub fn label(&self) -> String {
        let StillSettings { march, samples, .. } = self.0;
        let ends = if march.early_exit {
            "rays end where nothing behind can be seen"
        } else {
            "rays go to their ends"
        };
        let interpolation = if march.exact_interpolation {
            ", noise interpolated in f32"
        } else {
            ""
        };
        format!(
            "screen-space renderer, f32 on the GPU, {} steps, {} sun steps, {samples} samples a pixel, {ends}{interpolation}",
            march.steps,
            march
                .sun_steps
                .map_or("the scene's".to_owned(), |n| n.to_string()),
        )
    }

    /// Work in the unit of [`PointSettings::expected_work`].
    #[must_use]
    pub fn expected_work(&self) -> f64 {
        let march = self.0.march;
        PointSettings {
            sun_steps: march.sun_steps,
            ..PointSettings::screen_space(march.steps, self.0.samples)
        }
        .expected_work()
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

/// The reference of a scene and camera, linear radiance, three values a pixel. Whatever becomes the truth renders here.
///
/// # Errors
/// When the device cannot render it.
pub fn reference_picture(
    still: &mut StillRenderer,
    source: &ReferenceSource,
    camera: Camera,
    size: FrameSize,
    progress: impl FnMut(f64),
) -> Result<Vec<f32>, GpuError> {
    let StillPicture { linear, .. } = still.render_with(camera, size, &source.0, progress)?;
    Ok(without_alpha(&linear))
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
    render: impl FnOnce() -> Result<Vec<f32>, GpuError>,
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
                || render.ok_or_else(|| GpuError::Device("rendered again".into())),
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

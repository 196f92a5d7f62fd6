//! Clouds alone as OpenEXR files, for whoever composites them later.

use std::io::Cursor;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};
use skycell_protocol::clouds::{Clouds, CloudsError};
use skycell_protocol::{FrameCodec, FrameHeader};
use thiserror::Error;

/// Why a payload is no file of clouds.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CloudsFileError {
    /// The frame holds something else.
    #[error("a frame of {0:?} holds no clouds alone")]
    NotClouds(FrameCodec),
    /// The payload is none.
    #[error(transparent)]
    Clouds(#[from] CloudsError),
    /// Another size than the header says.
    #[error("the clouds have {0}x{1} pixels, their frame's header says {2}x{3}")]
    WrongSize(u32, u32, u16, u16),
    /// The file cannot be made.
    #[error("EXR: {0}")]
    Exr(#[from] exr::error::Error),
}

/// The clouds of a frame.
///
/// # Errors
/// If the payload is not what the header describes.
pub fn clouds_of(header: &FrameHeader, payload: &[u8]) -> Result<Clouds, CloudsFileError> {
    if header.codec != FrameCodec::Clouds {
        return Err(CloudsFileError::NotClouds(header.codec));
    }
    let clouds = Clouds::parse(payload)?;
    let (width, height) = (clouds.width(), clouds.height());
    if (width, height) != (header.width.into(), header.height.into()) {
        let (told_width, told_height) = (header.width, header.height);
        let error = CloudsFileError::WrongSize(width, height, told_width, told_height);
        return Err(error);
    }
    Ok(clouds)
}

/// Clouds as an EXR file of one layer, f32: R, G, B (premultiplied, linear, without pre-exposure), A (1 - T), T (transmittance)
/// and Z (mean distance along the ray, m; 0 where there are no clouds).
///
/// # Errors
/// If the file cannot be made.
pub fn to_exr(clouds: &Clouds) -> Result<Vec<u8>, CloudsFileError> {
    let size = (clouds.width() as usize, clouds.height() as usize);
    let pixels = size.0 * size.1;
    let channel = |name: &str, value: &dyn Fn(usize) -> f32| {
        AnyChannel::new(name, FlatSamples::F32((0..pixels).map(value).collect()))
    };
    let channels = AnyChannels::sort(
        [
            channel("R", &|pixel| clouds.radiance(pixel)[0]),
            channel("G", &|pixel| clouds.radiance(pixel)[1]),
            channel("B", &|pixel| clouds.radiance(pixel)[2]),
            channel("A", &|pixel| 1.0 - clouds.transmittance(pixel)),
            channel("T", &|pixel| clouds.transmittance(pixel)),
            channel("Z", &|pixel| clouds.distance_m(pixel)),
        ]
        .into_iter()
        .collect(),
    );
    let layer = Layer::new(
        size,
        LayerAttributes::named("clouds"),
        Encoding::SMALL_LOSSLESS,
        channels,
    );
    let mut file = Cursor::new(Vec::new());
    Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut file)?;
    Ok(file.into_inner())
}

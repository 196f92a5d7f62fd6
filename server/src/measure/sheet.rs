//! Frames of sequences on one picture: a row for each sequence, columns from the first frame to the last.

use image::codecs::jpeg::JpegEncoder;
use image::{RgbImage, imageops};

/// Frames of a row.
const COLUMNS: usize = 4;
/// Pixels between frames.
const GAP: u32 = 4;
/// JPEG quality of the sheet.
const JPEG_QUALITY: u8 = 85;

/// A JPEG of evenly chosen frames of all rows.
pub(super) fn sheet(rows: &[(String, Vec<RgbImage>)]) -> anyhow::Result<Vec<u8>> {
    let first = rows.iter().find_map(|(_, frames)| frames.first());
    let (width, height) = first.map_or((1, 1), RgbImage::dimensions);
    let mut sheet = RgbImage::from_pixel(
        COLUMNS as u32 * (width + GAP) - GAP,
        (rows.len().max(1) as u32) * (height + GAP) - GAP,
        image::Rgb([255; 3]),
    );
    for (row, (_, frames)) in rows.iter().enumerate() {
        for column in 0..COLUMNS {
            let at = column * frames.len().saturating_sub(1) / (COLUMNS - 1);
            if let Some(frame) = frames.get(at) {
                let x = i64::from(column as u32 * (width + GAP));
                let y = i64::from(row as u32 * (height + GAP));
                imageops::replace(&mut sheet, frame, x, y);
            }
        }
    }
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, JPEG_QUALITY).encode_image(&sheet)?;
    Ok(jpeg)
}

//! The points as a table of comma-separated values, one row each.

use super::super::settings::PictureCodec;
use super::data::{Report, ReportPoint, RungCosts};
use serde::Serialize;

/// A row: settings, errors, costs. Empty where there is no figure.
#[derive(Serialize)]
struct Row<'a> {
    axis: &'a str,
    label: &'a str,
    renderer: &'a str,
    steps: u32,
    sun_steps: Option<u32>,
    octaves: Option<u32>,
    early_exit: bool,
    low_density_skip: bool,
    adaptive_step: bool,
    exact_interpolation: bool,
    samples: u32,
    samples_by_area: bool,
    window_frames: u32,
    depth_segments: u32,
    refinement: u32,
    resolution_divisor: u32,
    mip_bias: f32,
    filter: &'a str,
    reference_sideways_m: f64,
    codec: String,
    flip: f64,
    flip_of_axis: Option<f64>,
    ssim: f64,
    relative_mse: Option<f64>,
    relative_mse_per_pixel: Option<f64>,
    worst_pixel_deviation: Option<f64>,
    worst_pixel_x: Option<u32>,
    worst_pixel_y: Option<u32>,
    path_traced_relative_mse: Option<f64>,
    texture_reads_per_frame: Option<f64>,
    marches_per_frame: Option<f64>,
    gpu_ms_per_frame: Option<f64>,
    wall_ms_per_frame: Option<f64>,
    encoded_bytes: Option<u64>,
    encode_ms: Option<f64>,
    on_front: bool,
}

/// A name as it stands in JSON.
pub(crate) fn name_of(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        other => other.map(|value| value.to_string()).unwrap_or_default(),
    }
}

/// The table.
///
/// # Errors
/// When a row cannot be written, which memory never refuses.
pub fn csv(report: &Report) -> Result<Vec<u8>, csv::Error> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for point in &report.points {
        write_row(&mut writer, point)?;
    }
    writer
        .into_inner()
        .map_err(|error| csv::Error::from(error.into_error()))
}

fn write_row(writer: &mut csv::Writer<Vec<u8>>, point: &ReportPoint) -> Result<(), csv::Error> {
    let settings = &point.settings;
    let costs = RungCosts::of_frame(point);
    let measurement = point.measurement;
    let linear = measurement.linear;
    writer.serialize(Row {
        axis: &name_of(&point.axis),
        label: &point.label,
        renderer: &name_of(&settings.renderer),
        steps: settings.steps,
        sun_steps: settings.sun_steps,
        octaves: settings.octaves,
        early_exit: settings.early_exit,
        low_density_skip: settings.low_density_skip,
        adaptive_step: settings.adaptive_step,
        exact_interpolation: settings.exact_interpolation,
        samples: settings.samples,
        samples_by_area: settings.samples_by_area,
        window_frames: settings.window_frames,
        depth_segments: settings.depth_segments,
        refinement: settings.refinement,
        resolution_divisor: settings.resolution_divisor,
        mip_bias: settings.mip_bias,
        filter: &name_of(&settings.filter),
        reference_sideways_m: settings.reference_sideways_m,
        codec: match settings.codec {
            None => String::new(),
            Some(PictureCodec::Png) => "png".into(),
            Some(PictureCodec::Jpeg(quality)) => format!("jpeg {quality}"),
        },
        flip: measurement.shown.flip,
        flip_of_axis: point.flip_of_axis,
        ssim: measurement.shown.ssim,
        relative_mse: linear.map(|l| l.relative_mse),
        relative_mse_per_pixel: linear.map(|l| l.relative_mse_per_pixel),
        worst_pixel_deviation: linear.map(|l| l.worst_pixel.relative_deviation),
        worst_pixel_x: linear.map(|l| l.worst_pixel.x),
        worst_pixel_y: linear.map(|l| l.worst_pixel.y),
        path_traced_relative_mse: measurement.path_traced_relative_mse,
        texture_reads_per_frame: costs.texture_reads,
        marches_per_frame: costs.marches,
        gpu_ms_per_frame: costs.gpu_ms,
        wall_ms_per_frame: costs.wall_ms,
        encoded_bytes: measurement.cost.encoded_bytes,
        encode_ms: measurement.cost.encode_s.map(|s| s * 1e3),
        on_front: point.on_front,
    })
}

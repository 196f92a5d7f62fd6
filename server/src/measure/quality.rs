//! The file of quality points that a server picks from: `quality.json`.

use super::front::Preset;
use super::report::{Report, ReportPoint};
use super::settings::PointSettings;
use serde_json::{Value, json};
use skycell_protocol::Scene;

/// The points that nothing beats, also of those with all samples in each texel alone, one of which who asks for an error gets, and of
/// those with few tiles. A preset's point is there once for each preset that it is; with numbers for what the scene leaves open.
#[must_use]
pub fn quality_file(report: &Report, scene: &Scene) -> Value {
    let best_cost = report
        .quality_front
        .last()
        .and_then(|i| report.points[*i].frame_cost);
    let alone = (report.each_texel_front.iter()).chain(&report.few_tiles_front);
    let beaten = alone.filter(|i| !report.quality_front.contains(i));
    let points: Vec<Value> = report
        .quality_front
        .iter()
        .chain(beaten)
        .flat_map(|i| {
            let presets: Vec<Option<Preset>> = report
                .presets
                .iter()
                .filter(|choice| choice.point == Some(*i))
                .map(|choice| Some(choice.preset))
                .collect();
            let presets = if presets.is_empty() {
                vec![None]
            } else {
                presets
            };
            presets
                .into_iter()
                .map(|preset| quality_point(&report.points[*i], preset, scene, best_cost))
                .collect::<Vec<_>>()
        })
        .collect();
    let size = report.run.size;
    // Scenes are measured as they are at a moment.
    let default = Scene::default();
    let is_default = [&default, &default.at_sky_s(0.0)].contains(&scene);
    json!({
        "version": 1,
        "measured_with": format!(
            "{}, {}x{}, {}, against {}",
            report.run.adapter,
            size.width(),
            size.height(),
            if is_default { "default scene" } else { "a scene of its own" },
            report.run.reference,
        ),
        "points": points,
    })
}

fn quality_point(
    point: &ReportPoint,
    preset: Option<Preset>,
    scene: &Scene,
    best_cost: Option<f64>,
) -> Value {
    let PointSettings {
        steps,
        sun_steps,
        sun_depth,
        octaves,
        samples,
        samples_by_area,
        mip_bias,
        filter,
        ..
    } = point.settings;
    let measurement = point.measurement;
    let cost = measurement.cost;
    let reads_per_ray = cost
        .texture_reads
        .filter(|_| cost.marches > 0)
        .map(|reads| reads as f64 / cost.marches as f64);
    let relative = point
        .frame_cost
        .zip(best_cost)
        .map(|(cost, best)| cost / best);
    json!({
        "preset": preset,
        "settings": {
            "march_steps": steps,
            "sun_steps": sun_steps.unwrap_or(scene.light().sun_steps()),
            // These are the scene's to say where a point does not: another way to the sun is another cost, and another number of terms
            // another sky.
            "sun_depth": sun_depth,
            "octaves": octaves,
            "samples": samples,
            "samples_by_area": samples_by_area,
            "mip_bias": mip_bias,
            "frame_filter": filter,
        },
        "error": {
            "flip": measurement.shown.flip,
            "ssim": measurement.shown.ssim,
            "relative_mse": measurement.linear.map(|l| l.relative_mse),
        },
        "cost": { "texture_reads_per_ray": reads_per_ray, "relative": relative },
    })
}

//! The report as one page that needs no other file.

use super::super::metrics::DARK_SHARE;
use super::super::plan::Axis;
use super::data::{CostUnit, Report, ReportPoint, Rung, RungCosts};
use super::plots::{CACHED, FRONT, OF_AXIS, SCREEN_SPACE, axis_plot, front_plot, short};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use plotters::style::RGBColor;

/// Data URIs of a point's picture and of its FLIP map.
pub(crate) type Thumbnails<'a> = &'a dyn Fn(&str) -> Option<[String; 2]>;

const STYLE: &str = include_str!("page.css");

/// The page. `reference` is the data URI of the reference picture.
#[must_use]
pub fn page(report: &Report, reference: &str, thumbnails: Thumbnails<'_>) -> String {
    let title = "Skycell: time against error";
    whole_page(
        title,
        &html! {
            h1 { (title) }
            (facts(report, reference))
            (presets(report))
            (front(report))
            @if !report.ladder.is_empty() { (ladder(report, thumbnails)) }
            h2 { "One setting at a time" }
            p { (legend(&[(SCREEN_SPACE, "FLIP, screen-space"), (CACHED, "FLIP, cached"), (OF_AXIS, "FLIP against the axis's own most accurate point: the error of this setting alone")])) }
            @for axis in Axis::ALL.into_iter().filter(|axis| *axis != Axis::Ladder) { (axis_section(report, axis, thumbnails)) }
            (definitions(report))
        },
    )
}

/// A page that needs no other file, around what it tells.
#[must_use]
pub(crate) fn whole_page(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { main { (body) } }
        }
    }
    .into_string()
}

fn legend(entries: &[(RGBColor, &str)]) -> Markup {
    html! {
        @for (RGBColor(r, g, b), text) in entries {
            span.key { i style=(format!("background:rgb({r},{g},{b})")) {} (text) }
        }
    }
}

fn facts(report: &Report, reference: &str) -> Markup {
    let run = &report.run;
    let camera = run.camera;
    let [x, y, z] = camera.position_m();
    html! {
        figure.reference { img src=(reference) alt="The reference picture"; figcaption { "The reference" } }
        dl {
            dt { "Rendered by" } dd { (run.adapter) ", Skycell " (run.version) }
            dt { "Picture" } dd {
                (run.size.width()) " × " (run.size.height()) ", from (" (x) ", " (y) ", " (z) ") m, yaw " (camera.yaw_deg())
                "°, pitch " (camera.pitch_deg()) "°, field of view " (camera.vertical_fov_deg()) "°"
            }
            dt { "Reference" } dd { (run.reference) }
            dt { "Pixels" } dd { (run.footprint) }
            dt { "Cost" } dd { (cost_meaning(report.cost_unit)) }
            dt { "Again" } dd { code { (run.command) } }
        }
        @for note in &run.notes { p.note { (note) } }
    }
}

fn cost_meaning(unit: CostUnit) -> &'static str {
    match unit {
        CostUnit::TextureReads => {
            "Texture reads of the march, counted by the shader: the same on every machine. A frame of a temporal window of n \
             frames costs 1/n of its picture; compositing is not counted."
        }
        CostUnit::GpuMs => {
            "Time by the device's timestamps. A frame of a temporal window of n frames costs 1/n of its picture."
        }
        CostUnit::WallMs => {
            "Time by the clock, as this device counts nothing else. A frame of a temporal window of n frames costs 1/n of its \
             picture."
        }
    }
}

fn presets(report: &Report) -> Markup {
    html! {
        h2 { "Presets" }
        p { "Picked by rule from the points that a server can be set to (the cache, read from its reference point) and that no "
            "other of them beats." }
        div.scroll { table {
            thead { tr { th { "Preset" } th { "Rule" } th { "Point" } th.n { "FLIP" } th.n { "SSIM" } th.n { (report.cost_unit.label()) } } }
            tbody { @for choice in &report.presets { tr {
                th { (choice.preset.name()) }
                td { (choice.rule) }
                @match choice.point.map(|i| &report.points[i]) {
                    Some(point) => {
                        td { (described(point)) }
                        td.n { (short(point.measurement.shown.flip)) }
                        td.n { (format!("{:.4}", point.measurement.shown.ssim)) }
                        td.n { (optional(point.frame_cost)) }
                    }
                    None => td colspan="4" { "no measured point is good enough" }
                }
            } } }
        } }
    }
}

fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "–".into(), short)
}

fn described(point: &ReportPoint) -> String {
    super::super::plan::front_point(&point.settings).label
}

fn front(report: &Report) -> Markup {
    html! {
        h2 { "Error over cost" }
        p { (legend(&[(SCREEN_SPACE, "screen-space"), (CACHED, "cached; its line: the front of what a server can be set to"), (FRONT, "nothing beats it")])) }
        @if let Some(svg) = front_plot(report) { figure.wide { div.scroll { (PreEscaped(svg)) } } }
        details {
            summary { "The " (report.front.len()) " points that nothing beats" }
            div.scroll { table {
                thead { tr { th { "Point" } th { "Renderer" } th.n { "FLIP" } th.n { "SSIM" } th.n { (report.cost_unit.label()) } } }
                tbody { @for point in report.front.iter().map(|i| &report.points[*i]) { tr {
                    td { (point.axis.title()) ": " (point.label) }
                    td { (super::table::name_of(&point.settings.renderer)) }
                    td.n { (short(point.measurement.shown.flip)) }
                    td.n { (format!("{:.4}", point.measurement.shown.ssim)) }
                    td.n { (optional(point.frame_cost)) }
                } } }
            } }
        }
    }
}

fn ladder(report: &Report, thumbnails: Thumbnails<'_>) -> Markup {
    let points: Vec<&ReportPoint> = report.points_of(Axis::Ladder).map(|(_, p)| p).collect();
    let flip_max = report
        .ladder
        .iter()
        .map(|r| r.flip)
        .fold(f64::MIN_POSITIVE, f64::max);
    html! {
        h2 { "Ladder" }
        p { (Axis::Ladder.meaning()) " Costs are those of a frame; × is how many times less than the plain march. "
            "Bars of cost are logarithmic, those of FLIP are not." }
        div.scroll { table.ladder {
            thead { tr {
                th { "Rung" } th.n { "Reads" } th.n { "×" } th.n { "Densities" } th.n { "×" } th.n { "Rays" } th.n { "×" } th.n { "GPU ms" } th.n { "×" }
                th.n { "Clock ms" } th.n { "×" } th.n { "FLIP" } th.n { "of plain" } th.n { "SSIM" } th.n { "Relative MSE" }
            } }
            tbody { @for rung in &report.ladder { tr {
                th { (rung.name) }
                @for (cost, factor) in columns(&rung.frame).into_iter().zip(columns(&rung.times_less_than_plain)) {
                    td.n { (optional(cost)) } td.n { (optional(factor)) }
                }
                td.n { (short(rung.flip)) }
                td.n { (optional(rung.flip_of_plain)) }
                td.n { (format!("{:.4}", rung.ssim)) }
                td.n { (optional(rung.relative_mse)) }
            } } }
        } }
        div.bars {
            @for rung in &report.ladder {
                span { (rung.name) }
                div { i.cost style=(format!("width:{:.1}%", 100.0 * cost_share(rung, &report.ladder))) {} b { "÷ " (optional(first(&rung.times_less_than_plain))) } }
                div { i.flip style=(format!("width:{:.1}%", 80.0 * rung.flip / flip_max)) {} b { "FLIP " (short(rung.flip)) } }
            }
        }
        (pictures(&points, thumbnails))
    }
}

fn columns(costs: &RungCosts) -> [Option<f64>; 5] {
    [
        costs.texture_reads,
        costs.density_evaluations,
        costs.marches,
        costs.gpu_ms,
        costs.wall_ms,
    ]
}

/// Reads where they were counted, else time.
fn first(costs: &RungCosts) -> Option<f64> {
    costs.texture_reads.or(costs.gpu_ms).or(costs.wall_ms)
}

/// Length of a bar, 0.02 to 0.8: logarithm of the cost between a half of the least and the plain march's.
fn cost_share(rung: &Rung, ladder: &[Rung]) -> f64 {
    let costs = ladder
        .iter()
        .filter_map(|r| first(&r.frame))
        .filter(|c| *c > 0.0);
    let (least, most) = costs.fold((f64::INFINITY, 0.0f64), |(a, b), c| (a.min(c), b.max(c)));
    match first(&rung.frame) {
        Some(cost) if cost > 0.0 && most > 0.0 => {
            let whole = (2.0 * most / least).ln();
            (0.8 * (2.0 * cost / least).ln() / whole).clamp(0.02, 0.8)
        }
        _ => 0.02,
    }
}

fn axis_section(report: &Report, axis: Axis, thumbnails: Thumbnails<'_>) -> Markup {
    let points: Vec<&ReportPoint> = report.points_of(axis).map(|(_, p)| p).collect();
    if points.is_empty() {
        return html! {};
    }
    let plot = if matches!(axis, Axis::Ladder | Axis::Front) {
        None
    } else {
        axis_plot(report, axis)
    };
    html! {
        section.axis {
            h3 { (axis.title()) }
            p { (axis.meaning()) }
            div.split {
                @if let Some(svg) = plot { figure { (PreEscaped(svg)) } }
                div.scroll { (points_table(report, axis, &points)) }
            }
            (pictures(points.as_slice(), thumbnails))
        }
    }
}

fn pictures(points: &[&ReportPoint], thumbnails: Thumbnails<'_>) -> Markup {
    html! {
        details {
            summary { "Pictures and FLIP maps" }
            div.thumbs { @for point in points {
                @if let Some([picture, flip]) = thumbnails(&point.key) {
                    figure {
                        img src=(picture) alt=(format!("{}: picture", point.label)) loading="lazy";
                        img src=(flip) alt=(format!("{}: FLIP", point.label)) loading="lazy";
                        figcaption { (point.label) ": FLIP " (short(point.measurement.shown.flip)) }
                    }
                }
            } }
        }
    }
}

fn points_table(report: &Report, axis: Axis, points: &[&ReportPoint]) -> Markup {
    let path_traced = points
        .iter()
        .any(|p| p.measurement.path_traced_relative_mse.is_some());
    html! {
        table {
            thead { tr {
                th { (axis.quantity()) } th.n { "FLIP" } th.n { "of this" }
                @if axis == Axis::Codec { th.n { "kB" } th.n { "ms to encode" } } @else { th.n { (report.cost_unit.label()) } }
                th.n { "SSIM" }
                @if axis != Axis::Codec { th.n { "Relative MSE" } th.n { "per pixel" } th.n { "Worst pixel" } }
                @if path_traced { th.n { "Relative MSE, path tracer" } }
                @if axis != Axis::Codec { th.n { "Rays" } th.n { "GPU ms" } th.n { "Clock ms" } }
            } }
            tbody { @for point in points {
                @let measurement = point.measurement;
                @let costs = RungCosts::of_frame(point);
                tr.front[point.on_front] {
                    th { (point.label) }
                    td.n { (short(measurement.shown.flip)) }
                    td.n { (optional(point.flip_of_axis)) }
                    @if axis == Axis::Codec {
                        td.n { (optional(measurement.cost.encoded_bytes.map(|n| n as f64 / 1e3))) }
                        td.n { (optional(measurement.cost.encode_s.map(|s| s * 1e3))) }
                    } @else { td.n { (optional(point.frame_cost)) } }
                    td.n { (format!("{:.4}", measurement.shown.ssim)) }
                    @if axis != Axis::Codec {
                        td.n { (optional(measurement.linear.map(|l| l.relative_mse))) }
                        td.n { (optional(measurement.linear.map(|l| l.relative_mse_per_pixel))) }
                        td.n { @if let Some(linear) = measurement.linear {
                            (short(linear.worst_pixel.relative_deviation)) " at " (linear.worst_pixel.x) "," (linear.worst_pixel.y)
                        } }
                    }
                    @if path_traced { td.n { (optional(measurement.path_traced_relative_mse)) } }
                    @if axis != Axis::Codec {
                        td.n { (optional(costs.marches)) } td.n { (optional(costs.gpu_ms)) } td.n { (optional(costs.wall_ms)) }
                    }
                }
            } }
        }
    }
}

fn definitions(report: &Report) -> Markup {
    html! {
        h2 { "What the figures mean" }
        dl {
            dt { "FLIP" } dd { "Mean of NVIDIA's FLIP between shown pictures (8-bit sRGB) at 67 pixels a degree; 0 is equal. "
                "Maps are in Magma's colours: black 0, light yellow 1." }
            dt { "Of this" } dd { "FLIP against the axis's own most accurate point." }
            dt { "SSIM" } dd { "Mean SSIM of luma (Wang et al. 2004, Gaussian window of 11 pixels, σ = 1.5); 1 is equal." }
            dt { "Relative MSE" } dd { "mean((a − b)²) / mean(b²) of linear radiance, all channels; b is the reference." }
            dt { "Per pixel" } dd { "mean((a − b)² / (b² + ε)), after Rousselle et al. 2011, ε = " (DARK_SHARE) " · mean(b²)." }
            dt { "Worst pixel" } dd { "The largest |Y(a) − Y(b)| / max(Y(b), " (DARK_SHARE) " · mean Y(b)) and its column and row." }
            dt { "Rays" } dd { "Marched samples of pixels or texels. The cache's serve every viewer of its cell and all later frames; "
                "the screen-space renderer's serve one." }
            dt { "GPU ms, clock ms" } dd { "The faster of two renderings where one takes less than half a second. Clock times include "
                "compositing and reading back." }
            dt { "Presets" } dd { @for choice in &report.presets { (choice.preset.name()) ": " (choice.rule) ". " } }
        }
    }
}

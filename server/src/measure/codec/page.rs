//! The report as one page that needs no other file.

use super::{CodecPoint, CodecReport, Compression, FLIP_MAX};
use crate::measure::report::{Curve, LinePlot, whole_page};
use maud::{Markup, html};
use skycell_protocol::FrameSize;

/// The page.
pub(super) fn page(report: &CodecReport) -> String {
    let title = "Skycell: what compression takes";
    let mut sizes: Vec<FrameSize> = Vec::new();
    for point in &report.points {
        if !sizes.contains(&point.size) {
            sizes.push(point.size);
        }
    }
    let body = html! {
        h1 { (title) }
        dl {
            dt { "Rendered by" } dd { (report.adapter) }
            dt { "Pictures" } dd {
                (report.frames) " of each size, " (report.fps) " a second, while the view turns by " (report.turn_deg_per_s)
                "° a second; " (report.steps) " steps, " (report.samples) " samples of a texel"
            }
            dt { "Compared" } dd {
                "Each decoded picture with the same before compression. Mean FLIP at 67 pixels a degree; 0 is equal."
            }
            @if let Some(is_met) = report.bar_is_met {
                dt { "H.264 at 8 Mbit/s and 1280 × 720" }
                dd { "stays " @if is_met { "below" } @else { "above" } " a mean FLIP of " (FLIP_MAX) }
            }
        }
        div.plots { @for size in &sizes { (plot(report, *size)) } }
        h2 { "All points" }
        (points(&report.points))
    };
    whole_page(title, &body)
}

fn plot(report: &CodecReport, size: FrameSize) -> Markup {
    let curve = |name: &str, is_of: fn(Compression) -> bool| {
        let of_it = report.points.iter();
        let of_it = of_it.filter(|point| point.size == size && is_of(point.compression));
        let mut points: Vec<(f64, f64)> = of_it.map(|p| (p.mbit_per_s, p.flip)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Curve {
            name: name.into(),
            points,
            has_dots: true,
        }
    };
    let curves: Vec<Curve> = [
        curve("H.264", |c| matches!(c, Compression::H264(_))),
        curve("H.264, plain", |c| matches!(c, Compression::PlainH264(_))),
        curve("JPEG", |c| matches!(c, Compression::Jpeg(_))),
    ]
    .into_iter()
    .filter(|curve| !curve.points.is_empty())
    .collect();
    let plot = LinePlot {
        x_desc: "Mbit/s",
        y_desc: "mean FLIP",
        curves: &curves,
    };
    plot.figure(&format!("{} × {}", size.width(), size.height()))
}

fn points(points: &[CodecPoint]) -> Markup {
    html! {
        div.scroll { table {
            thead { tr {
                th { "Size" } th { "Compression" } th.n { "Mbit/s" } th.n { "FLIP" } th.n { "worst" } th.n { "SSIM" } th.n { "PSNR, dB" }
                th.n { "largest, kB" } th.n { "ms to encode" }
            } }
            tbody { @for point in points { tr {
                td { (point.size.width()) " × " (point.size.height()) }
                td { (point.compression.name()) }
                td.n { (format!("{:.2}", point.mbit_per_s)) }
                td.n { (format!("{:.4}", point.flip)) }
                td.n { (format!("{:.4}", point.flip_worst)) }
                td.n { (format!("{:.4}", point.ssim)) }
                td.n { (format!("{:.2}", point.psnr_db)) }
                td.n { (format!("{:.0}", point.largest_bytes as f64 * 1e-3)) }
                td.n { (format!("{:.1}", point.encode_ms)) }
            } } }
        } }
    }
}

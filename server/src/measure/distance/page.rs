//! The report as one page that needs no other file.

use super::plan::{Direction, Variant, View};
use super::report::{DistanceReport, Reach, VariantCost};
use crate::measure::report::{Curve, LinePlot, short, whole_page};
use maud::{Markup, html};

/// The page.
pub(super) fn page(report: &DistanceReport) -> String {
    let title = "Skycell: error over distance";
    let body = html! {
        h1 { (title) }
        dl {
            dt { "Rendered by" } dd { (report.adapter) }
            dt { "Pictures" } dd {
                (report.size.width()) " × " (report.size.height()) ", " (report.steps) " steps, " (report.samples)
                " samples, looking " (report.pitch_deg) "° above the horizon"
            }
            dt { "Compared" } dd {
                "A picture from a cache whose reference point lies so far from the eye, against the screen-space renderer from \
                 that eye with the same steps and samples. Mean FLIP between shown pictures at 67 pixels a degree; 0 is equal."
            }
        }
        h2 { "Distances of equal error" }
        (reaches(&report.reaches))
        h2 { "Costs of a composite" }
        (costs(&report.costs))
        h2 { "FLIP over distance" }
        @for direction in Direction::ALL {
            div.plots { @for view in View::ALL { (plot(report, direction, view)) } }
        }
        h2 { "All points" }
        (points(report))
    };
    whole_page(title, &body)
}

fn reaches(reaches: &[Reach]) -> Markup {
    html! {
        p { "Where each way to read the cache is as wrong as the first one is at the distance that is named." }
        div.scroll { table {
            thead { tr { th { "Reference" } th { "View" } th { "Cache" } th.n { "FLIP" } th.n { "reached at, m" } } }
            tbody { @for reach in reaches { tr {
                td { (reach.direction.name()) ", as at " (reach.compared_at_m) " m" }
                td { (reach.view.name()) }
                td { (reach.variant.name()) }
                td.n { (short(reach.flip)) }
                td.n { @match reach.reached_m {
                    Some(reached_m) => (format!("{reached_m:.0}")),
                    None => { "not within " (reach.measured_m) }
                } }
            } } }
        } }
    }
}

fn costs(costs: &[VariantCost]) -> Markup {
    let first_ns = costs.first().and_then(|cost| cost.composite_ns);
    html! {
        p { "Means over the points at which variants are compared. Reads of texels, page tables and origins of rays; device time, the least of some." }
        div.scroll { table {
            thead { tr { th { "Cache" } th.n { "reads a pixel" } th.n { "device, ms" } th.n { "÷ the first" } } }
            tbody { @for cost in costs { tr {
                td { (cost.variant.name()) }
                td.n { (short(cost.reads_per_pixel)) }
                @match (cost.composite_ns, first_ns) {
                    (Some(ns), Some(first_ns)) => { td.n { (short(ns * 1e-6)) } td.n { (short(ns / first_ns)) } }
                    _ => { td.n { "–" } td.n { "–" } }
                }
            } } }
        } }
    }
}

fn plot(report: &DistanceReport, direction: Direction, view: View) -> Markup {
    // As many as there are colours; the tables have all.
    let curves: Vec<Curve> = Variant::COMPARED
        .into_iter()
        .map(|variant| Curve {
            name: variant.name().into(),
            points: report.curve(view, direction, variant),
            has_dots: true,
        })
        .filter(|curve| !curve.points.is_empty())
        .collect();
    let plot = LinePlot {
        x_desc: "m between reference and eye",
        y_desc: "mean FLIP",
        curves: &curves,
    };
    plot.figure(&format!("{}, {}", direction.name(), view.name()))
}

fn points(report: &DistanceReport) -> Markup {
    html! {
        div.scroll { table {
            thead { tr { th { "View" } th { "Reference" } th { "Cache" } th.n { "m" } th.n { "FLIP" } th.n { "SSIM" } } }
            tbody { @for point in &report.points { tr {
                td { (point.view.name()) }
                td { (point.direction.name()) }
                td { (point.variant.name()) }
                td.n { (point.distance_m) }
                td.n { (format!("{:.4}", point.errors.flip)) }
                td.n { (format!("{:.4}", point.errors.ssim)) }
            } } }
        } }
    }
}

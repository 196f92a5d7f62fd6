//! The report as one page that needs no other file.

use super::ScalingReport;
use super::crowds::{CrowdOutcome, CrowdSecond, FLIP_S, Spread};
use super::views::RingOutcome;
use crate::measure::report::{Curve, LinePlot, short, whole_page};
use maud::{Markup, html};

/// The page.
pub(super) fn page(report: &ScalingReport) -> String {
    let title = "Skycell: what many viewers cost";
    let body = html! {
        h1 { (title) }
        @if !report.crowds.is_empty() { (crowds(report)) }
        @if !report.rings.is_empty() { (rings(report)) }
    };
    whole_page(title, &body)
}

fn crowds(report: &ScalingReport) -> Markup {
    let size = report.size;
    let look_s = f64::from(report.ticks_per_look) / f64::from(report.ticks_per_s);
    html! {
        h2 { "Crowds" }
        p {
            "Cameras alone, no device. Cells are decided on " (report.ticks_per_s) " times in a simulated second and are no wider \
             than " (short(report.limit_m / 1e3)) " km sideways. The caches' own bookkeeping is driven every " (look_s) " s for every viewer ("
            (size.width()) " × " (size.height()) ", mip bias " (report.crowd_mip_bias) ", " (report.samples)
            " samples a texel, at most " (short(report.tiles_per_s)) " tiles a second): it tells the texels that would be \
             marched. The error is that of the measured curve at each viewer's distance from its reference."
        }
        (cells(&report.crowds))
        (texels(&report.crowds))
        @for crowd in &report.crowds { (course(crowd)) }
    }
}

fn cells(crowds: &[CrowdOutcome]) -> Markup {
    html! {
        h3 { "Cells" }
        div.scroll { table {
            thead { tr {
                th { "Crowd" } th.n { "Cells: least" } th.n { "median" } th.n { "most" }
                th.n { "Changes a viewer and minute" } th.n { "Back within " (FLIP_S) " s" }
                th.n { "Widest, of the limit" } th.n { "Distance, of the limit: median" } th.n { "p95" }
                th.n { "Decision, µs of the processor: median" } th.n { "p95" } th.n { "most" } th.n { "above 1 ms" }
                th.n { "All come at once, µs" }
            } }
            tbody { @for crowd in crowds {
                @let Spread { min, median, max, .. } = crowd.cells;
                tr {
                    th { (name(crowd)) }
                    td.n { (min) } td.n { (median) } td.n { (max) }
                    td.n { (format!("{:.3}", crowd.changes_per_viewer_minute)) } td.n { (crowd.flips) }
                    td.n { (format!("{:.3}", crowd.widest_share)) }
                    td.n { (format!("{:.2}", crowd.distance_share.median)) }
                    td.n { (format!("{:.2}", crowd.distance_share.p95)) }
                    td.n { (short(crowd.decision_us.median)) } td.n { (short(crowd.decision_us.p95)) }
                    td.n { (short(crowd.decision_us.max)) }
                    td.n { (format!("{:.2} %", crowd.slow_decisions_share * 100.0)) }
                    td.n { (short(crowd.joined_us)) }
                }
            } }
        } }
    }
}

fn texels(crowds: &[CrowdOutcome]) -> Markup {
    let percent = |share: f64| format!("{:.1} %", share * 100.0);
    html! {
        h3 { "Texels and error" }
        p { "Rays: what a screen-space renderer marches for each viewer, once per pixel and tick, for each texel that is marched \
             here. Viewers in a layer have rays of their own for its near part, which are not counted." }
        div.scroll { table {
            thead { tr {
                th { "Crowd" } th.n { "Texels a viewer and second" } th.n { "Rays for each" } th.n { "Requests shared" }
                th.n { "Time with a cache" } th.n { "In a layer" } th.n { "Budget spent" } th.n { "New anchors" } th.n { "Most memory, MB" }
                th.n { "FLIP by distance: median" } th.n { "p95" } th.n { "most" }
            } }
            tbody { @for crowd in crowds {
                @let texels = crowd.texels;
                tr {
                    th { (name(crowd)) }
                    td.n { (short(texels.per_viewer_second)) } td.n { (short(texels.screen_space_rays_per_texel)) }
                    td.n { (percent(texels.shared)) } td.n { (percent(texels.readers_share)) } td.n { (percent(texels.within_share)) } td.n { (percent(texels.short_share)) }
                    td.n { (texels.new_anchors) } td.n { (short(texels.bytes_most as f64 / 1e6)) }
                    td.n { (short(crowd.error.median)) } td.n { (short(crowd.error.p95)) } td.n { (short(crowd.error.max)) }
                }
            } }
        } }
    }
}

fn name(crowd: &CrowdOutcome) -> String {
    format!("{} who {}", crowd.viewers, crowd.motion)
}

/// How a crowd's figures went over time.
fn course(crowd: &CrowdOutcome) -> Markup {
    let curve = |name: &str, of: &dyn Fn(&CrowdSecond) -> f64| Curve {
        name: name.into(),
        points: crowd.seconds.iter().map(|s| (s.time_s, of(s))).collect(),
        has_dots: false,
    };
    let readers = crowd.viewers as f64;
    let plots = [
        (
            "cells",
            vec![curve("cells with members", &|s| s.cells as f64)],
        ),
        (
            "texels a viewer and second",
            vec![curve("texels marched, of all viewers", &|s| {
                s.texels as f64 / readers
            })],
        ),
        (
            "FLIP by distance",
            vec![
                curve("median over viewers", &|s| s.error_median),
                curve("95th percentile", &|s| s.error_p95),
            ],
        ),
    ];
    html! {
        h3 { (name(crowd)) }
        div.plots { @for (y_desc, curves) in &plots {
            (LinePlot { x_desc: "s", y_desc, curves }.figure(""))
        } }
    }
}

fn rings(report: &ScalingReport) -> Markup {
    let mut biases: Vec<f32> = report
        .rings
        .iter()
        .map(|ring| ring.setup.mip_bias)
        .collect();
    biases.sort_by(f32::total_cmp);
    biases.dedup();
    html! {
        h2 { "Viewers at one place" }
        p {
            "Rendered by " (report.adapter.as_deref().unwrap_or("nobody")) ", pictures of " (report.size.width()) " × "
            (report.size.height()) ", " (report.samples) " samples. Viewers are turned from each other so that neighbours share \
             the named part of their field of view, which is 360° over their number and at most 90°. Caches are empty at first \
             and marched until nothing is left; then each viewer gets a picture. Rays are those of a screen-space renderer for \
             the same pictures and samples."
        }
        div.plots { @for bias in &biases { (ring_plot(report, *bias)) } }
        (ring_table(&report.rings))
    }
}

/// Texels over overlap, a curve for each number of viewers.
fn ring_plot(report: &ScalingReport, bias: f32) -> Markup {
    let rings = || {
        report
            .rings
            .iter()
            .filter(|ring| ring.setup.mip_bias == bias)
    };
    let mut numbers: Vec<u32> = rings().map(|ring| ring.setup.viewers).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let curves: Vec<Curve> = numbers
        .into_iter()
        .map(|viewers| Curve {
            name: format!("{viewers} viewers"),
            points: rings()
                .filter(|ring| ring.setup.viewers == viewers)
                .map(|ring| (ring.setup.overlap * 100.0, ring.figures.marches as f64))
                .collect(),
            has_dots: true,
        })
        .filter(|curve| curve.points.len() > 1)
        .collect();
    let plot = LinePlot {
        x_desc: "overlap, %",
        y_desc: "texels marched",
        curves: &curves,
    };
    plot.figure(&format!("Mip bias {bias}"))
}

fn ring_table(rings: &[RingOutcome]) -> Markup {
    let ms = |ns: Option<u64>| ns.map_or_else(|| "–".into(), |ns| short(ns as f64 / 1e6));
    html! {
        div.scroll { table {
            thead { tr {
                th.n { "Mip bias" } th.n { "Viewers" } th.n { "Overlap" } th.n { "measured" } th.n { "Texels requested" }
                th.n { "unique" } th.n { "marched, all samples" } th.n { "for each ray" } th.n { "March, device ms" }
                th.n { "clock ms" } th.n { "A picture, device ms" } th.n { "clock ms" } th.n { "Memory, MB" }
            } }
            tbody { @for ring in rings {
                @let RingOutcome { setup, figures, .. } = ring;
                @let viewers = f64::from(setup.viewers);
                tr {
                    td.n { (setup.mip_bias) } td.n { (setup.viewers) }
                    td.n { (format!("{:.0} %", setup.overlap * 100.0)) } td.n { (format!("{:.0} %", figures.measured_overlap * 100.0)) }
                    td.n { (short(figures.texels_requested as f64)) } td.n { (short(figures.texels_unique as f64)) }
                    td.n { (short(figures.marches as f64)) } td.n { (short(ring.marches_per_ray)) }
                    td.n { (ms(figures.march_ns)) } td.n { (short(figures.march_wall_s * 1e3)) }
                    td.n { (ms(figures.composite_ns.map(|ns| ns / u64::from(setup.viewers)))) }
                    td.n { (short(figures.composite_wall_s * 1e3 / viewers)) }
                    td.n { (short(figures.cache_bytes as f64 / 1e6)) }
                }
            } }
        } }
    }
}

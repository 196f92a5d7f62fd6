//! Plots as SVG that stands inside the page. Black stands for the page's ink: its style sheet recolours it.

use super::super::plan::Axis;
use super::data::{Report, ReportPoint};
use plotters::coord::Shift;
use plotters::prelude::*;
use skycell_protocol::RendererKind;

/// Screen-space points.
pub(super) const SCREEN_SPACE: RGBColor = RGBColor(59, 130, 246);
/// Cached points.
pub(super) const CACHED: RGBColor = RGBColor(234, 115, 23);
/// What nothing beats.
pub(super) const FRONT: RGBColor = RGBColor(22, 163, 74);
/// FLIP against the axis's own best.
pub(super) const OF_AXIS: RGBColor = RGBColor(168, 85, 247);

pub(super) const GRID: RGBColor = RGBColor(128, 128, 128);
pub(super) const FONT: &str = "sans-serif";
pub(super) const FONT_PX: i32 = 13;

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Drawn = Result<(), Box<dyn std::error::Error>>;

pub(super) fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> Option<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        draw(&area).ok()?;
        area.present().ok()?;
    }
    Some(text)
}

fn colour_of(point: &ReportPoint) -> RGBColor {
    match point.settings.renderer {
        RendererKind::ScreenSpace => SCREEN_SPACE,
        RendererKind::Cached => CACHED,
    }
}

/// A number in three digits, with k and M.
pub(crate) fn short(value: f64) -> String {
    let rounded = |v: f64, unit: &str| {
        let digits = if v >= 99.95 {
            0
        } else if v >= 9.995 {
            1
        } else {
            2
        };
        let text = format!("{v:.digits$}");
        let text = if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.')
        } else {
            &text
        };
        format!("{text}{unit}")
    };
    match value.abs() {
        0.0 => "0".into(),
        v if v >= 0.9995e9 => rounded(value / 1e9, "G"),
        v if v >= 0.9995e6 => rounded(value / 1e6, "M"),
        v if v >= 999.5 => rounded(value / 1e3, "k"),
        v if v >= 0.995 => rounded(value, ""),
        v if v >= 1e-4 => {
            let digits = (2.0 - v.log10().floor()).clamp(0.0, 6.0) as usize - 1;
            let text = format!("{value:.digits$}");
            text.trim_start_matches('0').to_owned()
        }
        _ => format!("{value:.1e}"),
    }
}

/// 1, 2 and 5 times powers of ten would crowd a short range less than plotters' own choice, which may also be none: so a
/// range is widened to whole decades.
fn decades(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (least, most) = values.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(v), b.max(v)));
    let (least, most) = if least.is_finite() && least > 0.0 {
        (least, most)
    } else {
        (0.1, 1.0)
    };
    let low = 10f64.powf((least * 0.8).log10().floor());
    let high = 10f64.powf((most * 1.25).log10().ceil());
    low..high
}

/// FLIP over cost of all points, with the front and the presets.
pub(super) fn front_plot(report: &Report) -> Option<String> {
    let shown = |p: &&ReportPoint| {
        p.settings.codec.is_none()
            && p.frame_cost.is_some_and(|c| c > 0.0)
            && p.measurement.shown.flip > 0.0
    };
    let place = |p: &ReportPoint| (p.frame_cost.unwrap_or(1.0), p.measurement.shown.flip);
    let points: Vec<&ReportPoint> = report.points.iter().filter(shown).collect();
    let line = |indices: &[usize]| -> Vec<(f64, f64)> {
        indices
            .iter()
            .map(|i| &report.points[*i])
            .filter(shown)
            .map(place)
            .collect()
    };
    svg((760, 440), |area| {
        let x = decades(points.iter().map(|p| place(p).0));
        let y = decades(points.iter().map(|p| place(p).1));
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .margin_right(24)
            .x_label_area_size(46)
            .y_label_area_size(58)
            .build_cartesian_2d(x.log_scale(), y.log_scale())?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID.mix(0.25))
            .axis_style(BLACK)
            .label_style((FONT, FONT_PX))
            .x_desc(report.cost_unit.label())
            .y_desc("mean FLIP")
            .x_label_formatter(&|v| short(*v))
            .y_label_formatter(&|v| short(*v))
            .draw()?;
        chart.draw_series(LineSeries::new(
            line(&report.quality_front),
            CACHED.mix(0.7).stroke_width(1),
        ))?;
        chart.draw_series(LineSeries::new(line(&report.front), FRONT.stroke_width(2)))?;
        chart.draw_series(
            points
                .iter()
                .map(|p| Circle::new(place(p), 4, colour_of(p).mix(0.75).filled())),
        )?;
        chart.draw_series(
            points
                .iter()
                .filter(|p| p.on_front)
                .map(|p| Circle::new(place(p), 7, FRONT.stroke_width(2))),
        )?;
        // One label for all presets of a point, alternately above and below, so that neighbours do not meet.
        let mut labels: Vec<(usize, String)> = Vec::new();
        for choice in &report.presets {
            match (choice.point, labels.last_mut()) {
                (Some(point), Some((last, text))) if *last == point => {
                    *text = format!("{text}, {}", choice.preset.name());
                }
                (Some(point), _) => labels.push((point, choice.preset.name().to_owned())),
                (None, _) => {}
            }
        }
        for (n, (index, text)) in labels.into_iter().enumerate() {
            let (x, y) = chart.backend_coord(&place(&report.points[index]));
            let y = if n % 2 == 0 { y - 22 } else { y + 12 };
            let x = x.min(760 - 9 * text.len() as i32);
            area.draw(&Text::new(text, (x + 4, y), (FONT, FONT_PX)))?;
        }
        Ok(())
    })
}

/// FLIP and cost along an axis, its points evenly spread.
pub(super) fn axis_plot(report: &Report, axis: Axis) -> Option<String> {
    let points: Vec<&ReportPoint> = report.points_of(axis).map(|(_, p)| p).collect();
    if points.len() < 2 {
        return None;
    }
    let labels: Vec<String> = points
        .iter()
        .map(|p| p.label.trim_start_matches("JPEG ").to_owned())
        .collect();
    let costs: Vec<f64> = points.iter().map(|p| shown_cost(axis, p)).collect();
    let flips: Vec<f64> = points.iter().map(|p| p.measurement.shown.flip).collect();
    let of_axis: Vec<(i32, f64)> = (0..)
        .zip(&points)
        .filter_map(|(i, p)| Some((i, p.flip_of_axis?)))
        .collect();
    let cost_label = if axis == Axis::Codec {
        "kB a picture"
    } else {
        report.cost_unit.label()
    };
    svg((380, 380), |area| {
        let (upper, lower) = area.split_vertically(210);
        let curves = [(flips, colour_of(points[0]))];
        let panel = Panel {
            labels: &labels,
            x_desc: None,
            y_desc: "mean FLIP",
        };
        panel.draw(&upper, &curves, &of_axis)?;
        let panel = Panel {
            labels: &labels,
            x_desc: Some(axis.quantity()),
            y_desc: cost_label,
        };
        panel.draw(&lower, &[(costs, GRID)], &[])
    })
}

/// What the lower panel of an axis shows.
pub(super) fn shown_cost(axis: Axis, point: &ReportPoint) -> f64 {
    if axis == Axis::Codec {
        point.measurement.cost.encoded_bytes.unwrap_or_default() as f64 / 1e3
    } else {
        point.frame_cost.unwrap_or_default()
    }
}

struct Panel<'a> {
    labels: &'a [String],
    x_desc: Option<&'a str>,
    y_desc: &'a str,
}

impl Panel<'_> {
    fn draw(
        &self,
        area: &Area<'_>,
        curves: &[(Vec<f64>, RGBColor)],
        of_axis: &[(i32, f64)],
    ) -> Drawn {
        let values = curves.iter().flat_map(|(values, _)| values.iter().copied());
        let most = values
            .chain(of_axis.iter().map(|(_, v)| *v))
            .fold(0.0, f64::max);
        let last = self.labels.len() as i32 - 1;
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(18)
            .x_label_area_size(if self.x_desc.is_some() { 40 } else { 22 })
            .y_label_area_size(58)
            .build_cartesian_2d(0..last.max(1), 0.0..(most * 1.1).max(1e-9))?;
        let name = |i: &i32| self.labels.get(*i as usize).cloned().unwrap_or_default();
        let value = |v: &f64| short(*v);
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(TRANSPARENT)
            .bold_line_style(GRID.mix(0.25))
            .axis_style(BLACK)
            .label_style((FONT, FONT_PX - 1))
            .x_labels(self.labels.len())
            .y_labels(5)
            .y_desc(self.y_desc)
            .x_label_formatter(&name)
            .y_label_formatter(&value);
        if let Some(desc) = self.x_desc {
            mesh.x_desc(desc);
        }
        mesh.draw()?;
        for (values, colour) in curves {
            let places = || (0..).zip(values.iter().copied());
            chart.draw_series(LineSeries::new(places(), colour.stroke_width(2)))?;
            chart.draw_series(places().map(|place| Circle::new(place, 3, colour.filled())))?;
        }
        let of_axis = || of_axis.iter().copied();
        chart.draw_series(DashedLineSeries::new(
            of_axis(),
            5,
            4,
            OF_AXIS.stroke_width(2),
        ))?;
        chart.draw_series(of_axis().map(|place| Circle::new(place, 3, OF_AXIS.filled())))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let shown = [
            0.0, 0.00456, 0.0456, 0.456, 1.0, 45.64, 1234.0, 2.5e6, 3e9, 1e-6,
        ]
        .map(short);
        assert_eq!(
            shown,
            [
                "0", ".0046", ".046", ".46", "1", "45.6", "1.23k", "2.5M", "3G", "1.0e-6"
            ]
        );
    }

    #[test]
    fn ranges_are_whole_decades_around_their_values() {
        let range = decades([0.02, 3.0].into_iter());
        assert!(
            (range.start - 0.01).abs() < 1e-12 && (range.end - 10.0).abs() < 1e-9,
            "{range:?}"
        );
    }
}

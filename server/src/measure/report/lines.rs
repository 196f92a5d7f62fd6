//! Curves over one quantity: figures of reports that are no sweep of settings.

use super::plots::{Area, CACHED, FONT, FONT_PX, FRONT, GRID, OF_AXIS, SCREEN_SPACE, short, svg};
use maud::{Markup, PreEscaped, html};
use plotters::prelude::*;

/// Colours of curves, in their order.
const COLOURS: [RGBColor; 6] = [
    SCREEN_SPACE,
    CACHED,
    OF_AXIS,
    FRONT,
    RGBColor(220, 38, 38),
    GRID,
];

/// One curve.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Curve {
    /// What the legend calls it.
    pub name: String,
    /// Its places, by rising x.
    pub points: Vec<(f64, f64)>,
    /// Each place is measured and gets a dot.
    pub has_dots: bool,
}

/// Curves with axes and a legend.
pub(crate) struct LinePlot<'a> {
    /// What stands below.
    pub x_desc: &'a str,
    /// What stands beside.
    pub y_desc: &'a str,
    /// What is drawn.
    pub curves: &'a [Curve],
}

impl LinePlot<'_> {
    /// As SVG, with its legend above and its title below; nothing where there is no point.
    pub(crate) fn figure(&self, title: &str) -> Markup {
        html! {
            @if let Some(plot) = self.svg() {
                figure {
                    (PreEscaped(plot))
                    figcaption {
                        (title) br;
                        @for (curve, RGBColor(r, g, b)) in self.curves.iter().zip(COLOURS.iter().cycle()) {
                            span.key { i style=(format!("background:rgb({r},{g},{b})")) {} (curve.name) }
                        }
                    }
                }
            }
        }
    }

    fn svg(&self) -> Option<String> {
        let places = || self.curves.iter().flat_map(|curve| &curve.points);
        let (least, most) = places().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), (x, _)| {
            (a.min(*x), b.max(*x))
        });
        let high = places().map(|(_, y)| *y).fold(0.0, f64::max);
        (least < most).then_some(())?;
        svg((420, 300), |area: &Area<'_>| {
            let mut chart = ChartBuilder::on(area)
                .margin(8)
                .margin_right(18)
                .x_label_area_size(40)
                .y_label_area_size(58)
                .build_cartesian_2d(least..most, 0.0..(high * 1.1).max(1e-9))?;
            chart
                .configure_mesh()
                .light_line_style(TRANSPARENT)
                .bold_line_style(GRID.mix(0.25))
                .axis_style(BLACK)
                .label_style((FONT, FONT_PX - 1))
                .x_labels(6)
                .y_labels(5)
                .x_desc(self.x_desc)
                .y_desc(self.y_desc)
                .x_label_formatter(&|v| short(*v))
                .y_label_formatter(&|v| short(*v))
                .draw()?;
            for (curve, colour) in self.curves.iter().zip(COLOURS.iter().cycle()) {
                let places = || curve.points.iter().copied();
                chart.draw_series(LineSeries::new(places(), colour.stroke_width(2)))?;
                if curve.has_dots {
                    chart.draw_series(places().map(|at| Circle::new(at, 3, colour.filled())))?;
                }
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<(f64, f64)>) -> String {
        let curves = [Curve {
            name: "one <of> them".into(),
            points,
            has_dots: true,
        }];
        let plot = LinePlot {
            x_desc: "m",
            y_desc: "mean FLIP",
            curves: &curves,
        };
        plot.figure("figure").into_string()
    }

    #[test]
    fn a_figure_has_a_dot_for_every_point_and_a_legend() {
        let figure = plot(vec![(0.0, 0.1), (10.0, 0.2), (20.0, 0.4)]);
        assert_eq!(figure.matches("<circle").count(), 3, "{figure}");
        assert!(figure.contains("one &lt;of&gt; them") && figure.contains("mean FLIP"));
    }

    #[test]
    fn a_curve_without_extent_is_left_out() {
        assert_eq!(plot(vec![(1.0, 0.1)]), "");
        assert_eq!(plot(Vec::new()), "");
    }
}

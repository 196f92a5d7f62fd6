//! What was measured, as tables and as a page.

use super::setups::SETUPS;
use crate::measure::distance::plan::{Direction, View};
use crate::measure::distance::report::first_reached;
use crate::measure::metrics::ShownErrors;
use crate::measure::report::{Curve, LinePlot, whole_page};
use maud::{Markup, html};
use serde::Serialize;
use skycell_protocol::FrameSize;
use std::fmt::Write as _;

/// What one setup shows from one place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct ProxyPoint {
    /// What layers are kept on.
    pub(super) setup: &'static str,
    /// Whether viewers look for what texels show along their own rays.
    pub(super) searched: bool,
    /// Where it looks.
    pub(super) view: View,
    /// Which way the reference lies.
    pub(super) direction: Direction,
    /// How far the reference is from the eye, or where it comes from, m.
    pub(super) distance_m: f64,
    /// How far the picture is from one of the eye's own rays.
    #[serde(flatten)]
    pub(super) errors: ShownErrors,
    /// Samples of texels that were marched.
    pub(super) marches: u64,
    /// GPU memory of the tiles that are there, bytes.
    pub(super) bytes: u64,
    /// Device time of the picture from the cache, where it was taken and the device can tell.
    pub(super) composite_ns: Option<u64>,
}

/// All that is reported.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ProxiesReport {
    /// What rendered.
    pub(super) adapter: String,
    /// Of the pictures.
    pub(super) size: FrameSize,
    /// Steps through a layer's thickness.
    pub(super) steps: u32,
    /// Samples of a texel and of a pixel.
    pub(super) samples: u32,
    /// Every picture.
    pub(super) points: Vec<ProxyPoint>,
}

impl ProxiesReport {
    /// FLIP over distance, by rising distance.
    fn curve(
        &self,
        view: View,
        direction: Direction,
        setup: &str,
        searched: bool,
    ) -> Vec<(f64, f64)> {
        self.points
            .iter()
            .filter(|p| (p.view, p.direction) == (view, direction))
            .filter(|p| (p.setup, p.searched) == (setup, searched))
            .map(|p| (p.distance_m, p.errors.flip))
            .collect()
    }

    /// Setups and ways to read them, in the order of the points.
    fn rows(&self) -> Vec<(&'static str, bool)> {
        let mut rows = Vec::new();
        for point in &self.points {
            let row = (point.setup, point.searched);
            if !rows.contains(&row) {
                rows.push(row);
            }
        }
        rows
    }

    fn views(&self) -> impl Iterator<Item = View> {
        let is_there = |view: &View| self.points.iter().any(|p| p.view == *view);
        View::ALL.into_iter().filter(is_there)
    }

    /// Directions and distances, in the order of a table's columns. That without a distance is the first one's.
    fn places(&self) -> Vec<(Direction, f64)> {
        let mut places: Vec<(Direction, f64)> = Vec::new();
        for direction in Direction::ALL {
            for point in &self.points {
                let is_first = places.is_empty();
                let place = (direction, point.distance_m);
                let is_new = !places.contains(&place) && (is_first || place.1 > 0.0);
                if point.direction == direction && is_new {
                    places.push(place);
                }
            }
        }
        places
    }

    /// A row for each setup and way to read it: FLIP at each distance.
    fn errors(&self, view: View) -> Table {
        let places = self.places();
        let mut head = vec!["setup".to_owned(), "read".to_owned()];
        head.extend(places.iter().map(|(direction, distance_m)| {
            if *distance_m == 0.0 {
                "0".to_owned()
            } else {
                format!("{} {} km", direction.name(), distance_m / 1_000.0)
            }
        }));
        let of_row = |(setup, searched): &(&'static str, bool)| {
            let mut cells = vec![(*setup).to_owned(), read(*searched)];
            cells.extend(places.iter().map(|(direction, distance_m)| {
                let curve = self.curve(view, *direction, setup, *searched);
                let at = curve.into_iter().find(|(m, _)| m == distance_m);
                at.map_or_else(|| "–".to_owned(), |(_, flip)| format!("{flip:.4}"))
            }));
            cells
        };
        Table {
            head,
            rows: self.rows().iter().map(of_row).collect(),
        }
    }

    /// Where each is as wrong as the first one is, alone, at the distance that others are compared at, m, and what each takes.
    fn reaches(&self) -> Table {
        let mut head = vec!["setup".to_owned(), "read".to_owned()];
        let columns: Vec<(View, Direction)> = self
            .views()
            .flat_map(|view| Direction::ALL.map(|direction| (view, direction)))
            .collect();
        head.extend(columns.iter().map(|(view, direction)| {
            let at_m = direction.compared_at_m();
            format!("{} {at_m} m, {}", direction.name(), view.name())
        }));
        head.extend(["million rays", "MB", "composite, ms"].map(str::to_owned));
        let of_row = |(setup, searched): &(&'static str, bool)| {
            let mut cells = vec![(*setup).to_owned(), read(*searched)];
            cells.extend(columns.iter().map(|(view, direction)| {
                let plain = self.curve(*view, *direction, SETUPS[0].name, false);
                let flip = plain
                    .into_iter()
                    .find(|(m, _)| *m == direction.compared_at_m())
                    .map(|(_, flip)| flip);
                let curve = self.curve(*view, *direction, setup, *searched);
                match (flip, curve.last()) {
                    (Some(flip), Some((last_m, _))) => first_reached(&curve, flip)
                        .map_or_else(|| format!("over {last_m}"), |m| format!("{m:.0}")),
                    _ => "–".to_owned(),
                }
            }));
            let of_setup = |p: &&ProxyPoint| (p.setup, p.searched) == (*setup, *searched);
            let these = || self.points.iter().filter(of_setup);
            // At the eye, where all see the same; composites where a search is part of them.
            let first = these().find(|p| p.distance_m == 0.0);
            let least_ns = these().filter_map(|p| p.composite_ns).min();
            let or_none = |value: Option<String>| value.unwrap_or_else(|| "–".to_owned());
            cells.extend([
                or_none(first.map(|p| format!("{:.2}", p.marches as f64 / 1e6))),
                or_none(first.map(|p| format!("{:.1}", p.bytes as f64 / 1e6))),
                or_none(least_ns.map(|ns| format!("{:.1}", ns as f64 / 1e6))),
            ]);
            cells
        };
        Table {
            head,
            rows: self.rows().iter().map(of_row).collect(),
        }
    }

    fn tables(&self) -> Vec<(String, Table)> {
        let title = format!(
            "As wrong as {}, alone, at a distance: reached at, m",
            SETUPS[0].name
        );
        let mut tables = vec![(title, self.reaches())];
        tables.extend(
            self.views()
                .map(|view| (format!("FLIP, {}", view.name()), self.errors(view))),
        );
        tables
    }

    /// For people who read text.
    pub(super) fn markdown(&self) -> String {
        let mut text = String::new();
        for (title, table) in self.tables() {
            let _ = writeln!(text, "## {title}\n\n{}", table.markdown());
        }
        text
    }

    /// The same with plots, as one page that needs no other file.
    pub(super) fn page(&self) -> String {
        let title = "Skycell: what clouds are kept on";
        let body = html! {
            h1 { (title) }
            dl {
                dt { "Rendered by" } dd { (self.adapter) }
                dt { "Pictures" } dd {
                    (self.size.width()) " × " (self.size.height()) ", " (self.steps) " steps, " (self.samples) " samples"
                }
                dt { "Compared" } dd {
                    "A picture from a cache whose reference point lies so far from the eye, against the screen-space renderer from \
                     that eye with the same steps and samples: mean FLIP at 67 pixels a degree; 0 is equal. Domes that follow \
                     began at that distance and came to the eye with nothing marched."
                }
            }
            h2 { "FLIP over distance" }
            @for searched in [false, true] {
                h3 { (if searched { "Searched along the viewer's ray" } else { "Alone" }) }
                @for direction in Direction::ALL {
                    div.plots { @for view in self.views() { (self.plot(view, direction, searched)) } }
                }
            }
            @for (title, table) in self.tables() {
                h2 { (title) }
                (table.markup())
            }
        };
        whole_page(title, &body)
    }

    fn plot(&self, view: View, direction: Direction, searched: bool) -> Markup {
        let curves: Vec<Curve> = SETUPS
            .iter()
            .filter(|kept| kept.is_plotted)
            .map(|kept| Curve {
                name: kept.name.into(),
                points: self.curve(view, direction, kept.name, searched),
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
}

fn read(searched: bool) -> String {
    if searched { "searched" } else { "alone" }.to_owned()
}

/// Words and numbers in rows; the first two columns are words.
struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let mut text = line(&self.head);
        let _ = writeln!(text, "|{}", " --- |".repeat(self.head.len()));
        for row in &self.rows {
            text.push_str(&line(row));
        }
        text
    }

    fn markup(&self) -> Markup {
        html! {
            div.scroll { table {
                thead { tr { @for (index, cell) in self.head.iter().enumerate() {
                    @if index < 2 { th { (cell) } } @else { th.n { (cell) } }
                } } }
                tbody { @for row in &self.rows { tr { @for (index, cell) in row.iter().enumerate() {
                    @if index < 2 { td { (cell) } } @else { td.n { (cell) } }
                } } } }
            } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(setup: &'static str, searched: bool, distance_m: f64, flip: f64) -> ProxyPoint {
        ProxyPoint {
            setup,
            searched,
            view: View::TowardsSun,
            direction: Direction::Sideways,
            distance_m,
            errors: ShownErrors { flip, ssim: 0.9 },
            marches: 2_500_000,
            bytes: 13_000_000,
            composite_ns: Some(4_000_000),
        }
    }

    fn report() -> ProxiesReport {
        let plain = SETUPS[0].name;
        let points = vec![
            point(plain, false, 0.0, 0.01),
            point(plain, false, 1_000.0, 0.11),
            point(plain, false, 3_000.0, 0.21),
            point(plain, true, 0.0, 0.01),
            point(plain, true, 1_000.0, 0.06),
            point(plain, true, 3_000.0, 0.16),
            point("static dome", false, 0.0, 0.01),
            point("static dome", false, 1_000.0, 0.21),
            point("static dome", false, 3_000.0, 0.31),
            point("in-layer, 4 slabs", true, 0.0, 0.01),
            point("in-layer, 4 slabs", true, 1_000.0, 0.02),
            point("in-layer, 4 slabs", true, 3_000.0, 0.10),
        ];
        ProxiesReport {
            adapter: "a device".into(),
            size: FrameSize::new(160, 90).expect("a size"),
            steps: 64,
            samples: 4,
            points,
        }
    }

    #[test]
    fn the_table_says_where_each_is_as_wrong_as_plain_spheres_at_a_kilometre() {
        let table = report().reaches();
        let reached: Vec<&str> = table.rows.iter().map(|row| row[2].as_str()).collect();
        assert_eq!(reached, ["1000", "2000", "500", "over 3000"]);
        let costs = &table.rows[0][5..];
        assert_eq!(costs, ["2.50", "13.0", "4.0"]);
        assert!(table.rows.iter().all(|row| row.len() == table.head.len()));
    }

    #[test]
    fn the_page_has_every_figure_and_plots_of_both_ways_to_read() {
        let report = report();
        let page = report.page();
        assert_eq!(page.matches("<svg").count(), 2, "{page}");
        assert!(page.contains("sideways 3 km") && page.contains("0.3100"));
        let text = report.markdown();
        assert!(
            text.contains("| static dome | alone | 0.0100 | 0.2100 | 0.3100 |"),
            "{text}"
        );
    }
}

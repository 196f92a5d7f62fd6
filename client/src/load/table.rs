//! A load test's report for people.

use super::report::{LoadReport, OverlapReport};

/// What a column shows and how.
struct Column {
    title: [&'static str; 2],
    cell: fn(&OverlapReport) -> String,
}

const COLUMNS: &[Column] = &[
    Column {
        title: ["overlap", "%"],
        cell: |row| format!("{:.0}", row.nominal_overlap_percent),
    },
    Column {
        title: ["measured", "%"],
        cell: |row| format!("{:.1}", row.measured_overlap * 100.0),
    },
    Column {
        title: ["requested", "texels"],
        cell: |row| grouped(row.texels_requested),
    },
    Column {
        title: ["unique", "texels"],
        cell: |row| grouped(row.texels_unique),
    },
    Column {
        title: ["updated", "texels"],
        cell: |row| grouped(row.texels_updated),
    },
    Column {
        title: ["updated /", "ideal"],
        cell: |row| optional(row.ideal.updates_per_unique_sample, 3),
    },
    Column {
        title: ["cache", "GPU ms"],
        cell: |row| format!("{:.1}", row.gpu_cache_ms),
    },
    Column {
        title: ["ms ratio", "/ ideal"],
        cell: |row| optional(row.ideal.gpu_cache_excess, 2),
    },
    Column {
        title: ["composite", "GPU ms"],
        cell: |row| format!("{:.1}", row.gpu_composite_ms),
    },
    Column {
        title: ["screen-sp.", "GPU ms"],
        cell: |row| optional(row.screen_space.and_then(|figures| figures.gpu_ms_once), 1),
    },
    Column {
        title: ["cache", "MiB"],
        cell: |row| format!("{:.1}", row.cache_bytes as f64 / f64::from(1 << 20)),
    },
    Column {
        title: ["fps", "least"],
        cell: |row| optional(row.turning.as_ref().map(|turning| turning.fps_min), 1),
    },
    Column {
        title: ["fps", "median"],
        cell: |row| optional(row.turning.as_ref().map(|turning| turning.fps_median), 1),
    },
    Column {
        title: ["CPU ms", "/ frame"],
        cell: |row| {
            let turning = row.turning.as_ref();
            optional(turning.and_then(|t| t.server_cpu_ms_per_frame), 1)
        },
    },
    Column {
        title: ["age ms", "p50"],
        cell: |row| {
            optional(
                row.turning.as_ref().map(|turning| turning.frame_age_ms.p50),
                0,
            )
        },
    },
    Column {
        title: ["age ms", "p95"],
        cell: |row| {
            optional(
                row.turning.as_ref().map(|turning| turning.frame_age_ms.p95),
                0,
            )
        },
    },
    Column {
        title: ["motion-", "photon p50"],
        cell: |row| {
            let turning = row.turning.as_ref();
            optional(turning.map(|turning| turning.motion_to_photon_ms.p50), 0)
        },
    },
    Column {
        title: ["to-", "ms p95"],
        cell: |row| {
            let turning = row.turning.as_ref();
            optional(turning.map(|turning| turning.motion_to_photon_ms.p95), 0)
        },
    },
    Column {
        title: ["remarks", ""],
        cell: remarks,
    },
];

/// The report as a table with a line above that says what was measured.
pub fn table(report: &LoadReport) -> String {
    let mut rows: Vec<Vec<String>> = (0..2)
        .map(|line| {
            COLUMNS
                .iter()
                .map(|column| column.title[line].to_owned())
                .collect()
        })
        .collect();
    rows.extend(
        report
            .overlaps
            .iter()
            .map(|row| COLUMNS.iter().map(|column| (column.cell)(row)).collect()),
    );
    let widths: Vec<usize> = (0..COLUMNS.len())
        .map(|column| {
            rows.iter()
                .map(|row| row[column].chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let mut text = heading(report);
    for row in rows {
        let cells: Vec<String> = row
            .iter()
            .zip(&widths)
            .map(|(cell, width)| format!("{cell:>width$}"))
            .collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
    }
    text.push_str(&stages(report));
    text
}

/// Where the time goes, of each overlap in which viewers turned.
fn stages(report: &LoadReport) -> String {
    let mut text = String::new();
    for row in &report.overlaps {
        let Some(turning) = row.turning.as_ref().filter(|t| !t.stages.is_empty()) else {
            continue;
        };
        let told: Vec<String> = STAGES
            .iter()
            .filter_map(|stage| {
                let times = turning.stages.get(*stage)?;
                Some(format!("{stage} {:.1}/{:.1}", times.p50_ms, times.p95_ms))
            })
            .collect();
        let percent = row.nominal_overlap_percent;
        text.push_str(&format!(
            "\n{percent:.0} %, ms p50/p95: {}",
            told.join(", ")
        ));
    }
    if !text.is_empty() {
        text.push('\n');
    }
    text
}

/// Stages of a frame's way in their order, as `skycell_frame_stage_seconds` and reports name them.
pub const STAGES: [&str; 11] = [
    "input",
    "march_wait",
    "composite",
    "readback",
    "encode_wait",
    "encode",
    "to_socket",
    "network",
    "decode",
    "present",
    "motion_to_photon",
];

fn heading(report: &LoadReport) -> String {
    format!(
        "{} viewers of {}x{}{}, {:.2}° across, {:.0}° up, {} samples per texel{}, on {}\n\
         ideal: updated = unique × samples; ms ratio = cache ms against those of the smallest \
         overlap, ideal: as the unique texels\n\n",
        report.viewers,
        report.width,
        report.height,
        report.stereo.map_or(String::new(), |stereo| format!(
            " for each of two eyes {} m apart",
            stereo.eye_distance_m()
        )),
        report.horizontal_fov_deg,
        report.pitch_deg,
        report.samples_per_texel,
        if report.wind_off { ", no wind" } else { "" },
        if report.adapter.name.is_empty() {
            "an unnamed adapter"
        } else {
            &report.adapter.name
        },
    )
}

fn remarks(row: &OverlapReport) -> String {
    let mut remarks = Vec::new();
    if !row.converged {
        remarks.push("did not converge".to_owned());
    }
    if !row.cold_start {
        remarks.push(format!("began with {} tiles", row.tiles_at_start));
    }
    if row.cells != 1 {
        remarks.push(format!("in {} cells", row.cells));
    }
    remarks.join(", ")
}

fn optional(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
}

/// 1234567 as 1 234 567.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::report::tests::{overlap, report};
    use super::*;

    #[test]
    fn every_overlap_has_a_line_and_columns_stand_under_each_other() {
        let report = report(vec![
            overlap(0.0, 16_000, 128_000, 160.0),
            overlap(100.0, 1_000, 8_000, 10.0),
        ]);
        let text = table(&report);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3 + 2 + 2, "{text}");
        let end_of = |line: &str, word: &str| line.find(word).map(|start| start + word.len());
        assert_eq!(
            end_of(lines[3], "updated"),
            end_of(lines[5], "128 000"),
            "{text}"
        );
        assert_eq!(
            end_of(lines[3], "updated"),
            end_of(lines[6], "8 000"),
            "{text}"
        );
    }

    #[test]
    fn what_makes_a_figure_doubtful_is_said_beside_it() {
        let mut doubtful = overlap(0.0, 1, 8, 1.0);
        doubtful.converged = false;
        doubtful.cold_start = false;
        doubtful.tiles_at_start = 7;
        doubtful.cells = 2;
        let text = table(&report(vec![doubtful]));
        assert!(
            text.contains("did not converge, began with 7 tiles, in 2 cells"),
            "{text}"
        );
    }

    #[test]
    fn digits_are_grouped_by_three() {
        assert_eq!(
            [0, 999, 1_000, 1_234_567].map(grouped),
            ["0", "999", "1 000", "1 234 567"]
        );
    }
}

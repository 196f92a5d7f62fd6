//! Errors that viewers and scenes ask for: what audits find of a cell's texels is held against what is asked there, and decides how
//! finely is marched.

use super::auditing::AuditedTexel;
use super::interface::AskedBy;
use super::qualities::{Qualities, ViewerQuality, has_all_samples};
use super::renderer::SkyRenderer;
use crate::cache::LAG_RAD;
use crate::quality::{AuditedError, BEYOND_MAX, ErrorGovernor, QualitySettings};
use skycell_protocol::{CellId, QualityChoice, ViewerId};
use std::collections::BTreeMap;
use std::time::Instant;

/// Errors that are followed at a time: others get what the table picks for them.
const ERRORS_MAX: usize = 64;

/// A texel that is seen from elsewhere than the reference by this angle is old: half of what wind may make it.
const OLD_RAD: f64 = 0.5 * LAG_RAD;

/// How finely is marched for each error that somebody asks for.
#[derive(Debug, Default)]
pub(super) struct AskedErrors {
    /// By error, FLIP.
    governors: Vec<(f64, ErrorGovernor)>,
}

impl AskedErrors {
    fn of(&self, max_error: f64) -> Option<&ErrorGovernor> {
        let found = self.governors.iter().find(|(asked, _)| *asked == max_error);
        found.map(|(_, governor)| governor)
    }
}

impl Qualities {
    /// The error that somebody has asked for. Where nobody has, the default is what a software driver can afford, and no promise.
    pub(super) fn asked_error(&self, asked: QualityChoice, by: AskedBy) -> Option<f64> {
        match asked {
            QualityChoice::MaxError(_) if by == AskedBy::Server && !self.default_is_asked => None,
            QualityChoice::MaxError(flip) => Some(flip),
            QualityChoice::Preset(_) | QualityChoice::BudgetMs(_) => None,
        }
    }

    /// Settings of a point, with rays that are marched as finely as audits have shown to be needed.
    pub(super) fn settings_for(
        &self,
        asked: QualityChoice,
        by: AskedBy,
        point: usize,
    ) -> QualitySettings {
        let mut picked = self.overrides.over(self.table.point(point).settings);
        let error = self.asked_error(asked, by);
        // Texels are held against an error that is asked for, and not pixels.
        picked.samples_by_area &= error.is_none();
        let Some(governor) = error.and_then(|error| self.asked_errors.of(error)) else {
            return picked;
        };
        let finer = governor.marched();
        // Audits look at what is marched, and so much is changed: resolution and filter are of the picture that was asked for.
        let marched = self.overrides.over(QualitySettings {
            march_steps: finer.march_steps(&self.table),
            ..self.table.point(finer.point).settings
        });
        QualitySettings {
            samples_by_area: picked.samples_by_area,
            mip_bias: picked.mip_bias,
            frame_filter: picked.frame_filter,
            parallax_steps: picked.parallax_steps,
            ..marched
        }
    }

    /// Nothing that was audited speaks against an error that was asked for being kept.
    pub(super) fn is_error_kept(&self, asked: QualityChoice, by: AskedBy) -> bool {
        let error = self.asked_error(asked, by);
        let governor = error.and_then(|error| self.asked_errors.of(error));
        governor.is_none_or(|governor| governor.missed_share().is_none())
    }

    fn error_of(&self, quality: &ViewerQuality) -> Option<f64> {
        self.asked_error(quality.asked, quality.asked_by)
    }
}

impl SkyRenderer {
    /// The least error that viewers of each cell ask for.
    fn errors_of_cells(&self) -> BTreeMap<CellId, f64> {
        let mut errors: BTreeMap<CellId, f64> = BTreeMap::new();
        for viewer in self.viewers.values() {
            if let Some(error) = self.qualities.error_of(&viewer.quality) {
                let least = errors.entry(viewer.cell).or_insert(error);
                *least = least.min(error);
            }
        }
        errors
    }

    /// Holds what was audited against what is asked for in each cell.
    pub(super) fn note_audited(&mut self, texels: &[AuditedTexel], now: Instant) {
        if texels.is_empty() || !self.qualities.are_chosen {
            return;
        }
        let errors = self.errors_of_cells();
        for (error, governor) in &mut self.qualities.asked_errors.governors {
            let here = texels
                .iter()
                .filter(|texel| errors.get(&texel.sphere.cell) == Some(error));
            let found = here.map(|texel| AuditedError {
                is_beyond: texel.deviation_percent > 100.0 * *error,
                is_old: texel.off_rad > OLD_RAD,
            });
            governor.note(found, now);
        }
    }

    /// Lets it be marched more finely where audits find more than was asked for, as far as time suffices, and less finely where it
    /// is needed no more.
    pub(super) fn consider_errors(&mut self, now: Instant) {
        if !self.qualities.are_chosen {
            return;
        }
        let asked: Vec<(ViewerId, f64)> = self
            .viewers
            .iter()
            .filter_map(|(id, viewer)| Some((*id, self.qualities.error_of(&viewer.quality)?)))
            .collect();
        let pace = self.losses.pace();
        let Qualities {
            asked_errors: AskedErrors { governors },
            table,
            ..
        } = &mut self.qualities;
        governors.retain(|(error, _)| asked.iter().any(|(_, other)| other == error));
        for (_, error) in &asked {
            let is_known = governors.iter().any(|(known, _)| known == error);
            if !is_known && governors.len() < ERRORS_MAX {
                let least = table.pick_error_among(*error, has_all_samples).point;
                governors.push((*error, ErrorGovernor::new(least)));
            }
        }
        let mut changed = Vec::new();
        for (error, governor) in governors {
            if governor.consider(table, pace, now) {
                let marched = governor.marched();
                tracing::info!(
                    max_error = *error,
                    march_steps = marched.march_steps(table),
                    samples = table.point(marched.point).settings.samples,
                    wait_share = marched.wait_share,
                    ?pace,
                    "marched in another way for an error that was asked for"
                );
                changed.push(*error);
            }
        }
        if changed.is_empty() {
            return;
        }
        for (id, error) in asked {
            if changed.contains(&error) {
                self.refresh_quality(id);
            }
        }
        // What was audited was marched in another way than what is shown from now on.
        self.audit.restart();
    }

    /// After which share of the time that tiles otherwise wait a cell's are marched again, for the errors that its viewers ask for.
    pub(super) fn wait_share(&self, cell: CellId) -> f64 {
        let members = self.viewers.values().filter(|viewer| viewer.cell == cell);
        members
            .filter_map(|viewer| {
                let error = self.qualities.error_of(&viewer.quality)?;
                Some(self.qualities.asked_errors.of(error)?.marched().wait_share)
            })
            .fold(1.0, f64::min)
    }

    /// What a cell's viewers do not get of the error that they ask for, for people.
    pub(super) fn error_note(&self, cell: CellId) -> Option<String> {
        let error = *self.errors_of_cells().get(&cell)?;
        let share = self.qualities.asked_errors.of(error)?.missed_share()?;
        Some(format!(
            "the error that was asked for is not kept ({:.0} % of the audited texels deviate by more than {:.1} %, allowed: {:.0} %)",
            100.0 * share,
            100.0 * error,
            100.0 * BEYOND_MAX
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame_loop::driven::{Driven, camera, view};
    use crate::frame_loop::interface::ViewRequest;
    use serde_json::json;

    #[test]
    fn samples_go_by_area_where_that_is_configured_and_nobody_asks_for_an_error() {
        let calm = json!({"version": 1, "wind": {"speed_m_per_s": 0}});
        let updates = |by_area: bool, quality: Option<QualityChoice>| {
            let mut driven = Driven::configured(4, &calm, &[], |config| {
                config.mip_bias = Some(0.0);
                config.samples = Some(8);
                config.samples_by_area = Some(by_area);
            });
            let renderer = &mut driven.renderer;
            renderer.let_qualities_be_chosen().expect("pipelines");
            let request = ViewRequest {
                quality,
                ..view([320, 180], camera(0.0, 0.0))
            };
            renderer.join(ViewerId(1), request);
            driven.settle();
            driven.renderer.counters.tiles_updated
        };
        let error = Some(QualityChoice::MaxError(0.1));
        let each = updates(false, None);
        assert_eq!(updates(true, error), each);
        // Texels are half as wide as pixels: two of eight, and the coarse level.
        let by_area = updates(true, None);
        println!("{by_area} updates by area, {each} with all in each texel");
        assert!(by_area < each / 2 && by_area > each / 8, "{by_area} {each}");
    }
}

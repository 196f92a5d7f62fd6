//! Which quality each viewer, each cell and the scene have: what is asked for, what is picked, what it costs.

use super::asked_errors::AskedErrors;
use super::cells_on_device::ActiveCell;
use super::interface::{AskedBy, QualityStats, ViewRequest};
use super::renderer::SkyRenderer;
use super::viewers_on_device::ActiveViewer;
use crate::cache::TexelSamples;
use crate::cells::ErrorCurves;
use crate::config::RenderConfig;
use crate::gpu::TimedPass;
use crate::march::MarchSettings;
use crate::quality::{
    BudgetGovernor, FEW_TILES_MIP_BIAS, FrameCost, Pick, QualityOverrides, QualityPoint,
    QualitySettings, QualityTable,
};
use skycell_protocol::{CellId, QualityChoice, QualityPreset, RendererKind, ViewerId};
use std::time::{Duration, Instant};

/// How often measured costs are compared with budgets.
const BUDGET_INTERVAL: Duration = Duration::from_millis(500);
/// In how many seconds what a viewer sees is marched anew once, while it looks around or the wind blows: a turn of 10° a
/// second brings a new view in about as long. Spreads the march of a view over its frames.
const RENEWAL_S: f64 = 8.0;
/// Share of a new measurement in the mean.
const NEW_SHARE: f64 = 0.3;

/// Device times of a unit of work, smoothed.
#[derive(Debug, Default)]
struct UnitTime {
    seen: (u64, u64),
    ms: Option<f64>,
}

impl UnitTime {
    /// Takes sums of nanoseconds and units; true when units were added since.
    fn measure(&mut self, total: (u64, u64)) -> bool {
        let (ns, units) = (
            total.0.saturating_sub(self.seen.0),
            total.1.saturating_sub(self.seen.1),
        );
        self.seen = total;
        if units == 0 {
            return false;
        }
        let measured = ns as f64 * 1e-6 / units as f64;
        let ms = self.ms.get_or_insert(measured);
        *ms += NEW_SHARE * (measured - *ms);
        true
    }
}

/// What decides about qualities.
#[derive(Debug)]
pub(super) struct Qualities {
    pub(super) table: QualityTable,
    pub(super) overrides: QualityOverrides,
    default: QualityChoice,
    /// Somebody has chosen the default: it is not only what the adapter affords.
    pub(super) default_is_asked: bool,
    /// How finely is marched for errors that are asked for.
    pub(super) asked_errors: AskedErrors,
    /// How the error of a shared cache grows with the distance, by how it is read.
    curves: ErrorCurves,
    /// Viewers and scenes may choose; single pictures have their own settings.
    pub(super) are_chosen: bool,
    composite: UnitTime,
    tile: UnitTime,
    due: Instant,
}

/// Mean FLIP that a software driver aims at where nobody says anything: what two cores can march for a few viewers.
const SOFTWARE_MAX_ERROR: f64 = 0.03;

/// Most places of a search for what texels show, on a software driver: there each costs as much as reading the picture.
const SOFTWARE_PARALLAX_STEPS: u32 = 4;

/// The quality of one viewer.
#[derive(Clone, Debug)]
pub(super) struct ViewerQuality {
    pub(super) asked: QualityChoice,
    pub(super) asked_by: AskedBy,
    pick: Pick,
    governor: Option<BudgetGovernor>,
    /// The point's, with what the configuration fixes.
    pub(super) settings: QualitySettings,
    device_ms: Option<f64>,
}

/// Texels have all samples: it is they that audits hold against an error that somebody asks for.
pub(super) fn has_all_samples(point: &QualityPoint) -> bool {
    !point.settings.samples_by_area
}

/// Samples go by area, where nobody was promised anything, and there are few tiles: many cost a software driver more than fewer
/// samples save.
fn is_cheap_to_show(point: &QualityPoint) -> bool {
    point.settings.samples_by_area && point.settings.mip_bias >= FEW_TILES_MIP_BIAS
}

/// A point's settings but for those that tell nothing where points are measured, at the reference.
fn from_the_reference(point: QualitySettings, picked: &QualitySettings) -> QualitySettings {
    QualitySettings {
        parallax_steps: picked.parallax_steps,
        ..point
    }
}

impl Qualities {
    pub(super) fn new(config: &RenderConfig, is_software: bool) -> Self {
        let default = if is_software {
            QualityChoice::MaxError(SOFTWARE_MAX_ERROR)
        } else {
            QualityChoice::Preset(QualityPreset::Balanced)
        };
        Self {
            table: QualityTable::embedded(),
            overrides: QualityOverrides {
                march_steps: config.march_steps,
                samples: config.samples,
                samples_by_area: config.samples_by_area,
                mip_bias: config.mip_bias.map(f64::from),
                frame_filter: config.frame_filter,
                parallax_steps: config
                    .parallax_steps
                    .or(is_software.then_some(SOFTWARE_PARALLAX_STEPS)),
            },
            default: config.quality.unwrap_or(default),
            default_is_asked: config.quality.is_some(),
            asked_errors: AskedErrors::default(),
            curves: ErrorCurves::embedded(),
            are_chosen: false,
            composite: UnitTime::default(),
            tile: UnitTime::default(),
            due: Instant::now(),
        }
    }

    /// The point to begin with, and the governor of a budget.
    fn pick(&self, choice: QualityChoice, by: AskedBy) -> (Pick, Option<BudgetGovernor>) {
        match choice {
            QualityChoice::Preset(preset) => (self.table.pick_preset(preset), None),
            QualityChoice::MaxError(flip) => {
                let pick = if self.asked_error(choice, by).is_some() {
                    self.table.pick_error_among(flip, has_all_samples)
                } else {
                    self.table.pick_error_among(flip, is_cheap_to_show)
                };
                (pick, None)
            }
            QualityChoice::BudgetMs(_) => {
                // Until it is measured, in the middle.
                let pick = Pick {
                    is_met: false,
                    ..self.table.pick_preset(QualityPreset::Balanced)
                };
                (pick, Some(BudgetGovernor::new(pick.point)))
            }
        }
    }

    fn settings(&self, pick: Pick) -> QualitySettings {
        self.overrides.over(self.table.point(pick.point).settings)
    }

    /// What viewers get when nobody asks for anything.
    pub(super) fn default_settings(&self) -> QualitySettings {
        self.settings(self.pick(self.default, AskedBy::Server).0)
    }

    fn stats(&self, quality: &ViewerQuality) -> QualityStats {
        let point = self.table.point(quality.pick.point);
        QualityStats {
            asked: Some(quality.asked),
            asked_by: quality.asked_by,
            picked: point.name(),
            flip: point.error.flip,
            // Of other settings than the point's it tells nothing.
            measured: point.measured
                && quality.settings == from_the_reference(point.settings, &quality.settings),
            settings: quality.settings,
            is_met: quality.pick.is_met && self.is_error_kept(quality.asked, quality.asked_by),
            device_ms_per_frame: quality.device_ms,
        }
    }
}

impl SkyRenderer {
    /// Lets viewers and scenes choose, and makes what the points of the table need.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub(super) fn let_qualities_be_chosen(&mut self) -> Result<(), crate::gpu::GpuError> {
        self.qualities.are_chosen = true;
        let (scene, revision) = (self.scene.clone(), self.scene_revision);
        self.set_scene(scene, revision)
    }

    /// Settings of marches that pipelines must be there for.
    pub(super) fn possible_settings(&self, scene_octaves: u32) -> Vec<MarchSettings> {
        let mut possible = vec![self.settings];
        if self.qualities.are_chosen {
            possible.extend(self.qualities.table.points().iter().map(|point| {
                let octaves = point.settings.octaves.map(|o| o.min(scene_octaves));
                MarchSettings {
                    octaves,
                    sun_depth: point.settings.sun_depth.or(self.settings.sun_depth),
                    ..self.settings
                }
            }));
        }
        possible
    }

    /// What single pictures are made with.
    fn own_settings(&self) -> QualitySettings {
        QualitySettings {
            march_steps: self.settings.steps,
            sun_steps: self.settings.sun_steps,
            sun_depth: self.settings.sun_depth,
            octaves: self.settings.octaves,
            samples: self.caches.samples().most,
            samples_by_area: self.caches.samples().by_area,
            mip_bias: self.mip_bias,
            frame_filter: self.frame_filter,
            parallax_steps: self.parallax_steps,
        }
    }

    /// The choice that holds where a viewer makes none.
    fn scene_choice(&self) -> (QualityChoice, AskedBy) {
        match self.scene.quality() {
            Some(choice) => (choice, AskedBy::Scene),
            None => (self.qualities.default, AskedBy::Server),
        }
    }

    fn within_scene(&self, settings: QualitySettings) -> QualitySettings {
        let most = self.scene.light().octaves();
        QualitySettings {
            octaves: settings.octaves.filter(|octaves| *octaves < most),
            ..settings
        }
    }

    /// The quality of a view. What is asked for as before keeps what a budget has found out.
    pub(super) fn quality_of(
        &self,
        view: &ViewRequest,
        old: Option<&ViewerQuality>,
    ) -> ViewerQuality {
        let (asked, asked_by) = match view.quality {
            Some(choice) => (choice, AskedBy::Viewer),
            None => self.scene_choice(),
        };
        let (pick, governor) = match old {
            Some(old) if (old.asked, old.asked_by) == (asked, asked_by) => {
                (old.pick, old.governor.clone())
            }
            _ => self.qualities.pick(asked, asked_by),
        };
        let settings = if self.qualities.are_chosen {
            self.within_scene(self.qualities.settings_for(asked, asked_by, pick.point))
        } else {
            self.own_settings()
        };
        ViewerQuality {
            asked,
            asked_by,
            pick,
            governor,
            settings,
            device_ms: old.and_then(|old| old.device_ms),
        }
    }

    /// Looks up what a viewer's quality is now; its requests are made anew where it has changed.
    pub(super) fn refresh_quality(&mut self, id: ViewerId) {
        let Some(viewer) = self.viewers.get(&id) else {
            return;
        };
        let quality = self.quality_of(&viewer.view, Some(&viewer.quality));
        if let Some(viewer) = self.viewers.get_mut(&id) {
            if viewer.quality.settings != quality.settings {
                viewer.forget_requests();
            }
            viewer.quality = quality;
        }
        self.change_requests_of(id);
    }

    /// Gives a cell the finest march that its viewers and the scene ask for. A finer one ages what was marched; what is
    /// finer than asked for stays, so that a pick that gives way under load does not add to it.
    pub(super) fn refresh_cell_settings(&mut self, id: CellId, cell: &mut ActiveCell) {
        let light = self.scene.light();
        let (sun_steps, octaves) = (light.sun_steps(), light.octaves());
        let wished = match self.scene.quality() {
            // A budget is a limit and no least quality.
            Some(QualityChoice::BudgetMs(_)) | None => None,
            Some(_) if !self.qualities.are_chosen => None,
            Some(choice) => {
                let point = self.qualities.pick(choice, AskedBy::Scene).0.point;
                let settings = self.qualities.settings_for(choice, AskedBy::Scene, point);
                Some(self.within_scene(settings))
            }
        };
        let members = self.viewers.values().filter(|viewer| viewer.cell == id);
        let finest = wished
            .into_iter()
            .chain(members.map(|viewer| viewer.quality.settings))
            .reduce(|a, b| a.finest_march(&b, sun_steps, octaves));
        let Some(finest) = finest else {
            return;
        };
        let settings = MarchSettings {
            steps: finest.march_steps,
            sun_steps: finest.sun_steps,
            sun_depth: finest.sun_depth,
            octaves: finest.octaves,
            ..self.settings
        };
        let before = cell.settings;
        let is_finer = settings.steps > before.steps
            || settings.sun_steps.unwrap_or(sun_steps) > before.sun_steps.unwrap_or(sun_steps)
            || settings.sun_depth != before.sun_depth
            || settings.octaves.unwrap_or(octaves) > before.octaves.unwrap_or(octaves);
        if is_finer {
            self.caches.age_cell(id);
        }
        cell.settings = settings;
        cell.samples = TexelSamples::new(finest.samples, finest.samples_by_area);
    }

    /// Gives those who ask for an error the limit that keeps it, by the measured curve. Where nobody asks, and for what a
    /// software driver can afford, it is the default.
    fn refresh_limit(&mut self) {
        let qualities = &self.qualities;
        if !qualities.are_chosen {
            return;
        }
        for (id, viewer) in &self.viewers {
            let steps = viewer.quality.settings.parallax_steps;
            let curve = qualities.curves.of(self.kept_on.slabs, steps);
            let quality = &viewer.quality;
            let error = qualities.asked_error(quality.asked, quality.asked_by);
            let limit = error.map(|flip| curve.limit(flip));
            self.cells.set_limit_of(*id, limit);
        }
    }

    /// Measures what frames cost, lets budgets pick and gives cells their limit, every half a second.
    pub(super) fn consider_budgets(&mut self, now: Instant) {
        if now < self.qualities.due {
            return;
        }
        self.qualities.due = now + BUDGET_INTERVAL;
        self.refresh_limit();
        self.consider_errors(now);
        let composites = self.gpu_time(TimedPass::Composite);
        let tiles = self.gpu_time(TimedPass::Cache);
        let are_fresh = self.qualities.composite.measure(composites);
        self.qualities.tile.measure(tiles);
        if !are_fresh {
            return;
        }
        let pixels: u64 = self
            .viewers
            .values()
            .map(|viewer| u64::from(viewer.view.picture_size().pixels()))
            .sum();
        let pixels_mean = pixels as f64 / self.viewers.len().max(1) as f64;
        let mut changed = Vec::new();
        let mut viewers = std::mem::take(&mut self.viewers);
        for (id, viewer) in &mut viewers {
            let Some(cost) = self.frame_cost(viewer, pixels_mean) else {
                continue;
            };
            let quality = &mut viewer.quality;
            quality.device_ms = Some(cost.total_ms());
            if let (Some(governor), QualityChoice::BudgetMs(budget_ms)) =
                (&mut quality.governor, quality.asked)
            {
                if governor.consider(&self.qualities.table, budget_ms, &cost, now) {
                    changed.push(*id);
                }
                quality.pick = Pick {
                    point: governor.point(),
                    is_met: governor.is_met(),
                };
            }
        }
        self.viewers = viewers;
        if changed.is_empty() {
            return;
        }
        for id in changed {
            self.refresh_quality(id);
        }
        // Another filter is another composite.
        self.prepare_views();
    }

    /// What a frame of a viewer costs by the device's own times: its composite, and the march of what it requests spread
    /// over [`RENEWAL_S`]. None while nothing was measured.
    fn frame_cost(&self, viewer: &ActiveViewer, pixels_mean: f64) -> Option<FrameCost> {
        if viewer.kind != RendererKind::Cached {
            return None;
        }
        let composite_ms = self.qualities.composite.ms?;
        let samples = self.active_cells.get(&viewer.cell)?.samples;
        let updates: u64 = (viewer.requests.iter().flatten())
            .map(|request| u64::from(samples.of_texel(request.texel_pixels)))
            .sum();
        let view_ms = updates as f64 * self.qualities.tile.ms.unwrap_or(0.0);
        Some(FrameCost {
            composite_ms: composite_ms * f64::from(viewer.view.picture_size().pixels())
                / pixels_mean,
            march_ms: view_ms / (viewer.view.fps * RENEWAL_S),
        })
    }

    /// How a cell's rays are marched.
    pub(super) fn cell_settings(&self, cell: CellId) -> MarchSettings {
        self.active_cells
            .get(&cell)
            .map_or(self.settings, |cell| cell.settings)
    }

    /// A viewer's quality for people.
    pub(super) fn viewer_quality_stats(&self, viewer: &ActiveViewer) -> QualityStats {
        self.qualities.stats(&viewer.quality)
    }

    /// The quality of viewers who ask for none. Under a budget each has its own; this is the one of the first.
    pub(super) fn scene_quality_stats(&self) -> QualityStats {
        let (asked, asked_by) = self.scene_choice();
        let follower = self
            .viewers
            .values()
            .find(|viewer| viewer.view.quality.is_none());
        match follower {
            Some(viewer) => self.qualities.stats(&viewer.quality),
            None => {
                let (pick, _) = self.qualities.pick(asked, asked_by);
                self.qualities.stats(&ViewerQuality {
                    asked,
                    asked_by,
                    pick,
                    governor: None,
                    settings: self.within_scene(self.qualities.settings(pick)),
                    device_ms: None,
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_asks_for_an_error_gets_the_cheapest_point_with_all_samples_and_defaults_go_by_area() {
        let config = RenderConfig::new("no-noise".into());
        for is_software in [false, true] {
            let qualities = Qualities::new(&config, is_software);
            let default = qualities.default_settings();
            assert!(default.samples_by_area, "{default:?}");
            assert!(!is_software || default.mip_bias >= 1.0, "{default:?}");
            for by in [AskedBy::Viewer, AskedBy::Scene] {
                for flip in [0.009, 0.02, 0.03, 0.1] {
                    let (pick, _) = qualities.pick(QualityChoice::MaxError(flip), by);
                    let picked = qualities.table.point(pick.point);
                    assert!(pick.is_met && picked.error.flip <= flip);
                    assert!(!picked.settings.samples_by_area, "{picked:?}");
                    let is_no_better = |p: &QualityPoint| {
                        p.settings.samples_by_area
                            || p.error.flip > flip
                            || p.cost.relative >= picked.cost.relative
                    };
                    assert!(qualities.table.points().iter().all(is_no_better));
                }
            }
        }
    }
}

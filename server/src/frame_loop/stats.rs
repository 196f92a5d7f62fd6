//! The frame loop's figures.

use super::interface::{CellStats, RenderStats, RenderTotals, ViewerRenderStats};
use super::renderer::SkyRenderer;
use crate::audit::AuditStats;
use crate::cache::{BYTES_PER_TEXEL, TEXELS_PER_TILE};
use crate::gpu::TimedPass;
use skycell_protocol::CellId;
use std::time::Instant;

/// How much of what is requested is requested in common: 0 when no texel is asked for twice, 1 when all viewers ask for
/// the same. With n viewers who request r texels in all, u of them distinct, (r − u) / (r − r/n).
#[must_use]
pub(super) fn overlap(viewers: usize, requested: u64, unique: u64) -> f64 {
    if viewers < 2 || requested == 0 {
        return 0.0;
    }
    let requested = requested as f64;
    let most = requested - requested / viewers as f64;
    ((requested - unique as f64) / most).clamp(0.0, 1.0)
}

pub(super) fn render_stats(renderer: &SkyRenderer, uptime_s: f64) -> RenderStats {
    let counters = &renderer.counters;
    RenderStats {
        adapter: renderer.gpu.adapter_stats(),
        tick: counters.ticks,
        scene_revision: renderer.scene_revision,
        uptime_s,
        sky_time: renderer.sky_time.stats(crate::clock::now()),
        totals: RenderTotals {
            ticks: counters.ticks,
            submissions: counters.submissions,
            dispatches: counters.dispatches,
            texels_updated: counters.tiles_updated * TEXELS_PER_TILE,
            tiles_updated: counters.tiles_updated,
            tiles_resampled: counters.tiles_resampled,
            tiles_evicted: renderer.caches.evicted(),
            texels_audited: counters.texels_audited,
            frames_composited: counters.frames_composited,
            first_frames_held: counters.first_frames_held,
            frames_held: counters.frames_held,
            frames_read_back: renderer.frames_read_back(),
            gpu_cache_ns: renderer.gpu_time(TimedPass::Cache).0,
            gpu_resample_ns: renderer.gpu_time(TimedPass::Resample).0,
            gpu_fade_ns: renderer.gpu_time(TimedPass::Fade).0,
            gpu_audit_ns: renderer.gpu_time(TimedPass::Audit).0,
            gpu_composite_ns: renderer.gpu_time(TimedPass::Composite).0,
            gpu_screen_space_ns: renderer.gpu_time(TimedPass::ScreenSpace).0,
            screen_space_marches: counters.screen_space_marches,
            cache_bytes: renderer.cache_bytes(),
            sun_volume_evaluations: renderer.sun.counters.evaluations,
            sun_volume_columns: renderer.sun.counters.columns,
            sun_volume_bytes: renderer.sun.bytes(),
            gpu_sun_volume_ns: renderer.gpu_time(TimedPass::SunVolume).0,
            light_shaft_evaluations: renderer.shafts.evaluations,
            light_shaft_tables: renderer.shafts.tables,
            light_shaft_bytes: renderer.shafts.bytes(),
            gpu_light_shaft_ns: renderer.gpu_time(TimedPass::LightShafts).0,
        },
        device: renderer.inventory(),
        audit: AuditStats {
            // Nobody is there to be shown anything wrong.
            rests: renderer.viewers.is_empty() || !renderer.audit.is_pending(),
            ..renderer.audit.stats(Instant::now())
        },
        quality: renderer.scene_quality_stats(),
        transitions: renderer.transition_stats(),
        losses: renderer.loss_stats(),
        device_loss: Default::default(),
        cells: renderer
            .cells
            .iter()
            .map(|(id, _)| cell_stats(renderer, id))
            .collect(),
        viewers: renderer
            .viewers
            .iter()
            .map(|(id, viewer)| ViewerRenderStats {
                id: *id,
                cell: viewer.cell,
                leaves: viewer
                    .transition
                    .as_ref()
                    .filter(|t| !t.shows_rays())
                    .map(|t| renderer.cell_shown_by(t.from)),
                position_m: viewer.view.camera.position_m(),
                yaw_deg: viewer.view.camera.yaw_deg(),
                texels_requested: viewer.texels_requested(),
                frames_composited: viewer.frames_composited,
                frames_in_flight: viewer.frames_in_flight(),
                renderer: viewer.kind,
                renderer_note: viewer.renderer_note(),
                show: viewer.view.show,
                show_note: renderer.shown_to(viewer).1,
                quality: renderer.viewer_quality_stats(viewer),
            })
            .collect(),
    }
}

fn cell_stats(renderer: &SkyRenderer, id: CellId) -> CellStats {
    let Some(cell) = renderer.cells.get(id) else {
        return CellStats::default();
    };
    let mut stats = CellStats {
        id,
        name: cell.name.clone(),
        reference_m: cell.reference_m.to_array(),
        radius_m: cell.radius_m,
        placed: cell.placed,
        viewers: cell.members.clone(),
        ..CellStats::default()
    };
    if let Some(active) = renderer.active_cells.get(&id) {
        stats.march_steps = active.settings.steps;
        stats.samples = renderer.losses.rate().samples(active.samples.most);
        (stats.tiles_wished, stats.levels_lost) = (active.wish.tiles(0), active.lost);
        stats.auto_exposure_ev = active.auto_exposure_ev();
    }
    if let Some((drift, _)) = renderer.cell_drift(id) {
        stats.anchor_drift_m = drift.to_array();
    }
    for (_, sphere) in renderer.caches.spheres_of(id) {
        let (requested, unique) = sphere.requested_and_unique();
        stats.texels_requested += requested * TEXELS_PER_TILE;
        stats.texels_unique += unique * TEXELS_PER_TILE;
        stats.texels_coarse += sphere.coarse_only() * TEXELS_PER_TILE;
        stats.texels_pending +=
            sphere.pending_samples(renderer.caches.samples_of(sphere)) * TEXELS_PER_TILE;
        stats.tiles_resident += sphere.resident() as u64;
    }
    stats.loss_note = renderer.loss_note(id);
    stats.bytes = stats.tiles_resident * TEXELS_PER_TILE * BYTES_PER_TEXEL;
    stats.overlap = overlap(
        cell.members.len(),
        stats.texels_requested,
        stats.texels_unique,
    );
    stats.converged = stats.texels_pending == 0 && renderer.awaited.is_none();
    stats
}

#[cfg(test)]
mod tests {
    use super::overlap;

    #[test]
    fn overlap_is_none_for_distinct_views_and_whole_for_equal_ones() {
        assert!(overlap(16, 1600, 1600).abs() < 1e-12);
        assert!((overlap(16, 1600, 100) - 1.0).abs() < 1e-12);
        assert!(overlap(1, 100, 100).abs() < 1e-12);
        // A ring of 16 viewers who share 40 % with each neighbour on one side needs 1 + 15 · 0.6 views.
        let unique = 1000 + 15 * 600;
        assert!((overlap(16, 16_000, unique) - 0.4).abs() < 1e-12);
    }
}

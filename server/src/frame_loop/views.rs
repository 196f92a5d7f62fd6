//! Pictures of one quantity instead of the sky: whether a view says anything of a viewer's frames, and its pipelines, which
//! are made beside the frames when somebody first asks for them.

use super::cells_on_device::parallax_steps;
use super::clouds::{self, of_format};
use super::renderer::{SkyRenderer, frame_key};
use super::viewers_on_device::ActiveViewer;
use crate::composite::{
    CompositeInputs, InspectionInputs, Inspections, Picture, PictureFormat, ground_key,
    inspect_key, shown_key, shown_of, with_above, with_inside, with_parallax,
};
use crate::gpu::PipelineKey;
use crate::march::layer_features;
use skycell_protocol::{Camera, CellId, RendererKind, Show, ViewerId};
use skycell_shaders::Shown;

/// Why a view of the cache shows the picture instead.
const NOT_CACHED: &str =
    "this viewer's frames are made by rays of its own, not from the cache; the picture is shown";
/// Why a view that was asked for is not there yet.
const BEING_MADE: &str = "the view is being made; the picture is shown until then";
/// Why nothing of the field is shown.
const NO_LAYERS: &str = "the scene has no layer that holds cloud";

impl SkyRenderer {
    /// The keys of a view: one composite and its ground rows, or one inspection per layer.
    pub(super) fn shown_keys(&self, shown: Shown, composite: PipelineKey) -> Vec<PipelineKey> {
        if shown.is_inspection() {
            self.active
                .iter()
                .map(|layer| {
                    let settings = &self.settings;
                    let features = layer_features(&self.scene, layer.scene_index, settings);
                    inspect_key(features, shown)
                })
                .collect()
        } else {
            let key = shown_key(composite, shown);
            vec![key, ground_key(key)]
        }
    }

    /// The composite of a viewer's frames by a renderer, at the reference.
    fn composite_by(&self, viewer: &ActiveViewer, renderer: RendererKind) -> PipelineKey {
        let key = frame_key(
            &self.gpu,
            &self.scene,
            viewer.quality.settings.frame_filter,
            self.blend(),
            renderer == RendererKind::ScreenSpace,
        );
        of_format(key, viewer.view.picture_format(), viewer.view.haze)
    }

    fn frame_keys(&self, viewer: &ActiveViewer, shown: Shown) -> Vec<PipelineKey> {
        let composite = self.composite_by(viewer, viewer.kind);
        let keys = self.keys_for(viewer, viewer.cell, composite);
        let of_eyes = keys.into_iter().flat_map(|key| self.shown_keys(shown, key));
        of_eyes.collect()
    }

    /// The keys of all that a viewer's frames come to need as it moves: away from its reference, and to where the cache does not
    /// reach.
    pub(super) fn possible_keys(&self, viewer: &ActiveViewer, shown: Shown) -> Vec<PipelineKey> {
        let mut composites = Vec::new();
        if viewer.view.renderer == RendererKind::Cached {
            let cached = self.composite_by(viewer, RendererKind::Cached);
            composites.extend([cached, with_parallax(cached)]);
            if self.looks_down(viewer.view.camera.position_m()[1]) {
                composites.extend([cached, with_parallax(cached)].map(with_above));
            }
            if self.marches_near(viewer) {
                composites.extend([cached, with_parallax(cached)].map(with_inside));
            }
        }
        if !shown.is_of_cache() {
            composites.push(self.composite_by(viewer, RendererKind::ScreenSpace));
        }
        composites
            .into_iter()
            .flat_map(|composite| self.shown_keys(shown, composite))
            .collect()
    }

    /// A composite's keys as a viewer's eyes need them.
    pub(super) fn keys_for(
        &self,
        viewer: &ActiveViewer,
        cell: CellId,
        composite: PipelineKey,
    ) -> Vec<PipelineKey> {
        let eyes = viewer.eyes_in(cell);
        eyes.iter()
            .map(|eye| self.key_for(viewer, eye, cell, composite))
            .collect()
    }

    /// A composite's key as an eye of a viewer needs it that reads the cache of a cell.
    fn key_for(
        &self,
        viewer: &ActiveViewer,
        eye: &Camera,
        cell: CellId,
        composite: PipelineKey,
    ) -> PipelineKey {
        let on_device = self.active_cells.get(&cell);
        let Some(on_device) = on_device.filter(|_| viewer.kind == RendererKind::Cached) else {
            return composite;
        };
        let domes = self.kept_on.has_domes();
        let (scene, active) = (&self.scene, &self.active);
        let steps = parallax_steps(scene, active, domes, viewer, eye, on_device);
        let composite = if steps > 0 {
            with_parallax(composite)
        } else {
            composite
        };
        if self.near_layers_of(on_device) != 0 {
            with_inside(composite)
        } else if self.looks_down(viewer.view.camera.position_m()[1]) {
            with_above(composite)
        } else {
            composite
        }
    }

    /// What a viewer's frames show: what it asks for, or the picture where that says nothing or is not there yet, and why.
    pub(super) fn shown_to(&self, viewer: &ActiveViewer) -> (Shown, Option<&'static str>) {
        let shown = shown_of(viewer.view.show);
        if viewer.view.picture_format() != PictureFormat::Display {
            let waits = self.waits_for_format(viewer);
            return (Shown::Picture, waits.then_some(clouds::BEING_MADE));
        }
        if shown == Shown::Picture {
            return (shown, None);
        }
        if shown.is_of_cache() && viewer.kind == RendererKind::ScreenSpace {
            return (Shown::Picture, Some(NOT_CACHED));
        }
        if shown.is_inspection() && self.active.is_empty() {
            return (Shown::Picture, Some(NO_LAYERS));
        }
        let keys = self.frame_keys(viewer, shown);
        if keys.iter().all(|key| self.pipelines.get(*key).is_some()) {
            (shown, None)
        } else {
            (Shown::Picture, Some(BEING_MADE))
        }
    }

    /// Has the pipelines of what viewers look at made on another thread; none is made in a frame.
    pub(super) fn prepare_views(&mut self) {
        let mut wanted = Vec::new();
        for viewer in self.viewers.values() {
            let shown = shown_of(viewer.view.show);
            if shown != Shown::Picture {
                wanted.extend(self.possible_keys(viewer, shown));
            }
            wanted.extend(self.own_format_keys(viewer));
        }
        if !wanted.is_empty() {
            self.pipelines.prepare_later(&self.gpu, wanted);
        }
    }

    /// Takes over what was made beside the frames; returns the viewers whose frames can now show what they ask for.
    pub(super) fn take_views(&mut self) -> Vec<ViewerId> {
        if !self.pipelines.take_finished() {
            return Vec::new();
        }
        self.viewers
            .iter()
            .filter(|(_, viewer)| {
                viewer.view.show != Show::Picture
                    || viewer.view.picture_format() != PictureFormat::Display
            })
            .map(|(id, _)| *id)
            .collect()
    }

    /// Whether somebody in a cell looks at the age of its texels.
    pub(super) fn ages_are_shown(&self, cell: skycell_protocol::CellId) -> bool {
        self.viewers
            .values()
            .any(|viewer| viewer.cell == cell && viewer.view.show == Show::CacheAge)
    }

    /// Records an inspection in the place of a composite.
    pub(super) fn record_inspection(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        picture: &Picture,
        eyes: &[CompositeInputs<'_>],
        field: &wgpu::BindGroup,
        shown: Shown,
    ) {
        // An inspection reads no cache: both eyes have the same.
        let keys = eyes
            .first()
            .map_or_else(Vec::new, |eye| self.shown_keys(shown, eye.key));
        let highest_top_m = self
            .active
            .iter()
            .map(|layer| self.scene.layers()[layer.scene_index].top_altitude_m())
            .fold(1.0, f64::max);
        let layers = self.active.len();
        let inspections = self.inspections.get_or_insert_with(|| {
            Inspections::new(&self.gpu, &self.pipelines, layers, highest_top_m)
        });
        picture.record_inspection(
            &self.gpu,
            encoder,
            &mut self.timing,
            &self.pipelines,
            eyes,
            &InspectionInputs {
                field,
                inspections,
                keys: &keys,
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::super::driven::{Driven, camera, view};
    use super::*;
    use crate::config::PlacedCell;
    use serde_json::json;
    use std::time::{Duration, Instant};

    const WALKER: ViewerId = ViewerId(1);

    #[test]
    fn who_walks_away_from_the_reference_goes_on_seeing_what_was_asked_for() {
        let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
            {"name": "low", "density": {"model": "homogeneous", "shape":
             {"form": "sphere", "center_m": [0, 2000, -3000], "radius_m": 900}}}]});
        let plaza = PlacedCell {
            name: "plaza".into(),
            center_m: [0.0, 2.0, 0.0],
            radius_m: 2_000.0,
        };
        let mut driven = Driven::new(16, &document, &[plaza]);
        let mut asked = view([64, 36], camera(0.0, 0.0));
        asked.show = Show::Transmittance;
        driven.renderer.join(WALKER, asked);
        driven.settle();
        let shown = |driven: &Driven| {
            driven
                .renderer
                .shown_to(&driven.renderer.viewers[&WALKER])
                .0
        };
        let begun = Instant::now();
        let is_made = |driven: &Driven| {
            let (renderer, viewer) = (&driven.renderer, &driven.renderer.viewers[&WALKER]);
            let keys = renderer.possible_keys(viewer, shown_of(viewer.view.show));
            keys.iter()
                .all(|key| renderer.pipelines.get(*key).is_some())
        };
        while !is_made(&driven) {
            driven.renderer.take_views();
            assert!(begun.elapsed() < Duration::from_secs(60), "never made");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_ne!(shown(&driven), Shown::Picture);
        driven.go(WALKER, 1_500.0);
        driven.settle();
        assert_ne!(
            shown(&driven),
            Shown::Picture,
            "{:?}",
            driven
                .renderer
                .shown_to(&driven.renderer.viewers[&WALKER])
                .1
        );
    }
}

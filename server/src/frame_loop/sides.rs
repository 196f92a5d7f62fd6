//! Viewers in, between and above layers: for whom the caches of a cell hold, and what their frames need beside those of
//! viewers below all clouds.

#[cfg(test)]
mod tests;

use super::cells_on_device::ActiveCell;
use super::clouds::of_format;
use super::interface::ViewRequest;
use super::renderer::{SkyRenderer, frame_key};
use super::viewers_on_device::ActiveViewer;
use crate::cells::Storeys;
use crate::composite::{PictureFormat, ground_key, with_above, with_inside, with_parallax};
use crate::config::FrameFilter;
use crate::gpu::PipelineKey;
use crate::march::{
    LayerBlend, REACH_FADE_M, REACH_M, Side, active_layers, layer_bounds_m, near_layers,
};
use glam::DVec3;
use skycell_protocol::{CellId, RendererKind, Scene};
use skycell_shaders::layout;
use std::time::{Duration, Instant};

/// From rays back to the cache, a camera goes this far out of a layer, m.
const RETURN_MARGIN_M: f64 = 50.0;
/// And no further than this share of the base's altitude, below it, or of the layer's thickness, above: fog lies low, and
/// sheets are thin.
const RETURN_SHARE: f64 = 0.1;

/// A viewer at a boundary of a layer reads the cache when it has been on its side for so long: who goes to and fro there keeps
/// rays of its own.
const SIDE_KEPT: Duration = Duration::from_secs(1);

/// In a layer the cache holds no farther from its reference than this share of where the far part begins.
const IN_LAYER_SHARE: f64 = 0.5;

impl SkyRenderer {
    /// On which side of each layer an altitude is.
    pub(super) fn sides_at(&self, altitude_m: f64) -> Vec<Side> {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        let sides = bounds_m.into_iter();
        sides.map(|between| Side::of(between, altitude_m)).collect()
    }

    /// Whether an altitude is in no layer; with a margin for a camera that comes out of one.
    fn is_between_layers(&self, altitude_m: f64, comes_out: bool) -> bool {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        bounds_m.into_iter().all(|[base_m, top_m]| {
            let margin = |of_m: f64| {
                if comes_out {
                    (RETURN_SHARE * of_m).min(RETURN_MARGIN_M)
                } else {
                    0.0
                }
            };
            altitude_m < base_m - margin(base_m) || altitude_m > top_m + margin(top_m - base_m)
        })
    }

    /// Whether the far part is kept of layers that rays start in. Where layers are on domes anyway, it is not.
    pub(super) fn keeps_far_parts(&self) -> bool {
        !self.kept_on.has_domes()
    }

    /// The layers of which a cell keeps the far part alone, since its rays start in them: one bit for each.
    pub(super) fn near_layers_of(&self, cell: &ActiveCell) -> u32 {
        let anchors: Vec<DVec3> = (0..self.active.len())
            .map(|layer| self.anchor_m(cell, layer))
            .collect();
        near_layers(&self.proxies, &self.active, &cell.frame, &anchors)
    }

    /// Tells a view of a cell's cache of which layers the near part is marched, and how far that reaches.
    pub(super) fn set_near(&self, view: &mut layout::View, cell: &ActiveCell) {
        view.near_layers = self.near_layers_of(cell);
        if view.near_layers != 0 {
            let starts = cell.frame.from_world(cell.reference_m);
            view.reach_from = starts.as_vec3().to_array();
            view.reach_m = REACH_M as f32;
            view.reach_fade_m = REACH_FADE_M as f32;
        }
    }

    /// Whether a viewer reads the cache of a cell in a layer, so that the near part of that is marched for it.
    pub(super) fn marches_near(&self, viewer: &ActiveViewer) -> bool {
        let cell = self.active_cells.get(&viewer.cell);
        viewer.kind == RendererKind::Cached
            && cell.is_some_and(|cell| self.near_layers_of(cell) != 0)
    }

    /// Whether rays of a viewer's own are part of its frames.
    pub(super) fn shows_pixels(&self, viewer: &ActiveViewer) -> bool {
        viewer.kind == RendererKind::ScreenSpace || self.marches_near(viewer)
    }

    /// Whether rays of a viewer's own are marched: for its frames, or for those of its way to another cell that are about to come.
    pub(super) fn marches_pixels(&self, viewer: &ActiveViewer) -> bool {
        self.shows_pixels(viewer) || viewer.marches_on_its_way()
    }

    /// The layers, among the active ones, that rays of a viewer's own go through.
    pub(super) fn layers_marched_for(&self, viewer: &ActiveViewer) -> Vec<u32> {
        let layers = 0..self.active.len() as u32;
        let cell = self.active_cells.get(&viewer.cell);
        match (viewer.kind, cell) {
            _ if viewer.marches_on_its_way() => layers.collect(),
            (RendererKind::Cached, Some(cell)) => {
                let near = self.near_layers_of(cell);
                layers.filter(|layer| (near >> layer) & 1 == 1).collect()
            }
            (RendererKind::Cached, None) => Vec::new(),
            (RendererKind::ScreenSpace, _) => layers.collect(),
        }
    }

    /// Whether a viewer who has come to a side of a layer at some time can be taken to stay there: it is well away from where that
    /// begins, or has been there for a while.
    pub(super) fn is_there_to_stay(
        &self,
        viewer: &ActiveViewer,
        since: Instant,
        now: Instant,
    ) -> bool {
        let altitude_m = viewer.view.camera.position_m()[1];
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        let is_away = bounds_m.into_iter().all(|[base_m, top_m]| {
            let margins_m =
                [base_m, top_m - base_m].map(|m| (RETURN_SHARE * m).min(RETURN_MARGIN_M));
            (altitude_m - base_m).abs() >= margins_m[0]
                && (altitude_m - top_m).abs() >= margins_m[1]
        });
        is_away || now.duration_since(since) >= SIDE_KEPT
    }

    /// The renderer for a view. The cache of a layer holds on the side of it on which its rays start: below, above or in it. Where
    /// its far part is not kept, a viewer in a layer gets rays of its own. `before`: the one that made its frames so far; from rays back to the cache it goes
    /// a little farther than the other way, so that a camera on the boundary does not change between them all the time.
    pub(super) fn kind_of(&self, view: &ViewRequest, before: Option<RendererKind>) -> RendererKind {
        let altitude_m = view.camera.position_m()[1];
        let comes_out = before == Some(RendererKind::ScreenSpace);
        if self.keeps_far_parts() || self.is_between_layers(altitude_m, comes_out) {
            view.renderer
        } else {
            RendererKind::ScreenSpace
        }
    }

    /// Whether the caches of a cell hold for an eye: it is on the side of each layer on which their rays start, and in a layer
    /// near there.
    pub(super) fn reaches(&self, cell: &ActiveCell, eye_m: [f64; 3]) -> bool {
        let eye_m = DVec3::from_array(eye_m);
        let sides = self.sides_at(eye_m.y);
        let is_held = !sides.contains(&Side::Within)
            || (self.keeps_far_parts()
                && eye_m.distance(cell.reference_m) <= IN_LAYER_SHARE * REACH_M);
        is_held && sides == self.sides_at(cell.reference_m.y)
    }

    /// The same of a cell by its number.
    pub(super) fn is_reached(&self, cell: CellId, eye_m: [f64; 3]) -> bool {
        let cell = self.active_cells.get(&cell);
        cell.is_some_and(|cell| self.reaches(cell, eye_m))
    }

    /// Whether some layer is below an altitude.
    pub(super) fn looks_down(&self, altitude_m: f64) -> bool {
        self.sides_at(altitude_m).contains(&Side::Above)
    }

    /// Whether a layer's anchor is on the side of the layer on which rays start. Where nothing is kept of a layer that they start
    /// in, any is.
    pub(super) fn is_anchored_aright(&self, cell: &ActiveCell, layer: usize) -> bool {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        bounds_m.get(layer).is_some_and(|between_m| {
            let reference = cell.frame.from_world(cell.reference_m);
            let [starts, stands] = [reference, self.anchor_m(cell, layer)]
                .map(|place| Side::of(*between_m, cell.frame.altitude_m(place)));
            starts == stands || (starts == Side::Within && !self.keeps_far_parts())
        })
    }

    /// Tells the cells where layers are: nobody on one side of a layer shares what is seen from another.
    pub(super) fn tell_storeys(&mut self) {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        self.cells.set_storeys(Storeys::of(&bounds_m));
    }

    /// What frames of a scene need that look down on a layer, or from within one.
    pub(super) fn side_keys(&self, scene: &Scene, sides: &[Side]) -> Vec<PipelineKey> {
        let blend = LayerBlend::of(scene, &active_layers(scene), &self.kept_on);
        let looks_down = sides.contains(&Side::Above);
        let is_in = sides.contains(&Side::Within) && self.keeps_far_parts();
        let of_filter = |filter| {
            let key = frame_key(&self.gpu, scene, filter, blend, false);
            let above = looks_down.then(|| with_above(key));
            let inside = is_in.then(|| with_inside(key));
            let mut keys = Vec::new();
            for key in above.into_iter().chain(inside) {
                keys.extend([key, with_parallax(key)]);
            }
            keys.extend(inside.map(ground_key));
            keys
        };
        FrameFilter::ALL.into_iter().flat_map(of_filter).collect()
    }

    /// The same as a view's frames need it.
    fn side_keys_of(&self, view: &ViewRequest, sides: &[Side]) -> Vec<PipelineKey> {
        let mut keys = self.side_keys(&self.scene, sides);
        let format = view.picture_format();
        if format != PictureFormat::Display {
            let own = |key: &PipelineKey| of_format(*key, format, view.haze);
            let own: Vec<PipelineKey> = keys.iter().map(own).collect();
            keys.extend(own);
        }
        keys
    }

    /// The sides of layers on which viewers are that read the cache, or are about to.
    pub(super) fn sides_of_viewers(&self) -> Vec<Side> {
        let cached = |viewer: &&ActiveViewer| viewer.view.renderer == RendererKind::Cached;
        let viewers = self.viewers.values().filter(cached);
        let mut sides: Vec<Side> = viewers
            .flat_map(|viewer| self.sides_about(viewer.view.camera.position_m()[1]))
            .collect();
        sides.dedup();
        sides
    }

    /// The sides of layers on which an altitude is; who is in a layer is about to be above it.
    fn sides_about(&self, altitude_m: f64) -> Vec<Side> {
        let mut sides = self.sides_at(altitude_m);
        if sides.contains(&Side::Within) {
            sides.push(Side::Above);
        }
        sides
    }

    /// Whether the pipelines of a view's frames are there. Those of viewers above or in a layer are made when the first comes
    /// there.
    pub(super) fn can_be_shown(&self, view: &ViewRequest) -> bool {
        let sides = self.sides_at(view.camera.position_m()[1]);
        let is_made = |key: PipelineKey| self.pipelines.get(key).is_some();
        self.side_keys_of(view, &sides).into_iter().all(is_made)
    }

    /// Has the pipelines of a view that looks down on a layer, or is in one, made beside the frames.
    pub(super) fn prepare_sides(&mut self, view: &ViewRequest) {
        if view.renderer == RendererKind::Cached {
            let sides = self.sides_about(view.camera.position_m()[1]);
            let keys = self.side_keys_of(view, &sides);
            self.pipelines.prepare_later(&self.gpu, keys);
        }
    }
}

//! What each of a viewer's eyes is composited from: the cache of a cell, or rays of its own. A viewer has one picture, made by
//! one pass, whether it has one eye or two.

#[cfg(test)]
mod tests;

use super::passes::ground_radius_m;
use super::renderer::SkyRenderer;
use super::screen_space::EyeJob;
use super::viewers_on_device::ActiveViewer;
use crate::cache::TileRequest;
use crate::composite::{CompositeInputs, Picture};
use crate::gpu::PipelineKey;
use skycell_protocol::{CellId, RendererKind};
use skycell_shaders::{Shown, layout};

/// A viewer's picture of a cell.
pub(super) struct EyesPicture<'a> {
    pub(super) viewer: &'a ActiveViewer,
    /// The cell whose cache is read, and what the viewer requests of it.
    pub(super) cell: CellId,
    pub(super) requests: &'a [Vec<TileRequest>],
    /// A composite for each eye.
    pub(super) keys: &'a [PipelineKey],
    /// What is shown, if that is no composite.
    pub(super) inspected: Option<Shown>,
}

/// What an eye's part of a picture is made of.
struct EyeSources {
    key: PipelineKey,
    view: layout::View,
    layers: wgpu::BindGroup,
    air: Option<wgpu::BindGroup>,
}

impl SkyRenderer {
    /// The views of a viewer's eyes, and what each reads its layers from.
    fn seen_by_eyes(
        &mut self,
        asked: &EyesPicture<'_>,
    ) -> Option<Vec<(layout::View, wgpu::BindGroup)>> {
        let viewer = asked.viewer;
        if viewer.kind == RendererKind::ScreenSpace {
            let read = |eye: &EyeJob| (eye.view(), eye.marched().read_group().clone());
            let eyes = viewer.screen_space.as_ref()?.eyes();
            return Some(eyes.iter().map(read).collect());
        }
        let views = self.views_in(viewer, asked.cell, asked.requests)?;
        let cell = self.active_cells.get_mut(&asked.cell)?;
        let (gpu, pipelines) = (&self.gpu, &self.pipelines);
        if views.iter().any(|view| view.near_layers != 0) {
            let job = viewer.screen_space.as_ref()?;
            job.shown_from()?;
            let read = |(view, eye): (layout::View, &EyeJob)| {
                let values = eye.marched().values();
                let group = cell
                    .buffers
                    .inside_group(gpu, pipelines, &self.atlas, values);
                (view, group)
            };
            return Some(views.into_iter().zip(job.eyes()).map(read).collect());
        }
        let cache = cell.buffers.cached_group(gpu, pipelines, &self.atlas);
        let read = |view| (view, cache.clone());
        Some(views.into_iter().map(read).collect())
    }

    /// Records a viewer's picture, both eyes' parts in one pass.
    pub(super) fn record_eyes(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        picture: &Picture,
        asked: &EyesPicture<'_>,
    ) -> Option<()> {
        let shafts = self.shaft_reader(self.cell_shown_by(asked.cell));
        let mut sources = Vec::new();
        for ((view, layers), key) in self.seen_by_eyes(asked)?.into_iter().zip(asked.keys) {
            let air = self.air_views.group(
                &self.gpu,
                &self.pipelines,
                encoder,
                f64::from(view.altitude_m),
                shafts.as_ref(),
            );
            sources.push(EyeSources {
                key: *key,
                view,
                layers,
                air,
            });
        }
        let cell = self.active_cells.get(&asked.cell)?;
        let (scene, field) = (
            cell.buffers.scene_group.clone(),
            cell.buffers.field_group().clone(),
        );
        let inputs: Vec<CompositeInputs<'_>> = sources
            .iter()
            .map(|eye| CompositeInputs {
                key: eye.key,
                scene: &scene,
                air: eye.air.as_ref(),
                layers: &eye.layers,
                view: &eye.view,
                ground_radius_m: ground_radius_m(&self.scene, &self.active, &eye.view),
            })
            .collect();
        match asked.inspected {
            Some(shown) => self.record_inspection(encoder, picture, &inputs, &field, shown),
            None => picture.record(
                &self.gpu,
                encoder,
                &mut self.timing,
                &self.pipelines,
                &inputs,
            ),
        }
        Some(())
    }
}

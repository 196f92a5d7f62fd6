//! Functions that read the scene or its cloud field.

use super::{Round, group};
use crate::atmosphere::BaseTables;
use crate::field::FieldStore;
use crate::gpu::{FieldTextures, Gpu, GpuError, PipelineKey, Pipelines, TimingRing};
use crate::march::{
    ActiveLayer, CellBuffers, CellFrame, MarchSettings, SunVolumeTexture, active_layers,
    layer_features, placed_sheets, placed_weather, scene_uniform, sky_light,
    sun_angular_radius_rad, sun_columns_key, wind_drifts,
};
use crate::sun_volume::{Generation, GenerationInputs, LayerShell, serves, sun_volume_uniform};
use glam::{DVec2, DVec3};
use skycell_protocol::{Scene, SunDepth};
use skycell_shaders::{Kernel, layout};
use std::path::Path;

/// What `probe/field.wgsl` can be asked; what a point holds stands there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldQuestion {
    /// Parts of a ray in a layer.
    LayerIntervals = 0,
    /// Steps of a march.
    Steps = 1,
    /// Coverage and type from a map's value.
    CoverageAndType = 2,
    /// Density of a place.
    Density = 3,
    /// Optical depth towards the sun.
    SunOpticalDepth = 4,
    /// Parts of a ray over a layer's bounds.
    OverBounds = 5,
    /// Radiance and transmittance of clear air.
    ClearSky = 6,
    /// Relative air mass; radiance of the sun's disc.
    AirMassAndDisc = 7,
    /// The scene's phase.
    Phase = 8,
    /// What lies behind all clouds.
    Background = 9,
    /// A cloud over what lies behind it.
    LayerOver = 10,
    /// The tone curve.
    Tone = 11,
    /// A texel after many samples.
    Accumulated = 12,
    /// Where the first samples of a texel stand in the mean.
    SampleOffset = 13,
    /// Where a slice of a temporal window shows a point.
    Reprojected = 30,
    /// Weights of a temporal window's samples, and how they are kept.
    WindowWeights = 31,
}

/// Four vectors.
pub type FieldPoint = [[f32; 4]; 4];
/// Two vectors.
pub type FieldValue = [[f32; 4]; 2];

/// A scene on the device, around one place.
pub struct FieldProbe {
    gpu: Gpu,
    pipelines: Pipelines,
    cell: CellBuffers,
    field: FieldTextures,
    keys: Vec<PipelineKey>,
    uniform: layout::Scene,
    active: Vec<ActiveLayer>,
    frame: CellFrame,
}

impl FieldProbe {
    /// Puts a scene on a device. The frame's origin is the ground under `origin_m` (x, altitude, z); the wind has blown for
    /// `time_s`; noise is kept in `noise_dir`, voxels and maps are looked for in `grids_dir`.
    ///
    /// # Errors
    /// When there is no device.
    pub fn open(
        scene: &Scene,
        settings: MarchSettings,
        origin_m: DVec3,
        time_s: f64,
        noise_dir: &Path,
        grids_dir: &Path,
    ) -> Result<Self, GpuError> {
        let gpu = Gpu::open_blocking()?;
        let mut pipelines = Pipelines::new(&gpu);
        let store = FieldStore::new(Some(noise_dir.to_owned()));
        let mut field = FieldTextures::new(&gpu, &pipelines.field_layout, store);
        field.set_grids(&gpu, &pipelines.field_layout, scene, grids_dir);
        let active = active_layers(scene);
        let frame = CellFrame::at(origin_m, scene.planet().radius_m());
        let air = BaseTables::of(scene, sun_angular_radius_rad(), None);
        let light = sky_light(
            scene,
            air.as_ref(),
            active.first().map_or(0.0, |l| l.proxy_altitude_m),
        );
        let has_volume = settings.sun_depth.unwrap_or(scene.light().sun_depth())
            == SunDepth::Volume
            && !active.is_empty()
            && serves(light.sun_direction);
        let mut keys = Vec::new();
        let maps = placed_weather(scene, &active);
        let sheets = placed_sheets(scene, &active);
        field.set_maps(&gpu, &pipelines.field_layout, &maps, &sheets, grids_dir);
        for layer in &active {
            keys.push(PipelineKey {
                kernel: Kernel::ProbeField,
                features: skycell_shaders::Features {
                    sun_layers: if has_volume { active.len() as u32 } else { 0 },
                    ..layer_features(scene, layer.scene_index, &settings)
                },
            });
        }
        if keys.is_empty() {
            keys.push(PipelineKey {
                kernel: Kernel::ProbeField,
                features: skycell_shaders::Features {
                    density: skycell_shaders::Density::Homogeneous,
                    ..Default::default()
                },
            });
        }
        for key in &keys {
            pipelines.prepare(&gpu, *key)?;
        }
        let drifts = wind_drifts(scene, time_s);
        let uniform = scene_uniform(scene, &active, &light, settings, &frame, &drifts);
        let mut cell = CellBuffers::new(&gpu, &pipelines, &field.bind_group);
        cell.set_scene(&gpu, &uniform);
        if has_volume {
            let around = SunAround {
                scene,
                settings,
                active: &active,
                drifts: &drifts,
                frame: &frame,
                field: &field.bind_group,
            };
            around.bind(&gpu, &mut pipelines, &mut cell)?;
        }
        Ok(Self {
            gpu,
            pipelines,
            cell,
            field,
            keys,
            uniform,
            active,
            frame,
        })
    }

    /// For tests: answers come from edited shaders, until `None` brings the true ones back.
    ///
    /// # Errors
    /// When what comes of the edit is no shader.
    pub fn plant(&mut self, edit: Option<skycell_shaders::SourceEdit>) -> Result<(), GpuError> {
        self.pipelines.plant(edit);
        for key in &self.keys {
            self.pipelines.prepare(&self.gpu, *key)?;
        }
        Ok(())
    }

    /// Gives the scene's layers other maps, which have been on their way for `passed_s` of the transition that they ask for.
    /// The scene must not differ in anything else.
    ///
    /// # Errors
    /// When the pass that blends maps cannot be made.
    pub fn change_maps(
        &mut self,
        scene: &Scene,
        passed_s: f64,
        maps_dir: &Path,
    ) -> Result<(), GpuError> {
        let maps = placed_weather(scene, &self.active);
        let layout = &self.pipelines.field_layout;
        let sheets = placed_sheets(scene, &self.active);
        self.field
            .set_maps(&self.gpu, layout, &maps, &sheets, maps_dir);
        self.field.advance_maps(passed_s);
        self.field.show_maps(&self.gpu, &mut self.pipelines)?;
        self.cell.set_field_group(&self.field.bind_group);
        Ok(())
    }

    /// What the shaders read of the scene.
    #[must_use]
    pub fn uniform(&self) -> &layout::Scene {
        &self.uniform
    }

    /// Layers that are shown, lowest first.
    #[must_use]
    pub fn active(&self) -> &[ActiveLayer] {
        &self.active
    }

    /// The frame that points are in.
    #[must_use]
    pub fn frame(&self) -> &CellFrame {
        &self.frame
    }

    /// The values at the points; `layer` counts those that are shown.
    ///
    /// # Errors
    /// When the device is lost or there is no such layer.
    pub fn ask(
        &self,
        question: FieldQuestion,
        layer: usize,
        points: &[FieldPoint],
    ) -> Result<Vec<FieldValue>, GpuError> {
        let no_layer = || GpuError::Device(format!("there is no layer {layer}"));
        let key = self.keys.get(layer).ok_or_else(no_layer)?;
        let pipeline = self.pipelines.get(*key).ok_or_else(no_layer)?;
        let asked = [question as u32, points.len() as u32, layer as u32, 0];
        let round = Round::new(&self.gpu, points, 32, asked);
        let data = group(
            &self.gpu,
            &self.pipelines.points_layout,
            &[&round.points, &round.values],
        );
        let asked = group(
            &self.gpu,
            &self.pipelines.question_layout,
            &[&round.question],
        );
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, self.cell.march_group(key.features), &[]);
            pass.set_bind_group(1, self.cell.field_group(), &[]);
            pass.set_bind_group(2, &data, &[]);
            pass.set_bind_group(3, &asked, &[]);
            pass.dispatch_workgroups(round.groups, 1, 1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        round.read(&self.gpu, points.len())
    }
}

/// What the sun volume around a place is made of.
struct SunAround<'a> {
    scene: &'a Scene,
    settings: MarchSettings,
    active: &'a [ActiveLayer],
    drifts: &'a [DVec3],
    frame: &'a CellFrame,
    field: &'a wgpu::BindGroup,
}

impl SunAround<'_> {
    /// Makes the whole volume at once and lets the cell read it.
    fn bind(
        &self,
        gpu: &Gpu,
        pipelines: &mut Pipelines,
        cell: &mut CellBuffers,
    ) -> Result<(), GpuError> {
        let [x, z] = self.frame.origin_m();
        let center_m = DVec2::new(x, z);
        let layers: Vec<(LayerShell, DVec3, f64)> = self
            .active
            .iter()
            .map(|active| {
                let layer = &self.scene.layers()[active.scene_index];
                let drift = self.drifts[active.scene_index];
                let shell = LayerShell {
                    base_altitude_m: layer.base_altitude_m(),
                    top_altitude_m: layer.top_altitude_m(),
                };
                (shell, drift, layer.extinction_per_m())
            })
            .collect();
        let inputs = GenerationInputs {
            direction: sky_light(self.scene, None, 0.0).sun_direction,
            center_m,
            planet_radius_m: self.scene.planet().radius_m(),
            layers: layers
                .iter()
                .map(|(shell, drift_m, _)| (*shell, *drift_m))
                .collect(),
        };
        let mut volume =
            Generation::new(self.settings.sun_volume.fitting(self.active.len()), &inputs);
        let light = sky_light(self.scene, None, 0.0);
        let scenes: Vec<_> = (0..volume.layers())
            .map(|layer| {
                let at = volume.origin_m(layer);
                let frame =
                    CellFrame::at(DVec3::new(at.x, 0.0, at.y), self.scene.planet().radius_m());
                let still = DVec3::new(0.0, volume.risen_m(layer), 0.0);
                scene_uniform(
                    self.scene,
                    self.active,
                    &light,
                    self.settings,
                    &frame,
                    &vec![still; self.drifts.len()],
                )
            })
            .collect();
        let features: Vec<_> = self
            .active
            .iter()
            .map(|layer| layer_features(self.scene, layer.scene_index, &self.settings))
            .collect();
        for features in &features {
            pipelines.prepare(gpu, sun_columns_key(*features))?;
        }
        let texture = SunVolumeTexture::new(gpu, pipelines, &volume, &scenes);
        let strips = volume.advance(&inputs, u64::MAX);
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        texture.record(
            gpu,
            &mut encoder,
            &mut TimingRing::new(gpu),
            pipelines,
            self.field,
            &volume,
            &strips,
            &features,
        );
        gpu.queue.submit([encoder.finish()]);
        let layers: Vec<_> = layers
            .iter()
            .map(|(_, drift, extinction)| (DVec2::new(drift.x, drift.z), *extinction))
            .collect();
        let sun_steps = self
            .settings
            .sun_steps
            .unwrap_or(self.scene.light().sun_steps());
        let sun = sun_volume_uniform(&volume, center_m, &layers, sun_steps);
        cell.bind_sun(gpu, pipelines, &texture, 0, volume.layers() as u32, &sun);
        Ok(())
    }
}

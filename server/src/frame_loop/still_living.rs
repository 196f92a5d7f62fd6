//! Viewers of cells while simulated time passes: what wind and turning heads cost, without a clock.

use super::auditing::AuditedTexel;
use super::still::{BATCH_TILES, StillRenderer};
use super::still_settings::StillSettings;
use crate::cells::CellLimit;
use crate::composite::{Picture, ground_key, with_parallax};
use crate::gpu::{GpuError, read_buffer_blocking};
use crate::march::AUDIT_TEXELS_MAX;
use skycell_protocol::{Camera, FrameSize, InputSequence, Scene, ViewerId};
use std::sync::Arc;
use std::time::Instant;

/// Viewers who share cells while time passes.
#[derive(Debug)]
pub struct LivingViewers {
    ids: Vec<ViewerId>,
    size: FrameSize,
    settings: StillSettings,
}

impl StillRenderer {
    /// Lets viewers share cells no wider than a limit from now on, with empty caches.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub fn begin_living(
        &mut self,
        cameras: &[Camera],
        size: FrameSize,
        settings: &StillSettings,
        limit: CellLimit,
    ) -> Result<LivingViewers, GpuError> {
        self.begin(settings)?;
        let renderer = &mut self.renderer;
        renderer.is_living = true;
        renderer.wind_is_searched = settings.parallax_steps > 0;
        let ids = self.join_together(cameras, size, settings, limit);
        let viewers = LivingViewers {
            ids,
            size,
            settings: *settings,
        };
        let key = self.key_together(settings);
        let renderer = &mut self.renderer;
        for key in [key, with_parallax(key)] {
            renderer.pipelines.prepare(&renderer.gpu, key)?;
            renderer.pipelines.prepare(&renderer.gpu, ground_key(key))?;
        }
        // They come together to where their mean is.
        renderer.regroup(0.0);
        Ok(viewers)
    }

    /// Marches until nothing is left to do, as the sky is now.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn settle_living(&mut self) -> Result<(), GpuError> {
        self.march_all(false, |_| {})
    }

    /// One turn: time has passed, viewers look elsewhere, at most so many tiles are marched. Returns how many were.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn turn_living(
        &mut self,
        viewers: &LivingViewers,
        cameras: &[Camera],
        passed_s: f64,
        tiles_max: usize,
    ) -> Result<u64, GpuError> {
        let renderer = &mut self.renderer;
        renderer.advance_time(passed_s);
        for (id, camera) in viewers.ids.iter().zip(cameras) {
            renderer.set_camera(*id, InputSequence(1), *camera);
        }
        renderer.regroup(passed_s);
        renderer.look_up_all();
        renderer.refresh_cells();
        while renderer.update_sun_volumes(BATCH_TILES) {
            renderer.gpu.wait()?;
        }
        let mut marched = 0;
        // A tile takes one sample a batch.
        while marched < tiles_max {
            let updates = renderer.march((tiles_max - marched).min(BATCH_TILES)).len();
            renderer.gpu.wait()?;
            if updates == 0 {
                break;
            }
            marched += updates;
        }
        let cells: Vec<_> = renderer.active_cells.keys().copied().collect();
        for cell in cells {
            renderer.caches.frame_shown(cell);
        }
        renderer.refresh_cells();
        Ok(marched as u64)
    }

    /// The scene is another, and nobody tells the caches.
    ///
    /// # Errors
    /// When a pipeline cannot be made or the device is lost.
    pub fn pretend_living(&mut self, scene: Arc<Scene>) -> Result<(), GpuError> {
        let renderer = &mut self.renderer;
        renderer.prepare_pipelines(&scene)?;
        renderer.scene = scene;
        renderer.take_maps();
        let altitude_m = renderer.active.first().map(|layer| layer.proxy_altitude_m);
        renderer.take_light(altitude_m.unwrap_or_default());
        renderer.look_up_all();
        renderer.refresh_cells();
        while renderer.update_sun_volumes(BATCH_TILES) {
            renderer.gpu.wait()?;
        }
        Ok(())
    }

    /// Every tile takes one sample more.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn refresh_living(&mut self) -> Result<(), GpuError> {
        self.renderer.caches.refresh_all();
        self.march_all(false, |_| {})
    }

    /// Cells with members.
    #[must_use]
    pub fn living_cells(&self) -> usize {
        let cells = self.renderer.cells.iter();
        cells.filter(|(_, cell)| !cell.members.is_empty()).count()
    }

    /// What a viewer sees, as it is shown: 4 bytes a pixel.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn show_living(
        &mut self,
        viewers: &LivingViewers,
        viewer: usize,
    ) -> Result<Vec<u8>, GpuError> {
        let gone = || GpuError::Device("the viewer of the picture is gone".into());
        let id = *viewers.ids.get(viewer).ok_or_else(gone)?;
        let key = self.key_together(&viewers.settings);
        let renderer = &mut self.renderer;
        let active = renderer.viewers.get(&id).ok_or_else(gone)?;
        let keys = renderer.keys_for(active, active.cell, key);
        let picture = Picture::new(&renderer.gpu, &renderer.pipelines, viewers.size, false);
        renderer.composite_still(id, &picture, &keys, None)?;
        read_buffer_blocking(&renderer.gpu, picture.pixels())
    }

    /// Marches so many texels of what viewers want again, and tells how far the cache is from them, percent.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn audit_living(&mut self, texels: usize) -> Result<Vec<AuditedTexel>, GpuError> {
        let renderer = &mut self.renderer;
        let mut found = Vec::new();
        renderer.refresh_cells();
        while found.len() < texels
            && renderer.audit((texels - found.len()).min(AUDIT_TEXELS_MAX)) > 0
        {
            renderer.gpu.wait()?;
            found.extend(renderer.collect_audit(Instant::now()));
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RenderConfig;
    use crate::frame_loop::driven::{Driven, camera, scene_of, view};
    use crate::march::MarchSettings;
    use crate::measure::metrics::shown_errors;
    use image::RgbImage;
    use serde_json::{Value, json};
    use skycell_shaders::SourceEdit;
    use std::path::PathBuf;

    fn shown(still: &mut StillRenderer, viewers: &LivingViewers) -> RgbImage {
        let pixels = still.show_living(viewers, 0).expect("a picture");
        let rgb = pixels.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]);
        let (width, height) = (viewers.size.width(), viewers.size.height());
        RgbImage::from_raw(width, height, rgb.collect()).expect("a picture")
    }

    /// FLIP between what a viewer sees after the wind has carried the clouds by 60 m and every texel has taken one sample, and
    /// what it would see if all had been marched since.
    fn left_behind(edit: Option<SourceEdit>) -> f64 {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        let scene = |wind: f64, evolution: f64| {
            scene_of(&json!({"version": 1, "wind": {"speed_m_per_s": wind},
                "layers": [{"density": {"evolution_m_per_s": evolution}}]}))
        };
        let size = FrameSize::new(128, 72).expect("a size");
        let settings = StillSettings {
            march: MarchSettings {
                steps: 32,
                ..MarchSettings::default()
            },
            parallax_steps: 0,
            ..StillSettings::default()
        };
        let mut still = StillRenderer::new(config, scene(0.0, 0.0), &[]).expect("a device");
        still.plant(edit).expect("shaders");
        let viewers = still
            .begin_living(&[camera(0.0, 30.0)], size, &settings, CellLimit::default())
            .expect("viewers");
        still.settle_living().expect("marched");
        still.pretend_living(scene(1.0, 0.0)).expect("a scene");
        still.advance_time(60.0);
        // Clouds stand still there, and rays do not start ahead of them.
        still.pretend_living(scene(0.0, 1e-6)).expect("a scene");
        still.refresh_living().expect("marched");
        let carried = shown(&mut still, &viewers);
        still.renderer.caches.age_all();
        still.settle_living().expect("marched");
        shown_errors(&shown(&mut still, &viewers), &carried)
            .expect("comparable")
            .flip
    }

    #[test]
    fn what_is_carried_over_is_nearer_to_what_is_seen_than_what_is_left_where_it_was() {
        let carried = left_behind(None);
        // Planted: old texels are mixed in where they are.
        let left: SourceEdit = |path, source| match path {
            "march/texels.wgsl" => source.replace("any(item.old_origin != item.origin)", "false"),
            _ => source.to_owned(),
        };
        let left = left_behind(Some(left));
        println!("FLIP {carried:.4} carried over, {left:.4} left");
        // Both have the noise of the one sample; seen: 0.0141 and 0.0186.
        assert!(carried < 0.9 * left, "{carried} {left}");
    }

    /// Tiles that wind alone asks for in ten seconds.
    fn marched_under_wind(age_factor: f64) -> u64 {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig {
            age_factor,
            ..RenderConfig::new(PathBuf::from(noise))
        };
        let scene = scene_of(&json!({"version": 1, "wind": {"speed_m_per_s": 20.0}}));
        let size = FrameSize::new(96, 54).expect("a size");
        let settings = StillSettings {
            march: MarchSettings {
                steps: 8,
                ..MarchSettings::default()
            },
            ..StillSettings::default()
        };
        let mut still = StillRenderer::new(config, scene, &[]).expect("a device");
        let cameras = [camera(0.0, 30.0)];
        let viewers = still
            .begin_living(&cameras, size, &settings, CellLimit::default())
            .expect("viewers");
        still.settle_living().expect("marched");
        (0..40)
            .map(|_| still.turn_living(&viewers, &cameras, 0.25, usize::MAX))
            .sum::<Result<u64, _>>()
            .expect("marched")
    }

    #[test]
    fn what_may_be_half_as_old_is_marched_about_twice_as_often() {
        let [usual, younger, older] = [1.0, 0.5, 2.0].map(marched_under_wind);
        println!("{usual} tiles, {younger} at half the age, {older} at twice");
        let ratio = |more: u64, fewer: u64| more as f64 / fewer as f64;
        assert!(
            (1.6..2.4).contains(&ratio(younger, usual)),
            "{younger} {usual}"
        );
        assert!((1.6..2.4).contains(&ratio(usual, older)), "{usual} {older}");
    }

    #[test]
    fn a_head_that_turns_to_what_it_has_seen_the_suns_colour_and_exposure_march_nothing() {
        let calm = |members: Value| {
            let mut document = json!({"version": 1, "wind": {"speed_m_per_s": 0}});
            for (key, value) in members.as_object().expect("members") {
                document[key] = value.clone();
            }
            document
        };
        let mut driven = Driven::new(16, &calm(json!({})), &[]);
        let viewer = ViewerId(1);
        driven
            .renderer
            .join(viewer, view([96, 54], camera(0.0, 0.0)));
        let yaws_deg = [0.0, 20.0, 40.0, 60.0, 30.0, 10.0];
        let turn = |driven: &mut Driven| {
            for yaw_deg in yaws_deg {
                let input = InputSequence(1);
                driven
                    .renderer
                    .set_camera(viewer, input, camera(0.0, yaw_deg));
                driven.settle();
            }
            driven.renderer.counters.tiles_updated
        };
        let seen = turn(&mut driven);
        assert!(seen > 0);
        assert_eq!(turn(&mut driven), seen, "turned back");
        let looks = [
            json!({"exposure_ev": -1.0}),
            json!({"sun": {"irradiance_w_per_m2_nm": [2.2, 0.9, 0.6]}}),
        ];
        for (revision, members) in (2..).zip(looks) {
            let scene = scene_of(&calm(members.clone()));
            driven.renderer.set_scene(scene, revision).expect("a scene");
            assert_eq!(turn(&mut driven), seen, "{members}");
        }
        // Another place of the sun is no look.
        let lower = scene_of(&calm(json!({"sun": {"elevation_deg": 20.0}})));
        driven.renderer.set_scene(lower, 9).expect("a scene");
        assert!(turn(&mut driven) > seen);
    }
}

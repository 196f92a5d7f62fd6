//! Viewers whose frames are no pictures: clouds alone, or linear radiance. What such frames need is made beside the frames when
//! the first of them comes; before, and where nobody asks, nothing of it exists.

use super::renderer::{SkyRenderer, frame_key};
use super::viewers_on_device::ActiveViewer;
use crate::composite::{
    PictureFormat, clouds_key, fade_key_of, ground_key, linear_key, pre_exposure, with_parallax,
};
use crate::config::FrameFilter;
use crate::gpu::PipelineKey;
use crate::march::LayerBlend;
use skycell_protocol::{CellId, Scene};
use skycell_shaders::Shown;
use std::collections::BTreeSet;

/// Why a viewer whose frames are no pictures is sent nothing yet.
pub(super) const BEING_MADE: &str =
    "what makes such frames is being made; frames come when it is there";

/// A composite as frames of a format need it.
pub(super) fn of_format(key: PipelineKey, format: PictureFormat, haze: bool) -> PipelineKey {
    match format {
        PictureFormat::Clouds => clouds_key(key, haze),
        PictureFormat::Linear => linear_key(key),
        PictureFormat::Display => key,
    }
}

impl SkyRenderer {
    /// In which ways viewers ask for clouds alone: with haze, without.
    pub(super) fn clouds_asked(&self) -> BTreeSet<bool> {
        let views = self.viewers.values().map(|viewer| viewer.view);
        views
            .filter(|view| view.picture_format() == PictureFormat::Clouds)
            .map(|view| view.haze)
            .collect()
    }

    /// What those viewers' frames of a scene need, wherever they are below its layers.
    pub(super) fn clouds_keys(&self, scene: &Scene, blend: LayerBlend) -> Vec<PipelineKey> {
        let asked = self.clouds_asked();
        let mut keys: Vec<PipelineKey> = asked
            .iter()
            .map(|_| fade_key_of(PictureFormat::Clouds))
            .collect();
        for haze in asked {
            for filter in FrameFilter::ALL {
                for screen_space in [false, true] {
                    let plain = frame_key(&self.gpu, scene, filter, blend, screen_space);
                    let key = clouds_key(plain, haze);
                    keys.extend([key, ground_key(key), with_parallax(key)]);
                }
            }
        }
        keys
    }

    /// What a viewer's frames come to need, if they are no pictures.
    pub(super) fn own_format_keys(&self, viewer: &ActiveViewer) -> Vec<PipelineKey> {
        let format = viewer.view.picture_format();
        if format == PictureFormat::Display {
            return Vec::new();
        }
        let mut keys = self.possible_keys(viewer, Shown::Picture);
        if format == PictureFormat::Clouds {
            keys.push(fade_key_of(format));
        }
        keys
    }

    /// Whether a viewer cannot be sent what it asks for yet.
    pub(super) fn waits_for_format(&self, viewer: &ActiveViewer) -> bool {
        let keys = self.own_format_keys(viewer);
        keys.into_iter()
            .any(|key| self.pipelines.get(key).is_none())
    }

    /// What the colours of clouds alone are multiplied by that are composited from a cell now.
    pub(super) fn pre_exposure_in(&self, cell: CellId) -> f32 {
        let exposure = self.active_cells.get(&cell).map_or(1.0, |c| c.exposure);
        pre_exposure(exposure)
    }
}

#[cfg(test)]
mod tests {
    use super::super::driven::{Driven, camera, view};
    use super::super::interface::{FinishedFrame, FrameSink};
    use super::super::transitions::Stage;
    use super::*;
    use crate::config::PlacedCell;
    use serde_json::json;
    use skycell_protocol::clouds::{Clouds, append};
    use skycell_protocol::{Codec, ViewerId};
    use skycell_shaders::CloudsAlone;
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant};

    const PICTURES: ViewerId = ViewerId(1);
    const ALONE: ViewerId = ViewerId(2);

    /// The last clouds that were delivered.
    #[derive(Default)]
    struct LastClouds(Mutex<Option<Clouds>>);

    impl FrameSink for LastClouds {
        fn deliver(&self, frame: FinishedFrame) {
            let header = frame.clouds.expect("clouds alone");
            let mut payload = Vec::new();
            append(&mut payload, &header, frame.pixels.rgba()).expect("as many pixels");
            // Reading refuses numbers that clouds cannot have.
            let clouds = Clouds::parse(&payload).expect("clouds");
            *self.0.lock().expect("clouds") = Some(clouds);
        }
    }

    fn placed(name: &str, east_m: f64) -> PlacedCell {
        PlacedCell {
            name: name.into(),
            center_m: [east_m, 2.0, 0.0],
            radius_m: 60.0,
        }
    }

    fn driven() -> Driven {
        let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
            {"name": "low", "density": {"model": "homogeneous", "shape":
             {"form": "sphere", "center_m": [0, 2000, -3000], "radius_m": 900}}}]});
        Driven::new(
            16,
            &document,
            &[placed("here", 0.0), placed("there", 200.0)],
        )
    }

    fn shown(driven: &mut Driven) -> Clouds {
        let last = Arc::new(LastClouds::default());
        let sink: Arc<dyn FrameSink> = last.clone();
        assert_eq!(driven.renderer.composite(&[ALONE], &sink), [ALONE]);
        driven.renderer.gpu.wait().expect("a device");
        let mut last = last.0.lock().expect("clouds");
        last.take().expect("a frame")
    }

    /// Joins one who asks for clouds alone, and waits for what they need.
    fn join(driven: &mut Driven) {
        let mut asked = view([64, 36], camera(0.0, 0.0));
        asked.codec = Codec::Clouds;
        driven.renderer.join(ALONE, asked);
        let begun = Instant::now();
        while driven
            .renderer
            .waits_for_format(&driven.renderer.viewers[&ALONE])
        {
            driven.renderer.take_views();
            assert!(begun.elapsed() < Duration::from_secs(60), "never made");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn made(driven: &Driven) -> usize {
        let keys = driven.renderer.pipelines.keys();
        keys.filter(|key| key.features.clouds_alone != CloudsAlone::Off)
            .count()
    }

    #[test]
    fn nothing_of_clouds_alone_is_made_before_somebody_asks_for_them() {
        let mut driven = driven();
        let plain = view([64, 36], camera(0.0, 0.0));
        driven.renderer.join(PICTURES, plain);
        driven.settle();
        assert_eq!(made(&driven), 0);
        let document = json!({"version": 1, "layers": []});
        let scene = super::super::driven::scene_of(&document);
        let pictures_only = driven.renderer.pipeline_keys(&scene);
        assert!(
            pictures_only
                .iter()
                .all(|key| key.features.clouds_alone == CloudsAlone::Off)
        );

        let mut asked = plain;
        asked.codec = Codec::Clouds;
        driven.renderer.join(ALONE, asked);
        // The render thread does not make them.
        let viewer = &driven.renderer.viewers[&ALONE];
        assert!(driven.renderer.waits_for_format(viewer));
        assert_eq!(driven.renderer.shown_to(viewer).1, Some(BEING_MADE));
        driven.renderer.leave(ALONE);
        join(&mut driven);
        assert!(made(&driven) > 0);
        let viewer = &driven.renderer.viewers[&ALONE];
        assert_eq!(driven.renderer.shown_to(viewer), (Shown::Picture, None));
        // A scene that comes later has its own made with the rest of it.
        let with_clouds = driven.renderer.pipeline_keys(&scene);
        assert!(with_clouds.len() > pictures_only.len());
        driven.settle();
        let clouds = shown(&mut driven);
        let hidden = clouds.planes()[3]
            .iter()
            .filter(|through| through.to_f32() < 0.5);
        assert!(hidden.count() > 10);
        // Who asks for pictures gets pictures, and the other way round.
        let mut back = plain;
        back.size = asked.size;
        driven.renderer.set_view(ALONE, back);
        driven.settle();
        driven.show(ALONE);
    }

    #[test]
    fn on_the_way_to_another_cell_clouds_go_from_one_picture_to_the_other() {
        let mut driven = driven();
        join(&mut driven);
        driven.settle();
        driven.go(ALONE, 0.0);
        driven.settle();
        shown(&mut driven);
        driven.go(ALONE, 200.0);
        driven.until(ALONE, Some(Stage::Waits));
        driven.settle();
        driven.until(ALONE, Some(Stage::Fades));
        let mut on_the_way = Vec::new();
        while driven.stage(ALONE) == Some(Stage::Fades) {
            let share = driven.share(ALONE);
            on_the_way.push((share, shown(&mut driven)));
            driven.turn(0.1);
        }
        assert!(on_the_way.len() > 2, "{}", on_the_way.len());
        let last = shown(&mut driven);
        let (first_share, first) = &on_the_way[0];
        for (share, clouds) in &on_the_way {
            // What is left of the way from the first picture to the last one.
            let left = (1.0 - share) / (1.0 - first_share);
            for (pixel, told) in clouds.planes()[3].iter().enumerate() {
                let [begun, ends] = [first, &last].map(|c| f64::from(c.transmittance(pixel)));
                let expected = left * begun + (1.0 - left) * ends;
                let off = (f64::from(told.to_f32()) - expected).abs();
                assert!(
                    off < 2e-3,
                    "share {share}, pixel {pixel}: {told} for {expected}"
                );
            }
        }
    }
}

//! A renderer that tests drive frame by frame, as the loop does it, without a server or a clock.

use super::interface::{FinishedFrame, FrameSink, ViewRequest};
use super::renderer::SkyRenderer;
use super::transitions::Stage;
use crate::config::{PlacedCell, RenderConfig};
use crate::march::ProxySettings;
use crate::measure::metrics::shown_errors;
use image::RgbImage;
use serde_json::Value;
use skycell_protocol::{
    Camera, CellId, Codec, FrameSize, InputSequence, RendererKind, Scene, Show, ViewerId,
};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Frames a second, in all that is compared.
pub(super) const FPS: f64 = 10.0;
/// Tiles that are marched between two frames.
pub(super) const TILES: usize = 6;

/// The last frame that was delivered.
#[derive(Default)]
struct LastFrame(Mutex<Option<RgbImage>>);

impl FrameSink for LastFrame {
    fn deliver(&self, frame: FinishedFrame) {
        let (width, height) = (frame.size.width(), frame.size.height());
        let rgb = frame.pixels.rgba().chunks_exact(4);
        let rgb = rgb.flat_map(|p| [p[0], p[1], p[2]]).collect();
        *self.0.lock().expect("a frame") = RgbImage::from_raw(width, height, rgb);
    }
}

/// A renderer that is driven frame by frame as the loop does it.
pub(super) struct Driven {
    pub(super) renderer: SkyRenderer,
    last: Arc<LastFrame>,
}

pub(super) fn scene_of(document: &Value) -> Arc<Scene> {
    Arc::new(Scene::from_json(document).expect("a scene"))
}

pub(super) fn camera(east_m: f64, yaw_deg: f64) -> Camera {
    Camera::new([east_m, 2.0, 0.0], yaw_deg, 25.0, 60.0).expect("a camera")
}

pub(super) fn view(size: [u32; 2], camera: Camera) -> ViewRequest {
    ViewRequest {
        size: FrameSize::new(size[0], size[1]).expect("a size"),
        fps: FPS,
        codec: Codec::Png,
        jpeg_quality: 100,
        camera,
        renderer: RendererKind::Cached,
        quality: None,
        show: Show::Picture,
        stereo: None,
        haze: true,
        linear: false,
    }
}

impl Driven {
    pub(super) fn new(steps: u32, document: &Value, placed: &[PlacedCell]) -> Self {
        Self::configured(steps, document, placed, |_| {})
    }

    /// With layers that are kept in a way of their own.
    pub(super) fn on(
        proxies: ProxySettings,
        steps: u32,
        document: &Value,
        placed: &[PlacedCell],
    ) -> Self {
        Self::configured(steps, document, placed, |config| config.proxies = proxies)
    }

    /// With a configuration of its own.
    pub(super) fn configured(
        steps: u32,
        document: &Value,
        placed: &[PlacedCell],
        configure: impl FnOnce(&mut RenderConfig),
    ) -> Self {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let mut config = RenderConfig {
            march_steps: Some(steps),
            ..RenderConfig::new(PathBuf::from(noise))
        };
        configure(&mut config);
        let gpu = crate::gpu::Gpu::open_blocking().expect("a device");
        let renderer = SkyRenderer::new(gpu, config, scene_of(document), 1, placed);
        let mut renderer = renderer.expect("a renderer");
        renderer.is_living = true;
        Self {
            renderer,
            last: Arc::default(),
        }
    }

    /// One frame of a viewer, after time has passed.
    pub(super) fn frame(&mut self, viewer: ViewerId, passed_s: f64) -> RgbImage {
        self.turn(passed_s);
        self.show(viewer)
    }

    /// What happens between two frames.
    pub(super) fn turn(&mut self, passed_s: f64) {
        self.renderer.march(TILES);
        self.pass_time(passed_s);
    }

    /// The same without marching.
    pub(super) fn pass_time(&mut self, passed_s: f64) {
        let renderer = &mut self.renderer;
        renderer.advance_time(passed_s);
        renderer.regroup(passed_s);
        renderer.pass_renderer_fades(passed_s);
        renderer.pass_transitions(passed_s);
        renderer.refresh_cells();
        renderer.finish_approaches(Instant::now());
        renderer.gpu.wait().expect("a device");
        self.march_ways();
    }

    /// Marches a frame of rays for each viewer on its way to another cell that has such.
    fn march_ways(&mut self) {
        let renderer = &mut self.renderer;
        let viewers = renderer.viewers.iter();
        let on_their_way: Vec<ViewerId> = viewers
            .filter(|(_, viewer)| viewer.marches_on_its_way())
            .map(|(id, _)| *id)
            .collect();
        for id in on_their_way {
            while !renderer.march_screen_space(id, u64::MAX >> 20) {
                renderer.gpu.wait().expect("a device");
            }
        }
    }

    pub(super) fn show(&mut self, viewer: ViewerId) -> RgbImage {
        let sink: Arc<dyn FrameSink> = self.last.clone();
        assert_eq!(self.renderer.composite(&[viewer], &sink), [viewer]);
        self.renderer.gpu.wait().expect("a device");
        let mut last = self.last.0.lock().expect("a frame");
        last.take().expect("a picture")
    }

    /// Marches all that is wanted.
    pub(super) fn settle(&mut self) {
        self.renderer.refresh_cells();
        while !self.renderer.march(32).is_empty() {
            self.renderer.refresh_cells();
        }
        self.renderer.gpu.wait().expect("a device");
    }

    pub(super) fn stage(&self, viewer: ViewerId) -> Option<Stage> {
        let viewer = self.renderer.viewers.get(&viewer)?;
        Some(viewer.transition.as_ref()?.way.stage())
    }

    pub(super) fn share(&self, viewer: ViewerId) -> f64 {
        let viewer = self.renderer.viewers.get(&viewer).expect("a viewer");
        viewer.transition.as_ref().map_or(1.0, |t| t.way.share())
    }

    pub(super) fn cell_of(&self, viewer: ViewerId) -> CellId {
        self.renderer.viewers[&viewer].cell
    }

    /// Turns until a viewer's way has come to a stage, or has ended.
    pub(super) fn until(&mut self, viewer: ViewerId, stage: Option<Stage>) {
        for _ in 0..400 {
            if self.stage(viewer) == stage {
                return;
            }
            self.turn(1.0 / FPS);
        }
        panic!(
            "{stage:?} never comes: {:?}",
            self.renderer.transition_stats()
        );
    }

    /// Steps a viewer aside.
    pub(super) fn go(&mut self, viewer: ViewerId, east_m: f64) {
        let input = InputSequence(1);
        self.renderer
            .set_camera(viewer, input, camera(east_m, 40.0));
    }
}

/// FLIP between each frame and the next.
pub(super) fn steps(frames: &[RgbImage]) -> Vec<f64> {
    frames
        .windows(2)
        .map(|pair| shown_errors(&pair[0], &pair[1]).expect("comparable").flip)
        .collect()
}

pub(super) fn mean_and_most(values: &[f64]) -> [f64; 2] {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    [mean, values.iter().copied().fold(0.0, f64::max)]
}

/// Mean difference of two pictures, in steps of 8 bits.
pub(super) fn apart(a: &RgbImage, b: &RgbImage) -> f64 {
    let pairs = a.as_raw().iter().zip(b.as_raw());
    let sum: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / a.as_raw().len() as f64
}

/// The median.
pub(super) fn middle(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

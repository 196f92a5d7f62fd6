//! Prints the device time of a composite per pixel: run after changes to the composite's WGSL.

use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::StillRenderer;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    config.samples = 1;
    if std::env::args().any(|a| a == "bilinear") {
        config.frame_filter = skycell_server::config::FrameFilter::Bilinear;
    }
    let mut still = StillRenderer::new(config, Arc::new(Scene::default()), &[])?;
    let size = FrameSize::new(640, 360)?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 20.0, 60.0)?;
    for kind in [RendererKind::Cached, RendererKind::ScreenSpace] {
        let mut samples = Vec::new();
        for _ in 0..4 {
            let before = still.gpu_times_ns()[1];
            still.render(camera, size, kind, false, |_| {})?;
            samples.push((still.gpu_times_ns()[1] - before) as f64 / 1e6);
        }
        println!("{kind:?}: ms per composite {samples:.1?}");
    }
    Ok(())
}

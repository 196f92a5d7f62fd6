//! Prints the device time of marched tiles and of composites: run after changes to the WGSL. Arguments: `bilinear`,
//! `shared` for what is behind clouds being shared by two by two pixels, the name of a scene file, and how many pictures
//! are made.

use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::{FrameFilter, RenderConfig};
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let filter = if std::env::args().any(|a| a == "bilinear") {
        FrameFilter::Bilinear
    } else {
        FrameFilter::CatmullRom
    };
    let pictures = std::env::args().find_map(|a| a.parse().ok()).unwrap_or(4);
    let scene = match std::env::args().find(|a| a.ends_with(".json")) {
        Some(file) => Scene::from_json(&serde_json::from_str(&std::fs::read_to_string(file)?)?)?,
        None => Scene::default(),
    };
    let mut still = StillRenderer::new(config, Arc::new(scene), &[])?;
    let size = FrameSize::new(640, 360)?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 20.0, 60.0)?;
    for kind in [RendererKind::Cached, RendererKind::ScreenSpace] {
        let (mut marches, mut composites) = (Vec::new(), Vec::new());
        for _ in 0..pictures {
            let (before, tiles) = (still.gpu_times_ns(), still.totals().tiles_updated);
            let settings = StillSettings {
                renderer: kind,
                samples: 2,
                filter,
                shared_background: std::env::args().any(|a| a == "shared"),
                ..StillSettings::default()
            };
            still.render_with(camera, size, &settings, |_| {})?;
            let after = still.gpu_times_ns();
            let ms = |i: usize| (after[i] - before[i]) as f64 / 1e6;
            let tiles = still.totals().tiles_updated - tiles;
            composites.push(ms(1));
            marches.push(match kind {
                RendererKind::Cached => ms(0) / tiles as f64,
                RendererKind::ScreenSpace => ms(2),
            });
        }
        let unit = match kind {
            RendererKind::Cached => "tile and sample",
            RendererKind::ScreenSpace => "picture of two samples",
        };
        println!(
            "{kind:?}: ms per {unit} {marches:.1?}, ms for both composites (shown and linear) {composites:.1?}"
        );
    }
    Ok(())
}

//! Prints what temporal windows cost and how far they are from the plain march: run after changes to the window's WGSL.
//! Arguments: windows as frames,divisor,segments,refinement[,degrees a frame[,frames marched]].

use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillPicture, StillRenderer, StillSettings};
use skycell_server::march::{MarchSettings, WindowPlan};
use std::sync::Arc;

/// Mean FLIP of two shown pictures.
fn flip(a: &StillPicture, b: &StillPicture) -> f32 {
    let (width, height) = (a.size.width(), a.size.height());
    let [a, b] = [a, b].map(|picture| -> Vec<u8> {
        let pixels = picture.display.chunks_exact(4);
        pixels.flat_map(|p| [p[0], p[1], p[2]]).collect()
    });
    let [a, b] = [a, b].map(|rgb| nv_flip::FlipImageRgb8::with_data(width, height, &rgb));
    let errors = nv_flip::flip(a, b, nv_flip::DEFAULT_PIXELS_PER_DEGREE);
    nv_flip::FlipPool::from_image(&errors).mean()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let mut still = StillRenderer::new(config, Arc::new(Scene::default()), &[])?;
    let size = FrameSize::new(320, 180)?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 20.0, 60.0)?;
    let march = MarchSettings {
        count_reads: true,
        ..MarchSettings::default()
    };
    let settings = StillSettings {
        renderer: RendererKind::ScreenSpace,
        march,
        samples: 1,
        ..StillSettings::default()
    };
    let plain = StillSettings {
        march: MarchSettings {
            early_exit: false,
            low_density_skip: false,
            adaptive_step: false,
            jitter: false,
            ..march
        },
        ..settings
    };
    let plain = still.render_with(camera, size, &plain, |_| {})?;
    let work = |picture: &StillPicture| {
        let figures = picture.figures;
        let counts = [figures.texture_reads, figures.density_evaluations];
        counts.map(|count| count.unwrap_or(0) as f64)
    };
    let [plain_reads, plain_densities] = work(&plain);
    println!(
        "plain march: {plain_reads:.3e} texture reads, {plain_densities:.3e} density evaluations"
    );
    for argument in std::env::args().skip(1) {
        let numbers = argument
            .split(',')
            .map(str::parse)
            .collect::<Result<Vec<f64>, _>>()?;
        let number = |at: usize, default: f64| numbers.get(at).copied().unwrap_or(default);
        let plan = WindowPlan {
            frames: number(0, 16.0) as u32,
            divisor: number(1, 1.0) as u32,
            depth_segments: number(2, 1.0) as u32,
            refinement: number(3, 1.0) as u32,
        };
        let frames = number(5, number(0, 16.0)).max(1.0);
        let windowed = StillSettings {
            window: Some(plan),
            frames: frames as u32,
            turn_deg_per_frame: number(4, 0.0),
            ..settings
        };
        let before_ns = still.gpu_times_ns()[2];
        let picture = still.render_with(camera, size, &windowed, |_| {})?;
        let ms = (still.gpu_times_ns()[2] - before_ns) as f64 / 1e6 / frames;
        let [reads, densities] = work(&picture).map(|count| count / frames);
        println!(
            "{argument:<20} a frame: reads ÷ {:.0}, densities ÷ {:.0}, {ms:.1} ms of device time; FLIP of plain {:.4}",
            plain_reads / reads,
            plain_densities / densities,
            flip(&picture, &plain),
        );
    }
    Ok(())
}

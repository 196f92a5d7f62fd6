//! The renderer that all cases share, and short ways to ask it for pictures and rays.

use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{
    RayFigures, RayPicture, StillPicture, StillRay, StillRenderer, StillSettings,
};
use skycell_server::march::MarchSettings;
use skycell_shaders::SourceEdit;
use skycell_tests::server::target_dir;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// Steps of pictures: cases are many, and extremes show at any number.
pub(crate) const STEPS: u32 = 24;

pub(crate) const SCREEN: RendererKind = RendererKind::ScreenSpace;
pub(crate) const CACHED: RendererKind = RendererKind::Cached;

/// One renderer; scenes are replaced.
pub(crate) struct Stage {
    still: StillRenderer,
    /// Sky time so far, s.
    time_s: f64,
    /// Where files of grids and maps lie.
    pub(crate) grids_dir: PathBuf,
}

/// The renderer of this run; cases take turns.
pub(crate) fn stage() -> MutexGuard<'static, Stage> {
    static STAGE: OnceLock<Mutex<Stage>> = OnceLock::new();
    STAGE
        .get_or_init(|| Mutex::new(Stage::open()))
        .lock()
        // A case that failed leaves a renderer that the next one sets up anew.
        .unwrap_or_else(PoisonError::into_inner)
}

impl Stage {
    fn open() -> Self {
        let noise = target_dir()
            .expect("a target folder")
            .join("noise-of-tests");
        let mut config = RenderConfig::new(noise);
        config.grids_dir = target_dir()
            .expect("a target folder")
            .join("grids-of-extremes");
        std::fs::create_dir_all(&config.grids_dir).expect("a folder");
        config.maps_dir = config.grids_dir.clone();
        let grids_dir = config.grids_dir.clone();
        let still = StillRenderer::new(config, Arc::default(), &[]).expect("a device");
        println!("{}", still.adapter());
        Self {
            still,
            time_s: 0.0,
            grids_dir,
        }
    }

    pub(crate) fn scene(&mut self, document: &Value) {
        self.show(Scene::from_json(document).expect("a valid document"));
    }

    pub(crate) fn show(&mut self, scene: Scene) {
        if scene.has_carried() {
            // It says itself where its clouds are.
            self.time_s = 0.0;
        }
        self.still.set_scene(Arc::new(scene)).expect("pipelines");
    }

    /// Sets the time that the wind has blown for.
    pub(crate) fn at_time(&mut self, time_s: f64) {
        self.still.advance_time(time_s - self.time_s);
        self.time_s = time_s;
    }

    /// Shaders with a defect, or the true ones again.
    pub(crate) fn plant(&mut self, edit: Option<SourceEdit>) {
        self.still.plant(edit).expect("shaders");
    }

    pub(crate) fn look(
        &mut self,
        camera: Camera,
        size: FrameSize,
        renderer: RendererKind,
    ) -> StillPicture {
        self.look_with(camera, size, &settings(renderer))
    }

    pub(crate) fn look_with(
        &mut self,
        camera: Camera,
        size: FrameSize,
        settings: &StillSettings,
    ) -> StillPicture {
        self.still
            .render_with(camera, size, settings, |_| {})
            .expect("a picture")
    }

    /// Rays in the frame at a world place; one sample in the middle of each step, nothing cut short.
    pub(crate) fn rays(
        &mut self,
        frame_m: DVec3,
        rays: Vec<StillRay>,
        march: MarchSettings,
    ) -> RayFigures {
        let list = RayPicture {
            frame_m,
            size: size(rays.len() as u32, 1),
            rays,
            pixel_m: [DVec3::ZERO; 2],
        };
        let settings = StillSettings {
            march,
            samples: 1,
            ..StillSettings::default()
        };
        self.still
            .render_rays(&list, &settings, |_| {})
            .expect("rays")
    }
}

/// One sample, few steps, everything on.
pub(crate) fn settings(renderer: RendererKind) -> StillSettings {
    StillSettings {
        renderer,
        march: MarchSettings {
            steps: STEPS,
            ..MarchSettings::default()
        },
        samples: 1,
        ..StillSettings::default()
    }
}

pub(crate) fn size(width: u32, height: u32) -> FrameSize {
    FrameSize::new(width, height).expect("a size")
}

/// What most cases look with.
pub(crate) fn small() -> FrameSize {
    size(32, 18)
}

pub(crate) fn eye(position_m: [f64; 3], yaw_deg: f64, pitch_deg: f64, fov_deg: f64) -> Camera {
    Camera::new(position_m, yaw_deg, pitch_deg, fov_deg).expect("a camera")
}

pub(crate) fn ray(origin_m: [f64; 3], direction: [f64; 3]) -> StillRay {
    StillRay {
        origin_m: DVec3::from_array(origin_m),
        direction: DVec3::from_array(direction).normalize(),
    }
}

/// Members of `patch` over those of `base`, as deep as there are objects.
pub(crate) fn merged(base: Value, patch: Value) -> Value {
    match (base, patch) {
        (Value::Object(mut base), Value::Object(patch)) => {
            for (key, value) in patch {
                let old = base.remove(&key).unwrap_or(Value::Null);
                base.insert(key, merged(old, value));
            }
            Value::Object(base)
        }
        (_, patch) => patch,
    }
}

/// The default scene with changes.
pub(crate) fn weather(patch: Value) -> Value {
    merged(json!({"version": 1}), patch)
}

/// A full layer from 1 km to 2 km under nothing but the sun, single scattering, no air and no sky: what closed forms know.
pub(crate) fn slab(patch: Value) -> Value {
    let plain = json!({
        "version": 1,
        "planet": "flat",
        "atmosphere": {"model": "uniform"},
        "sun": {"elevation_deg": 90, "irradiance_w_per_m2_nm": [1, 1, 1]},
        "light": {"phase": {"model": "isotropic"}, "octaves": 1, "ambient": 0, "sun_steps": 1, "sun_march_distance_m": 1},
        "layers": [{
            "base_altitude_m": 1000, "top_altitude_m": 2000, "extinction_per_m": 1e-3,
            "single_scattering_albedo": 1, "density": {"model": "homogeneous"}
        }]
    });
    merged(plain, patch)
}

/// Largest difference and largest value of two pictures' radiance.
pub(crate) fn difference(a: &StillPicture, b: &StillPicture) -> (f64, f64) {
    let pairs = a.linear.iter().zip(&b.linear);
    pairs.fold((0.0, 0.0), |(worst, largest): (f64, f64), (a, b)| {
        let (a, b) = (f64::from(*a), f64::from(*b));
        (worst.max((a - b).abs()), largest.max(a.abs()))
    })
}

/// |a - b| / |a| over red, green and blue of all pixels.
pub(crate) fn relative_l2(a: &StillPicture, b: &StillPicture) -> f64 {
    let (mut apart, mut whole) = (0.0, 0.0);
    for (a, b) in a.linear.chunks_exact(4).zip(b.linear.chunks_exact(4)) {
        for channel in 0..3 {
            apart += f64::from(a[channel] - b[channel]).powi(2);
            whole += f64::from(a[channel]).powi(2);
        }
    }
    (apart / whole).sqrt()
}

/// The linear radiance of a pixel.
pub(crate) fn pixel(picture: &StillPicture, column: u32, row: u32) -> [f64; 3] {
    let at = 4 * (row * picture.size.width() + column) as usize;
    [0, 1, 2].map(|channel| f64::from(picture.linear[at + channel]))
}

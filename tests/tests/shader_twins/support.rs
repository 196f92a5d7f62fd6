//! The device at given points, and the judgement that every comparison ends with.

use glam::DVec3;
use serde_json::Value;
use skycell_protocol::{Scene, SunDepth};
use skycell_reference::{Approximations, World};
use skycell_server::march::MarchSettings;
use skycell_server::probe::{FieldPoint, FieldProbe, FieldQuestion, FieldValue};
use skycell_server::probe::{FunctionProbe, FunctionQuestion as Question};
use skycell_server::truth::reference_world;
use skycell_tests::server::target_dir;
use std::path::PathBuf;

pub(crate) type Point = [[f32; 4]; 2];

/// The device, for tests of at least ten thousand points.
pub(crate) struct Probe(FunctionProbe);

impl Probe {
    pub(crate) fn open() -> Self {
        Self(FunctionProbe::open().expect("a device"))
    }

    pub(crate) fn ask(&self, question: Question, points: &[Point]) -> Vec<[f32; 4]> {
        let count = points.len();
        assert!(count >= 10_000, "{count} points are too few");
        self.0.ask(question, points).expect("values")
    }
}

/// A scene on the device, for tests of at least ten thousand points, and the same scene in f64.
pub(crate) struct SceneProbe {
    pub(crate) device: FieldProbe,
    pub(crate) world: World,
}

pub(crate) fn noise_dir() -> PathBuf {
    target_dir().expect("a folder").join("noise-of-tests")
}

impl SceneProbe {
    /// `exact`: textures are interpolated in f32.
    pub(crate) fn open(document: &Value, exact: bool) -> Self {
        Self::open_at(document, exact, 0.0)
    }

    /// The scene's f64 twin at a sky time.
    pub(crate) fn world_at(document: &Value, time_s: f64) -> World {
        let scene = Scene::from_json(document).expect("a valid document");
        let noise = noise_dir();
        let (origin, all) = (DVec3::ZERO, Approximations::ALL);
        reference_world(&scene, &noise, &noise, time_s, origin, all).expect("a world")
    }

    /// As [`Self::open`], at a sky time.
    pub(crate) fn open_at(document: &Value, exact: bool, time_s: f64) -> Self {
        let settings = MarchSettings {
            exact_interpolation: exact,
            sun_depth: Some(SunDepth::Cone),
            ..MarchSettings::default()
        };
        Self::open_with(document, settings, time_s)
    }

    /// As [`Self::open_at`], marched as settings tell.
    pub(crate) fn open_with(document: &Value, settings: MarchSettings, time_s: f64) -> Self {
        let scene = Scene::from_json(document).expect("a valid document");
        let noise = noise_dir();
        let device = FieldProbe::open(&scene, settings, DVec3::ZERO, time_s, &noise, &noise);
        Self {
            device: device.expect("a device"),
            world: Self::world_at(document, time_s),
        }
    }

    pub(crate) fn ask(&self, question: FieldQuestion, points: &[FieldPoint]) -> Vec<FieldValue> {
        let count = points.len();
        assert!(count >= 10_000, "{count} points are too few");
        self.device.ask(question, 0, points).expect("values")
    }
}

/// The bound holds for the GPU and is broken by the defect, else the test could not fail.
pub(crate) fn judge(what: &str, points: usize, gpu: f64, defect: f64) {
    println!(
        "{what:<36} {points:>6} points, worst {gpu:>6.3} of the bound, planted defect {defect:.2e}"
    );
    assert!(gpu <= 1.0, "{what}: {gpu} times the bound");
    assert!(
        defect > 1.0,
        "{what}: the planted defect passes, at {defect} of the bound"
    );
}

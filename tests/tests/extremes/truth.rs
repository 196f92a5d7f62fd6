//! Pictures at the ends against the f64 reference at the same steps: what f32 costs there.

use super::line::Line;
use super::stage::{SCREEN, STEPS, Stage, eye, size, weather};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::{Camera, Scene};
use skycell_reference::march::MarchSteps;
use skycell_reference::picture::{Projection, Renderer, render};
use skycell_reference::{Approximations, World};
use skycell_server::frame_loop::StillPicture;
use skycell_server::truth::reference_world;
use skycell_tests::server::target_dir;

/// Relative L2 of linear radiance.
const L2_MAX: f64 = 1e-3;

pub(crate) fn compare(
    stage: &mut Stage,
    line: &mut Line,
    what: &str,
    document: &Value,
    camera: Camera,
) {
    stage.scene(document);
    let scene = Scene::from_json(document).expect("valid");
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    let world = reference_world(
        &scene,
        &noise,
        &stage.grids_dir,
        0.0,
        DVec3::from_array(camera.position_m()),
        Approximations::ALL,
    )
    .expect("a world");
    compare_with(stage, line, what, &world, camera);
}

/// As [`compare`], for fields so steep that the rounding of places shows: what the device finds is what the reference finds
/// from somewhere within `moved_m` of the eye, to [`L2_MAX`].
pub(crate) fn compare_within(
    stage: &mut Stage,
    line: &mut Line,
    what: &str,
    document: &Value,
    camera: Camera,
    moved_m: f64,
) {
    stage.scene(document);
    let scene = Scene::from_json(document).expect("valid");
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    let at = camera.position_m();
    let world = reference_world(
        &scene,
        &noise,
        &stage.grids_dir,
        0.0,
        DVec3::from_array(at),
        Approximations::ALL,
    )
    .expect("a world");
    let picture = device_picture(stage, camera);
    let exact = reference_picture(&world, camera);
    // Along each axis, both ways: by how much each value changes there.
    let mut uncertain = vec![0.0f64; exact.len()];
    for axis in 0..3 {
        for way in [-moved_m, moved_m] {
            let mut place = at;
            place[axis] += way;
            let moved = eye(
                place,
                camera.yaw_deg(),
                camera.pitch_deg(),
                camera.vertical_fov_deg(),
            );
            let moved = reference_picture(&world, moved);
            for (most, (moved, exact)) in uncertain.iter_mut().zip(moved.iter().zip(&exact)) {
                *most = most.max((moved - exact).abs());
            }
        }
    }
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let whole = norm(&mut exact.iter().copied());
    let uncertain = norm(&mut uncertain.iter().copied());
    let apart = norm(
        &mut rgb(&picture)
            .zip(&exact)
            .map(|(found, exact)| found - exact),
    );
    println!(
        "{what}: {:.2e} apart, {:.2e} by places {moved_m} m off, relative",
        apart / whole,
        uncertain / whole
    );
    line.picture(what, &picture);
    line.holds(what, apart, L2_MAX * whole + uncertain);
}

/// Red, green and blue of all pixels.
fn rgb(picture: &StillPicture) -> impl Iterator<Item = f64> {
    let pixels = picture.linear.chunks_exact(4);
    pixels.flat_map(|pixel| pixel[..3].iter().map(|v| f64::from(*v)))
}

fn device_picture(stage: &mut Stage, camera: Camera) -> StillPicture {
    let mut settings = super::stage::settings(SCREEN);
    settings.march.exact_interpolation = true;
    settings.march.jitter = false;
    stage.look_with(camera, size(16, 9), &settings)
}

fn reference_picture(world: &World, camera: Camera) -> Vec<f64> {
    let steps = MarchSteps {
        steps: STEPS,
        ..MarchSteps::default()
    };
    let size = size(16, 9);
    let projection = Projection::Pinhole { camera, size };
    let truth = render(world, &projection, &Renderer::March(steps), || {}).expect("a picture");
    let rays = truth.rays.iter();
    rays.flat_map(|ray| ray.radiance.to_array()).collect()
}

/// The scene on stage against a world in the frame under the camera.
pub(crate) fn compare_with(
    stage: &mut Stage,
    line: &mut Line,
    what: &str,
    world: &World,
    camera: Camera,
) {
    let picture = device_picture(stage, camera);
    let (mut apart, mut whole) = (0.0, 0.0);
    for (found, exact) in rgb(&picture).zip(reference_picture(world, camera)) {
        apart += (found - exact).powi(2);
        whole += exact * exact;
    }
    line.picture(what, &picture);
    // At night both are black; the smallest f32 stands for nothing.
    line.holds(
        what,
        apart.sqrt(),
        L2_MAX * whole.sqrt() + f64::from(f32::MIN_POSITIVE),
    );
}

pub(crate) fn at_the_ends(stage: &mut Stage) -> Line {
    let mut line = Line::new("against the reference");
    let up = || eye([0.0, 2.0, 0.0], 100.0, 25.0, 60.0);
    for elevation_deg in [-90.0, -3.0, -1.0, -0.2666, 0.0, 0.2666, 1.0, 30.0, 90.0] {
        let scene = weather(json!({"sun": {"elevation_deg": elevation_deg, "azimuth_deg": 100}}));
        compare(
            stage,
            &mut line,
            &format!("sun at {elevation_deg}°"),
            &scene,
            up(),
        );
    }
    for altitude_m in [
        0.0, 1499.9999, 1500.0, 1500.0001, 2750.0, 4000.0, 12_000.0, 400_000.0,
    ] {
        for pitch_deg in [-90.0, -20.0, 20.0, 90.0] {
            let camera = eye([0.0, altitude_m, 0.0], 100.0, pitch_deg, 60.0);
            let what = format!("{altitude_m} m up, {pitch_deg}°");
            compare(stage, &mut line, &what, &weather(json!({})), camera);
        }
    }
    for fov_deg in [1.0, 170.0] {
        let camera = eye([0.0, 2.0, 0.0], 0.0, 30.0, fov_deg);
        compare(
            stage,
            &mut line,
            &format!("view of {fov_deg}°"),
            &weather(json!({})),
            camera,
        );
    }
    for coverage in [0.0, 1.0] {
        for cloud_type in [0.0, 1.0] {
            let scene = weather(
                json!({"layers": [{"density": {"model": "weather", "coverage": coverage,
                "type": cloud_type, "detail_strength": 1}}]}),
            );
            compare(
                stage,
                &mut line,
                &format!("coverage {coverage}, type {cloud_type}"),
                &scene,
                up(),
            );
        }
    }
    for extinction_per_m in [1e-9, 1e-5, 1.0, 1e3] {
        let scene = weather(json!({"layers": [{"extinction_per_m": extinction_per_m}]}));
        compare(
            stage,
            &mut line,
            &format!("extinction {extinction_per_m}"),
            &scene,
            up(),
        );
    }
    for phase in [
        json!({"model": "hg", "g": 0.999}),
        json!({"model": "hg", "g": -0.999}),
        json!({"model": "draine", "g": 0.9, "alpha": 1e4}),
        json!({"model": "hg-draine", "droplet_diameter_um": 5}),
        json!({"model": "hg-draine", "droplet_diameter_um": 50}),
    ] {
        let scene = weather(json!({"light": {"phase": phase.clone()}}));
        compare(stage, &mut line, &phase.to_string(), &scene, up());
    }
    for octaves in [1, 16] {
        for factor in [0, 1] {
            let scene = weather(
                json!({"light": {"scattering": "octaves", "octaves": octaves, "octave_attenuation": factor,
                "octave_contribution": 1, "octave_eccentricity": 1 - factor}}),
            );
            compare(
                stage,
                &mut line,
                &format!("{octaves} octaves, {factor}"),
                &scene,
                up(),
            );
        }
    }
    for aerosol in [0.0, 5.0] {
        let scene =
            weather(json!({"atmosphere": {"model": "analytic", "aerosol_optical_depth": aerosol}}));
        compare(stage, &mut line, &format!("haze {aerosol}"), &scene, up());
    }
    for radius_m in [1e4, 1e8] {
        let scene = weather(json!({"planet": {"radius_m": radius_m}}));
        compare(
            stage,
            &mut line,
            &format!("planet of {radius_m} m"),
            &scene,
            up(),
        );
    }
    line
}

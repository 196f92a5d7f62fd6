//! `skycell-server probe`: the functions of the shaders and of the f64 reference at given points, side by side.

use super::{FieldProbe, FieldQuestion, FunctionProbe, FunctionQuestion};
use crate::march::{CellFrame, MarchSettings};
use crate::render_command::{Folders, read_scene};
use crate::truth::reference_world;
use anyhow::{Context, bail, ensure};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_protocol::scene::{HgDraineDocument, PhaseDocument};
use skycell_reference::{Approximations, Ray, World};
use std::path::PathBuf;

/// Most points of a call.
const POINTS_MAX: usize = 1 << 20;

/// What to ask, and where.
#[derive(Clone, Debug, clap::Args)]
pub struct ProbeArguments {
    #[command(subcommand)]
    question: Question,
    /// Scene document; the default scene without it.
    #[arg(long, global = true)]
    scene: Option<PathBuf>,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR", global = true)]
    noise_cache_dir: Option<PathBuf>,
}

/// Functions that can be asked.
#[derive(Clone, Debug, clap::Subcommand)]
enum Question {
    /// The scene's phase function in 1/sr, as it is and averaged over the sun's disc.
    #[command(
        after_help = "Example: skycell-server probe phase --droplet-diameter-um 10 --angles-deg 0,0.5,1,10,90,140,180"
    )]
    Phase {
        /// Angles between the light's way and the scattered light's.
        #[arg(long, value_delimiter = ',', required = true, num_args = 1..)]
        angles_deg: Vec<f64>,
        /// Instead of the scene's phase function, that of droplets of this diameter, 5 to 50.
        #[arg(long)]
        droplet_diameter_um: Option<f64>,
    },
    /// Where a ray's line meets the sphere at an altitude: distances in metres.
    #[command(
        after_help = "Example: skycell-server probe shell --origin-m 0,2,0 --direction 0,0.01,-1 --altitudes-m 1500,4000"
    )]
    Shell {
        /// Where the ray begins: x, altitude, z.
        #[arg(long, value_delimiter = ',', num_args = 1, value_name = "X,Y,Z", default_values_t = [0.0, 2.0, 0.0], allow_negative_numbers = true)]
        origin_m: Vec<f64>,
        /// Where it goes, in the axes of the ground under its origin: east, up, south.
        #[arg(
            long,
            value_delimiter = ',',
            num_args = 1,
            value_name = "X,Y,Z",
            required = true,
            allow_negative_numbers = true
        )]
        direction: Vec<f64>,
        /// Altitudes of the spheres.
        #[arg(long, value_delimiter = ',', required = true, num_args = 1.., allow_negative_numbers = true)]
        altitudes_m: Vec<f64>,
    },
    /// Density (0 to 1) of every layer at given places and time: f64, the device's f32 with exact interpolation, and with
    /// its sampler.
    #[command(
        after_help = "Example: skycell-server probe density --positions-m 0,2000,0,500,2500,-800 --time-s 3600"
    )]
    Density {
        /// Places, three numbers each: x, altitude, z.
        #[arg(long, value_delimiter = ',', required = true, num_args = 1.., allow_negative_numbers = true)]
        positions_m: Vec<f64>,
        /// Seconds for which the wind has blown.
        #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
        time_s: f64,
        /// Weight of the detail noise, which fades with distance: 0 to 1.
        #[arg(long, default_value_t = 1.0)]
        detail_weight: f64,
    },
}

/// Asks and prints JSON.
///
/// # Errors
/// For an unreadable scene, a number that is out of range, a missing device.
pub fn run(arguments: &ProbeArguments) -> anyhow::Result<()> {
    let scene = read_scene(arguments.scene.as_deref())?;
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    crate::field::check_grids(&scene, &folders.grids)?;
    let store = crate::field::FieldStore::new(Some(folders.noise.clone()));
    crate::field::check_maps(&scene, &store, &folders.grids)?;
    let answer = match &arguments.question {
        Question::Phase {
            angles_deg,
            droplet_diameter_um,
        } => phase(scene, &folders, angles_deg, *droplet_diameter_um)?,
        Question::Shell {
            origin_m,
            direction,
            altitudes_m,
        } => shell(&scene, &folders, origin_m, direction, altitudes_m)?,
        Question::Density {
            positions_m,
            time_s,
            detail_weight,
        } => density(&scene, &folders, positions_m, *time_s, *detail_weight)?,
    };
    println!("{}", serde_json::to_string_pretty(&answer)?);
    Ok(())
}

fn limited(what: &str, count: usize) -> anyhow::Result<()> {
    ensure!(
        count <= POINTS_MAX,
        "{what} has {count} values; allowed are 1 to {POINTS_MAX}"
    );
    Ok(())
}

fn world(scene: &Scene, folders: &Folders, time_s: f64, origin_m: DVec3) -> anyhow::Result<World> {
    Ok(reference_world(
        scene,
        &folders.noise,
        &folders.grids,
        time_s,
        origin_m,
        Approximations::ALL,
    )?)
}

fn probe(
    scene: &Scene,
    folders: &Folders,
    exact: bool,
    time_s: f64,
    origin_m: DVec3,
) -> anyhow::Result<FieldProbe> {
    let settings = MarchSettings {
        exact_interpolation: exact,
        ..MarchSettings::default()
    };
    let (noise, grids) = (&folders.noise, &folders.grids);
    Ok(FieldProbe::open(
        scene, settings, origin_m, time_s, noise, grids,
    )?)
}

fn phase(
    mut scene: Scene,
    folders: &Folders,
    angles_deg: &[f64],
    droplet_diameter_um: Option<f64>,
) -> anyhow::Result<Value> {
    limited("--angles-deg", angles_deg.len())?;
    if let Some(bad) = angles_deg.iter().find(|a| !(0.0..=180.0).contains(*a)) {
        bail!("--angles-deg has {bad}; allowed is 0 to 180");
    }
    let mut document = scene.to_document();
    // The phase needs no clouds, and so no noise.
    document.layers.clear();
    if let Some(droplet_diameter_um) = droplet_diameter_um {
        document.light.phase = PhaseDocument::HgDraine(HgDraineDocument {
            droplet_diameter_um,
        });
    }
    scene = Scene::try_from(document)?;
    let world = world(&scene, folders, 0.0, DVec3::ZERO)?;
    let disc = world.light().sun_one_minus_mu;
    // 1 - cos by the half angle keeps the digits of small angles.
    let one_minus_mu = |deg: f64| 2.0 * (0.5 * deg.to_radians()).sin().powi(2);
    let points: Vec<_> = angles_deg
        .iter()
        .map(|deg| {
            let mut point = [[0.0; 4]; 4];
            point[0] = [one_minus_mu(*deg) as f32, 1.0, disc as f32, 0.0];
            point
        })
        .collect();
    let device = probe(&scene, folders, true, 0.0, DVec3::ZERO)?;
    let found = device.ask(FieldQuestion::Phase, 0, &points)?;
    let lines: Vec<Value> = angles_deg
        .iter()
        .zip(&found)
        .map(|(deg, [value, _])| {
            let x = one_minus_mu(*deg);
            let phase = world.phase();
            json!({
                "angle_deg": deg,
                "phase_per_sr": {"f64": phase.per_sr(1.0, x), "device": value[0]},
                "over_sun_disc_per_sr": {"f64": phase.over_disc_per_sr(x, disc), "device": value[1]},
            })
        })
        .collect();
    Ok(json!({
        "phase": scene.to_document().light.phase, "mean_cosine": world.phase().mean_cosine(), "points": lines,
    }))
}

fn place(what: &str, values: &[f64]) -> anyhow::Result<DVec3> {
    let values = <[f64; 3]>::try_from(values)
        .ok()
        .with_context(|| format!("{what} has {} numbers; needed are 3", values.len()))?;
    ensure!(
        values.iter().all(|v| v.is_finite() && v.abs() <= 1e9),
        "{what} is {values:?}; allowed is -1e9 to 1e9"
    );
    Ok(DVec3::from_array(values))
}

fn shell(
    scene: &Scene,
    folders: &Folders,
    origin_m: &[f64],
    direction: &[f64],
    altitudes_m: &[f64],
) -> anyhow::Result<Value> {
    limited("--altitudes-m", altitudes_m.len())?;
    let origin_m = place("--origin-m", origin_m)?;
    let mut document = scene.to_document();
    document.layers.clear();
    let scene = Scene::try_from(document)?;
    let world = world(&scene, folders, 0.0, origin_m)?;
    let ray = Ray::new(
        world.frame_from_world_m(origin_m),
        place("--direction", direction)?,
    )?;
    let radius_m = scene.planet().radius_m() as f32;
    let f32s = |v: DVec3, w: f32| {
        let [x, y, z] = v.as_vec3().to_array();
        [x, y, z, w]
    };
    let points: Vec<_> = altitudes_m
        .iter()
        .map(|altitude_m| {
            [
                f32s(ray.origin_m, radius_m),
                f32s(ray.direction, *altitude_m as f32),
            ]
        })
        .collect();
    let found = FunctionProbe::open()?.ask(FunctionQuestion::ShellRoots, &points)?;
    let lines: Vec<Value> = altitudes_m
        .iter()
        .zip(&found)
        .map(|(altitude_m, device)| {
            let exact = world.globe().at_most(*altitude_m, &ray);
            let roots = |near_m: f64, far_m: f64| json!({"near_m": near_m, "far_m": far_m});
            let (near_m, far_m) = (f64::from(device[0]), f64::from(device[1]));
            json!({
                "altitude_m": altitude_m,
                "f64": exact.map(|found| roots(found.start_m, found.end_m)),
                "device": (device[2] > 0.0).then(|| roots(near_m, far_m)),
            })
        })
        .collect();
    Ok(json!({
        "origin_m": origin_m.to_array(), "direction": ray.direction.to_array(),
        "planet_radius_m": scene.planet().radius_m(), "flat": scene.planet().is_flat(), "points": lines,
    }))
}

fn density(
    scene: &Scene,
    folders: &Folders,
    positions_m: &[f64],
    time_s: f64,
    detail_weight: f64,
) -> anyhow::Result<Value> {
    limited("--positions-m", positions_m.len())?;
    ensure!(
        positions_m.len().is_multiple_of(3),
        "--positions-m has {} numbers; needed are three for each place",
        positions_m.len()
    );
    ensure!(
        (0.0..=1.0).contains(&detail_weight),
        "--detail-weight is {detail_weight}; allowed is 0 to 1"
    );
    ensure!(
        time_s.abs() <= 1e10,
        "--time-s is {time_s}; allowed is -1e10 to 1e10"
    );
    let places: Vec<DVec3> = positions_m
        .chunks_exact(3)
        .map(|three| place("--positions-m", three))
        .collect::<anyhow::Result<_>>()?;
    let origin_m = places[0];
    let world = world(scene, folders, time_s, origin_m)?;
    let frame = CellFrame::at(origin_m, scene.planet().radius_m());
    let points: Vec<_> = places
        .iter()
        .map(|at| {
            let [x, y, z] = frame.from_world(*at).as_vec3().to_array();
            let mut point = [[0.0; 4]; 4];
            point[0] = [x, y, z, detail_weight as f32];
            point
        })
        .collect();
    let ask = |exact: bool| -> anyhow::Result<Vec<Vec<[[f32; 4]; 2]>>> {
        let device = probe(scene, folders, exact, time_s, origin_m)?;
        (0..device.active().len())
            .map(|layer| Ok(device.ask(FieldQuestion::Density, layer, &points)?))
            .collect()
    };
    let (exact, sampled) = (ask(true)?, ask(false)?);
    let lines: Vec<Value> = places
        .iter()
        .enumerate()
        .map(|(index, at)| {
            let position_m = world.frame_from_world_m(*at);
            let layers: Vec<Value> = world
                .layers()
                .iter()
                .enumerate()
                .map(|(place, layer)| {
                    // Outside its altitudes a layer is not asked on the device.
                    let inside = (layer.base_altitude_m..=layer.top_altitude_m).contains(&at.y);
                    let of = |found: &[Vec<[[f32; 4]; 2]>], column: usize| {
                        if inside {
                            found[place][index][0][column]
                        } else {
                            0.0
                        }
                    };
                    json!({
                        "layer": scene.layers()[layer.scene_index].name(),
                        "density": {
                            "f64": world.density(layer, position_m, detail_weight),
                            "device": of(&exact, 0), "device_sampler": of(&sampled, 0),
                        },
                        "density_towards_sun": {
                            "f64": world.smooth_density(layer, position_m),
                            "device": of(&exact, 1), "device_sampler": of(&sampled, 1),
                        },
                    })
                })
                .collect();
            json!({"position_m": at.to_array(), "layers": layers})
        })
        .collect();
    Ok(json!({"time_s": time_s, "detail_weight": detail_weight, "points": lines}))
}

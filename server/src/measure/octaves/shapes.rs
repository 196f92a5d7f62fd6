//! The clouds that scattered light is measured in, and the rays that look at them.

use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::{Scene, ValueError};
use skycell_reference::{Field, LayerField, Ray, World, WorldSettings};
use std::sync::Arc;

/// Elevations of the sun.
pub const SUN_ELEVATIONS_DEG: [f64; 5] = [5.0, 15.0, 30.0, 60.0, 90.0];
/// The layer that every shape stands in, m above the ground.
const LAYER_M: [f64; 2] = [1000.0, 2000.0];
/// Where the finite ones stand: x, altitude, z.
const CENTER_M: DVec3 = DVec3::new(0.0, 1500.0, 0.0);
/// From where these are looked at.
const EYE_DISTANCE_M: f64 = 5000.0;
/// Voxels of a grid along each axis.
const VOXELS: u32 = 16;

/// What fills a shape.
#[derive(Clone, Copy, Debug)]
enum Body {
    /// The whole layer.
    Slab,
    Ball {
        radius_m: f64,
    },
    Box {
        size_m: [f64; 3],
    },
    /// Voxels in a cube as high as the layer.
    Grid(fn(DVec3) -> f64),
}

/// One cloud.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// What it is called.
    pub name: &'static str,
    /// Whether fits leave it out, to be judged by it.
    pub held_out: bool,
    body: Body,
    extinction_per_m: f64,
}

/// Droplets that scatter light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Droplets {
    /// Henyey-Greenstein with the mean cosine of a water cloud.
    Hg,
    /// Droplets of 20 µm.
    HgDraine,
}

impl Droplets {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Hg, Self::HgDraine];

    /// What they are called.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Hg => "hg 0.85",
            Self::HgDraine => "hg-draine 20 µm",
        }
    }

    fn document(self) -> Value {
        match self {
            Self::Hg => json!({"model": "hg", "g": 0.85}),
            Self::HgDraine => json!({"model": "hg-draine", "droplet_diameter_um": 20.0}),
        }
    }
}

/// A ray that looks at a shape.
#[derive(Clone, Debug)]
pub struct View {
    /// Where from, relative to the sun's azimuth.
    pub name: String,
    /// The ray.
    pub ray: Ray,
}

const fn shape(name: &'static str, body: Body, extinction_per_m: f64, held_out: bool) -> Shape {
    Shape {
        name,
        held_out,
        body,
        extinction_per_m,
    }
}

/// All of them, thin to thick. About two in five are held out of fits.
#[must_use]
pub fn shapes() -> Vec<Shape> {
    let ball = |radius_m| Body::Ball { radius_m };
    let cuboid = |x: f64, y: f64, z: f64| Body::Box { size_m: [x, y, z] };
    vec![
        shape("slab 0.5", Body::Slab, 0.5e-3, false),
        shape("slab 1", Body::Slab, 1e-3, true),
        shape("slab 2", Body::Slab, 2e-3, false),
        shape("slab 4", Body::Slab, 4e-3, true),
        shape("slab 8", Body::Slab, 8e-3, false),
        shape("slab 16", Body::Slab, 16e-3, true),
        shape("slab 32", Body::Slab, 32e-3, false),
        shape("slab 64", Body::Slab, 64e-3, false),
        shape("ball 2", ball(450.0), 2.0 / 900.0, false),
        shape("ball 8", ball(450.0), 8.0 / 900.0, true),
        shape("ball 24", ball(450.0), 24.0 / 900.0, false),
        shape("ball 80", ball(450.0), 80.0 / 900.0, true),
        shape("wide box 20", cuboid(2400.0, 400.0, 2400.0), 0.05, false),
        shape("tower 50", cuboid(400.0, 950.0, 400.0), 50.0 / 950.0, true),
        shape("cumulus 30", Body::Grid(cumulus), 0.05, false),
        shape("cumulus 60", Body::Grid(cumulus), 0.1, true),
        shape("fractus 8", Body::Grid(fractus), 0.02, false),
    ]
}

/// Billows of a cloud with a flat base: middle and radius in a cube of edge 2 about the origin.
const BILLOWS: [[f64; 4]; 9] = [
    [0.0, -0.25, 0.0, 0.55],
    [0.35, -0.3, 0.2, 0.4],
    [-0.4, -0.35, -0.1, 0.38],
    [0.1, -0.35, -0.45, 0.35],
    [-0.15, -0.3, 0.45, 0.36],
    [0.05, 0.25, 0.05, 0.42],
    [0.3, 0.15, -0.2, 0.3],
    [-0.25, 0.2, 0.2, 0.3],
    [0.1, 0.55, 0.0, 0.26],
];

/// Density of a heap of billows, at a place in a cube of edge 2.
fn cumulus(at: DVec3) -> f64 {
    if at.y < -0.6 {
        return 0.0;
    }
    let depth = BILLOWS
        .iter()
        .map(|[x, y, z, radius]| radius - (at - DVec3::new(*x, *y, *z)).length())
        .fold(f64::NEG_INFINITY, f64::max);
    // An edge one voxel wide.
    (depth / 0.12).clamp(0.0, 1.0)
}

/// Density of torn scraps with holes between them.
fn fractus(at: DVec3) -> f64 {
    let waves = (7.0 * at.x + 2.0 * at.y).sin() * (6.0 * at.z - at.y).cos()
        + 0.6 * (11.0 * at.y + 3.0 * at.z).sin() * (10.0 * at.x).cos();
    let inside = 1.0 - at.length();
    ((waves + 2.0 * inside - 0.5) / 0.8).clamp(0.0, 1.0)
}

fn towards(elevation_deg: f64, azimuth_deg: f64) -> DVec3 {
    let (sin_up, cos_up) = elevation_deg.to_radians().sin_cos();
    let (sin_azimuth, cos_azimuth) = azimuth_deg.to_radians().sin_cos();
    DVec3::new(cos_up * sin_azimuth, sin_up, -cos_up * cos_azimuth)
}

fn named_azimuth(azimuth_deg: f64) -> &'static str {
    match azimuth_deg as u32 {
        0 => "towards the sun",
        90 => "across",
        _ => "away from the sun",
    }
}

/// Unit vector towards the sun, which stands in the north.
#[must_use]
pub fn towards_sun(elevation_deg: f64) -> DVec3 {
    towards(elevation_deg, 0.0)
}

impl Shape {
    /// The scene of the shape. Layers of light that only the model knows are the document's defaults, with `light` over
    /// them.
    ///
    /// # Errors
    /// For a light that no scene can have.
    pub fn scene(
        &self,
        droplets: Droplets,
        sun_deg: f64,
        light: &Value,
    ) -> Result<Scene, ValueError> {
        let density = match self.body {
            Body::Slab => json!({"model": "homogeneous"}),
            Body::Ball { radius_m } => json!({"model": "homogeneous", "shape":
                {"form": "sphere", "center_m": CENTER_M.to_array(), "radius_m": radius_m}}),
            Body::Box { size_m } => json!({"model": "homogeneous", "shape":
                {"form": "box", "center_m": CENTER_M.to_array(), "size_m": size_m}}),
            Body::Grid(_) => json!({"model": "grid", "file": "generated",
                "dimensions": [VOXELS, VOXELS, VOXELS],
                "bounds_min_m": (CENTER_M - 500.0).to_array(),
                "bounds_max_m": (CENTER_M + 500.0).to_array()}),
        };
        let mut document = json!({
            "version": 1,
            "planet": null,
            "atmosphere": {"model": "uniform"},
            "sun": {"azimuth_deg": 0.0, "elevation_deg": sun_deg, "irradiance_w_per_m2_nm": [1.0, 1.0, 1.0]},
            "layers": [{"name": "shape", "base_altitude_m": LAYER_M[0], "top_altitude_m": LAYER_M[1],
                "density": density, "extinction_per_m": self.extinction_per_m,
                "single_scattering_albedo": 1.0}],
            "light": {"phase": droplets.document(), "sun_march_distance_m": 100_000.0},
            "wind": {"speed_m_per_s": 0.0},
        });
        if let (Some(all), Some(over)) = (document["light"].as_object_mut(), light.as_object()) {
            all.extend(over.clone());
        }
        Scene::from_json(&document)
    }

    /// The shape, ready for rays.
    ///
    /// # Errors
    /// For a light that no scene can have.
    pub fn world(&self, droplets: Droplets, sun_deg: f64, light: &Value) -> anyhow::Result<World> {
        let scene = self.scene(droplets, sun_deg, light)?;
        Ok(World::new(
            &scene,
            Arc::new(self.field()),
            WorldSettings::default(),
        )?)
    }

    fn field(&self) -> Field {
        let Body::Grid(density) = self.body else {
            return Field::default();
        };
        let mut voxels = Vec::new();
        let place = |i: u32| (f64::from(i) + 0.5) / f64::from(VOXELS) * 2.0 - 1.0;
        for z in 0..VOXELS {
            for y in 0..VOXELS {
                for x in 0..VOXELS {
                    voxels.push(density(DVec3::new(place(x), place(y), place(z))) as f32);
                }
            }
        }
        Field {
            noise: None,
            layers: vec![LayerField::Grid(voxels)],
        }
    }

    /// Rays that see it from below, above and around. None looks into the sun itself.
    #[must_use]
    pub fn views(&self) -> Vec<View> {
        let view = |name: String, origin: DVec3, direction: DVec3| {
            Ray::new(origin, direction)
                .ok()
                .map(|ray| View { name, ray })
        };
        let views: Vec<Option<View>> = match self.body {
            Body::Slab => {
                let below = [
                    (25.0, 0.0),
                    (25.0, 180.0),
                    (55.0, 0.0),
                    (55.0, 90.0),
                    (55.0, 180.0),
                    (84.0, 0.0),
                ]
                .map(|(up, azimuth)| ("below", DVec3::ZERO, up, azimuth));
                let above = [
                    (-15.0, 0.0),
                    (-15.0, 180.0),
                    (-45.0, 0.0),
                    (-45.0, 90.0),
                    (-45.0, 180.0),
                    (-84.0, 0.0),
                ]
                .map(|(up, azimuth)| ("above", DVec3::new(0.0, 3000.0, 0.0), up, azimuth));
                below
                    .into_iter()
                    .chain(above)
                    .map(|(side, eye, up, azimuth)| {
                        let name = format!("from {side}, {}° up, {}", up, named_azimuth(azimuth));
                        view(name, eye, towards(up, azimuth))
                    })
                    .collect()
            }
            _ => {
                let around = [
                    (3.0, 0.0),
                    (3.0, 90.0),
                    (3.0, 180.0),
                    (25.0, 0.0),
                    (25.0, 180.0),
                    (70.0, 90.0),
                    (-25.0, 0.0),
                    (-25.0, 180.0),
                    (-70.0, 90.0),
                ];
                around
                    .into_iter()
                    .flat_map(|(up, azimuth)| {
                        let direction = towards(up, azimuth);
                        // Through the middle, and for some beside it.
                        let rim = (up > 0.0 && up < 20.0 && azimuth != 90.0)
                            || (up == 25.0 && azimuth == 180.0);
                        let places = [Some(DVec3::ZERO), rim.then(|| self.beside_m())];
                        places.into_iter().flatten().map(move |off| {
                            let target = CENTER_M + off;
                            let name = format!(
                                "{} at {up}° up, {}",
                                if off == DVec3::ZERO { "middle" } else { "rim" },
                                named_azimuth(azimuth)
                            );
                            view(name, target - direction * EYE_DISTANCE_M, direction)
                        })
                    })
                    .collect()
            }
        };
        views.into_iter().flatten().collect()
    }

    /// A place beside the middle, inside.
    fn beside_m(&self) -> DVec3 {
        match self.body {
            Body::Slab => DVec3::ZERO,
            Body::Ball { radius_m } => DVec3::new(0.45, 0.5, 0.1) * radius_m,
            Body::Box { size_m } => 0.5 * DVec3::new(0.6, 0.7, 0.1) * DVec3::from_array(size_m),
            Body::Grid(_) => DVec3::new(130.0, 120.0, 20.0),
        }
    }

    /// How much longer than through the same medium without voxels a path takes to trace, about.
    #[must_use]
    pub fn cost(&self) -> u64 {
        if matches!(self.body, Body::Grid(_)) {
            8
        } else {
            1
        }
    }
}

//! Pictures: a ray per pixel, traced on all cores in an order that does not show.

use crate::error::checked;
use crate::march::{ConvergeLimit, MarchSteps, converged_ray, march_ray};
use crate::path::{Moments, PathSettings, trace_ray};
use crate::{Ray, RayResult, ReferenceError, World};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::Serialize;
use skycell_protocol::{Camera, FrameSize};

/// Which rays a picture has.
#[derive(Clone, Debug)]
pub enum Projection {
    /// A camera's.
    Pinhole {
        /// Where it stands and looks.
        camera: Camera,
        /// Pixels.
        size: FrameSize,
    },
    /// Parallel rays along a camera's direction, from a rectangle about its position.
    Orthographic {
        /// Where it stands and looks; its angle of view does not count.
        camera: Camera,
        /// Pixels.
        size: FrameSize,
        /// Height of the rectangle, m.
        height_m: f64,
    },
    /// Given ones, in the local frame.
    Rays(Vec<Ray>),
}

/// How a picture is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Renderer {
    /// The shaders' discretisation.
    March(MarchSteps),
    /// The model until it no longer changes.
    Converged {
        /// Relative change that counts as none.
        tolerance: f64,
        /// How far steps may be halved.
        limit: ConvergeLimit,
    },
    /// Monte-Carlo.
    Path {
        /// Paths per pixel.
        samples: u64,
        /// Another number, other paths.
        seed: u64,
        /// How paths are traced.
        settings: PathSettings,
    },
}

/// What the rays of a picture saw, in its rows from the top.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Picture {
    /// Pixels of a row; of given rays, their number.
    pub width: usize,
    /// Rows; 1 of given rays.
    pub height: usize,
    /// One per pixel.
    pub rays: Vec<RayResult>,
    /// Rays that the limit stopped before they converged.
    pub not_converged: u64,
    /// Paths that the safety limit cut.
    pub cut_paths: u64,
    /// Places where density was above its upper bound; not 0 only if the result is wrong.
    pub above_majorant: u64,
}

impl Projection {
    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        match self {
            Self::Pinhole { size, .. } | Self::Orthographic { size, .. } => {
                [size.width() as usize, size.height() as usize]
            }
            Self::Rays(rays) => [rays.len(), 1],
        }
    }

    /// The ray through a point of the picture, in pixels from its upper left corner: a pixel's middle is at one half.
    /// `None` beyond a list of rays.
    #[must_use]
    pub fn ray(&self, world: &World, pixel: DVec2) -> Option<Ray> {
        let [width, height] = self.size().map(|n| n as f64);
        // −1…1 to the right and up.
        let right = 2.0 * pixel.x / width - 1.0;
        let up = 1.0 - 2.0 * pixel.y / height;
        match self {
            Self::Pinhole { camera, .. } => {
                let half = (0.5 * camera.vertical_fov_deg().to_radians()).tan();
                let direction = camera.direction()
                    + camera.right() * (right * half * width / height)
                    + camera.up() * (up * half);
                Some(Ray {
                    origin_m: world.frame_from_world_m(DVec3::from_array(camera.position_m())),
                    direction: direction.normalize_or(camera.direction()),
                })
            }
            Self::Orthographic {
                camera, height_m, ..
            } => {
                let middle = world.frame_from_world_m(DVec3::from_array(camera.position_m()));
                let half_m = 0.5 * height_m;
                Some(Ray {
                    origin_m: middle
                        + camera.right() * (right * half_m * width / height)
                        + camera.up() * (up * half_m),
                    direction: camera.direction(),
                })
            }
            Self::Rays(rays) => rays.get(pixel.x as usize).copied(),
        }
    }

    /// The direction that the composite looks up the clear air in for a pixel: it shares one among two by two, through
    /// the corner where they meet.
    #[must_use]
    pub fn shared_air_direction(&self, world: &World, column: usize, row: usize) -> Option<DVec3> {
        match self {
            Self::Rays(_) => None,
            _ => {
                let corner = DVec2::new((column / 2 * 2 + 1) as f64, (row / 2 * 2 + 1) as f64);
                self.ray(world, corner).map(|ray| ray.direction)
            }
        }
    }
}

/// What one ray of a picture gave, beside its result.
struct Shot {
    result: RayResult,
    not_converged: bool,
    moments: Option<Moments>,
}

fn shoot(
    world: &World,
    ray: &Ray,
    index: u64,
    renderer: &Renderer,
) -> Result<Shot, ReferenceError> {
    Ok(match renderer {
        Renderer::March(steps) => Shot {
            result: march_ray(world, ray, steps),
            not_converged: false,
            moments: None,
        },
        Renderer::Converged { tolerance, limit } => {
            let converged = converged_ray(world, ray, None, *tolerance, limit)?;
            Shot {
                not_converged: !converged.converged,
                result: converged.result,
                moments: None,
            }
        }
        Renderer::Path {
            samples,
            seed,
            settings,
        } => {
            let moments = trace_ray(world, ray, index, 0..*samples, *seed, settings);
            Shot {
                result: moments.result(),
                not_converged: false,
                moments: Some(moments),
            }
        }
    })
}

/// Makes a picture on all cores of rayon's current pool; pixels do not depend on how many there are. `progress` is called
/// after every ray, from any thread.
///
/// # Errors
/// Names a setting that is out of range.
pub fn render(
    world: &World,
    projection: &Projection,
    renderer: &Renderer,
    progress: impl Fn() + Sync,
) -> Result<Picture, ReferenceError> {
    if let Projection::Orthographic { height_m, .. } = projection {
        checked(
            "the height of an orthographic picture",
            *height_m,
            1e-3..=4e7,
            "1e-3 to 4e7 m",
        )?;
    }
    if let Renderer::Path { settings, .. } = renderer {
        settings.check()?;
    }
    if let Renderer::March(steps) = renderer {
        steps.check()?;
    }
    let [width, height] = projection.size();
    let shots = (0..width * height)
        .into_par_iter()
        .map(|index| {
            let (column, row) = (index % width, index / width);
            let pixel = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
            let shot = projection
                .ray(world, pixel)
                .map(|ray| shoot(world, &ray, index as u64, renderer))
                .transpose();
            progress();
            shot
        })
        .collect::<Result<Vec<Option<Shot>>, ReferenceError>>()?;
    let mut picture = Picture {
        width,
        height,
        rays: Vec::with_capacity(shots.len()),
        not_converged: 0,
        cut_paths: 0,
        above_majorant: 0,
    };
    for shot in shots.into_iter().flatten() {
        picture.not_converged += u64::from(shot.not_converged);
        if let Some(moments) = shot.moments {
            picture.cut_paths += moments.cut_paths;
            picture.above_majorant += moments.above_majorant;
        }
        picture.rays.push(shot.result);
    }
    Ok(picture)
}

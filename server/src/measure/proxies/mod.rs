//! `skycell-server measure proxies`: the same figures for each setup of proxies.
//!
//! `setups` is what is compared, `report` what comes of it. Directions, distances and views are those of `measure distance`.

mod report;
mod setups;

use super::arguments::{parsed_metres, parsed_size};
use super::distance::plan::{Direction, Fineness, Variant, View};
use super::distance::{asked, rgb_of};
use super::metrics::shown_errors;
use super::progress::Progress;
use super::store::{write_json, write_whole};
use crate::frame_loop::{FrameCosts, StillFrame, StillRenderer, StillSettings};
use crate::march::ProxySetup;
use crate::quality::default_parallax_steps;
use crate::render_command::{Folders, read_scene};
use anyhow::Context;
use glam::DVec3;
use image::RgbImage;
use report::{ProxiesReport, ProxyPoint};
use setups::{Kept, SETUPS};
use skycell_protocol::{Camera, FrameSize, Scene};
use std::path::PathBuf;
use std::sync::Arc;

/// GPU memory for the cache.
const CACHE_MEMORY_MIB: u32 = 2048;
/// Height of the eye, m.
const EYE_M: f64 = 2.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;
/// Times that a picture is composited to find out what that costs.
const TIMED: u32 = 3;

/// What `measure proxies` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct ProxiesArguments {
    /// Folder of the results: proxies.json, proxies.md and proxies.html.
    #[arg(long, default_value = "skycell-proxies", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it. The wind stands still.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Size of the pictures.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size, default_value = "320x180")]
    pub size: FrameSize,
    /// Steps through a layer's thickness.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: u32,
    /// Samples of a pixel and of a texel.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: u32,
    /// Only these setups; all without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "SETUP,...")]
    pub only: Vec<ProxySetup>,
    /// Only these views; both without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "VIEW,...")]
    pub views: Vec<View>,
    /// Only these directions; all without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "DIRECTION,...")]
    pub directions: Vec<Direction>,
    /// Only these distances, m, from small to large; those of the direction without. Upwards those are left out that are in or above a
    /// layer.
    #[arg(long, value_delimiter = ',', value_name = "M,...", value_parser = parsed_metres)]
    pub distances_m: Vec<f64>,
    /// Where the middle of the pictures looks above the horizon.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Also write every picture.
    #[arg(long)]
    pub pictures: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

impl ProxiesArguments {
    fn distances_m(&self, direction: Direction, scene: &Scene) -> Vec<f64> {
        let asked_m = match &self.distances_m[..] {
            [] => direction.distances_m(false),
            asked_m => asked_m,
        };
        direction.shared_m(scene, EYE_M, asked_m)
    }
}

/// Measures and writes the report.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub(super) fn run(arguments: &ProxiesArguments) -> anyhow::Result<()> {
    let out = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| format!("--out {} cannot be made", out.display()))?;
    let report = measured(arguments)?;
    let text = report.markdown();
    write_json(&out.join("proxies.json"), &report)?;
    write_whole(&out.join("proxies.md"), text.as_bytes())?;
    write_whole(&out.join("proxies.html"), report.page().as_bytes())?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        println!("{text}{}", out.join("proxies.html").display());
    }
    Ok(())
}

/// Renders and compares.
struct Bench<'a> {
    arguments: &'a ProxiesArguments,
    still: StillRenderer,
    fineness: Fineness,
}

/// What is shown from a place.
struct Seen {
    searched: bool,
    picture: RgbImage,
    marches: u64,
    composite_ns: Option<u64>,
}

fn measured(arguments: &ProxiesArguments) -> anyhow::Result<ProxiesReport> {
    let scene = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    let config = folders.render_config(CACHE_MEMORY_MIB);
    let sun_azimuth_deg = scene.sun().azimuth_deg();
    let mut bench = Bench {
        arguments,
        still: StillRenderer::new(config, Arc::new(scene.clone()), &[])?,
        fineness: Fineness {
            steps: arguments.steps,
            samples: arguments.samples,
        },
    };
    let setups: Vec<&Kept> = SETUPS
        .iter()
        .filter(|kept| arguments.only.is_empty() || arguments.only.contains(&kept.setup))
        .collect();
    let views = asked(&View::ALL, &arguments.views);
    let directions = asked(&Direction::ALL, &arguments.directions);
    let distances = directions
        .iter()
        .map(|d| arguments.distances_m(*d, &scene).len());
    let places = setups.len() * views.len() * distances.sum::<usize>();
    let mut progress = Progress::new(places as u64, places as f64);
    let mut points = Vec::new();
    for view in views {
        let yaw_deg = view.yaw_deg(sun_azimuth_deg);
        let eye = Camera::new([0.0, EYE_M, 0.0], yaw_deg, arguments.pitch_deg, FOV_DEG)
            .context("the camera (--pitch-deg)")?;
        let truth = bench.own_rays(eye)?;
        for kept in &setups {
            for direction in &directions {
                for distance_m in arguments.distances_m(*direction, &scene) {
                    let label = format!(
                        "{}, {}, {} {distance_m} m",
                        kept.name,
                        view.name(),
                        direction.name()
                    );
                    progress.begin(&label, 1.0);
                    let is_compared = distance_m == direction.compared_at_m();
                    let offset_m = direction.offset_m(&eye, distance_m);
                    let seen = bench
                        .seen(&eye, kept, offset_m, is_compared)
                        .with_context(|| label.clone())?;
                    let mut flips = Vec::new();
                    for one in seen {
                        let errors = shown_errors(&truth, &one.picture)?;
                        flips.push(format!("{:.4}", errors.flip));
                        if arguments.pictures {
                            let read = if one.searched { "searched" } else { "alone" };
                            let name = format!("{label}, {read}").replace([' ', ',', '.'], "_");
                            let path = arguments.out.join(format!("{name}.png"));
                            one.picture.save(path)?;
                        }
                        points.push(ProxyPoint {
                            setup: kept.name,
                            searched: one.searched,
                            view,
                            direction: *direction,
                            distance_m,
                            errors,
                            marches: one.marches,
                            bytes: bench.still.resident_bytes(),
                            composite_ns: one.composite_ns,
                        });
                    }
                    progress.done(&format!("FLIP {}", flips.join(", searched ")));
                }
            }
        }
    }
    progress.finish();
    let place_of = |p: &ProxyPoint| SETUPS.iter().position(|kept| kept.name == p.setup);
    points.sort_by_key(|p| (place_of(p), p.searched));
    Ok(ProxiesReport {
        adapter: bench.still.adapter(),
        size: arguments.size,
        steps: arguments.steps,
        samples: arguments.samples,
        points,
    })
}

impl Bench<'_> {
    fn own_rays(&mut self, eye: Camera) -> anyhow::Result<RgbImage> {
        let settings = self.fineness.screen_space();
        let size = self.arguments.size;
        let picture = self.still.render_with(eye, size, &settings, |_| {})?;
        rgb_of(size, &picture.display)
    }

    /// What the eye sees of texels that were marched from an offset, alone and searched.
    fn seen(
        &mut self,
        eye: &Camera,
        kept: &Kept,
        offset_m: DVec3,
        is_timed: bool,
    ) -> anyhow::Result<Vec<Seen>> {
        let settings = StillSettings {
            slabs: kept.slabs,
            proxies: kept.setup,
            bands: kept.bands,
            band_ends: kept.ends,
            ..self.fineness.cached(Variant::Phase, offset_m)
        };
        match kept.followed_m {
            Some(step_m) => {
                let way = way_to(eye, offset_m, step_m)?;
                [false, true]
                    .map(|searched| self.followed(&way, settings, step_m, searched))
                    .into_iter()
                    .collect()
            }
            None => self.beside(eye, settings, is_timed),
        }
    }

    /// From caches whose rays start beside the eye: both ways to read the same texels.
    fn beside(
        &mut self,
        eye: &Camera,
        settings: StillSettings,
        is_timed: bool,
    ) -> anyhow::Result<Vec<Seen>> {
        let size = self.arguments.size;
        let frames = [false, true].map(|searched| StillFrame {
            camera: *eye,
            parallax_steps: places_of(searched),
            phase_of_reference: false,
        });
        let costs = FrameCosts {
            timed: if is_timed { TIMED } else { 0 },
            counts_reads: false,
        };
        let mut seen = Vec::new();
        let mut marches = 0;
        self.still.render_frames(
            size,
            &settings,
            &frames,
            costs,
            |index, display, figures| {
                // A search may want texels that the first did not.
                marches += figures.marches;
                seen.push((index == 1, display, marches, figures.composite_ns));
                Ok(())
            },
        )?;
        seen.into_iter()
            .map(|(searched, display, marches, composite_ns)| {
                Ok(Seen {
                    searched,
                    picture: rgb_of(size, &display)?,
                    marches,
                    composite_ns,
                })
            })
            .collect()
    }

    /// From caches that have followed the eye along a way.
    fn followed(
        &mut self,
        way: &[Camera],
        settings: StillSettings,
        step_m: f64,
        searched: bool,
    ) -> anyhow::Result<Seen> {
        let settings = StillSettings {
            dome_follow_m: step_m,
            parallax_steps: places_of(searched),
            ..settings
        };
        let size = self.arguments.size;
        let picture = self.still.render_followed(way, size, &settings, |_| {})?;
        Ok(Seen {
            searched,
            picture: rgb_of(size, &picture.display)?,
            marches: picture.figures.marches,
            composite_ns: None,
        })
    }
}

fn places_of(searched: bool) -> u32 {
    if searched {
        default_parallax_steps()
    } else {
        0
    }
}

/// Places from an offset to an eye, so far apart that domes follow at each.
fn way_to(eye: &Camera, offset_m: DVec3, step_m: f64) -> anyhow::Result<Vec<Camera>> {
    // A little more than the setting, which must be passed.
    let steps = ((offset_m.length() / (1.001 * step_m)).floor() as u32).max(1);
    (0..=steps)
        .map(|step| {
            let left = 1.0 - f64::from(step) / f64::from(steps);
            let at = DVec3::from_array(eye.position_m()) + offset_m * left;
            let (yaw_deg, pitch_deg) = (eye.yaw_deg(), eye.pitch_deg());
            let camera = Camera::new(at.to_array(), yaw_deg, pitch_deg, eye.vertical_fov_deg());
            camera.context("a camera on the way")
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_ends_at_the_eye_and_its_steps_pass_the_setting() {
        let eye = Camera::new([0.0, EYE_M, 0.0], 30.0, 20.0, 60.0).expect("a camera");
        for (length_m, step_m, most) in [(0.0, 100.0, 2), (300.0, 100.0, 3), (3_000.0, 300.0, 10)] {
            let way = way_to(&eye, DVec3::X * length_m, step_m).expect("cameras");
            assert_eq!(way.last(), Some(&eye));
            assert!(way.len() <= most, "{} places", way.len());
            if let [first, second, ..] = way[..] {
                let [a, b] = [first, second].map(|c| DVec3::from_array(c.position_m()));
                assert!(length_m == 0.0 || a.distance(b) > step_m);
            }
        }
    }
}

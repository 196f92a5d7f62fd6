//! `skycell-server measure proxies`: the same figures for each setup of proxies.

use super::arguments::parsed_size;
use super::metrics::{ShownErrors, shown_errors};
use super::progress::Progress;
use super::reference::without_alpha;
use super::store::{write_json, write_whole};
use crate::frame_loop::{StillPicture, StillRenderer, StillSettings};
use crate::march::{BandEnds, MarchSettings, ProxySetup};
use crate::render_command::{Folders, read_scene};
use anyhow::Context;
use glam::DVec3;
use image::RgbImage;
use serde::Serialize;
use skycell_protocol::{Camera, FrameSize, RendererKind};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::Arc;

/// GPU memory for the cache.
const CACHE_MEMORY_MIB: u32 = 2048;
/// Height of the eye, m.
const EYE_M: f64 = 2.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;

/// What `measure proxies` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct ProxiesArguments {
    /// Folder of the results: proxies.json and proxies.md.
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
    /// Where the middle of the pictures looks, clockwise from north.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub yaw_deg: f64,
    /// And above the horizon.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Also write every picture.
    #[arg(long)]
    pub pictures: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
}

/// A setup with what it is told.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Kept {
    name: &'static str,
    setup: ProxySetup,
    slabs: u32,
    bands: u32,
    ends: BandEnds,
    /// How far the reference goes before its domes follow, m: the viewer comes from elsewhere, and what it is shown is resampled.
    followed_m: Option<f64>,
}

const PLAIN: Kept = Kept {
    name: "in-layer",
    setup: ProxySetup::InLayer,
    slabs: 1,
    bands: 3,
    ends: BandEnds::Cut,
    followed_m: None,
};
const NESTED: Kept = Kept {
    name: "nested domes, 3 bands",
    setup: ProxySetup::NestedDomes,
    ..PLAIN
};
const FOLLOWING: Kept = Kept {
    name: "following dome, every 100 m",
    setup: ProxySetup::FollowingDome,
    followed_m: Some(100.0),
    ..PLAIN
};

/// Everything that is compared.
const SETUPS: [Kept; 9] = [
    PLAIN,
    Kept {
        name: "in-layer, 4 slabs",
        slabs: 4,
        ..PLAIN
    },
    Kept {
        name: "static dome",
        setup: ProxySetup::StaticDome,
        ..PLAIN
    },
    FOLLOWING,
    Kept {
        name: "following dome, every 300 m",
        followed_m: Some(300.0),
        ..FOLLOWING
    },
    Kept {
        name: "nested domes, 2 bands",
        bands: 2,
        ..NESTED
    },
    NESTED,
    Kept {
        name: "nested domes, 3 bands, gaps",
        ends: BandEnds::Gaps,
        ..NESTED
    },
    Kept {
        name: "nested domes, 4 bands",
        bands: 4,
        ..NESTED
    },
];

/// Where texels were marched, seen from the eye: to the right, up, ahead, m.
const PLACES: [(&str, [f64; 3]); 7] = [
    ("0", [0.0, 0.0, 0.0]),
    ("0.3 km aside", [300.0, 0.0, 0.0]),
    ("1 km aside", [1_000.0, 0.0, 0.0]),
    ("3 km aside", [3_000.0, 0.0, 0.0]),
    ("1 km ahead", [0.0, 0.0, 1_000.0]),
    ("0.3 km up", [0.0, 300.0, 0.0]),
    ("1.1 km up", [0.0, 1_100.0, 0.0]),
];

/// What one setup shows from one place.
#[derive(Clone, Debug, Serialize)]
struct Shown {
    setup: &'static str,
    /// Whether viewers look for what texels show along their own rays.
    searched: bool,
    place: &'static str,
    #[serde(flatten)]
    errors: ShownErrors,
    /// Samples of texels that were marched.
    marches: u64,
    /// GPU memory of the tiles that are there, bytes.
    bytes: u64,
    /// Device time of the picture from the cache, where it can tell.
    composite_ns: u64,
}

/// Measures and writes the table.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub(super) fn run(arguments: &ProxiesArguments) -> anyhow::Result<()> {
    let out = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| format!("--out {} cannot be made", out.display()))?;
    let shown = measured(arguments)?;
    let table = table(&shown);
    write_json(&out.join("proxies.json"), &shown)?;
    write_whole(&out.join("proxies.md"), table.as_bytes())?;
    println!("{table}");
    Ok(())
}

fn measured(arguments: &ProxiesArguments) -> anyhow::Result<Vec<Shown>> {
    let scene = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    let config = folders.render_config(CACHE_MEMORY_MIB);
    let mut still = StillRenderer::new(config, Arc::new(scene), &[])?;
    let eye = Camera::new(
        [0.0, EYE_M, 0.0],
        arguments.yaw_deg,
        arguments.pitch_deg,
        FOV_DEG,
    )
    .context("the camera (--yaw-deg, --pitch-deg)")?;
    let size = arguments.size;
    let screen_space = StillSettings {
        renderer: RendererKind::ScreenSpace,
        march: MarchSettings {
            steps: arguments.steps,
            ..MarchSettings::default()
        },
        samples: arguments.samples,
        ..StillSettings::default()
    };
    let truth = still.render_with(eye, size, &screen_space, |_| {})?;
    let truth = rgb(&truth)?;
    if arguments.pictures {
        truth.save(arguments.out.join("screen-space.png"))?;
    }
    let setups: Vec<&Kept> = SETUPS
        .iter()
        .filter(|kept| arguments.only.is_empty() || arguments.only.contains(&kept.setup))
        .collect();
    let pictures = setups.len() * 2 * PLACES.len();
    let mut progress = Progress::new(pictures as u64, pictures as f64);
    let mut found = Vec::new();
    for kept in setups {
        for searched in [false, true] {
            for (place, way) in PLACES {
                let label = format!(
                    "{}, {}, {place}",
                    kept.name,
                    if searched { "searched" } else { "alone" }
                );
                progress.begin(&label, 1.0);
                let ahead = DVec3::Y.cross(eye.right());
                let offset_m = eye.right() * way[0] + DVec3::Y * way[1] + ahead * way[2];
                let settings = StillSettings {
                    renderer: RendererKind::Cached,
                    parallax_steps: if searched {
                        screen_space.parallax_steps
                    } else {
                        0
                    },
                    slabs: kept.slabs,
                    proxies: kept.setup,
                    bands: kept.bands,
                    band_ends: kept.ends,
                    reference_offset_m: offset_m.to_array(),
                    dome_follow_m: kept.followed_m.unwrap_or(screen_space.dome_follow_m),
                    ..screen_space
                };
                let before = still.gpu_times_ns()[1];
                let picture = match kept.followed_m {
                    Some(step_m) => {
                        let way = way_to(&eye, offset_m, step_m)?;
                        still.render_followed(&way, size, &settings, |share| {
                            progress.share(share);
                        })?
                    }
                    None => still
                        .render_with(eye, size, &settings, |share| progress.share(share))
                        .with_context(|| label.clone())?,
                };
                let composite_ns = still.gpu_times_ns()[1] - before;
                let seen = rgb(&picture)?;
                let errors = shown_errors(&truth, &seen)?;
                if arguments.pictures {
                    let name = label.replace([' ', ',', '.'], "_");
                    seen.save(arguments.out.join(format!("{name}.png")))?;
                }
                progress.done(&format!("FLIP {:.4}", errors.flip));
                found.push(Shown {
                    setup: kept.name,
                    searched,
                    place,
                    errors,
                    marches: picture.figures.marches,
                    bytes: still.resident_bytes(),
                    composite_ns,
                });
            }
        }
    }
    progress.finish();
    Ok(found)
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

fn rgb(picture: &StillPicture) -> anyhow::Result<RgbImage> {
    let (width, height) = (picture.size.width(), picture.size.height());
    RgbImage::from_raw(width, height, without_alpha(&picture.display))
        .context("the device gave a picture of another size")
}

/// A row for each setup and way to read it: FLIP / SSIM from each place, then what it takes from the first.
fn table(shown: &[Shown]) -> String {
    let mut text = String::from("| setup | read |");
    for (place, _) in PLACES {
        let _ = write!(text, " {place} |");
    }
    text.push_str(" million rays | MB | composite, ms |\n|");
    text.push_str(&" --- |".repeat(PLACES.len() + 5));
    text.push('\n');
    for row in shown.chunks(PLACES.len()) {
        let Some(first) = row.first() else { continue };
        let read = if first.searched { "searched" } else { "alone" };
        let _ = write!(text, "| {} | {read} |", first.setup);
        for one in row {
            let _ = write!(text, " {:.4} / {:.3} |", one.errors.flip, one.errors.ssim);
        }
        // Away from the reference, a search is part of the picture; the first place has none. A driver's first dispatch of a
        // pipeline takes longer.
        let beside = row.iter().skip(1).map(|one| one.composite_ns);
        let composite_ns = beside.min().unwrap_or(first.composite_ns);
        let _ = writeln!(
            text,
            " {:.2} | {:.1} | {:.0} |",
            first.marches as f64 / 1e6,
            first.bytes as f64 / 1e6,
            composite_ns as f64 / 2e6
        );
    }
    text
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

    #[test]
    fn the_table_has_a_row_for_each_way_to_read_a_setup() {
        let one = Shown {
            setup: "static dome",
            searched: false,
            place: "0",
            errors: ShownErrors {
                flip: 0.01,
                ssim: 0.99,
            },
            marches: 2_500_000,
            bytes: 13_000_000,
            composite_ns: 4_000_000,
        };
        let text = table(&vec![one; 2 * PLACES.len()]);
        assert_eq!(text.lines().count(), 4);
        let last = text.lines().last().expect("a row");
        assert!(last.ends_with("| 2.50 | 13.0 | 2 |"), "{last}");
    }
}

//! A renderer of its own that shows Skycell's clouds: gets one frame of clouds alone for its camera, puts them over a sky, a
//! ground and a ball with a depth of their own, and writes a PNG.
//!
//! ```text
//! skycell-server serve &
//! cargo run --release -p skycell-client --example composite_clouds -- --out clouds.png
//! ```

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::Parser;
use glam::{DVec3, Vec3, dvec3, vec3};
use image::{Rgb, RgbImage};
use skycell_client::clouds_file::clouds_of;
use skycell_client::{Connection, ConnectionLimits, Event, Frame, ServerAddress};
use skycell_protocol::clouds::Clouds;
use skycell_protocol::message::{Acknowledgement, Hello};
use skycell_protocol::{Camera, Codec, FrameSize};

/// Composites clouds over a world of its own.
#[derive(Debug, Parser)]
struct Arguments {
    /// The server's address.
    #[arg(long, default_value = "ws://127.0.0.1:8080/ws")]
    url: ServerAddress,
    /// The PNG to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Pixels in a row.
    #[arg(long, default_value_t = 960)]
    width: u32,
    /// Rows.
    #[arg(long, default_value_t = 540)]
    height: u32,
    /// Degrees from north, clockwise.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    yaw_deg: f64,
    /// Brightness of the clouds in the picture.
    #[arg(long, default_value_t = 12.0)]
    exposure: f32,
    /// How long the clouds may take to get sharp.
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0)]
    wait_s: f64,
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let camera = Camera::new([0.0, 30.0, 0.0], arguments.yaw_deg, 14.0, 60.0)?;
    let size = FrameSize::new(arguments.width, arguments.height)?;
    let frame = sharp_frame(&arguments, camera, size).await?;
    let clouds = clouds_of(&frame.header, frame.payload())?;
    let world = World::before(&camera);
    let picture = RgbImage::from_fn(size.width(), size.height(), |column, row| {
        let ray = ray_of(&camera, size, column, row);
        let seen = world.look(DVec3::from_array(camera.position_m()), ray);
        let pixel = (row * size.width() + column) as usize;
        shown(composite(&clouds, pixel, seen, arguments.exposure))
    });
    picture.save(&arguments.out)?;
    println!(
        "{}: {} bytes of clouds, {:.1} a pixel",
        arguments.out.display(),
        frame.payload().len(),
        frame.payload().len() as f64 / f64::from(size.pixels())
    );
    Ok(())
}

/// The first frame to which nothing finer comes, or the last one within the time.
async fn sharp_frame(
    arguments: &Arguments,
    camera: Camera,
    size: FrameSize,
) -> anyhow::Result<Frame> {
    let hello = Hello {
        codec: Codec::Clouds,
        // Its own air is clear: what haze does to clouds is left to Skycell.
        haze: true,
        ..Hello::new(size, 10.0, camera)
    };
    let mut connection =
        Connection::open(&arguments.url, hello, ConnectionLimits::default()).await?;
    let until = tokio::time::Instant::now() + Duration::from_secs_f64(arguments.wait_s);
    let mut newest: Option<Frame> = None;
    while let Ok(event) = tokio::time::timeout_at(until, connection.next_event()).await {
        match event? {
            Event::Frame(frame) => {
                let acknowledgement = Acknowledgement::of(frame.header.sequence);
                connection.acknowledge(acknowledgement).await?;
                let is_exact = frame.header.exact;
                newest = Some(frame);
                if is_exact {
                    break;
                }
            }
            Event::Complaint(complaint) => anyhow::bail!("the server: {}", complaint.message),
            _ => {}
        }
    }
    connection.close().await;
    newest.context("no frame came in time")
}

/// What the renderer itself sees along a ray.
struct Seen {
    /// Linear, in the picture's brightness.
    colour: Vec3,
    /// How far away it is along the ray, m; infinite for the sky.
    depth_m: f32,
}

/// Clouds over what the renderer sees. They stand at their mean distance: something nearer hides them, something farther is
/// seen through them. A cloud is no surface, so things that it touches go into it softly, over a fifth of the distance.
fn composite(clouds: &Clouds, pixel: usize, seen: Seen, exposure: f32) -> Vec3 {
    let distance_m = clouds.distance_m(pixel);
    let in_front = if distance_m > 0.0 && seen.depth_m.is_finite() {
        ((seen.depth_m / distance_m - 0.9) / 0.2).clamp(0.0, 1.0)
    } else {
        1.0
    };
    let opacity = in_front * (1.0 - clouds.transmittance(pixel));
    let colour = in_front * exposure * Vec3::from_array(clouds.radiance(pixel));
    seen.colour * (1.0 - opacity) + colour
}

/// A plain of fields, a ball and a clear sky.
struct World {
    ball_centre_m: DVec3,
    ball_radius_m: f64,
}

impl World {
    fn before(camera: &Camera) -> Self {
        let ahead = camera.direction().with_y(0.0).normalize();
        let aside = camera.right();
        let eye_m = DVec3::from_array(camera.position_m());
        Self {
            // It reaches from 900 m up into the cumulus.
            ball_centre_m: eye_m + ahead * 6_500.0 + aside * 900.0 + DVec3::Y * 2_300.0,
            ball_radius_m: 1_400.0,
        }
    }

    fn look(&self, eye_m: DVec3, ray: DVec3) -> Seen {
        let sun = dvec3(0.4, 0.7, 0.55).normalize();
        if let Some(depth_m) = self.ball_depth_m(eye_m, ray) {
            let normal = (eye_m + ray * depth_m - self.ball_centre_m).normalize();
            let light = 0.15 + 0.85 * normal.dot(sun).max(0.0);
            return Seen {
                colour: vec3(0.75, 0.16, 0.08) * light as f32,
                depth_m: depth_m as f32,
            };
        }
        let haze = vec3(0.55, 0.66, 0.80);
        if ray.y < 0.0 {
            let depth_m = eye_m.y / -ray.y;
            let at = (eye_m + ray * depth_m) / 250.0;
            let is_light = (at.x.floor() + at.z.floor()).rem_euclid(2.0) < 1.0;
            let field = if is_light {
                vec3(0.16, 0.24, 0.08)
            } else {
                vec3(0.10, 0.18, 0.05)
            };
            let clear = (-depth_m / 9_000.0).exp() as f32;
            return Seen {
                colour: field * clear + haze * (1.0 - clear),
                depth_m: depth_m as f32,
            };
        }
        let zenith = vec3(0.10, 0.26, 0.62);
        let share = ray.y.powf(0.45) as f32;
        Seen {
            colour: haze.lerp(zenith, share),
            depth_m: f32::INFINITY,
        }
    }

    fn ball_depth_m(&self, eye_m: DVec3, ray: DVec3) -> Option<f64> {
        let from_centre = eye_m - self.ball_centre_m;
        let along = from_centre.dot(ray);
        let inside = along * along - from_centre.length_squared() + self.ball_radius_m.powi(2);
        let depth_m = -along - inside.max(0.0).sqrt();
        (inside >= 0.0 && depth_m > 0.0).then_some(depth_m)
    }
}

/// Through the middle of a pixel.
fn ray_of(camera: &Camera, size: FrameSize, column: u32, row: u32) -> DVec3 {
    let half_height = (camera.vertical_fov_deg().to_radians() / 2.0).tan();
    let half_width = half_height * f64::from(size.width()) / f64::from(size.height());
    let x = 2.0 * (f64::from(column) + 0.5) / f64::from(size.width()) - 1.0;
    let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / f64::from(size.height());
    let ray = camera.direction() + camera.right() * half_width * x + camera.up() * half_height * y;
    ray.normalize()
}

/// Reinhard's curve by luminance, and sRGB.
fn shown(colour: Vec3) -> Rgb<u8> {
    let luminance = colour.dot(vec3(0.2126, 0.7152, 0.0722));
    let white = 4.0;
    let curve = (1.0 + luminance / (white * white)) / (1.0 + luminance);
    let encode = |linear: f32| {
        let linear = linear.clamp(0.0, 1.0);
        if linear <= 0.003_130_8 {
            12.92 * linear
        } else {
            1.055 * linear.powf(1.0 / 2.4) - 0.055
        }
    };
    Rgb((colour * curve)
        .to_array()
        .map(|channel| (encode(channel) * 255.0).round() as u8))
}

use super::sky::*;
use glam::DVec3;
use skycell_protocol::FrameSize;
use skycell_reference::sky::SkyLight;
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{RayPicture, StillRay, StillRenderer, StillSettings};
use std::io::Write;

pub fn from_disk(path: &str, source: &str) -> String {
    if path.starts_with("sky/") {
        std::fs::read_to_string(format!("/tmp/wt/atmosphere/shaders/wgsl/{path}")).expect("x")
    } else {
        source.to_owned()
    }
}

#[test]
fn explore() {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let mut still = StillRenderer::new(config, scene(40.0), &[]).expect("a device");
    still.plant(Some(from_disk)).expect("shader");
    let mut out = std::fs::File::create("/tmp/air_dump.txt").expect("f");
    let alts: Vec<f64> = std::env::var("ALTS").unwrap_or("-100,0,2,500,2000,5000,12000,50000,100000,400000".into()).split(',').map(|x| x.parse().expect("n")).collect();
    for altitude_m in alts {
        for elevation_deg in SUNS_DEG {
            let scene = scene(elevation_deg);
            still.set_scene(scene.clone()).expect("a scene");
            let cache = format!("/tmp/air_truth2/{altitude_m}_{elevation_deg}.txt");
            let rays = rays(altitude_m, scene_sun(&scene));
            let truth: Vec<DVec3> = if let Ok(text) = std::fs::read_to_string(&cache) {
                text.lines().map(|l| { let v: Vec<f64> = l.split(' ').map(|x| x.parse().expect("n")).collect(); DVec3::new(v[0], v[1], v[2]) }).collect()
            } else {
                let light = SkyLight::new(&scene, 0.0);
                let of = |rays: &[skycell_reference::Ray]| -> Vec<DVec3> { rays.iter().map(|ray| light.background(ray, ray.direction).without_sun).collect() };
                let (first, second) = rays.split_at(DIRECTIONS / 2);
                let truth = std::thread::scope(|scope| {
                    let other = scope.spawn(|| of(second));
                    let mut truth = of(first);
                    truth.extend(other.join().expect("no panic"));
                    truth
                });
                std::fs::create_dir_all("/tmp/air_truth2").expect("d");
                let text: String = truth.iter().map(|t| format!("{:e} {:e} {:e}\n", t.x, t.y, t.z)).collect();
                std::fs::write(&cache, text).expect("w");
                truth
            };
            let list = RayPicture {
                frame_m: DVec3::ZERO,
                size: FrameSize::new(DIRECTIONS as u32, 1).expect("a size"),
                pixel_m: [DVec3::ZERO; 2],
                rays: rays.iter().map(|ray| StillRay { origin_m: ray.origin_m, direction: ray.direction }).collect(),
            };
            let start = std::time::Instant::now();
            let figures = still.render_rays(&list, &StillSettings::default(), |_| {}).expect("pictures");
            let took = start.elapsed();
            let mut errors = Vec::new();
            for ((ray, truth), seen) in rays.iter().zip(&truth).zip(&figures.radiance) {
                for c in 0..3 {
                    errors.push((f64::from(seen[c]) - truth[c]).abs() * 100.0 / truth[c].max(1.2e-8));
                }
                writeln!(out, "{altitude_m} {elevation_deg} {:.7} {:.7} {:.7} {:e} {:e} {:e} {:e} {:e} {:e}", ray.direction.x, ray.direction.y, ray.direction.z, truth.x, truth.y, truth.z, seen[0], seen[1], seen[2]).expect("w");
            }
            errors.sort_by(f64::total_cmp);
            let n = errors.len() - 1;
            println!("{altitude_m} m {elevation_deg}: p50 {:.3} p95 {:.3} p99 {:.3} worst {:.3}  {took:?}", errors[n / 2], errors[n * 95 / 100], errors[n*99/100], errors[n]);
        }
    }
}


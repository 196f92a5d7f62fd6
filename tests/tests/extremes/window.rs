//! Temporal windows: any size and plan, cameras that turn, cut and come to rest, and thousands of frames.

use super::line::Line;
use super::stage::{SCREEN, Stage, eye, relative_l2, settings, size, slab, weather};
use serde_json::json;
use skycell_server::frame_loop::StillSettings;
use skycell_server::march::WindowPlan;

fn windowed(frames: u32, divisor: u32, depth_segments: u32, refinement: u32) -> StillSettings {
    StillSettings {
        window: Some(WindowPlan {
            frames,
            divisor,
            depth_segments,
            refinement,
        }),
        frames,
        ..settings(SCREEN)
    }
}

const PIXEL_DEG: f64 = 60.0 / 36.0;

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("temporal window");
    let camera = |yaw_deg| eye([0.0, 2.0, 0.0], yaw_deg, 30.0, 60.0);
    stage.scene(&weather(json!({})));
    for (width, height) in [(1, 1), (2, 1), (1, 60), (17, 3), (3840, 1)] {
        for plan in [
            (1, 1, 1, 1),
            (1, 4, 1, 1),
            (5, 2, 2, 16),
            (16, 1, 16, 4),
            (16, 4, 3, 2),
        ] {
            let (frames, divisor, segments, refinement) = plan;
            let settings = windowed(frames, divisor, segments, refinement);
            let picture = stage.look_with(camera(0.0), size(width, height), &settings);
            line.picture(format!("{width} x {height}, {plan:?}"), &picture);
        }
    }

    let picture = size(64, 36);
    for (divisor, turn_deg) in [(1, 1.5), (4, 1.5), (4, -40.0), (4, 180.0)] {
        let still = StillSettings {
            window: Some(WindowPlan {
                frames: 16,
                divisor,
                depth_segments: 1,
                refinement: 1,
            }),
            frames: 16,
            ..settings(SCREEN)
        };
        let at_rest = stage.look_with(camera(0.0), picture, &still);
        let turning = StillSettings {
            frames: 24,
            turn_deg_per_frame: turn_deg,
            ..still
        };
        let what = format!("1/{divisor} sides, {turn_deg} degrees a frame");
        let turned = stage.look_with(camera(0.0), picture, &turning);
        line.picture(&what, &turned);
        if turn_deg == 1.5 {
            // Samples are looked up to the nearest pixel: the picture is nearer to the still one than that is to one a
            // marched pixel beside it.
            let step_deg = PIXEL_DEG * f64::from(divisor);
            let beside = stage.look_with(camera(step_deg), picture, &still);
            line.holds(
                &what,
                relative_l2(&at_rest, &turned),
                relative_l2(&at_rest, &beside),
            );
        }
        // Whatever was seen before: a window later nothing of it is left, to the last bit.
        let rested = StillSettings {
            frames: 24,
            resting_frames: 16,
            ..turning
        };
        let rested = stage.look_with(camera(0.0), picture, &rested);
        line.case();
        line.is(
            format!("{what}, then at rest: as if it had never moved"),
            at_rest.linear == rested.linear,
        );
    }

    // Longer steps, less work, however finely they are cut where cloud begins: no ray goes round in circles there.
    for refinement in [1, 2, 4, 16] {
        let [coarse, fine] = [12, 96].map(|steps| {
            let mut settings = windowed(16, 4, 3, refinement);
            settings.march.steps = steps;
            settings.march.count_reads = true;
            let picture = stage.look_with(camera(0.0), size(64, 36), &settings);
            picture.figures.density_evaluations.unwrap_or(u64::MAX) as f64
        });
        line.case();
        line.holds(
            format!("evaluations with 12 steps in {refinement} parts, against 96"),
            coarse,
            fine,
        );
    }

    stage.scene(&slab(json!({})));
    let short = windowed(16, 2, 4, 2);
    let long = StillSettings {
        frames: 1600,
        ..short
    };
    let [first, last] = [short, long].map(|settings| {
        let picture = stage.look_with(camera(0.0), size(8, 4), &settings);
        line.picture(format!("{} frames", settings.frames), &picture);
        picture
    });
    line.is(
        "1600 frames at rest are 16 of them, to the last bit",
        first.linear == last.linear,
    );
    line
}

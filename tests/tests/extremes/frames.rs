//! Frames of one pixel, one row and one column; large ones, and too large ones, which are refused.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, size, slab, weather};
use serde_json::json;
use skycell_protocol::FrameSize;

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("frame sizes");
    stage.scene(&weather(json!({})));
    let camera = || eye([0.0, 2.0, 0.0], 0.0, 30.0, 60.0);
    for (width, height) in [(1, 1), (2, 1), (1, 2160), (17, 3)] {
        for renderer in [SCREEN, CACHED] {
            // A column of 2160 pixels is as fine as a picture of that height: its cache would take minutes.
            if renderer == CACHED && height > 1000 {
                continue;
            }
            let picture = stage.look(camera(), size(width, height), renderer);
            line.picture(format!("{renderer:?}: {width} x {height}"), &picture);
        }
    }
    stage.scene(&slab(json!({})));
    let mut settings = super::stage::settings(SCREEN);
    settings.march.steps = 1;
    for (width, height) in [(3840, 1), (2048, 1024)] {
        let picture = stage.look_with(camera(), size(width, height), &settings);
        line.picture(format!("{width} x {height}"), &picture);
    }
    for (width, height) in [(0, 1), (3841, 1), (4096, 4096)] {
        line.case();
        line.is(
            format!("{width} x {height} is refused"),
            FrameSize::new(width, height).is_err(),
        );
    }
    line
}

//! One viewer of a soak: moves with its crowd, decodes every picture, and notes what is wrong.

use super::migration;
use crate::{Connection, ConnectionError, ConnectionLimits, Event, Frame, ServerAddress};
use skycell_protocol::CellId;
use skycell_protocol::message::{Acknowledgement, Hello};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval};

/// The server says something once a second; longer than this without a frame or a heartbeat is one missed.
pub(super) const GAP_MAX: Duration = Duration::from_millis(1_500);
/// A pixel this dark, of 255, in daylight is no sky and no ground.
const DARK: u8 = 4;

/// What a viewer has seen so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Watched {
    pub(super) frames: u64,
    pub(super) coarse_frames: u64,
    pub(super) gaps: u64,
    pub(super) longest_gap: Duration,
    /// Pictures that cannot be decoded, or hold a pixel that is all but black.
    pub(super) bad_pictures: u64,
    pub(super) cells: BTreeSet<CellId>,
    pub(super) cell_changes: u64,
    last_cell: Option<CellId>,
}

impl Watched {
    fn heard(&mut self, after: Duration) {
        self.gaps += u64::from(after > GAP_MAX);
        self.longest_gap = self.longest_gap.max(after);
    }

    fn saw(&mut self, frame: &Frame) {
        self.frames += 1;
        self.coarse_frames += u64::from(frame.header.coarse);
        self.bad_pictures += u64::from(!is_good(frame.payload()));
        let cell = frame.header.cell;
        self.cells.insert(cell);
        let before = self.last_cell.replace(cell);
        self.cell_changes += u64::from(before.is_some_and(|before| before != cell));
    }
}

/// Whether a file is a picture without black pixels.
fn is_good(file: &[u8]) -> bool {
    image::load_from_memory(file).is_ok_and(|picture| {
        let picture = picture.to_rgb8();
        picture
            .pixels()
            .all(|pixel| pixel.0.iter().any(|c| *c > DARK))
    })
}

/// Moves with the crowd until `stop` says so. `pace`: seconds of the crowd in one of the clock.
pub(super) async fn run(
    address: ServerAddress,
    hello: Hello,
    viewer: usize,
    (begun, pace): (Instant, f64),
    watched: Arc<Mutex<Watched>>,
    mut stop: watch::Receiver<bool>,
) -> Result<(), ConnectionError> {
    let fps = hello.fps;
    let mut connection = Connection::open(&address, hello, ConnectionLimits::default()).await?;
    let mut inputs = interval(Duration::from_secs_f64(1.0 / fps));
    inputs.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut heard = Instant::now();
    let note = |note: &mut dyn FnMut(&mut Watched)| {
        note(&mut watched.lock().unwrap_or_else(PoisonError::into_inner));
    };
    loop {
        tokio::select! {
            _ = stop.changed() => break,
            _ = inputs.tick() => {
                if let Ok(camera) = migration::camera(viewer, begun.elapsed().as_secs_f64() * pace) {
                    connection.send_camera(camera).await?;
                }
            }
            event = connection.next_event() => match event? {
                Event::Frame(frame) => {
                    note(&mut |watched| {
                        watched.heard(heard.elapsed());
                        watched.saw(&frame);
                    });
                    heard = Instant::now();
                    connection.acknowledge(Acknowledgement::of(frame.header.sequence)).await?;
                }
                Event::Heartbeat(_) => {
                    note(&mut |watched| watched.heard(heard.elapsed()));
                    heard = Instant::now();
                }
                Event::Complaint(complaint) => return Err(ConnectionError::Refused(complaint)),
                _ => {}
            },
        }
    }
    note(&mut |watched| watched.heard(heard.elapsed()));
    connection.close().await;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageFormat, Rgb, RgbImage};
    use std::io::Cursor;

    #[test]
    fn one_black_pixel_and_a_broken_file_are_found() {
        let file = |picture: &RgbImage| {
            let mut file = Cursor::new(Vec::new());
            picture
                .write_to(&mut file, ImageFormat::Png)
                .expect("written");
            file.into_inner()
        };
        let mut picture = RgbImage::from_pixel(9, 7, Rgb([90, 120, 200]));
        assert!(is_good(&file(&picture)));
        let whole = file(&picture);
        assert!(!is_good(&whole[..whole.len() / 2]));
        picture.put_pixel(4, 3, Rgb([0, 0, 0]));
        assert!(!is_good(&file(&picture)));
    }

    #[test]
    fn a_second_and_a_half_without_a_word_is_a_missed_heartbeat() {
        let mut watched = Watched::default();
        for ms in [200, 1_010, 1_400, 1_600] {
            watched.heard(Duration::from_millis(ms));
        }
        assert_eq!((watched.gaps, watched.longest_gap.as_millis()), (1, 1_600));
    }
}

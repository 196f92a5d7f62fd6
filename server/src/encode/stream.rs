//! One viewer's stream: its encoder, when its last key was, and how fast its pictures come.

use std::time::{Duration, Instant};

use skycell_protocol::{Codec, FrameSize};

use super::EncodeError;
use super::video::{self, AccessUnit, VideoEncoder, VideoWish};

/// A viewer gets a key on request this often at most: each costs as much as many pictures.
const KEY_INTERVAL: Duration = Duration::from_millis(900);
/// Pictures further apart say nothing of how many come in a second: the view rested.
const PAUSE: Duration = Duration::from_millis(400);
/// Share of the newest distance between two pictures in their mean.
const NEWEST_SHARE: f32 = 0.1;

/// What one picture of a stream is made of.
#[derive(Clone, Copy, Debug)]
pub struct StreamPicture<'a> {
    /// Red, green, blue, alpha; rows from top to bottom.
    pub rgba: &'a [u8],
    /// Its size.
    pub size: FrameSize,
    /// How the stream is compressed.
    pub codec: Codec,
    /// The rate to aim at.
    pub target_kbit_per_s: u32,
    /// The most pictures a second that the viewer wants.
    pub fps_max: f32,
    /// The viewer puts colours back that were spread.
    pub scales_colours: bool,
    /// It is that of two eyes, side by side.
    pub is_pair: bool,
}

/// A viewer's stream. It holds at most one encoder, for the codec and size of the last picture.
#[derive(Default)]
pub struct ViewerStream {
    open: Option<OpenStream>,
}

struct OpenStream {
    encoder: Box<dyn VideoEncoder>,
    codec: Codec,
    size: FrameSize,
    begun: Instant,
    last: Instant,
    last_key: Instant,
    interval_s: f32,
}

impl ViewerStream {
    /// Appends a picture to `out`. `wants_key` is cleared when the picture is one; it stays while the last key is too young.
    ///
    /// # Errors
    /// If the pixels do not fit the size or there is no encoder for them; the stream then begins anew.
    pub fn encode(
        &mut self,
        picture: &StreamPicture<'_>,
        wants_key: &mut bool,
        now: Instant,
        out: &mut Vec<u8>,
    ) -> Result<AccessUnit, EncodeError> {
        let mut open = match self.open.take() {
            Some(open) if open.codec == picture.codec && open.size == picture.size => open,
            // Another size or codec is another stream; its first picture is a key.
            _ => OpenStream::begin(picture, now)?,
        };
        let unit = open.encode(picture, *wants_key, now, out)?;
        if unit.is_key {
            *wants_key = false;
        }
        self.open = Some(open);
        Ok(unit)
    }

    /// Lets go of the encoder: the viewer has other wishes.
    pub fn end(&mut self) {
        self.open = None;
    }

    /// Whether it holds an encoder.
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }
}

impl OpenStream {
    fn begin(picture: &StreamPicture<'_>, now: Instant) -> Result<Self, EncodeError> {
        let interval_s = 1.0 / picture.fps_max.max(1.0);
        let wish = VideoWish {
            key: true,
            target_kbit_per_s: picture.target_kbit_per_s,
            fps: picture.fps_max,
            time: Duration::ZERO,
            scales_colours: picture.scales_colours,
            is_pair: picture.is_pair,
        };
        Ok(Self {
            encoder: video::open(picture.codec, picture.size, &wish)?,
            codec: picture.codec,
            size: picture.size,
            begun: now,
            last: now,
            last_key: now,
            interval_s,
        })
    }

    fn encode(
        &mut self,
        picture: &StreamPicture<'_>,
        wants_key: bool,
        now: Instant,
        out: &mut Vec<u8>,
    ) -> Result<AccessUnit, EncodeError> {
        let passed = now.saturating_duration_since(self.last);
        if !passed.is_zero() && passed < PAUSE {
            self.interval_s += NEWEST_SHARE * (passed.as_secs_f32() - self.interval_s);
        }
        self.last = now;
        let may_be_key = now.saturating_duration_since(self.last_key) >= KEY_INTERVAL;
        let wish = VideoWish {
            key: wants_key && may_be_key,
            target_kbit_per_s: picture.target_kbit_per_s,
            fps: (1.0 / self.interval_s).clamp(1.0, picture.fps_max.max(1.0)),
            time: now.saturating_duration_since(self.begun),
            scales_colours: picture.scales_colours,
            is_pair: picture.is_pair,
        };
        let unit = self.encoder.encode(picture.rgba, &wish, out)?;
        if unit.is_key {
            self.last_key = now;
        }
        Ok(unit)
    }
}

//! H.264, constrained baseline, by OpenH264: no picture refers to a later one, so none waits for another.

use openh264::encoder::{
    BitRate, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, Level, Profile,
    RateControlMode, UsageType, VuiConfig,
};
use openh264::{OpenH264API, Timestamp};
use openh264_sys2::{
    ENCODER_OPTION, ENCODER_OPTION_BITRATE, ENCODER_OPTION_FRAME_RATE, ENCODER_OPTION_MAX_BITRATE,
    ENCODER_OPTION_TRACE_LEVEL, SBitrateInfo, SPATIAL_LAYER_0, WELS_LOG_QUIET,
};
use skycell_protocol::{ColourScale, FrameSize};

use super::EncodeError;
use super::colours::Spread;
use super::i420::I420;
use super::video::{AccessUnit, KBIT_PER_S_MAX, KBIT_PER_S_MIN, VideoEncoder, VideoWish};

/// OpenH264 counts with at most so many pictures a second.
const FPS_MAX: f32 = 60.0;
/// Pixels up to which a stream is of level 4.2, which every decoder takes: 1920 x 1088.
const LEVEL_42_PIXELS: u32 = 1920 * 1088;
/// The encoder is told of another number of pictures a second when it is off by more than this share.
const FPS_SLACK: f32 = 0.2;

/// A stream of one size.
pub struct H264Encoder {
    encoder: Encoder,
    picture: I420,
    spread: Spread,
    kbit_per_s: u32,
    fps: f32,
    is_begun: bool,
}

impl H264Encoder {
    /// An encoder for pictures of a size.
    ///
    /// # Errors
    /// If OpenH264 gives none.
    pub fn new(size: FrameSize, wish: &VideoWish) -> Result<Self, EncodeError> {
        let kbit_per_s = wish.target_kbit_per_s.clamp(KBIT_PER_S_MIN, KBIT_PER_S_MAX);
        let fps = wish.fps.clamp(1.0, FPS_MAX);
        let level = if size.pixels() <= LEVEL_42_PIXELS {
            Level::Level_4_2
        } else {
            Level::Level_5_2
        };
        let config = EncoderConfig::new()
            .usage_type(UsageType::CameraVideoRealTime)
            .profile(Profile::Baseline)
            .level(level)
            .rate_control_mode(RateControlMode::Bitrate)
            .bitrate(BitRate::from_bps(kbit_per_s * 1000))
            .max_frame_rate(FrameRate::from_hz(fps))
            // Whether a picture is sent is decided before it comes here.
            .skip_frames(false)
            // Keys come when they are asked for.
            .intra_frame_period(IntraFramePeriod::from_num_frames(0))
            .scene_change_detect(false)
            // It takes parts of a slowly moving sky for a background that rests, and leaves them as they were.
            .background_detection(false)
            // The pool has a thread for each viewer's picture.
            .num_threads(1)
            .vui(VuiConfig::srgb());
        let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config)?;
        // Before its first word: it would warn on stderr that it skips no pictures.
        set_option(&mut encoder, ENCODER_OPTION_TRACE_LEVEL, &mut {
            WELS_LOG_QUIET
        })?;
        Ok(Self {
            encoder,
            picture: I420::new(size),
            spread: Spread::default(),
            kbit_per_s,
            fps,
            is_begun: false,
        })
    }

    /// Follows the rate and the number of pictures without a key.
    fn follow(&mut self, wish: &VideoWish) -> Result<(), EncodeError> {
        let kbit_per_s = wish.target_kbit_per_s.clamp(KBIT_PER_S_MIN, KBIT_PER_S_MAX);
        if kbit_per_s != self.kbit_per_s {
            let rises = kbit_per_s > self.kbit_per_s;
            let (first, second) = if rises {
                (ENCODER_OPTION_MAX_BITRATE, ENCODER_OPTION_BITRATE)
            } else {
                (ENCODER_OPTION_BITRATE, ENCODER_OPTION_MAX_BITRATE)
            };
            // The target must not be above the maximum at any time.
            for option in [first, second] {
                let mut rate = SBitrateInfo {
                    iLayer: SPATIAL_LAYER_0,
                    iBitrate: (kbit_per_s * 1000) as i32,
                };
                set_option(&mut self.encoder, option, &mut rate)?;
            }
            self.kbit_per_s = kbit_per_s;
        }
        let mut fps = wish.fps.clamp(1.0, FPS_MAX);
        if (fps - self.fps).abs() > FPS_SLACK * self.fps {
            set_option(&mut self.encoder, ENCODER_OPTION_FRAME_RATE, &mut fps)?;
            self.fps = fps;
        }
        Ok(())
    }
}

/// Sets an option of an encoder that has encoded something, or the level of its log before. The crate has no safe way to change
/// a rate.
#[allow(unsafe_code)]
fn set_option<T>(
    encoder: &mut Encoder,
    option: ENCODER_OPTION,
    value: &mut T,
) -> Result<(), EncodeError> {
    // SAFETY: the encoder is initialised, since it has encoded a picture, but for the level of its log, which OpenH264 takes
    // before; the callers give each option the type that codec_api.h names for it (SBitrateInfo, float, int), and OpenH264
    // copies it before it returns.
    let status = unsafe {
        encoder
            .raw_api()
            .set_option(option, std::ptr::from_mut(value).cast())
    };
    if status == 0 {
        Ok(())
    } else {
        Err(EncodeError::H264Option(status))
    }
}

impl VideoEncoder for H264Encoder {
    fn encode(
        &mut self,
        rgba: &[u8],
        wish: &VideoWish,
        out: &mut Vec<u8>,
    ) -> Result<AccessUnit, EncodeError> {
        let begins = wish.key || !self.is_begun;
        let (colours, is_other): (Option<ColourScale>, bool) = if wish.scales_colours {
            let (scale, is_other) =
                self.spread
                    .fill(&mut self.picture, rgba, begins, wish.is_pair)?;
            (Some(scale), is_other)
        } else {
            self.picture.fill(rgba)?;
            (None, false)
        };
        if self.is_begun {
            self.follow(wish)?;
            if wish.key || is_other {
                self.encoder.force_intra_frame();
            }
        }
        let time = Timestamp::from_millis(wish.time.as_millis() as u64);
        let stream = self.encoder.encode_at(&self.picture, time)?;
        self.is_begun = true;
        stream.write_vec(out);
        Ok(AccessUnit {
            is_key: matches!(stream.frame_type(), FrameType::IDR),
            colours,
        })
    }
}

//! The header in front of every frame.
//!
//! A binary WebSocket message from the server is this header, then `payload_bytes` bytes of the
//! compressed picture. All numbers are little-endian.
//!
//! | bytes | field | type | meaning |
//! | --- | --- | --- | --- |
//! | 0..4 | magic | 4 bytes | `SKYF` |
//! | 4 | version | u8 | 2 |
//! | 5 | codec | u8 | 0 no picture (heartbeat), 1 JPEG, 2 PNG, 3 H.264 (one access unit in Annex B form), 4 clouds alone |
//! | 6..8 | flags | u16 | bit 0 heartbeat; bit 1 coarse; bit 2 stereo: the picture holds those of two eyes side by side, the left eye's on the left, each `width / 2` wide; bit 3 key: it needs no earlier picture (always set for JPEG, PNG and clouds); bit 4 exact: nothing finer comes while the view rests; others are 0 |
//! | 8..12 | sequence | u32 | number of the frame in this viewer's stream, from 1; numbers of dropped frames are missing. Heartbeat: that of the last frame sent, 0 if none |
//! | 12..14 | width | u16 | pixels, of both eyes together where there are two; heartbeat: 0 |
//! | 14..16 | height | u16 | pixels; heartbeat: 0 |
//! | 16..24 | scene_revision | u64 | revision of the scene that the frame shows; heartbeat: that of the last frame sent |
//! | 24..32 | input | u64 | the last `camera` input that the frame has applied; heartbeat: that of the last frame sent |
//! | 32..36 | cell | u32 | the view cell that the frame was composited from |
//! | 36..40 | viewer | u32 | whose frame it is |
//! | 40..48 | render_unix_us | u64 | server's clock when the composite was submitted to the GPU, µs since 1970; heartbeat: when the heartbeat was sent |
//! | 48..52 | input_to_render_us | u32 | from the arrival of the last applied input at the server until the composite was submitted; 0 where no input was new |
//! | 52..56 | march_wait_us | u32 | of that, how long the frame waited for marching; 0 if not |
//! | 56..60 | composite_us | u32 | the device's time for the picture; 0 where the device tells no times |
//! | 60..64 | readback_us | u32 | from the composite's submission until the pixels had arrived, without `composite_us`: waiting for the device, and the copy |
//! | 64..68 | encode_wait_us | u32 | from there until an encoder took the frame |
//! | 68..72 | encode_us | u32 | how long encoding took |
//! | 72..76 | encode_to_send_us | u32 | from the end of encoding until the frame was handed to the socket: waiting in the latest-wins slot |
//! | 76..80 | payload_bytes | u32 | length of what follows the header |
//! | 80..84 | target_kbit_per_s | u32 | the rate that the frame's compression aims at; 0 where there is none |
//! | 84..86 | colour_centre | 2 × u8 | of a video whose colours are spread (`scaled_colours` of the hello): the blue and the red difference that became 128 |
//! | 86 | colour_gain | u8 | how many times finer its colour differences are; 0 where they are as the stream says itself |
//! | 87..96 | | | 0, and not looked at |
//!
//! So `render_unix_us + composite_us + readback_us + encode_wait_us + encode_us + encode_to_send_us`
//! is the server's clock when the frame was sent. Durations too long for their field are stored as
//! the largest number.

use serde::Serialize;
use thiserror::Error;

use crate::{CellId, Codec, ColourScale, FrameSequence, InputSequence, ViewerId};

/// Length of an encoded header.
pub const FRAME_HEADER_BYTES: usize = 96;
/// The first bytes of every frame.
pub const FRAME_MAGIC: [u8; 4] = *b"SKYF";
/// The version of the header.
pub const FRAME_HEADER_VERSION: u8 = 2;

const FLAG_HEARTBEAT: u16 = 1 << 0;
const FLAG_COARSE: u16 = 1 << 1;
const FLAG_STEREO: u16 = 1 << 2;
const FLAG_KEY: u16 = 1 << 3;
const FLAG_EXACT: u16 = 1 << 4;

/// What follows the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FrameCodec {
    /// Nothing: the header is a sign of life.
    None,
    /// A JPEG file.
    Jpeg,
    /// A PNG file.
    Png,
    /// One access unit of H.264 in Annex B form.
    H264,
    /// The clouds alone, for a renderer that draws the rest.
    Clouds,
}

impl FrameCodec {
    /// Every one.
    pub const ALL: [Self; 5] = [Self::None, Self::Jpeg, Self::Png, Self::H264, Self::Clouds];

    /// Its number on the wire.
    const fn id(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Jpeg => 1,
            Self::Png => 2,
            Self::H264 => 3,
            Self::Clouds => 4,
        }
    }
}

impl From<Codec> for FrameCodec {
    fn from(codec: Codec) -> Self {
        match codec {
            Codec::Jpeg => Self::Jpeg,
            Codec::Png => Self::Png,
            Codec::H264 => Self::H264,
            Codec::Clouds => Self::Clouds,
        }
    }
}

/// How long a frame took on its way through the server, by stage, µs; the module tells from when until when.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameStages {
    /// From the arrival of the last applied input until the composite was submitted.
    pub input_to_render_us: u32,
    /// Of that, waiting for marching.
    pub march_wait_us: u32,
    /// The device's time for the picture.
    pub composite_us: u32,
    /// Waiting for the device, and the copy of the pixels.
    pub readback_us: u32,
    /// Waiting for an encoder.
    pub encode_wait_us: u32,
    /// Encoding.
    pub encode_us: u32,
    /// Waiting in the latest-wins slot.
    pub encode_to_send_us: u32,
}

impl FrameStages {
    /// From the composite's submission until the frame was handed to the socket.
    pub fn render_to_send_us(&self) -> u64 {
        [
            self.composite_us,
            self.readback_us,
            self.encode_wait_us,
            self.encode_us,
            self.encode_to_send_us,
        ]
        .into_iter()
        .map(u64::from)
        .sum()
    }

    const fn in_order(self) -> [u32; 7] {
        [
            self.input_to_render_us,
            self.march_wait_us,
            self.composite_us,
            self.readback_us,
            self.encode_wait_us,
            self.encode_us,
            self.encode_to_send_us,
        ]
    }
}

/// The header in front of every frame; the module tells its bytes and what each field means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// What follows the header.
    pub codec: FrameCodec,
    /// The header is a sign of life and shows nothing new.
    pub heartbeat: bool,
    /// Some visible part of the sky is not yet at the resolution that was asked for.
    pub coarse: bool,
    /// The picture holds those of two eyes side by side, the left eye's on the left. Heartbeat: the last frame's did.
    pub stereo: bool,
    /// The picture needs no earlier one.
    pub key: bool,
    /// Nothing finer comes while the view rests.
    pub exact: bool,
    /// Number of the frame in this viewer's stream.
    pub sequence: FrameSequence,
    /// Pixels in a row, of both eyes together where there are two.
    pub width: u16,
    /// Rows.
    pub height: u16,
    /// Revision of the scene that the frame shows.
    pub scene_revision: u64,
    /// The last camera input that the frame has applied.
    pub input: InputSequence,
    /// The view cell that the frame was composited from.
    pub cell: CellId,
    /// Whose frame it is.
    pub viewer: ViewerId,
    /// Server's clock when the composite was submitted to the GPU, µs since 1970.
    pub render_unix_us: u64,
    /// How long it took by stage.
    pub stages: FrameStages,
    /// Length of what follows the header.
    pub payload_bytes: u32,
    /// The rate that compression aims at, kbit/s; 0 where there is none.
    pub target_kbit_per_s: u32,
    /// How the colours of a video are spread; none where they are as the stream says itself.
    pub colours: Option<ColourScale>,
}

/// Why bytes are no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum FrameError {
    /// Fewer bytes than a header has.
    #[error("{0} bytes are too few for a frame header of {FRAME_HEADER_BYTES}")]
    Truncated(usize),
    /// The bytes do not begin with [`FRAME_MAGIC`].
    #[error("not a frame: begins with {0:?} instead of SKYF")]
    WrongMagic([u8; 4]),
    /// A version that this crate does not know.
    #[error("frame header version {0} is unknown; known: {FRAME_HEADER_VERSION}")]
    UnknownVersion(u8),
    /// A codec that this crate does not know.
    #[error("frame codec {0} is unknown; known: 0 none, 1 JPEG, 2 PNG, 3 H.264, 4 clouds")]
    UnknownCodec(u8),
    /// The payload is not as long as the header says.
    #[error("the header announces {announced} payload bytes and {found} follow")]
    WrongPayloadLength {
        /// What the header says.
        announced: u32,
        /// What follows the header.
        found: usize,
    },
}

impl FrameHeader {
    /// The header as bytes.
    pub fn encode(&self) -> [u8; FRAME_HEADER_BYTES] {
        let mut bytes = [0; FRAME_HEADER_BYTES];
        let flags = [
            (self.heartbeat, FLAG_HEARTBEAT),
            (self.coarse, FLAG_COARSE),
            (self.stereo, FLAG_STEREO),
            (self.key, FLAG_KEY),
            (self.exact, FLAG_EXACT),
        ]
        .into_iter()
        .fold(
            0,
            |flags, (set, flag)| if set { flags | flag } else { flags },
        );
        bytes[0..4].copy_from_slice(&FRAME_MAGIC);
        bytes[4] = FRAME_HEADER_VERSION;
        bytes[5] = self.codec.id();
        bytes[6..8].copy_from_slice(&flags.to_le_bytes());
        bytes[8..12].copy_from_slice(&self.sequence.0.to_le_bytes());
        bytes[12..14].copy_from_slice(&self.width.to_le_bytes());
        bytes[14..16].copy_from_slice(&self.height.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.scene_revision.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.input.0.to_le_bytes());
        bytes[32..36].copy_from_slice(&self.cell.0.to_le_bytes());
        bytes[36..40].copy_from_slice(&self.viewer.0.to_le_bytes());
        bytes[40..48].copy_from_slice(&self.render_unix_us.to_le_bytes());
        for (room, duration_us) in bytes[48..76]
            .chunks_exact_mut(4)
            .zip(self.stages.in_order())
        {
            room.copy_from_slice(&duration_us.to_le_bytes());
        }
        bytes[76..80].copy_from_slice(&self.payload_bytes.to_le_bytes());
        bytes[80..84].copy_from_slice(&self.target_kbit_per_s.to_le_bytes());
        bytes[84..88].copy_from_slice(&ColourScale::to_wire(self.colours));
        bytes
    }

    /// Reads the header at the front of `bytes`.
    ///
    /// # Errors
    /// If the bytes are too few or are not a header of a known version and codec.
    pub fn decode(bytes: &[u8]) -> Result<Self, FrameError> {
        let Some(header) = bytes.first_chunk::<FRAME_HEADER_BYTES>() else {
            return Err(FrameError::Truncated(bytes.len()));
        };
        if header[0..4] != FRAME_MAGIC {
            return Err(FrameError::WrongMagic(array_at(header, 0)));
        }
        if header[4] != FRAME_HEADER_VERSION {
            return Err(FrameError::UnknownVersion(header[4]));
        }
        let codec = FrameCodec::ALL
            .into_iter()
            .find(|codec| codec.id() == header[5])
            .ok_or(FrameError::UnknownCodec(header[5]))?;
        let flags = u16::from_le_bytes(array_at(header, 6));
        Ok(Self {
            codec,
            heartbeat: flags & FLAG_HEARTBEAT != 0,
            coarse: flags & FLAG_COARSE != 0,
            stereo: flags & FLAG_STEREO != 0,
            key: flags & FLAG_KEY != 0,
            exact: flags & FLAG_EXACT != 0,
            sequence: FrameSequence(u32_at(header, 8)),
            width: u16::from_le_bytes(array_at(header, 12)),
            height: u16::from_le_bytes(array_at(header, 14)),
            scene_revision: u64_at(header, 16),
            input: InputSequence(u64_at(header, 24)),
            cell: CellId(u32_at(header, 32)),
            viewer: ViewerId(u32_at(header, 36)),
            render_unix_us: u64_at(header, 40),
            stages: FrameStages {
                input_to_render_us: u32_at(header, 48),
                march_wait_us: u32_at(header, 52),
                composite_us: u32_at(header, 56),
                readback_us: u32_at(header, 60),
                encode_wait_us: u32_at(header, 64),
                encode_us: u32_at(header, 68),
                encode_to_send_us: u32_at(header, 72),
            },
            payload_bytes: u32_at(header, 76),
            target_kbit_per_s: u32_at(header, 80),
            colours: ColourScale::of_wire(array_at(header, 84)),
        })
    }

    /// Splits a whole message into its header and its payload.
    ///
    /// # Errors
    /// As [`FrameHeader::decode`], and if the payload is not as long as the header says.
    pub fn split(message: &[u8]) -> Result<(Self, &[u8]), FrameError> {
        let header = Self::decode(message)?;
        let payload = &message[FRAME_HEADER_BYTES..];
        if payload.len() as u64 != u64::from(header.payload_bytes) {
            return Err(FrameError::WrongPayloadLength {
                announced: header.payload_bytes,
                found: payload.len(),
            });
        }
        Ok((header, payload))
    }

    /// The server's clock when the frame was handed to the socket, µs since 1970.
    pub fn sent_unix_us(&self) -> u64 {
        self.render_unix_us
            .saturating_add(self.stages.render_to_send_us())
    }
}

fn array_at<const N: usize>(header: &[u8; FRAME_HEADER_BYTES], offset: usize) -> [u8; N] {
    std::array::from_fn(|index| header[offset + index])
}

fn u32_at(header: &[u8; FRAME_HEADER_BYTES], offset: usize) -> u32 {
    u32::from_le_bytes(array_at(header, offset))
}

fn u64_at(header: &[u8; FRAME_HEADER_BYTES], offset: usize) -> u64 {
    u64::from_le_bytes(array_at(header, offset))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn header() -> FrameHeader {
        FrameHeader {
            codec: FrameCodec::Jpeg,
            heartbeat: false,
            coarse: true,
            stereo: true,
            key: true,
            exact: true,
            sequence: FrameSequence(0x0102_0304),
            width: 0x0506,
            height: 0x0708,
            scene_revision: 0x1112_1314_1516_1718,
            input: InputSequence(0x2122_2324_2526_2728),
            cell: CellId(0x3132_3334),
            viewer: ViewerId(0x4142_4344),
            render_unix_us: 0x5152_5354_5556_5758,
            stages: FrameStages {
                input_to_render_us: 0x6162_6364,
                march_wait_us: 0x6566_6768,
                composite_us: 0x7172_7374,
                readback_us: 0x7576_7778,
                encode_wait_us: 0x8182_8384,
                encode_us: 0x8586_8788,
                encode_to_send_us: 0x9192_9394,
            },
            payload_bytes: 2,
            target_kbit_per_s: 0x9596_9798,
            colours: ColourScale::new([0xa1, 0xa2], 5),
        }
    }

    #[test]
    fn the_bytes_of_a_header_are_pinned() {
        let expected: [u8; FRAME_HEADER_BYTES] = [
            b'S', b'K', b'Y', b'F', 2, 1, 0x1e, 0, // magic, version, codec, flags
            4, 3, 2, 1, 6, 5, 8, 7, // sequence, width, height
            0x18, 0x17, 0x16, 0x15, 0x14, 0x13, 0x12, 0x11, // scene_revision
            0x28, 0x27, 0x26, 0x25, 0x24, 0x23, 0x22, 0x21, // input
            0x34, 0x33, 0x32, 0x31, 0x44, 0x43, 0x42, 0x41, // cell, viewer
            0x58, 0x57, 0x56, 0x55, 0x54, 0x53, 0x52, 0x51, // render_unix_us
            0x64, 0x63, 0x62, 0x61, 0x68, 0x67, 0x66,
            0x65, // input_to_render_us, march_wait_us
            0x74, 0x73, 0x72, 0x71, 0x78, 0x77, 0x76, 0x75, // composite_us, readback_us
            0x84, 0x83, 0x82, 0x81, 0x88, 0x87, 0x86, 0x85, // encode_wait_us, encode_us
            0x94, 0x93, 0x92, 0x91, 2, 0, 0, 0, // encode_to_send_us, payload_bytes
            0x98, 0x97, 0x96, 0x95, 0xa1, 0xa2, 5, 0, // target_kbit_per_s, colours, nothing
            0, 0, 0, 0, 0, 0, 0, 0, // nothing
        ];
        assert_eq!(header().encode(), expected);
    }

    #[test]
    fn what_is_not_a_frame_is_refused() {
        let good = header().encode();
        assert_eq!(
            FrameHeader::decode(&good[..95]),
            Err(FrameError::Truncated(95))
        );
        let with = |index: usize, byte: u8| {
            let mut bytes = good;
            bytes[index] = byte;
            FrameHeader::decode(&bytes)
        };
        assert_eq!(with(0, b'X'), Err(FrameError::WrongMagic(*b"XKYF")));
        assert_eq!(with(4, 1), Err(FrameError::UnknownVersion(1)));
        assert_eq!(with(4, 3), Err(FrameError::UnknownVersion(3)));
        assert_eq!(with(5, 5), Err(FrameError::UnknownCodec(5)));
        assert_eq!(
            FrameHeader::split(&good),
            Err(FrameError::WrongPayloadLength {
                announced: 2,
                found: 0
            })
        );
    }

    #[test]
    fn the_stages_after_the_submission_add_up_to_when_the_frame_was_sent() {
        let header = FrameHeader {
            render_unix_us: 1_000,
            stages: FrameStages {
                input_to_render_us: 1_000_000,
                march_wait_us: 100_000,
                composite_us: 1,
                readback_us: 20,
                encode_wait_us: 300,
                encode_us: 4_000,
                encode_to_send_us: 50_000,
            },
            ..header()
        };
        assert_eq!(header.sent_unix_us(), 55_321);
        let late = FrameHeader {
            render_unix_us: u64::MAX,
            ..header
        };
        assert_eq!(late.sent_unix_us(), u64::MAX);
    }

    proptest! {
        #[test]
        fn a_header_survives_encoding_and_decoding(
            (codec, [heartbeat, coarse, stereo, key, exact]) in (0..FrameCodec::ALL.len(), any::<[bool; 5]>()),
            (sequence, width, height) in any::<(u32, u16, u16)>(),
            (scene_revision, input, cell, viewer) in any::<(u64, u64, u32, u32)>(),
            (render_unix_us, us, payload_bytes, target_kbit_per_s) in any::<(u64, [u32; 7], u32, u32)>(),
            (centre, gain) in (any::<[u8; 2]>(), 0..10u8),
        ) {
            let header = FrameHeader {
                codec: FrameCodec::ALL[codec],
                heartbeat,
                coarse,
                stereo,
                key,
                exact,
                sequence: FrameSequence(sequence),
                width,
                height,
                scene_revision,
                input: InputSequence(input),
                cell: CellId(cell),
                viewer: ViewerId(viewer),
                render_unix_us,
                stages: FrameStages {
                    input_to_render_us: us[0],
                    march_wait_us: us[1],
                    composite_us: us[2],
                    readback_us: us[3],
                    encode_wait_us: us[4],
                    encode_us: us[5],
                    encode_to_send_us: us[6],
                },
                payload_bytes,
                target_kbit_per_s,
                colours: ColourScale::new(centre, gain),
            };
            prop_assert_eq!(FrameHeader::decode(&header.encode()), Ok(header));
        }

        #[test]
        fn no_bytes_make_decoding_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = FrameHeader::split(&bytes);
        }
    }
}

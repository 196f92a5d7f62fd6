//! What a client says to a server.

use serde::Serialize;
use serde_json::Value;
use thiserror::Error;

use super::server::{ErrorCode, ErrorMessage};
use super::token::AccessToken;
use crate::read_json::{ObjectReader, nearest_name};
use crate::view::FRAMES_PER_SECOND;
use crate::{
    Camera, Codec, FrameSequence, FrameSize, InputSequence, JpegQuality, PROTOCOL_VERSION,
    QualityChoice, RendererKind, Show, Stereo, ValueError,
};

/// How many codecs a client may name.
const CODECS_MAX: usize = 8;

/// A message from a client, in range throughout.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum ClientMessage {
    /// The first message: who speaks and what it wants to be sent.
    Hello(Hello),
    /// Where the viewer stands and looks now.
    Camera(CameraInput),
    /// A change of wishes.
    View(ViewChange),
    /// A frame has arrived.
    Ack(Acknowledgement),
    /// The next picture is to need no earlier one: the client lacks one of those that it builds on.
    #[serde(rename = "key_frame")]
    KeyFrame,
}

/// The first message of a client.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Hello {
    /// The version that the client speaks.
    pub protocol: u32,
    /// Width and height of frames, or of each of two eyes' pictures in one; `width` and `height` on the wire.
    #[serde(flatten)]
    pub size: FrameSize,
    /// The most frames a second that the client wants.
    pub fps: f64,
    /// How frames are compressed, where `codecs` says nothing.
    pub codec: Codec,
    /// What the client can take, what it likes best first; of names on the wire that this crate does not know, nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub codecs: Vec<Codec>,
    /// Quality of JPEG frames.
    pub jpeg_quality: JpegQuality,
    /// Where the viewer stands and looks.
    pub camera: Camera,
    /// Which renderer makes the frames.
    pub renderer: RendererKind,
    /// How good pictures are to be; none for what the scene or the server says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality: Option<QualityChoice>,
    /// What frames show.
    pub show: Show,
    /// Frames hold the pictures of two eyes side by side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stereo: Option<Stereo>,
    /// Colour of clouds alone includes the haze in front of them.
    pub haze: bool,
    /// The client puts a video's colours back as frame headers say ([`crate::colour_scale`]).
    pub scaled_colours: bool,
    /// Lets the client in, where the server demands it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub token: Option<AccessToken>,
}

impl Hello {
    /// A hello of this crate's version with the default codec, quality and renderer.
    pub fn new(size: FrameSize, fps: f64, camera: Camera) -> Self {
        Self {
            protocol: PROTOCOL_VERSION,
            size,
            fps,
            codec: Codec::default(),
            codecs: Vec::new(),
            jpeg_quality: JpegQuality::default(),
            camera,
            renderer: RendererKind::default(),
            quality: None,
            show: Show::default(),
            stereo: None,
            haze: true,
            scaled_colours: false,
            token: None,
        }
    }

    /// The first of its codecs that `can_give` allows; `codec` where there is none.
    pub fn picked_codec(&self, can_give: impl Fn(Codec) -> bool) -> Codec {
        let mut wanted = self.codecs.iter().copied();
        wanted.find(|codec| can_give(*codec)).unwrap_or(self.codec)
    }
}

/// Where the viewer stands and looks now.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CameraInput {
    /// The client's number of this input; frames tell the last one that they show.
    pub input: InputSequence,
    /// The camera.
    pub camera: Camera,
}

/// A change of wishes; what is not named stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ViewChange {
    /// New width of frames, or of each of two eyes' pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// New height of frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// New wish for frames a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<f64>,
    /// New compression.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub codec: Option<Codec>,
    /// New quality of JPEG frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jpeg_quality: Option<JpegQuality>,
    /// New wish for how good pictures are to be; null for what the scene or the server says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality: Option<Option<QualityChoice>>,
    /// What frames are to show now.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub show: Option<Show>,
    /// Two eyes, or null for one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stereo: Option<Option<Stereo>>,
    /// Whether colour of clouds alone is to include the haze in front of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub haze: Option<bool>,
}

impl ViewChange {
    /// The size after this change of `size`, and the eyes after it.
    ///
    /// # Errors
    /// Names the number that is out of range; in a change that was read from JSON only a width that is too large for two eyes
    /// can be.
    pub fn size_after(
        &self,
        size: FrameSize,
        stereo: Option<Stereo>,
    ) -> Result<(FrameSize, Option<Stereo>), ValueError> {
        let stereo = self.stereo.unwrap_or(stereo);
        let size = FrameSize::new(
            self.width.unwrap_or(size.width()),
            self.height.unwrap_or(size.height()),
        )?;
        Ok((size.for_eyes(stereo)?, stereo))
    }

    /// What is shown, and by which codec, after this change of both.
    ///
    /// # Errors
    /// Names what the codec cannot show.
    pub fn show_after(&self, show: Show, codec: Codec) -> Result<(Show, Codec), ValueError> {
        let codec = self.codec.unwrap_or(codec);
        Ok((self.show.unwrap_or(show).for_codec(codec)?, codec))
    }
}

/// A frame has arrived. Acknowledges every earlier one too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Acknowledgement {
    /// The frame.
    pub sequence: FrameSequence,
    /// How long the client took to decode it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decode_us: Option<u32>,
    /// The client's clock when the frame had arrived, µs since 1970.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub received_us: Option<u64>,
    /// The client's clock when the frame was shown, µs since 1970.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub present_us: Option<u64>,
    /// If the frame is the first with an input, how long that was ago when the frame was shown: from sending it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_to_photon_us: Option<u32>,
}

impl Acknowledgement {
    /// Without any times.
    pub fn of(sequence: FrameSequence) -> Self {
        Self {
            sequence,
            decode_us: None,
            received_us: None,
            present_us: None,
            motion_to_photon_us: None,
        }
    }
}

/// Why a text is no message of a client.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum MessageError {
    /// Not JSON.
    #[error("the message is not JSON: {0}")]
    BadJson(String),
    /// The `type` is missing or unknown.
    #[error("{0}")]
    UnknownType(ValueError),
    /// A key is unknown or missing, or a value is not allowed.
    #[error("{0}")]
    BadValue(ValueError),
    /// A hello of another version.
    #[error("{0}")]
    WrongProtocol(ValueError),
}

impl MessageError {
    /// The code of the error on the wire.
    pub fn code(&self) -> ErrorCode {
        match self {
            Self::BadJson(_) => ErrorCode::BadJson,
            Self::UnknownType(_) => ErrorCode::UnknownType,
            Self::BadValue(_) => ErrorCode::BadValue,
            Self::WrongProtocol(_) => ErrorCode::WrongProtocol,
        }
    }

    /// The error as it is told to the client.
    pub fn to_message(&self) -> ErrorMessage {
        ErrorMessage {
            code: self.code(),
            pointer: match self {
                Self::BadJson(_) => None,
                Self::UnknownType(error) | Self::BadValue(error) | Self::WrongProtocol(error) => {
                    Some(error.pointer.clone())
                }
            },
            message: self.to_string(),
        }
    }
}

impl From<ValueError> for MessageError {
    fn from(error: ValueError) -> Self {
        Self::BadValue(error)
    }
}

const TYPES: &[&str] = &["hello", "camera", "view", "ack", "key_frame"];

impl ClientMessage {
    /// Reads a message from the text of a WebSocket message.
    ///
    /// # Errors
    /// Names what is not allowed and where it stands.
    pub fn from_json_text(text: &str) -> Result<Self, MessageError> {
        let value: Value =
            serde_json::from_str(text).map_err(|error| MessageError::BadJson(error.to_string()))?;
        let members = ObjectReader::new(&value, "")?;
        let Some(kind) = members.optional::<Value>("type")? else {
            return Err(MessageError::UnknownType(ValueError::missing(
                "/type",
                TYPES.join(", "),
            )));
        };
        match kind.as_str().unwrap_or_default() {
            "hello" => read_hello(&members).map(Self::Hello),
            "camera" => Ok(Self::Camera(read_camera_input(&members)?)),
            "view" => Ok(Self::View(read_view_change(&members)?)),
            "ack" => Ok(Self::Ack(read_acknowledgement(&members)?)),
            "key_frame" => {
                members.only(&["type"])?;
                Ok(Self::KeyFrame)
            }
            unknown => {
                let mut allowed = TYPES.join(", ");
                if let Some(name) = nearest_name(unknown, TYPES) {
                    allowed.push_str(&format!("; did you mean \"{name}\"?"));
                }
                Err(MessageError::UnknownType(ValueError::new(
                    "/type", &kind, allowed,
                )))
            }
        }
    }
}

fn read_hello(members: &ObjectReader<'_>) -> Result<Hello, MessageError> {
    // Before the rest: another version may have other keys.
    let protocol: u32 = members.required("protocol", &PROTOCOL_VERSION.to_string())?;
    if protocol != PROTOCOL_VERSION {
        return Err(MessageError::WrongProtocol(ValueError::new(
            "/protocol",
            &Value::from(protocol),
            PROTOCOL_VERSION.to_string(),
        )));
    }
    members.only(&[
        "type",
        "protocol",
        "width",
        "height",
        "fps",
        "codec",
        "codecs",
        "jpeg_quality",
        "camera",
        "renderer",
        "quality",
        "show",
        "stereo",
        "haze",
        "scaled_colours",
        "token",
    ])?;
    let stereo = members.member_or("stereo", None)?;
    let codecs = match members.optional::<Value>("codecs")? {
        Some(names) => read_codecs(&names)?,
        None => Vec::new(),
    };
    let codec = match codecs.first() {
        Some(first) => members.member_or("codec", *first)?,
        None => members.required("codec", &Codec::names())?,
    };
    let show = members.member_or("show", Show::default())?;
    // Whichever the server picks.
    for codec in codecs.iter().chain([&codec]) {
        show.for_codec(*codec)?;
    }
    Ok(Hello {
        protocol,
        size: FrameSize::new(
            members.required("width", "a whole number of pixels")?,
            members.required("height", "a whole number of pixels")?,
        )?
        .for_eyes(stereo)?,
        fps: FRAMES_PER_SECOND.check(
            "/fps",
            members.required("fps", &FRAMES_PER_SECOND.to_string())?,
        )?,
        codec,
        codecs,
        jpeg_quality: read_jpeg_quality(members)?.unwrap_or_default(),
        camera: members.required("camera", "a camera")?,
        renderer: members.member_or("renderer", RendererKind::default())?,
        quality: members.member_or("quality", None)?,
        show,
        stereo,
        haze: members.member_or("haze", true)?,
        scaled_colours: members.member_or("scaled_colours", false)?,
        token: members.optional("token")?,
    })
}

/// Codecs in order of preference. A client may name some that are newer than this crate, as long as one is known.
fn read_codecs(names: &Value) -> Result<Vec<Codec>, ValueError> {
    let error = || {
        let allowed = format!("1 to {CODECS_MAX} names, one of them of {}", Codec::names());
        ValueError::new("/codecs", names, allowed)
    };
    let list = names
        .as_array()
        .filter(|list| (1..=CODECS_MAX).contains(&list.len()))
        .ok_or_else(error)?;
    let mut known = Vec::new();
    for name in list {
        let codec = Codec::of_name(name.as_str().ok_or_else(error)?);
        known.extend(codec.filter(|codec| !known.contains(codec)));
    }
    if known.is_empty() {
        return Err(error());
    }
    Ok(known)
}

fn read_jpeg_quality(members: &ObjectReader<'_>) -> Result<Option<JpegQuality>, ValueError> {
    members
        .optional("jpeg_quality")?
        .map(JpegQuality::new)
        .transpose()
}

fn read_camera_input(members: &ObjectReader<'_>) -> Result<CameraInput, ValueError> {
    members.only(&["type", "input", "camera"])?;
    Ok(CameraInput {
        input: InputSequence(members.required("input", "a whole number")?),
        camera: members.required("camera", "a camera")?,
    })
}

fn read_view_change(members: &ObjectReader<'_>) -> Result<ViewChange, ValueError> {
    members.only(&[
        "type",
        "width",
        "height",
        "fps",
        "codec",
        "jpeg_quality",
        "quality",
        "show",
        "stereo",
        "haze",
    ])?;
    let change = ViewChange {
        width: members.optional("width")?,
        height: members.optional("height")?,
        fps: members
            .optional("fps")?
            .map(|fps| FRAMES_PER_SECOND.check("/fps", fps))
            .transpose()?,
        codec: members.optional::<Codec>("codec")?,
        jpeg_quality: read_jpeg_quality(members)?,
        quality: members.optional("quality")?,
        show: members.optional("show")?,
        stereo: members.optional("stereo")?,
        haze: members.optional("haze")?,
    };
    // Whatever the other side is, each named side must be in range.
    change.size_after(FrameSize::new(1, 1)?, None)?;
    Ok(change)
}

fn read_acknowledgement(members: &ObjectReader<'_>) -> Result<Acknowledgement, ValueError> {
    members.only(&[
        "type",
        "sequence",
        "decode_us",
        "received_us",
        "present_us",
        "motion_to_photon_us",
    ])?;
    Ok(Acknowledgement {
        sequence: FrameSequence(members.required("sequence", "the number of a frame")?),
        decode_us: members.optional("decode_us")?,
        received_us: members.optional("received_us")?,
        present_us: members.optional("present_us")?,
        motion_to_photon_us: members.optional("motion_to_photon_us")?,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn hello_json() -> Value {
        json!({
            "type": "hello", "protocol": 1, "width": 640, "height": 360, "fps": 30,
            "codec": "jpeg",
            "camera": {"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 15, "vertical_fov_deg": 60}
        })
    }

    fn read(value: &Value) -> Result<ClientMessage, MessageError> {
        ClientMessage::from_json_text(&value.to_string())
    }

    fn hello_with(key: &str, value: Value) -> MessageError {
        let mut hello = hello_json();
        hello[key] = value;
        read(&hello).expect_err("must be refused")
    }

    #[test]
    fn a_hello_without_optional_keys_gets_their_defaults() {
        let size = FrameSize::new(640, 360).expect("in range");
        assert_eq!(
            read(&hello_json()),
            Ok(ClientMessage::Hello(Hello::new(
                size,
                30.0,
                Camera::default()
            )))
        );
    }

    #[test]
    fn of_the_codecs_that_a_client_lists_the_first_that_can_be_given_is_picked() {
        let mut hello = hello_json();
        hello["codecs"] = json!(["av1", "h264", "jpeg", "h264"]);
        let picked = |hello: &Value, can_give: fn(Codec) -> bool| match read(hello) {
            Ok(ClientMessage::Hello(hello)) => hello.picked_codec(can_give),
            other => panic!("not a hello: {other:?}"),
        };
        assert_eq!(picked(&hello, |_| true), Codec::H264);
        assert_eq!(picked(&hello, |codec| !codec.is_stream()), Codec::Jpeg);
        // The list may stand alone, and so may the one codec.
        if let Some(members) = hello.as_object_mut() {
            members.remove("codec");
        }
        assert_eq!(picked(&hello, |_| true), Codec::H264);
        assert_eq!(picked(&hello_json(), |_| true), Codec::Jpeg);
    }

    #[test]
    fn each_kind_of_bad_message_has_its_code_and_pointer() {
        let cases = [
            ("{", ErrorCode::BadJson, None),
            (r#"{"type":"camera","input":NaN}"#, ErrorCode::BadJson, None),
            ("[]", ErrorCode::BadValue, Some("")),
            ("{}", ErrorCode::UnknownType, Some("/type")),
            (r#"{"type":"helo"}"#, ErrorCode::UnknownType, Some("/type")),
            (r#"{"type":7}"#, ErrorCode::UnknownType, Some("/type")),
            (
                r#"{"type":"hello"}"#,
                ErrorCode::BadValue,
                Some("/protocol"),
            ),
            (
                r#"{"type":"hello","protocol":9,"new":1}"#,
                ErrorCode::WrongProtocol,
                Some("/protocol"),
            ),
            (
                r#"{"type":"camera","input":1}"#,
                ErrorCode::BadValue,
                Some("/camera"),
            ),
            (
                r#"{"type":"camera","input":-1}"#,
                ErrorCode::BadValue,
                Some("/input"),
            ),
            (
                r#"{"type":"view","width":0}"#,
                ErrorCode::BadValue,
                Some("/width"),
            ),
            (
                r#"{"type":"view","height":100000}"#,
                ErrorCode::BadValue,
                Some("/height"),
            ),
            (r#"{"type":"view","fps":1e999}"#, ErrorCode::BadJson, None),
            (
                r#"{"type":"view","stereo":{"eye_distance_m":-1}}"#,
                ErrorCode::BadValue,
                Some("/stereo/eye_distance_m"),
            ),
            (
                r#"{"type":"view","width":2000,"stereo":{"eye_distance_m":0.064}}"#,
                ErrorCode::BadValue,
                Some("/width"),
            ),
            (
                r#"{"type":"view","fsp":10}"#,
                ErrorCode::BadValue,
                Some("/fsp"),
            ),
            (
                r#"{"type":"ack","sequence":4294967296}"#,
                ErrorCode::BadValue,
                Some("/sequence"),
            ),
        ];
        for (text, code, pointer) in cases {
            let message = ClientMessage::from_json_text(text)
                .expect_err("must be refused")
                .to_message();
            assert_eq!(
                (message.code, message.pointer.as_deref()),
                (code, pointer),
                "{text}"
            );
        }
    }

    #[test]
    fn a_hello_names_the_key_that_is_wrong() {
        for (key, value, pointer) in [
            ("width", json!(0), "/width"),
            ("height", json!(100_000), "/height"),
            ("fps", json!(0.5), "/fps"),
            ("fps", json!(121), "/fps"),
            ("codec", json!("gif"), "/codec"),
            ("codecs", json!("h264"), "/codecs"),
            ("codecs", json!([]), "/codecs"),
            ("codecs", json!(["av1", "gif"]), "/codecs"),
            ("codecs", json!([1]), "/codecs"),
            ("codecs", json!(vec!["h264"; 9]), "/codecs"),
            ("jpeg_quality", json!(101), "/jpeg_quality"),
            ("renderer", json!("raster"), "/renderer"),
            ("quality", json!({"budget_ms": 0}), "/quality/budget_ms"),
            ("heigth", json!(360), "/heigth"),
            ("stereo", json!(0.064), "/stereo"),
            ("haze", json!("no"), "/haze"),
            ("scaled_colours", json!(1), "/scaled_colours"),
            (
                "stereo",
                json!({"eye_distance_m": 101}),
                "/stereo/eye_distance_m",
            ),
        ] {
            assert_eq!(
                hello_with(key, value).to_message().pointer.as_deref(),
                Some(pointer)
            );
        }
        let mut hello = hello_json();
        hello["codec"] = json!("clouds");
        assert!(read(&hello).is_ok());
        hello["show"] = json!("density");
        assert_eq!(
            read(&hello).expect_err("a codec of clouds").to_string(),
            "/show is \"density\"; allowed: \"picture\" where codec is \"clouds\""
        );
        let alone = ViewChange {
            codec: Some(Codec::Clouds),
            ..ViewChange::default()
        };
        let shown = |change: ViewChange, show| change.show_after(show, Codec::Png);
        assert!(shown(alone, Show::Picture).is_ok() && shown(alone, Show::Density).is_err());
        let mut hello = hello_json();
        hello["camera"]["pitch_deg"] = json!(100);
        let error = read(&hello).expect_err("out of range");
        assert_eq!(
            error.to_string(),
            "/camera/pitch_deg is 100; allowed: -90 to 90"
        );
    }

    proptest! {
        #[test]
        fn every_message_survives_the_wire(
            width in 1..=3840u32, height in 1..=2160u32, fps in 1.0..=120.0f64, quality in 1..=100u32,
            png in any::<bool>(), screen_space in any::<bool>(), yaw_deg in -180.0..180.0f64,
            input in any::<u64>(), sequence in any::<u32>(), decode_us in any::<Option<u32>>(),
            present_us in any::<Option<u64>>(), received_us in any::<Option<u64>>(), some in any::<[bool; 5]>(),
            max_error in proptest::option::of(proptest::option::of(0.001..=1.0f64)),
            eyes in proptest::option::of(proptest::option::of(0.0..=100.0f64)),
        ) {
            let camera = Camera::new([1.0, 2.0, 3.0], yaw_deg, 5.0, 60.0).expect("in range");
            let codec = match (png, screen_space) {
                (true, _) => Codec::Png,
                (false, true) => Codec::Clouds,
                (false, false) => Codec::Jpeg,
            };
            let codecs = if some[4] { vec![Codec::H264, codec] } else { Vec::new() };
            let jpeg_quality = JpegQuality::new(quality).expect("in range");
            let renderer = if screen_space { RendererKind::ScreenSpace } else { RendererKind::Cached };
            let show = if png { Show::Density } else { Show::Picture };
            let size = FrameSize::new(width, height).expect("in range");
            let quality = max_error.map(|choice| choice.map(QualityChoice::MaxError));
            let stereo = eyes.map(|pair| pair.and_then(|distance_m| Stereo::new(distance_m).ok()));
            prop_assume!(width <= 1920 || eyes.is_none());
            let messages = [
                ClientMessage::Hello(Hello {
                    codec, codecs: codecs.clone(), jpeg_quality, renderer, quality: quality.flatten(), show, stereo: stereo.flatten(), haze: some[2], scaled_colours: some[3], ..Hello::new(size, fps, camera)
                }),
                ClientMessage::Camera(CameraInput { input: InputSequence(input), camera }),
                ClientMessage::View(ViewChange {
                    width: some[0].then_some(width),
                    height: some[1].then_some(height),
                    fps: some[2].then_some(fps),
                    codec: some[3].then_some(codec),
                    jpeg_quality: some[4].then_some(jpeg_quality),
                    quality,
                    show: some[0].then_some(show),
                    stereo,
                    haze: some[1].then_some(png),
                }),
                ClientMessage::Ack(Acknowledgement {
                    sequence: FrameSequence(sequence), decode_us, received_us, present_us,
                    motion_to_photon_us: decode_us,
                }),
                ClientMessage::KeyFrame,
            ];
            for message in messages {
                let text = serde_json::to_string(&message).expect("serialises");
                prop_assert_eq!(ClientMessage::from_json_text(&text), Ok(message));
            }
        }

        #[test]
        fn no_text_makes_reading_a_message_panic(text in ".{0,100}") {
            let _ = ClientMessage::from_json_text(&text);
        }
    }
}

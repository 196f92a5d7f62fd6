//! Follows a camera path and keeps every picture.
//!
//! Time goes by frames, not by the clock: each step sends the next camera and waits for the picture
//! that shows it. A slow server makes the recording slower, not its steps larger. (The sky goes on
//! by the server's clock meanwhile: a sky with wind looks faster in the recording of a slow server.)

use std::path::{Path, PathBuf};
use std::time::Duration;

use image::RgbImage;
use indicatif::ProgressBar;
use serde::Serialize;
use skycell_protocol::message::{Acknowledgement, Hello};
use skycell_protocol::{
    Camera, CameraDocument, Codec, FrameCodec, FrameHeader, FrameSize, FrameStages, InputSequence,
    QualityChoice, QualityPreset, Stereo,
};
use thiserror::Error;
use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, timeout_at};

use crate::camera_path::CameraPath;
use crate::clouds_file::{CloudsFileError, clouds_of, to_exr};
use crate::picture::{PictureError, png_of, to_png};
use crate::unix_time::unix_us_now;
use crate::video::VideoDecoder;
use crate::{ConnectionError, ConnectionLimits, Event, Frame, ServerAddress, Session};

/// Frames of one recording: an hour at 24 frames a second, and file names of five digits.
pub const RECORDING_FRAMES_MAX: u32 = 99_999;

/// What to record.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Where to write `frame-00000.png` (of clouds alone `.exr`) and so on, and `index.json`.
    pub directory: PathBuf,
    /// The way of the camera.
    pub path: CameraPath,
    /// How many frames.
    pub frames: u32,
    /// Frames per second of the recording: frame i shows the path at i / fps.
    pub fps: f64,
    /// Size of the pictures, or of each of two eyes' in one.
    pub size: FrameSize,
    /// Pictures of two eyes, side by side in one file.
    pub stereo: Option<Stereo>,
    /// PNG for exact pictures, JPEG for a fast connection, H.264 for what a viewer sees of a video, files of which are PNG; or
    /// clouds alone, as EXR.
    pub codec: Codec,
    /// Colour of clouds alone includes the haze in front of them.
    pub haze: bool,
    /// Also writes the video as it came, `video.h264`: every access unit that was received, in Annex B form.
    pub raw: bool,
    /// How good pictures are to be; none for what the scene or the server says.
    pub quality: Option<QualityPreset>,
    /// How long to wait for a picture that is not coarse before a coarse one is taken.
    pub sharp_wait: Duration,
    /// How long to wait for any picture of a step.
    pub frame_timeout: Duration,
}

/// What was recorded; `index.json`.
#[derive(Clone, Debug, Serialize)]
pub struct RecordIndex {
    /// Where it was recorded.
    pub url: String,
    /// Name and version of the server.
    pub server: String,
    /// What rendered.
    pub adapter: String,
    /// Pixels in a row of a picture, of both eyes together where there are two.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The two eyes that pictures hold side by side; null for one.
    pub stereo: Option<Stereo>,
    /// Frames per second of the recording.
    pub fps: f64,
    /// The pictures in order.
    pub frames: Vec<RecordedFrame>,
}

/// One picture of a recording.
#[derive(Clone, Debug, Serialize)]
pub struct RecordedFrame {
    /// Its file, beside the index.
    pub file: String,
    /// Its moment on the path.
    pub time_s: f64,
    /// The camera that it shows.
    pub camera: CameraDocument,
    /// This machine's clock when it had arrived, µs since 1970.
    pub received_unix_us: u64,
    /// What the server said about it.
    pub header: HeaderRecord,
}

/// A frame's header as JSON; [`FrameHeader`] tells what each number means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[expect(missing_docs, reason = "field for field those of FrameHeader")]
pub struct HeaderRecord {
    pub coarse: bool,
    pub stereo: bool,
    pub key: bool,
    pub exact: bool,
    pub sequence: u32,
    pub scene_revision: u64,
    pub input: u64,
    pub cell: u32,
    pub viewer: u32,
    pub render_unix_us: u64,
    #[serde(flatten)]
    pub stages: FrameStages,
    pub payload_bytes: u32,
    pub target_kbit_per_s: u32,
}

impl From<&FrameHeader> for HeaderRecord {
    fn from(header: &FrameHeader) -> Self {
        Self {
            coarse: header.coarse,
            stereo: header.stereo,
            key: header.key,
            exact: header.exact,
            sequence: header.sequence.0,
            scene_revision: header.scene_revision,
            input: header.input.0,
            cell: header.cell.0,
            viewer: header.viewer.0,
            render_unix_us: header.render_unix_us,
            stages: header.stages,
            payload_bytes: header.payload_bytes,
            target_kbit_per_s: header.target_kbit_per_s,
        }
    }
}

/// Why a recording ended early.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecordError {
    /// No session.
    #[error(transparent)]
    Connection(#[from] ConnectionError),
    /// The server sent something else than a picture.
    #[error("frame {frame}: {source}")]
    Picture {
        /// Which.
        frame: u32,
        /// What is wrong with it.
        source: PictureError,
    },
    /// The server sent something else than clouds alone.
    #[error("frame {frame}: {source}")]
    Clouds {
        /// Which.
        frame: u32,
        /// What is wrong with it.
        source: CloudsFileError,
    },
    /// The server did not show a camera in time.
    #[error("frame {frame}: no picture of its camera within {limit_s} s")]
    NoPicture {
        /// Which.
        frame: u32,
        /// How long the server had.
        limit_s: f64,
    },
    /// A file cannot be written.
    #[error("{}: {source}", .path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The index cannot be written as JSON.
    #[error("the index cannot be written: {0}")]
    Index(#[from] serde_json::Error),
}

/// Records what `options` says and writes it to disk.
///
/// # Errors
/// If the connection breaks, a picture does not come or is none, or the disk does not take it.
/// Pictures written before stay; the index is written at the end only.
pub async fn record(
    address: &ServerAddress,
    options: &RecordOptions,
    progress: &ProgressBar,
) -> Result<RecordIndex, RecordError> {
    create_directory(&options.directory).await?;
    let first = options.path.at(0.0);
    let hello = Hello {
        codec: options.codec,
        quality: options.quality.map(QualityChoice::Preset),
        stereo: options.stereo,
        haze: options.haze,
        // A video that is kept is for players, which would show spread colours as they are.
        scaled_colours: !options.raw,
        ..Hello::new(options.size, options.fps, first)
    };
    let mut connection = Session::open(address, hello, ConnectionLimits::default()).await?;
    let welcome = connection.welcome().clone();
    let shown = match options.stereo {
        Some(_) => options.size.pair(),
        None => options.size,
    };
    let mut index = RecordIndex {
        url: address.to_string(),
        server: welcome.server,
        adapter: welcome.adapter,
        width: shown.width(),
        height: shown.height(),
        stereo: options.stereo,
        fps: options.fps,
        frames: Vec::new(),
    };
    progress.set_length(options.frames.into());
    let mut stage = Stage {
        camera: first,
        input: InputSequence(0),
        newest: None,
        video: None,
        raw: if options.raw {
            Some(RawVideo::create(options.directory.join("video.h264")).await?)
        } else {
            None
        },
    };
    for number in 0..options.frames {
        let time_s = f64::from(number) / options.fps;
        let shown = stage
            .show(&mut connection, options.path.at(time_s), number, options)
            .await?;
        let (file, bytes) = file_of(&shown, number, options.codec)?;
        write_file(&options.directory.join(&file), &bytes).await?;
        index.frames.push(RecordedFrame {
            file,
            time_s,
            camera: stage.camera.into(),
            received_unix_us: shown.frame.received_unix_us,
            header: (&shown.frame.header).into(),
        });
        progress.inc(1);
    }
    connection.close().await;
    if let Some(mut raw) = stage.raw {
        let flushed = raw.file.flush().await;
        flushed.map_err(|source| file_error(&raw.path, source))?;
    }
    let text = serde_json::to_vec_pretty(&index)?;
    write_file(&options.directory.join("index.json"), &text).await?;
    progress.finish_and_clear();
    Ok(index)
}

/// What the server has been asked to show, and what it has shown.
struct Stage {
    camera: Camera,
    input: InputSequence,
    newest: Option<Shown>,
    video: Option<VideoDecoder>,
    /// The video as it came, if it is to be kept.
    raw: Option<RawVideo>,
}

/// A video's file, in which access units follow one another.
struct RawVideo {
    path: PathBuf,
    file: tokio::fs::File,
}

impl RawVideo {
    async fn create(path: PathBuf) -> Result<Self, RecordError> {
        let file = tokio::fs::File::create(&path).await;
        let file = file.map_err(|source| file_error(&path, source))?;
        Ok(Self { path, file })
    }

    async fn append(&mut self, frame: &Frame) -> Result<(), RecordError> {
        if frame.header.codec != FrameCodec::H264 {
            return Ok(());
        }
        let written = self.file.write_all(frame.payload()).await;
        written.map_err(|source| file_error(&self.path, source))
    }
}

/// A frame, and its pixels where it was part of a video.
#[derive(Clone)]
struct Shown {
    frame: Frame,
    picture: Option<RgbImage>,
}

impl Stage {
    /// Waits for a picture of `camera`.
    async fn show(
        &mut self,
        connection: &mut Session,
        camera: Camera,
        number: u32,
        options: &RecordOptions,
    ) -> Result<Shown, RecordError> {
        // A server sends nothing where nothing changes: a camera that rests needs no new input,
        // and a picture of it may be all there will ever be.
        if camera != self.camera {
            self.input = connection.send_camera(camera).await?;
            self.camera = camera;
        }
        let mut begun = Instant::now();
        loop {
            match self.wait(connection, number, options, begun).await? {
                Some(shown) => return Ok(shown),
                // The connection is another one, which knows the camera as input 0 and has sent nothing yet.
                None => {
                    begun = Instant::now();
                    self.input = InputSequence(0);
                    self.newest = None;
                }
            }
        }
    }

    /// Waits for a picture of the last input; none when the connection was lost and is there again.
    async fn wait(
        &mut self,
        connection: &mut Session,
        number: u32,
        options: &RecordOptions,
        begun: Instant,
    ) -> Result<Option<Shown>, RecordError> {
        let sharp_until = begun + options.sharp_wait;
        let any_until = begun + options.frame_timeout.max(options.sharp_wait);
        loop {
            let shown = self
                .newest
                .as_ref()
                .filter(|shown| shown.frame.header.input >= self.input);
            let sharp = shown.is_some_and(|shown| !shown.frame.header.coarse);
            if let (Some(shown), true) = (shown, sharp || Instant::now() >= sharp_until) {
                return Ok(Some(shown.clone()));
            }
            let deadline = if shown.is_some() {
                sharp_until
            } else {
                any_until
            };
            match timeout_at(deadline, connection.next_event()).await {
                Ok(Ok(Event::Frame(frame))) => {
                    let picture = self.decode(&frame, number)?;
                    if let Some(raw) = &mut self.raw {
                        raw.append(&frame).await?;
                    }
                    connection.acknowledge(acknowledgement(&frame)).await?;
                    self.newest = Some(Shown { frame, picture });
                }
                Ok(Ok(Event::Complaint(complaint))) => {
                    return Err(ConnectionError::Refused(complaint).into());
                }
                Ok(Ok(Event::Resumed)) => return Ok(None),
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return Err(error.into()),
                Err(_) if shown.is_some() => {} // a coarse picture is taken
                Err(_) => {
                    return Err(RecordError::NoPicture {
                        frame: number,
                        limit_s: options.frame_timeout.as_secs_f64(),
                    });
                }
            }
        }
    }
}

/// The file that a frame becomes: its name and what it holds.
fn file_of(shown: &Shown, number: u32, codec: Codec) -> Result<(String, Vec<u8>), RecordError> {
    let (header, payload) = (&shown.frame.header, shown.frame.payload());
    if codec == Codec::Clouds {
        let bytes = clouds_of(header, payload).and_then(|clouds| to_exr(&clouds));
        let bytes = bytes.map_err(|source| RecordError::Clouds {
            frame: number,
            source,
        })?;
        return Ok((format!("frame-{number:05}.exr"), bytes));
    }
    let png = match &shown.picture {
        Some(picture) => png_of(picture),
        None => to_png(header, payload),
    };
    let png = png.map_err(|source| RecordError::Picture {
        frame: number,
        source,
    })?;
    Ok((format!("frame-{number:05}.png"), png))
}

impl Stage {
    /// The pixels of a frame of a video. Each builds on those before, so every one is decoded.
    fn decode(&mut self, frame: &Frame, number: u32) -> Result<Option<RgbImage>, RecordError> {
        if frame.header.codec != FrameCodec::H264 {
            return Ok(None);
        }
        let failed = |source| RecordError::Picture {
            frame: number,
            source,
        };
        let video = match &mut self.video {
            Some(video) => video,
            none => none.insert(VideoDecoder::new().map_err(failed)?),
        };
        let picture = video.decode(&frame.header, frame.payload());
        picture.map(Some).map_err(failed)
    }
}

fn acknowledgement(frame: &Frame) -> Acknowledgement {
    Acknowledgement {
        received_us: Some(frame.received_unix_us),
        present_us: Some(unix_us_now()),
        ..Acknowledgement::of(frame.header.sequence)
    }
}

async fn create_directory(path: &Path) -> Result<(), RecordError> {
    tokio::fs::create_dir_all(path)
        .await
        .map_err(|source| file_error(path, source))
}

async fn write_file(path: &Path, bytes: &[u8]) -> Result<(), RecordError> {
    tokio::fs::write(path, bytes)
        .await
        .map_err(|source| file_error(path, source))
}

fn file_error(path: &Path, source: std::io::Error) -> RecordError {
    RecordError::File {
        path: path.to_owned(),
        source,
    }
}

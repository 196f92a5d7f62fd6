//! Recording from a server whose pictures show the yaw as a colour.

mod support;

use std::path::Path;
use std::time::Duration;

use indicatif::ProgressBar;
use serde_json::Value;
use skycell_client::camera_path::CameraPath;
use skycell_client::record::{RecordError, RecordOptions, record};
use skycell_protocol::message::ClientMessage;
use skycell_protocol::{Camera, Codec, FrameSize, Stereo};
use support::{Behaviour, FakeServer, color_of};

fn options(directory: &Path, turn_deg: f64) -> RecordOptions {
    RecordOptions {
        directory: directory.to_owned(),
        path: CameraPath::turn(Camera::default(), turn_deg, 1.0).expect("a path"),
        frames: 6,
        fps: 5.0,
        size: FrameSize::new(32, 18).expect("in range"),
        stereo: None,
        codec: Codec::Png,
        haze: true,
        raw: false,
        quality: None,
        sharp_wait: Duration::from_secs(2),
        frame_timeout: Duration::from_secs(5),
    }
}

fn shown(directory: &Path, number: u32) -> [u8; 3] {
    let file = directory.join(format!("frame-{number:05}.png"));
    image::open(file)
        .expect("a picture")
        .to_rgb8()
        .get_pixel(4, 4)
        .0
}

#[tokio::test]
async fn every_picture_shows_the_camera_of_its_moment() {
    let server = FakeServer::start(Behaviour::default()).await;
    let directory = tempfile::tempdir().expect("a directory");
    let options = options(directory.path(), 100.0);
    let index = record(&server.address, &options, &ProgressBar::hidden())
        .await
        .expect("a recording");
    assert_eq!(index.frames.len(), 6);
    for (number, frame) in (0..).zip(&index.frames) {
        let camera = options.path.at(f64::from(number) / 5.0);
        assert_eq!(shown(directory.path(), number), color_of(&camera).0);
        assert_eq!(frame.camera, camera.into());
    }
    let file = std::fs::read_to_string(directory.path().join("index.json")).expect("an index");
    let file: Value = serde_json::from_str(&file).expect("JSON");
    assert_eq!(file["frames"][5]["file"], "frame-00005.png");
    assert_eq!(file["frames"][5]["header"]["input"], 5);
}

#[tokio::test]
async fn a_jpeg_stream_is_saved_as_png() {
    let server = FakeServer::start(Behaviour::default()).await;
    let directory = tempfile::tempdir().expect("a directory");
    let options = RecordOptions {
        codec: Codec::Jpeg,
        ..options(directory.path(), 100.0)
    };
    record(&server.address, &options, &ProgressBar::hidden())
        .await
        .expect("a recording");
    let expected = color_of(&options.path.at(0.6)).0;
    let differs = shown(directory.path(), 3)
        .iter()
        .zip(expected)
        .any(|(is, should)| is.abs_diff(should) > 6);
    assert!(!differs);
}

#[tokio::test]
async fn clouds_alone_are_saved_as_exr_with_their_transmittance_and_distance() {
    let server = FakeServer::start(Behaviour::default()).await;
    let directory = tempfile::tempdir().expect("a directory");
    let options = RecordOptions {
        codec: Codec::Clouds,
        ..options(directory.path(), 100.0)
    };
    let index = record(&server.address, &options, &ProgressBar::hidden())
        .await
        .expect("a recording");
    assert_eq!(index.frames[3].file, "frame-00003.exr");
    let image =
        exr::prelude::read_all_flat_layers_from_file(directory.path().join(&index.frames[3].file))
            .expect("an EXR file");
    let [layer] = image.layer_data.as_slice() else {
        panic!("{} layers", image.layer_data.len());
    };
    assert_eq!((layer.size.width(), layer.size.height()), (32, 18));
    let found: Vec<(String, f32)> = layer
        .channel_data
        .list
        .iter()
        .map(|channel| {
            let value = channel.sample_data.value_by_flat_index(40).to_f32();
            (channel.name.to_string(), value)
        })
        .collect();
    let [red, green, blue] = support::CLOUDS_RADIANCE;
    let expected = [
        ("A", 0.75),
        ("B", blue),
        ("G", green),
        ("R", red),
        ("T", 0.25),
        ("Z", 5_000.0),
    ]
    .map(|(name, value)| (name.to_owned(), value));
    assert_eq!(found, expected);
}

#[tokio::test]
async fn a_pair_of_eyes_is_asked_for_and_saved_side_by_side() {
    let server = FakeServer::start(Behaviour::default()).await;
    let directory = tempfile::tempdir().expect("a directory");
    let stereo = Stereo::new(0.064).ok();
    let options = RecordOptions {
        stereo,
        ..options(directory.path(), 100.0)
    };
    let index = record(&server.address, &options, &ProgressBar::hidden())
        .await
        .expect("a recording");
    let hello = server
        .messages()
        .into_iter()
        .find_map(|message| match message {
            ClientMessage::Hello(hello) => Some(hello),
            _ => None,
        });
    let hello = hello.expect("a hello");
    assert_eq!((hello.size, hello.stereo), (options.size, stereo));
    assert!(index.frames.iter().all(|frame| frame.header.stereo));
    assert_eq!((index.width, index.height, index.stereo), (64, 18, stereo));
    let file = image::open(directory.path().join("frame-00003.png")).expect("a picture");
    assert_eq!((file.width(), file.height()), (64, 18));
}

#[tokio::test]
async fn a_camera_that_rests_repeats_its_picture_without_asking_again() {
    let server = FakeServer::start(Behaviour::default()).await;
    let directory = tempfile::tempdir().expect("a directory");
    let index = record(
        &server.address,
        &options(directory.path(), 0.0),
        &ProgressBar::hidden(),
    )
    .await
    .expect("a recording");
    assert_eq!(index.frames.len(), 6);
    let cameras = server
        .messages()
        .into_iter()
        .filter(|message| matches!(message, ClientMessage::Camera(_)));
    assert_eq!(cameras.count(), 0);
}

#[tokio::test]
async fn a_coarse_picture_is_taken_only_if_no_sharp_one_comes() {
    let server = FakeServer::start(Behaviour {
        coarse_first: true,
        ..Behaviour::default()
    })
    .await;
    let directory = tempfile::tempdir().expect("a directory");
    let patient = options(directory.path(), 100.0);
    let index = record(&server.address, &patient, &ProgressBar::hidden())
        .await
        .expect("a recording");
    assert!(index.frames.iter().all(|frame| !frame.header.coarse));

    let hasty = RecordOptions {
        sharp_wait: Duration::ZERO,
        ..patient
    };
    let index = record(&server.address, &hasty, &ProgressBar::hidden())
        .await
        .expect("a recording");
    assert!(index.frames.iter().any(|frame| frame.header.coarse));
}

#[tokio::test]
async fn a_directory_that_cannot_be_made_is_named() {
    let server = FakeServer::start(Behaviour::default()).await;
    let directory = tempfile::tempdir().expect("a directory");
    let file = directory.path().join("taken");
    std::fs::write(&file, "").expect("a file");
    let error = record(
        &server.address,
        &options(&file, 1.0),
        &ProgressBar::hidden(),
    )
    .await
    .expect_err("a file is in the way");
    assert!(
        matches!(&error, RecordError::File { path, .. } if *path == file),
        "{error}"
    );
}

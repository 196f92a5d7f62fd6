//! Viewers with two eyes at a real server: what they ask for, what they get, what it costs.

use anyhow::ensure;
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::message::{Hello, ViewChange};
use skycell_protocol::{Codec, FrameCodec, FrameSize, RendererKind, Stereo};
use skycell_tests::picture::{colours, decoded, mean_difference};
use skycell_tests::server::total_of;
use skycell_tests::viewer::camera;
use skycell_tests::{Seen, Server, Viewer};

/// Of an eye's picture.
const SIZE: [u32; 2] = [160, 90];

fn hello(stereo: Option<Stereo>) -> anyhow::Result<Hello> {
    let camera = camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    Ok(Hello {
        codec: Codec::Png,
        stereo,
        ..Hello::new(FrameSize::new(SIZE[0], SIZE[1])?, 30.0, camera)
    })
}

fn halves(picture: &RgbImage) -> [RgbImage; 2] {
    let (width, height) = (picture.width() / 2, picture.height());
    [0, width].map(|x| image::imageops::crop_imm(picture, x, 0, width, height).to_image())
}

fn is_pair(seen: &Seen) -> bool {
    seen.frame.as_ref().is_some_and(|frame| {
        let header = &frame.header;
        header.stereo
            && (u32::from(header.width), u32::from(header.height)) == (2 * SIZE[0], SIZE[1])
    })
}

fn is_single(seen: &Seen) -> bool {
    seen.frame
        .as_ref()
        .is_some_and(|frame| !frame.header.stereo && u32::from(frame.header.width) == SIZE[0])
}

async fn told(server: &Server) -> anyhow::Result<Value> {
    Ok(server.get("api/v1/viewers").await?[0].clone())
}

#[tokio::test(flavor = "multi_thread")]
async fn two_eyes_come_in_one_picture_from_one_cache_and_go_again() -> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    let alone = Viewer::join_as(&server, hello(None)?).await?;
    let one = total_of(&server.at_rest(1).await?, "texels_updated")?;
    let single = decoded(alone.seen().frame()?)?;
    alone.close().await;
    server.at_rest(0).await?;

    // From cold caches, like the one before.
    let before = server.total("texels_updated").await?;
    let people = Stereo::new(0.064)?;
    let viewer = Viewer::join_as(&server, hello(Some(people))?).await?;
    let seen = viewer.wait_for("a picture of two eyes", is_pair).await?;
    ensure!(seen.frame()?.header.codec == FrameCodec::Png);
    let stats = server.at_rest(1).await?;
    let two = total_of(&stats, "texels_updated")? - before;
    ensure!(
        two as f64 <= 1.02 * one as f64,
        "{one} for one eye, {two} for two"
    );
    // One viewer, one request.
    ensure!(stats["cells"][0]["viewers"].as_array().map(Vec::len) == Some(1));
    ensure!(stats["cells"][0]["texels_requested"] == stats["cells"][0]["texels_unique"]);
    for half in halves(&decoded(viewer.seen().frame()?)?) {
        // 32 mm aside nothing moves that could be seen.
        let off = mean_difference(&half, &single);
        ensure!(colours(&half) > 100 && off < 0.05, "{off}");
    }
    let viewers = told(&server).await?;
    ensure!(
        viewers["stereo"] == json!({"eye_distance_m": 0.064}) && viewers["width"] == SIZE[0],
        "{viewers}"
    );
    // At rest a heartbeat says of what the picture is that stands.
    let seen = viewer
        .wait_for("a heartbeat and a status", |seen| {
            seen.heartbeat.is_some_and(|header| header.stereo) && seen.status.is_some()
        })
        .await?;
    ensure!(
        seen.status
            .is_some_and(|status| status.stereo == Some(people))
    );

    // Wider apart: what the eyes see differs, and the cell keeps what it has.
    let far = ViewChange {
        stereo: Some(Some(Stereo::new(100.0)?)),
        ..ViewChange::default()
    };
    let frames = viewer.seen().frames;
    viewer.wish(far).await?;
    viewer
        .wait_for("the next picture", |seen| {
            seen.frames > frames && is_pair(seen)
        })
        .await?;
    server.at_rest(1).await?;
    let [left, right] = halves(&decoded(viewer.seen().frame()?)?);
    let apart = mean_difference(&left, &right);
    ensure!(apart > 1.0, "{apart}");
    // Without a distance both halves are equal, to the byte.
    let none = ViewChange {
        stereo: Some(Some(Stereo::new(0.0)?)),
        ..ViewChange::default()
    };
    let frames = viewer.seen().frames;
    viewer.wish(none).await?;
    viewer
        .wait_for("the next picture", |seen| {
            seen.frames > frames && is_pair(seen)
        })
        .await?;
    server.at_rest(1).await?;
    let [left, right] = halves(&decoded(viewer.seen().frame()?)?);
    ensure!(left == right);

    // A bad wish is named and changes nothing; one eye is one again.
    let wide = ViewChange {
        width: Some(1_921),
        ..ViewChange::default()
    };
    viewer.wish(wide).await?;
    let seen = viewer
        .wait_for("a complaint", |seen| seen.complaint.is_some())
        .await?;
    let complaint = seen.complaint.as_ref().map(|c| c.message.as_str());
    ensure!(
        complaint == Some("/width is 1921; allowed: 1 to 1920 for each of two eyes"),
        "{complaint:?}"
    );
    ensure!(told(&server).await?["width"] == SIZE[0]);
    let closed = ViewChange {
        stereo: Some(None),
        ..ViewChange::default()
    };
    viewer.wish(closed).await?;
    viewer.wait_for("a picture of one eye", is_single).await?;
    ensure!(told(&server).await?["stereo"].is_null());
    viewer.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn two_eyes_with_rays_of_their_own_come_in_one_picture() -> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    let hello = Hello {
        renderer: RendererKind::ScreenSpace,
        ..hello(Some(Stereo::new(100.0)?))?
    };
    let viewer = Viewer::join_as(&server, hello).await?;
    viewer.wait_for("a picture of two eyes", is_pair).await?;
    let input = viewer.look(camera([0.0, 2.0, 0.0], 30.0, 20.0)?).await?;
    viewer
        .wait_for("a picture of where it looks now", |seen| {
            is_pair(seen) && seen.frame.as_ref().is_some_and(|f| f.header.input >= input)
        })
        .await?;
    server.at_rest(1).await?;
    let [left, right] = halves(&decoded(viewer.seen().frame()?)?);
    let apart = mean_difference(&left, &right);
    ensure!(colours(&left) > 100 && apart > 1.0, "{apart}");
    viewer.close().await;
    Ok(())
}

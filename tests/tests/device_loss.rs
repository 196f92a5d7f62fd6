//! A device that is lost under viewers: they stay, and go on when it is open again.

use std::net::SocketAddr;
use std::time::Duration;

use anyhow::{Context, ensure};
use serde_json::{Value, json};
use skycell_client::{Connection, ConnectionLimits, Event, Frame};
use skycell_protocol::message::{Acknowledgement, Hello, Status, ViewChange};
use skycell_protocol::{FrameSize, InputSequence};
use skycell_server::config::Config;
use skycell_server::frame_loop::FrameLoop;
use skycell_server::frame_loop::interface::{FrameLoopHandle, RenderCommand};
use skycell_server::scene::{Precondition, SceneStore};
use skycell_server::service::ServiceParts;
use skycell_tests::PATIENCE;
use skycell_tests::picture::{decoded, mean_difference};
use skycell_tests::server::target_dir;
use skycell_tests::viewer::camera;
use tokio::time::timeout;

type Outcome = anyhow::Result<()>;

/// Hears on and acknowledges until something is as wanted.
async fn hear_until<T>(
    connection: &mut Connection,
    what: &str,
    mut wanted: impl FnMut(&Event) -> Option<T>,
) -> anyhow::Result<T> {
    let hearing = async {
        loop {
            let event = connection.next_event().await?;
            if let Event::Frame(frame) = &event {
                let acknowledgement = Acknowledgement::of(frame.header.sequence);
                connection.acknowledge(acknowledgement).await?;
            }
            if let Some(found) = wanted(&event) {
                return anyhow::Ok(found);
            }
        }
    };
    timeout(PATIENCE, hearing)
        .await
        .with_context(|| format!("never: {what}"))?
}

fn frame_of(event: &Event) -> Option<&Frame> {
    match event {
        Event::Frame(frame) => Some(frame),
        _ => None,
    }
}

fn status_of(event: &Event) -> Option<&Status> {
    match event {
        Event::Status(status) => Some(status),
        _ => None,
    }
}

async fn get(address: SocketAddr, path: &str) -> anyhow::Result<(u16, String)> {
    let http = reqwest::Client::builder().no_proxy().build()?;
    let answer = http.get(format!("http://{address}{path}")).send().await?;
    Ok((answer.status().as_u16(), answer.text().await?))
}

/// A figure of `/metrics` without labels.
async fn figure(address: SocketAddr, name: &str) -> anyhow::Result<f64> {
    let (_, page) = get(address, "/metrics").await?;
    let line = page
        .lines()
        .find(|line| line.split_whitespace().next() == Some(name));
    let value = line.and_then(|line| line.split_whitespace().nth(1));
    Ok(value.with_context(|| format!("no {name}"))?.parse()?)
}

/// For how long, at least, there is no device in a test that says something meanwhile.
const OUTAGE: Duration = Duration::from_secs(4);

fn lose(handle: &FrameLoopHandle, closed_for: Duration) -> anyhow::Result<()> {
    Ok(handle.send(RenderCommand::LoseDevice { closed_for })?)
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_stay_when_the_device_is_lost_and_see_frames_again() -> Outcome {
    // Any client that may speak TLS asks for it.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let state = tempfile::tempdir()?;
    // No wind: every frame has a reason.
    let store = SceneStore::open(state.path().to_owned())?;
    let calm = json!({"wind": {"speed_m_per_s": 0.0}});
    let revision = store.patch(&Precondition::Any, &calm)?.revision;
    drop(store);
    let mut config = Config::new(state.path().to_owned());
    config.listen = SocketAddr::from(([127, 0, 0, 1], 0));
    config.render.noise_cache_dir = target_dir()?.join("noise-of-tests");
    // Each texel has as many samples, whatever its viewers have looked at before: pictures are compared.
    config.render.samples_by_area = Some(false);
    let parts = ServiceParts::prepare(config)?;
    let scene = parts.scene();
    let (handle, thread) = FrameLoop::start(
        parts.config().render.clone(),
        scene.scene,
        scene.revision,
        parts.frame_sink(),
        &[],
    )?;
    let service = parts.start(handle.clone()).await?;
    let address = service.address();

    let look = |yaw_deg| camera([0.0, 2.0, 0.0], yaw_deg, 20.0);
    let hello = Hello::new(FrameSize::new(160, 90)?, 30.0, look(0.0)?);
    let server_address = format!("http://{address}").parse()?;
    let join = || Connection::open(&server_address, hello.clone(), ConnectionLimits::default());
    let mut viewer = join().await?;
    let (mut who_resizes, mut who_leaves) = (join().await?, join().await?);
    for other in [&mut who_resizes, &mut who_leaves] {
        hear_until(other, "a frame", |event| frame_of(event).map(|_| ())).await?;
    }
    let before = hear_until(&mut viewer, "a finished frame", |event| {
        frame_of(event).filter(|frame| frame.header.exact).cloned()
    })
    .await?;
    let composited = figure(address, "skycell_frames_composited_total").await?;
    ensure!(get(address, "/readyz").await?.0 == 200);

    lose(&handle, OUTAGE)?;
    let note = hear_until(&mut viewer, "a note", |event| {
        status_of(event).and_then(|status| status.renderer_note.clone())
    })
    .await?;
    println!("the viewer is told: {note}");
    ensure!(note.contains("device was lost"), "{note}");
    // One looks elsewhere while there is no device, one wants other frames, one leaves and one comes: nothing of it is
    // forgotten.
    let input = viewer.send_camera(look(30.0)?).await?;
    let smaller = ViewChange {
        width: Some(96),
        height: Some(54),
        ..ViewChange::default()
    };
    who_resizes.change_view(smaller).await?;
    let left = who_leaves.welcome().viewer;
    who_leaves.close().await;
    let mut who_comes = join().await?;
    ensure!(
        get(address, "/readyz").await?.0 == 503,
        "all of it was said too late"
    );

    let after = hear_until(&mut viewer, "a sharp frame of the new view", |event| {
        frame_of(event)
            .filter(|frame| frame.header.input == input && !frame.header.coarse)
            .cloned()
    })
    .await?;
    ensure!(after.header.viewer == before.header.viewer);
    ensure!(after.header.sequence > before.header.sequence);
    ensure!(after.header.scene_revision == revision);
    hear_until(&mut viewer, "a status without the note", |event| {
        status_of(event)
            .filter(|status| status.renderer_note.is_none())
            .cloned()
    })
    .await?;
    ensure!(get(address, "/readyz").await?.0 == 200);
    ensure!(figure(address, "skycell_device_losses_total").await? == 1.0);
    hear_until(&mut who_resizes, "a frame of the new size", |event| {
        frame_of(event)
            .filter(|frame| frame.header.width == 96 && !frame.header.coarse)
            .map(|_| ())
    })
    .await?;
    hear_until(&mut who_comes, "a sharp frame for who came", |event| {
        frame_of(event)
            .filter(|frame| !frame.header.coarse)
            .map(|_| ())
    })
    .await?;
    let expected = [&viewer, &who_resizes, &who_comes].map(|viewer| viewer.welcome().viewer);
    let known: Vec<_> = handle
        .stats()
        .viewers
        .iter()
        .map(|viewer| viewer.id)
        .collect();
    ensure!(known == expected, "{known:?} are known; {left} left");
    tokio::join!(who_resizes.close(), who_comes.close());
    // Sums go on.
    ensure!(figure(address, "skycell_frames_composited_total").await? > composited);

    // The picture is that of a device that was never lost.
    let input: InputSequence = viewer.send_camera(look(0.0)?).await?;
    let again = hear_until(&mut viewer, "a finished frame of the first view", |event| {
        frame_of(event)
            .filter(|frame| frame.header.input == input && frame.header.exact)
            .cloned()
    })
    .await?;
    let difference = mean_difference(&decoded(&again)?, &decoded(&before)?);
    let turned = mean_difference(&decoded(&after)?, &decoded(&before)?);
    println!("before and after the loss: {difference:.3} of 255; the other view: {turned:.3}");
    ensure!(difference < 0.5 && turned > 2.0, "{difference}, {turned}");

    // A second loss that is over soon, and a change of the scene meanwhile.
    lose(&handle, Duration::ZERO)?;
    let http = reqwest::Client::builder().no_proxy().build()?;
    let patched = http
        .patch(format!("http://{address}/api/v1/scene"))
        .header("content-type", "application/merge-patch+json")
        .header("if-match", "*")
        .body(json!({"exposure_ev": 1.0}).to_string())
        .send()
        .await?;
    ensure!(patched.status() == 200);
    // However short it was, it is told.
    let (mut is_told, mut is_seen) = (false, false);
    hear_until(
        &mut viewer,
        "a note and a frame of the changed scene",
        |event| {
            let note = status_of(event).and_then(|status| status.renderer_note.as_ref());
            is_told |= note.is_some_and(|note| note.contains("device was lost"));
            is_seen |=
                frame_of(event).is_some_and(|frame| frame.header.scene_revision == revision + 1);
            (is_told && is_seen).then_some(())
        },
    )
    .await?;
    let (_, stats) = get(address, "/api/v1/stats").await?;
    let stats: Value = serde_json::from_str(&stats)?;
    ensure!(
        stats["device_loss"]["losses"] == 2,
        "{}",
        stats["device_loss"]
    );
    ensure!(stats["device_loss"]["is_lost"] == false);

    tokio::join!(service.shutdown(), viewer.close());
    handle.send(RenderCommand::Shutdown)?;
    let until = tokio::time::Instant::now() + Duration::from_secs(10);
    while !thread.is_finished() && tokio::time::Instant::now() < until {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    ensure!(thread.is_finished(), "the render thread does not end");
    Ok(())
}

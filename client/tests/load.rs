//! The load test against servers whose cost is known.

mod support;

use std::time::Duration;

use indicatif::ProgressBar;
use skycell_client::load::{self, LoadError, LoadOptions, LoadReport, ViewerRing};
use skycell_client::{Connection, ConnectionLimits};
use skycell_protocol::message::Hello;
use skycell_protocol::{Camera, FrameSize};
use support::{Behaviour, FakeServer, SAMPLES};

fn options() -> LoadOptions {
    let size = FrameSize::new(32, 18).expect("in range");
    LoadOptions {
        ring: ViewerRing::new(8, size, [0.0, 2.0, 0.0], 0.0, None).expect("a ring"),
        overlaps: vec![0.0, 0.6, 1.0],
        size,
        stereo: None,
        fps: 60.0,
        converge_timeout: Duration::from_secs(10),
        turn_duration: Duration::from_millis(300),
        decodes: true,
        turn_speed_deg_per_s: 10.0,
        samples_per_texel: SAMPLES as u32,
        quality: None,
        renderer_baseline: false,
        wind_off: false,
    }
}

async fn run(server: &FakeServer, options: &LoadOptions) -> Result<LoadReport, LoadError> {
    load::run(
        &server.address,
        options,
        &ProgressBar::hidden(),
        std::future::pending(),
        |_| {},
    )
    .await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_shares_everything_is_found_ideal() {
    let server = FakeServer::start(Behaviour::default()).await;
    let report = run(&server, &options()).await.expect("a report");
    assert_eq!(report.overlaps.len(), 3);
    for row in &report.overlaps {
        assert!(row.converged && row.cold_start && row.cells == 1);
        assert_eq!(row.ideal.updates_per_unique_sample, Some(1.0), "{row:?}");
        let share = row.ideal.unique_share.expect("requests");
        // The fake's texels are a quarter of a degree of 45.
        assert!(
            (share - row.ideal.unique_share_by_angles).abs() < 0.02,
            "{row:?}"
        );
        assert!((row.ideal.gpu_cache_excess.expect("time") - 1.0).abs() < 1e-9);
        let turning = row.turning.as_ref().expect("turned");
        assert!(
            turning.fps_min > 5.0 && turning.viewers.len() == 8,
            "{turning:?}"
        );
        assert!(
            turning.frame_age_ms.p50 >= 1.0 && turning.frame_age_ms.p95 >= turning.frame_age_ms.p50
        );
    }
    assert_eq!(report.overlaps[0].measured_overlap, 0.0);
    assert_eq!(report.overlaps[2].measured_overlap, 1.0);
    assert_eq!(server.viewers(), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_shares_nothing_is_found_out() {
    let server = FakeServer::start(Behaviour {
        shares_nothing: true,
        ..Behaviour::default()
    })
    .await;
    let report = run(&server, &options()).await.expect("a report");
    let all_alike = &report.overlaps[2].ideal;
    assert_eq!(all_alike.updates_per_unique_sample, Some(8.0));
    assert!(all_alike.gpu_cache_excess.expect("time") > 7.9);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_same_views_by_the_screen_space_renderer_cost_one_march_per_pixel() {
    let server = FakeServer::start(Behaviour::default()).await;
    let options = LoadOptions {
        overlaps: vec![1.0],
        renderer_baseline: true,
        turn_duration: Duration::ZERO,
        ..options()
    };
    let report = run(&server, &options).await.expect("a report");
    let figures = report.overlaps[0].screen_space.expect("measured");
    assert_eq!((figures.views, figures.marches), (8, 8 * 32 * 18));
    assert_eq!(figures.gpu_ms_once, Some(figures.gpu_ms));
    assert!(report.overlaps[0].turning.is_none());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_wind_is_put_back_also_when_the_test_is_stopped() {
    let server = FakeServer::start(Behaviour::default()).await;
    let options = LoadOptions {
        wind_off: true,
        ..options()
    };
    let (before, _) = server.scene();
    let stop = tokio::time::sleep(Duration::from_millis(300));
    let result = load::run(
        &server.address,
        &options,
        &ProgressBar::hidden(),
        stop,
        |_| {},
    )
    .await;
    assert!(matches!(result, Err(LoadError::Interrupted)));
    let (after, revision) = server.scene();
    assert_eq!((after, revision), (before, 3));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn somebody_elses_viewers_are_not_measured() {
    let server = FakeServer::start(Behaviour::default()).await;
    let hello = Hello::new(options().size, 30.0, Camera::default());
    let somebody = Connection::open(&server.address, hello, ConnectionLimits::default())
        .await
        .expect("a session");
    let error = run(&server, &options()).await.expect_err("not alone");
    assert!(error.to_string().starts_with("1 other viewers"), "{error}");
    somebody.close().await;
}

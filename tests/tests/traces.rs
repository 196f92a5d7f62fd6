//! Traces: a collector hears of requests, changes, sessions and frames; without one nothing is sent.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use anyhow::{Context, ensure};
use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::StatusCode;
use axum::routing::post;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;
use serde_json::json;
use skycell_protocol::FrameSize;
use skycell_protocol::message::Hello;
use skycell_tests::viewer::camera;
use skycell_tests::{Server, ServerOptions, Viewer};

type Outcome = anyhow::Result<()>;

#[derive(Clone, Default)]
struct Collected {
    spans: Arc<Mutex<Vec<Span>>>,
    services: Arc<Mutex<Vec<String>>>,
}

async fn collect(State(collected): State<Collected>, body: Bytes) -> StatusCode {
    let Ok(request) = ExportTraceServiceRequest::decode(body) else {
        return StatusCode::BAD_REQUEST;
    };
    for of_resource in request.resource_spans {
        let attributes = of_resource.resource.into_iter().flat_map(|r| r.attributes);
        for attribute in attributes.filter(|a| a.key == "service.name") {
            let mut services = collected.services.lock().expect("not poisoned");
            services.push(format!("{:?}", attribute.value));
        }
        let spans = of_resource.scope_spans.into_iter().flat_map(|s| s.spans);
        collected.spans.lock().expect("not poisoned").extend(spans);
    }
    StatusCode::OK
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_gets_requests_changes_sessions_and_the_stages_of_frames() -> Outcome {
    let collected = Collected::default();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?;
    let router = Router::new()
        .route("/v1/traces", post(collect))
        .with_state(collected.clone());
    let collector = tokio::spawn(async move { axum::serve(listener, router).await });

    let server = Server::start_with(ServerOptions {
        top_level_toml: format!(
            "otlp_endpoint = 'http://{address}'\notlp_frame_share = 1.0\ndrain_s = 0"
        ),
        ..ServerOptions::default()
    })
    .await?;
    let looking = camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    let hello = Hello::new(FrameSize::new(160, 90)?, 30.0, looking);
    let viewer = Viewer::join_as(&server, hello).await?;
    viewer.wait_for("frames", |seen| seen.frames >= 3).await?;
    let revision = server.patch(&json!({"exposure_ev": 1.0})).await?;
    viewer.close().await;
    server.signal("TERM")?;
    let (ended, log) = server.end().await?;
    ensure!(ended.code() == Some(0), "{ended}: {log}");
    collector.abort();

    let spans = collected.spans.lock().expect("not poisoned").clone();
    let services = collected.services.lock().expect("not poisoned").clone();
    ensure!(
        services.iter().all(|name| name.contains("skycell-server")),
        "{services:?}"
    );
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for span in &spans {
        *counts.entry(&span.name).or_default() += 1;
    }
    println!("spans: {counts:?}");
    for name in [
        "request",
        "scene change",
        "keep revision",
        "viewer session",
        "frame",
        "composite",
        "readback",
        "encode",
    ] {
        ensure!(
            counts.contains_key(name),
            "no span {name:?} among {counts:?}"
        );
    }
    let of_name = |name: &'static str| spans.iter().filter(move |span| span.name == name);
    let attribute = |span: &Span, key: &str| {
        let found = span.attributes.iter().find(|a| a.key == key);
        found.map(|a| format!("{:?}", a.value)).unwrap_or_default()
    };
    // A change belongs to its request, and says which revision it has made.
    let change = of_name("scene change").next().context("a change")?;
    ensure!(
        attribute(change, "skycell.revision").contains(&revision.to_string()),
        "{change:?}"
    );
    let request = of_name("request")
        .find(|span| span.span_id == change.parent_span_id)
        .context("the change's request")?;
    ensure!(
        attribute(request, "http.route").contains("/api/v1/scene"),
        "{request:?}"
    );
    ensure!(
        attribute(request, "http.response.status_code").contains("200"),
        "{request:?}"
    );
    // Stages lie in their frame, one after another.
    let frame = of_name("frame").next().context("a frame")?;
    let mut stages: Vec<&Span> = spans
        .iter()
        .filter(|span| span.parent_span_id == frame.span_id)
        .collect();
    stages.sort_by_key(|span| (span.start_time_unix_nano, span.end_time_unix_nano));
    ensure!(stages.len() == 6, "{stages:?}");
    for pair in stages.windows(2) {
        ensure!(
            pair[0].end_time_unix_nano <= pair[1].start_time_unix_nano,
            "{pair:?}"
        );
    }
    ensure!(frame.end_time_unix_nano == stages[5].end_time_unix_nano);
    let session = of_name("viewer session").next().context("a session")?;
    ensure!(
        !attribute(session, "skycell.frames_sent").is_empty(),
        "{session:?}"
    );
    Ok(())
}

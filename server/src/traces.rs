//! Traces for OpenTelemetry, when the configuration names a collector: requests, sessions of viewers, changes of the scene,
//! and the stages of some frames.
//!
//! Without a collector the spans are disabled where they stand (one load of an atomic), and no frame is looked at.

use std::sync::atomic::{AtomicU32, Ordering};

use skycell_protocol::FrameHeader;

/// The target of all spans that are traces. They are below every level that is logged by default.
pub const TARGET: &str = "skycell_traces";

/// One frame in so many is traced; 0 for none.
static FRAMES_EVERY: AtomicU32 = AtomicU32::new(0);

/// Traces a frame that is handed to the socket, if it is one of those.
pub fn frame_sent(header: &FrameHeader) {
    let every = FRAMES_EVERY.load(Ordering::Relaxed);
    if every != 0 && header.sequence.0.is_multiple_of(every) {
        #[cfg(feature = "otlp")]
        export::frame(header);
    }
}

#[cfg(feature = "otlp")]
pub use export::{Traces, TracesError};

#[cfg(feature = "otlp")]
mod export {
    use std::future::Future;
    use std::pin::Pin;
    use std::sync::Arc;
    use std::sync::atomic::Ordering;
    use std::time::{Duration, SystemTime};

    use opentelemetry::trace::{Span, SpanBuilder, TraceContextExt, Tracer, TracerProvider};
    use opentelemetry::{Context, KeyValue, global};
    use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};
    use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig, WithHttpConfig};
    use opentelemetry_sdk::Resource;
    use opentelemetry_sdk::trace::SdkTracerProvider;
    use skycell_protocol::FrameHeader;
    use tracing_subscriber::Layer;
    use tracing_subscriber::filter::Targets;
    use tracing_subscriber::registry::LookupSpan;

    use super::{FRAMES_EVERY, TARGET};

    /// A collector that does not answer is left after this time; spans are dropped then, and nothing waits for them.
    const EXPORT_TIMEOUT: Duration = Duration::from_secs(5);

    /// Why traces cannot be exported.
    #[derive(Debug, thiserror::Error)]
    #[non_exhaustive]
    pub enum TracesError {
        /// The exporter refuses its settings.
        #[error("cannot export traces: {0}")]
        Exporter(#[from] opentelemetry_otlp::ExporterBuildError),
        /// No HTTP client.
        #[error("cannot export traces: {0}")]
        Client(#[from] reqwest::Error),
        /// The same.
        #[error("cannot export traces: {0}")]
        Tls(#[from] rustls::Error),
    }

    /// The export of traces. Spans are collected and sent in batches by a thread of its own, which never holds up who makes
    /// them: when too many wait, new ones are dropped.
    pub struct Traces {
        provider: SdkTracerProvider,
    }

    impl Traces {
        /// Exports to a collector, by OTLP over HTTP. `frame_share` is the share of frames that are traced.
        ///
        /// # Errors
        /// If the address is none.
        pub fn start(
            endpoint: &str,
            frame_share: f64,
            runtime: tokio::runtime::Handle,
        ) -> Result<Self, TracesError> {
            let http = reqwest::Client::builder()
                .tls_backend_preconfigured(no_tls()?)
                .no_proxy()
                .redirect(reqwest::redirect::Policy::none())
                .timeout(EXPORT_TIMEOUT)
                .build()?;
            let exporter = SpanExporter::builder()
                .with_http()
                .with_http_client(Client { http, runtime })
                .with_protocol(Protocol::HttpBinary)
                .with_timeout(EXPORT_TIMEOUT)
                .with_endpoint(format!("{}/v1/traces", endpoint.trim_end_matches('/')))
                .build()?;
            let resource = Resource::builder()
                .with_service_name("skycell-server")
                .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
                .build();
            let provider = SdkTracerProvider::builder()
                .with_batch_exporter(exporter)
                .with_resource(resource)
                .build();
            global::set_tracer_provider(provider.clone());
            if frame_share > 0.0 {
                let every = (1.0 / frame_share).round().min(f64::from(u32::MAX));
                FRAMES_EVERY.store(every as u32, Ordering::Relaxed);
            }
            Ok(Self { provider })
        }

        /// What turns spans of [`TARGET`] into traces.
        pub fn layer<S>(&self) -> impl Layer<S> + use<S>
        where
            S: tracing::Subscriber + for<'span> LookupSpan<'span>,
        {
            tracing_opentelemetry::layer()
                .with_tracer(self.provider.tracer("skycell-server"))
                .with_location(false)
                .with_threads(false)
                .with_tracked_inactivity(false)
                .with_filter(Targets::new().with_target(TARGET, tracing::Level::TRACE))
        }

        /// Sends what waits and ends the export. Blocks for some seconds at most; not for a thread of the runtime.
        pub fn end(self) {
            FRAMES_EVERY.store(0, Ordering::Relaxed);
            if let Err(error) = self.provider.shutdown_with_timeout(EXPORT_TIMEOUT) {
                tracing::warn!(%error, "the last traces were not sent");
            }
        }
    }

    /// Collectors are spoken to without TLS; the client asks for its settings all the same.
    fn no_tls() -> Result<rustls::ClientConfig, rustls::Error> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        Ok(rustls::ClientConfig::builder_with_provider(provider)
            .with_protocol_versions(rustls::DEFAULT_VERSIONS)?
            .with_root_certificates(rustls::RootCertStore::empty())
            .with_no_client_auth())
    }

    /// A frame and its stages, by what its header tells: they follow each other from the composite's submission on.
    pub(super) fn frame(header: &FrameHeader) {
        let tracer = global::tracer("skycell-server");
        let at = |unix_us: u64| SystemTime::UNIX_EPOCH + Duration::from_micros(unix_us);
        let stages = &header.stages;
        let submitted_us = header.render_unix_us;
        let begun_us = submitted_us.saturating_sub(stages.input_to_render_us.into());
        let whole = SpanBuilder::from_name("frame")
            .with_start_time(at(begun_us))
            .with_attributes([
                KeyValue::new("skycell.viewer", i64::from(header.viewer.0)),
                KeyValue::new("skycell.cell", i64::from(header.cell.0)),
                KeyValue::new("skycell.sequence", i64::from(header.sequence.0)),
                KeyValue::new("skycell.payload_bytes", i64::from(header.payload_bytes)),
                KeyValue::new("skycell.march_wait_us", i64::from(stages.march_wait_us)),
            ])
            .start_with_context(&tracer, &Context::new());
        let context = Context::new().with_span(whole);
        let mut from_us = begun_us;
        for (name, took_us) in [
            ("input to render", stages.input_to_render_us),
            ("composite", stages.composite_us),
            ("readback", stages.readback_us),
            ("encode wait", stages.encode_wait_us),
            ("encode", stages.encode_us),
            ("encode to send", stages.encode_to_send_us),
        ] {
            let until_us = from_us + u64::from(took_us);
            let mut stage = tracer.build_with_context(
                SpanBuilder::from_name(name).with_start_time(at(from_us)),
                &context,
            );
            stage.end_with_timestamp(at(until_us));
            from_us = until_us;
        }
        context.span().end_with_timestamp(at(from_us));
    }

    /// The HTTP client that is there anyway, for a thread outside of the runtime that it needs.
    #[derive(Debug)]
    struct Client {
        http: reqwest::Client,
        runtime: tokio::runtime::Handle,
    }

    impl Client {
        async fn send(
            http: reqwest::Client,
            request: Request<Bytes>,
        ) -> Result<Response<Bytes>, HttpError> {
            let answer = http.execute(request.try_into()?).await?;
            let status = answer.status();
            // What a collector says of single spans is of no use here; the status is.
            Ok(Response::builder().status(status).body(Bytes::new())?)
        }
    }

    impl HttpClient for Client {
        // As `async_trait` writes it.
        fn send_bytes<'client, 'future>(
            &'client self,
            request: Request<Bytes>,
        ) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, HttpError>> + Send + 'future>>
        where
            'client: 'future,
            Self: 'future,
        {
            let sending = self.runtime.spawn(Self::send(self.http.clone(), request));
            Box::pin(async move { sending.await? })
        }
    }
}

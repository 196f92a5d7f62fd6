//! A server of the protocol without a sky: an ideal one, whose cost is exactly that of the unique
//! texels, with switches for the ways in which a server can misbehave.

#![allow(dead_code, reason = "each test file uses a part")]

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use image::{ImageFormat, Rgb, RgbImage};
use serde_json::{Value, json};
use skycell_client::unix_time::unix_us_now;
use skycell_client::{HttpApi, ServerAddress};
use skycell_protocol::clouds::CloudsHeader;
use skycell_protocol::frame::FrameHeader;
use skycell_protocol::message::{
    ClientMessage, ErrorCode, ErrorMessage, Hello, ServerMessage, Welcome,
};
use skycell_protocol::{
    Camera, CellId, Codec, FrameSequence, FrameSize, FrameStages, InputSequence, PROTOCOL_VERSION,
    RendererKind, SUBPROTOCOL, ViewerId,
};

/// Samples until a texel of the fake has converged.
pub(crate) const SAMPLES: u64 = 8;
const NS_PER_UPDATE: u64 = 1_000;
const TEXELS_PER_DEG: f64 = 4.0;

/// How the fake behaves; the default is well.
#[derive(Clone, Debug, Default)]
pub(crate) struct Behaviour {
    /// Refuses every hello with this.
    pub(crate) refuse: Option<ErrorMessage>,
    /// Never says welcome.
    pub(crate) mute: bool,
    /// Sends this after the welcome instead of pictures.
    pub(crate) garbage: Option<Vec<u8>>,
    /// Sends every picture coarse first and sharp 20 ms later.
    pub(crate) coarse_first: bool,
    /// Marches every viewer's texels anew, shared or not.
    pub(crate) shares_nothing: bool,
    /// How many patches somebody else is faster than.
    pub(crate) lost_races: u32,
}

#[derive(Default)]
struct World {
    behaviour: Behaviour,
    viewers: BTreeMap<u32, (Hello, Camera)>,
    last_viewer: u32,
    acknowledged: Vec<u32>,
    messages: Vec<ClientMessage>,
    texels_resident: BTreeSet<(u32, i64)>,
    texels_updated: u64,
    frames_composited: u64,
    marches: u64,
    scene: Value,
    revision: u64,
}

/// A running fake.
#[derive(Clone)]
pub(crate) struct FakeServer {
    world: Arc<Mutex<World>>,
    pub(crate) address: ServerAddress,
}

impl FakeServer {
    pub(crate) async fn start(behaviour: Behaviour) -> Self {
        let world = Arc::new(Mutex::new(World {
            behaviour,
            scene: json!({"version": 1, "wind": {"towards_deg": 90.0, "speed_m_per_s": 5.0}, "layers": []}),
            revision: 1,
            ..World::default()
        }));
        let router = Router::new()
            .route("/ws", get(websocket))
            .route("/api/v1/stats", get(stats))
            .route("/api/v1/scene", get(get_scene).patch(patch_scene))
            .with_state(Arc::clone(&world));
        let listener = tokio::net::TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0)))
            .await
            .expect("a free port");
        let local = listener.local_addr().expect("an address");
        tokio::spawn(async move { axum::serve(listener, router).await });
        Self {
            world,
            address: format!("ws://{local}/ws").parse().expect("an address"),
        }
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().expect("no test has panicked inside")
    }

    pub(crate) fn api(&self) -> HttpApi {
        HttpApi::new(self.address.clone()).expect("a client")
    }

    pub(crate) fn messages(&self) -> Vec<ClientMessage> {
        self.world().messages.clone()
    }

    pub(crate) fn acknowledged(&self) -> Vec<u32> {
        self.world().acknowledged.clone()
    }

    pub(crate) fn viewers(&self) -> usize {
        self.world().viewers.len()
    }

    pub(crate) fn scene(&self) -> (Value, u64) {
        let world = self.world();
        (world.scene.clone(), world.revision)
    }
}

/// The colour in which the fake paints a yaw.
pub(crate) fn color_of(camera: &Camera) -> Rgb<u8> {
    Rgb([camera.yaw_deg().rem_euclid(256.0) as u8, 100, 200])
}

fn picture_size(hello: &Hello) -> FrameSize {
    match hello.stereo {
        Some(_) => hello.size.pair(),
        None => hello.size,
    }
}

fn picture(hello: &Hello, camera: &Camera) -> Vec<u8> {
    let size = picture_size(hello);
    let pixels = RgbImage::from_pixel(size.width(), size.height(), color_of(camera));
    let format = match hello.codec {
        Codec::Jpeg => ImageFormat::Jpeg,
        Codec::Png => ImageFormat::Png,
        Codec::H264 => unreachable!("no test asks the fake for video"),
        Codec::Clouds => return clouds(size),
    };
    let mut file = Cursor::new(Vec::new());
    pixels
        .write_to(&mut file, format)
        .expect("an encodable picture");
    file.into_inner()
}

/// Radiance of the fake's clouds, at pre-exposure 4: half floats 8, 4 and 2.
pub(crate) const CLOUDS_RADIANCE: [f32; 3] = [2.0, 1.0, 0.5];

/// Clouds of transmittance 1/4 at 5 km.
fn clouds(size: FrameSize) -> Vec<u8> {
    let header = CloudsHeader {
        width: size.width(),
        height: size.height(),
        pre_exposure: 4.0,
        haze: true,
    };
    let pixel = [0x4800u16, 0x4400, 0x4000, 0x3400, 0x4500, 0].map(u16::to_le_bytes);
    let mut payload = Vec::new();
    skycell_protocol::clouds::append(
        &mut payload,
        &header,
        &pixel.as_flattened().repeat(size.pixels() as usize),
    )
    .expect("clouds");
    payload
}

async fn websocket(State(world): State<Arc<Mutex<World>>>, upgrade: WebSocketUpgrade) -> Response {
    upgrade
        .protocols([SUBPROTOCOL])
        .on_upgrade(move |socket| session(world, socket))
}

async fn session(world: Arc<Mutex<World>>, mut socket: WebSocket) {
    let behaviour = world.lock().expect("whole").behaviour.clone();
    let Some(ClientMessage::Hello(hello)) = read(&mut socket, &world).await else {
        return;
    };
    if let Some(refusal) = behaviour.refuse {
        say(&mut socket, ServerMessage::Error(refusal)).await;
        return;
    }
    if behaviour.mute {
        while socket.recv().await.is_some() {}
        return;
    }
    let viewer = {
        let mut world = world.lock().expect("whole");
        world.last_viewer += 1;
        let viewer = world.last_viewer;
        world.viewers.insert(viewer, (hello.clone(), hello.camera));
        viewer
    };
    welcome(&mut socket, viewer).await;
    if let Some(garbage) = behaviour.garbage {
        let _ = socket.send(Message::Binary(garbage.into())).await;
    } else {
        let mut stream = Frames {
            hello,
            viewer,
            sequence: 0,
            coarse_first: behaviour.coarse_first,
        };
        stream.serve(&world, &mut socket).await;
    }
    let mut world = world.lock().expect("whole");
    world.viewers.remove(&viewer);
    if world.viewers.is_empty() {
        world.texels_resident.clear();
    }
}

async fn welcome(socket: &mut WebSocket, viewer: u32) {
    let welcome = Welcome {
        protocol: PROTOCOL_VERSION,
        viewer: ViewerId(viewer),
        cell: None,
        server: "fake".to_owned(),
        adapter: "none".to_owned(),
        max_width: 3840,
        max_height: 2160,
        max_fps: 120.0,
        frame_header_bytes: 96,
        codec: Codec::Jpeg,
    };
    say(socket, ServerMessage::Welcome(welcome)).await;
}

struct Frames {
    hello: Hello,
    viewer: u32,
    sequence: u32,
    coarse_first: bool,
}

impl Frames {
    async fn serve(&mut self, world: &Arc<Mutex<World>>, socket: &mut WebSocket) {
        let (mut input, mut camera) = (InputSequence(0), self.hello.camera);
        self.show(world, socket, input, &camera).await;
        while let Some(message) = read(socket, world).await {
            match message {
                ClientMessage::Camera(moved) => {
                    (input, camera) = (moved.input, moved.camera);
                    if let Some(viewer) = world.lock().expect("whole").viewers.get_mut(&self.viewer)
                    {
                        viewer.1 = camera;
                    }
                    self.show(world, socket, input, &camera).await;
                }
                ClientMessage::Ack(ack) => {
                    world
                        .lock()
                        .expect("whole")
                        .acknowledged
                        .push(ack.sequence.0);
                }
                _ => {}
            }
        }
    }

    async fn show(
        &mut self,
        world: &Arc<Mutex<World>>,
        socket: &mut WebSocket,
        input: InputSequence,
        camera: &Camera,
    ) {
        if self.coarse_first {
            self.send(world, socket, input, camera, true).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        self.send(world, socket, input, camera, false).await;
    }

    async fn send(
        &mut self,
        world: &Arc<Mutex<World>>,
        socket: &mut WebSocket,
        input: InputSequence,
        camera: &Camera,
        coarse: bool,
    ) {
        {
            let mut world = world.lock().expect("whole");
            match self.hello.renderer {
                RendererKind::Cached => world.frames_composited += 1,
                RendererKind::ScreenSpace => world.marches += u64::from(self.hello.size.pixels()),
            }
        }
        self.sequence += 1;
        let payload = picture(&self.hello, camera);
        let header = FrameHeader {
            codec: self.hello.codec.into(),
            heartbeat: false,
            coarse,
            stereo: self.hello.stereo.is_some(),
            key: true,
            exact: !coarse,
            sequence: FrameSequence(self.sequence),
            width: picture_size(&self.hello).width() as u16,
            height: self.hello.size.height() as u16,
            scene_revision: 1,
            input,
            cell: CellId(0),
            viewer: ViewerId(self.viewer),
            render_unix_us: unix_us_now() - 1_000,
            stages: FrameStages::default(),
            payload_bytes: payload.len() as u32,
            target_kbit_per_s: 0,
            colours: None,
        };
        let mut message = header.encode().to_vec();
        message.extend_from_slice(&payload);
        let _ = socket.send(Message::Binary(message.into())).await;
    }
}

async fn read(socket: &mut WebSocket, world: &Arc<Mutex<World>>) -> Option<ClientMessage> {
    loop {
        match socket.recv().await?.ok()? {
            Message::Text(text) => {
                let message =
                    ClientMessage::from_json_text(&text).expect("clients speak the protocol");
                world.lock().expect("whole").messages.push(message.clone());
                return Some(message);
            }
            Message::Close(_) => return None,
            _ => {}
        }
    }
}

async fn say(socket: &mut WebSocket, message: ServerMessage) {
    let text = serde_json::to_string(&message).expect("serialises");
    let _ = socket.send(Message::text(text)).await;
}

impl World {
    /// A texel is a slice of yaw; two viewers that look the same way request the same ones.
    fn texels_of(hello: &Hello, camera: &Camera) -> BTreeSet<i64> {
        let aspect = f64::from(hello.size.width()) / f64::from(hello.size.height());
        let half_tan = (camera.vertical_fov_deg().to_radians() / 2.0).tan() * aspect;
        let half_deg = half_tan.atan().to_degrees();
        let slice = |yaw_deg: f64| (yaw_deg * TEXELS_PER_DEG).round() as i64;
        let round = slice(360.0);
        (slice(camera.yaw_deg() - half_deg)..slice(camera.yaw_deg() + half_deg))
            .map(|texel| texel.rem_euclid(round))
            .collect()
    }

    fn stats(&mut self) -> Value {
        let requests: BTreeMap<u32, BTreeSet<i64>> = self
            .viewers
            .iter()
            .filter(|(_, (hello, _))| hello.renderer == RendererKind::Cached)
            .map(|(id, (hello, camera))| (*id, Self::texels_of(hello, camera)))
            .collect();
        let mut askers: BTreeMap<i64, u64> = BTreeMap::new();
        for (id, texels) in &requests {
            for texel in texels {
                *askers.entry(*texel).or_default() += 1;
                let owner = if self.behaviour.shares_nothing {
                    *id
                } else {
                    0
                };
                if self.texels_resident.insert((owner, *texel)) {
                    self.texels_updated += SAMPLES;
                }
            }
        }
        let requested: u64 = askers.values().sum();
        let shared: u64 = askers.values().filter(|count| **count > 1).sum();
        let viewers: Vec<Value> = self
            .viewers
            .keys()
            .map(|id| json!({"id": id, "cell": 0, "frames_composited": 1, "frames_in_flight": 0, "renderer": "cached",
                "texels_requested": requests.get(id).map_or(0, BTreeSet::len)}))
            .collect();
        let cell = json!({"id": 0, "name": "first", "reference_m": [0, 2, 0], "viewers": requests.keys().collect::<Vec<_>>(),
            "texels_requested": requested, "texels_unique": askers.len(), "overlap": shared as f64 / requested.max(1) as f64,
            "texels_pending": 0, "tiles_resident": self.texels_resident.len(), "bytes": 4096, "converged": true});
        json!({
            "adapter": {"name": "none", "driver": "", "backend": "", "device_type": "cpu"},
            "totals": {"texels_updated": self.texels_updated, "frames_composited": self.frames_composited,
                "gpu_cache_ns": self.texels_updated * NS_PER_UPDATE, "gpu_composite_ns": self.frames_composited * 1_000_000,
                "gpu_screen_space_ns": self.marches * NS_PER_UPDATE, "screen_space_marches": self.marches, "cache_bytes": 4096},
            "cells": if requests.is_empty() { vec![] } else { vec![cell] },
            "viewers": viewers,
        })
    }
}

async fn stats(State(world): State<Arc<Mutex<World>>>) -> Response {
    axum::Json(world.lock().expect("whole").stats()).into_response()
}

async fn get_scene(State(world): State<Arc<Mutex<World>>>) -> Response {
    scene_answer(&world.lock().expect("whole"))
}

fn scene_answer(world: &World) -> Response {
    let etag = format!("\"{}\"", world.revision);
    ([(header::ETAG, etag)], axum::Json(world.scene.clone())).into_response()
}

async fn patch_scene(
    State(world): State<Arc<Mutex<World>>>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    let mut world = world.lock().expect("whole");
    let text = |name| {
        headers
            .get(name)
            .and_then(|value| value.to_str().ok())
            .unwrap_or_default()
    };
    if text(header::CONTENT_TYPE) != "application/merge-patch+json" {
        return problem(StatusCode::UNSUPPORTED_MEDIA_TYPE, "not a merge patch");
    }
    if world.behaviour.lost_races > 0 {
        world.behaviour.lost_races -= 1;
        world.revision += 1;
    }
    if text(header::IF_MATCH) != format!("\"{}\"", world.revision) {
        return problem(
            StatusCode::PRECONDITION_FAILED,
            "the scene has another revision",
        );
    }
    let patch: Value = serde_json::from_slice(&body).expect("clients send JSON");
    merge(&mut world.scene, &patch);
    world.revision += 1;
    scene_answer(&world)
}

fn problem(status: StatusCode, detail: &str) -> Response {
    (
        status,
        axum::Json(json!({"title": "no", "status": status.as_u16(), "detail": detail})),
    )
        .into_response()
}

fn merge(target: &mut Value, patch: &Value) {
    let Value::Object(members) = patch else {
        *target = patch.clone();
        return;
    };
    for (key, value) in members {
        merge(&mut target[key], value);
    }
}

/// A refusal as a full server gives it.
pub(crate) fn too_many_viewers() -> ErrorMessage {
    ErrorMessage {
        code: ErrorCode::TooManyViewers,
        pointer: None,
        message: "16 viewers are connected; allowed: 16".to_owned(),
    }
}

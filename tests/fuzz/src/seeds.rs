//! Inputs that every parser takes.

use serde_json::{Value, json};
use skycell_protocol::clouds::{CloudsHeader, PIXEL_BYTES, append};
use skycell_protocol::scene::Family;
use skycell_protocol::{
    CellId, FrameCodec, FrameHeader, FrameSequence, FrameStages, InputSequence, SceneDocument,
    ViewerId,
};
use skycell_server::field::{GreyMap, MapFileFormat};
use skycell_server::scene::presets;

use crate::mutate::Input;

fn json_inputs(values: Vec<Value>) -> Vec<Input> {
    values.into_iter().map(Input::Json).collect()
}

fn camera() -> Value {
    json!({"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 12, "vertical_fov_deg": 60})
}

fn hello_values() -> Vec<Value> {
    vec![
        json!({"type": "hello", "protocol": 1, "width": 640, "height": 360, "fps": 30, "codec": "jpeg", "camera": camera()}),
        json!({
            "type": "hello", "protocol": 1, "width": 320, "height": 180, "fps": 1.5, "codec": "png", "camera": camera(),
            "jpeg_quality": 80, "renderer": "screen-space", "quality": {"budget_ms": 5}, "show": "cache-mip",
            "stereo": {"eye_distance_m": 0.065},
        }),
    ]
}

pub(crate) fn hellos() -> Vec<Input> {
    json_inputs(hello_values())
}

pub(crate) fn client_messages() -> Vec<Input> {
    let mut messages = hello_values();
    messages.extend([
        json!({"type": "camera", "input": 7, "camera": camera()}),
        json!({"type": "view", "width": 1280, "height": 720, "quality": null, "stereo": {"eye_distance_m": 1}}),
        json!({"type": "ack", "sequence": 9, "decode_us": 1200, "present_us": 16000}),
    ]);
    json_inputs(messages)
}

pub(crate) fn server_messages() -> Vec<Input> {
    json_inputs(vec![
        json!({
            "type": "welcome", "protocol": 1, "viewer": 3, "cell": null, "server": "skycell-server", "adapter": "llvmpipe",
            "max_width": 3840, "max_height": 2160, "max_fps": 120.0, "frame_header_bytes": 96,
        }),
        json!({"type": "error", "code": "bad-value", "pointer": "/width", "message": "/width is 0; allowed: 1 to 3840"}),
    ])
}

pub(crate) fn scenes() -> Vec<Input> {
    let mut scenes = vec![
        serde_json::to_value(SceneDocument::default()).expect("JSON"),
        json!({"version": 1}),
        json!({"version": 1, "planet": null, "layers": []}),
        json!({
            "version": 1,
            "sun": {"place_and_time": {"latitude_deg": 50, "longitude_deg": 8, "date": "2026-06-21T10:30:00Z"}},
            "moon": {"of_place_and_time": true},
            "stars": {},
            "atmosphere": {"model": "physical", "light_shafts": true},
            "time": {"epoch": 0, "rate": 24, "wind_rate": 1, "paused_at": "2026-06-21T10:30:00Z"},
            "animation": [{
                "path": "/layers/0/density/coverage", "repeat": "ping-pong",
                "keyframes": [{"at_s": 0, "value": 0.2, "ease": "smooth"}, {"at_s": 60, "value": 0.8}],
            }],
            "transition": {"began": 0, "duration_s": 60, "from": {"version": 1, "layers": [{"family": "stratus"}]}},
            "drift": {"since": 0, "layers_m": {"low": [1, 2, 3]}},
            "tone": {"curve": "agx", "auto_exposure": {}},
            "quality": {"max_error": 0.01},
        }),
        json!({"version": 1, "layers": [
            {"name": "box", "density": {"model": "homogeneous", "shape": {"form": "box"}}},
            {"name": "ball", "density": {"model": "homogeneous", "shape": {"form": "sphere"}}, "phase": {"model": "draine"}},
            {"name": "grid", "density": {"model": "grid", "file": "a.raw", "dimensions": [4, 4, 4]}, "wind": {}},
        ]}),
    ];
    scenes.extend(
        Family::ALL.map(|family| json!({"version": 1, "layers": [{"family": family.name()}]})),
    );
    scenes.extend(
        presets()
            .iter()
            .map(|preset| serde_json::to_value(preset.scene.to_document()).expect("JSON")),
    );
    json_inputs(scenes)
}

pub(crate) fn merge_patches() -> Vec<Input> {
    json_inputs(vec![
        json!({}),
        json!({"sun": {"elevation_deg": 5}, "exposure_ev": 1}),
        json!({"planet": "flat", "moon": {}, "stars": {"turn_deg": 12}}),
        json!({"planet": null, "light": null}),
        json!({"atmosphere": {"model": "physical", "light_shafts": true}}),
        json!({"layers": [{"family": "cirrus"}, {"family": "cumulus", "density": {"coverage": 0.3}}]}),
        json!({"light": {"phase": {"model": "hg", "droplet_diameter_um": null, "g": 0.5}}}),
        json!({"animation": [{"path": "/exposure_ev", "keyframes": [{"at_s": 0, "value": 1}, {"at_s": 9, "value": 2}]}]}),
        json!({"time": {"rate": -3, "wind_rate": 7}, "drift": {"since": 0, "layers_m": {"low": [1, 2, 3]}}}),
        json!({"transition": {"duration_s": 9, "from": {"version": 1}}}),
    ])
}

pub(crate) fn json_patches() -> Vec<Input> {
    json_inputs(vec![
        json!([{"op": "replace", "path": "/exposure_ev", "value": 2}]),
        json!([
            {"op": "test", "path": "/layers/0/name", "value": "low"},
            {"op": "replace", "path": "/layers/0/density/coverage", "value": 0.6},
            {"op": "add", "path": "/layers/-", "value": {"name": "high", "base_altitude_m": 5000, "top_altitude_m": 6000}},
        ]),
        json!([
            {"op": "copy", "from": "/layers/0", "path": "/layers/1"},
            {"op": "replace", "path": "/layers/1/name", "value": "again"},
            {"op": "move", "from": "/layers/1", "path": "/layers/0"},
            {"op": "remove", "path": "/layers/1"},
        ]),
        json!([{"op": "add", "path": "", "value": {"version": 1}}]),
        json!([{"op": "add", "path": "/moon", "value": {}}, {"op": "remove", "path": "/light"}]),
    ])
}

fn map() -> GreyMap {
    GreyMap {
        width: 5,
        height: 3,
        values: (0..15).map(|index| index as f32 / 14.0).collect(),
    }
}

pub(crate) fn pngs() -> Vec<Input> {
    let mut eight_bits = Vec::new();
    let grey = image::GrayImage::from_fn(4, 4, |x, y| image::Luma([(40 * x + y) as u8]));
    grey.write_to(
        &mut std::io::Cursor::new(&mut eight_bits),
        image::ImageFormat::Png,
    )
    .expect("a PNG");
    vec![
        Input::Png(map().encode(MapFileFormat::Png).expect("a PNG")),
        Input::Png(eight_bits),
    ]
}

pub(crate) fn exrs() -> Vec<Input> {
    let one = GreyMap {
        width: 1,
        height: 1,
        values: vec![0.5],
    };
    vec![
        Input::Bytes(map().encode(MapFileFormat::Exr).expect("an EXR")),
        Input::Bytes(one.encode(MapFileFormat::Exr).expect("an EXR")),
    ]
}

pub(crate) fn frames() -> Vec<Input> {
    FrameCodec::ALL
        .into_iter()
        .map(|codec| {
            let header = FrameHeader {
                codec,
                heartbeat: false,
                coarse: true,
                stereo: false,
                key: true,
                exact: false,
                sequence: FrameSequence(1),
                width: 4,
                height: 2,
                scene_revision: 3,
                input: InputSequence(4),
                cell: CellId(5),
                viewer: ViewerId(6),
                render_unix_us: 7,
                stages: FrameStages::default(),
                payload_bytes: 5,
                target_kbit_per_s: 0,
                colours: None,
            };
            Input::Bytes([header.encode().as_slice(), b"cloud"].concat())
        })
        .collect()
}

pub(crate) fn clouds() -> Vec<Input> {
    [(4, 2, false), (1, 1, true)]
        .into_iter()
        .map(|(width, height, haze)| {
            let header = CloudsHeader {
                width,
                height,
                pre_exposure: 0.5,
                haze,
            };
            // Half floats of 0.5.
            let pixels = [0x00, 0x38].repeat((width * height) as usize * PIXEL_BYTES / 2);
            let mut payload = Vec::new();
            append(&mut payload, &header, &pixels).expect("a picture");
            Input::Bytes(payload)
        })
        .collect()
}

pub(crate) fn token_lines() -> Vec<Input> {
    ["view guests", "steer mission-control", "admin x"]
        .map(|holder| Input::Bytes(format!("{holder} sha256:{}", "0f".repeat(32)).into_bytes()))
        .into()
}

pub(crate) fn camera_paths() -> Vec<Input> {
    json_inputs(vec![
        json!([{"time_s": 0, "camera": camera()}]),
        json!([{"time_s": 0, "camera": camera()}, {"time_s": 8, "camera": camera()}, {"time_s": 9.5, "camera": camera()}]),
    ])
}

pub(crate) fn configurations() -> Vec<Input> {
    vec![
        Input::Toml(json!({})),
        Input::Toml(json!({
            "listen": "127.0.0.1:8080", "viewers_max": 200, "render": {"mip_bias": 1},
            "cells": [{"name": "plaza", "center_m": [10000.0, 2.0, 0.0], "radius_m": 500.0}],
        })),
    ]
}

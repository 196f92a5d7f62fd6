//! Inputs that were valid once: JSON with values exchanged, keys misspelt and numbers at their ends, pictures with bytes
//! changed and checksums made right again, texts with bytes changed.

use fastrand::Rng;
use serde_json::{Map, Value, json};

/// How long an input may become: four times what the server takes of a client.
pub const INPUT_MAX_BYTES: usize = 256 * 1024;

/// An input that is valid.
pub enum Input {
    /// JSON.
    Json(Value),
    /// A configuration; as TOML.
    Toml(Value),
    /// PNG.
    Png(Vec<u8>),
    /// Anything else.
    Bytes(Vec<u8>),
}

impl Input {
    /// What a parser gets.
    pub fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Json(value) => value.to_string().into_bytes(),
            Self::Toml(value) => toml_of(value).into_bytes(),
            Self::Png(bytes) | Self::Bytes(bytes) => bytes.clone(),
        }
    }

    /// An input of the same kind with these bytes; nothing where they are not of that kind.
    pub fn of_same_kind(&self, bytes: &[u8]) -> Option<Self> {
        match self {
            Self::Json(_) => serde_json::from_slice(bytes).ok().map(Self::Json),
            Self::Toml(_) => {
                let text = std::str::from_utf8(bytes).ok()?;
                let table = toml::from_str::<Map<String, Value>>(text).ok()?;
                Some(Self::Toml(Value::Object(table)))
            }
            Self::Png(_) => png_chunks(bytes).map(|_| Self::Png(bytes.to_vec())),
            Self::Bytes(_) => Some(Self::Bytes(bytes.to_vec())),
        }
    }
}

/// One to four mutations of one of the seeds.
pub fn mutated(seeds: &[Input], rng: &mut Rng) -> Vec<u8> {
    let seed = &seeds[rng.usize(..seeds.len())];
    let mut bytes = mutated_input(seed, seeds, rng);
    if rng.u8(..10) == 0 {
        mutate_bytes(&mut bytes, rng);
    }
    bytes.truncate(INPUT_MAX_BYTES);
    bytes
}

/// One to four mutations of an input; parts of the seeds may come into it.
pub fn mutated_input(input: &Input, seeds: &[Input], rng: &mut Rng) -> Vec<u8> {
    let times = rng.usize(1..=4);
    match input {
        Input::Json(value) | Input::Toml(value) => {
            let mut value = value.clone();
            for _ in 0..times {
                mutate_json(&mut value, seeds, rng);
            }
            match input {
                Input::Toml(_) => toml_of(&value).into_bytes(),
                _ => value.to_string().into_bytes(),
            }
        }
        Input::Png(bytes) => match png_chunks(bytes) {
            Some(chunks) => mutated_png(chunks, times, rng),
            None => bytes.clone(),
        },
        Input::Bytes(bytes) => {
            let mut bytes = bytes.clone();
            for _ in 0..times {
                mutate_bytes(&mut bytes, rng);
            }
            bytes
        }
    }
}

fn mutate_json(value: &mut Value, seeds: &[Input], rng: &mut Rng) {
    let mut places = Vec::new();
    places_of(value, String::new(), &mut places);
    let place = places[rng.usize(..places.len())].clone();
    let elsewhere = value
        .pointer(&places[rng.usize(..places.len())])
        .cloned()
        .unwrap_or_default();
    let Some(at) = value.pointer_mut(&place) else {
        return;
    };
    match rng.u8(..8) {
        0 => *at = odd_value(rng),
        1 => *at = elsewhere,
        2 => {
            // A part of another seed.
            if let Input::Json(other) | Input::Toml(other) = &seeds[rng.usize(..seeds.len())] {
                let mut places = Vec::new();
                places_of(other, String::new(), &mut places);
                *at = other
                    .pointer(&places[rng.usize(..places.len())])
                    .cloned()
                    .unwrap_or_default();
            }
        }
        _ => mutate_in_place(at, rng),
    }
}

fn mutate_in_place(at: &mut Value, rng: &mut Rng) {
    match at {
        Value::Number(number) => {
            let number = number.as_f64().unwrap_or_default();
            let changed = match rng.u8(..8) {
                0 => -number,
                1 => number + 1.0,
                2 => number * (1.0 + 1e-9),
                3 => number * 1e6,
                4 => number * 1e-300,
                5 => 0.0,
                6 => rng.f64(),
                _ => number.floor(),
            };
            *at = if rng.bool() && changed.fract() == 0.0 && changed.abs() < 1e18 {
                json!(changed as i64)
            } else {
                json!(changed)
            };
        }
        Value::String(text) => match rng.u8(..5) {
            0 => text.clear(),
            1 => text.push(['x', 'é', '/', '~', '\u{0}', '"'][rng.usize(..6)]),
            2 => {
                text.pop();
            }
            3 => *text = text.repeat(rng.usize(1..40)),
            _ => *text = text.to_uppercase(),
        },
        Value::Array(items) => match rng.u8(..4) {
            0 => {
                items.pop();
            }
            1 => {
                if let Some(item) = items.first().cloned() {
                    let count = [1, 2, 5, 70][rng.usize(..4)];
                    items.extend(std::iter::repeat_n(item, count));
                }
            }
            2 => items.reverse(),
            _ => items.insert(rng.usize(..=items.len()), odd_value(rng)),
        },
        Value::Object(members) => mutate_object(members, rng),
        Value::Bool(is) => *is = !*is,
        Value::Null => *at = odd_value(rng),
    }
}

fn mutate_object(members: &mut Map<String, Value>, rng: &mut Rng) {
    let keys: Vec<String> = members.keys().cloned().collect();
    let Some(key) = (!keys.is_empty()).then(|| keys[rng.usize(..keys.len())].clone()) else {
        members.insert("x".into(), odd_value(rng));
        return;
    };
    match rng.u8(..4) {
        0 => {
            members.remove(&key);
        }
        1 => {
            if let Some(value) = members.remove(&key) {
                members.insert(format!("{key}s"), value);
            }
        }
        2 => {
            members.insert(key, odd_value(rng));
        }
        _ => {
            members.insert(
                ["~", "/", "", "\u{0}"][rng.usize(..4)].into(),
                odd_value(rng),
            );
        }
    }
}

fn odd_value(rng: &mut Rng) -> Value {
    match rng.u8(..20) {
        0 => Value::Null,
        1 => json!(true),
        2 => json!(0),
        3 => json!(-0.0),
        4 => json!(-1),
        5 => json!(u64::MAX),
        6 => json!(i64::MIN),
        7 => json!(f64::MAX),
        8 => json!(-f64::MAX),
        9 => json!(f64::MIN_POSITIVE),
        10 => json!(0.1 + 0.2),
        11 => json!(""),
        12 => json!("\u{0}\u{fffd}\u{1f329}"),
        13 => json!("x".repeat(rng.usize(1..5000))),
        14 => json!([]),
        15 => json!({}),
        16 => json!(vec![0.5; rng.usize(1..200)]),
        17 => (0..rng.usize(1..120)).fold(json!(1), |inner, _| json!([inner])),
        18 => (0..rng.usize(1..120)).fold(json!({}), |inner, _| json!({"from": inner})),
        _ => json!("2026-06-21T10:30:00Z"),
    }
}

fn places_of(value: &Value, at: String, places: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            for (key, below) in members {
                let key = key.replace('~', "~0").replace('/', "~1");
                places_of(below, format!("{at}/{key}"), places);
            }
        }
        Value::Array(items) => {
            for (index, below) in items.iter().enumerate() {
                places_of(below, format!("{at}/{index}"), places);
            }
        }
        _ => {}
    }
    places.push(at);
}

fn mutate_bytes(bytes: &mut Vec<u8>, rng: &mut Rng) {
    if bytes.is_empty() {
        bytes.push(rng.u8(..));
        return;
    }
    let at = rng.usize(..bytes.len());
    match rng.u8(..7) {
        0 => bytes[at] ^= 1 << rng.u8(..8),
        1 => bytes[at] = rng.u8(..),
        2 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][rng.usize(..5)],
        3 => bytes.truncate(at),
        4 => {
            bytes.remove(at);
        }
        5 => bytes.insert(at, rng.u8(..)),
        _ => {
            let end = (at + rng.usize(1..=16)).min(bytes.len());
            let part = bytes[at..end].to_vec();
            let to = rng.usize(..=bytes.len());
            bytes.splice(to..to, part);
        }
    }
}

/// How a PNG begins.
const PNG_SIGNATURE: &[u8; 8] = b"\x89PNG\r\n\x1a\n";

/// Kind and content of a chunk.
type PngChunk = (Vec<u8>, Vec<u8>);

/// The chunks of a PNG, at least one; nothing where the lengths are not right.
fn png_chunks(bytes: &[u8]) -> Option<Vec<PngChunk>> {
    let mut rest = bytes.strip_prefix(PNG_SIGNATURE)?;
    let mut chunks = Vec::new();
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let end = (u32::from_be_bytes(*length) as usize).checked_add(4)?;
        chunks.push((after.get(..4)?.to_vec(), after.get(4..end)?.to_vec()));
        rest = after.get(end + 4..)?;
    }
    (!chunks.is_empty()).then_some(chunks)
}

/// Changes what chunks of a PNG hold and makes their checksums right again: with a wrong one, nothing behind it is read.
fn mutated_png(mut chunks: Vec<PngChunk>, times: usize, rng: &mut Rng) -> Vec<u8> {
    for _ in 0..times {
        let at = rng.usize(..chunks.len());
        match rng.u8(..8) {
            0 => {
                let chunk = chunks[at].clone();
                chunks.insert(at, chunk);
            }
            1 if chunks.len() > 1 => {
                chunks.remove(at);
            }
            2 => mutate_bytes(&mut chunks[at].0, rng),
            _ => mutate_bytes(&mut chunks[at].1, rng),
        }
    }
    let mut png = PNG_SIGNATURE.to_vec();
    for (mut kind, data) in chunks {
        kind.resize(4, b'x');
        png.extend_from_slice(&(data.len() as u32).to_be_bytes());
        let checked = [kind, data].concat();
        png.extend_from_slice(&checked);
        png.extend_from_slice(&crc32(&checked).to_be_bytes());
    }
    png
}

/// ISO 3309, as the PNG specification's appendix D has it.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 {
                0xedb8_8320 ^ (crc >> 1)
            } else {
                crc >> 1
            }
        })
    })
}

/// A configuration as TOML; what has no place there (null) is left out.
fn toml_of(value: &Value) -> String {
    let mut text = String::new();
    for (key, value) in value.as_object().into_iter().flatten() {
        if !value.is_null() {
            text.push_str(&format!(
                "{} = {}\n",
                Value::from(key.as_str()),
                inline(value)
            ));
        }
    }
    text
}

fn inline(value: &Value) -> String {
    match value {
        Value::Object(members) => {
            let members: Vec<String> = members
                .iter()
                .filter(|(_, value)| !value.is_null())
                .map(|(key, value)| format!("{} = {}", Value::from(key.as_str()), inline(value)))
                .collect();
            format!("{{{}}}", members.join(", "))
        }
        Value::Array(items) => {
            let items: Vec<String> = items
                .iter()
                .filter(|item| !item.is_null())
                .map(inline)
                .collect();
            format!("[{}]", items.join(", "))
        }
        other => other.to_string(),
    }
}

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

use skycell_protocol::{
    Camera, CellId, FrameCodec, FrameSequence, FrameSize, InputSequence, RendererKind, ViewerId,
};

use super::*;
use crate::clock::unix_now_us;
use crate::frame_loop::interface::{FramePixels, ViewRequest};
use crate::viewers::{Delivery, ViewerMembership};

/// Whose frames were encoded, in that order.
type Order = Arc<Mutex<Vec<(ViewerId, u32)>>>;

/// Pixels that count how many of them live, as the ring of buffers would.
struct CountedPixels {
    frame: (ViewerId, u32),
    encoded: Order,
    rgba: Vec<u8>,
    alive: Arc<AtomicUsize>,
    /// An encoder that asks for the pixels waits here.
    gate: Option<Arc<Mutex<mpsc::Receiver<()>>>>,
}

impl FramePixels for CountedPixels {
    fn rgba(&self) -> &[u8] {
        if let Some(gate) = &self.gate {
            let _ = gate.lock().expect("not poisoned").recv();
        }
        self.encoded.lock().expect("not poisoned").push(self.frame);
        &self.rgba
    }
}

impl Drop for CountedPixels {
    fn drop(&mut self) {
        self.alive.fetch_sub(1, Ordering::SeqCst);
    }
}

struct Bench {
    pool: Arc<EncoderPool>,
    registry: Arc<ViewerRegistry>,
    alive: Arc<AtomicUsize>,
    encoded: Order,
}

fn bench() -> Bench {
    let registry = ViewerRegistry::new(8);
    let metrics = Arc::new(Metrics::new().expect("good settings"));
    Bench {
        pool: EncoderPool::new(1, Arc::clone(&registry), metrics).expect("a thread"),
        registry,
        alive: Arc::default(),
        encoded: Arc::default(),
    }
}

fn size() -> FrameSize {
    FrameSize::new(16, 8).expect("in range")
}

impl Bench {
    fn join(&self) -> ViewerMembership {
        self.join_for(Codec::Png)
    }

    fn join_for(&self, codec: Codec) -> ViewerMembership {
        let view = ViewRequest {
            size: size(),
            fps: 30.0,
            codec,
            jpeg_quality: 85,
            camera: Camera::default(),
            renderer: RendererKind::Cached,
            quality: None,
            show: skycell_protocol::Show::Picture,
            stereo: None,
            haze: true,
            linear: false,
        };
        self.registry.join(view).expect("room")
    }

    fn deliver(
        &self,
        viewer: ViewerId,
        sequence: u32,
        bytes: usize,
        gate: Option<&Arc<Mutex<mpsc::Receiver<()>>>>,
    ) {
        let rgba = vec![200; bytes];
        self.deliver_pixels(viewer, sequence, rgba, gate, false);
    }

    fn deliver_pixels(
        &self,
        viewer: ViewerId,
        sequence: u32,
        rgba: Vec<u8>,
        gate: Option<&Arc<Mutex<mpsc::Receiver<()>>>>,
        refines: bool,
    ) {
        self.alive.fetch_add(1, Ordering::SeqCst);
        self.pool.deliver(FinishedFrame {
            viewer,
            sequence: FrameSequence(sequence),
            input: InputSequence(5),
            scene_revision: 6,
            cell: CellId(7),
            size: size(),
            stereo: false,
            codec: self
                .registry
                .get(viewer)
                .map_or(Codec::Png, |viewer| viewer.view().codec),
            jpeg_quality: 85,
            clouds: None,
            linear: false,
            coarse: true,
            exact: true,
            refines,
            refinement: Refinement::None,
            stages: FrameStages {
                input_to_render_us: 100,
                march_wait_us: 10,
                composite_us: 20,
                readback_us: 30,
                ..FrameStages::default()
            },
            submitted_unix_us: unix_now_us(),
            read_back: Instant::now(),
            pixels: Box::new(CountedPixels {
                frame: (viewer, sequence),
                encoded: Arc::clone(&self.encoded),
                rgba,
                alive: Arc::clone(&self.alive),
                gate: gate.cloned(),
            }),
        });
    }
}

const FRAME_BYTES: usize = 16 * 8 * 4;

fn gradient() -> Vec<u8> {
    (0..size().pixels())
        .flat_map(|index| [(index * 2) as u8, 100, 255 - index as u8, 255])
        .collect()
}

#[test]
fn a_png_is_exact_and_a_jpeg_is_close() {
    let rgba = gradient();
    for (codec, tolerance) in [(Codec::Png, 0), (Codec::Jpeg, 24)] {
        let mut out = vec![9; 3];
        encode_after(&mut out, &rgba, size(), codec, 95).expect("encodes");
        assert_eq!(&out[..3], [9; 3], "what was there stays");
        let read = image::load_from_memory(&out[3..])
            .expect("decodes")
            .to_rgba8();
        assert_eq!((read.width(), read.height()), (16, 8));
        for (a, b) in read.as_raw().iter().zip(&rgba) {
            assert!(a.abs_diff(*b) <= tolerance, "{codec:?}: {a} for {b}");
        }
    }
}

#[test]
fn pixels_that_do_not_fit_the_size_are_refused() {
    let result = encode_after(&mut Vec::new(), &[0; 7], size(), Codec::Jpeg, 85);
    assert!(matches!(
        result,
        Err(EncodeError::WrongLength { found: 7, .. })
    ));
}

#[tokio::test]
async fn a_frame_arrives_with_its_header_and_its_pixels_are_given_back() {
    let bench = bench();
    let viewer = bench.join();
    bench.deliver(viewer.id(), 3, FRAME_BYTES, None);
    let (header, message) = viewer.outbox().next().await.into_message(Instant::now());
    let (read, payload) = FrameHeader::split(&message).expect("a whole frame");
    assert_eq!(read, header);
    assert_eq!(
        (
            read.codec,
            read.sequence,
            read.input,
            read.scene_revision,
            read.cell,
            read.coarse
        ),
        (
            FrameCodec::Png,
            FrameSequence(3),
            InputSequence(5),
            6,
            CellId(7),
            true
        )
    );
    let stages = read.stages;
    assert_eq!(
        (
            read.key,
            stages.input_to_render_us,
            stages.march_wait_us,
            stages.composite_us,
            stages.readback_us
        ),
        (true, 100, 10, 20, 30),
        "what the renderer measured is passed on"
    );
    assert!(image::load_from_memory(payload).is_ok());
    assert_eq!(bench.alive.load(Ordering::SeqCst), 0);
}

#[tokio::test]
async fn of_frames_that_wait_only_the_newest_is_encoded_and_the_rest_is_counted() {
    let bench = bench();
    let viewer = bench.join();
    let (open, gate) = mpsc::channel();
    let gate = Arc::new(Mutex::new(gate));
    for sequence in 1..=50 {
        bench.deliver(viewer.id(), sequence, FRAME_BYTES, Some(&gate));
        // The one in the encoder and the one that waits.
        assert!(bench.alive.load(Ordering::SeqCst) <= 2);
    }
    drop(open);
    let last = loop {
        let (header, _) = viewer.outbox().next().await.into_message(Instant::now());
        if header.sequence == FrameSequence(50) {
            break header;
        }
    };
    assert_eq!(last.input, InputSequence(5));
    let dropped = viewer.figures().frames_dropped;
    assert!((48..=49).contains(&dropped), "{dropped}");
    assert_eq!(bench.alive.load(Ordering::SeqCst), 0);
}

#[tokio::test]
async fn a_viewer_whose_frame_cannot_be_encoded_hears_of_it_and_others_go_on() {
    let bench = bench();
    let (broken, whole) = (bench.join(), bench.join());
    bench.deliver(broken.id(), 1, 7, None);
    bench.deliver(whole.id(), 1, FRAME_BYTES, None);
    broken.failure().await;
    whole.outbox().next().await;
}

#[test]
fn a_frame_for_a_viewer_that_has_left_is_let_go() {
    let bench = bench();
    let viewer = bench.join();
    let (id, shared) = (viewer.id(), Arc::clone(&viewer));
    drop(viewer);
    bench.deliver(id, 1, FRAME_BYTES, None);
    assert_eq!(bench.alive.load(Ordering::SeqCst), 0);
    assert!(shared.outbox().take().is_none());
}

#[tokio::test]
async fn a_viewer_whose_frames_never_end_takes_turns_with_all_others() {
    let bench = bench();
    let heavy = bench.join();
    let others: Vec<_> = (0..5).map(|_| bench.join()).collect();
    let (open, gate) = mpsc::channel();
    let gate = Arc::new(Mutex::new(gate));
    // While the first frame of the heavy one is in the only encoder, its next one waits already, and so do the others'.
    bench.deliver(heavy.id(), 1, FRAME_BYTES, Some(&gate));
    while heavy.has_waiting_frame() {
        tokio::task::yield_now().await;
    }
    bench.deliver(heavy.id(), 2, FRAME_BYTES, Some(&gate));
    for other in &others {
        bench.deliver(other.id(), 1, FRAME_BYTES, None);
    }
    drop(open);
    for viewer in others.iter().chain([&heavy]) {
        while viewer.outbox().next().await.sequence() < FrameSequence(1) {}
    }
    while bench.alive.load(Ordering::SeqCst) > 0 {
        tokio::task::yield_now().await;
    }
    let encoded = bench.encoded.lock().expect("not poisoned").clone();
    let mut expected = vec![(heavy.id(), 1)];
    expected.extend(others.iter().map(|other| (other.id(), 1)));
    expected.push((heavy.id(), 2));
    assert_eq!(encoded, expected, "who was encoded, in that order");
}

/// A picture whose JPEG has some length.
fn noise() -> Vec<u8> {
    (0..FRAME_BYTES as u32)
        .map(|index| (index.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect()
}

#[tokio::test]
async fn a_slow_link_gets_shorter_pictures_and_a_whole_one_when_it_rests() {
    let bench = bench();
    let viewer = bench.join_for(Codec::Jpeg);
    let encode = async |sequence, refines| {
        bench.deliver_pixels(viewer.id(), sequence, noise(), None, refines);
        let frame = viewer.outbox().next().await;
        let is_reduced = frame.is_reduced();
        let (header, message) = frame.into_message(Instant::now());
        (header, is_reduced, message.len())
    };
    let (header, is_reduced, whole) = encode(1, false).await;
    assert!(header.exact && !is_reduced);
    assert_eq!(header.target_kbit_per_s, 0);
    // Each frame takes the link for a second.
    for second in 1..=8 {
        let delivery = Delivery {
            bytes: whole as u64,
            sent_us: second * 1_000_000,
            acknowledged_us: (second + 1) * 1_000_000,
            held_us: 0,
        };
        let mut rate = viewer.rate();
        rate.round_trip(1_000);
        rate.delivered(delivery, 30.0);
    }
    let mut last = whole;
    for sequence in 2..10 {
        let (header, _, bytes) = encode(sequence, false).await;
        assert!(header.target_kbit_per_s > 0);
        assert!(bytes <= last, "{bytes} after {last}");
        last = bytes;
    }
    assert!(last < whole);
    let (header, is_reduced, _) = encode(10, false).await;
    assert!(is_reduced && !header.exact, "less than wished is not exact");
    let (header, is_reduced, bytes) = encode(11, true).await;
    assert!(header.exact && !is_reduced);
    assert_eq!(bytes, whole);
}

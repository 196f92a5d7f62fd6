use proptest::prelude::*;

use super::*;

fn header(width: u32, height: u32) -> CloudsHeader {
    CloudsHeader {
        width,
        height,
        pre_exposure: 0.25,
        haze: true,
    }
}

/// Pixels as the renderer leaves them, of the bits of half floats.
fn pixels_of(planes: &[[u16; PLANES]]) -> Vec<u8> {
    let words = planes.iter().flat_map(|pixel| pixel.iter().chain([&0]));
    words.flat_map(|bits| bits.to_le_bytes()).collect()
}

fn payload(width: u32, height: u32, planes: &[[u16; PLANES]]) -> Vec<u8> {
    let mut out = Vec::new();
    append(&mut out, &header(width, height), &pixels_of(planes)).expect("clouds");
    out
}

/// A payload around a stream of some bytes.
fn around(width: u32, height: u32, inflated: &[u8]) -> Vec<u8> {
    let mut good = payload(1, 1, &[[0, 0, 0, 0x3c00, 0]]);
    good.truncate(CLOUDS_HEADER_BYTES);
    good[4..8].copy_from_slice(&width.to_le_bytes());
    good[8..12].copy_from_slice(&height.to_le_bytes());
    let mut stream = ZlibEncoder::new(Vec::new(), FAST);
    stream.write_all(inflated).expect("memory");
    let data = stream.finish().expect("memory");
    good[16..20].copy_from_slice(&(data.len() as u32).to_le_bytes());
    good.extend(data);
    good
}

#[test]
fn the_bytes_of_a_header_are_pinned() {
    let payload = payload(1, 1, &[[0x3801, 1, 0, 0x3800, 0x4000]]);
    let data_bytes = (payload.len() - CLOUDS_HEADER_BYTES) as u8;
    let mut expected = [0u8; CLOUDS_HEADER_BYTES];
    expected[..3].copy_from_slice(&[1, 5, 1]);
    (expected[4], expected[8], expected[15], expected[16]) = (1, 1, 0x3e, data_bytes);
    // 0.25 is 0x3e800000.
    expected[14] = 0x80;
    assert_eq!(payload[..CLOUDS_HEADER_BYTES], expected);
    let mut inflated = Vec::new();
    ZlibDecoder::new(&payload[CLOUDS_HEADER_BYTES..])
        .read_to_end(&mut inflated)
        .expect("a stream");
    // Differences from nothing, of red and blue less green's, folded: twice the number; upper byte, lower byte.
    assert_eq!(inflated, [0x70, 0, 0, 2, 0, 1, 0x70, 0, 0x80, 0]);
}

#[test]
fn colour_is_told_without_its_pre_exposure_and_distance_in_metres() {
    let clouds =
        Clouds::parse(&payload(1, 1, &[[0x3c00, 0x3800, 0, 0x3400, 0x4500]])).expect("clouds");
    assert_eq!(clouds.radiance(0), [4.0, 2.0, 0.0]);
    assert_eq!(
        (clouds.transmittance(0), clouds.distance_m(0)),
        (0.25, 5000.0)
    );
    assert_eq!(
        (clouds.width(), clouds.height(), clouds.header().haze),
        (1, 1, true)
    );
    assert_eq!(clouds.radiance(1), [0.0; 3]);
}

#[test]
fn the_sample_that_the_page_reads_too_is_read_as_it_was_written() {
    let sample = include_bytes!("../../../client/web/tests/clouds-4x3.bin");
    let clouds = Clouds::parse(sample).expect("clouds");
    assert_eq!(
        clouds.header(),
        &CloudsHeader {
            haze: false,
            ..header(4, 3)
        }
    );
    for pixel in 0..12 {
        let number = pixel as f32;
        assert_eq!(clouds.radiance(pixel), [number, 2.0 * number, 0.5]);
        assert_eq!(clouds.transmittance(pixel), 1.0 - number / 16.0);
        assert_eq!(clouds.distance_m(pixel), 1000.0 * (12.0 - number));
    }
}

#[test]
fn what_is_no_picture_of_clouds_is_refused_in_words() {
    let good = payload(2, 1, &[[0, 0, 0, 0x3c00, 0]; 2]);
    assert!(Clouds::parse(&good).is_ok());
    let with = |at: usize, byte: u8| {
        let mut bytes = good.clone();
        bytes[at] = byte;
        Clouds::parse(&bytes).expect_err("no clouds").to_string()
    };
    assert_eq!(Clouds::parse(&good[..31]), Err(CloudsError::Truncated(31)));
    for (at, byte, said) in [
        (0, 2, "version 2"),
        (1, 4, "4 planes"),
        (2, 3, "flags or reserved"),
        (31, 1, "flags or reserved"),
        (4, 0, "width of clouds is 0; allowed: 1 to 3840"),
        (10, 1, "height of clouds is 65537; allowed: 1 to 2160"),
        (12, 1, "pre_exposure"),
        (15, 0xbe, "pre_exposure of clouds is -0.25"),
        (15, 0x7f, "pre_exposure of clouds is inf"),
        (16, 1, "announce 1 bytes of data"),
        (CLOUDS_HEADER_BYTES, 0, "inflated"),
        (5, 1, "instead of 2580"),
    ] {
        let error = with(at, byte);
        assert!(error.contains(said), "{at}: {error}");
    }
    let cut = &good[..good.len() - 1];
    assert!(matches!(
        Clouds::parse(cut),
        Err(CloudsError::WrongLength { .. })
    ));
    // Too short, too long by a byte, and a bomb, which is not inflated to its end.
    for inflated in [19, 21, 50_000_000] {
        let error = Clouds::parse(&around(2, 1, &vec![0; inflated]));
        let found = inflated.min(21);
        assert_eq!(
            error,
            Err(CloudsError::WrongData {
                expected: 20,
                found
            })
        );
    }
    // Not a number, infinity, below nothing; more light than there was.
    for (plane, bits, allowed) in [
        (0, 0x7e00, "0 to 65504"),
        (1, 0x7c00, "0 to 65504"),
        (4, 0x8001, "0 to 65504"),
        (3, 0x3c01, "0 to 1"),
    ] {
        let mut pixel = [0; PLANES];
        pixel[plane] = bits;
        let error = Clouds::parse(&payload(1, 1, &[pixel])).expect_err("no clouds");
        assert!(error.to_string().contains(allowed), "{error}");
    }
}

#[test]
fn what_cannot_become_a_picture_is_refused() {
    let refused = |header: &CloudsHeader, bytes: usize| {
        append(&mut Vec::new(), header, &vec![0; bytes]).expect_err("refused")
    };
    assert_eq!(
        refused(&header(2, 1), 23),
        CloudsError::WrongPixels {
            found: 23,
            expected: 24
        }
    );
    assert!(matches!(
        refused(&header(3841, 1), 12),
        CloudsError::Size { name: "width", .. }
    ));
    let dark = CloudsHeader {
        pre_exposure: f32::NAN,
        ..header(1, 1)
    };
    assert!(matches!(refused(&dark, 12), CloudsError::PreExposure(_)));
}

proptest! {
    #[test]
    fn every_bit_of_clouds_comes_back(
        (width, planes) in (1usize..20).prop_flat_map(|width| {
            // Any colour and distance, and smooth ones, whose differences are small.
            let bits = prop_oneof![0u16..=0x7bff, 0x3000u16..0x3010];
            let pixel = (bits.clone(), bits.clone(), bits.clone(), 0u16..=0x3c00, bits)
                .prop_map(|(r, g, b, t, d)| [r, g, b, t, d]);
            (Just(width), proptest::collection::vec(pixel, width..=4 * width))
        }),
    ) {
        let height = planes.len() / width;
        let planes = &planes[..width * height];
        let clouds = Clouds::parse(&payload(width as u32, height as u32, planes)).expect("clouds");
        for (index, pixel) in planes.iter().enumerate() {
            let read = [0, 1, 2, 3, 4].map(|plane| clouds.planes()[plane][index].to_bits());
            prop_assert_eq!(&read, pixel);
        }
    }

    #[test]
    fn folding_comes_back_and_predictions_stay_between_neighbours(value: u16, left: u16, up: u16, corner: u16) {
        prop_assert_eq!(unfold(fold(value)), value);
        let expected = predicted(left, up, corner);
        prop_assert!((left.min(up)..=left.max(up)).contains(&expected));
    }

    #[test]
    fn no_bytes_make_reading_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..100),
        at in 0usize..200, byte: u8,
    ) {
        let _ = Clouds::parse(&bytes);
        let _ = Clouds::parse(&around(3, 2, &bytes));
        let mut damaged = payload(4, 2, &[[0x3000, 0x3100, 0x3200, 0x3c00, 0x4000]; 8]);
        if let Some(place) = damaged.get_mut(at) {
            *place = byte;
        }
        let _ = Clouds::parse(&damaged);
    }
}

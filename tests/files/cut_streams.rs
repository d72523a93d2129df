//! Compressed frames that were cut short and closed with their end marker.

use common::volumes::{self, fixture, read};
use intima::volume::Volume;

/// The frame's stream in a file with one fragment: its first byte and its length's place.
fn fragment(bytes: &[u8]) -> (usize, usize) {
    let pixels = bytes.windows(4).position(|w| w == b"\xe0\x7f\x10\0").expect("pixels");
    // Behind the head of twelve bytes: the offset table, then the fragment, each an item.
    let len = |at: usize| u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap()) as usize;
    let item = pixels + 12 + 8 + len(pixels + 12);
    (item + 8, len(item))
}

/// The file with its stream cut to `keep` bytes and closed with `end`, of an even length.
fn cut(bytes: &[u8], keep: usize, end: &[u8]) -> Vec<u8> {
    let (first, len) = fragment(bytes);
    let mut stream = [&bytes[first..first + keep], end].concat();
    if stream.len() % 2 == 1 {
        stream.push(0);
    }
    let mut out = bytes[..first - 4].to_vec();
    out.extend((stream.len() as u32).to_le_bytes());
    out.extend(stream);
    out.extend(&bytes[first + len..]);
    out
}

#[test]
fn a_stream_cut_short_and_closed_with_an_end_marker_is_refused() {
    let dir = common::scratch();
    let path = dir.path().join("cut.dcm");
    let values = |v: &Volume| (0..v.grid.len()).map(|i| v.real(i)).collect::<Vec<_>>();
    let mut wrong = Vec::new();
    for (name, end) in [
        ("jpeg_8", &b"\xff\xd9"[..]),
        ("jpeg_12", b"\xff\xd9"),
        ("jpeg_lossless", b"\xff\xd9"),
        ("jpeg_ls", b"\xff\xd9"),
        ("jpeg_2000", b"\xff\xd9"),
        ("htj2k", b"\xff\xd9"),
    ] {
        let feature = name.replace('_', "-");
        if feature == "jpeg-12" && volumes::read(&fixture(&format!("codec/{name}.dcm"))).is_err() {
            println!("{name}: not in this build");
            continue;
        }
        let whole = std::fs::read(fixture(&format!("codec/{name}.dcm"))).unwrap();
        let truth = values(&volumes::read(&fixture(&format!("codec/{name}.dcm"))).unwrap());
        let (_, len) = fragment(&whole);
        let (mut refused, mut same, mut worst) = (0, 0, 0);
        // From the last bytes to the first, a step apart; every place near the end.
        for keep in (16..len).filter(|k| k % 13 == 0 || len - k < 40) {
            std::fs::write(&path, cut(&whole, keep, end)).unwrap();
            match read(&path) {
                Err(e) => {
                    assert!(e.is_bad_input(), "{name}: {e}");
                    refused += 1;
                }
                Ok(v) => match values(&v).iter().zip(&truth).filter(|(a, b)| a != b).count() {
                    0 => same += 1,
                    n => worst = worst.max(n),
                },
            }
        }
        println!(
            "{name}: {len} bytes, {refused} cuts refused, {same} complete, {worst} wrong voxels"
        );
        if worst > 0 {
            wrong.push((name, worst));
        }
        assert!(refused > 20, "{name}: {refused}");
    }
    assert!(wrong.is_empty(), "wrong voxels were read: {wrong:?}");
}

/// Sides of 30,000 in a file of a kilobyte, which took gigabytes and seconds.
#[test]
fn compressed_frames_that_claim_more_than_their_bytes_are_refused_at_once() {
    let dir = common::scratch();
    let path = dir.path().join("big.dcm");
    for name in ["jpeg_8", "jpeg_lossless", "jpeg_ls", "jpeg_2000", "htj2k"] {
        let whole = std::fs::read(fixture(&format!("codec/{name}.dcm"))).unwrap();
        for side in [30_000u16, 8_000, 60_000] {
            let mut bytes = whole.clone();
            for element in [0x10, 0x11] {
                let head = [0x28, 0, element, 0, b'U', b'S', 2, 0];
                let at = bytes.windows(8).position(|w| w == head).expect("rows and columns") + 8;
                bytes[at..at + 2].copy_from_slice(&side.to_le_bytes());
            }
            // The stream's own header says the same.
            let (first, len) = fragment(&bytes);
            if let Some(i) = (first..first + len - 9)
                .find(|i| bytes[*i] == 0xff && [0xc0, 0xc1, 0xc3, 0xf7].contains(&bytes[i + 1]))
            {
                for k in [5, 7] {
                    bytes[i + k..i + k + 2].copy_from_slice(&side.to_be_bytes());
                }
            }
            let began = std::time::Instant::now();
            std::fs::write(&path, &bytes).unwrap();
            let error = read(&path).expect_err(name);
            let seconds = began.elapsed().as_secs_f64();
            println!("{name} {side}: {seconds:.3} s, {error}");
            assert!(error.is_bad_input() && seconds < 5.0, "{name}: {seconds:.3} s, {error}");
        }
    }
}

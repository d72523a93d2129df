//! Deflated DICOM: frames of one stream, and streams that stand for far more than their bytes.

use std::io::Write as _;
use std::path::Path;

use common::volumes::{read, refusal};
use flate2::Compression;
use flate2::write::DeflateEncoder;
use intima::formats::{ReadOptions, inspect};

use crate::COUNTED;
use crate::dicom::{element, enhanced};
use common::child;

/// A deflated file of a plain explicit one, with `more` behind the modality.
fn deflated(plain: &[u8], more: &[u8]) -> Vec<u8> {
    let meta = 132 + element((2, 0x10), "UI", b"1.2.840.10008.1.2.1").len();
    let at = plain.windows(6).position(|w| w == b"\x20\0\x0e\0UI").expect("a series");
    let mut out = plain[..132].to_vec();
    out.extend(element((2, 0x10), "UI", b"1.2.840.10008.1.2.1.99"));
    let mut encoder = DeflateEncoder::new(out, Compression::best());
    for part in [&plain[meta..at], more, &plain[at..]] {
        encoder.write_all(part).unwrap();
    }
    encoder.finish().unwrap()
}

fn write(dir: &Path, name: &str, bytes: &[u8]) -> std::path::PathBuf {
    let path = dir.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn frames_of_a_deflated_file_are_those_of_the_plain_one() {
    let dir = tempfile::tempdir().unwrap();
    let plain = enhanced(&[4.0, 0.0, 6.0, 2.0], true, false);
    let whole = deflated(&plain, &[]);
    let truth = read(&write(dir.path(), "plain.dcm", &plain)).unwrap();
    let got = read(&write(dir.path(), "deflated.dcm", &whole)).unwrap();
    assert_eq!(got.grid, truth.grid);
    assert_eq!(got.samples, truth.samples);
    for keep in [whole.len() - 20, whole.len() / 2, 200] {
        refusal(&write(dir.path(), "cut.dcm", &whole[..keep]));
    }
    let mut bad = whole;
    bad[220..260].fill(0xff);
    refusal(&write(dir.path(), "bad.dcm", &bad));
}

#[test]
fn frames_of_a_deflated_file_are_inflated_once() {
    let dir = tempfile::tempdir().unwrap();
    let places: Vec<f64> = (0..120).map(f64::from).collect();
    let plain = enhanced(&places, true, false);
    // Before the frames lie 48 MB that are inflated again wherever the stream is begun again.
    let path = write(
        dir.path(),
        "many.dcm",
        &deflated(&plain, &element((9, 0x1001), "OB", &vec![0; 48 << 20])),
    );
    let seconds = |f: &dyn Fn()| {
        let began = std::time::Instant::now();
        f();
        began.elapsed().as_secs_f64()
    };
    let info = seconds(&|| drop(inspect(&path, &ReadOptions::default()).unwrap()));
    let whole = seconds(&|| drop(read(&path).unwrap()));
    println!("info {info:.3} s, 120 frames {whole:.3} s");
    assert!(whole < 20.0 * info, "info {info:.3} s, 120 frames {whole:.3} s");
}

#[test]
fn a_deflated_file_takes_no_memory_for_what_is_passed_over() {
    if !child::alone("deflated::a_deflated_file_takes_no_memory_for_what_is_passed_over") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let plain = enhanced(&[0.0, 2.0], true, false);
    let bytes = deflated(&plain, &element((9, 0x1001), "OB", &vec![0; 256 << 20]));
    let path = write(dir.path(), "bomb.dcm", &bytes);
    let before = COUNTED.current_usage();
    COUNTED.reset_peak_usage();
    inspect(&path, &ReadOptions::default()).unwrap();
    read(&path).unwrap();
    let taken = COUNTED.peak_usage() - before;
    println!("{taken} bytes for a file of {} that stands for 256 MiB", bytes.len());
    assert!(taken < 8_000_000, "{taken}");
}

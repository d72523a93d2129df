//! Meshes, centerlines, pictures and videos: what is written is what is read.

use intima::formats::{NOTICE, encode_png, read_png, write_png};

#[test]
#[ignore = "a measurement, not a check"]
fn time_of_a_frame() {
    let (w, h) = (1280, 720);
    let rgb = picture(w, h);
    encode_png(w, h, &rgb);
    let t = std::time::Instant::now();
    let bytes = (0..10).map(|_| encode_png(w, h, &rgb).len()).sum::<usize>() / 10;
    println!("{:?} a frame, {bytes} bytes of {}", t.elapsed() / 10, rgb.len());
}

/// Shaded bumps with a little grain, as a rendered wall is.
fn picture(w: u32, h: u32) -> Vec<u8> {
    let mut rgb = Vec::new();
    for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y as f32, x as f32))) {
        let r = ((x - 640.0).hypot(y - 360.0) * 0.02).sin() * 0.3 + 0.6;
        let s = r + 0.1 * (0.05 * x).sin() * (0.07 * y).cos();
        rgb.extend([s * 230.0, s * s * 150.0, s * s * 140.0].map(|v| v as u8));
    }
    rgb
}

#[test]
fn png_keeps_every_pixel_carries_the_notice_and_is_repeatable() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.png");
    let rgb = picture(37, 21);
    write_png(&path, 37, 21, &rgb).unwrap();
    assert_eq!(read_png(&path).unwrap(), (37, 21, rgb.clone()));
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(bytes, encode_png(37, 21, &rgb));
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains(&format!("Disclaimer\0{NOTICE}")) && text.contains("Comment\0"));
    assert!(write_png(&path, 38, 21, &rgb).unwrap_err().to_string().contains("38x21"));
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(read_png(&path).is_err());
    assert!(read_png(&dir.path().join("none.png")).is_err());
}

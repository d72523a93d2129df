//! Pictures and videos: what is written is what is read.

use std::path::Path;

use intima::formats::{NOTICE, VideoWriter, encode_png, read_png, write_png};

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
    let begins = |chunk: &[u8]| bytes.windows(chunk.len()).position(|w| w == chunk);
    let (srgb, data) = (begins(b"sRGB").expect("colours are said to be sRGB"), begins(b"IDAT"));
    assert!(srgb < data.unwrap(), "before the pixels");
    assert!(write_png(&path, 38, 21, &rgb).unwrap_err().to_string().contains("38x21"));
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(read_png(&path).is_err());
    assert!(read_png(&dir.path().join("none.png")).is_err());
}

#[test]
fn video_has_the_size_the_frames_and_the_notice() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mp4");
    if !VideoWriter::available() {
        let error = VideoWriter::create(&path, 64, 48, 25.0).err().unwrap();
        assert!(error.to_string().contains("ffmpeg") && !error.is_bad_input());
        println!("skipped: no ffmpeg");
        return;
    }
    let (w, h) = (101, 75);
    let record = |path: &Path| {
        let mut video = VideoWriter::create(path, w, h, 25.0).unwrap();
        for k in 0..12u32 {
            let mut rgb = picture(w, h);
            rgb.rotate_left(3 * k as usize);
            video.frame(&rgb).unwrap();
        }
        assert!(video.frame(&[0; 5]).is_err());
        video.finish().unwrap();
    };
    for (name, size) in [("a.mp4", "102,76"), ("a.gif", "101,75")] {
        let (path, again) = (dir.path().join(name), dir.path().join(format!("again-{name}")));
        record(&path);
        record(&again);
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes == std::fs::read(&again).unwrap(), "{name}: same frames, same bytes");
        assert!(bytes.windows(NOTICE.len()).any(|w| w == NOTICE.as_bytes()), "{name}");
        let probe = std::process::Command::new("ffprobe")
            .args(["-v", "error", "-count_frames", "-of", "csv=p=0", "-show_entries"])
            .args(["stream=width,height,nb_read_frames,r_frame_rate"])
            .arg(&path)
            .output();
        match probe {
            Ok(out) => {
                let text = String::from_utf8_lossy(&out.stdout);
                assert_eq!(text.trim(), format!("{size},25/1,12"), "{name}");
            }
            Err(_) => println!("skipped: no ffprobe"),
        }
    }
    // Nothing stays behind from a video that was given up.
    let given_up = dir.path().join("b.mp4");
    VideoWriter::create(&given_up, w, h, 25.0).unwrap().frame(&picture(w, h)).unwrap();
    assert!(VideoWriter::create(&given_up, w, h, 25.0).unwrap().finish().is_err());
    assert!(VideoWriter::create(&given_up, w, h, f64::NAN).is_err());
    assert!(VideoWriter::create(&given_up, 0, h, 25.0).is_err());
    assert!(VideoWriter::create(&dir.path().join("b.avi"), w, h, 25.0).is_err());
    let mut left: Vec<_> =
        std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["a.gif", "a.mp4", "again-a.gif", "again-a.mp4"]);
}

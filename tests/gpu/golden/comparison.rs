//! Golden frames: small pictures a person has looked at, and what to do when one changes.
//!
//! `INTIMA_BLESS=1` writes what was drawn as the new truth. Each file names the driver that drew
//! it, and for software the processor: the same must give the same bytes. Another one may round
//! otherwise and place its samples elsewhere in a pixel, which moves an edge by less than a pixel
//! and shades a face a level or two off: each of its pixels lies between the darkest and brightest
//! of the golden's pixels about it, give or take [`UNSEEN`], and none is an exception.
//! A failure leaves `actual` and `diff` pictures under `target/golden`.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// Levels of 255 that nobody sees: two levels in all three colours are at most 2.1 units of CIELAB,
/// and 2.3 units are just noticeable (Mahy, Van Eycken & Oosterlinck, Color Research & Application
/// 19 (1994) 105-121, doi:10.1111/j.1520-6378.1994.tb00070.x).
pub const UNSEEN: u8 = 2;

/// A frame: columns, rows, RGB.
pub struct Frame {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Rows from the top, three bytes a pixel.
    pub rgb: Vec<u8>,
}

impl Frame {
    /// Mean level of a pixel.
    pub fn level(&self, x: u32, y: u32) -> f32 {
        let at = 3 * (y * self.size[0] + x) as usize;
        self.rgb[at..at + 3].iter().map(|v| f32::from(*v)).sum::<f32>() / 3.0
    }
}

/// Maker, family and model of the processor: software drivers use its own approximate roots and
/// reciprocals, and makers round these otherwise.
pub fn processor() -> String {
    let told = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let of = |key: &str| {
        let line = told.lines().find_map(|l| l.split_once(':').filter(|l| l.0.trim() == key));
        line.map_or("?", |l| l.1.trim()).to_owned()
    };
    let arch = std::env::consts::ARCH;
    format!("{arch} {} {} {}", of("vendor_id"), of("cpu family"), of("model"))
}

/// Compares `frame` with `tests/golden/<name>.png`; `driver` names what drew it.
pub fn check(name: &str, driver: &str, frame: &Frame) {
    let path = common::root().join(format!("tests/golden/{name}.png"));
    if std::env::var("INTIMA_BLESS").is_ok_and(|v| v == "1") {
        write(&path, frame, Some(driver));
        let bytes = fs::metadata(&path).unwrap().len();
        assert!(bytes < 30_000, "{name}: a golden frame of {bytes} bytes is too large");
        return;
    }
    let (golden, drawn_by) = read(&path);
    assert_eq!(golden.size, frame.size, "{name}");
    let same_driver = drawn_by == driver;
    let off = if same_driver { apart(&golden, frame) } else { beyond_neighbours(&golden, frame) };
    let allowed = if same_driver { 0 } else { UNSEEN };
    if off.iter().any(|d| *d > allowed) {
        let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("../golden");
        let shown = off.iter().flat_map(|d| [d.saturating_mul(8); 3]).collect();
        write(&dir.join(format!("{name}.actual.png")), frame, None);
        write(&dir.join(format!("{name}.diff.png")), &Frame { size: frame.size, rgb: shown }, None);
        let over = |level: u8| off.iter().filter(|d| **d > level).count();
        let counts: Vec<String> =
            [0, 1, 2, 8, 32].map(|l| format!("{} over {l}", over(l))).to_vec();
        panic!(
            "{name}: {} pixels over {allowed} levels; of {}: {}; golden by {drawn_by}, this by \
             {driver}; pictures in {}",
            over(allowed),
            off.len(),
            counts.join(", "),
            dir.display()
        );
    }
}

/// By how many levels each pixel differs, the most of its colours.
pub fn apart(golden: &Frame, frame: &Frame) -> Vec<u8> {
    let off = |(a, b): (&[u8], &[u8])| (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap_or(0);
    golden.rgb.chunks_exact(3).zip(frame.rgb.chunks_exact(3)).map(off).collect()
}

/// By how many levels each pixel is darker or brighter than all of the golden's nine about it, the
/// most of its colours.
pub fn beyond_neighbours(golden: &Frame, frame: &Frame) -> Vec<u8> {
    let [width, height] = golden.size;
    let about = |v: u32, side: u32| v.saturating_sub(1)..(v + 2).min(side);
    let off = |x: u32, y: u32| {
        let of = |channel: usize| {
            let value = |x: u32, y: u32| golden.rgb[3 * (y * width + x) as usize + channel];
            let near = || about(y, height).flat_map(|y| about(x, width).map(move |x| (x, y)));
            let low = near().map(|(x, y)| value(x, y)).min().unwrap_or(0);
            let high = near().map(|(x, y)| value(x, y)).max().unwrap_or(255);
            let v = frame.rgb[3 * (y * width + x) as usize + channel];
            low.saturating_sub(v).max(v.saturating_sub(high))
        };
        (0..3).map(of).max().unwrap_or(0)
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| off(x, y)).collect()
}

fn write(path: &Path, frame: &Frame, driver: Option<&str>) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), frame.size[0], frame.size[1]);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    if let Some(driver) = driver {
        encoder.add_text_chunk("Driver".into(), driver.into()).unwrap();
    }
    encoder.write_header().unwrap().write_image_data(&frame.rgb).unwrap();
}

fn read(path: &Path) -> (Frame, String) {
    let file = File::open(path).unwrap_or_else(|e| {
        panic!("{}: {e}; INTIMA_BLESS=1 makes it, after you have looked", path.display())
    });
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut rgb).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    let texts = &reader.info().uncompressed_latin1_text;
    let driver = texts.iter().find(|t| t.keyword == "Driver").map(|t| t.text.clone());
    (Frame { size: [info.width, info.height], rgb }, driver.unwrap_or_default())
}

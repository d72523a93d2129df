//! Golden frames: small pictures a person has looked at, and what to do when one changes.
//!
//! `INTIMA_BLESS=1` writes what was drawn as the new truth. Each file names the driver that drew
//! it, and for software the processor: the same must give the same bytes, another one stays within
//! the stated budget.
//! A failure leaves `actual` and `diff` pictures under `target/golden`.
#![allow(dead_code)]

use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// What another driver may differ by.
#[derive(Clone, Copy)]
pub struct Budget {
    /// Levels of 255 that do not count.
    pub level: u8,
    /// Pixels that may differ by more.
    pub pixels: usize,
}

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
pub fn check(name: &str, driver: &str, frame: &Frame, budget: Budget) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/{name}.png"));
    if std::env::var("INTIMA_BLESS").is_ok_and(|v| v == "1") {
        write(&path, frame, Some(driver));
        let bytes = fs::metadata(&path).unwrap().len();
        assert!(bytes < 30_000, "{name}: a golden frame of {bytes} bytes is too large");
        return;
    }
    let (golden, drawn_by) = read(&path);
    assert_eq!(golden.size, frame.size, "{name}");
    let budget = if drawn_by == driver { Budget { level: 0, pixels: 0 } } else { budget };
    let off = |a: &[u8], b: &[u8]| (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap();
    let pairs = golden.rgb.chunks_exact(3).zip(frame.rgb.chunks_exact(3));
    let diff: Vec<u8> = pairs.map(|(a, b)| off(a, b)).collect();
    let over = |level: u8| diff.iter().filter(|d| **d > level).count();
    if over(budget.level) > budget.pixels {
        let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("../golden");
        let shown = diff.iter().flat_map(|d| [d.saturating_mul(8); 3]).collect();
        write(&dir.join(format!("{name}.actual.png")), frame, None);
        let diff = Frame { size: frame.size, rgb: shown };
        write(&dir.join(format!("{name}.diff.png")), &diff, None);
        let counts: Vec<String> =
            [0, 1, 2, 8, 32].map(|l| format!("{} over {l}", over(l))).to_vec();
        panic!(
            "{name}: {} pixels over {} allowed over {}; of {}: {}; golden by {drawn_by}, \
             this by {driver}; pictures in {}",
            over(budget.level),
            budget.pixels,
            budget.level,
            diff.rgb.len() / 3,
            counts.join(", "),
            dir.display()
        );
    }
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

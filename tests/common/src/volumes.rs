//! Small inputs made by hand, and the shared real ones where they exist.

use std::path::{Path, PathBuf};
use std::process::Command;

use glam::{DMat3, DQuat, DVec3, UVec3};
use intima::formats::{FormatError, ReadOptions, read_volume};
use intima::volume::{Grid, Volume};

/// A file of tools/oracle.
pub fn fixture(name: &str) -> PathBuf {
    crate::root().join("tests/fixtures").join(name)
}

/// Reads a volume where nothing has to be chosen.
pub fn read(path: &Path) -> Result<Volume, FormatError> {
    read_volume(path, &ReadOptions::default())
}

/// What is said of a file that must not be read.
pub fn refusal(path: &Path) -> String {
    let text = read(path).expect_err("must be refused").to_string();
    println!("{text}");
    text
}

/// An oblique, anisotropic grid with four labelled points that no mirror image repeats.
pub fn phantom(left_handed: bool) -> Volume {
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.5, 0.9);
    let mut axes = DMat3::from_quat(turn);
    if left_handed {
        axes.y_axis = -axes.y_axis;
    }
    let spacing = DVec3::new(0.7, 0.9, 2.5);
    let grid = Grid::new([7, 5, 4], spacing, DVec3::new(-31.5, 12.25, 104.0), axes).unwrap();
    let mut samples = vec![0i16; grid.len()];
    for (label, v) in [(1, [0, 0, 0]), (200, [6, 0, 0]), (-300, [0, 4, 1]), (1400, [2, 1, 3])] {
        samples[grid.index(v.into())] = label;
    }
    Volume::new(grid, samples.into())
}

/// A NIfTI-1 header of a 2 × 3 × 4 volume.
#[derive(Clone)]
pub struct NiftiHeader {
    pub big: bool,
    pub code: i16,
    pub units: u8,
    pub pixdim: [f32; 3],
    pub dim4: i16,
    /// qfac, quaternion b c d, offset.
    pub qform: Option<(f32, [f32; 3], [f32; 3])>,
}

impl Default for NiftiHeader {
    fn default() -> Self {
        Self { big: false, code: 4, units: 2, pixdim: [1.0, 2.0, 3.0], dim4: 0, qform: None }
    }
}

impl NiftiHeader {
    pub fn bytes(&self) -> Vec<u8> {
        let mut h = vec![0u8; 352];
        let i16b = |v: i16| if self.big { v.to_be_bytes() } else { v.to_le_bytes() };
        let f32b = |v: f32| if self.big { v.to_be_bytes() } else { v.to_le_bytes() };
        let size = if self.big { 348i32.to_be_bytes() } else { 348i32.to_le_bytes() };
        h[..4].copy_from_slice(&size);
        let axes = if self.dim4 > 0 { 4 } else { 3 };
        for (i, d) in [axes, 2, 3, 4, self.dim4].into_iter().enumerate() {
            h[40 + 2 * i..][..2].copy_from_slice(&i16b(d));
        }
        h[70..72].copy_from_slice(&i16b(self.code));
        for (i, v) in self.pixdim.into_iter().enumerate() {
            h[80 + 4 * i..][..4].copy_from_slice(&f32b(v));
        }
        h[108..112].copy_from_slice(&f32b(352.0));
        h[123] = self.units;
        if let Some((qfac, bcd, offset)) = self.qform {
            h[76..80].copy_from_slice(&f32b(qfac));
            h[252..254].copy_from_slice(&i16b(1));
            for (i, v) in bcd.into_iter().chain(offset).enumerate() {
                h[256 + 4 * i..][..4].copy_from_slice(&f32b(v));
            }
        }
        h[344..348].copy_from_slice(b"n+1\0");
        h
    }
}

/// One DICOM slice of 12 bits in 16, 4 × 3 unless told.
#[derive(Clone)]
pub struct Slice {
    pub implicit: bool,
    pub signed: bool,
    pub syntax: &'static str,
    pub series: &'static str,
    pub photometric: &'static str,
    pub frames: &'static str,
    /// Acquisition number; left out where it is empty.
    pub acquisition: &'static str,
    /// Trigger time; left out where it is empty.
    pub trigger: &'static str,
    /// Padding value and its limit, where there are any.
    pub padding: Vec<i16>,
    pub burned_in: &'static str,
    pub recognizable: &'static str,
    /// Convolution kernel; left out where it is empty.
    pub kernel: &'static str,
    /// SOP class; left out where it is empty.
    pub class: &'static str,
    /// SOP instance; it, the study and the frame of reference are left out where it is empty.
    pub instance: String,
    pub pixel_spacing: &'static str,
    pub slope: &'static str,
    pub position: [f64; 3],
    pub orientation: [f64; 6],
    /// Columns and rows.
    pub size: [u16; 2],
    pub pixels: Vec<u16>,
    /// Put into every text element that may name somebody.
    pub canary: &'static str,
}

impl Default for Slice {
    fn default() -> Self {
        Self {
            implicit: false,
            signed: false,
            syntax: "",
            series: "1.2.3.4",
            photometric: "MONOCHROME2",
            frames: "1",
            acquisition: "",
            trigger: "",
            padding: Vec::new(),
            burned_in: "",
            recognizable: "",
            kernel: "",
            class: "",
            instance: String::new(),
            pixel_spacing: "0.75\\0.5",
            slope: "1",
            position: [0.0; 3],
            orientation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            size: [4, 3],
            pixels: (0..12).collect(),
            canary: "SOMEBODY",
        }
    }
}

/// UIDs of the study and the frame of reference of slices that have an instance.
pub const STUDY: &str = "1.2.3.1";
pub const FRAME_OF_REFERENCE: &str = "1.2.3.2";

/// The bytes of a slice's file.
pub fn dicom_slice(s: &Slice) -> Vec<u8> {
    fn put(out: &mut Vec<u8>, implicit: bool, tag: (u16, u16), vr: &str, value: &[u8]) {
        out.extend(tag.0.to_le_bytes());
        out.extend(tag.1.to_le_bytes());
        let odd = value.len() % 2;
        let len = (value.len() + odd) as u32;
        if implicit {
            out.extend(len.to_le_bytes());
        } else if vr == "OW" || vr == "SQ" {
            out.extend(vr.as_bytes());
            out.extend([0, 0]);
            out.extend(len.to_le_bytes());
        } else {
            out.extend(vr.as_bytes());
            out.extend((len as u16).to_le_bytes());
        }
        out.extend(value);
        out.extend(vec![if vr == "UI" { 0 } else { b' ' }; odd]);
    }
    let syntax = match (s.syntax, s.implicit) {
        ("", true) => "1.2.840.10008.1.2",
        ("", false) => "1.2.840.10008.1.2.1",
        (other, _) => other,
    };
    let join = |v: &[f64]| v.iter().map(f64::to_string).collect::<Vec<_>>().join("\\");
    let mut meta = Vec::new();
    put(&mut meta, false, (2, 0x10), "UI", syntax.as_bytes());
    let mut out = vec![0; 128];
    out.extend(b"DICM");
    put(&mut out, false, (2, 0), "UL", &(meta.len() as u32).to_le_bytes());
    out.extend(meta);
    let mut text =
        |tag, vr: &str, value: &str| put(&mut out, s.implicit, tag, vr, value.as_bytes());
    if !s.class.is_empty() {
        text((0x0008, 0x0016), "UI", s.class);
    }
    if !s.instance.is_empty() {
        text((0x0008, 0x0018), "UI", &s.instance);
    }
    text((0x0008, 0x0060), "CS", "CT");
    for (tag, vr) in [
        ((0x0008, 0x0080), "LO"), // institution
        ((0x0008, 0x0090), "PN"), // referring physician
        ((0x0008, 0x1010), "SH"), // station
        ((0x0008, 0x1030), "LO"), // study
        ((0x0008, 0x103e), "LO"), // series
        ((0x0009, 0x0010), "LO"), // private creator
        ((0x0009, 0x1001), "LO"), // private
        ((0x0010, 0x0010), "PN"), // patient
        ((0x0010, 0x0020), "LO"), // patient's number
        ((0x0010, 0x21b0), "LT"), // history
        ((0x0010, 0x4000), "LT"), // comments
        ((0x0018, 0x1030), "LO"), // protocol
    ] {
        text(tag, vr, s.canary);
    }
    if !s.trigger.is_empty() {
        text((0x0018, 0x1060), "DS", s.trigger);
    }
    if !s.kernel.is_empty() {
        text((0x0018, 0x1210), "SH", s.kernel);
    }
    if !s.instance.is_empty() {
        text((0x0020, 0x000d), "UI", STUDY);
    }
    text((0x0020, 0x000e), "UI", s.series);
    if !s.acquisition.is_empty() {
        text((0x0020, 0x0012), "IS", s.acquisition);
    }
    text((0x0020, 0x0032), "DS", &join(&s.position));
    text((0x0020, 0x0037), "DS", &join(&s.orientation));
    if !s.instance.is_empty() {
        text((0x0020, 0x0052), "UI", FRAME_OF_REFERENCE);
    }
    let mut word = |tag: (u16, u16), v: u16| put(&mut out, s.implicit, tag, "US", &v.to_le_bytes());
    word((0x0028, 0x0002), 1);
    let mut text =
        |tag, vr: &str, value: &str| put(&mut out, s.implicit, tag, vr, value.as_bytes());
    text((0x0028, 0x0004), "CS", s.photometric);
    text((0x0028, 0x0008), "IS", s.frames);
    let mut word = |tag: (u16, u16), v: u16| put(&mut out, s.implicit, tag, "US", &v.to_le_bytes());
    word((0x0028, 0x0010), s.size[1]);
    word((0x0028, 0x0011), s.size[0]);
    let mut text =
        |tag, vr: &str, value: &str| put(&mut out, s.implicit, tag, vr, value.as_bytes());
    text((0x0028, 0x0030), "DS", s.pixel_spacing);
    let mut word = |tag: (u16, u16), v: u16| put(&mut out, s.implicit, tag, "US", &v.to_le_bytes());
    word((0x0028, 0x0100), 16);
    word((0x0028, 0x0101), 12);
    word((0x0028, 0x0102), 11);
    word((0x0028, 0x0103), s.signed.into());
    for (element, value) in [0x0120, 0x0121].into_iter().zip(&s.padding) {
        word((0x0028, element), *value as u16);
    }
    let mut text =
        |tag, vr: &str, value: &str| put(&mut out, s.implicit, tag, vr, value.as_bytes());
    if !s.burned_in.is_empty() {
        text((0x0028, 0x0301), "CS", s.burned_in);
    }
    if !s.recognizable.is_empty() {
        text((0x0028, 0x0302), "CS", s.recognizable);
    }
    text((0x0028, 0x1052), "DS", "-1024");
    text((0x0028, 0x1053), "DS", s.slope);
    let pixels: Vec<u8> = s.pixels.iter().flat_map(|p| p.to_le_bytes()).collect();
    put(&mut out, s.implicit, (0x7fe0, 0x0010), "OW", &pixels);
    out
}

/// Noise of a voxel with a standard deviation of 1, the same in every run: a sum of four uniform
/// numbers.
pub fn noise(v: UVec3, seed: u32) -> f64 {
    let mix = |n: u32| (n ^ n >> 16).wrapping_mul(0x045d_9f3b).rotate_left(13);
    let word = mix(mix(mix(v.x ^ seed) ^ v.y) ^ v.z);
    let sum: u32 = (0..4).map(|k| mix(word ^ k) >> 8 & 0xffff).sum();
    (f64::from(sum) / 65536.0 - 2.0) / (4.0f64 / 12.0).sqrt()
}

/// The folder of real volumes, where this machine has it. With `INTIMA_REQUIRE_DATA=1` it must.
pub fn shared_data() -> Option<PathBuf> {
    let data = crate::root().join("../shared/data");
    if data.is_dir() { Some(data) } else { skipped("no shared data") }
}

/// A file of that folder, as required as the folder is.
pub fn shared_file(name: &str) -> Option<PathBuf> {
    let file = shared_data()?.join(name);
    if file.is_file() { Some(file) } else { skipped(&format!("no {name} in the shared data")) }
}

/// Says why a test of real volumes ends here.
///
/// # Panics
/// Where they are required.
fn skipped<T>(why: &str) -> Option<T> {
    let required = std::env::var("INTIMA_REQUIRE_DATA").is_ok_and(|v| v == "1");
    assert!(!required, "INTIMA_REQUIRE_DATA=1, and there is {why}");
    println!("skipped: {why}");
    None
}

/// A shared archive unpacked into a folder that goes away with the value.
pub fn unzip(name: &str) -> Option<tempfile::TempDir> {
    let archive = shared_file(name)?;
    let dir = tempfile::tempdir().unwrap();
    let quiet = |c: &mut Command| c.output().is_ok_and(|o| o.status.success());
    let done = quiet(Command::new("unzip").arg("-q").arg(&archive).arg("-d").arg(dir.path()))
        || quiet(
            Command::new("python3").args(["-m", "zipfile", "-e"]).arg(&archive).arg(dir.path()),
        );
    if done { Some(dir) } else { skipped(&format!("neither unzip nor python3 for {name}")) }
}

/// A mask (1 inside) that is hard on every assumption about grids: oblique axes, left-handed,
/// spacing 1:5, and two pieces, of which the larger is cut off by the edge of the volume. A helical
/// tube with haustra about a separate ellipsoid; more than 200,000 faces.
pub fn oblique_two_piece() -> Volume {
    use rayon::prelude::*;
    use std::f64::consts::TAU;
    let mut axes = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.3, 0.7));
    axes.x_axis = -axes.x_axis;
    let spacing = DVec3::new(0.5, 0.5, 2.5);
    let dims = [212, 216, 50];
    let grid = Grid::new(dims, spacing, DVec3::new(-61.5, 40.25, -318.0), axes).unwrap();
    // Millimetres along the index axes. The tube's axis passes 3 mm from the face x = 0.
    let middle = DVec3::new(48.0, 54.0, 62.0);
    let (ring, pitch, turns) = (45.0, 26.0, 3.4);
    let inside = |i: usize| {
        let p = grid.voxel(i).as_dvec3() * spacing - middle;
        if (p / DVec3::new(14.0, 9.0, 25.0)).length() < 1.0 {
            return true;
        }
        let (across, angle) = (p.truncate().length() - ring, p.y.atan2(p.x));
        (-2..3).map(|k| angle / TAU + f64::from(k)).filter(|t| t.abs() < 0.5 * turns).any(|t| {
            let radius = 7.5 + 1.5 * (40.0 * t).sin();
            DVec3::new(across, 0.0, p.z - pitch * t).length() < radius
        })
    };
    let samples: Vec<u8> = (0..grid.len()).into_par_iter().map(|i| u8::from(inside(i))).collect();
    Volume::new(grid, samples.into())
}

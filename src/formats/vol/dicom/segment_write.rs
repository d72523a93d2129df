//! Segmentations out (DICOM SEG, PS3.3 A.51): one segment, a bit a pixel, a frame for each slice in
//! which the segment has a voxel.
//!
//! No clock and no random number is asked, so that the same mask of the same series gives the same
//! bytes: UIDs are a hash of the rest of the file.

use std::path::Path;

use super::super::FormatError;
use super::super::segment_description::SegmentDescription;
use super::data_set::{DataSet, uid};
use super::element::Tag;
use super::source_series::{CONTENT_DATE, CONTENT_TIME, LOSSY, PATIENT, SourceSeries};
use crate::formats::atomic_file::write_atomic;

/// Segmentation Storage.
const CLASS: &str = "1.2.840.10008.5.1.4.1.1.66.4";
/// Bytes of pixels that an element can hold.
const MAX_PIXELS: u64 = u32::MAX as u64 - 1;
/// Date and time of a segmentation of which none is known.
const NO_DATE: &[u8] = b"19700101";
const NO_TIME: &[u8] = b"000000";

/// UIDs that a segmentation needs of its own.
#[derive(Default)]
struct OwnUids {
    series: String,
    instance: String,
    dimensions: String,
    /// For a series that names no frame of reference.
    frame_of_reference: String,
}

impl SourceSeries {
    /// Writes a mask of the series' volume as a DICOM segmentation (`.dcm`).
    ///
    /// * `mask`: a number a voxel, x fastest, not zero in the segment.
    /// * `keep_patient`: whether patient and study are described as in the series; else those
    ///   fields are empty or absent. UIDs of study and series are always those of the series.
    ///
    /// # Errors
    /// [`FormatError::Unsupported`] for a mask that does not match, is empty or too large for one
    /// file, and in the place of a slice; [`FormatError::Io`] with no partial file left behind.
    pub fn write_segment(
        &self,
        path: &Path,
        mask: &[u8],
        segment: &SegmentDescription,
        keep_patient: bool,
    ) -> Result<(), FormatError> {
        if mask.len() != self.grid.len() {
            let what = format!("{} voxels of a mask for {}", mask.len(), self.grid.len());
            return Err(FormatError::unsupported(path, what));
        }
        if self.holds(path) {
            return Err(FormatError::unsupported(path, "a segmentation in the place of a slice"));
        }
        let side = self.grid.dims.x as usize * self.grid.dims.y as usize;
        let is_set = |k: &usize| mask[k * side..][..side].iter().any(|v| *v != 0);
        let frames: Vec<usize> = (0..self.slices.len()).filter(is_set).collect();
        let bytes = (side as u64 * frames.len() as u64).div_ceil(8);
        if frames.is_empty() || bytes > MAX_PIXELS {
            let what = format!("a DICOM segmentation of {} frames", frames.len());
            return Err(FormatError::unsupported(path, what));
        }
        let pixels = packed(mask, side, &frames);
        let content = self.data_set(&frames, segment, keep_patient, &OwnUids::default()).bytes();
        let own = |name: &[u8]| {
            let mut hasher = blake3::Hasher::new();
            hasher.update(&content).update(&pixels).update(name);
            uid(&hasher.finalize())
        };
        let uids = OwnUids {
            series: own(b"series"),
            instance: own(b"instance"),
            dimensions: own(b"dimensions"),
            frame_of_reference: own(b"frame of reference"),
        };
        let content = self.data_set(&frames, segment, keep_patient, &uids);
        write_atomic(path, |out| content.write(out, [CLASS, &uids.instance], &pixels))
    }

    /// Everything but the pixels.
    ///
    /// * `frames`: the slice of each frame.
    fn data_set(
        &self,
        frames: &[usize],
        segment: &SegmentDescription,
        keep_patient: bool,
        own: &OwnUids,
    ) -> DataSet {
        let mut d = DataSet::default();
        for (tag, vr, is_needed) in PATIENT {
            let value = if keep_patient { self.values.get(tag) } else { &[] };
            if is_needed || !value.is_empty() {
                d.text(tag, vr, value);
            }
        }
        d.text(CONTENT_DATE, b"DA", self.date(keep_patient));
        d.text(CONTENT_TIME, b"TM", self.time(keep_patient));
        d.text((0x0008, 0x0008), b"CS", "DERIVED\\PRIMARY");
        d.text((0x0008, 0x0016), b"UI", CLASS);
        d.text((0x0008, 0x0018), b"UI", &own.instance);
        d.text((0x0008, 0x0060), b"CS", "SEG");
        d.text((0x0008, 0x103e), b"LO", format!("{} segmentation", segment.name));
        // Maker, model, serial number and version of the equipment.
        d.text((0x0008, 0x0070), b"LO", MAKER);
        d.text((0x0008, 0x1090), b"LO", MAKER);
        d.text((0x0018, 0x1000), b"LO", "none");
        d.text((0x0018, 0x1020), b"LO", env!("CARGO_PKG_VERSION"));
        d.item((0x0008, 0x1115), |d| self.refer(d));
        d.text((0x0020, 0x000d), b"UI", &self.study_uid);
        d.text((0x0020, 0x000e), b"UI", &own.series);
        // Behind the series of images in the list of a study.
        let number = self.number.clamp(0, 1_000_000) + 1000;
        d.text((0x0020, 0x0011), b"IS", number.to_string());
        d.text((0x0020, 0x0013), b"IS", "1");
        let frame = match self.frame_of_reference_uid.as_str() {
            "" => &own.frame_of_reference,
            named => named,
        };
        d.text((0x0020, 0x0052), b"UI", frame);
        d.text((0x0020, 0x1040), b"LO", "");
        dimensions(&mut d, &own.dimensions);
        self.pixel_format(&mut d, frames.len());
        d.text((0x0062, 0x0001), b"CS", "BINARY");
        describe_segment(&mut d, segment);
        // Label, description and creator of the content.
        d.text((0x0070, 0x0080), b"CS", segment.name.to_ascii_uppercase());
        d.text((0x0070, 0x0081), b"LO", NOTICE);
        d.text((0x0070, 0x0084), b"PN", "");
        self.groups(&mut d, frames);
        d
    }

    /// Names the series and all its files.
    fn refer(&self, d: &mut DataSet) {
        let instances = self.instances.iter().map(|instance| {
            DataSet::with(|d| {
                d.text((0x0008, 0x1150), b"UI", &instance.class_uid);
                d.text((0x0008, 0x1155), b"UI", &instance.uid);
            })
        });
        d.sequence((0x0008, 0x114a), instances);
        d.text((0x0020, 0x000e), b"UI", &self.series_uid);
    }

    /// The date of the images where it may be told, else none.
    fn date(&self, keep_patient: bool) -> &[u8] {
        let known = [CONTENT_DATE, (0x0008, 0x0020)].map(|tag| self.values.get(tag));
        let is_date = |v: &&[u8]| v.len() == 8 && v.iter().all(u8::is_ascii_digit);
        known.into_iter().find(|v| keep_patient && is_date(v)).unwrap_or(NO_DATE)
    }

    fn time(&self, keep_patient: bool) -> &[u8] {
        let known = [CONTENT_TIME, (0x0008, 0x0030)].map(|tag| self.values.get(tag));
        let is_time =
            |v: &&[u8]| v.len() >= 6 && v[..6].iter().all(u8::is_ascii_digit) && v.len() <= 13;
        known.into_iter().find(|v| keep_patient && is_time(v)).unwrap_or(NO_TIME)
    }

    fn pixel_format(&self, d: &mut DataSet, frames: usize) {
        let [columns, rows] = [self.grid.dims.x, self.grid.dims.y].map(|n| n as u16);
        d.shorts((0x0028, 0x0002), &[1]);
        d.text((0x0028, 0x0004), b"CS", "MONOCHROME2");
        d.text((0x0028, 0x0008), b"IS", frames.to_string());
        d.shorts((0x0028, 0x0010), &[rows]);
        d.shorts((0x0028, 0x0011), &[columns]);
        // Bits allocated and stored, the high bit, no sign.
        for (element, value) in [(0x0100, 1), (0x0101, 1), (0x0102, 0), (0x0103, 0)] {
            d.shorts((0x0028, element), &[value]);
        }
        // What compression took from the images is missing in what was drawn on them.
        let lossy = LOSSY.map(|(tag, vr)| (tag, vr, self.values.get(tag)));
        if lossy[0].2 == b"01" && lossy.iter().all(|e| !e.2.is_empty()) {
            lossy.into_iter().for_each(|(tag, vr, value)| d.text(tag, vr, value));
        } else {
            d.text((0x0028, 0x2110), b"CS", "00");
        }
    }

    /// Functional groups: what all frames share, then each frame's own.
    fn groups(&self, d: &mut DataSet, frames: &[usize]) {
        let spacing = self.grid.spacing_mm;
        d.item((0x5200, 0x9229), |d| {
            d.item((0x0020, 0x9116), |d| {
                let (row, column) = (self.grid.direction.x_axis, self.grid.direction.y_axis);
                let way = [row.to_array(), column.to_array()].concat();
                d.decimals((0x0020, 0x0037), &way);
            });
            d.item((0x0028, 0x9110), |d| {
                d.decimals((0x0018, 0x0050), &[spacing.z]);
                d.decimals((0x0018, 0x0088), &[spacing.z]);
                d.decimals((0x0028, 0x0030), &[spacing.y, spacing.x]);
            });
            d.item(SEGMENT_IDENTIFICATION, |d| d.shorts(REFERENCED_SEGMENT, &[1]));
        });
        let own = frames.iter().enumerate().map(|(n, k)| self.frame(n as u32 + 1, *k));
        d.sequence((0x5200, 0x9230), own);
    }

    /// Derivation, place among the frames and place in space of one frame.
    fn frame(&self, number: u32, slice: usize) -> DataSet {
        let slice = &self.slices[slice];
        let instance = &self.instances[slice.instance];
        DataSet::with(|d| {
            d.item((0x0008, 0x9124), |d| {
                d.item((0x0008, 0x2112), |d| {
                    d.text((0x0008, 0x1150), b"UI", &instance.class_uid);
                    d.text((0x0008, 0x1155), b"UI", &instance.uid);
                    if instance.is_multi_frame {
                        d.text((0x0008, 0x1160), b"IS", (slice.frame + 1).to_string());
                    }
                    d.text((0x0028, 0x135a), b"CS", "YES");
                    let purpose = "Source Image for Image Processing Operation";
                    d.code((0x0040, 0xa170), ["121322", "DCM", purpose]);
                });
                d.code((0x0008, 0x9215), ["113076", "DCM", "Segmentation"]);
            });
            d.item((0x0020, 0x9111), |d| d.longs((0x0020, 0x9157), &[1, number]));
            d.item(PLANE_POSITION, |d| d.decimals(IMAGE_POSITION, &slice.position_mm.to_array()));
        })
    }
}

const MAKER: &str = "intima";
/// The notice of every picture that leaves, as a description of at most 64 characters.
const NOTICE: &str = crate::formats::NOTICE;

const SEGMENT_IDENTIFICATION: Tag = (0x0062, 0x000a);
const REFERENCED_SEGMENT: Tag = (0x0062, 0x000b);
const PLANE_POSITION: Tag = (0x0020, 0x9113);
const IMAGE_POSITION: Tag = (0x0020, 0x0032);

/// Frames are counted by segment, then by place.
fn dimensions(d: &mut DataSet, organization: &str) {
    d.item((0x0020, 0x9221), |d| d.text((0x0020, 0x9164), b"UI", organization));
    let index = |to, within, label| {
        DataSet::with(|d| {
            d.text((0x0020, 0x9164), b"UI", organization);
            d.pointer((0x0020, 0x9165), to);
            d.pointer((0x0020, 0x9167), within);
            d.text((0x0020, 0x9421), b"LO", label);
        })
    };
    let indices = [
        index(REFERENCED_SEGMENT, SEGMENT_IDENTIFICATION, "Segment"),
        index(IMAGE_POSITION, PLANE_POSITION, "Position"),
    ];
    d.sequence((0x0020, 0x9222), indices);
}

fn describe_segment(d: &mut DataSet, segment: &SegmentDescription) {
    d.item((0x0062, 0x0002), |d| {
        d.code((0x0062, 0x0003), ["91723000", "SCT", "Anatomical Structure"]);
        d.shorts((0x0062, 0x0004), &[1]);
        d.text((0x0062, 0x0005), b"LO", segment.name);
        let way = if segment.is_automatic { "AUTOMATIC" } else { "SEMIAUTOMATIC" };
        d.text((0x0062, 0x0008), b"CS", way);
        d.text((0x0062, 0x0009), b"LO", MAKER);
        d.shorts((0x0062, 0x000d), &cie_lab(segment.rgb));
        d.code((0x0062, 0x000f), [segment.kind.value, "SCT", segment.kind.meaning]);
    });
}

/// Bits of all frames, the lowest of a byte first, without a gap between frames.
fn packed(mask: &[u8], side: usize, frames: &[usize]) -> Vec<u8> {
    let mut bytes = vec![0u8; (side * frames.len()).div_ceil(8)];
    for (frame, k) in frames.iter().enumerate() {
        crate::task::checkpoint();
        for (i, v) in (frame * side..).zip(&mask[k * side..][..side]) {
            bytes[i / 8] |= u8::from(*v != 0) << (i % 8);
        }
    }
    bytes
}

/// An sRGB colour in CIELab, each part scaled to 16 bits (PS3.3 C.10.7.1.1). The standard does not
/// name the white point; DCMTK and highdicom take sRGB's own, D65.
fn cie_lab(rgb: [u8; 3]) -> [u16; 3] {
    let linear = rgb.map(|c| {
        let c = f64::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    // sRGB to XYZ (IEC 61966-2-1), divided by the white point.
    let over_white = |row: [f64; 3], white: f64| {
        let sum: f64 = row.iter().zip(linear).map(|(m, c)| m * c).sum();
        let t = sum / white;
        if t > 216.0 / 24389.0 { t.cbrt() } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let x = over_white([0.4124564, 0.3575761, 0.1804375], 0.95047);
    let y = over_white([0.2126729, 0.7151522, 0.0721750], 1.0);
    let z = over_white([0.0193339, 0.1191920, 0.9503041], 1.08883);
    let [l, a, b] = [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)];
    [l / 100.0, (a + 128.0) / 255.0, (b + 128.0) / 255.0].map(|v| (v * 65535.0).round() as u16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_run_on_from_frame_to_frame_the_lowest_first() {
        // Two frames of five pixels; the slice between them has none.
        let mask = [1, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1];
        assert_eq!(packed(&mask, 5, &[0, 2]), [0b0101_1001, 0b0000_0010]);
    }

    #[test]
    fn colours_are_those_of_cie_lab() {
        assert_eq!(cie_lab([255; 3]), [65535, 32896, 32896], "white");
        assert_eq!(cie_lab([0; 3]), [0, 32896, 32896], "black");
        // L 53.24, a 80.09, b 67.20.
        let red = [0.5324 * 65535.0, 208.09 / 255.0 * 65535.0, 195.20 / 255.0 * 65535.0];
        let near = |(made, wanted): (u16, f64)| (f64::from(made) - wanted).abs() < 8.0;
        assert!(cie_lab([255, 0, 0]).into_iter().zip(red).all(near), "{:?}", cie_lab([255, 0, 0]));
    }
}

//! NRRD out: gzip, LPS; also as segmentations of 3D Slicer.

use std::io::{self, Write};
use std::path::Path;

use glam::{DVec3, IVec3};

use super::FormatError;
use super::gzip::GzipWriter;
use super::rescale::real_samples;
use super::segment_description::SegmentDescription;
use crate::formats::atomic_file::write_atomic;
use crate::volume::{Grid, Sample, SampleType, Volume};

/// Writes a volume as real values.
pub(super) fn write(path: &Path, volume: &Volume) -> Result<(), FormatError> {
    let samples = real_samples(volume);
    let head = header(&volume.grid, samples.sample_type(), None);
    write_atomic(path, |out| body(out, &head, "", |out| out.write_all(samples.bytes())))
}

/// Writes a mask as a segmentation of 3D Slicer (`.seg.nrrd`): a label map in which the segment's
/// voxels are 1, and what the segment is as keys and values of the header.
pub(super) fn write_segment(
    path: &Path,
    grid: &Grid,
    mask: &[u8],
    segment: &SegmentDescription,
) -> Result<(), FormatError> {
    let keys = segment_keys(grid, mask, segment);
    let labels = mask.iter().map(|v| u8::from(*v != 0));
    let labels: Vec<u8> = labels.collect();
    let head = header(grid, SampleType::U8, None);
    write_atomic(path, |out| body(out, &head, &keys, |out| out.write_all(&labels)))
}

/// Writes a field of vectors on a grid as `.nrrd`, the components of a voxel side by side:
/// `values` holds `components` numbers a voxel, x fastest. Used for Hessian eigenvalues.
///
/// # Errors
/// [`FormatError::Unsupported`] for another extension or a count that does not match the grid,
/// [`FormatError::Io`] with no partial file left behind.
pub fn write_vector_field(
    path: &Path,
    grid: &Grid,
    components: u32,
    values: &[f32],
) -> Result<(), FormatError> {
    if !super::lower_name(path).ends_with(".nrrd") {
        return Err(FormatError::unsupported(path, "a vector field in this format; use .nrrd"));
    }
    if components == 0 || grid.len().checked_mul(components as usize) != Some(values.len()) {
        let what = format!("{} values for {components} a voxel", values.len());
        return Err(FormatError::unsupported(path, what));
    }
    let head = header(grid, SampleType::F32, Some(components));
    write_atomic(path, |out| {
        body(out, &head, "", |out| out.write_all(bytemuck::cast_slice(values)))
    })
}

/// Writes a volume as `.nrrd` while it is made, so that nobody holds all of it: `layers` hands over
/// its samples in order, x fastest, in pieces of any length.
///
/// # Errors
/// [`FormatError::Unsupported`] for another extension, [`FormatError::Io`] also where the layers
/// together do not fill the grid; no partial file is left behind.
pub fn write_layers<T: Sample>(
    path: &Path,
    grid: &Grid,
    layers: impl FnOnce(&mut dyn FnMut(&[T]) -> io::Result<()>) -> io::Result<()>,
) -> Result<(), FormatError> {
    if !super::lower_name(path).ends_with(".nrrd") {
        return Err(FormatError::unsupported(path, "a volume in layers in this format; use .nrrd"));
    }
    let head = header(grid, T::TYPE, None);
    write_atomic(path, |out| {
        body(out, &head, "", |out| {
            let mut written = 0;
            layers(&mut |layer| {
                written += layer.len();
                out.write_all(bytemuck::cast_slice(layer))
            })?;
            let fits = written == grid.len();
            if fits { Ok(()) } else { Err(io::Error::other("the layers do not fill the grid")) }
        })
    })
}

/// Writes the fields of a header, keys with their values, the blank line and the samples.
fn body(
    out: &mut dyn Write,
    fields: &str,
    keys: &str,
    samples: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    writeln!(out, "{fields}{keys}")?;
    let mut out = GzipWriter::new(out)?;
    samples(&mut out)?;
    out.finish()
}

fn header(grid: &Grid, sample_type: SampleType, components: Option<u32>) -> String {
    let vector = |v: DVec3| format!("({},{},{})", v.x, v.y, v.z);
    let (d, s) = (grid.direction, grid.spacing_mm);
    let steps = [d.x_axis * s.x, d.y_axis * s.y, d.z_axis * s.z].map(|v| vector(v + DVec3::ZERO));
    let mut sizes: Vec<u32> = grid.dims.to_array().into();
    let mut directions: Vec<&str> = steps.iter().map(String::as_str).collect();
    let mut kinds = vec!["domain"; 3];
    if let Some(n) = components {
        sizes.insert(0, n);
        directions.insert(0, "none");
        kinds.insert(0, "vector");
    }
    let sizes: Vec<String> = sizes.iter().map(u32::to_string).collect();
    let name = match sample_type {
        SampleType::F32 => "float",
        SampleType::F64 => "double",
        integer => integer.name(),
    };
    let endian = if cfg!(target_endian = "big") { "big" } else { "little" };
    format!(
        "NRRD0005\n\
         type: {name}\n\
         dimension: {}\n\
         space: left-posterior-superior\n\
         sizes: {}\n\
         space directions: {}\n\
         kinds: {}\n\
         endian: {endian}\n\
         encoding: gzip\n\
         space origin: {}\n",
        sizes.len(),
        sizes.join(" "),
        directions.join(" "),
        kinds.join(" "),
        vector(grid.origin_mm),
    )
}

/// Keys of the one segment of a label map, as 3D Slicer writes them; slicerio needs every one.
fn segment_keys(grid: &Grid, mask: &[u8], segment: &SegmentDescription) -> String {
    let [r, g, b] = segment.rgb.map(|c| f64::from(c) / 255.0);
    let (low, high) = extent(grid, mask);
    let kind = segment.kind;
    format!(
        "Segmentation_MasterRepresentation:=Binary labelmap\n\
         Segmentation_ContainedRepresentationNames:=Binary labelmap|\n\
         Segmentation_ReferenceImageExtentOffset:=0 0 0\n\
         Segment0_ID:=Segment_1\n\
         Segment0_Name:={}\n\
         Segment0_NameAutoGenerated:=1\n\
         Segment0_Color:={r:.6} {g:.6} {b:.6}\n\
         Segment0_ColorAutoGenerated:=1\n\
         Segment0_LabelValue:=1\n\
         Segment0_Layer:=0\n\
         Segment0_Extent:={} {} {} {} {} {}\n\
         Segment0_Tags:=Segmentation.Status:completed|TerminologyEntry:\
         Segmentation category and type - 3D Slicer General Anatomy list\
         ~SCT^123037004^Anatomical Structure~SCT^{}^{}~^^\
         ~Anatomic codes - DICOM master list~^^~^^|\n",
        segment.name, low.x, high.x, low.y, high.y, low.z, high.z, kind.value, kind.meaning,
    )
}

/// First and last voxel, inclusive, of the box around a mask; of an empty mask Slicer's empty
/// extent, whose last voxel lies before the first.
fn extent(grid: &Grid, mask: &[u8]) -> (IVec3, IVec3) {
    let (mut low, mut high) = (IVec3::MAX, IVec3::MIN);
    let [columns, rows, _] = grid.dims.to_array().map(|d| d as usize);
    for (n, row) in mask.chunks_exact(columns).enumerate() {
        let (Some(first), Some(last)) =
            (row.iter().position(|v| *v != 0), row.iter().rposition(|v| *v != 0))
        else {
            continue;
        };
        let at = |x: usize| IVec3::new(x as i32, (n % rows) as i32, (n / rows) as i32);
        (low, high) = (low.min(at(first)), high.max(at(last)));
    }
    if low.x > high.x { (IVec3::ZERO, IVec3::NEG_ONE) } else { (low, high) }
}

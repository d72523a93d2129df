//! Volumes in and out: DICOM series and OME-Zarr in; NIfTI, NRRD and MetaImage in and out; segmentations as
//! `.seg.nrrd` and DICOM SEG in and out.
//!
//! Every reader first makes a [`layout::Layout`]: geometry, sample type, and where the bytes lie.
//! The layout is held against the size of the file before any memory is taken for samples, so a
//! small file cannot claim a large volume. Only then are the bytes read (or inflated) straight
//! into the samples.

mod affine;
mod dicom;
mod gzip;
mod info;
mod layout;
mod metaimage;
mod metaimage_write;
mod nifti;
mod nifti_write;
mod nrrd;
mod nrrd_write;
mod parts;
mod rescale;
mod segment_description;
mod segments;
mod source;
mod text;
mod zarr;

use std::io::Read as _;
use std::path::{Path, PathBuf};

pub use dicom::SourceSeries;
pub use info::{ImageInfo, InputInfo, ScreenText, SegmentInfo, SeriesInfo};
pub use metaimage_write::check_data_file;
pub use nrrd_write::{write_layers, write_vector_field};
pub use parts::VolumeParts;
pub use segment_description::{SegmentDescription, SnomedCode};
pub use source::{open_plain, read_plain};

use super::FormatError;
use crate::volume::{Grid, Rescale, Volume};
use layout::Layout;
pub(super) use layout::MAX_SHRINK;
use zarr::ZarrImage;

/// Options for reading an input.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// DICOM series: its UID, or its index in the listing (from 0).
    pub series: Option<String>,
    /// Number of the volume among several at the same places, from 0: times, echoes, phases.
    pub volume: Option<usize>,
    /// DICOM: whether to interpolate where slices are uneven or missing.
    pub fill_gaps: bool,
    /// DICOM: read pixels that may show who the patient is: burned-in text, a face, a screen.
    pub allow_burned_in: bool,
    /// Segmentations: names of the segments that are read, together as 1 in a label map of zeros and
    /// ones; all, with their own labels, where none is named.
    pub segments: Vec<String>,
    /// Closed meshes: side of the voxels that their inside is cut into, mm.
    pub mesh_spacing_mm: Option<f64>,
}

/// The kinds of input, told apart by name first and by their first bytes otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileKind {
    Nifti,
    Nrrd,
    MetaImage,
    Dicom,
    Zarr,
}

const ACCEPTED: &str =
    "a DICOM folder or file, an OME-Zarr folder, .nii, .nii.gz, .nrrd, .nhdr, .mha or .mhd";

/// Describes an input without reading its samples. Lengths are LPS mm.
///
/// A DICOM folder with several series and none chosen is described by its list of series alone.
///
/// # Errors
/// As [`read_volume`], save what only the samples can show.
pub fn inspect(path: &Path, options: &ReadOptions) -> Result<InputInfo, FormatError> {
    match kind(path)? {
        FileKind::Dicom => dicom::inspect(path, options),
        FileKind::Zarr => {
            let image = ZarrImage::open(path)?;
            let own = ImageInfo::of(&image.grid, image.sample_type(), Rescale::IDENTITY);
            Ok(InputInfo {
                format: image.format.to_owned(),
                image: Some(ImageInfo { reading_bytes: image.reading_bytes(), ..own }),
                series: Vec::new(),
                segments: Vec::new(),
                notes: image.notes,
                acquisition: None,
            })
        }
        k => {
            // Of several volumes the first is described.
            let mut layout = layout_of(path, k, options.volume.or(Some(0)))?;
            layout.open()?;
            if options.volume.is_none() && layout.volumes > 1 {
                layout.notes.push(layout.choice());
            }
            Ok(InputInfo {
                format: layout.format.to_owned(),
                image: Some(ImageInfo::of(&layout.grid, layout.sample_type, layout.rescale)),
                series: Vec::new(),
                segments: layout.segments,
                notes: layout.notes,
                acquisition: None,
            })
        }
    }
}

/// Whether the names of an input's files say where their samples lie: chunks of a Zarr array.
pub fn names_are_places(path: &Path) -> bool {
    path.is_dir() && zarr::is_zarr(path)
}

/// Every file that reading an input may look at, in the order of their paths: those of a DICOM
/// folder, metadata and chunks of a Zarr array, a file alone, or a header and the file of its samples.
///
/// # Errors
/// [`FormatError::Io`]; a file that is no volume is a list of itself.
pub fn input_files(path: &Path) -> Result<Vec<PathBuf>, FormatError> {
    let meta = std::fs::metadata(path).map_err(|e| FormatError::io(path, e))?;
    if meta.is_dir() && zarr::is_zarr(path) {
        return ZarrImage::open(path)?.files();
    }
    if meta.is_dir() {
        return dicom::files_in(path);
    }
    if lower_name(path) == "dicomdir" {
        return dicom::files_in(
            path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")),
        );
    }
    let samples = kind(path).and_then(|k| layout_of(path, k, Some(0))).map(|layout| layout.file);
    let mut files = vec![path.to_owned()];
    files.extend(samples.ok().filter(|file| file != path));
    files.sort();
    Ok(files)
}

/// Reads any volume. Geometry comes back in LPS mm whatever the file's frame; samples keep their
/// stored type, with the map to real values in [`Volume::rescale`].
///
/// # Errors
/// [`FormatError`] names the file, the field and its value. Sizes are checked before memory is
/// taken.
pub fn read_volume(path: &Path, options: &ReadOptions) -> Result<Volume, FormatError> {
    match kind(path)? {
        FileKind::Dicom => dicom::read(path, options),
        FileKind::Zarr => {
            let image = ZarrImage::open(path)?;
            warn(image.format, &image.notes);
            segments::chosen(path, &[], &options.segments)?;
            image.load()
        }
        k => {
            let layout = layout_of(path, k, options.volume)?;
            warn(layout.format, &layout.notes);
            segments::read(layout, &options.segments)
        }
    }
}

/// Writes a volume in the format of the extension: `.nrrd`, `.nii`, `.nii.gz`, `.mha`, or `.mhd`
/// with its samples beside it in `.raw`. The geometry is kept, oblique and left-handed grids
/// included; NIfTI holds it as 32-bit floats. NIfTI carries the rescale, the others hold real
/// values.
///
/// # Errors
/// [`FormatError::Unsupported`] for another extension, [`FormatError::Io`] with no partial file
/// left behind.
pub fn write_volume(path: &Path, volume: &Volume) -> Result<(), FormatError> {
    let name = lower_name(path);
    if name.ends_with(".seg.nrrd") {
        let what = "values in a .seg.nrrd, which holds segments; use .nrrd";
        Err(FormatError::unsupported(path, what))
    } else if name.ends_with(".nrrd") {
        nrrd_write::write(path, volume)
    } else if name.ends_with(".nii") || name.ends_with(".nii.gz") {
        nifti_write::write(path, volume)
    } else if name.ends_with(".mha") || name.ends_with(".mhd") {
        metaimage_write::write(path, volume)
    } else {
        let what = "writing a volume to this extension; use .nrrd, .nii, .nii.gz, .mha or .mhd";
        Err(FormatError::unsupported(path, what))
    }
}

/// Writes a mask as the only segment of a segmentation: `.seg.nrrd`.
///
/// * `mask`: a number a voxel of the grid, x fastest, not zero in the segment.
///
/// # Errors
/// [`FormatError::Unsupported`] for another extension or a count that does not match the grid,
/// [`FormatError::Io`] with no partial file left behind.
pub fn write_segment(
    path: &Path,
    grid: &Grid,
    mask: &[u8],
    segment: &SegmentDescription,
) -> Result<(), FormatError> {
    if !lower_name(path).ends_with(".seg.nrrd") {
        return Err(FormatError::unsupported(path, "a segment in this format; use .seg.nrrd"));
    }
    if mask.len() != grid.len() {
        let what = format!("{} voxels of a mask for {} of its grid", mask.len(), grid.len());
        return Err(FormatError::unsupported(path, what));
    }
    nrrd_write::write_segment(path, grid, mask, segment)
}

fn layout_of(path: &Path, kind: FileKind, volume: Option<usize>) -> Result<Layout, FormatError> {
    let layout = match kind {
        FileKind::Nifti => nifti::layout(path)?,
        FileKind::Nrrd => nrrd::layout(path)?,
        FileKind::MetaImage => metaimage::layout(path)?,
        FileKind::Dicom => return Err(FormatError::unsupported(path, "a DICOM input here")),
        FileKind::Zarr => return Err(FormatError::unsupported(path, "a Zarr input here")),
    };
    layout.at_volume(volume)
}

/// The first bytes of what a gzip file holds; fewer where it is damaged.
fn gzip_prefix(path: &Path) -> Result<Vec<u8>, FormatError> {
    let file = source::DataFile::open(path)?.take(1 << 20);
    let mut bytes = vec![0; 512];
    let n = source::fill(&mut flate2::read::MultiGzDecoder::new(file), &mut bytes).unwrap_or(0);
    bytes.truncate(n);
    Ok(bytes)
}

fn warn(format: &str, notes: &[String]) {
    notes.iter().for_each(|note| tracing::warn!("{format}: {note}"));
}

fn is_dicom(path: &Path) -> Result<bool, FormatError> {
    Ok(kind(path)? == FileKind::Dicom)
}

fn lower_name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn kind(path: &Path) -> Result<FileKind, FormatError> {
    if std::fs::metadata(path).map_err(|e| FormatError::io(path, e))?.is_dir() {
        return Ok(if zarr::is_zarr(path) { FileKind::Zarr } else { FileKind::Dicom });
    }
    let head = source::prefix(path, 512)?;
    let name = lower_name(path);
    let ends = |list: &[&str]| list.iter().any(|e| name.ends_with(e));
    if ends(&[".npz", ".npy"]) {
        let what = "arrays of NumPy, which say no size of a voxel; save them as .nii.gz or .nrrd";
        return Err(FormatError::unsupported(path, what));
    }
    if super::is_mesh(path) {
        let what = "a mesh here; commands that need a lumen cut its inside into voxels of \
                    --mesh-spacing";
        return Err(FormatError::unsupported(path, what));
    }
    if head.starts_with(b"PK\x03\x04") || ends(&[".zip"]) {
        return Err(FormatError::unsupported(path, "a zip archive; unzip it and give the folder"));
    }
    if ends(&[".mgz", ".mgh", ".mgh.gz"]) {
        let what = "volumes of FreeSurfer (.mgz, .mgh); mri_convert turns them into .nii.gz";
        return Err(FormatError::unsupported(path, what));
    }
    if ends(&[".nii", ".nii.gz", ".hdr", ".img", ".hdr.gz", ".img.gz"]) {
        return Ok(FileKind::Nifti);
    }
    if ends(&[".nrrd", ".nhdr"]) || head.starts_with(b"NRRD000") {
        return Ok(FileKind::Nrrd);
    }
    if ends(&[".mha", ".mhd"]) {
        return Ok(FileKind::MetaImage);
    }
    if ends(&[".dcm", ".dicom", ".ima"]) || head.get(128..132) == Some(b"DICM") {
        return Ok(FileKind::Dicom);
    }
    let is_nifti = |head: &[u8]| {
        let magic = head.get(344..348);
        magic == Some(b"n+1\0") || magic == Some(b"ni1\0")
    };
    if head.starts_with(&[0x1f, 0x8b]) {
        let inner = gzip_prefix(path)?;
        let what = match () {
            () if is_nifti(&inner) => return Ok(FileKind::Nifti),
            () if inner.get(128..132) == Some(b"DICM") => "a gzipped DICOM file; gunzip it",
            () if inner.starts_with(b"NRRD000") => "a gzipped NRRD file; gunzip it",
            () => "a gzip file of something else than NIfTI-1",
        };
        return Err(FormatError::unsupported(path, what));
    }
    if is_nifti(&head) {
        return Ok(FileKind::Nifti);
    }
    if head.starts_with(b"ObjectType") || head.starts_with(b"NDims") {
        return Ok(FileKind::MetaImage);
    }
    if name == "dicomdir" || dicom::is_bare(&head) {
        return Ok(FileKind::Dicom);
    }
    Err(FormatError::unsupported(path, format!("this kind of file; give {ACCEPTED}")))
}

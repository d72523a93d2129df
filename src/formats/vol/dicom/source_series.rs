//! A series of images that a segmentation is written of: where its slices lie, and what names them
//! and their patient.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use rayon::prelude::*;

use super::super::{FormatError, ReadOptions};
use super::element::Tag;
use super::head::{self, Head};
use super::stack::Stack;
use super::walk::{StoredValues, stored_values};
use super::{choose, find};
use crate::volume::Grid;

/// Series of images whose slices form the volume that is read of them.
pub struct SourceSeries {
    pub(super) grid: Grid,
    /// Slices in the order of the volume.
    pub(super) slices: Vec<SourceSlice>,
    /// Files of the slices, and what names them.
    files: Vec<Arc<Path>>,
    pub(super) instances: Vec<SourceInstance>,
    pub(super) study_uid: String,
    pub(super) series_uid: String,
    /// UID of the first slice's frame of reference; empty where it names none.
    pub(super) frame_of_reference_uid: String,
    pub(super) number: i64,
    /// Values of the first file: of the patient, the study and what compression has lost.
    pub(super) values: StoredValues,
}

/// One slice of a volume.
pub(super) struct SourceSlice {
    /// Index of its file.
    pub instance: usize,
    /// Index of its frame in the file, from 0.
    pub frame: usize,
    pub position_mm: DVec3,
}

/// One file of a series.
#[derive(Clone)]
pub(super) struct SourceInstance {
    pub class_uid: String,
    pub uid: String,
    pub is_multi_frame: bool,
}

const CLASS: Tag = (0x0008, 0x0016);
const INSTANCE: Tag = (0x0008, 0x0018);
const STUDY: Tag = (0x0020, 0x000d);
const SERIES: Tag = (0x0020, 0x000e);
const FRAME_OF_REFERENCE: Tag = (0x0020, 0x0052);

/// Elements that describe patient and study, with their value representations. Types are those of
/// PS3.3 C.7.1.1 and C.7.2.1: `true` where the element is there even if nothing is known.
pub(super) const PATIENT: [(Tag, &[u8; 2], bool); 15] = [
    ((0x0008, 0x0005), b"CS", false), // character set
    ((0x0008, 0x0020), b"DA", true),  // study date
    ((0x0008, 0x0030), b"TM", true),  // study time
    ((0x0008, 0x0050), b"SH", true),  // accession number
    ((0x0008, 0x0090), b"PN", true),  // referring physician
    ((0x0008, 0x1030), b"LO", false), // study description
    ((0x0010, 0x0010), b"PN", true),  // name
    ((0x0010, 0x0020), b"LO", true),  // number
    ((0x0010, 0x0021), b"LO", false), // issuer of the number
    ((0x0010, 0x0030), b"DA", true),  // birth date
    ((0x0010, 0x0040), b"CS", true),  // sex
    ((0x0010, 0x1010), b"AS", false), // age
    ((0x0010, 0x1020), b"DS", false), // size
    ((0x0010, 0x1030), b"DS", false), // weight
    ((0x0020, 0x0010), b"SH", true),  // study ID
];
pub(super) const CONTENT_DATE: Tag = (0x0008, 0x0023);
pub(super) const CONTENT_TIME: Tag = (0x0008, 0x0033);
/// Whether compression has lost something, by how much, and how.
pub(super) const LOSSY: [(Tag, &[u8; 2]); 3] =
    [((0x0028, 0x2110), b"CS"), ((0x0028, 0x2112), b"DS"), ((0x0028, 0x2114), b"CS")];

impl SourceSeries {
    /// Reads what is known of a series, without its pixels.
    ///
    /// # Errors
    /// [`FormatError`]: as [`read_volume`](crate::formats::read_volume), and where the input is no
    /// DICOM series of images, voxels of its volume are no pixels of its slices, or a UID that a
    /// segmentation has to name is missing.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let refuse = |what: &str| Err(FormatError::unsupported(path, what));
        if !super::super::is_dicom(path)? {
            return refuse(
                "a DICOM segmentation of an input that is no DICOM series; use .seg.nrrd",
            );
        }
        let found = find(path)?;
        let series = &found.series[choose(path, &found.series, options)?];
        if series.is_segmentation() {
            return refuse("a DICOM segmentation of a segmentation; give its images as INPUT");
        }
        series.refuse_missing_parts()?;
        let stack = Stack::new(path, &series.heads, options.fill_gaps)?;
        if stack.upright.is_some() {
            let what = "a DICOM segmentation of tilted or uneven slices, whose voxels are no pixels \
                        of theirs; use .seg.nrrd";
            return refuse(what);
        }
        let mut files: Vec<Arc<Path>> = Vec::new();
        let mut index = BTreeMap::new();
        let slices = stack.slices.iter().map(|s| {
            let instance = *index.entry(Arc::clone(&s.file)).or_insert_with(|| {
                files.push(Arc::clone(&s.file));
                files.len() - 1
            });
            SourceSlice { instance, frame: s.frame, position_mm: s.position_mm }
        });
        let slices: Vec<SourceSlice> = slices.collect();
        let named: Result<Vec<_>, _> = files.par_iter().map(|f| names(f)).collect();
        let named = named?;
        let (_, study_uid, series_uid, frame_of_reference_uid) = named[0].clone();
        if let Some(i) = named.iter().position(|n| n.1 != study_uid) {
            let why = "another slice has another one";
            return Err(FormatError::text(&files[i], "StudyInstanceUID", why));
        }
        // De-identified series may have one a slice, though all lie in one box.
        if named.iter().any(|n| n.3 != frame_of_reference_uid) {
            tracing::warn!(
                "DICOM: slices name several frames of reference; the segmentation names the first's"
            );
        }
        let mut instances: Vec<SourceInstance> = named.into_iter().map(|n| n.0).collect();
        for s in &slices {
            instances[s.instance].is_multi_frame |= s.frame > 0;
        }
        let listed = PATIENT.iter().map(|e| e.0).chain(LOSSY.iter().map(|e| e.0));
        let listed: Vec<Tag> = listed.chain([CONTENT_DATE, CONTENT_TIME]).collect();
        let values = stored_values(&files[0], &listed)?;
        let number = series.heads.first().map_or(0, |h: &Head| h.series_number);
        let grid = stack.grid;
        Ok(Self {
            grid,
            slices,
            files,
            instances,
            study_uid,
            series_uid,
            frame_of_reference_uid,
            number,
            values,
        })
    }

    /// Whether a path leads to one of the series' files.
    pub(super) fn holds(&self, path: &Path) -> bool {
        let Ok(place) = path.canonicalize() else { return false };
        self.files.iter().any(|f| f.canonicalize().is_ok_and(|f| f == place))
    }
}

/// A file's class and instance, and the UIDs of its study, series and frame of reference.
type Names = (SourceInstance, String, String, String);

fn names(file: &Path) -> Result<Names, FormatError> {
    let values = stored_values(file, &[CLASS, INSTANCE, STUDY, SERIES, FRAME_OF_REFERENCE])?;
    let uid = |tag, name: &str| {
        let value = values.get(tag);
        match value.iter().all(|b| b.is_ascii_digit() || *b == b'.') && value.len() <= 64 {
            true if value.is_empty() && tag != FRAME_OF_REFERENCE => {
                Err(FormatError::field(file, name, "absent", "a segmentation names it"))
            }
            true => Ok(String::from_utf8_lossy(value).into_owned()),
            false => Err(FormatError::text(file, name, "not a UID")),
        }
    };
    let class_uid = uid(CLASS, "SOPClassUID")?;
    let is_multi_frame = head::ENHANCED.contains(&class_uid.as_str());
    let instance =
        SourceInstance { class_uid, uid: uid(INSTANCE, "SOPInstanceUID")?, is_multi_frame };
    Ok((
        instance,
        uid(STUDY, "StudyInstanceUID")?,
        uid(SERIES, "SeriesInstanceUID")?,
        uid(FRAME_OF_REFERENCE, "FrameOfReferenceUID")?,
    ))
}

//! Properties of one slice that are known before its pixels are read.

use std::io::Read as _;
use std::path::Path;
use std::sync::Arc;

use super::super::FormatError;
use super::super::info::SegmentInfo;
use super::super::segments::printable;
use super::super::source::DataFile;
use super::element::ElementValues;
use super::fragments::{self, Fragment};
use super::walk::{Pixels, walk};

/// One slice, a DICOM file or a frame of one: sorted and named, its geometry not yet judged.
#[derive(Clone)]
pub(super) struct Head {
    pub file: Arc<Path>,
    /// Index of the frame in its file, from 0.
    pub frame: usize,
    /// Transfer syntax UID.
    pub syntax: Arc<str>,
    pub series_uid: Arc<str>,
    pub series_number: i64,
    /// A known modality code, or `other`.
    pub modality: &'static str,
    pub rows: u32,
    pub columns: u32,
    /// Pixels of all frames of the file.
    pub pixels: Option<Arc<Pixels>>,
    /// Fragments of this frame, where pixels are encapsulated.
    pub fragments: Vec<Fragment>,
    /// The segments of a segmentation; empty for images.
    pub segments: Arc<[SegmentInfo]>,
    /// Elements of this frame alone, of all frames, and of the file. A file may have very many
    /// frames; what they share is there once.
    values: [Arc<ElementValues>; 3],
}

/// Stands for the UID of a series that has none.
pub(super) const UNNAMED: &str = "unnamed";

const MODALITIES: [&str; 12] =
    ["CT", "MR", "PT", "NM", "US", "XA", "CR", "DX", "SEG", "SR", "OT", "RTDOSE"];

/// Enhanced CT, MR and PET image storage.
pub(super) const ENHANCED: [&str; 3] =
    ["1.2.840.10008.5.1.4.1.1.2.1", "1.2.840.10008.5.1.4.1.1.4.1", "1.2.840.10008.5.1.4.1.1.130"];

/// Parametric map storage, whose pixels are of floating point.
const PARAMETRIC_MAP: &str = "1.2.840.10008.5.1.4.1.1.30";

/// Segmentation and label map segmentation storage.
const SEGMENTATIONS: [&str; 2] = ["1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7"];

/// Reads the allowed elements of a file: one head a frame; `None` if it is not DICOM.
pub(super) fn read(file: &Path) -> Result<Option<Vec<Head>>, FormatError> {
    let Some(walked) = walk(file)? else { return Ok(None) };
    let groups = walked.groups;
    let segment = |(number, label): &(i64, String)| SegmentInfo {
        name: printable(label.trim_matches('\0')),
        label: *number,
        layer: 0,
    };
    // Number 0 of a label map is the background.
    let listed = groups.segments.iter().filter(|(number, _)| *number > 0);
    let segments: Vec<SegmentInfo> = listed.map(segment).collect();
    let mut head = Head {
        file: Arc::from(file),
        frame: 0,
        syntax: Arc::from(walked.syntax),
        series_uid: Arc::from(""),
        series_number: 0,
        modality: "other",
        rows: 0,
        columns: 0,
        pixels: walked.pixels.map(Arc::new),
        fragments: Vec::new(),
        segments: Arc::from(segments),
        values: [Arc::default(), Arc::default(), Arc::new(walked.values)],
    };
    let uid = head.text(0x0020, 0x000e);
    // Free text in the place of an identifier must not reach a listing.
    let plain = uid.chars().all(|c| c.is_ascii_digit() || c == '.') && !uid.is_empty();
    head.series_uid = Arc::from(if plain { uid.as_str() } else { UNNAMED });
    head.series_number = head.int(0x0020, 0x0011).unwrap_or(0);
    let modality = head.text(0x0008, 0x0060);
    head.modality = MODALITIES.into_iter().find(|m| *m == modality).unwrap_or("other");
    let side = |v: Option<i64>| v.and_then(|v| u32::try_from(v).ok()).unwrap_or(0);
    head.rows = side(head.int(0x0028, 0x0010));
    head.columns = side(head.int(0x0028, 0x0011));
    let frames = usize::try_from(head.int(0x0028, 0x0008).unwrap_or(1)).unwrap_or(0);
    let is_enhanced =
        head.is_segmentation() || ENHANCED.contains(&head.text(0x0008, 0x0016).as_str());
    let mut parts = match head.pixels.as_deref() {
        None => return Ok(Some(vec![head])),
        Some(Pixels::Plain { .. }) => Vec::new(),
        Some(Pixels::Encapsulated { fragments, offsets }) => {
            let begins = |f: &Fragment| begins_stream(file, f);
            fragments::frames(fragments, offsets, frames, begins)
                .map_err(|why| FormatError::field(file, "pixels", "damaged", why))?
        }
    };
    if frames == 1 && !is_enhanced {
        head.fragments = parts.pop().unwrap_or_default();
        return Ok(Some(vec![head]));
    }
    if groups.frames.is_empty() {
        let what = format!(
            "{frames} frames in a file that does not say where each lies (no functional groups)"
        );
        return Err(FormatError::unsupported(file, what));
    }
    if groups.frames.len() != frames {
        let what = format!(
            "a multi-frame file that says it has {frames} frames and describes {}",
            groups.frames.len()
        );
        return Err(FormatError::unsupported(file, what));
    }
    if frames > 1 && groups.frames.iter().any(ElementValues::is_empty) {
        let what = "a multi-frame file with frames of which nothing is said";
        return Err(FormatError::unsupported(file, what));
    }
    parts.resize(frames, Vec::new());
    let shared = Arc::new(groups.shared);
    let of = |((i, own), fragments): ((usize, ElementValues), Vec<Fragment>)| Head {
        frame: i,
        fragments,
        values: [Arc::new(own), Arc::clone(&shared), Arc::clone(&head.values[2])],
        ..head.clone()
    };
    Ok(Some(groups.frames.into_iter().enumerate().zip(parts).map(of).collect()))
}

/// Whether a fragment begins a JPEG or JPEG 2000 stream.
fn begins_stream(file: &Path, fragment: &Fragment) -> bool {
    let mut first = [0; 3];
    let read = DataFile::open_at(file, fragment.0).map(|mut s| s.read_exact(&mut first));
    matches!(read, Ok(Ok(()))) && (first == [0xff, 0xd8, 0xff] || first == [0xff, 0x4f, 0xff])
}

/// Whether a file says that it is of a modality that takes volumes.
pub(super) fn is_volume(file: &Path) -> bool {
    let walked = walk(file).ok().flatten();
    let modality = walked.as_ref().and_then(|w| w.values.get((0x0008, 0x0060)));
    matches!(modality, Some("CT" | "MR" | "PT"))
}

impl Head {
    /// Whether it is a picture to plan a scan on, as its type says.
    pub fn is_localizer(&self) -> bool {
        self.text(0x0008, 0x0008).split('\\').nth(2).is_some_and(|t| t.trim() == "LOCALIZER")
    }

    /// Whether it holds the slices of a volume side by side in one picture, as Siemens writes them.
    pub fn is_mosaic(&self) -> bool {
        self.text(0x0008, 0x0008).split('\\').any(|word| word.trim() == "MOSAIC")
    }

    /// Whether its pixels are numbers of floating point.
    pub fn is_parametric_map(&self) -> bool {
        self.text(0x0008, 0x0016) == PARAMETRIC_MAP
    }

    /// Whether its pixels say which segment they belong to.
    pub fn is_segmentation(&self) -> bool {
        SEGMENTATIONS.contains(&self.text(0x0008, 0x0016).as_str())
    }

    /// The value of an element: the frame's own, else that of all frames, else the file's.
    fn value(&self, group: u16, element: u16) -> Option<&str> {
        self.values.iter().find_map(|values| values.get((group, element)))
    }

    /// A short text without padding; empty if absent.
    pub fn text(&self, group: u16, element: u16) -> String {
        self.value(group, element).unwrap_or_default().to_owned()
    }

    /// A whole number, if there is one; of several the first.
    pub fn int(&self, group: u16, element: u16) -> Option<i64> {
        self.value(group, element)?.split('\\').next()?.trim().parse().ok()
    }

    /// Decimal numbers, exactly `N`; `None` if absent or empty.
    ///
    /// # Errors
    /// Names the element if it holds something else; its text is not shown.
    pub fn decimals<const N: usize>(
        &self,
        group: u16,
        element: u16,
        name: &str,
    ) -> Result<Option<[f64; N]>, FormatError> {
        let text = self.text(group, element);
        if text.is_empty() {
            return Ok(None);
        }
        let numbers: Result<Vec<f64>, _> = text.split('\\').map(|t| t.trim().parse()).collect();
        let finite = numbers.ok().filter(|v| v.iter().all(|x: &f64| x.is_finite()));
        if let Some(v) = finite.and_then(|v| <[f64; N]>::try_from(v).ok()) {
            return Ok(Some(v));
        }
        Err(FormatError::text(&self.file, name, format!("expected {N} finite numbers")))
    }
}

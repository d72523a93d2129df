//! What is known of one slice before its pixels are read.

use std::path::{Path, PathBuf};

use dicom_object::{InMemDicomObject, OpenFileOptions, Tag};

use super::super::FormatError;
use super::walk::{Pixels, walk};

/// One DICOM file: sorted and named, its geometry not yet judged.
pub(super) struct Head {
    pub file: PathBuf,
    /// Transfer syntax UID.
    pub syntax: String,
    pub series_uid: String,
    pub series_number: i64,
    /// A known modality code, or `other`.
    pub modality: &'static str,
    pub rows: u32,
    pub columns: u32,
    pub pixels: Option<Pixels>,
    values: Values,
}

/// The values of a file's elements as one text. A parsed data set takes ten times the bytes of a
/// small file, and the heads of a whole series are held at once.
#[derive(Default)]
struct Values {
    text: String,
    /// Element, and where its value ends in the text; the one before ends where it begins.
    ends: Vec<(Tag, u32)>,
}

impl Values {
    fn new(elements: &InMemDicomObject) -> Self {
        let mut values = Self::default();
        for element in elements {
            let Ok(value) = element.to_str() else { continue };
            values.text.push_str(&value);
            values.ends.push((element.header().tag, values.text.len() as u32));
        }
        values.text.shrink_to_fit();
        values.ends.shrink_to_fit();
        values
    }

    /// The value of an element without padding.
    fn get(&self, tag: Tag) -> Option<&str> {
        let i = self.ends.iter().position(|e| e.0 == tag)?;
        let start = if i == 0 { 0 } else { self.ends[i - 1].1 };
        let value = &self.text[start as usize..self.ends[i].1 as usize];
        Some(value.trim_matches(|c: char| c.is_whitespace() || c == '\0'))
    }
}

const MODALITIES: [&str; 12] =
    ["CT", "MR", "PT", "NM", "US", "XA", "CR", "DX", "SEG", "SR", "OT", "RTDOSE"];

/// Reads the allowed elements of a file; `None` if it is not DICOM.
pub(super) fn read(file: &Path) -> Result<Option<Head>, FormatError> {
    let Some(walked) = walk(file)? else { return Ok(None) };
    let parsed = OpenFileOptions::new().from_reader(walked.stream.as_slice()).map_err(|_| {
        FormatError::field(file, "data set", "damaged", "its elements cannot be taken apart")
    })?;
    let mut head = Head {
        file: file.to_owned(),
        syntax: walked.syntax,
        series_uid: String::new(),
        series_number: 0,
        modality: "other",
        rows: 0,
        columns: 0,
        pixels: walked.pixels,
        values: Values::new(&parsed),
    };
    let uid = head.text(0x0020, 0x000e);
    // Free text in the place of an identifier must not reach a listing.
    let plain = uid.chars().all(|c| c.is_ascii_digit() || c == '.') && !uid.is_empty();
    head.series_uid = if plain { uid } else { "unnamed".to_owned() };
    head.series_number = head.int(0x0020, 0x0011).unwrap_or(0);
    let modality = head.text(0x0008, 0x0060);
    head.modality = MODALITIES.into_iter().find(|m| *m == modality).unwrap_or("other");
    let side = |v: Option<i64>| v.and_then(|v| u32::try_from(v).ok()).unwrap_or(0);
    head.rows = side(head.int(0x0028, 0x0010));
    head.columns = side(head.int(0x0028, 0x0011));
    Ok(Some(head))
}

impl Head {
    /// A short text without padding; empty if absent.
    pub fn text(&self, group: u16, element: u16) -> String {
        self.values.get(Tag(group, element)).unwrap_or_default().to_owned()
    }

    /// A whole number, if there is one; of several the first.
    pub fn int(&self, group: u16, element: u16) -> Option<i64> {
        self.values.get(Tag(group, element))?.split('\\').next()?.trim().parse().ok()
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

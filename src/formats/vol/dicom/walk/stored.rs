//! Values of elements as they are stored, for a file that refers to this one. The reader of volumes
//! asks for none of them.

use std::io::{Read, Seek};
use std::path::Path;

use super::super::super::FormatError;
use super::super::element::{ElementCoding, MAX_VALUE, Tag, UNDEFINED};
use super::super::syntax;
use super::Walker;

/// Elements with their bytes, without padding.
pub(in super::super) struct StoredValues(Vec<(Tag, Vec<u8>)>);

impl StoredValues {
    /// The value of an element; empty where it is absent or longer than any that is read.
    pub fn get(&self, tag: Tag) -> &[u8] {
        self.0.iter().find(|v| v.0 == tag).map_or(&[], |v| &v.1)
    }
}

/// Elements of a file's data set.
///
/// * `wanted`: elements of text, whose bytes are the same in every transfer syntax.
pub(in super::super) fn stored_values(
    file: &Path,
    wanted: &[Tag],
) -> Result<StoredValues, FormatError> {
    let absent = || FormatError::text(file, "magic", "it is no DICOM file any more");
    let (mut w, syntax) = Walker::open(file)?.ok_or_else(absent)?;
    let coding = ElementCoding::of(&syntax);
    match syntax == syntax::DEFLATED {
        true => Walker::inflated(file, w.at)?.stored(coding, wanted),
        false => w.stored(coding, wanted),
    }
}

impl<R: Read + Seek> Walker<'_, R> {
    fn stored(&mut self, c: ElementCoding, wanted: &[Tag]) -> Result<StoredValues, FormatError> {
        let last = wanted.iter().max().copied();
        let mut values = Vec::new();
        while self.has_more()? {
            let h = self.head(c)?;
            if Some(h.tag) > last {
                break;
            }
            let len = u64::from(h.len);
            if h.len == UNDEFINED {
                self.skip_sequence(h.nested(c))?;
            } else if wanted.contains(&h.tag) && len <= MAX_VALUE {
                let value = self.bytes(len)?;
                let is_padding = |b: &u8| matches!(b, 0 | b' ');
                let end = value.len() - value.iter().rev().take_while(|b| is_padding(b)).count();
                values.push((h.tag, value[..end].to_vec()));
            } else {
                self.skip(len)?;
            }
        }
        Ok(StoredValues(values))
    }
}

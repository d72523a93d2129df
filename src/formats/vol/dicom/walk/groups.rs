//! Functional groups of multi-frame files: what is said of all frames, and of each (PS3.3 C.7.6.16).
//!
//! Only the sequences of position, orientation, spacing and rescale are entered, two levels below the
//! groups; everything else is stepped over.

use std::io::{Read, Seek};

use dicom_object::Tag;

use super::{Coding, ElementHead, FormatError, MOST_VALUE, UNDEFINED, Walker};

/// Values of elements by tag, as text.
pub(in super::super) type Leaves = Vec<(Tag, String)>;

/// What the groups hold.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Groups {
    /// Of all frames.
    pub shared: Leaves,
    /// Of each.
    pub frames: Vec<Leaves>,
}

/// Shared and per-frame functional groups.
pub(super) const SHARED: (u16, u16) = (0x5200, 0x9229);
pub(super) const PER_FRAME: (u16, u16) = (0x5200, 0x9230);

/// Sequences that are entered: plane position, plane orientation, pixel measures, pixel value
/// transformation.
const ENTERED: [(u16, u16); 4] =
    [(0x0020, 0x9113), (0x0020, 0x9116), (0x0028, 0x9110), (0x0028, 0x9145)];
/// Elements that are taken from them.
const LEAVES: [(u16, u16); 6] = [
    (0x0020, 0x0032), // image position
    (0x0020, 0x0037), // image orientation
    (0x0028, 0x0030), // pixel spacing
    (0x0018, 0x0050), // slice thickness
    (0x0028, 0x1052), // rescale intercept
    (0x0028, 0x1053), // rescale slope
];
/// Most frames of a file.
const MOST_FRAMES: usize = 1 << 18;

/// Where a sequence or an item ends; `None` where a delimiter says so.
type End = Option<u64>;

impl<R: Read + Seek> Walker<'_, R> {
    /// Takes one of the two group sequences in.
    pub(super) fn groups(
        &mut self,
        c: Coding,
        h: &ElementHead,
        groups: &mut Groups,
    ) -> Result<(), FormatError> {
        let is_shared = h.tag == SHARED;
        let inner = nested(c, h);
        let end = self.end_of(h)?;
        self.each_item(inner, end, &mut |w, end| {
            let mut leaves = Leaves::new();
            w.each_element(inner, end, &ENTERED, &mut |w, c, h| {
                let inner = nested(c, h);
                let end = w.end_of(h)?;
                w.each_item(inner, end, &mut |w, end| {
                    w.each_element(inner, end, &LEAVES, &mut |w, _, h| {
                        let value = w.bytes(u64::from(h.len).min(MOST_VALUE))?;
                        // Numbers as text; anything else is refused where they are read.
                        let text = String::from_utf8_lossy(&value).into_owned();
                        leaves.push((Tag(h.tag.0, h.tag.1), text));
                        Ok(())
                    })
                })
            })?;
            if is_shared {
                groups.shared.append(&mut leaves);
            } else if groups.frames.len() < MOST_FRAMES {
                groups.frames.push(leaves);
            } else {
                let what = format!("more than {MOST_FRAMES} frames");
                return Err(FormatError::unsupported(w.file, what));
            }
            Ok(())
        })
    }

    fn end_of(&self, h: &ElementHead) -> Result<End, FormatError> {
        if h.len == UNDEFINED {
            return Ok(None);
        }
        let len = u64::from(h.len);
        if len > self.end.saturating_sub(self.at) {
            Err(self.cut(len))
        } else {
            Ok(Some(self.at + len))
        }
    }

    fn is_over(&self, end: End) -> bool {
        end.is_some_and(|e| self.at >= e) || self.end.saturating_sub(self.at) < 8
    }

    fn each_item(
        &mut self,
        c: Coding,
        end: End,
        visit: &mut dyn FnMut(&mut Self, End) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        while !self.is_over(end) {
            let h = self.head(c)?;
            match h.tag {
                (0xfffe, 0xe000) => {
                    let end = self.end_of(&h)?;
                    visit(self, end)?;
                }
                (0xfffe, 0xe0dd) => return Ok(()),
                _ => {
                    let why = "something else than an item in a sequence";
                    return Err(FormatError::field(self.file, "functional groups", "damaged", why));
                }
            }
        }
        Ok(())
    }

    /// Visits the wanted elements of an item and steps over the others.
    fn each_element(
        &mut self,
        c: Coding,
        end: End,
        wanted: &[(u16, u16)],
        visit: &mut dyn FnMut(&mut Self, Coding, &ElementHead) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        while !self.is_over(end) {
            let h = self.head(c)?;
            if h.tag == (0xfffe, 0xe00d) {
                return Ok(());
            }
            // A sequence may be of any length, a value is short.
            let is_sequence = ENTERED.contains(&h.tag);
            let is_short = h.len != UNDEFINED && u64::from(h.len) <= MOST_VALUE;
            if wanted.contains(&h.tag) && (is_sequence || is_short) {
                visit(self, c, &h)?;
            } else if h.len == UNDEFINED {
                self.skip_sequence(nested(c, &h))?;
            } else {
                self.skip(u64::from(h.len))?;
            }
        }
        Ok(())
    }
}

/// How the elements within a sequence are coded.
fn nested(c: Coding, h: &ElementHead) -> Coding {
    Coding { explicit: c.explicit && &h.vr != b"UN", ..c }
}

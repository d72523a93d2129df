//! Functional groups of multi-frame files: what is said of all frames, and of each (PS3.3 C.7.6.16).
//!
//! Only the sequences of position, orientation, spacing, rescale and segment are entered, two levels
//! below the groups, and the list of segments; everything else is stepped over.

use std::io::{Read, Seek};

use dicom_object::Tag;

use super::{Coding, ElementHead, FormatError, MAX_VALUE, UNDEFINED, Walker};

/// Values of elements by tag, as text.
pub(in super::super) type Leaves = Vec<(Tag, String)>;

/// What the groups hold.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Groups {
    /// Of all frames.
    pub shared: Leaves,
    /// Of each.
    pub frames: Vec<Leaves>,
    /// The segments of a segmentation: number and label (PS3.3 C.8.20.4).
    pub segments: Vec<(i64, String)>,
}

/// Shared and per-frame functional groups.
pub(super) const SHARED: (u16, u16) = (0x5200, 0x9229);
pub(super) const PER_FRAME: (u16, u16) = (0x5200, 0x9230);

/// The list of segments, and what is taken from it.
pub(super) const SEGMENTS: (u16, u16) = (0x0062, 0x0002);
const SEGMENT_NUMBER: (u16, u16) = (0x0062, 0x0004);
const SEGMENT_LABEL: (u16, u16) = (0x0062, 0x0005);
/// The number of a frame's segment; like that of the list it is stored as two bytes.
const REFERENCED_SEGMENT: (u16, u16) = (0x0062, 0x000b);

/// Sequences that are entered: plane position, plane orientation, pixel measures, pixel value
/// transformation, segment identification.
const ENTERED: [(u16, u16); 5] =
    [(0x0020, 0x9113), (0x0020, 0x9116), (0x0028, 0x9110), (0x0028, 0x9145), (0x0062, 0x000a)];
/// Elements that are taken from them.
const LEAVES: [(u16, u16); 8] = [
    (0x0018, 0x0088), // spacing between slices
    (0x0020, 0x0032), // image position
    (0x0020, 0x0037), // image orientation
    (0x0028, 0x0030), // pixel spacing
    (0x0018, 0x0050), // slice thickness
    (0x0028, 0x1052), // rescale intercept
    (0x0028, 0x1053), // rescale slope
    REFERENCED_SEGMENT,
];
/// Most frames of a file.
const MAX_FRAMES: usize = 1 << 18;
/// Segments have numbers of 16 bits.
const MAX_SEGMENTS: usize = 1 << 16;

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
                    w.each_element(inner, end, &LEAVES, &mut |w, c, h| {
                        let value = w.bytes(u64::from(h.len).min(MAX_VALUE))?;
                        // Numbers as text; anything else is refused where they are read.
                        let text = match (h.tag, value.as_slice()) {
                            (REFERENCED_SEGMENT, &[a, b]) => word(c, [a, b]).to_string(),
                            _ => String::from_utf8_lossy(&value).into_owned(),
                        };
                        push(&mut leaves, Tag(h.tag.0, h.tag.1), text);
                        Ok(())
                    })
                })
            })?;
            if is_shared {
                leaves.drain(..).for_each(|(tag, text)| push(&mut groups.shared, tag, text));
            } else if groups.frames.len() < MAX_FRAMES {
                groups.frames.push(leaves);
            } else {
                let what = format!("more than {MAX_FRAMES} frames");
                return Err(FormatError::unsupported(w.file, what));
            }
            Ok(())
        })
    }

    /// Takes the list of segments in.
    pub(super) fn segments(
        &mut self,
        c: Coding,
        h: &ElementHead,
        groups: &mut Groups,
    ) -> Result<(), FormatError> {
        let inner = nested(c, h);
        let end = self.end_of(h)?;
        self.each_item(inner, end, &mut |w, end| {
            let (mut number, mut label) = (None, String::new());
            let wanted = [SEGMENT_NUMBER, SEGMENT_LABEL];
            w.each_element(inner, end, &wanted, &mut |w, c, h| {
                let value = w.bytes(u64::from(h.len).min(MAX_VALUE))?;
                match (h.tag, value.as_slice()) {
                    (SEGMENT_LABEL, text) => label = String::from_utf8_lossy(text).into_owned(),
                    (_, &[a, b]) => number = Some(i64::from(word(c, [a, b]))),
                    _ => {}
                }
                Ok(())
            })?;
            if let Some(number) = number
                && groups.segments.len() < MAX_SEGMENTS
            {
                groups.segments.push((number, label));
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
            let is_short = h.len != UNDEFINED && u64::from(h.len) <= MAX_VALUE;
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

/// Keeps one value of an element, the first.
fn push(leaves: &mut Leaves, tag: Tag, text: String) {
    if leaves.iter().all(|(other, _)| *other != tag) {
        leaves.push((tag, text));
    }
}

fn word(c: Coding, bytes: [u8; 2]) -> u16 {
    if c.big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
}

/// How the elements within a sequence are coded.
fn nested(c: Coding, h: &ElementHead) -> Coding {
    Coding { explicit: c.explicit && &h.vr != b"UN", ..c }
}

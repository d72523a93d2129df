//! Functional groups of multi-frame files: values of all frames, and of each (PS3.3 C.7.6.16).
//!
//! Only the sequences of position, orientation, spacing, rescale and segment are entered, two levels
//! below the groups, and the list of segments; everything else is stepped over.

use std::io::{Read, Seek};

use super::super::element::{SEGMENT_LABEL, Tag};
use super::{
    ElementCoding, ElementHead, ElementScope, ElementValues, FormatError, UNDEFINED, Walker,
};

/// Contents of the functional groups.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Groups {
    /// Values that all frames share.
    pub shared: ElementValues,
    /// Values of each frame.
    pub frames: Vec<ElementValues>,
    /// The segments of a segmentation: number and label (PS3.3 C.8.20.4).
    pub segments: Vec<(i64, String)>,
}

/// Shared and per-frame functional groups.
pub(super) const SHARED: Tag = (0x5200, 0x9229);
pub(super) const PER_FRAME: Tag = (0x5200, 0x9230);

/// The list of segments.
pub(super) const SEGMENTS: Tag = (0x0062, 0x0002);
/// Sequences that are entered: plane position, plane orientation, pixel measures, pixel value
/// transformation, segment identification.
const ENTERED: [Tag; 5] =
    [(0x0020, 0x9113), (0x0020, 0x9116), (0x0028, 0x9110), (0x0028, 0x9145), (0x0062, 0x000a)];
/// Most frames of a file.
const MAX_FRAMES: usize = 1 << 18;
/// Segments have numbers of 16 bits.
const MAX_SEGMENTS: usize = 1 << 16;

/// Offset at which a sequence or an item ends; `None` where a delimiter ends it.
type End = Option<u64>;

impl<R: Read + Seek> Walker<'_, R> {
    /// Takes one of the two group sequences in.
    pub(super) fn groups(
        &mut self,
        c: ElementCoding,
        h: &ElementHead,
        groups: &mut Groups,
    ) -> Result<(), FormatError> {
        let is_shared = h.tag == SHARED;
        let inner = h.nested(c);
        let end = self.end_of(h)?;
        let is_entered = |h: &ElementHead| ENTERED.contains(&h.tag);
        self.each_item(inner, end, &mut |w, end| {
            let mut values = ElementValues::default();
            w.each_element(inner, end, &is_entered, &mut |w, c, h| {
                let inner = h.nested(c);
                let end = w.end_of(h)?;
                w.each_item(inner, end, &mut |w, end| {
                    let is_readable = |h: &ElementHead| h.is_readable(ElementScope::Frames);
                    w.each_element(inner, end, &is_readable, &mut |w, c, h| {
                        let text = w.text(c, h)?;
                        values.push(h.tag, &text);
                        Ok(())
                    })
                })
            })?;
            values.shrink_to_fit();
            if is_shared {
                groups.shared.merge(&values);
            } else if groups.frames.len() < MAX_FRAMES {
                groups.frames.push(values);
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
        c: ElementCoding,
        h: &ElementHead,
        groups: &mut Groups,
    ) -> Result<(), FormatError> {
        let inner = h.nested(c);
        let end = self.end_of(h)?;
        self.each_item(inner, end, &mut |w, end| {
            let (mut number, mut label) = (None, String::new());
            let is_readable = |h: &ElementHead| h.is_readable(ElementScope::Segments);
            w.each_element(inner, end, &is_readable, &mut |w, c, h| {
                let text = w.text(c, h)?;
                match h.tag {
                    SEGMENT_LABEL => label = text,
                    _ => number = text.parse().ok(),
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
        c: ElementCoding,
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
        c: ElementCoding,
        end: End,
        is_wanted: &dyn Fn(&ElementHead) -> bool,
        visit: &mut dyn FnMut(&mut Self, ElementCoding, &ElementHead) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        while !self.is_over(end) {
            let h = self.head(c)?;
            if h.tag == (0xfffe, 0xe00d) {
                return Ok(());
            }
            if is_wanted(&h) {
                visit(self, c, &h)?;
            } else if h.len == UNDEFINED {
                self.skip_sequence(h.nested(c))?;
            } else {
                self.skip(u64::from(h.len))?;
            }
        }
        Ok(())
    }
}

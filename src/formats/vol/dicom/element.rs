//! Elements of a data set: their heads in each coding (PS3.5 chapter 7), and the few whose values
//! may be read, with the value representation that the data dictionary (PS3.6) gives them.

use std::ops::Range;

use super::charset::CharacterSet;
use super::syntax;

/// Group and element number.
pub(super) type Tag = (u16, u16);
/// A value representation: two capital letters.
type Vr = [u8; 2];

/// Part of a file from which an element is taken.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum ElementScope {
    /// The data set itself.
    File,
    /// The functional groups of frames.
    Frames,
    /// The list of segments.
    Segments,
}
use ElementScope::{File, Frames, Segments};

pub(super) const CHARACTER_SET: Tag = (0x0008, 0x0005);
pub(super) const SEGMENT_NUMBER: Tag = (0x0062, 0x0004);
pub(super) const SEGMENT_LABEL: Tag = (0x0062, 0x0005);

/// Elements that may be read. What is not on the list (names, dates, other descriptions) is never
/// decoded. The description of a series is free text: it is shown where one is chosen from several
/// and goes into no file, report or message.
const READABLE: [(Tag, &Vr, &[ElementScope]); 40] = [
    (CHARACTER_SET, b"CS", &[File]),
    ((0x0008, 0x0008), b"CS", &[File]),         // image type
    ((0x0008, 0x0016), b"UI", &[File]),         // SOP class
    ((0x0008, 0x0060), b"CS", &[File]),         // modality
    ((0x0008, 0x103e), b"LO", &[File]),         // series description
    ((0x0018, 0x0050), b"DS", &[File, Frames]), // slice thickness
    ((0x0018, 0x0086), b"IS", &[File]),         // echo numbers
    ((0x0018, 0x0088), b"DS", &[File, Frames]), // spacing between slices
    ((0x0018, 0x1060), b"DS", &[File]),         // trigger time
    ((0x0018, 0x1210), b"SH", &[File]),         // convolution kernel
    ((0x0020, 0x000e), b"UI", &[File]),         // series instance UID
    ((0x0020, 0x0011), b"IS", &[File]),         // series number
    ((0x0020, 0x0012), b"IS", &[File]),         // acquisition number
    ((0x0020, 0x0032), b"DS", &[File, Frames]), // image position
    ((0x0020, 0x0037), b"DS", &[File, Frames]), // image orientation
    ((0x0020, 0x0100), b"IS", &[File]),         // temporal position
    ((0x0020, 0x9161), b"UI", &[File]),         // concatenation UID
    ((0x0020, 0x9162), b"US", &[File]),         // number of the part
    ((0x0020, 0x9163), b"US", &[File]),         // number of parts
    ((0x0028, 0x0002), b"US", &[File]),         // samples per pixel
    ((0x0028, 0x0004), b"CS", &[File]),         // photometric interpretation
    ((0x0028, 0x0008), b"IS", &[File]),         // number of frames
    ((0x0028, 0x0010), b"US", &[File]),         // rows
    ((0x0028, 0x0011), b"US", &[File]),         // columns
    ((0x0028, 0x0030), b"DS", &[File, Frames]), // pixel spacing
    ((0x0028, 0x0100), b"US", &[File]),         // bits allocated
    ((0x0028, 0x0101), b"US", &[File]),         // bits stored
    ((0x0028, 0x0102), b"US", &[File]),         // high bit
    ((0x0028, 0x0103), b"US", &[File]),         // pixel representation
    ((0x0028, 0x0120), b"US", &[File]),         // padding value, or SS
    ((0x0028, 0x0121), b"US", &[File]),         // padding range limit, or SS
    ((0x0028, 0x0301), b"CS", &[File]),         // burned-in annotation
    ((0x0028, 0x0302), b"CS", &[File]),         // recognizable visual features
    ((0x0028, 0x1052), b"DS", &[File, Frames]), // rescale intercept
    ((0x0028, 0x1053), b"DS", &[File, Frames]), // rescale slope
    ((0x0062, 0x0001), b"CS", &[File]),         // segmentation type
    (SEGMENT_NUMBER, b"US", &[Segments]),
    (SEGMENT_LABEL, b"LO", &[Segments]),
    ((0x0062, 0x000b), b"US", &[Frames]), // number of a frame's segment
    ((0x0062, 0x000e), b"US", &[File]),   // maximum fractional value
];

/// Value representations of the readable elements. With another one an element is passed over.
const PLAIN: [&Vr; 8] = [b"CS", b"DS", b"IS", b"LO", b"SH", b"SS", b"UI", b"US"];
/// Value representations whose length has 16 bits.
const SHORT: [&Vr; 21] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FD", b"FL", b"IS", b"LO", b"LT", b"PN",
    b"SH", b"SL", b"SS", b"ST", b"TM", b"UI", b"UL", b"US",
];
/// The others of the standard; those of the future have 32 bits too.
const LONG: [&Vr; 13] =
    [b"OB", b"OD", b"OF", b"OL", b"OV", b"OW", b"SQ", b"SV", b"UC", b"UN", b"UR", b"UT", b"UV"];
/// Value representation of an element that a writer did not know; the dictionary has its own.
const UNKNOWN: Vr = *b"UN";

/// No readable element needs more.
pub(super) const MAX_VALUE: u64 = 1024;
/// Length of a sequence, an item or pixels whose end a delimiter tells.
pub(super) const UNDEFINED: u32 = u32::MAX;

/// Coding of elements: byte order and value representation.
#[derive(Clone, Copy)]
pub(super) struct ElementCoding {
    /// Whether each names its value representation.
    pub explicit: bool,
    pub big: bool,
}

impl ElementCoding {
    /// Returns the coding of a transfer syntax.
    pub fn of(syntax: &str) -> Self {
        let big = syntax == syntax::EXPLICIT_BIG;
        Self { explicit: syntax != syntax::IMPLICIT_LITTLE, big }
    }

    pub fn u16(self, bytes: [u8; 2]) -> u16 {
        if self.big { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn u32(self, bytes: [u8; 4]) -> u32 {
        if self.big { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }
}

/// Tag, value representation and length before a value.
#[derive(Clone, Copy)]
pub(super) struct ElementHead {
    pub tag: Tag,
    vr: Option<Vr>,
    pub len: u32,
}

impl ElementHead {
    /// Takes the first eight bytes of an element apart. Where the length has 32 bits after them,
    /// `true`: [`Self::with_length`] is needed.
    pub fn new(c: ElementCoding, b: [u8; 8]) -> (Self, bool) {
        let tag = (c.u16([b[0], b[1]]), c.u16([b[2], b[3]]));
        // Items and delimiters never carry a value representation.
        if !c.explicit || tag.0 == 0xfffe {
            return (Self { tag, vr: None, len: c.u32([b[4], b[5], b[6], b[7]]) }, false);
        }
        let vr = [b[4], b[5]];
        (Self { tag, vr: Some(vr), len: c.u16([b[6], b[7]]).into() }, !SHORT.contains(&&vr))
    }

    pub fn with_length(self, c: ElementCoding, bytes: [u8; 4]) -> Self {
        Self { len: c.u32(bytes), ..self }
    }

    /// Whether a value representation is there, or none is asked for.
    pub fn is_typed(&self) -> bool {
        self.vr.is_none_or(|vr| vr.iter().all(u8::is_ascii_uppercase))
    }

    /// Whether the value representation is one of the standard's, or there is none.
    pub fn is_standard(&self) -> bool {
        self.vr.is_none_or(|vr| SHORT.contains(&&vr) || LONG.contains(&&vr))
    }

    /// Returns the coding of the elements of a sequence with this head.
    pub fn nested(&self, c: ElementCoding) -> ElementCoding {
        ElementCoding { explicit: c.explicit && self.vr != Some(UNKNOWN), ..c }
    }

    /// Whether the value may be read there.
    pub fn is_readable(&self, scope: ElementScope) -> bool {
        let entry = READABLE.iter().find(|e| e.0 == self.tag && e.2.contains(&scope));
        entry.is_some() && u64::from(self.len) <= MAX_VALUE && PLAIN.contains(&&self.stored_as())
    }

    /// Returns the element's value representation, or that of the dictionary where it has none.
    fn stored_as(&self) -> Vr {
        let known = || READABLE.iter().find(|e| e.0 == self.tag).map_or(UNKNOWN, |e| *e.1);
        self.vr.filter(|vr| *vr != UNKNOWN).unwrap_or_else(known)
    }

    /// A value as text, several joined by backslashes; `None` if it is cut within a number.
    pub fn text(&self, c: ElementCoding, set: CharacterSet, value: &[u8]) -> Option<String> {
        let vr = self.stored_as();
        if &vr != b"US" && &vr != b"SS" {
            return Some(set.decoded(value));
        }
        let (words, rest) = value.as_chunks::<2>();
        let number = |w: &[u8; 2]| match &vr {
            b"SS" => (c.u16(*w) as i16).to_string(),
            _ => c.u16(*w).to_string(),
        };
        rest.is_empty().then(|| words.iter().map(number).collect::<Vec<_>>().join("\\"))
    }
}

/// Values of elements, as one text: those of a whole series are held at once.
#[derive(Clone, Debug, Default)]
pub(super) struct ElementValues {
    text: String,
    /// Element, and where its value ends in the text; the one before ends where it begins.
    ends: Vec<(Tag, u32)>,
}

impl ElementValues {
    /// Keeps a value of an element, the first.
    pub fn push(&mut self, tag: Tag, value: &str) {
        if self.ends.iter().all(|e| e.0 != tag) {
            self.text.push_str(value);
            self.ends.push((tag, self.text.len() as u32));
        }
    }

    /// Adds what is not there yet.
    pub fn merge(&mut self, other: &Self) {
        (0..other.ends.len()).for_each(|i| self.push(other.ends[i].0, &other.text[other.range(i)]));
    }

    /// The value of an element without padding.
    pub fn get(&self, tag: Tag) -> Option<&str> {
        let i = self.ends.iter().position(|e| e.0 == tag)?;
        Some(self.text[self.range(i)].trim_matches(|c: char| c.is_whitespace() || c == '\0'))
    }

    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    pub fn shrink_to_fit(&mut self) {
        self.text.shrink_to_fit();
        self.ends.shrink_to_fit();
    }

    fn range(&self, i: usize) -> Range<usize> {
        let start = if i == 0 { 0 } else { self.ends[i - 1].1 };
        start as usize..self.ends[i].1 as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_numbers_with_their_sign_and_byte_order() {
        let c = ElementCoding { explicit: true, big: true };
        let (padding, long) = ElementHead::new(c, *b"\0\x28\x01\x20SS\0\x02");
        assert!(!long && padding.is_readable(File) && !padding.is_readable(Frames));
        assert_eq!(
            padding.text(c, CharacterSet::default(), &[0xf8, 0x30]).as_deref(),
            Some("-2000")
        );
        assert_eq!(padding.text(c, CharacterSet::default(), &[0xf8]), None);
        let c = ElementCoding { explicit: false, big: false };
        let (padding, _) = ElementHead::new(c, *b"\x28\0\x20\x01\x04\0\0\0");
        assert_eq!(
            padding.text(c, CharacterSet::default(), &[0x30, 0xf8, 1, 0]).as_deref(),
            Some("63536\\1")
        );
    }

    #[test]
    fn the_first_value_of_an_element_is_kept_and_padding_is_not() {
        let mut values = ElementValues::default();
        values.push((0x20, 0x32), "1\\2\\3 ");
        values.push((0x20, 0x32), "4\\5\\6");
        values.push((0x20, 0xe), "1.2\0");
        let mut all = ElementValues::default();
        all.push((0x20, 0xe), "9.9");
        all.merge(&values);
        assert_eq!(all.get((0x20, 0x32)), Some("1\\2\\3"));
        assert_eq!(all.get((0x20, 0xe)), Some("9.9"));
        assert_eq!(all.get((0x20, 0x10)), None);
    }
}

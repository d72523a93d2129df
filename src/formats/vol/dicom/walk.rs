//! A walk over the elements of a DICOM file that copies out the few we may see.
//!
//! The parser of `dicom-object` takes memory for whatever length an element claims and follows
//! nested sequences as deep as they go; both end the process on a hostile file. So lengths are
//! held against the file here, sequences are stepped over without recursion, and the parser gets
//! a small data set of allowlisted elements. What is not on the list (names, dates, descriptions)
//! is never decoded.

mod groups;
mod inflated;

pub(super) use groups::{Groups, Leaves};
pub(super) use inflated::Inflated;

use std::io::{self, BufRead as _, BufReader, Read, Seek};
use std::path::Path;

use super::super::FormatError;
use super::super::source::{Source, fill};
use super::fragments::Fragment;
use super::{bare, syntax};

/// Elements that may be read: group and element number, ascending.
const ALLOWED: [(u16, u16); 34] = [
    (0x0008, 0x0008), // image type
    (0x0008, 0x0016), // SOP class
    (0x0008, 0x0060), // modality
    (0x0018, 0x0050), // slice thickness
    (0x0018, 0x0086), // echo numbers
    (0x0018, 0x0088), // spacing between slices
    (0x0018, 0x1060), // trigger time
    (0x0020, 0x000e), // series instance UID
    (0x0020, 0x0011), // series number
    (0x0020, 0x0012), // acquisition number
    (0x0020, 0x0032), // image position
    (0x0020, 0x0037), // image orientation
    (0x0020, 0x0100), // temporal position
    (0x0020, 0x9161), // concatenation UID
    (0x0020, 0x9162), // number of the part
    (0x0020, 0x9163), // number of parts
    (0x0028, 0x0002), // samples per pixel
    (0x0028, 0x0004), // photometric interpretation
    (0x0028, 0x0008), // number of frames
    (0x0028, 0x0010), // rows
    (0x0028, 0x0011), // columns
    (0x0028, 0x0030), // pixel spacing
    (0x0028, 0x0100), // bits allocated
    (0x0028, 0x0101), // bits stored
    (0x0028, 0x0102), // high bit
    (0x0028, 0x0103), // pixel representation
    (0x0028, 0x0120), // padding value
    (0x0028, 0x0121), // padding range limit
    (0x0028, 0x0301), // burned-in annotation
    (0x0028, 0x0302), // recognizable visual features
    (0x0028, 0x1052), // rescale intercept
    (0x0028, 0x1053), // rescale slope
    (0x0062, 0x0001), // segmentation type
    (0x0062, 0x000e), // maximum fractional value
];

/// Value representations whose length has 16 bits.
const SHORT: [&[u8; 2]; 21] = [
    b"AE", b"AS", b"AT", b"CS", b"DA", b"DS", b"DT", b"FD", b"FL", b"IS", b"LO", b"LT", b"PN",
    b"SH", b"SL", b"SS", b"ST", b"TM", b"UI", b"UL", b"US",
];

/// Value representations of the allowed elements. With another one an element is passed over, so
/// that the parser never sees a head it might read in a different way than we do.
const PLAIN: [&[u8; 2]; 6] = [b"CS", b"DS", b"IS", b"SS", b"UI", b"US"];

/// No allowed element needs more.
const MAX_VALUE: u64 = 1024;
const DEEPEST: usize = 64;
/// Most fragments of a file's pixels.
const MAX_FRAGMENTS: u64 = 1 << 20;
const UNDEFINED: u32 = u32::MAX;

/// Where the pixels of a file lie.
#[derive(Clone, Debug)]
pub(super) enum Pixels {
    /// As they are, from an offset on; in a deflated file, of what is inflated.
    Plain {
        /// Bytes before them.
        offset: u64,
        /// Bytes of them.
        len: u64,
    },
    /// Compressed, in fragments.
    Encapsulated {
        /// In their order.
        fragments: Vec<Fragment>,
        /// The basic offset table, where there is one.
        offsets: Vec<u64>,
    },
}

/// The allowed part of a file.
pub(super) struct Walked {
    /// UID of the transfer syntax, digits and dots only.
    pub syntax: String,
    /// A complete small DICOM stream of the allowed elements, without preamble.
    pub stream: Vec<u8>,
    /// What is said of the frames of a multi-frame file.
    pub groups: Groups,
    pub pixels: Option<Pixels>,
}

#[derive(Clone, Copy)]
struct Coding {
    explicit: bool,
    big: bool,
}

impl Coding {
    fn may_copy(self, h: &ElementHead) -> bool {
        let plain = !self.explicit || PLAIN.contains(&&h.vr);
        ALLOWED.contains(&h.tag) && plain && u64::from(h.len) <= MAX_VALUE
    }
}

struct ElementHead {
    tag: (u16, u16),
    vr: [u8; 2],
    len: u32,
    /// The head as stored.
    bytes: Vec<u8>,
}

struct Walker<'a, R> {
    file: &'a Path,
    input: BufReader<R>,
    at: u64,
    end: u64,
}

/// Walks a file; `None` if it is not DICOM.
pub(super) fn walk(file: &Path) -> Result<Option<Walked>, FormatError> {
    let source = Source::open(file)?;
    let end = source.len;
    let mut w = Walker { file, input: BufReader::with_capacity(1 << 14, source), at: 0, end };
    let mut preamble = [0; 132];
    let n = fill(&mut w.input, &mut preamble).map_err(|e| FormatError::io(file, e))?;
    w.at = n as u64;
    let (syntax, first) = if n == preamble.len() && &preamble[128..] == b"DICM" {
        w.meta()?
    } else {
        let Some(syntax) = bare::syntax_of(&preamble[..n]) else { return Ok(None) };
        w.input.seek_relative(-(n as i64)).map_err(|e| FormatError::io(file, e))?;
        w.at = 0;
        // The meta group may be there without a preamble.
        if bare::begins_with_meta(&preamble[..n]) { w.meta()? } else { (syntax.to_owned(), 0) }
    };
    let coding =
        Coding { explicit: syntax != syntax::IMPLICIT_LITTLE, big: syntax == syntax::EXPLICIT_BIG };
    let mut stream = synthetic_meta(coding);
    let mut groups = Groups::default();
    let pixels = if syntax == syntax::DEFLATED {
        let inflated = Inflated::open(file, w.at)?;
        let end = inflated.most();
        let input = BufReader::with_capacity(1 << 14, inflated);
        Walker { file, input, at: 0, end }.data_set(coding, 0, &mut stream, &mut groups)?
    } else {
        w.data_set(coding, first, &mut stream, &mut groups)?
    };
    Ok(Some(Walked { syntax, stream, groups, pixels }))
}

/// The data set of a deflated file, from its first byte on.
pub(super) fn inflate(file: &Path) -> Result<Inflated, FormatError> {
    Inflated::open(file, data_set_offset(file)?)
}

/// Where the data set of a file begins.
fn data_set_offset(file: &Path) -> Result<u64, FormatError> {
    let source = Source::open(file)?;
    let end = source.len;
    let mut w = Walker { file, input: BufReader::new(source), at: 0, end };
    w.skip(132.min(end))?;
    Ok(w.meta()?.1)
}

impl<R: Read + Seek> Walker<'_, R> {
    fn cut(&self, wanted: u64) -> FormatError {
        let (file, found) = (self.file.to_owned(), self.end);
        let wanted = self.at.saturating_add(wanted);
        FormatError::Truncated { file, what: "elements", wanted, found }
    }

    fn bytes(&mut self, n: u64) -> Result<Vec<u8>, FormatError> {
        if n > self.end.saturating_sub(self.at) {
            return Err(self.cut(n));
        }
        let mut out = vec![0; n as usize];
        match self.input.read_exact(&mut out) {
            Ok(()) => {}
            Err(e) => return Err(self.failed(e, n)),
        }
        self.at += n;
        Ok(out)
    }

    fn skip(&mut self, n: u64) -> Result<(), FormatError> {
        if n > self.end.saturating_sub(self.at) {
            return Err(self.cut(n));
        }
        self.input.seek_relative(n as i64).map_err(|e| self.failed(e, n))?;
        self.at += n;
        Ok(())
    }

    /// What became of reading `n` bytes.
    fn failed(&self, e: io::Error, n: u64) -> FormatError {
        match e.kind() {
            io::ErrorKind::UnexpectedEof => self.cut(n),
            io::ErrorKind::InvalidData => inflated::damaged(self.file),
            _ => FormatError::io(self.file, e),
        }
    }

    /// Whether another element may follow; where a deflated data set ends is not known before.
    fn has_more(&mut self) -> Result<bool, FormatError> {
        if self.end.saturating_sub(self.at) < 8 {
            return Ok(false);
        }
        let has_more = self.input.fill_buf().map(|b| !b.is_empty());
        has_more.map_err(|e| self.failed(e, 1))
    }

    fn head(&mut self, c: Coding) -> Result<ElementHead, FormatError> {
        let mut bytes = self.bytes(8)?;
        let u16_at = |b: &[u8], i: usize| {
            let two = [b[i], b[i + 1]];
            if c.big { u16::from_be_bytes(two) } else { u16::from_le_bytes(two) }
        };
        let u32_at = |b: &[u8], i: usize| {
            let four = [b[i], b[i + 1], b[i + 2], b[i + 3]];
            if c.big { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) }
        };
        let tag = (u16_at(&bytes, 0), u16_at(&bytes, 2));
        // Items and delimiters never carry a value representation.
        if !c.explicit || tag.0 == 0xfffe {
            let len = u32_at(&bytes, 4);
            return Ok(ElementHead { tag, vr: [0; 2], len, bytes });
        }
        let vr = [bytes[4], bytes[5]];
        if !vr.iter().all(u8::is_ascii_uppercase) {
            let name = format!("element ({:04x},{:04x})", tag.0, tag.1);
            let why = "no value representation, where the transfer syntax is explicit";
            return Err(FormatError::field(self.file, name, "untyped", why));
        }
        // All others, those of the future included, have a long head.
        let len = if !SHORT.contains(&&vr) {
            bytes.extend(self.bytes(4)?);
            u32_at(&bytes, 8)
        } else {
            u32::from(u16_at(&bytes, 6))
        };
        Ok(ElementHead { tag, vr, len, bytes })
    }

    /// The file meta group, always explicit little endian: the transfer syntax, and the first
    /// eight bytes' place of the data set.
    fn meta(&mut self) -> Result<(String, u64), FormatError> {
        let c = Coding { explicit: true, big: false };
        let mut syntax = None;
        loop {
            let start = self.at;
            if self.end - self.at < 8 || self.peek_group()? != 2 {
                let missing =
                    || FormatError::field(self.file, "transfer syntax", "absent", "needed");
                return Ok((syntax.ok_or_else(missing)?, start));
            }
            let h = self.head(c)?;
            if h.tag == (2, 0x10) && u64::from(h.len) <= MAX_VALUE {
                let value = self.bytes(u64::from(h.len))?;
                let known = |b: &&u8| b.is_ascii_digit() || **b == b'.';
                syntax = Some(value.iter().filter(known).map(|&b| char::from(b)).collect());
            } else {
                self.skip(u64::from(h.len))?;
            }
        }
    }

    fn peek_group(&mut self) -> Result<u16, FormatError> {
        let two = self.bytes(2)?;
        self.input.seek_relative(-2).map_err(|e| FormatError::io(self.file, e))?;
        self.at -= 2;
        Ok(u16::from_le_bytes([two[0], two[1]]))
    }

    fn data_set(
        &mut self,
        c: Coding,
        first: u64,
        stream: &mut Vec<u8>,
        groups: &mut Groups,
    ) -> Result<Option<Pixels>, FormatError> {
        debug_assert_eq!(self.at, first);
        let mut last = None;
        while self.has_more()? {
            let h = self.head(c)?;
            let len = u64::from(h.len);
            if h.tag == (0x7fe0, 0x0010) {
                return Ok(Some(match h.len {
                    UNDEFINED => self.fragments(c)?,
                    _ => Pixels::Plain { offset: self.at, len },
                }));
            }
            if [groups::SHARED, groups::PER_FRAME].contains(&h.tag) {
                self.groups(c, &h, groups)?;
            } else if h.tag == groups::SEGMENTS {
                self.segments(c, &h, groups)?;
            } else if h.len == UNDEFINED {
                let explicit = c.explicit && &h.vr != b"UN";
                self.skip_sequence(Coding { explicit, ..c })?;
            } else if c.may_copy(&h) && last < Some(h.tag) {
                last = Some(h.tag);
                let value = self.bytes(len)?;
                stream.extend(&h.bytes);
                stream.extend(value);
            } else {
                self.skip(len)?;
            }
        }
        Ok(None)
    }

    /// The items of encapsulated pixels: the offset table, then fragments.
    fn fragments(&mut self, c: Coding) -> Result<Pixels, FormatError> {
        let mut fragments = Vec::new();
        let mut offsets = None;
        while self.end - self.at >= 8 {
            let h = self.head(c)?;
            let len = u64::from(h.len);
            match h.tag {
                (0xfffe, 0xe000) if h.len != UNDEFINED => {}
                (0xfffe, 0xe0dd) => break,
                _ => {
                    let why = "something else than a fragment among them";
                    return Err(FormatError::field(self.file, "pixels", "damaged", why));
                }
            }
            if offsets.is_none() {
                let table = if len <= 4 * MAX_FRAGMENTS { self.bytes(len)? } else { Vec::new() };
                let word = |b: &[u8]| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                offsets = Some(table.chunks_exact(4).map(word).collect());
                continue;
            }
            if fragments.len() as u64 == MAX_FRAGMENTS {
                let what = format!("more than {MAX_FRAGMENTS} fragments");
                return Err(FormatError::unsupported(self.file, what));
            }
            fragments.push((self.at, h.len));
            self.skip(len)?;
        }
        Ok(Pixels::Encapsulated { fragments, offsets: offsets.unwrap_or_default() })
    }

    /// Steps over a sequence of undefined length, nested ones included.
    fn skip_sequence(&mut self, c: Coding) -> Result<(), FormatError> {
        let mut open = vec![c];
        while let Some(&c) = open.last() {
            let h = self.head(c)?;
            match (h.tag, h.len) {
                ((0xfffe, 0xe00d | 0xe0dd), _) => {
                    open.pop();
                }
                (_, UNDEFINED) if open.len() == DEEPEST => {
                    let what = format!("sequences nested deeper than {DEEPEST}");
                    return Err(FormatError::unsupported(self.file, what));
                }
                (_, UNDEFINED) => {
                    let explicit = c.explicit && &h.vr != b"UN";
                    open.push(Coding { explicit, ..c });
                }
                (_, len) => self.skip(u64::from(len))?,
            }
        }
        Ok(())
    }
}

/// The least meta group that the parser takes: group length and transfer syntax.
fn synthetic_meta(c: Coding) -> Vec<u8> {
    // Compressed files store their elements as explicit little endian.
    let mut uid = match (c.explicit, c.big) {
        (false, _) => syntax::IMPLICIT_LITTLE,
        (true, false) => syntax::EXPLICIT_LITTLE,
        (true, true) => syntax::EXPLICIT_BIG,
    }
    .as_bytes()
    .to_vec();
    if uid.len() % 2 == 1 {
        uid.push(0);
    }
    let mut out = b"DICM\x02\0\0\0UL\x04\0".to_vec();
    out.extend((8 + uid.len() as u32).to_le_bytes());
    out.extend(b"\x02\0\x10\0UI");
    out.extend((uid.len() as u16).to_le_bytes());
    out.extend(uid);
    out
}

//! A walk over the elements of a DICOM file that takes out the few we may see.
//!
//! Lengths are held against the file before memory is taken for them, and sequences are stepped
//! over without recursion, however deep they are nested.

mod groups;
mod inflated;
mod stored;

pub(super) use groups::Groups;
pub(super) use inflated::Inflated;
pub(super) use stored::{StoredValues, stored_values};

use std::io::{self, BufRead as _, BufReader, Read, Seek};
use std::path::Path;

use super::super::FormatError;
use super::super::source::{DataFile, fill};
use super::charset::CharacterSet;
use super::element::{
    CHARACTER_SET, ElementCoding, ElementHead, ElementScope, ElementValues, MAX_VALUE, UNDEFINED,
};
use super::fragments::Fragment;
use super::{bare, syntax};

const DEEPEST: usize = 64;
/// Most fragments of a file's pixels.
const MAX_FRAGMENTS: u64 = 1 << 20;

/// Place of a file's pixels.
#[derive(Clone, Debug)]
pub(super) enum Pixels {
    /// Uncompressed, from an offset on: in the file, or in the inflated data set of a deflated one.
    Plain {
        /// Bytes before the pixels.
        offset: u64,
        /// Bytes of the pixels.
        len: u64,
    },
    /// Compressed, in fragments.
    Encapsulated {
        /// Fragments in their order.
        fragments: Vec<Fragment>,
        /// The basic offset table, where there is one.
        offsets: Vec<u64>,
    },
}

/// The readable part of a file.
pub(super) struct Walked {
    /// UID of the transfer syntax, digits and dots only.
    pub syntax: String,
    /// Readable elements of the data set.
    pub values: ElementValues,
    /// Functional groups of a multi-frame file, and its list of segments.
    pub groups: Groups,
    pub pixels: Option<Pixels>,
}

struct Walker<'a, R> {
    file: &'a Path,
    input: BufReader<R>,
    at: u64,
    end: u64,
    charset: CharacterSet,
}

/// Walks a file; `None` if it is not DICOM.
pub(super) fn walk(file: &Path) -> Result<Option<Walked>, FormatError> {
    let Some((mut w, syntax)) = Walker::open(file)? else { return Ok(None) };
    let coding = ElementCoding::of(&syntax);
    let mut values = ElementValues::default();
    let mut groups = Groups::default();
    let pixels = if syntax == syntax::DEFLATED {
        Walker::inflated(file, w.at)?.data_set(coding, &mut values, &mut groups)?
    } else {
        w.data_set(coding, &mut values, &mut groups)?
    };
    values.shrink_to_fit();
    Ok(Some(Walked { syntax, values, groups, pixels }))
}

/// The data set of a deflated file, from its first byte on.
pub(super) fn inflate(file: &Path) -> Result<Inflated, FormatError> {
    match Walker::open(file)? {
        Some((walker, _)) => Inflated::open(file, walker.at),
        None => Err(FormatError::unsupported(file, "a file that is not DICOM any more")),
    }
}

impl<'a> Walker<'a, DataFile> {
    /// Opens a file at its data set, with the UID of its transfer syntax; `None` if it is not DICOM.
    fn open(file: &'a Path) -> Result<Option<(Self, String)>, FormatError> {
        let source = DataFile::open(file)?;
        let end = source.len;
        let mut w = Walker::new(file, BufReader::with_capacity(1 << 14, source), end);
        let mut preamble = [0; 132];
        let n = fill(&mut w.input, &mut preamble).map_err(|e| FormatError::io(file, e))?;
        w.at = n as u64;
        if n == preamble.len() && &preamble[128..] == b"DICM" {
            let syntax = w.meta()?;
            return Ok(Some((w, syntax)));
        }
        let Some(syntax) = bare::syntax_of(&preamble[..n]) else { return Ok(None) };
        w.input.seek_relative(-(n as i64)).map_err(|e| FormatError::io(file, e))?;
        w.at = 0;
        // The meta group may be there without a preamble.
        let has_meta = bare::begins_with_meta(&preamble[..n]);
        let syntax = if has_meta { w.meta()? } else { syntax.to_owned() };
        Ok(Some((w, syntax)))
    }
}

impl<'a> Walker<'a, Inflated> {
    /// Opens the deflated data set that begins at an offset of a file.
    fn inflated(file: &'a Path, offset: u64) -> Result<Self, FormatError> {
        let inflated = Inflated::open(file, offset)?;
        let end = inflated.most();
        Ok(Walker::new(file, BufReader::with_capacity(1 << 14, inflated), end))
    }
}

impl<'a, R: Read + Seek> Walker<'a, R> {
    fn new(file: &'a Path, input: BufReader<R>, end: u64) -> Self {
        Self { file, input, at: 0, end, charset: CharacterSet::default() }
    }

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

    /// Returns the error of a failed read of `n` bytes.
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

    fn array<const N: usize>(&mut self) -> Result<[u8; N], FormatError> {
        let n = N as u64;
        if n > self.end.saturating_sub(self.at) {
            return Err(self.cut(n));
        }
        let mut out = [0; N];
        self.input.read_exact(&mut out).map_err(|e| self.failed(e, n))?;
        self.at += n;
        Ok(out)
    }

    fn head(&mut self, c: ElementCoding) -> Result<ElementHead, FormatError> {
        let (h, is_long) = ElementHead::new(c, self.array()?);
        if !h.is_typed() {
            let why = "no value representation, where the transfer syntax is explicit";
            return Err(FormatError::field(self.file, name(&h), "untyped", why));
        }
        Ok(if is_long { h.with_length(c, self.array()?) } else { h })
    }

    /// The value of a readable element.
    fn text(&mut self, c: ElementCoding, h: &ElementHead) -> Result<String, FormatError> {
        let value = self.bytes(u64::from(h.len))?;
        h.text(c, self.charset, &value).ok_or_else(|| {
            let why = format!("{} bytes are no numbers of two", h.len);
            FormatError::field(self.file, name(h), "damaged", why)
        })
    }

    /// The file meta group, always explicit little endian: the transfer syntax. The data set follows.
    fn meta(&mut self) -> Result<String, FormatError> {
        let c = ElementCoding { explicit: true, big: false };
        let mut syntax = None;
        loop {
            if self.end - self.at < 8 || self.peek_group()? != 2 {
                let missing =
                    || FormatError::field(self.file, "transfer syntax", "absent", "needed");
                return syntax.ok_or_else(missing);
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
        let two = self.array()?;
        self.input.seek_relative(-2).map_err(|e| FormatError::io(self.file, e))?;
        self.at -= 2;
        Ok(u16::from_le_bytes(two))
    }

    fn data_set(
        &mut self,
        c: ElementCoding,
        values: &mut ElementValues,
        groups: &mut Groups,
    ) -> Result<Option<Pixels>, FormatError> {
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
                self.skip_sequence(h.nested(c))?;
            } else if h.is_readable(ElementScope::File) && last < Some(h.tag) {
                last = Some(h.tag);
                let text = self.text(c, &h)?;
                if h.tag == CHARACTER_SET {
                    self.charset = CharacterSet::of(&text);
                }
                values.push(h.tag, &text);
            } else {
                self.skip(len)?;
            }
        }
        Ok(None)
    }

    /// The items of encapsulated pixels: the offset table, then fragments.
    fn fragments(&mut self, c: ElementCoding) -> Result<Pixels, FormatError> {
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
    fn skip_sequence(&mut self, c: ElementCoding) -> Result<(), FormatError> {
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
                (_, UNDEFINED) => open.push(h.nested(c)),
                (_, len) => self.skip(u64::from(len))?,
            }
        }
        Ok(())
    }
}

/// An element in an error.
fn name(h: &ElementHead) -> String {
    format!("element ({:04x},{:04x})", h.tag.0, h.tag.1)
}

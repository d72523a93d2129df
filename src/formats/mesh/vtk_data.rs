//! Numbers as the XML files of VTK hold them: as text, or as bytes, raw or in base64, in one block or
//! in several that are compressed.
//!
//! Bytes begin with words of the file's header type. Without a compressor that is their number; with
//! one it is the number of blocks, the size of a whole block and of the last one (0 where it is
//! whole), and the compressed size of each.

use std::borrow::Cow;
use std::io::{self, Read};
use std::path::Path;
use std::str::SplitAsciiWhitespace;

use flate2::read::ZlibDecoder;

use super::FormatError;
use crate::formats::vol::MAX_SHRINK;

/// A number type of VTK.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum VtkType {
    Signed(usize),
    Unsigned(usize),
    Float32,
    Float64,
}

impl VtkType {
    /// Returns the type with a name; characters of strings are stored as signed bytes.
    pub fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "Int8" | "String" => Self::Signed(1),
            "Int16" => Self::Signed(2),
            "Int32" => Self::Signed(4),
            "Int64" => Self::Signed(8),
            "UInt8" => Self::Unsigned(1),
            "UInt16" => Self::Unsigned(2),
            "UInt32" => Self::Unsigned(4),
            "UInt64" => Self::Unsigned(8),
            "Float32" => Self::Float32,
            "Float64" => Self::Float64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::Signed(n) | Self::Unsigned(n) => n,
            Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }

    /// The value of `size()` bytes; of integers beyond 2^53 the nearest.
    fn value(self, stored: &[u8], big_endian: bool) -> f64 {
        let bits = word(stored, big_endian);
        match self {
            Self::Signed(n) => {
                let unused = 64 - 8 * n as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            Self::Unsigned(_) => bits as f64,
            Self::Float32 => f64::from(f32::from_bits(bits as u32)),
            Self::Float64 => f64::from_bits(bits),
        }
    }
}

/// A word of at most eight bytes.
fn word(stored: &[u8], big_endian: bool) -> u64 {
    let mut b = [0; 8];
    b[..stored.len()].copy_from_slice(stored);
    if big_endian {
        b[..stored.len()].reverse();
    }
    u64::from_le_bytes(b)
}

/// Place of an array's numbers.
#[derive(Clone, Copy)]
pub(super) enum VtkStorage<'a> {
    Text(&'a str),
    /// In base64 within the array's own tag.
    Inline(&'a str),
    /// Place in the appended data.
    AppendedData(u64),
    Other,
}

/// Appended data, from its first byte on.
#[derive(Clone, Copy)]
pub(super) enum AppendedData<'a> {
    Raw(&'a [u8]),
    Base64(&'a [u8]),
}

/// Encoding of all arrays, from the outermost tag.
#[derive(Clone, Copy)]
pub(super) struct VtkEncoding {
    pub big_endian: bool,
    /// Bytes of a header's word.
    pub word_bytes: usize,
    pub is_compressed: bool,
}

/// The content of an array.
pub(super) enum VtkContent<'a> {
    Text(&'a str),
    Bytes(Cow<'a, [u8]>),
}

impl VtkContent<'_> {
    /// Returns the numbers in order.
    pub fn numbers(&self, kind: VtkType, big_endian: bool) -> VtkNumbers<'_> {
        match self {
            Self::Text(text) => VtkNumbers::Text(text.split_ascii_whitespace()),
            Self::Bytes(bytes) => VtkNumbers::Bytes { bytes, kind, big_endian },
        }
    }
}

/// The numbers of an array.
pub(super) enum VtkNumbers<'a> {
    Text(SplitAsciiWhitespace<'a>),
    Bytes { bytes: &'a [u8], kind: VtkType, big_endian: bool },
}

impl Iterator for VtkNumbers<'_> {
    /// `None` inside where a word is no number.
    type Item = Option<f64>;
    fn next(&mut self) -> Option<Option<f64>> {
        match self {
            Self::Text(words) => words.next().map(|w| w.parse().ok()),
            Self::Bytes { bytes, kind, big_endian } => {
                let (head, tail) = bytes.split_at_checked(kind.size())?;
                *bytes = tail;
                Some(Some(kind.value(head, *big_endian)))
            }
        }
    }
}

/// The content of an array, decoded; raw bytes are borrowed.
pub(super) fn content<'a>(
    path: &Path,
    coding: VtkEncoding,
    kind: VtkType,
    stored: VtkStorage<'a>,
    appended: Option<AppendedData<'a>>,
) -> Result<VtkContent<'a>, FormatError> {
    let cut = |found: u64, wanted: u64| FormatError::Truncated {
        file: path.to_owned(),
        what: "a VTK array",
        wanted,
        found,
    };
    let from = |all: &'a [u8], at: u64| {
        let rest = usize::try_from(at).ok().and_then(|at| all.get(at..));
        rest.ok_or_else(|| cut(all.len() as u64, at))
    };
    let bytes = match (stored, appended) {
        (VtkStorage::Text(text), _) => return Ok(VtkContent::Text(text)),
        (VtkStorage::AppendedData(at), Some(AppendedData::Raw(all))) if !coding.is_compressed => {
            let rest = from(all, at)?;
            let start = at.saturating_add(coding.word_bytes as u64);
            let (length, rest) = rest
                .split_at_checked(coding.word_bytes)
                .ok_or_else(|| cut(all.len() as u64, start))?;
            let length = word(length, coding.big_endian);
            let bytes = usize::try_from(length).ok().and_then(|n| rest.get(..n));
            let wanted = start.saturating_add(length);
            Cow::Borrowed(bytes.ok_or_else(|| cut(all.len() as u64, wanted))?)
        }
        (VtkStorage::AppendedData(at), Some(AppendedData::Raw(all))) => {
            let rest = from(all, at)?;
            Cow::Owned(decoded(path, coding, rest, rest.len() as u64)?)
        }
        (VtkStorage::AppendedData(at), Some(AppendedData::Base64(all))) => {
            let rest = from(all, at)?;
            Cow::Owned(decoded(path, coding, Base64::new(rest), rest.len() as u64)?)
        }
        (VtkStorage::Inline(text), _) => {
            let text = text.as_bytes();
            Cow::Owned(decoded(path, coding, Base64::new(text), text.len() as u64)?)
        }
        _ => {
            let what = "this encoding of VTK arrays";
            return Err(FormatError::unsupported(path, what));
        }
    };
    if bytes.len() % kind.size() != 0 {
        let why = "not a whole number of values";
        return Err(FormatError::field(path, "bytes of an array", bytes.len(), why));
    }
    Ok(VtkContent::Bytes(bytes))
}

/// Reads header and blocks; no more memory is taken than what `found` bytes can stand for.
fn decoded(
    path: &Path,
    coding: VtkEncoding,
    mut input: impl Read,
    found: u64,
) -> Result<Vec<u8>, FormatError> {
    let cut = |wanted: u64| FormatError::Truncated {
        file: path.to_owned(),
        what: "a VTK array",
        wanted,
        found,
    };
    let next = |input: &mut dyn Read| {
        let mut b = [0; 8];
        input.read_exact(&mut b[..coding.word_bytes]).map_err(|_| cut(coding.word_bytes as u64))?;
        Ok::<u64, FormatError>(word(&b[..coding.word_bytes], coding.big_endian))
    };
    let mut out = Vec::new();
    if !coding.is_compressed {
        let length = next(&mut input)?;
        if length > found {
            return Err(cut(length));
        }
        out.reserve_exact(length as usize);
        input.take(length).read_to_end(&mut out).map_err(|_| cut(length))?;
        return if out.len() as u64 == length { Ok(out) } else { Err(cut(length)) };
    }
    let (blocks, whole, last) = (next(&mut input)?, next(&mut input)?, next(&mut input)?);
    if blocks > found / coding.word_bytes as u64 {
        return Err(cut(blocks.saturating_mul(coding.word_bytes as u64)));
    }
    let sizes: Vec<u64> = (0..blocks).map(|_| next(&mut input)).collect::<Result<_, _>>()?;
    let damaged = || FormatError::text(path, "a VTK array", "its compressed blocks are damaged");
    for (i, &size) in sizes.iter().enumerate() {
        let wanted = if i + 1 == sizes.len() && last > 0 { last } else { whole };
        if size > found || wanted > size.saturating_mul(MAX_SHRINK) {
            return Err(damaged());
        }
        let before = out.len() as u64;
        // One byte more than there should be, so that a longer block is noticed.
        let mut block = ZlibDecoder::new(input.by_ref().take(size)).take(wanted + 1);
        block.read_to_end(&mut out).map_err(|_| damaged())?;
        let mut rest = block.into_inner().into_inner();
        if out.len() as u64 - before != wanted || io::copy(&mut rest, &mut io::sink()).is_err() {
            return Err(damaged());
        }
    }
    Ok(out)
}

/// Reads base64. What follows padding is a run of its own: VTK pads headers apart from their data.
struct Base64<'a> {
    text: &'a [u8],
    held: [u8; 3],
    /// Range of held bytes that have not been read.
    unread: std::ops::Range<usize>,
}

impl<'a> Base64<'a> {
    fn new(text: &'a [u8]) -> Self {
        Self { text, held: [0; 3], unread: 0..0 }
    }

    /// Decodes the next four characters; `false` at the end.
    fn refill(&mut self) -> io::Result<bool> {
        let (mut bits, mut count, mut padding) = (0u32, 0, 0);
        while count < 4 {
            let Some((&c, rest)) = self.text.split_first() else { break };
            self.text = rest;
            let value = match c {
                b'A'..=b'Z' => c - b'A',
                b'a'..=b'z' => c - b'a' + 26,
                b'0'..=b'9' => c - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                b'=' => {
                    padding += 1;
                    0
                }
                c if c.is_ascii_whitespace() => continue,
                // The end of appended data.
                _ => {
                    self.text = &[];
                    break;
                }
            };
            if padding > 0 && c != b'=' {
                return Err(io::ErrorKind::InvalidData.into());
            }
            bits = bits << 6 | u32::from(value);
            count += 1;
        }
        if count == 0 {
            return Ok(false);
        }
        if count < 4 || padding > 2 {
            return Err(io::ErrorKind::InvalidData.into());
        }
        self.held.copy_from_slice(&bits.to_be_bytes()[1..]);
        self.unread = 0..3 - padding;
        Ok(true)
    }
}

impl Read for Base64<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let mut done = 0;
        while done < buf.len() {
            if self.unread.is_empty() && !self.refill()? {
                break;
            }
            let n = self.unread.len().min(buf.len() - done);
            let from = self.unread.start;
            buf[done..done + n].copy_from_slice(&self.held[from..from + n]);
            self.unread.start += n;
            done += n;
        }
        Ok(done)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(text: &str) -> io::Result<Vec<u8>> {
        let mut out = Vec::new();
        Base64::new(text.as_bytes()).read_to_end(&mut out).map(|_| out)
    }

    #[test]
    fn base64_goes_on_after_padding_and_ends_at_a_tag() {
        assert_eq!(plain("aGVs\n bG8=d29ybGQh").unwrap(), b"helloworld!");
        assert_eq!(plain("YQ==Yg==</AppendedData>").unwrap(), b"ab");
        assert_eq!(plain("").unwrap(), b"");
        for bad in ["YQ", "Y===", "YQ=a"] {
            assert!(plain(bad).is_err(), "{bad}");
        }
    }
}

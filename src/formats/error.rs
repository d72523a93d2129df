//! Errors of the formats room.

use std::borrow::Cow;
use std::fmt;
use std::path::{Path, PathBuf};

use crate::volume::GridError;

/// Value of a header field in an error: words of this program, or numbers that were read as such.
/// It cannot be made of text from a file, which may name a patient.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldValue(Cow<'static, str>);

impl FieldValue {
    /// Several numbers.
    pub(super) fn numbers<N: Into<f64> + Copy>(numbers: &[N]) -> Self {
        let shown: Vec<String> = numbers.iter().map(|&n| n.into().to_string()).collect();
        Self(shown.join(" ").into())
    }

    /// Width and height.
    pub(super) fn size(width: u32, height: u32) -> Self {
        Self(format!("{width}x{height}").into())
    }
}

impl fmt::Display for FieldValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<&'static str> for FieldValue {
    fn from(words: &'static str) -> Self {
        Self(words.into())
    }
}

macro_rules! from_numbers {
    ($($t:ty)*) => {$(
        impl From<$t> for FieldValue {
            fn from(number: $t) -> Self {
                Self(number.to_string().into())
            }
        }
    )*};
}
from_numbers!(u8 i16 u32 i64 u64 usize f32 f64 glam::Vec3 glam::DVec3);

/// A path for a terminal or a log: what would move the cursor, end the line, change colours or turn
/// the direction of the text is written as its escape.
pub fn shown(path: &Path) -> String {
    escaped(&path.to_string_lossy(), is_control)
}

/// Any text for a terminal, its lines kept.
pub fn shown_lines(text: &str) -> String {
    escaped(text, |c| c != '\n' && c != '\t' && is_control(c))
}

fn escaped(text: &str, is_bad: impl Fn(char) -> bool) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if is_bad(c) { out.extend(c.escape_default()) } else { out.push(c) }
    }
    out
}

/// Control characters, line and paragraph separators, and marks of the direction of text.
fn is_control(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Fault of a file, or of reading or writing it. Every message names the file and, where there is
/// one, the field and its value if that is a number. No message holds text of the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The system refused.
    #[error("{}: {source}", shown(.file))]
    Io {
        /// Path of the file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A header field that cannot be right.
    #[error("{}: {field} is `{value}`: {why}", shown(.file))]
    Field {
        /// Path of the file.
        file: PathBuf,
        /// Name of the header field or tag.
        field: String,
        /// Value of the field.
        value: FieldValue,
        /// Fault of the value.
        why: String,
    },
    /// A header field or a place in the file whose text, which is not shown, cannot be right.
    #[error("{}: {field}: {why}", shown(.file))]
    Text {
        /// Path of the file.
        file: PathBuf,
        /// Name of the header field or tag, or the line.
        field: String,
        /// Reason why the text cannot be right.
        why: String,
    },
    /// The data ends before the header says it should.
    #[error("{}: truncated: the header promises {wanted} bytes of {what}, the file holds {found}", shown(.file))]
    Truncated {
        /// Path of the file.
        file: PathBuf,
        /// Name of the data that ends too soon.
        what: &'static str,
        /// Bytes promised.
        wanted: u64,
        /// Bytes found.
        found: u64,
    },
    /// Readable, but not by this version.
    #[error("{}: not supported: {what}", shown(.file))]
    Unsupported {
        /// Path of the file.
        file: PathBuf,
        /// Feature that is not supported.
        what: String,
    },
    /// The geometry is unusable.
    #[error("{}: {source}", shown(.file))]
    Grid {
        /// Path of the file.
        file: PathBuf,
        /// Fault of the geometry.
        source: GridError,
    },
    /// Segments overlap and none is chosen, or the file lacks the chosen one. The names in the file
    /// are its text: `intima info` shows them.
    #[error("{}: {why}", shown(.file))]
    Segments {
        /// Path of the file.
        file: PathBuf,
        /// Reason why the choice is refused.
        why: String,
    },
    /// Several series and none chosen, or the chosen one absent.
    #[error("{}: {why}; choose one with --series:{list}", shown(.file))]
    Series {
        /// Path of the folder or file.
        file: PathBuf,
        /// Reason why the choice is refused.
        why: String,
        /// List of the series, one a line.
        list: String,
    },
}

impl FormatError {
    /// Wraps a system error.
    pub fn io(file: &Path, source: std::io::Error) -> Self {
        Self::Io { file: file.to_owned(), source }
    }
    /// Names a bad header field.
    pub fn field(
        file: &Path,
        field: impl Into<String>,
        value: impl Into<FieldValue>,
        why: impl Into<String>,
    ) -> Self {
        let (field, value) = (field.into(), value.into());
        Self::Field { file: file.to_owned(), field, value, why: why.into() }
    }
    /// Names a header field, or a place in the file, whose text cannot be used.
    pub fn text(file: &Path, field: impl Into<String>, why: impl Into<String>) -> Self {
        Self::Text { file: file.to_owned(), field: field.into(), why: why.into() }
    }
    /// Names something this version does not read or write.
    pub fn unsupported(file: &Path, what: impl Into<String>) -> Self {
        Self::Unsupported { file: file.to_owned(), what: what.into() }
    }
    /// Whether the input is at fault (exit 3) rather than the system (exit 1).
    pub fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Io { source, .. } if source.kind() != std::io::ErrorKind::NotFound)
    }
}

//! The data set of a deflated file (PS3.5 A.5), inflated as it is read: no more of it is held than
//! what is asked for, however large it becomes.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::bufread::DeflateDecoder;

use super::super::super::FormatError;
use super::super::super::layout::MAX_SHRINK;
use super::super::super::source::DataFile;

/// Reads forward only.
pub struct Inflated {
    input: DeflateDecoder<BufReader<DataFile>>,
    at: u64,
    /// Bytes that the file can stand for.
    most: u64,
}

impl Inflated {
    pub fn open(file: &Path, offset: u64) -> Result<Self, FormatError> {
        let source = DataFile::open_at(file, offset)?;
        let most = source.len.saturating_sub(offset).saturating_mul(MAX_SHRINK);
        Ok(Self { input: DeflateDecoder::new(BufReader::new(source)), at: 0, most })
    }

    /// Most bytes that there can be.
    pub fn most(&self) -> u64 {
        self.most
    }

    /// Goes forward to a place.
    ///
    /// # Errors
    /// [`io::ErrorKind::UnexpectedEof`] if it ends before.
    pub fn skip_to(&mut self, place: u64) -> io::Result<()> {
        let count = place.checked_sub(self.at).ok_or(io::ErrorKind::Unsupported)?;
        match io::copy(&mut self.by_ref().take(count), &mut io::sink())? {
            n if n == count => Ok(()),
            _ => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }
}

impl Read for Inflated {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        match self.input.read(buf) {
            Ok(n) => {
                self.at += n as u64;
                Ok(n)
            }
            // The decoder's own complaints, so that no other error is taken for one.
            Err(e) if e.kind() == io::ErrorKind::InvalidInput => {
                Err(io::ErrorKind::InvalidData.into())
            }
            Err(e) => Err(e),
        }
    }
}

impl Seek for Inflated {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::Start(place) => Some(place),
            SeekFrom::End(_) => None,
        };
        self.skip_to(place.ok_or(io::ErrorKind::Unsupported)?)?;
        Ok(self.at)
    }
}

/// Error message for a file that cannot be inflated.
pub fn damaged(file: &Path) -> FormatError {
    let why = "its deflated data set cannot be inflated";
    FormatError::field(file, "data set", "damaged", why)
}

//! Gzip out, in blocks that are compressed side by side: one member, as every reader expects.

use std::io::{self, Write};

use flate2::{Compress, Compression, Crc, FlushCompress};
use rayon::prelude::*;

/// Size of what is compressed by itself, bytes.
const BLOCK: usize = 128 << 10;
/// Size of what is held back until it is compressed, bytes: blocks for eight threads.
const HELD: usize = 8 * BLOCK;
/// Size of what is compressed at once, bytes, where as much comes at once.
const AT_ONCE: usize = 64 * BLOCK;
/// Header of a member (RFC 1952): deflate, no name, no time, fastest, of an unknown system.
const HEADER: [u8; 10] = [0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 4, 255];
/// Last block of deflate (RFC 1951), which is empty.
const LAST: [u8; 2] = [3, 0];

/// Compressed block with the checksum of its bytes.
struct Packed {
    deflated: Vec<u8>,
    crc: Crc,
}

/// Writer that compresses what it is given. The bytes do not depend on the number of threads.
///
/// Blocks of zeros, of which a field about a lumen is made for the most part, are compressed once.
pub(super) struct GzipWriter<W> {
    out: W,
    /// Fewer than [`HELD`] bytes.
    held: Vec<u8>,
    crc: Crc,
    zeros: Packed,
}

impl<W: Write> GzipWriter<W> {
    /// Begins a member.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W) -> io::Result<Self> {
        out.write_all(&HEADER)?;
        // Once, so that it may take its time.
        let zeros = packed(&mut Compress::new(Compression::best(), false), &[0; BLOCK])?;
        Ok(Self { out, held: Vec::new(), crc: Crc::new(), zeros })
    }

    /// Ends the member.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn finish(mut self) -> io::Result<()> {
        let held = std::mem::take(&mut self.held);
        self.put(&held)?;
        self.out.write_all(&LAST)?;
        self.out.write_all(&self.crc.sum().to_le_bytes())?;
        self.out.write_all(&self.crc.amount().to_le_bytes())
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        let one = |compress: &mut Compress, block: &[u8]| {
            let is_zero = block.len() == BLOCK && block.iter().fold(0, |any, b| any | b) == 0;
            if is_zero { Ok(None) } else { packed(compress, block).map(Some) }
        };
        let blocks = bytes.par_chunks(BLOCK).map_init(compressor, one);
        for block in blocks.collect::<io::Result<Vec<_>>>()? {
            let block = block.as_ref().unwrap_or(&self.zeros);
            self.out.write_all(&block.deflated)?;
            self.crc.combine(&block.crc);
        }
        Ok(())
    }
}

impl<W: Write> Write for GzipWriter<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let whole = bytes.len() / HELD * HELD;
        if self.held.is_empty() && whole > 0 {
            bytes[..whole].chunks(AT_ONCE).try_for_each(|part| self.put(part))?;
            return Ok(whole);
        }
        let taken = bytes.len().min(HELD - self.held.len());
        self.held.extend_from_slice(&bytes[..taken]);
        if self.held.len() == HELD {
            let held = std::mem::take(&mut self.held);
            self.put(&held)?;
            self.held = held;
            self.held.clear();
        }
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

fn compressor() -> Compress {
    Compress::new(Compression::fast(), false)
}

/// Compresses a block by itself, to whole bytes, so that any other may follow.
fn packed(compress: &mut Compress, block: &[u8]) -> io::Result<Packed> {
    compress.reset();
    // Fixed codes of nine bits a byte, by which the fastest level writes noise, are the worst.
    let mut deflated = Vec::with_capacity(block.len() + block.len() / 8 + 1024);
    loop {
        let rest = &block[compress.total_in() as usize..];
        let flush = FlushCompress::Sync;
        compress.compress_vec(rest, &mut deflated, flush).map_err(io::Error::other)?;
        // A flush has ended where it leaves room.
        if deflated.len() < deflated.capacity() {
            break;
        }
        deflated.reserve(block.len() / 8 + 1024);
    }
    if compress.total_in() != block.len() as u64 {
        return Err(io::Error::other("a block was not compressed to its end"));
    }
    let mut crc = Crc::new();
    crc.update(block);
    Ok(Packed { deflated, crc })
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::GzDecoder;

    use super::*;

    fn zipped(pieces: &[&[u8]]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut writer = GzipWriter::new(&mut out).unwrap();
        pieces.iter().for_each(|p| writer.write_all(p).unwrap());
        writer.finish().unwrap();
        out
    }

    #[test]
    fn one_member_holds_what_was_written_however_it_came() {
        let noise = |i: usize| {
            let mixed = (i as u64 ^ i as u64 >> 9).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9).to_le_bytes()[6]
        };
        for len in [0, 1, BLOCK - 1, BLOCK, HELD, AT_ONCE + HELD + 3 * BLOCK + 7] {
            // Runs of zeros longer than a block, between noise that cannot be compressed.
            let at = |i: usize| if (i / (3 * BLOCK)).is_multiple_of(2) { noise(i) } else { 0 };
            let bytes: Vec<u8> = (0..len).map(at).collect();
            let whole = zipped(&[&bytes]);
            let pieces: Vec<&[u8]> = bytes.chunks(300_007).collect();
            assert!(zipped(&pieces) == whole, "{len} bytes in pieces");
            let mut back = Vec::new();
            let mut reader = GzDecoder::new(&whole[..]);
            reader.read_to_end(&mut back).unwrap();
            assert!(back == bytes, "{len} bytes");
            assert!(reader.into_inner().is_empty(), "{len} bytes: one member");
        }
    }

    #[test]
    fn zeros_take_less_than_a_five_hundredth() {
        let zeros = vec![0; 40 * BLOCK];
        let len = zipped(&[&zeros]).len();
        assert!(len < zeros.len() / 500, "{len}");
    }
}

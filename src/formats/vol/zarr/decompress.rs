//! Decompression of a chunk of at most so many bytes.

use std::io::{self, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use ruzstd::decoding::FrameDecoder;

/// Error of a decoder for bytes that no encoder writes.
pub(super) fn damaged() -> io::Error {
    io::ErrorKind::InvalidData.into()
}

fn at_most(input: impl Read, limit: usize) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    input.take(limit as u64 + 1).read_to_end(&mut out)?;
    if out.len() > limit { Err(damaged()) } else { Ok(out) }
}

pub(super) fn inflate_gzip(bytes: &[u8], limit: usize) -> io::Result<Vec<u8>> {
    at_most(MultiGzDecoder::new(bytes), limit)
}

pub(super) fn inflate_zlib(bytes: &[u8], limit: usize) -> io::Result<Vec<u8>> {
    at_most(ZlibDecoder::new(bytes), limit)
}

/// The block of an LZ4 stream, of this length.
pub(super) fn lz4_block(bytes: &[u8], len: usize) -> io::Result<Vec<u8>> {
    let mut out = vec![0; len];
    let n = lz4_flex::block::decompress_into(bytes, &mut out).map_err(|_| damaged())?;
    out.truncate(n);
    Ok(out)
}

/// All frames of a Zstandard stream.
pub(super) fn zstd(bytes: &[u8], limit: usize) -> io::Result<Vec<u8>> {
    let mut out = vec![0; limit];
    // A decoder of a stranger's bytes may hold a mistake; it is this chunk's then.
    let decode = || {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(2 * (limit as u64).max(1 << 20));
        decoder.decode_all(bytes, &mut out)
    };
    let n =
        catch_unwind(AssertUnwindSafe(decode)).map_err(|_| damaged())?.map_err(|_| damaged())?;
    out.truncate(n);
    Ok(out)
}

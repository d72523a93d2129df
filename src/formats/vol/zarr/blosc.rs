//! Blosc 1 frames in: the container of numcodecs, with lz4, zstd, zlib and BloscLZ inside.
//!
//! A frame is a header of 16 bytes, the place of each block, and blocks; a block is one stream or,
//! for small types, a stream for each byte of the type. Shuffles gather the bytes or the bits of
//! equal weight (c-blosc, `README_CHUNK_FORMAT.rst`).

use std::io;

use super::decompress::{damaged, inflate_zlib, lz4_block, zstd};

const HEADER: usize = 16;
/// Most bytes of a type whose streams are split, and least samples of a block that are.
const MAX_SPLITS: usize = 16;
const MIN_BUFFER: usize = 128;

/// Bits of the header's flags.
const BYTE_SHUFFLE: u8 = 1;
const STORED: u8 = 2;
const BIT_SHUFFLE: u8 = 4;
const NOT_SPLIT: u8 = 16;

/// The bytes of a frame, at most `limit`.
pub(super) fn decode(frame: &[u8], limit: usize) -> io::Result<Vec<u8>> {
    let head = frame.get(..HEADER).ok_or_else(damaged)?;
    let number = |at: usize| u32_at(head, at).map(|n| n as usize);
    let (flags, type_size) = (head[2], usize::from(head[3]).max(1));
    let (len, block) = (number(4)?, number(8)?);
    if len > limit || number(12)? > frame.len() {
        return Err(damaged());
    }
    if flags & STORED != 0 {
        return Ok(frame.get(HEADER..HEADER + len).ok_or_else(damaged)?.to_vec());
    }
    if len == 0 {
        return Ok(Vec::new());
    }
    if block == 0 || block > len.max(1 << 16) {
        return Err(damaged());
    }
    let starts = frame.get(HEADER..HEADER + 4 * len.div_ceil(block)).ok_or_else(damaged)?;
    let mut out = vec![0u8; len];
    let mut packed = Vec::new();
    for (i, out) in out.chunks_mut(block).enumerate() {
        let start = u32_at(starts, 4 * i)? as usize;
        let streams = frame.get(start..).ok_or_else(damaged)?;
        let is_last_short = out.len() < block;
        let is_split = flags & NOT_SPLIT == 0
            && !is_last_short
            && type_size <= MAX_SPLITS
            && out.len() / type_size >= MIN_BUFFER;
        let count = if is_split { type_size } else { 1 };
        packed.resize(out.len(), 0);
        unpack_streams(streams, flags >> 5, count, &mut packed)?;
        match () {
            () if flags & BYTE_SHUFFLE != 0 && type_size > 1 => unshuffle(&packed, type_size, out),
            () if flags & BIT_SHUFFLE != 0 => unshuffle_bits(&packed, type_size, out),
            () => out.copy_from_slice(&packed),
        }
    }
    Ok(out)
}

fn u32_at(bytes: &[u8], at: usize) -> io::Result<u32> {
    let four = bytes.get(at..at + 4).ok_or_else(damaged)?;
    Ok(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
}

/// Fills `out` from streams of equal length, each behind its compressed size.
fn unpack_streams(mut from: &[u8], kind: u8, count: usize, out: &mut [u8]) -> io::Result<()> {
    let each = out.len() / count;
    if each * count != out.len() {
        return Err(damaged());
    }
    for out in out.chunks_exact_mut(each) {
        let size = u32_at(from, 0)? as usize;
        let stream = from.get(4..4 + size).ok_or_else(damaged)?;
        from = &from[4 + size..];
        if size == each {
            out.copy_from_slice(stream); // what did not shrink is stored
            continue;
        }
        let unpacked = match kind {
            0 => blosclz(stream, each)?,
            1 => lz4_block(stream, each)?,
            3 => inflate_zlib(stream, each)?,
            4 => zstd(stream, each)?,
            _ => return Err(io::Error::new(io::ErrorKind::Unsupported, "snappy in blosc")),
        };
        if unpacked.len() != each {
            return Err(damaged());
        }
        out.copy_from_slice(&unpacked);
    }
    Ok(())
}

/// Bytes of equal weight stand together: byte b of element e is at `b · elements + e`. What is less
/// than an element at the end stays.
fn unshuffle(from: &[u8], size: usize, out: &mut [u8]) {
    let elements = from.len() / size;
    for (b, plane) in from.chunks_exact(elements.max(1)).take(size).enumerate() {
        for (e, byte) in plane.iter().enumerate() {
            out[e * size + b] = *byte;
        }
    }
    let rest = elements * size;
    out[rest..].copy_from_slice(&from[rest..]);
}

/// Bits of equal weight stand together, of eight elements a byte; a block whose elements are no
/// multiple of eight stays as it is.
fn unshuffle_bits(from: &[u8], size: usize, out: &mut [u8]) {
    let elements = from.len() / size;
    if !elements.is_multiple_of(8) {
        out.copy_from_slice(from);
        return;
    }
    let (whole, row) = (elements * size, elements / 8);
    out[whole..].copy_from_slice(&from[whole..]);
    out[..whole].fill(0);
    for bit in 0..8 * size {
        for (group, byte) in from[bit * row..][..row].iter().enumerate() {
            for k in 0..8 {
                out[(8 * group + k) * size + bit / 8] |= (byte >> k & 1) << (bit % 8);
            }
        }
    }
}

/// BloscLZ: literals and matches as in FastLZ, with two ranges of distances (c-blosc, `blosclz.c`).
fn blosclz(from: &[u8], len: usize) -> io::Result<Vec<u8>> {
    /// Distances up to here are in the token, farther ones behind it.
    const NEAR: usize = 8191;
    let mut out = Vec::with_capacity(len);
    let mut bytes = from.iter().copied();
    let mut next = || bytes.next().ok_or_else(damaged);
    // The first token is a literal run, whatever its upper bits say.
    let mut token = usize::from(next()? & 31);
    loop {
        if token >= 32 {
            let mut match_len = (token >> 5) - 1;
            let mut distance = (token & 31) << 8;
            if match_len == 6 {
                loop {
                    let more = next()?;
                    match_len += usize::from(more);
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = next()?;
            distance += usize::from(low);
            if low == 255 && distance == NEAR {
                distance = NEAR + (usize::from(next()?) << 8) + usize::from(next()?);
            }
            let (n, back) = (match_len + 3, distance + 1);
            if back > out.len() || n > len - out.len() {
                return Err(damaged());
            }
            for _ in 0..n {
                out.push(out[out.len() - back]);
            }
        } else {
            if token + 1 > len - out.len() {
                return Err(damaged());
            }
            for _ in 0..=token {
                out.push(next()?);
            }
        }
        match next() {
            Ok(byte) => token = usize::from(byte),
            Err(_) => return Ok(out),
        }
    }
}

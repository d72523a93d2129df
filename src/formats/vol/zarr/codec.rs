//! Codecs of bytes in a Zarr chunk. Each gives at most as many bytes as it is told; what it would
//! give beyond that is refused, so that a chunk takes no more memory than its shape says.

use std::io;

use super::blosc;
use super::decompress::{damaged, inflate_gzip, inflate_zlib, lz4_block, zstd};

/// A codec from bytes to bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ByteCodec {
    Gzip,
    Zlib,
    Zstd,
    Blosc,
    /// A block of LZ4 behind its size (numcodecs).
    Lz4,
    /// CRC-32C behind the bytes.
    Crc32c,
}

/// Bytes that codecs may add to data that does not shrink.
const OVERHEAD: usize = 1 << 12;

impl ByteCodec {
    /// Undoes codecs, the last one first: exactly `len` bytes.
    pub fn decode_all(codecs: &[Self], bytes: Vec<u8>, len: usize) -> io::Result<Vec<u8>> {
        let mut bytes = bytes;
        for (i, codec) in codecs.iter().enumerate().rev() {
            let limit = if i == 0 { len } else { len + len / 64 + OVERHEAD };
            bytes = codec.decode(bytes, limit)?;
        }
        if bytes.len() == len { Ok(bytes) } else { Err(damaged()) }
    }

    fn decode(self, mut bytes: Vec<u8>, limit: usize) -> io::Result<Vec<u8>> {
        match self {
            Self::Gzip => inflate_gzip(&bytes, limit),
            Self::Zlib => inflate_zlib(&bytes, limit),
            Self::Zstd => zstd(&bytes, limit),
            Self::Blosc => blosc::decode(&bytes, limit),
            Self::Lz4 => {
                let (size, block) = bytes.split_at_checked(4).ok_or_else(damaged)?;
                let size = u32::from_le_bytes([size[0], size[1], size[2], size[3]]) as usize;
                if size > limit { Err(damaged()) } else { lz4_block(block, size) }
            }
            Self::Crc32c => {
                let at = bytes.len().checked_sub(4).ok_or_else(damaged)?;
                let stored = bytes.split_off(at);
                if stored == crc32c(&bytes).to_le_bytes() { Ok(bytes) } else { Err(damaged()) }
            }
        }
    }
}

/// CRC-32C (Castagnoli), reflected polynomial 0x82f63b78 (RFC 3720, appendix B.4).
fn crc32c(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let (mut table, mut i) = ([0u32; 256], 0);
        while i < 256 {
            let (mut crc, mut bit) = (i as u32, 0);
            while bit < 8 {
                crc = if crc & 1 != 0 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 };
                bit += 1;
            }
            table[i] = crc;
            i += 1;
        }
        table
    };
    !bytes.iter().fold(!0, |crc: u32, b| crc >> 8 ^ TABLE[usize::from(crc as u8 ^ b)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_castagnolis() {
        // RFC 3720, appendix B.4: 32 bytes of zeros, and of ones.
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa);
        assert_eq!(crc32c(&[0xff; 32]), 0x62a8_ab43);
    }

    #[test]
    fn a_stream_of_more_bytes_than_its_chunk_has_is_refused() {
        // A frame of one block that repeats a byte 1,000,000 times would be cut at the limit.
        let frame = [0x28, 0xb5, 0x2f, 0xfd, 0xa4, 0x40, 0x42, 0x0f, 0, 3, 0, 16, 7];
        assert!(ByteCodec::decode_all(&[ByteCodec::Zstd], frame.to_vec(), 100).is_err());
    }
}

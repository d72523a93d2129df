//! Compressed frames into stored samples, by well-kept decoders.
//!
//! A frame may be hostile. Its own header is read here first and held against what the file says
//! of it, because two of the decoders take memory for whatever size the stream claims; then it is
//! decoded where a panic is caught, and what came out is counted again.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::jpeg_scan::{Process, check_complete};
use super::syntax::Codec;

/// Most pixels of a compressed frame, 8192 a side: beyond those of any scanner, and what a few bytes
/// of JPEG 2000 may claim in full earnest, each taking four bytes and more to decode.
const MAX_PIXELS: u64 = 1 << 26;
/// Most tiles of a JPEG 2000 codestream.
const MAX_TILES: u64 = 65_535;

/// Size of a frame as the file gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FrameSize {
    pub rows: u32,
    pub columns: u32,
    /// Bits allocated a pixel: 8, 16 or 32.
    pub bits_allocated: u32,
}

impl FrameSize {
    fn pixels(self) -> usize {
        self.rows as usize * self.columns as usize
    }
}

/// The feature of this crate that a frame's decoder needs and this build lacks.
pub(super) fn missing_feature(codec: Codec, bytes: &[u8]) -> Option<&'static str> {
    match codec {
        Codec::Jpeg if !cfg!(feature = "jpeg-12") => {
            jpeg_frame(bytes).filter(JpegFrame::is_12_bit).map(|_| "jpeg-12")
        }
        _ => None,
    }
}

/// Holds the pixels that a file says a frame has against what a stream of `len` bytes can stand
/// for, before memory is taken for them.
///
/// # Errors
/// The fault of a stream.
pub(super) fn check_claim(codec: Codec, [columns, rows]: [u32; 2], len: u64) -> Result<(), String> {
    let pixels = u64::from(columns) * u64::from(rows);
    if pixels > MAX_PIXELS {
        return Err(format!("{columns}x{rows} compressed pixels; {MAX_PIXELS} at most are read"));
    }
    let least = match codec {
        // Two bytes repeat one at most 128 times.
        Codec::Rle => pixels / 64,
        // A block of 64 pixels has two codes, a pixel of a lossless stream one.
        Codec::Jpeg => pixels / 256,
        // A line has a code at least.
        Codec::JpegLs => u64::from(rows) / 8,
        // Equal pixels take none.
        Codec::Jpeg2000 => 0,
    };
    if len < least {
        return Err(format!("{len} bytes for {columns}x{rows} pixels"));
    }
    Ok(())
}

/// Memory that a frame takes while it is decoded, bytes a pixel, its number of four bytes among
/// them. Measured on frames of 2048 x 2048 pixels; of JPEG what its decoder keeps.
pub(super) fn bytes_a_pixel(codec: Codec) -> u64 {
    match codec {
        Codec::Rle => 4,
        Codec::Jpeg | Codec::JpegLs => 6,
        Codec::Jpeg2000 => 9,
    }
}

/// Decodes a frame: one number a pixel, of which the lowest bits count.
///
/// # Errors
/// The fault of the stream.
pub(super) fn decode(codec: Codec, bytes: &[u8], size: FrameSize) -> Result<Vec<i32>, String> {
    check_claim(codec, [size.columns, size.rows], bytes.len() as u64)?;
    let decoded = catch_unwind(AssertUnwindSafe(|| match codec {
        Codec::Rle => rle(bytes, size),
        Codec::Jpeg => jpeg(bytes, size),
        Codec::JpegLs => jpeg_ls(bytes, size),
        Codec::Jpeg2000 => jpeg_2000(bytes, size),
    }));
    let samples = decoded.unwrap_or_else(|_| Err("its decoder gave up".into()))?;
    if samples.len() != size.pixels() {
        return Err(format!("{} samples for {} pixels", samples.len(), size.pixels()));
    }
    Ok(samples)
}

/// Byte planes, the highest first, each run-length encoded (PS3.5 annex G).
fn rle(bytes: &[u8], size: FrameSize) -> Result<Vec<i32>, String> {
    let word = |i: usize| -> Option<usize> {
        let four = bytes.get(4 * i..4 * i + 4)?;
        usize::try_from(u32::from_le_bytes(four.try_into().ok()?)).ok()
    };
    let planes = (size.bits_allocated / 8) as usize;
    if word(0) != Some(planes) {
        return Err(format!("it has no {planes} segments"));
    }
    let mut samples = vec![0i32; size.pixels()];
    for plane in 0..planes {
        let start = word(1 + plane).filter(|s| *s >= 64).ok_or("a segment without a place")?;
        let next = (1..=planes).filter_map(word).filter(|s| *s > start).min();
        let end = next.unwrap_or(bytes.len()).min(bytes.len());
        let segment = bytes.get(start..end).ok_or("a segment begins past the end")?;
        unpack(segment, &mut samples).ok_or("a segment ends too soon")?;
    }
    Ok(samples)
}

/// Shifts one plane into the samples; `None` where it ends too soon. Padding behind it is not looked
/// at: a segment has an even length.
fn unpack(segment: &[u8], samples: &mut [i32]) -> Option<()> {
    let mut input = segment.iter();
    let mut left = samples.iter_mut();
    // A run may be longer than what is left.
    let put = |left: &mut std::slice::IterMut<'_, i32>, value: u8| {
        if let Some(s) = left.next() {
            *s = *s << 8 | i32::from(value);
        }
    };
    while left.len() > 0 {
        match *input.next()? as i8 {
            n @ 0..=127 => {
                for _ in 0..=n {
                    put(&mut left, *input.next()?);
                }
            }
            -128 => {}
            n => {
                let value = *input.next()?;
                (0..=-i32::from(n)).for_each(|_| put(&mut left, value));
            }
        }
    }
    Some(())
}

/// The frame header of a JPEG or JPEG-LS stream.
#[derive(Clone, Copy, Debug, PartialEq)]
struct JpegFrame {
    /// Lower byte of its marker.
    marker: u8,
    precision: u8,
    rows: u32,
    columns: u32,
    components: u8,
}

impl JpegFrame {
    /// JPEG of the extended process with twelve bits.
    fn is_12_bit(&self) -> bool {
        self.precision == 12 && self.marker == 0xc1
    }
}

/// Finds the frame header (ITU-T T.81 B.2.2; T.87 C.2.2).
fn jpeg_frame(bytes: &[u8]) -> Option<JpegFrame> {
    let mut at = 2;
    if bytes.get(..2)? != [0xff, 0xd8] {
        return None;
    }
    loop {
        if *bytes.get(at)? != 0xff {
            return None;
        }
        let marker = *bytes.get(at + 1)?;
        if marker == 0xff {
            at += 1;
            continue;
        }
        let body = bytes.get(at + 2..)?;
        let u16_at = |i: usize| -> Option<u32> {
            Some(u32::from(*body.get(i)?) << 8 | u32::from(*body.get(i + 1)?))
        };
        let is_frame = matches!(marker, 0xc0..=0xcf if ![0xc4, 0xc8, 0xcc].contains(&marker));
        if is_frame || marker == 0xf7 {
            let (rows, columns) = (u16_at(3)?, u16_at(5)?);
            let (precision, components) = (*body.get(2)?, *body.get(7)?);
            return Some(JpegFrame { marker, precision, rows, columns, components });
        }
        // A scan before its frame.
        if marker == 0xda || marker == 0xd9 {
            return None;
        }
        at += 2 + u16_at(0)? as usize;
    }
}

/// A frame header that agrees with the file.
fn agreeing(bytes: &[u8], size: FrameSize) -> Result<JpegFrame, String> {
    let frame = jpeg_frame(bytes).ok_or("no frame header")?;
    agrees(
        [frame.columns, frame.rows, u32::from(frame.components), u32::from(frame.precision)],
        size,
    )?;
    Ok(frame)
}

fn agrees([columns, rows, components, bits]: [u32; 4], size: FrameSize) -> Result<(), String> {
    if (columns, rows, components) != (size.columns, size.rows, 1) {
        return Err(format!(
            "its stream is of {columns}x{rows} pixels in {components} components, the file of \
             {}x{} in 1",
            size.columns, size.rows
        ));
    }
    if !(1..=size.bits_allocated).contains(&bits) {
        return Err(format!("{bits} bits a sample in {} allocated", size.bits_allocated));
    }
    Ok(())
}

fn jpeg(bytes: &[u8], size: FrameSize) -> Result<Vec<i32>, String> {
    let frame = agreeing(bytes, size)?;
    // Those of the syntaxes that are read: baseline, extended, lossless.
    let process = match frame.marker {
        0xc0 | 0xc1 => Some(Process::Sequential),
        0xc3 => Some(Process::Lossless),
        _ => None,
    };
    if let Some(process) = process {
        check_complete(bytes, process, [size.columns, size.rows])?;
    }
    if frame.marker == 0xc3 || (frame.precision == 8 && process.is_some()) {
        let mut decoder = jpeg_decoder::Decoder::new(bytes);
        decoder.set_max_decoding_buffer_size(8 * size.pixels() + (1 << 20));
        let out = decoder.decode().map_err(|e| e.to_string())?;
        return match decoder.info().map(|i| i.pixel_format) {
            Some(jpeg_decoder::PixelFormat::L8) => Ok(out.into_iter().map(i32::from).collect()),
            Some(jpeg_decoder::PixelFormat::L16) => {
                let two = |b: &[u8]| i32::from(u16::from_ne_bytes([b[0], b[1]]));
                Ok(out.chunks_exact(2).map(two).collect())
            }
            _ => Err("not one component".into()),
        };
    }
    #[cfg(feature = "jpeg-12")]
    if frame.is_12_bit() {
        use libjpeg_turbo_rs::DecodeLimits;
        let limits = DecodeLimits {
            max_width: size.columns as usize,
            max_height: size.rows as usize,
            max_pixels: size.pixels() as u64,
            max_scans: 64,
            max_memory: Some(64 * size.pixels() as u64 + (1 << 20)),
        };
        let image = libjpeg_turbo_rs::decompress_12bit_with_limits(bytes, &limits)
            .map_err(|e| e.to_string())?;
        return Ok(image.data.into_iter().map(i32::from).collect());
    }
    let kind = frame.marker & 0x0f;
    Err(format!("JPEG process {kind} with {} bits is not supported", frame.precision))
}

fn jpeg_ls(bytes: &[u8], size: FrameSize) -> Result<Vec<i32>, String> {
    let frame = agreeing(bytes, size)?;
    if frame.marker != 0xf7 || size.bits_allocated > 16 {
        return Err("no JPEG-LS frame of 16 bits at most".into());
    }
    let decode = |bytes: &[u8]| {
        let decoded = jpegls::decode(bytes, size.columns, size.rows);
        decoded.map(|(samples, ..)| samples).map_err(|e| e.to_string())
    };
    // A zero byte may stand between the last scan and the end marker; the decoder takes none there.
    let samples = decode(bytes).or_else(|why| decode(&without_zero(bytes).ok_or(why)?))?;
    Ok(samples.into_iter().map(i32::from).collect())
}

/// A JPEG-LS stream without the zero byte before its end marker, where it has one.
fn without_zero(bytes: &[u8]) -> Option<Vec<u8>> {
    let end = bytes.windows(2).rposition(|two| two == [0xff, 0xd9])?;
    let body = bytes[..end].strip_suffix(&[0])?;
    Some([body, &bytes[end..]].concat())
}

/// Holds the SIZ marker of a codestream against the file (ISO/IEC 15444-1 A.5.1).
fn check_siz(bytes: &[u8], size: FrameSize) -> Result<(), String> {
    let none = "no size marker";
    let siz = bytes.get(..6).ok_or(none)?;
    if siz[..4] != [0xff, 0x4f, 0xff, 0x51] {
        return Err(none.into());
    }
    let body = bytes.get(4..).ok_or(none)?;
    let u32_at = |i: usize| -> Option<u64> {
        Some(u64::from(u32::from_be_bytes(body.get(i..i + 4)?.try_into().ok()?)))
    };
    // Extent, offset, and the same of a tile.
    let numbers: Option<Vec<u64>> = (0..8).map(|k| u32_at(4 + 4 * k)).collect();
    let n = numbers.ok_or(none)?;
    let components = body.get(36..38).map(|b| u32::from(b[0]) << 8 | u32::from(b[1]));
    let bits = body.get(38).map(|b| u32::from(b & 0x7f) + 1);
    let side = |k: usize| u32::try_from(n[k].saturating_sub(n[k + 2])).unwrap_or(u32::MAX);
    let (Some(components), Some(bits)) = (components, bits) else { return Err(none.into()) };
    agrees([side(0), side(1), components, bits], size)?;
    if n[4] == 0 || n[5] == 0 {
        return Err("tiles without pixels".into());
    }
    let tiles = n[0].div_ceil(n[4]).saturating_mul(n[1].div_ceil(n[5]));
    if tiles > MAX_TILES { Err(format!("{tiles} tiles")) } else { Ok(()) }
}

fn jpeg_2000(bytes: &[u8], size: FrameSize) -> Result<Vec<i32>, String> {
    check_siz(bytes, size)?;
    let parameters = jpeg2k::DecodeParameters::new().strict(true);
    let image = jpeg2k::Image::from_bytes_with(bytes, parameters).map_err(|e| e.to_string())?;
    match image.components() {
        [one] if (one.width(), one.height()) == (size.columns, size.rows) => {
            Ok(one.data().to_vec())
        }
        _ => Err("its stream came out in another size".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(columns: u32, rows: u32, bits_allocated: u32) -> FrameSize {
        FrameSize { rows, columns, bits_allocated }
    }

    /// An RLE frame of segments.
    fn frame(segments: &[&[u8]]) -> Vec<u8> {
        let mut header = [0u32; 16];
        header[0] = segments.len() as u32;
        let mut at = 64;
        for (i, s) in segments.iter().enumerate() {
            header[1 + i] = at;
            at += s.len() as u32;
        }
        let words = header.iter().flat_map(|w| w.to_le_bytes());
        words.chain(segments.iter().flat_map(|s| s.iter().copied())).collect()
    }

    #[test]
    fn run_length_planes_are_put_together_highest_byte_first() {
        // Four times 1; then a literal of 2, 3 and twice 4, with a control of no meaning.
        let bytes = frame(&[&[0xfd, 1], &[1, 2, 3, 0x80, 0xff, 4]]);
        let got = decode(Codec::Rle, &bytes, size(2, 2, 16)).unwrap();
        assert_eq!(got, [0x102, 0x103, 0x104, 0x104]);
    }

    /// A byte of padding was read as a run of the next segment, and its end found missing.
    #[test]
    fn padding_behind_a_run_length_segment_is_no_run() {
        let bytes = frame(&[&[0xfd, 1, 0, 0], &[2, 7, 8, 9, 0, 5]]);
        let got = decode(Codec::Rle, &bytes, size(2, 2, 16)).unwrap();
        assert_eq!(got, [0x107, 0x108, 0x109, 0x105]);
        let bytes = frame(&[&[1, 6, 7, 0], &[0xff, 9]]);
        assert_eq!(decode(Codec::Rle, &bytes, size(2, 1, 16)).unwrap(), [0x609, 0x709]);
        // A plane that is cut short is not completed by the next.
        assert!(decode(Codec::Rle, &frame(&[&[0, 6], &[0xff, 9]]), size(2, 1, 16)).is_err());
    }

    #[test]
    fn damaged_run_lengths_are_refused() {
        let good = frame(&[&[3, 1, 2, 3, 4]]);
        assert_eq!(decode(Codec::Rle, &good, size(2, 2, 8)).unwrap(), [1, 2, 3, 4]);
        for bad in [frame(&[&[3, 1, 2]]), frame(&[&[0xff, 9]]), good[..63].to_vec(), Vec::new()] {
            assert!(decode(Codec::Rle, &bad, size(2, 2, 8)).is_err());
        }
        let mut far = good.clone();
        far[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(decode(Codec::Rle, &far, size(2, 2, 8)).is_err());
        assert!(decode(Codec::Rle, &good, size(2, 2, 16)).is_err(), "planes are missing");
    }

    #[test]
    fn a_stream_of_another_size_than_its_file_says_is_not_decoded() {
        let mut jpeg = vec![0xff, 0xd8, 0xff, 0xe0, 0, 4, 1, 2, 0xff, 0xc3, 0, 11];
        jpeg.extend([16, 0x40, 0, 0x40, 0, 1, 1, 0x11, 0]);
        let frame = jpeg_frame(&jpeg).unwrap();
        assert_eq!((frame.rows, frame.columns, frame.precision), (0x4000, 0x4000, 16));
        let e = decode(Codec::Jpeg, &jpeg, size(2, 2, 16)).unwrap_err();
        assert!(e.contains("16384x16384"), "{e}");
        assert!(decode(Codec::JpegLs, &jpeg, size(2, 2, 16)).is_err());
        let mut j2k = vec![0xff, 0x4f, 0xff, 0x51, 0, 41, 0, 0];
        let words = [1u32 << 13, 1 << 13, 0, 0, 1, 1, 0, 0];
        j2k.extend(words.iter().flat_map(|w| w.to_be_bytes()));
        j2k.extend([0, 1, 15, 1, 1]);
        let e = decode(Codec::Jpeg2000, &j2k, size(2, 2, 16)).unwrap_err();
        assert!(e.contains("8192x8192"), "{e}");
        let e = decode(Codec::Jpeg2000, &j2k, size(1 << 13, 1 << 13, 16)).unwrap_err();
        assert!(e.contains("tiles"), "{e}");
        for codec in [Codec::Jpeg, Codec::JpegLs, Codec::Jpeg2000] {
            assert!(decode(codec, &[], size(2, 2, 16)).is_err());
            assert!(decode(codec, &[0xff; 40], size(2, 2, 16)).is_err());
        }
    }

    /// Numbers that look random.
    fn noise(seed: &mut u64) -> u32 {
        *seed =
            seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 33) as u32
    }

    #[test]
    fn damaged_streams_are_refused_or_decoded_and_nothing_else_happens() {
        let mut seed = 3;
        let pixels: Vec<u16> = (0..32 * 24)
            .map(|i| (i % 32 * 100 + noise(&mut seed) as i32 % 40) as u16 & 0xfff)
            .collect();
        let mut ls = Vec::new();
        jpegls::encode(&pixels, 32, 24, &mut ls).unwrap();
        let wanted: Vec<i32> = pixels.iter().map(|p| i32::from(*p)).collect();
        assert_eq!(decode(Codec::JpegLs, &ls, size(32, 24, 16)).unwrap(), wanted);
        let planes: Vec<Vec<u8>> = [8, 0]
            .iter()
            .map(|s| {
                let plane: Vec<u8> = pixels.iter().map(|p| (p >> s) as u8).collect();
                plane.chunks(128).flat_map(|c| [&[c.len() as u8 - 1], c].concat()).collect()
            })
            .collect();
        let rle = frame(&[&planes[0], &planes[1]]);
        assert_eq!(decode(Codec::Rle, &rle, size(32, 24, 16)).unwrap(), wanted);
        for (codec, stream) in [(Codec::JpegLs, &ls), (Codec::Rle, &rle)] {
            let mut same = 0;
            for _ in 0..400 {
                let mut bad = stream.clone();
                for _ in 0..1 + noise(&mut seed) % 4 {
                    let at = noise(&mut seed) as usize % bad.len();
                    bad[at] = noise(&mut seed) as u8;
                }
                if noise(&mut seed).is_multiple_of(2) {
                    bad.truncate(1 + noise(&mut seed) as usize % bad.len());
                }
                match decode(codec, &bad, size(32, 24, 16)) {
                    Ok(got) => {
                        assert_eq!(got.len(), wanted.len());
                        same += usize::from(got == wanted);
                    }
                    Err(why) => assert!(!why.is_empty()),
                }
            }
            assert!(same < 40, "{codec:?}: {same} came out whole");
        }
    }
}

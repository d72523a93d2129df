//! Transfer syntaxes by UID.

pub(super) const IMPLICIT_LITTLE: &str = "1.2.840.10008.1.2";
pub(super) const EXPLICIT_LITTLE: &str = "1.2.840.10008.1.2.1";
pub(super) const EXPLICIT_BIG: &str = "1.2.840.10008.1.2.2";
pub(super) const DEFLATED: &str = "1.2.840.10008.1.2.1.99";

/// A way of compressing frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Codec {
    /// Run lengths of byte planes.
    Rle,
    /// Baseline, extended and lossless JPEG.
    Jpeg,
    /// JPEG-LS, near-lossless too.
    JpegLs,
    /// JPEG 2000, High-Throughput too.
    Jpeg2000,
}

impl Codec {
    /// Returns the codec of a syntax; `None` where pixels are plain or no decoder is known.
    pub fn of(uid: &str) -> Option<Self> {
        match uid.strip_prefix("1.2.840.10008.1.2.")? {
            "5" => Some(Self::Rle),
            "4.50" | "4.51" | "4.57" | "4.70" => Some(Self::Jpeg),
            "4.80" | "4.81" => Some(Self::JpegLs),
            "4.90" | "4.91" | "4.201" | "4.202" | "4.203" => Some(Self::Jpeg2000),
            _ => None,
        }
    }
}

/// Whether the pixels of this syntax are stored plainly.
pub(super) fn is_plain(uid: &str) -> bool {
    [IMPLICIT_LITTLE, EXPLICIT_LITTLE, EXPLICIT_BIG, DEFLATED].contains(&uid)
}

/// The name of a syntax we do not read, with its UID where DICOM has assigned it.
pub(super) fn describe(uid: &str) -> String {
    let assigned = uid.starts_with("1.2.840.10008.") && uid.len() <= 64;
    let shown = if assigned { format!(" ({uid})") } else { String::new() };
    format!("{}{shown}", name(uid))
}

fn name(uid: &str) -> &'static str {
    match uid.strip_prefix("1.2.840.10008.1.2.") {
        Some("1.99") => "Deflated Explicit VR Little Endian",
        Some("4.50") => "JPEG Baseline",
        Some("4.51") => "JPEG Extended",
        Some("4.53") => "JPEG Spectral Selection",
        Some("4.55") => "JPEG Full Progression",
        Some("4.57") => "JPEG Lossless",
        Some("4.70") => "JPEG Lossless SV1",
        Some("4.80") => "JPEG-LS Lossless",
        Some("4.81") => "JPEG-LS Near-lossless",
        Some("4.90") => "JPEG 2000 Lossless",
        Some("4.91") => "JPEG 2000",
        Some("4.100" | "4.101") => "MPEG-2",
        Some("4.102" | "4.103" | "4.104" | "4.105" | "4.106") => "MPEG-4",
        Some("4.110") => "JPEG XL Lossless",
        Some("4.111" | "4.112") => "JPEG XL",
        Some("4.201" | "4.202" | "4.203") => "High-Throughput JPEG 2000",
        Some("5") => "RLE Lossless",
        Some("8.1") => "Deflated Image Frame Compression",
        _ => "unknown",
    }
}

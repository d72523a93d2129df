//! Description of a segment that is written: its name, colour and code.

/// Description of a written segment in words and codes that other programs know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentDescription {
    /// Name of the segment: one line of ASCII, at most 64 characters.
    pub name: &'static str,
    /// Colour in which it is shown, sRGB.
    pub rgb: [u8; 3],
    /// Structure that it shows.
    pub kind: SnomedCode,
    /// Whether nobody chose a threshold, a seed or a label.
    pub is_automatic: bool,
}

/// A code of SNOMED CT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SnomedCode {
    /// The code.
    pub value: &'static str,
    /// Meaning of the code in English.
    pub meaning: &'static str,
}

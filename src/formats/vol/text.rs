//! Fields and numbers in text headers.

use std::path::Path;
use std::str::FromStr;

use super::FormatError;

/// No header of an image is longer, in bytes; it bounds what is read to find its end.
pub(super) const MAX_HEADER: u64 = 1 << 20;

/// No field that is read is longer, in bytes; the longest hold 16 vectors.
const MAX_VALUE: usize = 1 << 16;

/// The value of a field without the blanks around it.
pub(super) fn field_value(file: &Path, field: &str, value: &str) -> Result<String, FormatError> {
    let value = value.trim();
    if value.len() > MAX_VALUE {
        let why = format!("{} bytes long; at most {MAX_VALUE} are read", value.len());
        return Err(FormatError::text(file, field, why));
    }
    Ok(value.to_owned())
}

/// Blank-separated numbers, exactly `n` of them.
pub(super) fn numbers<T: FromStr>(
    file: &Path,
    field: &str,
    value: &str,
    n: usize,
) -> Result<Vec<T>, FormatError> {
    let parsed: Result<Vec<T>, _> = value.split_whitespace().take(n + 1).map(str::parse).collect();
    match parsed {
        Ok(v) if v.len() == n => Ok(v),
        _ => Err(FormatError::text(file, field, format!("expected {n} numbers"))),
    }
}

/// One number.
pub(super) fn number<T: FromStr>(file: &Path, field: &str, value: &str) -> Result<T, FormatError> {
    let bad = |_| FormatError::text(file, field, "expected one number");
    value.trim().parse().map_err(bad)
}

/// Millimetres in one unit of a name, if the name is a length we know.
pub(super) fn mm_per(unit: &str) -> Option<f64> {
    match unit.trim().trim_matches('"').to_ascii_lowercase().as_str() {
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Some(1.0),
        "cm" | "centimeter" | "centimeters" => Some(10.0),
        "m" | "meter" | "meters" | "metre" | "metres" => Some(1000.0),
        "nm" | "nanometer" | "nanometers" | "nanometre" | "nanometres" => Some(1e-6),
        "um" | "µm" | "μm" | "micron" | "microns" | "micrometer" | "micrometers" | "micrometre"
        | "micrometres" => Some(1e-3),
        _ => None,
    }
}

//! JSON out. Zeros are written without a sign: -0.0 is equal to 0.0, and readers that compare text
//! or show it take the two for different.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter, PrettyFormatter};

/// A value as JSON in one line.
///
/// # Errors
/// As [`serde_json::to_string`].
pub fn to_json(value: &impl Serialize) -> serde_json::Result<String> {
    written(value, CompactFormatter)
}

/// A value as JSON, indented.
///
/// # Errors
/// As [`serde_json::to_string_pretty`].
pub fn to_pretty_json(value: &impl Serialize) -> serde_json::Result<String> {
    written(value, PrettyFormatter::new())
}

fn written(value: &impl Serialize, layout: impl Formatter) -> serde_json::Result<String> {
    let mut out = Vec::new();
    value.serialize(&mut serde_json::Serializer::with_formatter(&mut out, PlainZeros(layout)))?;
    Ok(String::from_utf8(out).expect("JSON is text"))
}

/// A layout with zeros of one kind.
struct PlainZeros<F>(F);

macro_rules! as_laid_out {
    ($($name:ident($($arg:ident: $kind:ty),*))*) => {$(
        fn $name<W: ?Sized + Write>(&mut self, out: &mut W, $($arg: $kind),*) -> io::Result<()> {
            self.0.$name(out, $($arg),*)
        }
    )*};
}

impl<F: Formatter> Formatter for PlainZeros<F> {
    // The sum of a zero of either sign and 0 is 0.
    fn write_f32<W: ?Sized + Write>(&mut self, out: &mut W, value: f32) -> io::Result<()> {
        self.0.write_f32(out, value + 0.0)
    }
    fn write_f64<W: ?Sized + Write>(&mut self, out: &mut W, value: f64) -> io::Result<()> {
        self.0.write_f64(out, value + 0.0)
    }
    as_laid_out! {
        begin_array() end_array() begin_array_value(first: bool) end_array_value()
        begin_object() end_object() begin_object_key(first: bool) end_object_key()
        begin_object_value() end_object_value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_zero_in_json_has_a_sign() {
        let value = serde_json::json!({"a": [-0.0, 1.5, -2.0], "b": {}, "c": []});
        assert_eq!(to_json(&value).unwrap(), r#"{"a":[0.0,1.5,-2.0],"b":{},"c":[]}"#);
        assert_eq!(to_json(&[-0.0f32]).unwrap(), "[0.0]");
        let plain = serde_json::json!({"a": [0.0, 1.5, -2.0], "b": {}, "c": []});
        assert_eq!(to_pretty_json(&value).unwrap(), serde_json::to_string_pretty(&plain).unwrap());
        let text = "{\"x\":-1e-300,\"y\":0.1,\"z\":123456789012}";
        let value: serde_json::Value = serde_json::from_str(text).unwrap();
        assert_eq!(to_json(&value).unwrap(), text, "other numbers stay as they are");
    }
}

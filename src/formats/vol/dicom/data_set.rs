//! Data sets that are written: elements in explicit little endian (PS3.5 chapter 7).

use std::collections::BTreeMap;
use std::io::{self, Write};

use super::element::Tag;
use super::syntax;

/// Elements of a data set or of an item. They are written in the order of their tags, whatever the
/// order in which they are added.
#[derive(Clone, Default)]
pub(super) struct DataSet {
    /// Value representation, length and value of each element.
    elements: BTreeMap<Tag, Vec<u8>>,
}

impl DataSet {
    /// Makes a data set.
    pub fn with(fill: impl FnOnce(&mut Self)) -> Self {
        let mut made = Self::default();
        fill(&mut made);
        made
    }

    /// Adds a text: ASCII, or bytes of another file in its character set.
    pub fn text(&mut self, tag: Tag, vr: &[u8; 2], value: impl AsRef<[u8]>) {
        let mut value = value.as_ref().to_vec();
        // UIDs are padded by a zero, other text by a blank.
        let padding = if vr == b"UI" { 0 } else { b' ' };
        value.resize(value.len().next_multiple_of(2), padding);
        self.put(tag, vr, &value);
    }

    /// Adds decimals.
    pub fn decimals(&mut self, tag: Tag, values: &[f64]) {
        let values: Vec<String> = values.iter().map(|v| decimal(*v)).collect();
        self.text(tag, b"DS", values.join("\\"));
    }

    /// Adds numbers of 16 bits.
    pub fn shorts(&mut self, tag: Tag, values: &[u16]) {
        self.put(tag, b"US", &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    }

    /// Adds numbers of 32 bits.
    pub fn longs(&mut self, tag: Tag, values: &[u32]) {
        self.put(tag, b"UL", &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    }

    /// Adds the name of another element.
    pub fn pointer(&mut self, tag: Tag, to: Tag) {
        self.put(tag, b"AT", &[to.0.to_le_bytes(), to.1.to_le_bytes()].concat());
    }

    /// Adds a sequence of items.
    pub fn sequence(&mut self, tag: Tag, items: impl IntoIterator<Item = Self>) {
        let mut all = Vec::new();
        for item in items {
            let start = all.len();
            all.extend(b"\xfe\xff\x00\xe0\0\0\0\0");
            item.append_to(&mut all);
            let len = (all.len() - start - 8) as u32;
            all[start + 4..start + 8].copy_from_slice(&len.to_le_bytes());
        }
        self.put_long(tag, b"SQ", all.len() as u32, &all);
    }

    /// Adds a sequence of one item.
    pub fn item(&mut self, tag: Tag, fill: impl FnOnce(&mut Self)) {
        self.sequence(tag, [Self::with(fill)]);
    }

    /// Adds a coded concept (PS3.3 section 8): code, scheme and meaning.
    pub fn code(&mut self, tag: Tag, [value, scheme, meaning]: [&str; 3]) {
        self.item(tag, |d| {
            d.text((0x0008, 0x0100), b"SH", value);
            d.text((0x0008, 0x0102), b"SH", scheme);
            d.text((0x0008, 0x0104), b"LO", meaning);
        });
    }

    /// The encoded elements.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.append_to(&mut bytes);
        bytes
    }

    /// Writes a file of this data set with its pixels, of at most 2³² − 2 bytes.
    ///
    /// * `class`, `instance`: UIDs of the file.
    pub fn write(
        &self,
        out: &mut dyn Write,
        [class, instance]: [&str; 2],
        pixels: &[u8],
    ) -> io::Result<()> {
        let meta = Self::with(|d| {
            d.put_long((0x0002, 0x0001), b"OB", 2, &[0, 1]);
            d.text((0x0002, 0x0002), b"UI", class);
            d.text((0x0002, 0x0003), b"UI", instance);
            d.text((0x0002, 0x0010), b"UI", syntax::EXPLICIT_LITTLE);
            d.text((0x0002, 0x0012), b"UI", IMPLEMENTATION);
            d.text((0x0002, 0x0013), b"SH", concat!("INTIMA_", env!("CARGO_PKG_VERSION")));
        })
        .bytes();
        let group = Self::with(|d| d.longs((0x0002, 0x0000), &[meta.len() as u32])).bytes();
        // Pixels follow every other element, and are not copied.
        let padding = &[0][..pixels.len() % 2];
        let len = (pixels.len() + padding.len()) as u32;
        let head = Self::with(|d| d.put_long((0x7fe0, 0x0010), b"OB", len, &[])).bytes();
        out.write_all(&[0; 128])?;
        out.write_all(b"DICM")?;
        for part in [&group, &meta, &self.bytes(), &head, pixels, padding] {
            out.write_all(part)?;
        }
        Ok(())
    }

    /// Keeps an element whose length has 16 bits.
    fn put(&mut self, tag: Tag, vr: &[u8; 2], value: &[u8]) {
        debug_assert!(value.len() <= usize::from(u16::MAX), "{} bytes for {tag:x?}", value.len());
        let len = (value.len() as u16).to_le_bytes();
        self.elements.insert(tag, [vr, &len[..], value].concat());
    }

    /// Keeps an element whose length has 32 bits.
    fn put_long(&mut self, tag: Tag, vr: &[u8; 2], len: u32, value: &[u8]) {
        self.elements.insert(tag, [vr, &[0, 0][..], &len.to_le_bytes(), value].concat());
    }

    fn append_to(&self, out: &mut Vec<u8>) {
        for (tag, element) in &self.elements {
            out.extend(tag.0.to_le_bytes());
            out.extend(tag.1.to_le_bytes());
            out.extend(element);
        }
    }
}

/// UID of this writer, made as [`uid`] makes one of the hash of `intima`.
const IMPLEMENTATION: &str = "2.25.304247235954139335336355330937505262805";

/// A UID made of a hash: a UUID of version 8 (RFC 9562) below 2.25 (PS3.5 B.2).
pub(super) fn uid(hash: &blake3::Hash) -> String {
    let bytes = hash.as_bytes().first_chunk::<16>().map_or(0, |b| u128::from_be_bytes(*b));
    let versioned = bytes & !(0xf << 76) | 8 << 76;
    format!("2.25.{}", versioned & !(3 << 62) | 2 << 62)
}

/// Most characters of a decimal (PS3.5 6.2).
const MAX_DECIMAL: usize = 16;

/// The decimal nearest to a number that has not too many characters, the shortest of them.
fn decimal(x: f64) -> String {
    // A zero has no sign.
    let x = x + 0.0;
    let shortest = x.to_string();
    if shortest.len() <= MAX_DECIMAL {
        return shortest;
    }
    let fixed = (0..MAX_DECIMAL).map(|digits| format!("{x:.digits$}"));
    let scaled = (0..MAX_DECIMAL).map(|digits| format!("{x:.digits$e}"));
    let fits = fixed.chain(scaled).filter(|text| text.len() <= MAX_DECIMAL);
    let miss = |text: &String| text.parse().map_or(f64::INFINITY, |y: f64| (y - x).abs());
    fits.min_by(|a, b| miss(a).total_cmp(&miss(b))).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_have_at_most_16_characters_and_the_least_miss() {
        for (x, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (2.5, "2.5"),
            (-486.800049, "-486.800049"),
            (1.0 / 3.0, "0.33333333333333"),
            (-1.0 / 3.0, "-0.3333333333333"),
            (-1e-7 / 3.0, "-3.333333333e-08"),
            (1e22, "1e22"),
            (-123_456.123_456_789_12, "-123456.12345679"),
        ] {
            let made = decimal(x);
            assert!(made.len() <= 16 && made.parse::<f64>().is_ok(), "{made}");
            let (made, wanted): (f64, f64) = (made.parse().unwrap(), text.parse().unwrap());
            assert!((made - x).abs() <= (wanted - x).abs(), "{x}: {made}, {text} is nearer");
        }
        assert_eq!(decimal(-0.0), "0");
    }

    #[test]
    fn a_uid_of_a_hash_is_a_uuid_of_version_8() {
        let all = uid(&blake3::Hash::from_bytes([0xff; 32]));
        let bits: u128 = all.strip_prefix("2.25.").unwrap().parse().unwrap();
        assert_eq!(format!("{bits:032x}"), "ffffffffffff8fffbfffffffffffffff");
        assert!(all.len() <= 64);
        assert_eq!(IMPLEMENTATION, uid(&blake3::hash(b"intima")));
    }
}

//! Character sets of text in DICOM (PS3.3 C.12.1.1.2, PS3.5 chapter 6).

use encoding_rs::{
    EUC_JP, EUC_KR, Encoding, GB18030, GBK, ISO_8859_2, ISO_8859_3, ISO_8859_4, ISO_8859_5,
    ISO_8859_6, ISO_8859_7, ISO_8859_8, ISO_8859_15, SHIFT_JIS, UTF_8, WINDOWS_874, WINDOWS_1252,
    WINDOWS_1254,
};

/// Defined terms, less `ISO_IR ` or `ISO 2022 IR `, with the final bytes of the escape sequences that
/// select the sets within a value, and their encodings. Latin-1 and Latin-5 are those parts of their
/// Windows encodings that are printed.
const SETS: [(&str, &[u8], &Encoding); 17] = [
    ("100", b"-A", WINDOWS_1252),
    ("101", b"-B", ISO_8859_2),
    ("109", b"-C", ISO_8859_3),
    ("110", b"-D", ISO_8859_4),
    ("144", b"-L", ISO_8859_5),
    ("127", b"-G", ISO_8859_6),
    ("126", b"-F", ISO_8859_7),
    ("138", b"-H", ISO_8859_8),
    ("148", b"-M", WINDOWS_1254),
    ("203", b"-b", ISO_8859_15),
    ("166", b"-T", WINDOWS_874),
    ("13", b")I", SHIFT_JIS),
    ("149", b"$)C", EUC_KR),
    ("58", b"$)A", GBK),
    ("192", b"%G", UTF_8),
    ("GB18030", b"", GB18030),
    ("GBK", b"", GBK),
];
/// Escape sequences of sets of two bytes in seven bits: JIS X 0208 and, whose codes EUC-JP has behind
/// a byte of their own, JIS X 0212.
const JIS_X_0208: &[u8] = b"$B";
const JIS_X_0212: &[u8] = b"$(D";
const JIS_X_0212_LEAD: u8 = 0x8f;
/// Escape sequences that end those: ASCII, and JIS X 0201, which has a yen for the backslash.
const ASCII: [&[u8]; 2] = [b"(B", b"(J"];
const ESCAPE: u8 = 0x1b;

/// Character set of a file's text, from its element (0008,0005).
#[derive(Clone, Copy, Default)]
pub(super) struct CharacterSet {
    /// The set in which a value begins; none of the known ones is told by the bytes.
    first: Option<&'static Encoding>,
}

impl CharacterSet {
    /// Reads the value of the element: terms joined by backslashes, the first of which may be empty.
    pub fn of(terms: &str) -> Self {
        let first = terms.split('\\').next().unwrap_or("").trim_matches([' ', '\0']);
        let number = ["ISO_IR ", "ISO 2022 IR "].iter().find_map(|p| first.strip_prefix(p));
        let name = number.unwrap_or(first);
        Self { first: SETS.iter().find(|set| set.0 == name).map(|set| set.2) }
    }

    /// Decodes a value; what cannot be is a replacement mark.
    pub fn decoded(self, value: &[u8]) -> String {
        let mut parts = value.split(|b| *b == ESCAPE);
        let mut out = self.part(parts.next().unwrap_or_default());
        for part in parts {
            out += &self.escaped(part);
        }
        out
    }

    /// Decodes what follows an escape, with the rest of its sequence.
    fn escaped(self, part: &[u8]) -> String {
        let two_bytes = |codes: &[u8], lead: Option<u8>| -> String {
            let high =
                |pair: &[u8]| lead.into_iter().chain(pair.iter().map(|b| b | 0x80)).collect();
            let bytes: Vec<Vec<u8>> = codes.chunks(2).map(high).collect();
            EUC_JP.decode_without_bom_handling(&bytes.concat()).0.into_owned()
        };
        if let Some(codes) = part.strip_prefix(JIS_X_0208) {
            return two_bytes(codes, None);
        }
        if let Some(codes) = part.strip_prefix(JIS_X_0212) {
            return two_bytes(codes, Some(JIS_X_0212_LEAD));
        }
        if let Some(text) = ASCII.iter().find_map(|end| part.strip_prefix(*end)) {
            return self.part(text);
        }
        let set = SETS.iter().filter(|set| !set.1.is_empty());
        let set = set.filter_map(|set| Some((set.2, part.strip_prefix(set.1)?))).next();
        set.map_or_else(|| self.part(part), |(of, text)| decoded(of, text))
    }

    fn part(self, bytes: &[u8]) -> String {
        match (self.first, std::str::from_utf8(bytes)) {
            (Some(set), _) => decoded(set, bytes),
            // Files that name no set hold UTF-8 or, most of the others, Latin-1.
            (None, Ok(text)) => text.to_owned(),
            (None, Err(_)) => decoded(WINDOWS_1252, bytes),
        }
    }
}

fn decoded(set: &'static Encoding, bytes: &[u8]) -> String {
    set.decode_without_bom_handling(bytes).0.into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_the_sets_of_the_standard_are_read() {
        // The examples of PS3.5, annexes H to K, and European names.
        for (terms, bytes, name) in [
            ("ISO_IR 100", &b"Trach\xe9e"[..], "Trachée"),
            ("", b"Trach\xe9e", "Trachée"),
            ("", "Trachée".as_bytes(), "Trachée"),
            ("ISO_IR 192", "Trachée".as_bytes(), "Trachée"),
            ("ISO_IR 144", b"\xbb\xee\xdace\xdc\xd1yp\xd3", "Люкceмбypг"),
            ("ISO_IR 126", b"\xc4\xe9\xef\xed\xf5\xf3\xe9\xef\xf2", "Διονυσιος"),
            ("GB18030", b"\xcd\xf5^\xd0\xa1\xb6\xab", "王^小东"),
            ("\\ISO 2022 IR 87", b"\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B", "山田^太郎"),
            ("ISO 2022 IR 13\\ISO 2022 IR 87", b"\xd4\xcf\xc0\xde^\xc0\xdb\xb3", "ﾔﾏﾀﾞ^ﾀﾛｳ"),
            ("\\ISO 2022 IR 149", b"\x1b$)C\xfb\xf3^\x1b$)C\xd1\xce\xd4\xd7", "洪^吉洞"),
            ("\\ISO 2022 IR 58", b"\x1b$)A\xd5\xc5^\x1b$)A\xd0\xa1\xb6\xab", "张^小东"),
            ("\\ISO 2022 IR 100", b"Buc^J\x1b-A\xe9r\xf4me", "Buc^Jérôme"),
        ] {
            assert_eq!(CharacterSet::of(terms).decoded(bytes), name, "{terms}");
        }
    }
}

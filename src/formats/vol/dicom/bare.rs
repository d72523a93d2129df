//! Data sets without preamble: told by their first elements, so that no other file is taken for one.

use super::element::{ElementCoding, ElementHead, Tag};
use super::syntax;

/// Elements that have to look right.
const ELEMENTS: usize = 4;
/// Longest value of one of them: a data set begins with short ones.
const MAX_VALUE: usize = 1 << 20;

/// The syntax of a data set that begins with these bytes; `None` if they begin none.
///
/// The first element is of group 2 or 8, tags ascend, value representations are those of the
/// standard or there are none, values are short.
pub(super) fn syntax_of(bytes: &[u8]) -> Option<&'static str> {
    [
        (syntax::EXPLICIT_LITTLE, true, false),
        (syntax::IMPLICIT_LITTLE, false, false),
        (syntax::EXPLICIT_BIG, true, true),
    ]
    .into_iter()
    .find(|(_, explicit, big)| looks_right(bytes, *explicit, *big))
    .map(|found| found.0)
}

/// Whether the meta group comes first.
pub(super) fn begins_with_meta(bytes: &[u8]) -> bool {
    bytes.starts_with(&[2, 0])
}

fn looks_right(bytes: &[u8], explicit: bool, big: bool) -> bool {
    let c = ElementCoding { explicit, big };
    let element = |at: usize| -> Option<(Tag, usize)> {
        let (h, is_long) = ElementHead::new(c, *bytes.get(at..)?.first_chunk()?);
        let h = match is_long {
            true => h.with_length(c, *bytes.get(at + 8..)?.first_chunk()?),
            false => h,
        };
        h.is_standard().then_some((h.tag, if is_long { 12 } else { 8 } + h.len as usize))
    };
    let mut at = 0;
    let mut last = None;
    for i in 0..ELEMENTS {
        // ElementValues may reach past the bytes that are known: what was seen has to do.
        let Some((tag, len)) = element(at) else { return i >= 2 };
        let first_fits = tag.0 == 8 || (tag.0 == 2 && !big && explicit);
        if (i == 0 && !first_fits) || last >= Some(tag) || len > MAX_VALUE {
            return false;
        }
        // Lengths of values are even.
        if len % 2 == 1 || tag.0 > 0x0040 {
            return false;
        }
        last = Some(tag);
        at += len;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_elements_tell_a_bare_data_set_and_its_coding() {
        let explicit = b"\x08\0\x05\0CS\x04\0abcd\x08\0\x08\0CS\x02\0ab\x08\0\x16\0UI\x02\x001\0\
                         \x08\0\x60\0CS\x02\0CT";
        assert_eq!(syntax_of(explicit), Some(syntax::EXPLICIT_LITTLE));
        let implicit = b"\x08\0\x05\0\x04\0\0\0abcd\x08\0\x08\0\x02\0\0\0ab\x08\0\x16\0\x02\0\0\0\
                         1\0\x08\0\x60\0\x02\0\0\0CT";
        assert_eq!(syntax_of(implicit), Some(syntax::IMPLICIT_LITTLE));
        let big = b"\0\x08\0\x05CS\0\x04abcd\0\x08\0\x08CS\0\x02ab\0\x08\0\x16UI\0\x021\0\
                    \0\x08\0\x60CS\0\x02CT";
        assert_eq!(syntax_of(big), Some(syntax::EXPLICIT_BIG));
        // Tags that fall, a group of pixels, and other files.
        let falls = [&implicit[12..], &implicit[..12]].concat();
        for other in [&falls[..], b"", b"NRRD0004\ntype: short\n", &[0; 132], &[8; 132]] {
            assert_eq!(syntax_of(other), None, "{other:?}");
        }
    }
}

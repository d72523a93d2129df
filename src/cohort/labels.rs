//! Labels of BIDS: letters and digits alone.

use std::collections::BTreeMap;

/// Most characters of a label; names of files get several of them.
const MAX_LABEL: usize = 48;
/// Characters of a hash that tells equal labels apart.
const HASH_CHARS: usize = 8;

/// Letters and digits of a text, without `sub-` or `ses-` in front: `sub-case_1` is `case1`.
pub fn clean(text: &str) -> String {
    let text = text.strip_prefix("sub-").or_else(|| text.strip_prefix("ses-")).unwrap_or(text);
    text.chars().filter(char::is_ascii_alphanumeric).take(MAX_LABEL).collect()
}

/// First characters of the BLAKE3 of a text.
pub fn short_hash(text: &[u8]) -> String {
    blake3::hash(text).to_hex()[..HASH_CHARS].to_owned()
}

/// Makes names different, also for file systems that do not tell case: where several sources come
/// to one name, or a source to none, its hash is put behind the name. A name that its source spells
/// out itself stays.
///
/// * `all`: each name with the path it was made from, and whether it is spelled like that there.
pub fn told_apart(all: Vec<(String, &[u8], bool)>) -> Vec<String> {
    let mut uses = BTreeMap::<String, usize>::new();
    for (name, ..) in &all {
        *uses.entry(name.to_ascii_lowercase()).or_default() += 1;
    }
    let exact = |name: &str| {
        let same = |(n, _, exact): &&(String, &[u8], bool)| *exact && n.eq_ignore_ascii_case(name);
        all.iter().filter(same).count()
    };
    let tell = |(name, source, is_exact): &(String, &[u8], bool)| {
        let is_alone = uses[&name.to_ascii_lowercase()] == 1 && !name.ends_with('-');
        let stays = is_alone || (*is_exact && exact(name) == 1);
        if stays { name.clone() } else { format!("{name}x{}", short_hash(source)) }
    };
    all.iter().map(tell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_hold_letters_and_digits_alone() {
        assert_eq!(clean("sub-case_1"), "case1");
        assert_eq!(clean("../../etc/passwd"), "etcpasswd");
        assert_eq!(clean("<b>&\u{202e}é\n"), "b");
        assert_eq!(clean(&"a".repeat(500)).len(), MAX_LABEL);
    }

    #[test]
    fn equal_labels_are_told_apart_by_their_source() {
        let name = |n: &str, source: &'static str, exact| (n.to_owned(), source.as_bytes(), exact);
        let told = told_apart(vec![
            name("sub-a1", "a1", true),
            name("sub-a1", "a-1", false),
            name("sub-A1", "A_1", false),
            name("sub-", "???", false),
            name("sub-b", "b!", false),
        ]);
        assert_eq!(told[0], "sub-a1", "a name spelled out stays");
        assert_eq!(told[4], "sub-b", "a name of its own stays");
        assert!(told[1].starts_with("sub-a1x") && told[2].starts_with("sub-A1x"));
        assert!(told[3].starts_with("sub-x") && told[3].len() > 6);
    }
}

//! Names and sentences: what a stranger searches for.

use super::source::{is_word, words};
use super::tree::{Tree, line};
use std::collections::BTreeMap;

/// Type names that stand more than once, each with its reason.
const SHARED_NAMES: &[(&str, &str)] = &[
    ("Args", "clap's arguments of a subcommand, one in each of their files"),
    ("Tolerance", "compute's of two floats, lod's of a picture: each the word of its field"),
];

/// Names of types that are declared in two files of `src`. Tests do not count: a module of tests has
/// small types of its own.
pub fn types_once(tree: &Tree) -> Vec<String> {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (path, code) in tree.rust("src/") {
        let code = before_tests(&code);
        if path.contains("/tests") {
            continue;
        }
        for (at, name) in declared(code) {
            places.entry(name.into()).or_default().push(format!("{path}:{}", line(code, at)));
        }
    }
    let twice = places.into_iter().filter(|(name, at)| {
        at.len() > 1 && !SHARED_NAMES.iter().any(|(shared, _)| shared == name)
    });
    twice.map(|(name, at)| format!("{name}: {}", at.join(", "))).collect()
}

/// `code` up to its module of tests.
fn before_tests(code: &str) -> &str {
    &code[..code.find("#[cfg(test)]\nmod ").unwrap_or(code.len())]
}

/// Types declared at a file's outermost level, each with its place.
fn declared(code: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    let mut start = 0;
    for text in code.split_inclusive('\n') {
        let mut rest = text;
        if let Some(public) = rest.strip_prefix("pub") {
            rest = public.split_once(' ').map_or("", |(_, r)| r);
            if public.starts_with("(in ") {
                rest = public.split_once(") ").map_or("", |(_, r)| r);
            }
        }
        let keyword = ["struct ", "enum ", "trait ", "type "].into_iter();
        if let Some(name) = keyword.filter_map(|k| rest.strip_prefix(k)).next() {
            found.push((start, &name[..name.find(|c| !is_word(c)).unwrap_or(name.len())]));
        }
        start += text.len();
    }
    found
}

/// Constants that bound a value and do not begin with `MAX_` or `MIN_`.
pub fn limits(tree: &Tree) -> Vec<String> {
    const FIRST: [&str; 6] = ["MOST", "LEAST", "LARGEST", "SMALLEST", "LONGEST", "SHORTEST"];
    const LAST: [&str; 4] = ["MAX", "MIN", "MOST", "LEAST"];
    let mut found = Vec::new();
    for (path, code) in tree.rust("") {
        for at in words(&code, "const") {
            let name = code[at + 5..].trim_start();
            let name = &name[..name.find(|c| !is_word(c)).unwrap_or(name.len())];
            let (first, last) = (name.split('_').next(), name.rsplit('_').next());
            let is_limit = first.is_some_and(|w| FIRST.contains(&w))
                || name.contains('_') && last.is_some_and(|w| LAST.contains(&w));
            if is_limit {
                found.push(format!("{path}:{}: {name}", line(&code, at)));
            }
        }
    }
    found
}

/// Names of numbers of things that are not `THING_count` or the things' plural.
pub fn counts(tree: &Tree) -> Vec<String> {
    let mut found = Vec::new();
    for (path, code) in tree.rust("") {
        for prefix in ["n_", "nr_", "no_of_", "number_of_", "let num_", "fn num_"] {
            let places = code.match_indices(prefix).map(|(at, _)| at).filter(|&at| {
                !code[..at].chars().next_back().is_some_and(is_word)
                    && code[at + prefix.len()..].starts_with(|c: char| c.is_ascii_lowercase())
            });
            found.extend(places.map(|at| format!("{path}:{}: {prefix}…", line(&code, at))));
        }
    }
    found
}

/// Fields of types that are written as JSON and have no doc comment.
pub fn json_fields(tree: &Tree) -> Vec<String> {
    let mut found = Vec::new();
    for path in tree.rust("src/").map(|(path, _)| path.to_owned()).collect::<Vec<_>>() {
        let text = tree.text(&path).unwrap_or_default();
        let (mut is_written, mut inside, mut has_doc) = (false, false, false);
        for (i, l) in text.lines().map(str::trim).enumerate() {
            if l.starts_with("#[cfg(test)]") {
                break;
            } else if l.starts_with("#[derive(") {
                is_written = l.contains("Serialize");
            } else if is_written && l.contains("struct ") && l.ends_with('{') {
                (is_written, inside, has_doc) = (false, true, false);
            } else if inside && l == "}" {
                inside = false;
            } else if inside && l.starts_with("///") {
                has_doc = true;
            } else if inside && !l.starts_with("//") && !l.starts_with('#') && l.contains(": ") {
                if !has_doc {
                    found.push(format!("{path}:{}: {l}", i + 1));
                }
                has_doc = false;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(rule: fn(&Tree) -> Vec<String>, path: &str, text: &str) -> Vec<String> {
        rule(&Tree::of(&[(path, text)]))
    }

    #[test]
    fn a_type_name_in_two_files_is_caught() {
        let tree = Tree::of(&[
            ("src/a.rs", "pub struct Piece;\npub(in crate::a) enum Own {}\n"),
            ("src/b.rs", "type Piece = u32;\n#[cfg(test)]\nmod tests {\nstruct Own;\n}\n"),
            ("src/c/tests.rs", "struct Piece;\n"),
        ]);
        assert_eq!(types_once(&tree), ["Piece: src/a.rs:1, src/b.rs:1"]);
        assert!(SHARED_NAMES.len() <= 8);
    }

    #[test]
    fn a_limit_by_another_word_is_caught() {
        let found = of(limits, "src/a.rs", "const MOST_FACES: u8 = 1;\nconst SIZE_MAX: u8 = 2;\n");
        assert_eq!(found, ["src/a.rs:1: MOST_FACES", "src/a.rs:2: SIZE_MAX"]);
        assert_eq!(of(limits, "src/a.rs", "const MAX_FACES: u8 = 1; const MAX: u8 = 1;"), [""; 0]);
    }

    #[test]
    fn a_count_by_a_prefix_is_caught() {
        assert_eq!(of(counts, "src/a.rs", "let n_faces = 1;"), ["src/a.rs:1: n_…"]);
        assert_eq!(of(counts, "src/a.rs", "let face_count = 1; let in_faces = 2;"), [""; 0]);
    }

    #[test]
    fn a_json_field_without_doc_is_caught() {
        let text = "#[derive(Serialize)]\nstruct A {\n    /// A.\n    #[serde(flatten)]\n    a: u8,\n    b: u8,\n}\n";
        assert_eq!(of(json_fields, "src/a.rs", text), ["src/a.rs:6: b: u8,"]);
    }
}

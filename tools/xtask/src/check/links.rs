//! A document or comment that names a file is right about it: the file is there.

use super::source::{comments_only, words};
use super::tree::{Tree, line};

/// Logs keep the words of their day; their links still have to resolve.
const LOGS: &str = "benches/results/";
/// Folders of the root: whatever is named below them has to exist.
const FOLDERS: &[&str] =
    &["src/", "tests/", "examples/", "benches/", "shaders/", "tools/", "docs/"];
/// Endings of files that are ours wherever they are named with a folder.
const ENDINGS: &[&str] = &[".rs", ".wgsl", ".py", ".md"];
/// Names that stand for any name.
const PLACEHOLDERS: &[&str] = &["NAME", "NNN"];
/// Notes that are not in the repository: a reader cannot look there.
const NOTES: &[&str] = &["ALGORITHMS", "CONTRACT", "DESIGN", "PLATFORM"];

/// Links of Markdown files that lead nowhere.
pub fn resolve(tree: &Tree) -> Vec<String> {
    let mut broken = Vec::new();
    for (path, text) in documents(tree) {
        let text = without_fences(text);
        for (at, _) in text.match_indices("](") {
            let target = text[at + 2..].split([')', ' ']).next().unwrap_or_default();
            let file = target.split('#').next().unwrap_or_default();
            let outside = file.is_empty() || file.contains("://") || file.starts_with("mailto:");
            if !outside && !exists(tree, &joined(folder(path), file)) {
                broken.push(format!("{path}:{}: {target}", line(&text, at)));
            }
        }
    }
    broken
}

/// Files named in documents and comments that are not there.
pub fn cited(tree: &Tree) -> Vec<String> {
    let mut broken = Vec::new();
    let documents = documents(tree).filter(|(path, _)| !path.starts_with(LOGS));
    let documents = documents.map(|(path, text)| (path, text.to_owned()));
    for (path, text) in documents.chain(comments(tree)) {
        for (at, name) in names(&text) {
            if !found(tree, path, name) {
                broken.push(format!("{path}:{}: {name}", line(&text, at)));
            }
        }
        for note in NOTES {
            let places = words(&text, note);
            broken.extend(places.map(|at| format!("{path}:{}: {note}", line(&text, at))));
        }
    }
    broken
}

/// Markdown files and their text.
fn documents(tree: &Tree) -> impl Iterator<Item = (&str, &str)> {
    let all = tree.below("").filter(|(path, _)| path.ends_with(".md"));
    all.filter_map(|(path, bytes)| Some((path, std::str::from_utf8(bytes).ok()?)))
}

/// Files with code, all but their comments blanked.
fn comments(tree: &Tree) -> impl Iterator<Item = (&str, String)> {
    tree.below("").filter_map(|(path, bytes)| {
        let text = || std::str::from_utf8(bytes).ok();
        match path.rsplit_once('.')?.1 {
            "rs" | "wgsl" => Some((path, comments_only(text()?))),
            "py" | "toml" => Some((path, after_hashes(text()?))),
            _ => None,
        }
    })
}

/// What follows the first `#` of each line.
fn after_hashes(text: &str) -> String {
    let after = text.lines().map(|l| l.split_once('#').map_or("", |(_, comment)| comment));
    after.collect::<Vec<_>>().join("\n")
}

/// Markdown without its fenced blocks; lines keep their places.
fn without_fences(text: &str) -> String {
    let mut fenced = false;
    let kept = text.lines().map(|l| {
        let fence = l.trim_start().starts_with("```");
        fenced ^= fence;
        if fenced || fence { "" } else { l }
    });
    kept.collect::<Vec<_>>().join("\n")
}

/// Names of files in a text, with their places. Web addresses and outputs are none.
fn names(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let parts = |c: char| !(c.is_alphanumeric() || "_./-:".contains(c));
    text.split(parts).filter_map(move |word| {
        let at = word.as_ptr() as usize - text.as_ptr() as usize;
        let name = word.trim_end_matches(['.', ':', '-']).trim_end_matches('/');
        let ours = ENDINGS.iter().any(|e| name.ends_with(e)) && name.contains('/');
        let below = FOLDERS.iter().any(|f| name.starts_with(f));
        let page = name.ends_with(".md") && name.starts_with(char::is_uppercase);
        let other = name.contains(':')
            || ["out/", "target/", "/"].iter().any(|p| name.starts_with(p))
            || PLACEHOLDERS.iter().any(|p| name.contains(p));
        ((ours || below || page) && !other).then_some((at, name))
    })
}

/// Looks from the citing file's folder upwards, and in the folders that names are shortened by.
fn found(tree: &Tree, from: &str, name: &str) -> bool {
    let mut here = folder(from);
    loop {
        if exists(tree, &joined(here, name)) {
            return true;
        }
        if here.is_empty() {
            break;
        }
        here = folder(here);
    }
    ["src", "tests", "shaders"].iter().any(|f| exists(tree, &joined(f, name)))
}

fn exists(tree: &Tree, path: &str) -> bool {
    path.is_empty() || tree.has(path) || tree.below(&format!("{path}/")).next().is_some()
}

/// The folder of a path, without a slash at its end.
fn folder(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// `relative` seen from `folder`, `.` and `..` resolved.
fn joined(folder: &str, relative: &str) -> String {
    let mut parts: Vec<&str> = folder.split('/').filter(|p| !p.is_empty()).collect();
    for part in relative.split('/') {
        match part {
            "" | "." => {}
            ".." => drop(parts.pop()),
            name => parts.push(name),
        }
    }
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_that_resolve_pass() {
        let page = "[a](docs/a.md) [b](docs/a.md#part) [c](#here) [d](https://x.org/y.md)\n\
                    [folder](docs/) ![p](docs/p.png)\n```\n[x](nowhere.md)\n```";
        let tree = Tree::of(&[
            ("README.md", page),
            ("docs/a.md", "[up](../README.md) [beside](p.png)"),
            ("docs/p.png", ""),
        ]);
        assert_eq!(resolve(&tree), [""; 0]);
    }

    #[test]
    fn a_link_that_leads_nowhere_is_caught() {
        let tree = Tree::of(&[("docs/a.md", "fine\n[b](b.md) [r](../README.md#x)")]);
        assert_eq!(resolve(&tree), ["docs/a.md:2: b.md", "docs/a.md:2: ../README.md#x"]);
    }

    #[test]
    fn a_cited_file_that_is_not_there_is_caught() {
        let tree = Tree::of(&[
            ("src/lod/mod.rs", "//! See `lod/gone.rs`.\nlet x = \"lod/quoted.rs\"; // PLAN.md"),
            ("shaders/a.wgsl", "// as in lib/none.wgsl\n"),
            ("tools/a.py", "x = 'src/quoted.rs'  # src/none\n"),
            ("README.md", "`tests/none` and `docs/none.md`"),
        ]);
        let said = cited(&tree);
        let names: Vec<_> = said.iter().map(|s| s.rsplit(' ').next().unwrap()).collect();
        let want = ["tests/none", "docs/none.md", "lib/none.wgsl", "lod/gone.rs", "PLAN.md"];
        assert_eq!(names, [&want[..], &["src/none"]].concat());
    }

    #[test]
    fn a_cited_note_that_is_kept_elsewhere_is_caught() {
        let tree = Tree::of(&[("src/a.rs", "//! As ALGORITHMS, stage c.\nconst DESIGN: u8 = 0;")]);
        assert_eq!(cited(&tree), ["src/a.rs:1: ALGORITHMS"]);
    }

    #[test]
    fn cited_files_that_are_there_pass() {
        let tree = Tree::of(&[
            (
                "src/lod/mod.rs",
                "//! `lod/cut.rs`, `shaders/lib/b.wgsl`, `common/fly.rs`, `src/lod`.",
            ),
            ("src/lod/cut.rs", "// https://x.org/a/b.rs, out/speed/table.md, src/NAME.rs"),
            ("shaders/lib/b.wgsl", "// lib/b.wgsl"),
            ("tests/common/fly.rs", ""),
            ("benches/results/2026/x.md", "`src/gone.rs`"),
        ]);
        assert_eq!(cited(&tree), [""; 0]);
    }
}

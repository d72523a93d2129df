//! The repository as paths and bytes. Tests build small ones.

use super::source::code_only;
use std::collections::BTreeMap;
use std::path::Path;
use std::{fs, io};

/// Files by path from the root, with `/` between folders.
#[derive(Default)]
pub struct Tree(BTreeMap<String, Vec<u8>>);

/// Folders that are not checked.
const SKIPPED: &[&str] = &["target", "out", "venv", "__pycache__"];

impl Tree {
    /// Every file below `root`, build products and hidden folders left out.
    pub fn read(root: &Path) -> io::Result<Self> {
        let mut tree = Self::default();
        tree.walk(root, "")?;
        Ok(tree)
    }

    fn walk(&mut self, folder: &Path, prefix: &str) -> io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let kind = entry.file_type()?;
            if kind.is_dir() && !name.starts_with('.') && !SKIPPED.contains(&name.as_str()) {
                self.walk(&entry.path(), &format!("{prefix}{name}/"))?;
            } else if kind.is_file() {
                self.0.insert(format!("{prefix}{name}"), fs::read(entry.path())?);
            }
        }
        Ok(())
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Text of a file; nothing if there is no such file or it is not text.
    pub fn text(&self, path: &str) -> Option<&str> {
        std::str::from_utf8(self.0.get(path)?).ok()
    }

    /// Whether there is such a file.
    pub fn has(&self, path: &str) -> bool {
        self.0.contains_key(path)
    }

    /// Paths and bytes of all files in a folder, at any depth.
    pub fn below<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = (&'a str, &'a [u8])> {
        let all = self.0.iter().filter(move |(path, _)| path.starts_with(folder));
        all.map(|(path, bytes)| (path.as_str(), bytes.as_slice()))
    }

    /// Rust files in a folder, with comments and strings blanked.
    pub fn rust<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = (&'a str, String)> {
        let files = self.below(folder).filter(|(path, _)| path.ends_with(".rs"));
        files.filter_map(|(path, bytes)| Some((path, code_only(std::str::from_utf8(bytes).ok()?))))
    }

    /// Rooms: folders of `src` and its files but `main.rs` and `lib.rs`.
    pub fn rooms(&self) -> Vec<&str> {
        let rest = self.0.keys().filter_map(|path| path.strip_prefix("src/"));
        let mut rooms: Vec<_> = rest
            .filter_map(|rest| match rest.split_once('/') {
                Some((room, _)) => Some(room),
                None => rest.strip_suffix(".rs").filter(|file| !["main", "lib"].contains(file)),
            })
            .collect();
        rooms.dedup();
        rooms
    }

    /// A tree of these files.
    #[cfg(test)]
    pub fn of(files: &[(&str, &str)]) -> Self {
        Self(files.iter().map(|(p, t)| ((*p).to_owned(), t.as_bytes().to_vec())).collect())
    }
}

/// The line (from 1) of a byte offset.
pub fn line(text: &str, at: usize) -> usize {
    1 + text[..at].matches('\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_files_of_src_are_rooms() {
        let files = ["src/main.rs", "src/lib.rs", "src/device.rs", "src/vk/mod.rs", "src/vk/a.rs"];
        let tree = Tree::of(&files.map(|f| (f, "")));
        assert_eq!(tree.rooms(), ["device", "vk"]);
    }

    #[test]
    fn our_own_tree_is_read() {
        let tree = Tree::read(&crate::process::root()).unwrap();
        assert!(tree.has("tools/xtask/src/check/tree.rs"));
        assert!(tree.below("target/").next().is_none());
    }
}

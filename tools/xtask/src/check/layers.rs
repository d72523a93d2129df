//! Rooms stand in the order the data takes, and import only rooms above them.

use super::source::{is_word, words};
use super::tree::{Tree, line};

/// The rooms, first to last.
pub const ORDER: &[&str] = &[
    "fault",
    "task",
    "volume",
    "geometry",
    "formats",
    "lumen",
    "compute",
    "kernels",
    "field",
    "organ",
    "centerline",
    "surface",
    "wall",
    "mesh",
    "lod",
    "behind",
    "flight",
    "vk",
    "render",
    "device",
    "paper",
    "session",
    "report_page",
    "cohort",
    "app",
    "cli",
];

fn rank(room: &str) -> Option<usize> {
    ORDER.iter().position(|r| *r == room)
}

/// Imports that go downward, and rooms without a place in the order.
pub fn order(tree: &Tree) -> Vec<String> {
    let mut broken = Vec::new();
    for room in tree.rooms() {
        let Some(here) = rank(room) else {
            broken.push(format!("src/{room}: not in the order of rooms"));
            continue;
        };
        let files = tree.rust("src/").filter(|(path, _)| of_room(path, room));
        for (path, code) in files {
            for (at, to) in imports(&code) {
                if rank(&to).is_some_and(|there| there > here) {
                    broken.push(format!("{path}:{}: {room} -> {to}", line(&code, at)));
                }
            }
        }
    }
    broken
}

fn of_room(path: &str, room: &str) -> bool {
    let rest = path.strip_prefix("src/").and_then(|p| p.strip_prefix(room));
    rest.is_some_and(|rest| rest.starts_with('/') || rest == ".rs")
}

/// Every `crate::NAME`, and each name of `crate::{NAME::…, NAME}`, with its place.
fn imports(code: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for at in words(code, "crate") {
        let Some(rest) = code[at + 5..].trim_start().strip_prefix("::") else { continue };
        let rest = rest.trim_start();
        match rest.strip_prefix('{') {
            Some(group) => found.extend(outer_names(group).map(|name| (at, name))),
            None => found.push((at, rest.chars().take_while(|c| is_word(*c)).collect())),
        }
    }
    found
}

/// The first name of each part of a brace group that has just been opened.
fn outer_names(group: &str) -> impl Iterator<Item = String> {
    let mut depth = 0;
    let mut parts = vec![String::new()];
    for c in group.chars() {
        match c {
            '}' if depth == 0 => break,
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => parts.push(String::new()),
            c => parts.last_mut().expect("never empty").push(c),
        }
    }
    parts.into_iter().map(|p| p.trim_start().chars().take_while(|c| is_word(*c)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn broken(path: &str, text: &str) -> Vec<String> {
        order(&Tree::of(&[(path, text)]))
    }

    #[test]
    fn an_import_from_below_is_caught() {
        let found = broken("src/lumen/mod.rs", "use crate::volume::Grid;\nuse crate::vk::Gpu;");
        assert_eq!(found, ["src/lumen/mod.rs:2: lumen -> vk"]);
        assert_eq!(broken("src/device.rs", "fn f() -> crate::session::X {}").len(), 1);
    }

    #[test]
    fn a_group_hides_nothing() {
        let text = "use crate::{\n  volume::{Grid, samples},\n  cli::{self, Args},\n  app,\n};";
        let found = broken("src/render/mod.rs", text);
        assert_eq!(
            found,
            ["src/render/mod.rs:1: render -> cli", "src/render/mod.rs:1: render -> app"]
        );
    }

    #[test]
    fn comments_strings_and_other_crates_import_nothing() {
        let text = "// crate::cli\nconst S: &str = \"crate::cli\"; use other_crate::cli;";
        assert_eq!(broken("src/volume/mod.rs", text), [""; 0]);
    }

    #[test]
    fn a_room_without_a_place_is_caught() {
        assert_eq!(broken("src/attic/mod.rs", "").len(), 1);
    }

    #[test]
    fn main_may_use_anything() {
        assert_eq!(broken("src/main.rs", "use intima::cli;"), [""; 0]);
    }
}

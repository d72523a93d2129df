//! ARCHITECTURE.md is the map of the code: it names the rooms there are.

use super::layers::ORDER;
use super::tree::Tree;

const PAGE: &str = "ARCHITECTURE.md";
/// Lines of the page that a newcomer reads in ten minutes.
const MAX_LINES: usize = 150;

/// The page is no longer than it may be.
pub fn length(tree: &Tree) -> Vec<String> {
    let lines = tree.text(PAGE).unwrap_or_default().lines().count();
    let over = (lines > MAX_LINES).then(|| format!("{PAGE}: {lines} lines, {MAX_LINES} at most"));
    over.into_iter().collect()
}

/// Rooms that the page leaves out, and rooms it shows that do not exist.
pub fn rooms(tree: &Tree) -> Vec<String> {
    let Some(text) = tree.text(PAGE) else { return vec![format!("no {PAGE}")] };
    let there = tree.rooms();
    let left_out = there.iter().filter(|room| !names(text, room));
    let left_out = left_out.map(|room| format!("{PAGE}: does not name {room}"));
    let known = ORDER.iter().filter(|room| !there.contains(room) && shows(text, room));
    let known = known.map(|room| format!("{PAGE}: shows {room}, which does not exist"));
    let lost = paths(text).filter(|room| !there.contains(&room.as_str()));
    let lost = lost.map(|room| format!("{PAGE}: names src/{room}, which does not exist"));
    left_out.chain(known).chain(lost).collect()
}

/// Shown as a place on the map, or at least in code type.
fn names(text: &str, room: &str) -> bool {
    shows(text, room) || text.contains(&format!("`{room}`"))
}

/// `room/` or `room.rs` in code type or at the start of a line, or `room` first in a table's row.
/// The bare word elsewhere may mean something else (`mesh`).
fn shows(text: &str, room: &str) -> bool {
    let forms = [format!("{room}/"), format!("{room}.rs")];
    let typed = forms.iter().any(|f| text.contains(&format!("`{f}")));
    let starts = |line: &str| {
        let row = line.trim_start_matches(['|', ' ', '-', '*']);
        forms.iter().any(|f| row.starts_with(f)) || {
            line.starts_with('|') && row.starts_with(&format!("`{room}`"))
        }
    };
    typed || text.lines().any(starts)
}

/// Rooms named by a path, `src/NAME/…` or `src/NAME.rs`, in code type.
fn paths(text: &str) -> impl Iterator<Item = String> {
    text.split("`src/").skip(1).filter_map(|rest| {
        let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        let after = &rest[name.len()..];
        let room = after.starts_with('/') || after.starts_with(".rs");
        (room && !["main", "lib"].contains(&name.as_str()) && !name.is_empty()).then_some(name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(page: &str) -> Vec<String> {
        rooms(&Tree::of(&[
            ("ARCHITECTURE.md", page),
            ("src/volume/mod.rs", ""),
            ("src/device.rs", ""),
            ("src/main.rs", ""),
        ]))
    }

    #[test]
    fn a_true_map_passes() {
        let map = "```text\n  volume/  grids\n  device.rs  chooses\n```\nA `mesh` is a thing.";
        assert_eq!(said(map), [""; 0]);
        assert_eq!(said("| room |\n| `volume` | grids |\n- `device`: `src/main.rs`"), [""; 0]);
    }

    #[test]
    fn a_room_left_out_is_caught() {
        assert_eq!(said("`volume/`"), ["ARCHITECTURE.md: does not name device"]);
    }

    #[test]
    fn a_room_that_is_not_there_is_caught() {
        let found = said("`volume/` `device.rs`\n  lod/  levels\nsee `src/attic/old.rs`");
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(said("`volume` `device`\n| `lod` | levels |").len(), 1);
    }

    #[test]
    fn one_line_too_many_is_caught() {
        let page = |lines: usize| Tree::of(&[(PAGE, &"x\n".repeat(lines))]);
        assert_eq!(length(&page(150)), [""; 0]);
        assert_eq!(length(&page(151)), ["ARCHITECTURE.md: 151 lines, 150 at most"]);
    }

    #[test]
    fn a_missing_page_is_caught() {
        assert_eq!(rooms(&Tree::of(&[])).len(), 1);
    }
}

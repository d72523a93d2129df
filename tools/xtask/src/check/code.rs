//! Words that are allowed in some rooms only, or nowhere.

use super::source::words;
use super::tree::{Tree, line};

/// Where a word is followed by `then`, outside `src/vk`.
fn outside_vk(tree: &Tree, word: &str, then: &str) -> Vec<String> {
    let files =
        tree.rust("").filter(|(path, _)| !path.starts_with("src/vk/") && *path != "src/vk.rs");
    let places = files.flat_map(|(path, code)| {
        let found = words(&code, word).filter(|&at| code[at + word.len()..].starts_with(then));
        found.map(|at| format!("{path}:{}: {word}{then}", line(&code, at))).collect::<Vec<_>>()
    });
    places.collect()
}

/// The Vulkan crates are named by `vk` alone; others use what it hands out.
pub fn vulkan_in_vk(tree: &Tree) -> Vec<String> {
    ["ash", "ash_window", "gpu_allocator"].iter().flat_map(|c| outside_vk(tree, c, "::")).collect()
}

/// No `unsafe` elsewhere, in tests and tools neither.
pub fn unsafe_in_vk(tree: &Tree) -> Vec<String> {
    outside_vk(tree, "unsafe", "")
}

/// No placeholder and no debugging print is committed.
pub fn placeholders(tree: &Tree) -> Vec<String> {
    let mut found = Vec::new();
    for (path, code) in tree.rust("") {
        for word in ["todo", "unimplemented", "dbg"] {
            let called = words(&code, word).filter(|&at| code[at + word.len()..].starts_with('!'));
            found.extend(called.map(|at| format!("{path}:{}: {word}!", line(&code, at))));
        }
    }
    found
}

/// Tests that are left out and do not say how long they take and by which command they run.
pub fn ignored(tree: &Tree) -> Vec<String> {
    const LEFT_OUT: &str = "#[ignore";
    let mut found = Vec::new();
    for (path, code) in tree.rust("") {
        let text = tree.text(path).unwrap_or_default();
        let places = code.match_indices(LEFT_OUT).map(|(at, _)| at);
        let bare = places.filter(|at| {
            let reason = text[at + LEFT_OUT.len()..].lines().next().unwrap_or_default();
            !(reason.starts_with(" = \"minutes: ") && reason.contains("cargo test "))
        });
        found.extend(bare.map(|at| format!("{path}:{}: {LEFT_OUT}", line(&code, at))));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vulkan_outside_vk_is_caught() {
        let text = "use ash::vk;\nfn f(x: gpu_allocator::Error, y: flash::X) {}";
        let tree = Tree::of(&[("src/render/mod.rs", text), ("src/vk/mod.rs", text)]);
        assert_eq!(
            vulkan_in_vk(&tree),
            ["src/render/mod.rs:1: ash::", "src/render/mod.rs:2: gpu_allocator::"]
        );
    }

    #[test]
    fn unsafe_outside_vk_is_caught() {
        let text = "#![deny(unsafe_code)]\n// unsafe\nunsafe { f() }";
        let tree = Tree::of(&[("tests/cli.rs", text), ("src/vk/mod.rs", text)]);
        assert_eq!(unsafe_in_vk(&tree), ["tests/cli.rs:3: unsafe"]);
    }

    #[test]
    fn a_test_left_out_without_its_command_is_caught() {
        let text = "#[ignore = \"minutes: cargo test x -- --ignored\"]\n#[ignore]\n\
                    #[ignore = \"a measurement\"]";
        let tree = Tree::of(&[("tests/gpu/a.rs", text)]);
        assert_eq!(ignored(&tree), ["tests/gpu/a.rs:2: #[ignore", "tests/gpu/a.rs:3: #[ignore"]);
    }

    #[test]
    fn placeholders_are_caught() {
        let text = "fn a() { todo!() }\nfn b() { unimplemented!(\"later\") }\nfn c() { dbg!(1); }";
        let tree = Tree::of(&[("src/lumen/mod.rs", text)]);
        assert_eq!(placeholders(&tree).len(), 3);
        let clean = Tree::of(&[("src/lumen/mod.rs", "// todo!\nlet todo = \"dbg!()\";")]);
        assert_eq!(placeholders(&clean), [""; 0]);
    }
}

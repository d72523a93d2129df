//! The rules of the house, as far as a program can see them.
//!
//! Each rule is a function from a [`Tree`] to the places that break it, with tests that plant a
//! violation and see it caught. Cargo's own checks come first.

mod code;
mod docs;
mod kernels;
mod layers;
mod links;
mod manifest;
mod size;
mod source;
mod tree;

use crate::Stop;
use crate::run::{cargo, loudly, on_path, quietly, root};
use tree::Tree;

/// A rule: its name, and a function that lists what breaks it, one line a place.
type Rule = (&'static str, fn(&Tree) -> Vec<String>);

const RULES: &[Rule] = &[
    ("rooms import only rooms above them", layers::order),
    ("Vulkan is called in vk alone", code::vulkan_in_vk),
    ("unsafe code is in vk alone", code::unsafe_in_vk),
    ("nothing is left to do", code::nothing_left_to_do),
    ("every kernel has its shader, twin, cases and place", kernels::complete),
    ("every shader says what it does", kernels::headers),
    ("ARCHITECTURE.md names the rooms there are", docs::rooms),
    ("ARCHITECTURE.md is short", docs::length),
    ("links of documents resolve", links::resolve),
    ("every dependency has its reason", manifest::reasons),
    ("committed pictures and tables stay small", size::budgets),
];

/// `cargo xtask check`: everything is tried, so that one run shows all there is to mend.
pub fn check() -> Result<(), Stop> {
    components()?;
    let clippy = ["clippy", "--workspace", "--all-targets", "--locked", "--features", "faults"];
    let doc = ["doc", "--no-deps", "--lib", "--locked", "--package", "intima"];
    let steps = [
        loudly(&mut cargo(&["fmt", "--all", "--check"])),
        loudly(&mut cargo(&[&clippy[..], &["--", "-D", "warnings"]].concat())),
        loudly(
            cargo(&[&doc[..], &["--features", "faults"]].concat())
                .env("RUSTDOCFLAGS", "-D warnings"),
        ),
        rules(),
    ];
    let failed = steps.into_iter().filter_map(Result::err).map(|stop| match stop {
        Stop::Failed(m) | Stop::Usage(m) | Stop::NoDevice(m) => m,
    });
    let failed: Vec<_> = failed.collect();
    if failed.is_empty() { Ok(()) } else { Err(Stop::Failed(failed.join("\n"))) }
}

/// `cargo xtask check --rules`: the rules of the house alone, in a blink.
pub fn rules() -> Result<(), Stop> {
    let tree = Tree::read(&root()).map_err(|e| Stop::Failed(format!("reading the tree: {e}")))?;
    let broken = report(&tree);
    if broken.is_empty() {
        eprintln!("{} rules hold over {} files", RULES.len(), tree.len());
        return Ok(());
    }
    Err(Stop::Failed(broken.join("\n")))
}

/// Every broken rule with its places.
fn report(tree: &Tree) -> Vec<String> {
    let broken = |(name, rule): &Rule| {
        let places = rule(tree);
        (!places.is_empty()).then(|| format!("broken: {name}\n  {}", places.join("\n  ")))
    };
    RULES.iter().filter_map(broken).collect()
}

/// rustfmt and clippy are optional parts of a toolchain: fetched where rustup can.
fn components() -> Result<(), Stop> {
    for (part, probe) in [("rustfmt", "fmt"), ("clippy", "clippy")] {
        if !quietly(&mut cargo(&[probe, "--version"])) {
            if !on_path("rustup") {
                return Err(Stop::Failed(format!("{part} is missing: install it with Rust")));
            }
            loudly(&mut crate::run::command("rustup", &["component", "add", part]))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broken_rule_is_reported_with_its_place() {
        let tree = Tree::of(&[("src/volume/grid.rs", "fn f() { todo!() }")]);
        let said = report(&tree).join("\n");
        assert!(said.contains("nothing is left to do"), "{said}");
        assert!(said.contains("src/volume/grid.rs:1"), "{said}");
    }
}

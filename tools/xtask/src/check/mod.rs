//! The project rules that a program can check.
//!
//! Each rule is a function from a [`Tree`] to the places that break it, with tests that plant a
//! violation and see it caught. Cargo's own checks come first.

mod builds;
mod code;
mod docs;
mod kernels;
mod layers;
mod links;
mod manifest;
mod pictures;
mod size;
mod source;
mod tree;
mod words;

use crate::TaskError;
use crate::process::{cargo, on_path, root, run, succeeds};
use crate::test_suite::FEATURES;
use tree::Tree;

/// A rule: its name, and a function that lists what breaks it, one line a place.
type Rule = (&'static str, fn(&Tree) -> Vec<String>);

const RULES: &[Rule] = &[
    ("rooms import only rooms above them", layers::order),
    ("Vulkan is called in vk alone", code::vulkan_in_vk),
    ("unsafe code is in vk alone", code::unsafe_in_vk),
    ("no placeholder or debugging print", code::placeholders),
    ("a test left out takes minutes and names its command", code::ignored),
    ("every kernel has its shader, twin, cases and place", kernels::complete),
    ("every kernel shader has a complete header", kernels::headers),
    ("ARCHITECTURE.md names the rooms there are", docs::rooms),
    ("ARCHITECTURE.md is short", docs::length),
    ("links of documents resolve", links::resolve),
    ("documents and comments name files that exist", links::cited),
    ("every dependency has a reason", manifest::reasons),
    ("committed pictures and tables stay small", size::budgets),
    ("a type name stands once", words::types_once),
    ("limits begin with MAX_ or MIN_", words::limits),
    ("counts end in _count", words::counts),
    ("fields of JSON are documented", words::json_fields),
    ("pictures of patients name source and licence", pictures::licensed),
];

/// `cargo xtask check`: all steps run, so that one call shows all failures.
pub fn check() -> Result<(), TaskError> {
    components()?;
    let all = [&["--workspace", "--all-targets", "--locked"], &FEATURES[..]].concat();
    let doc = ["doc", "--no-deps", "--lib", "--locked", "--package", "intima"];
    let steps = [
        run(&mut cargo(&["fmt", "--all", "--check"])),
        run(&mut cargo(&[&["clippy"], &all[..], &["--", "-D", "warnings"]].concat())),
        run(cargo(&[&doc[..], &FEATURES].concat()).env("RUSTDOCFLAGS", "-D warnings")),
        builds::library(),
        builds::released(),
        rules(),
    ];
    let failed = steps.into_iter().filter_map(Result::err).map(|stop| match stop {
        TaskError::Failed(m) | TaskError::Usage(m) | TaskError::NoDevice(m) => m,
    });
    let failed: Vec<_> = failed.collect();
    if failed.is_empty() { Ok(()) } else { Err(TaskError::Failed(failed.join("\n"))) }
}

/// `cargo xtask check --rules`: the project rules alone.
pub fn rules() -> Result<(), TaskError> {
    let tree =
        Tree::read(&root()).map_err(|e| TaskError::Failed(format!("reading the tree: {e}")))?;
    let broken = report(&tree);
    if broken.is_empty() {
        let lines = size::code_lines(&tree);
        eprintln!(
            "{} rules hold over {} files; {lines} lines of code in src",
            RULES.len(),
            tree.len()
        );
        return Ok(());
    }
    Err(TaskError::Failed(broken.join("\n")))
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
fn components() -> Result<(), TaskError> {
    for (part, probe) in [("rustfmt", "fmt"), ("clippy", "clippy")] {
        if !succeeds(&mut cargo(&[probe, "--version"])) {
            if !on_path("rustup") {
                return Err(TaskError::Failed(format!("{part} is missing: install it with Rust")));
            }
            run(&mut crate::process::command("rustup", &["component", "add", part]))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broken_rule_is_reported_with_file_and_line() {
        let tree = Tree::of(&[("src/volume/grid.rs", "fn f() { todo!() }")]);
        let said = report(&tree).join("\n");
        assert!(said.contains("no placeholder or debugging print"), "{said}");
        assert!(said.contains("src/volume/grid.rs:1"), "{said}");
    }
}

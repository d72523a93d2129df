//! Shader, twin and cases come together, and every kernel is on the list.

use super::source::words;
use super::tree::Tree;

/// Where twins stand, each folder with its own list.
const FOLDERS: [&str; 2] = ["src/kernels/", "src/paper/kernels/"];
const CASES: &str = "tests/gpu/cases/mod.rs";
/// What a shader's head has to say; `ours` (departures) only where there are any.
const FIELDS: &[&str] = &["in", "out", "grid", "tol", "src"];

/// Stems of the shaders that are kernels: `lib/` holds shared pieces, `draw/` the passes.
fn stems(tree: &Tree) -> impl Iterator<Item = &str> {
    let files = tree.below("shaders/").filter_map(|(path, _)| path.strip_prefix("shaders/"));
    files.filter(|name| !name.contains('/')).filter_map(|name| name.strip_suffix(".wgsl"))
}

/// Each shader has a Rust file of its name with a twin, listed in `ALL`, and cases; and the reverse.
pub fn complete(tree: &Tree) -> Vec<String> {
    let mut broken = Vec::new();
    let code: Vec<_> = FOLDERS.iter().flat_map(|folder| tree.rust(folder)).collect();
    let file = |path: &str| code.iter().find(|(p, _)| *p == path).map(|(_, code)| code);
    let cases = tree.text(CASES).unwrap_or_default();
    for stem in stems(tree) {
        let of = |folder: &&&str| file(&format!("{folder}{stem}.rs")).is_some();
        let folder = FOLDERS.iter().find(of).unwrap_or(&FOLDERS[0]);
        let (path, list_path) = (format!("{folder}{stem}.rs"), format!("{folder}mod.rs"));
        match file(&path) {
            None => broken.push(format!("shaders/{stem}.wgsl: no {path}")),
            Some(code) if !defines(code, "twin") => broken.push(format!("{path}: no fn twin")),
            Some(_) => {}
        }
        if words(cases, stem).next().is_none() {
            broken.push(format!("{CASES}: no cases of {stem}"));
        }
        let all = file(&list_path).and_then(|code| list(code));
        if all.is_none_or(|all| words(all, stem).next().is_none()) {
            broken.push(format!("{list_path}: {stem} is not in ALL"));
        }
    }
    let orphans = code.iter().filter_map(|(path, code)| {
        let folder = FOLDERS.iter().find(|f| path.starts_with(**f))?;
        let stem = path.strip_prefix(folder)?.strip_suffix(".rs")?;
        let lost = defines(code, "twin") && !tree.has(&format!("shaders/{stem}.wgsl"));
        lost.then(|| format!("{path}: a twin without shaders/{stem}.wgsl"))
    });
    broken.extend(orphans);
    broken
}

/// What stands between the brackets of `ALL`.
fn list(code: &str) -> Option<&str> {
    let after = &code[words(code, "ALL").next()?..];
    let value = after.split_once('=')?.1;
    value.split_once(';').map(|(list, _)| list)
}

fn defines(code: &str, name: &str) -> bool {
    words(code, name).any(|at| code[..at].trim_end().ends_with("fn"))
}

/// The comment a kernel's shader starts with names it and has every field.
pub fn headers(tree: &Tree) -> Vec<String> {
    let mut broken = Vec::new();
    for stem in stems(tree) {
        let path = format!("shaders/{stem}.wgsl");
        let text = tree.text(&path).unwrap_or_default();
        let head: Vec<_> = text.lines().map_while(|l| l.strip_prefix("//")).collect();
        if !head.first().is_some_and(|l| l.trim_start().starts_with(&format!("{stem}:"))) {
            broken.push(format!("{path}: does not start with `// {stem}: …`"));
        }
        let has = |field: &str| {
            head.iter()
                .filter_map(|l| l.trim_start().split_once(' '))
                .any(|(f, rest)| f == field && !rest.trim().is_empty())
        };
        let lacks = FIELDS.iter().filter(|f| !has(f));
        broken.extend(lacks.map(|f| format!("{path}: its head has no `{f}`")));
    }
    broken
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIST: &str = "src/kernels/mod.rs";
    const SHADER: &str = "// fair: smooths.\n// in   n [V]\n// out  m [V]\n// grid a vertex\n\
                          // tol  1e-5\n// src  someone 1995\n@compute fn main() {}";
    const RUST: &str = "pub fn twin(args: &mut CpuArgs<'_>) {}";
    const OF: &str = "\"fair\" => fair(),";
    const ALL: &str = "pub static ALL: &[&Kernel] = &[&fair::KERNEL];";

    fn tree(shader: &str, rust: &str, all: &str) -> Tree {
        let rust = [("src/kernels/fair.rs", rust), (LIST, all), (CASES, OF)];
        Tree::of(&[&[("shaders/fair.wgsl", shader)], &rust[..]].concat())
    }

    #[test]
    fn a_whole_kernel_is_fine() {
        let tree = tree(SHADER, RUST, ALL);
        assert_eq!([complete(&tree), headers(&tree)].concat(), [""; 0]);
    }

    #[test]
    fn a_kernel_of_the_paper_is_on_the_papers_list() {
        let wing = ("src/paper/kernels/fair.rs", RUST);
        let files = [("shaders/fair.wgsl", SHADER), wing, (CASES, OF), (LIST, ALL)];
        let lost = "src/paper/kernels/mod.rs: fair is not in ALL";
        assert_eq!(complete(&Tree::of(&files)), [lost]);
        let listed = [&files[..], &[("src/paper/kernels/mod.rs", ALL)]].concat();
        assert_eq!(complete(&Tree::of(&listed)), [""; 0]);
    }

    #[test]
    fn a_missing_part_is_caught() {
        assert_eq!(complete(&tree(SHADER, "", ALL)), ["src/kernels/fair.rs: no fn twin"]);
        let uncased = [("shaders/fair.wgsl", SHADER), ("src/kernels/fair.rs", RUST), (LIST, ALL)];
        assert_eq!(complete(&Tree::of(&uncased)), [format!("{CASES}: no cases of fair")]);
        let none = "mod fair;\npub static ALL: &[&Kernel] = &[&affair::KERNEL];\nuse fair::X;";
        assert_eq!(complete(&tree(SHADER, RUST, none)), [format!("{LIST}: fair is not in ALL")]);
    }

    #[test]
    fn shader_and_twin_without_each_other_are_caught() {
        let lone = Tree::of(&[("shaders/a.wgsl", SHADER), ("src/kernels/b.rs", RUST), (LIST, "")]);
        let found = complete(&lone).join("\n");
        assert!(found.contains("shaders/a.wgsl: no src/kernels/a.rs"), "{found}");
        assert!(found.contains("src/kernels/b.rs: a twin without"), "{found}");
        let shared = Tree::of(&[("shaders/lib/x.wgsl", ""), ("shaders/draw/y.wgsl", "")]);
        assert_eq!(complete(&shared), [""; 0]);
    }

    #[test]
    fn a_head_with_a_gap_is_caught() {
        for field in FIELDS {
            let gap = SHADER.replacen(&format!("// {field} "), "// none ", 1);
            let said = headers(&tree(&gap, RUST, ALL));
            assert_eq!(said, [format!("shaders/fair.wgsl: its head has no `{field}`")]);
        }
        let unnamed = SHADER.replacen("fair:", "foul:", 1);
        assert_eq!(headers(&tree(&unnamed, RUST, ALL)).len(), 1);
    }
}

//! Every dependency has its reason beside it.

use super::tree::Tree;

/// Dependencies without a comment on their line or at the head of their group. A group is what
/// follows a comment, up to a blank line or the next table.
pub fn reasons(tree: &Tree) -> Vec<String> {
    let manifests = ["Cargo.toml", "tools/xtask/Cargo.toml"];
    let texts = manifests.iter().filter_map(|path| Some((path, tree.text(path)?)));
    texts.flat_map(|(path, text)| unexplained(path, text)).collect()
}

fn unexplained(path: &str, text: &str) -> Vec<String> {
    let mut broken = Vec::new();
    let (mut listing, mut explained) = (false, false);
    for (n, line) in text.lines().map(str::trim).enumerate() {
        if line.starts_with('[') {
            let table = line.split(']').next().unwrap_or_default().trim_start_matches('[');
            // `[dependencies.NAME]` is a dependency by itself; its comment stands above it.
            let alone = table.split_once("dependencies.").map(|(_, name)| name);
            if let Some(name) = alone.filter(|_| !explained && !line.contains('#')) {
                broken.push(format!("{path}:{}: {name} has no reason", n + 1));
            }
            listing = table.ends_with("dependencies");
            explained = false;
        } else if line.is_empty() {
            explained = false;
        } else if line.starts_with('#') {
            explained = true;
        } else if listing && !explained && !line.contains(" #") {
            let name = line.split(['=', '.']).next().unwrap_or(line).trim();
            if is_name(name) {
                broken.push(format!("{path}:{}: {name} has no reason", n + 1));
            }
        }
    }
    broken
}

/// The continuation of a list over several lines is no dependency.
fn is_name(s: &str) -> bool {
    !s.is_empty() && s.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_may_stand_beside_or_above() {
        let text = "[dependencies]\n# maths\nglam = \"1\"\nrayon = \"1\"\n\npng = \"1\" # frames\n\
                    [features]\nfaults = []\n# one\n[dev-dependencies.proptest]\nversion = \"1\"";
        assert_eq!(unexplained("Cargo.toml", text), [""; 0]);
    }

    #[test]
    fn a_dependency_without_a_reason_is_caught() {
        let text = "[dependencies]\n# maths\nglam = \"1\"\n\nserde = { version = \"1\" }\n\
                    [build-dependencies]\nnaga = \"30\"\n[target.'cfg(unix)'.dependencies]\nlibc.version = \"1\"\n\
                    \n[dependencies.clap]\nversion = \"4\"";
        let found = reasons(&Tree::of(&[("Cargo.toml", text)]));
        let names: Vec<_> = found.iter().map(|f| f.split(' ').nth(1).unwrap()).collect();
        assert_eq!(names, ["serde", "naga", "libc", "clap"]);
    }
}

//! Pictures of patients: only of published volumes, with source and licence beside them.

use super::tree::Tree;

const FOLDER: &str = "docs/pictures/";
const PAGE: &str = "docs/pictures.md";
/// Licences that allow such pictures here.
const LICENCES: &[&str] =
    &["MIT", "Apache-2.0", "BSD-3-Clause", "CC BY 3.0", "CC BY 4.0", "CC0-1.0"];

/// Pictures without a section of the page that names source and licence, or of another licence.
pub fn licensed(tree: &Tree) -> Vec<String> {
    let page = tree.text(PAGE).unwrap_or_default();
    let sections: Vec<&str> = page.split("\n## ").collect();
    let why = |path: &str| {
        let link = format!("({})", path.trim_start_matches("docs/"));
        let Some(section) = sections.iter().find(|s| s.contains(&link)) else {
            return Some("is not on the page");
        };
        let named = |what: &str| section.lines().find_map(|l| l.strip_prefix(what));
        let licence = named("Licence: ").unwrap_or_default().trim_end_matches('.');
        match (named("Source: "), LICENCES.contains(&licence)) {
            (None, _) => Some("has no line `Source: …` in its section"),
            (_, false) => Some("has no line `Licence: …` that allows it"),
            _ => None,
        }
    };
    tree.below(FOLDER)
        .filter_map(|(path, _)| why(path).map(|why| format!("{path} {why} of {PAGE}")))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_without_source_or_licence_is_caught() {
        let check = |page: &str| {
            licensed(&Tree::of(&[("docs/pictures/a.jpg", ""), ("docs/pictures.md", page)])).len()
        };
        let good = "# P\n\n## A\n\nSource: x.\nLicence: MIT.\n\n![a](pictures/a.jpg)\n";
        assert_eq!(check(good), 0);
        assert_eq!(check(&good.replace("Source: x.", "")), 1);
        assert_eq!(check(&good.replace("MIT", "CC BY-NC 4.0")), 1);
        assert_eq!(check(&good.replace("a.jpg", "b.jpg")), 1);
        assert_eq!(check("# P\n\nSource: x.\nLicence: MIT.\n\n## A\n\n![a](pictures/a.jpg)\n"), 1);
    }
}

//! Sizes of committed files.

use super::tree::Tree;

/// Folder, most bytes.
const BUDGETS: &[(&str, usize)] = &[
    ("tests/golden/", 200 * 1024), // a dozen small frames; more would not be looked at
    ("tests/fixtures/", 500_000),  // what tools/oracle holds itself to
    ("docs/pictures/", 1_400_000), // sheets of volumes that may be shown
];

/// Folders over their budget.
pub fn budgets(tree: &Tree) -> Vec<String> {
    let over = BUDGETS.iter().filter_map(|(folder, most)| {
        let bytes: usize = tree.below(folder).map(|(_, bytes)| bytes.len()).sum();
        (bytes > *most).then(|| format!("{folder}: {bytes} bytes, {most} at most"))
    });
    over.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_byte_too_many_is_caught() {
        let full = "x".repeat(200 * 1024);
        assert_eq!(budgets(&Tree::of(&[("tests/golden/a.png", &full)])), [""; 0]);
        let found =
            budgets(&Tree::of(&[("tests/golden/a.png", &full), ("tests/golden/b.png", "x")]));
        assert_eq!(found, ["tests/golden/: 204801 bytes, 204800 at most"]);
    }
}

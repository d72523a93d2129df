//! Sizes of committed files, and of the code.

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

/// Lines of code of `src`: without tests, comments and blank lines.
pub fn code_lines(tree: &Tree) -> usize {
    let is_code = |path: &str| {
        path.ends_with(".rs") && !path.contains("/tests/") && !path.ends_with("/tests.rs")
    };
    let files = tree.below("src/").filter(|(path, _)| is_code(path));
    files.map(|(_, bytes)| code_lines_of(&String::from_utf8_lossy(bytes))).sum()
}

/// Lines of code of one file. A test module ends at the brace that stands under its beginning.
fn code_lines_of(text: &str) -> usize {
    let mut count = 0;
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let code = line.trim();
        if code == "#[cfg(test)]" {
            let item = lines.by_ref().find(|line| !line.trim_start().starts_with("#["));
            if let Some(item) = item.filter(|item| item.ends_with('{')) {
                let indent = item.len() - item.trim_start().len();
                let end = format!("{}}}", " ".repeat(indent));
                lines.by_ref().find(|line| line.starts_with(&end));
            }
        } else if !code.is_empty() && !code.starts_with("//") {
            count += 1;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_comments_and_blank_lines_are_no_code() {
        let text = "//! A.\n\nuse b;\n/// C.\nfn c() {\n    // d\n}\n\n#[cfg(test)]\n\
                    #[allow(x)]\nmod tests {\n    fn t() {}\n}\n#[cfg(test)]\nmod other;\nfn e() {}\n";
        let tree = Tree::of(&[("src/a.rs", text), ("src/a/tests.rs", "fn t() {}\n")]);
        assert_eq!(code_lines(&tree), 4);
    }

    #[test]
    fn one_byte_too_many_is_caught() {
        let full = "x".repeat(200 * 1024);
        assert_eq!(budgets(&Tree::of(&[("tests/golden/a.png", &full)])), [""; 0]);
        let found =
            budgets(&Tree::of(&[("tests/golden/a.png", &full), ("tests/golden/b.png", "x")]));
        assert_eq!(found, ["tests/golden/: 204801 bytes, 204800 at most"]);
    }
}

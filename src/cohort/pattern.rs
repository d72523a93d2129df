//! Patterns of paths: `*` and `?` within a name, `**` for any number of folders.

use std::str::FromStr;

/// A pattern of paths below a folder, such as `sub-*/**/*_CT.nii.gz`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern(Vec<String>);

impl FromStr for Pattern {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<String> = text.split('/').map(str::to_owned).collect();
        if parts.iter().any(|p| matches!(p.as_str(), "" | "." | "..")) {
            return Err("a path below the input folder: names with * and ?, ** for folders".into());
        }
        Ok(Self(parts))
    }
}

impl Pattern {
    /// Whether a path, given by its names from the top folder on, matches.
    pub fn matches(&self, path: &[String]) -> bool {
        matches_path(&self.0, path)
    }
}

impl std::fmt::Display for Pattern {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0.join("/"))
    }
}

/// `reached[i]`: the first `i` names of the path match the parts so far.
fn matches_path(parts: &[String], path: &[String]) -> bool {
    let mut reached = vec![false; path.len() + 1];
    reached[0] = true;
    for part in parts {
        let mut next = vec![false; path.len() + 1];
        if part == "**" {
            let first = reached.iter().position(|r| *r).unwrap_or(reached.len());
            next.iter_mut().skip(first).for_each(|r| *r = true);
        } else {
            for i in 0..path.len() {
                next[i + 1] = reached[i] && matches_name(part, &path[i]);
            }
        }
        reached = next;
    }
    reached[path.len()]
}

/// Linear in the product of lengths, whatever the pattern.
fn matches_name(pattern: &str, name: &str) -> bool {
    let name: Vec<char> = name.chars().collect();
    let mut reached = vec![false; name.len() + 1];
    reached[0] = true;
    for p in pattern.chars() {
        let mut next = vec![false; name.len() + 1];
        if p == '*' {
            let first = reached.iter().position(|r| *r).unwrap_or(reached.len());
            next.iter_mut().skip(first).for_each(|r| *r = true);
        } else {
            for i in 0..name.len() {
                next[i + 1] = reached[i] && (p == '?' || p == name[i]);
            }
        }
        reached = next;
    }
    reached[name.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matches(pattern: &str, path: &str) -> bool {
        let path: Vec<String> = path.split('/').map(str::to_owned).collect();
        pattern.parse::<Pattern>().unwrap().matches(&path)
    }

    #[test]
    fn stars_stay_within_a_name_and_double_stars_cross_folders() {
        let scan = "sub-01/ses-a/anat/sub-01_ses-a_CT.nii.gz";
        assert!(matches("sub-*/**/*_CT.nii.gz", scan));
        assert!(matches("sub-*/**/*_CT.nii.gz", "sub-01/sub-01_CT.nii.gz"));
        assert!(matches("**", scan) && matches("**/*.gz", scan));
        assert!(matches("sub-0?/ses-*/anat/*", scan));
        assert!(!matches("sub-*/*_CT.nii.gz", scan), "one star is no folder");
        assert!(!matches("sub-*/**/*_CT.nii", scan));
        assert!(!matches("sub-?/**", scan));
        assert!(!matches("*", "a/b") && matches("*", "a"));
    }

    #[test]
    fn a_pattern_of_many_stars_is_decided_quickly() {
        let name = "a".repeat(200);
        assert!(!matches(&format!("{}b", "*a".repeat(100)), &name));
    }

    #[test]
    fn patterns_stay_below_the_folder() {
        for bad in ["", "/etc/*", "../*", "a//b", "a/./b", "a/"] {
            assert!(bad.parse::<Pattern>().is_err(), "{bad}");
        }
    }
}

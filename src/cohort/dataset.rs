//! The folder of outputs: places of its files, and what makes it a derivative dataset of BIDS.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{Case, CaseNames, CohortError};
use crate::formats::{FormatError, NOTICE, atomic_file, read_plain, to_pretty_json};

/// Version of BIDS that outputs follow.
const BIDS_VERSION: &str = "1.11.0";
/// Name of the program among those that made a dataset.
const GENERATOR: &str = "intima";
/// Files that BIDS has no name for yet, for its validator to pass over. A pattern of a folder that
/// ends in a slash would not match.
const IGNORED: &str = "\
*.vtp
*.ply
*.csv
*.mrk.json
*.html
*_map.nrrd
sub-*/**/*_report.json
figures
logs/
quality.tsv
";
/// Largest description of a dataset that is read.
const MAX_DESCRIPTION: u64 = 1 << 20;

/// A folder of outputs.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// The folder.
    pub folder: PathBuf,
}

impl Dataset {
    /// A folder of outputs, made if it is not there.
    ///
    /// * `input`: folder of the cases, which nothing is written into.
    ///
    /// # Errors
    /// [`CohortError::Output`] for the input itself and for a dataset that somebody else made.
    pub fn open(folder: &Path, input: &Path) -> Result<Self, CohortError> {
        let refuse =
            |why: &str| Err(CohortError::Output { folder: folder.to_owned(), why: why.to_owned() });
        let real = |path: &Path| path.canonicalize().ok();
        if let (Some(out), Some(input)) = (real(folder), real(input)) {
            if out == input {
                return refuse("it is the input, which stays as it is");
            }
            if input.starts_with(&out) {
                return refuse("the input lies in it");
            }
        }
        let file = folder.join("dataset_description.json");
        if file.exists() && !is_ours(&file) {
            return refuse("it holds a dataset that another program made");
        }
        std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Writes the description of the dataset and the list of files for validators to pass over.
    ///
    /// * `names`: an input whose paths are hashed is not linked to, unless only by steps upwards.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn describe(&self, input: &Path, names: CaseNames) -> Result<(), FormatError> {
        let link = link(&self.folder, input);
        let shows_path = names == CaseNames::Hash && link.starts_with("file:");
        let links = if shows_path { json!({}) } else { json!({ "raw": link }) };
        let description = json!({
            "Name": "Virtual endoscopy by intima",
            "BIDSVersion": BIDS_VERSION,
            "DatasetType": "derivative",
            "License": "as of the source dataset",
            "GeneratedBy": [{
                "Name": GENERATOR,
                "Version": env!("CARGO_PKG_VERSION"),
                "Description": NOTICE,
            }],
            "DatasetLinks": links,
        });
        let text = to_pretty_json(&description).expect("a value is JSON") + "\n";
        self.write_if_changed("dataset_description.json", &text)?;
        self.write_if_changed(".bidsignore", IGNORED)
    }

    fn write_if_changed(&self, name: &str, text: &str) -> Result<(), FormatError> {
        let path = self.folder.join(name);
        if std::fs::read(&path).is_ok_and(|old| old == text.as_bytes()) {
            return Ok(());
        }
        atomic_file::write_atomic(&path, |o| o.write_all(text.as_bytes()))
    }

    /// Folder of a case's records: status, lock, messages.
    pub fn logs(&self, case: &str) -> PathBuf {
        self.folder.join("logs").join(case)
    }

    /// The status of a case.
    pub fn status(&self, case: &str) -> PathBuf {
        self.logs(case).join("status.json")
    }

    /// Names of cases that have records, in order.
    pub fn recorded(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.join("logs")).into_iter().flatten().flatten();
        let name = |e: std::fs::DirEntry| e.file_name().into_string().ok();
        let mut all: Vec<String> = entries.filter_map(name).filter(|n| is_case_name(n)).collect();
        all.retain(|n| self.status(n).is_file());
        all.sort();
        all
    }

    /// Folder of a participant's, or of its session's, outputs, below the dataset.
    pub(super) fn folder_of(case: &Case) -> String {
        let session = case.session().map(|s| format!("/{s}")).unwrap_or_default();
        format!("{}{session}", case.participant())
    }
}

/// Whether a name is one that a case may have: nothing else is joined to a path.
fn is_case_name(name: &str) -> bool {
    name.starts_with("sub-")
        && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
}

fn is_ours(description: &Path) -> bool {
    let bytes = read_plain(description, MAX_DESCRIPTION).unwrap_or_default();
    let value: Value = serde_json::from_slice(&bytes).unwrap_or_default();
    let names = value["GeneratedBy"].as_array().into_iter().flatten();
    names.into_iter().any(|by| by["Name"] == GENERATOR)
}

/// Address of the source dataset: relative where the outputs lie within it, else whole.
fn link(out: &Path, input: &Path) -> String {
    let (Ok(out), Ok(input)) = (out.canonicalize(), input.canonicalize()) else {
        return String::new();
    };
    match out.strip_prefix(&input) {
        Ok(below) => vec![".."; below.components().count()].join("/"),
        Err(_) => format!("file://{}", encoded(&input.to_string_lossy())),
    }
}

/// A path within an address: all but unreserved characters and slashes as percent escapes (RFC 3986).
pub(super) fn encoded(path: &str) -> String {
    let mut out = String::with_capacity(path.len());
    for byte in path.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => {
                out.push(char::from(byte));
            }
            _ => out += &format!("%{byte:02X}"),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn input_and_datasets_of_others_are_no_place_for_outputs() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for name in ["in/derivatives/ours", "theirs"] {
            std::fs::create_dir_all(at(name)).unwrap();
        }
        let open = |out: &str| Dataset::open(&at(out), &at("in"));
        assert!(open("in").is_err() && open("in/../in").is_err());
        assert!(Dataset::open(dir.path(), &at("in")).is_err(), "the input lies in it");
        std::fs::write(at("theirs/dataset_description.json"), "{\"Name\": \"raw\"}").unwrap();
        assert!(matches!(open("theirs"), Err(CohortError::Output { .. })));
        let ours = open("in/derivatives/ours").unwrap();
        ours.describe(&at("in"), CaseNames::Hash).unwrap();
        assert!(open("in/derivatives/ours").is_ok(), "our own is taken again");
        let text = std::fs::read(at("in/derivatives/ours/dataset_description.json")).unwrap();
        let value: Value = serde_json::from_slice(&text).unwrap();
        assert_eq!(value["DatasetLinks"]["raw"], "../..");
        assert_eq!(value["DatasetType"], "derivative");
    }

    #[test]
    fn the_path_of_an_input_whose_names_are_hashed_is_not_in_the_description() {
        let dir = tempfile::tempdir().unwrap();
        let (input, out) = (dir.path().join("Doe^Jane"), dir.path().join("out"));
        std::fs::create_dir(&input).unwrap();
        let dataset = Dataset::open(&out, &input).unwrap();
        let links = |names: CaseNames| {
            dataset.describe(&input, names).unwrap();
            let text = std::fs::read(out.join("dataset_description.json")).unwrap();
            serde_json::from_slice::<Value>(&text).unwrap()["DatasetLinks"].clone()
        };
        assert!(links(CaseNames::Folder)["raw"].as_str().unwrap().ends_with("/Doe%5EJane"));
        assert_eq!(links(CaseNames::Hash), json!({}));
    }

    #[test]
    fn only_names_of_cases_are_taken_from_the_folder_of_records() {
        let dir = tempfile::tempdir().unwrap();
        let data = Dataset { folder: dir.path().to_owned() };
        for name in ["sub-1", "sub-2", "sub-<b>", "other"] {
            std::fs::create_dir_all(data.logs(name)).unwrap();
            std::fs::write(data.logs(name).join("status.json"), "{}").unwrap();
        }
        std::fs::create_dir_all(data.logs("sub-3")).unwrap();
        assert_eq!(data.recorded(), ["sub-1", "sub-2"]);
    }
}

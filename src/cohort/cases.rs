//! The cases of a BIDS dataset or of a plain folder.

use std::collections::{BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

use super::labels::{clean, short_hash, told_apart};
use super::{CohortError, Pattern};
use crate::formats::FormatError;

/// Entries of folders that are looked at, at most.
const MAX_ENTRIES: usize = 4_000_000;
/// Folders below the one that is searched, at most.
const MAX_DEPTH: usize = 12;
/// Volumes that a plain folder may hold beside folders.
const VOLUME_FILES: [&str; 9] =
    [".nii.gz", ".nii", ".nrrd", ".nhdr", ".mha", ".mhd", ".hdr", ".dcm", ".ima"];
/// Scans of a BIDS dataset where no pattern is given. BIDS 1.11 has no suffix for CT; this one is
/// what the specification's open proposal names.
const BIDS_SCANS: [&str; 2] = ["sub-*/**/*_CT.nii.gz", "sub-*/**/*_CT.nii"];

/// A scan and its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Case {
    /// Name in files: entities of BIDS, `sub-01` or `sub-01_ses-2_run-1`. Letters, digits, `-` and
    /// `_` alone.
    pub name: String,
    /// File or DICOM folder.
    pub input: PathBuf,
    /// Path below the dataset's folder, for records; `None` where names are hashed.
    pub source: Option<String>,
}

impl Case {
    /// Participant: `sub-` and a label.
    pub fn participant(&self) -> &str {
        self.name.split('_').next().unwrap_or(&self.name)
    }

    /// Session, `ses-` and a label, if it has one.
    pub fn session(&self) -> Option<&str> {
        self.name.split('_').find(|part| part.starts_with("ses-"))
    }
}

/// Source of the names of cases that no BIDS name gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum CaseNames {
    /// Letters and digits of the file's or folder's name.
    #[default]
    Folder,
    /// Hash of the path, where names of folders may be those of patients.
    Hash,
}

/// Cases that are wanted.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Paths of scans; by the kind of folder where `None`.
    pub pattern: Option<Pattern>,
    /// Labels of participants; all where empty.
    pub participants: Vec<String>,
    /// Labels of sessions; all where empty.
    pub sessions: Vec<String>,
    /// Names of cases; all where empty.
    pub cases: Vec<String>,
    /// Source of names.
    pub names: CaseNames,
}

/// A path that was found: its names below the top folder.
struct FoundScan {
    names: Vec<String>,
    path: PathBuf,
}

/// The cases of a folder, in the order of their names.
///
/// With a pattern every file or folder that it matches is a case. Without one, of a BIDS dataset (a
/// folder with `dataset_description.json`) every `*_CT.nii[.gz]` below `sub-*` is; of another
/// folder every folder (of DICOM files) and every volume directly in it.
///
/// * `out`: folder of outputs, which is passed over where it lies within.
///
/// # Errors
/// [`CohortError`].
pub fn find_cases(
    folder: &Path,
    out: &Path,
    selection: &Selection,
) -> Result<Vec<Case>, CohortError> {
    let is_bids = folder.join("dataset_description.json").is_file();
    let (mut found, wanted) = match &selection.pattern {
        Some(p) => (search(folder, out, std::slice::from_ref(p))?, p.to_string()),
        None if is_bids => {
            let patterns = BIDS_SCANS.map(|p| p.parse().expect("a pattern"));
            (search(folder, out, &patterns)?, format!("{}; a pattern finds others", BIDS_SCANS[0]))
        }
        None => (top_level(folder, out)?, "a DICOM folder or a volume in it".to_owned()),
    };
    found.sort_by(|a, b| a.names.cmp(&b.names));
    if found.is_empty() {
        let why = format!("looked for {wanted}");
        return Err(CohortError::NoCases { folder: folder.to_owned(), why });
    }
    let mut cases = named(found, selection.names);
    cases.sort_by(|a, b| a.name.cmp(&b.name));
    chosen(folder, cases, selection)
}

fn chosen(folder: &Path, all: Vec<Case>, by: &Selection) -> Result<Vec<Case>, CohortError> {
    let labels = |list: &[String]| list.iter().map(|l| clean(l)).collect::<Vec<_>>();
    let (participants, sessions) = (labels(&by.participants), labels(&by.sessions));
    let none = |kind, label: &str| CohortError::NoSuchLabel {
        folder: folder.to_owned(),
        kind,
        label: label.to_owned(),
    };
    let participant = |c: &Case| clean(c.participant());
    let session = |c: &Case| c.session().map(clean).unwrap_or_default();
    let missing = |list: &[String], label: &dyn Fn(&Case) -> String| {
        list.iter().find(|l| !all.iter().any(|c| label(c) == **l)).cloned()
    };
    type Label<'a> = &'a dyn Fn(&Case) -> String;
    let lists: [(_, _, Label<'_>); 3] = [
        ("participant", participants, &participant),
        ("session", sessions, &session),
        ("name", by.cases.clone(), &|c| c.name.clone()),
    ];
    for (kind, list, label) in &lists {
        if let Some(label) = missing(list, label) {
            return Err(none(kind, label.as_str()));
        }
    }
    let is_wanted =
        |c: &Case| lists.iter().all(|(_, list, label)| list.is_empty() || list.contains(&label(c)));
    let cases: Vec<Case> = all.iter().filter(|c| is_wanted(c)).cloned().collect();
    if cases.is_empty() {
        let why = "no case has one of the participants, sessions and names".to_owned();
        return Err(CohortError::NoCases { folder: folder.to_owned(), why });
    }
    Ok(cases)
}

/// Names of cases, each different from all others.
fn named(found: Vec<FoundScan>, names: CaseNames) -> Vec<Case> {
    let sources: Vec<String> = found.iter().map(|f| f.names.join("/")).collect();
    let name = |(f, source): (&FoundScan, &String)| match names {
        CaseNames::Hash => (format!("sub-{}", short_hash(source.as_bytes())), false),
        CaseNames::Folder => case_name(&f.names),
    };
    let wished: Vec<(String, bool)> = found.iter().zip(&sources).map(name).collect();
    let wished = wished.into_iter().zip(&sources).map(|((n, exact), s)| (n, s.as_bytes(), exact));
    let told = told_apart(wished.collect());
    let source = |s: String| (names == CaseNames::Folder).then_some(s);
    let case = |((f, name), s): ((FoundScan, String), String)| Case {
        name,
        input: f.path,
        source: source(s),
    };
    found.into_iter().zip(told).zip(sources).map(case).collect()
}

/// Name of a case, and whether its path spells it like that.
fn case_name(path: &[String]) -> (String, bool) {
    let last = path.last().map_or("", String::as_str);
    let lower = last.to_ascii_lowercase();
    let extension = VOLUME_FILES.iter().find(|e| lower.ends_with(*e)).map_or(0, |e| e.len());
    let stem = &last[..last.len() - extension];
    if let Some(entities) = bids_entities(stem) {
        return (entities, true);
    }
    let folders = &path[..path.len() - 1];
    let label: String = folders.iter().map(|f| clean(f)).chain([clean(stem)]).collect();
    let label = clean(&label);
    let is_exact = folders.is_empty() && (label == stem || format!("sub-{label}") == stem);
    (format!("sub-{label}"), is_exact)
}

/// Entities of a BIDS name, without its suffix: `sub-01_ses-2_CT` gives `sub-01_ses-2`.
fn bids_entities(stem: &str) -> Option<String> {
    let (entities, suffix) = stem.rsplit_once('_')?;
    let is_word = |s: &str| !s.is_empty() && s.chars().all(|c| c.is_ascii_alphanumeric());
    let is_entity =
        |part: &str| part.split_once('-').is_some_and(|(k, v)| is_word(k) && is_word(v));
    let valid = entities.starts_with("sub-")
        && entities.len() <= 128
        && entities.split('_').all(is_entity)
        && is_word(suffix);
    valid.then(|| entities.to_owned())
}

/// Folders and volumes directly in a folder.
fn top_level(folder: &Path, out: &Path) -> Result<Vec<FoundScan>, CohortError> {
    let is_volume = |name: &str| {
        let name = name.to_ascii_lowercase();
        VOLUME_FILES.iter().any(|e| name.len() > e.len() && name.ends_with(e))
    };
    let entries = entries(folder, out, &mut 0)?;
    let is_case = |e: &(String, PathBuf)| e.1.is_dir() || (e.1.is_file() && is_volume(&e.0));
    let found = |(name, path)| FoundScan { names: vec![name], path };
    Ok(entries.into_iter().filter(is_case).map(found).collect())
}

/// Files and folders that a pattern matches. Nothing within a match is searched, and a folder that
/// links lead to again is searched once.
fn search(folder: &Path, out: &Path, patterns: &[Pattern]) -> Result<Vec<FoundScan>, CohortError> {
    let (mut found, mut count) = (Vec::new(), 0);
    let mut seen = BTreeSet::new();
    let mut folders = VecDeque::from([(Vec::new(), folder.to_owned())]);
    while let Some((names, at)) = folders.pop_front() {
        let real = at.canonicalize().map_err(|e| FormatError::io(&at, e))?;
        if !seen.insert(real) {
            continue;
        }
        for (name, path) in entries(&at, out, &mut count)? {
            let names: Vec<String> = names.iter().cloned().chain([name]).collect();
            if patterns.iter().any(|p| p.matches(&names)) {
                found.push(FoundScan { names, path });
            } else if names.len() < MAX_DEPTH && path.is_dir() && names != ["derivatives"] {
                folders.push_back((names, path));
            }
        }
    }
    Ok(found)
}

/// Names and paths in a folder in their order, without hidden ones and the folder of outputs.
fn entries(
    folder: &Path,
    out: &Path,
    count: &mut usize,
) -> Result<Vec<(String, PathBuf)>, CohortError> {
    let io = |e| FormatError::io(folder, e);
    let out = out.canonicalize().ok();
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        *count += 1;
        if *count > MAX_ENTRIES {
            return Err(CohortError::TooMany { folder: folder.to_owned(), limit: MAX_ENTRIES });
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let is_out = out.is_some() && path.canonicalize().ok() == out;
        if !name.starts_with('.') && !is_out {
            all.push((name, path));
        }
    }
    all.sort();
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(files: &[&str]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for file in files {
            let path = dir.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        dir
    }

    fn names(dir: &Path, by: &Selection) -> Vec<String> {
        let found = find_cases(dir, &dir.join("derivatives/intima"), by).unwrap();
        found.into_iter().map(|c| c.name).collect()
    }

    #[test]
    fn a_bids_dataset_names_cases_by_their_entities() {
        let dir = tree(&[
            "dataset_description.json",
            "sub-02/anat/sub-02_CT.nii.gz",
            "sub-01/ses-a/anat/sub-01_ses-a_run-1_CT.nii.gz",
            "sub-01/ses-a/anat/sub-01_ses-a_run-2_CT.nii.gz",
            "sub-01/ses-a/anat/sub-01_ses-a_run-2_CT.json",
            "sub-01/ses-b/anat/sub-01_ses-b_T1w.nii.gz",
            "derivatives/other/sub-09/anat/sub-09_CT.nii.gz",
            "sourcedata/sub-03/a.dcm",
        ]);
        let all = names(dir.path(), &Selection::default());
        assert_eq!(all, ["sub-01_ses-a_run-1", "sub-01_ses-a_run-2", "sub-02"]);
        let mr = Selection { pattern: "sub-*/**/*_T1w.nii.gz".parse().ok(), ..Default::default() };
        assert_eq!(names(dir.path(), &mr), ["sub-01_ses-b"]);
        for label in ["02", "sub-02"] {
            let one = Selection { participants: vec![label.into()], ..Default::default() };
            assert_eq!(names(dir.path(), &one), ["sub-02"], "{label}");
        }
        let session = Selection { sessions: vec!["a".into()], ..Default::default() };
        assert_eq!(names(dir.path(), &session).len(), 2);
        let none = Selection { participants: vec!["07".into()], ..Default::default() };
        let error = find_cases(dir.path(), dir.path(), &none).unwrap_err();
        assert!(matches!(error, CohortError::NoSuchLabel { label, .. } if label == "07"));
    }

    #[test]
    fn a_plain_folder_gives_a_case_to_each_folder_and_volume() {
        let dir = tree(&[
            "scan A/1.dcm",
            "b_2.nii.gz",
            "c.mhd",
            "c.raw",
            "README.md",
            ".hidden/1.dcm",
            "derivatives/intima/logs/x",
        ]);
        std::fs::remove_dir_all(dir.path().join("derivatives/intima/logs")).unwrap();
        let out = dir.path().join("derivatives");
        let cases = find_cases(dir.path(), &out, &Selection::default()).unwrap();
        let all: Vec<&str> = cases.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(all, ["sub-b2", "sub-c", "sub-scanA"]);
        assert_eq!(cases[2].source.as_deref(), Some("scan A"));
        let hashed = Selection { names: CaseNames::Hash, ..Default::default() };
        for case in find_cases(dir.path(), &out, &hashed).unwrap() {
            assert!(case.source.is_none() && case.name.len() == 12, "{case:?}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn names_that_no_file_system_should_hold_give_safe_different_names() {
        use std::os::unix::ffi::OsStrExt as _;
        let dir = tempfile::tempdir().unwrap();
        let hostile: [&[u8]; 6] =
            [b"<img src=x>", b"a\nb", b"a b", b"--out", b"\xff\xfe", b"$(rm -rf .)"];
        for name in hostile {
            let name = std::ffi::OsStr::from_bytes(name);
            std::fs::create_dir(dir.path().join(name)).unwrap();
        }
        let found = find_cases(dir.path(), &dir.path().join("o"), &Selection::default()).unwrap();
        let names: BTreeSet<String> = found.iter().map(|c| c.name.to_ascii_lowercase()).collect();
        assert_eq!(names.len(), hostile.len());
        let is_safe = |c: char| c.is_ascii_alphanumeric() || c == '-';
        assert!(names.iter().all(|n| n.starts_with("sub-") && n.chars().all(is_safe)), "{names:?}");
    }

    #[cfg(unix)]
    #[test]
    fn links_in_a_circle_end() {
        let dir = tree(&["dataset_description.json", "sub-1/anat/sub-1_CT.nii.gz"]);
        std::os::unix::fs::symlink(dir.path(), dir.path().join("sub-1/loop")).unwrap();
        assert_eq!(names(dir.path(), &Selection::default()), ["sub-1"]);
    }
}

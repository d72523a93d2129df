//! `status.json`, schema `intima.status/1`: how a case ended, and by what it can be told whether
//! its outputs are those of the present input and settings.

use std::path::Path;
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};

use super::key::{SCHEMA, hash_file};
use crate::formats::{FormatError, atomic_file, read_plain, to_pretty_json};

/// Largest status that is read: a flight has up to 100,000 frames, of about 150 bytes each here.
const MAX_BYTES: u64 = 64 << 20;

/// End of a case.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CaseStatus {
    /// Name and version of this layout.
    pub schema: String,
    /// Name of the case.
    pub case: String,
    /// Path of its input below the dataset; absent where names are hashed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Key of its input and settings; absent where the input could not be read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    /// Exit code: 0 done, else as of the command line; 128 and the number of a signal.
    pub exit_code: i32,
    /// Code of a failure, such as `lumen/seed-outside`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// Text of a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Version of the program.
    pub version: String,
    /// Identity of its build.
    pub build: String,
    /// Device as it was asked for.
    pub device: String,
    /// Settings after defaults.
    pub settings: String,
    /// Wall time of the case with all reading and writing.
    pub seconds: f64,
    /// Files that were read, in the order of their paths.
    #[serde(default)]
    pub inputs: Vec<InputFile>,
    /// Files that were written.
    #[serde(default)]
    pub outputs: Vec<OutputFile>,
}

/// A file that was read; without its name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InputFile {
    /// Size.
    pub bytes: u64,
    /// Time of its last change, nanoseconds since 1970.
    pub modified_ns: u64,
    /// Hash of its bytes.
    pub blake3: String,
}

/// A file that was written.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Path below the folder of outputs.
    pub path: String,
    /// Size.
    pub bytes: u64,
    /// Hash of its bytes.
    pub blake3: String,
}

/// Check of what an earlier run has left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Check {
    /// Sizes of outputs; inputs are read again where size or time of a file has changed.
    #[default]
    Quick,
    /// Hashes of all outputs and inputs.
    Verify,
    /// Not at all: every case is run again.
    Off,
}

impl InputFile {
    /// Size, time and hash of a file; the hash that is known where size and time are the same.
    pub(super) fn of(path: &Path, known: Option<&Self>) -> Result<Self, FormatError> {
        let io = |e| FormatError::io(path, e);
        let meta = std::fs::metadata(path).map_err(io)?;
        let since = meta.modified().map_err(io)?.duration_since(UNIX_EPOCH).unwrap_or_default();
        let (bytes, modified_ns) = (meta.len(), since.as_nanos() as u64);
        let is_same = |k: &&Self| k.bytes == bytes && k.modified_ns == modified_ns;
        let blake3 = match known.filter(is_same) {
            Some(known) => known.blake3.clone(),
            None => hash_file(path)?,
        };
        Ok(Self { bytes, modified_ns, blake3 })
    }
}

impl OutputFile {
    /// Size and hash of a file below the folder of outputs.
    pub(super) fn of(out: &Path, path: &str) -> Result<Self, FormatError> {
        let file = out.join(path);
        let bytes = std::fs::metadata(&file).map_err(|e| FormatError::io(&file, e))?.len();
        Ok(Self { path: path.to_owned(), bytes, blake3: hash_file(&file)? })
    }

    /// Whether the file is there as it was written.
    fn is_there(&self, out: &Path, check: Check) -> bool {
        let file = out.join(&self.path);
        let has_size = std::fs::metadata(&file).is_ok_and(|m| m.is_file() && m.len() == self.bytes);
        let has_bytes = || hash_file(&file).is_ok_and(|h| h == self.blake3);
        has_size && (check != Check::Verify || has_bytes())
    }
}

impl CaseStatus {
    /// Reads a status. One that is not there, or is none of this schema, is `None`: its case has
    /// not ended.
    pub fn read(path: &Path) -> Option<Self> {
        let bytes = read_plain(path, MAX_BYTES).ok()?;
        serde_json::from_slice(&bytes).ok().filter(|s: &Self| s.schema == SCHEMA)
    }

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FormatError> {
        let status = Self { schema: SCHEMA.to_owned(), ..self.clone() };
        let text =
            to_pretty_json(&status).map_err(|e| FormatError::io(path, std::io::Error::other(e)))?;
        atomic_file::write_atomic(path, |o| o.write_all(text.as_bytes()))
    }

    /// Whether the case ended well.
    pub fn is_success(&self) -> bool {
        self.exit_code == 0
    }

    /// Whether the outputs are there, of this key.
    ///
    /// * `out`: folder of outputs.
    pub fn is_done(&self, key: &str, out: &Path, check: Check) -> bool {
        self.is_success()
            && check != Check::Off
            && self.key.as_deref() == Some(key)
            && self.outputs.iter().all(|file| file.is_there(out, check))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_done_with_its_key_and_all_its_outputs() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a"), "abc").unwrap();
        let status = CaseStatus {
            key: Some("k".into()),
            outputs: vec![OutputFile::of(dir.path(), "a").unwrap()],
            ..CaseStatus::default()
        };
        let path = dir.path().join("status.json");
        status.write(&path).unwrap();
        let status = CaseStatus::read(&path).unwrap();
        let done = |key: &str, check| status.is_done(key, dir.path(), check);
        assert!(done("k", Check::Quick) && done("k", Check::Verify));
        assert!(!done("other", Check::Quick) && !done("k", Check::Off));
        assert!(!CaseStatus { exit_code: 3, ..status.clone() }.is_done(
            "k",
            dir.path(),
            Check::Quick
        ));
        std::fs::write(dir.path().join("a"), "xyz").unwrap();
        assert!(done("k", Check::Quick) && !done("k", Check::Verify), "same size, other bytes");
        std::fs::write(dir.path().join("a"), "ab").unwrap();
        assert!(!done("k", Check::Quick));
        std::fs::remove_file(dir.path().join("a")).unwrap();
        assert!(!done("k", Check::Quick));
    }

    #[test]
    fn half_a_status_is_none() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("status.json");
        assert_eq!(CaseStatus::read(&path), None);
        for text in ["", "{\"schema\": \"intima.status/1\", \"ca", "[]", "{\"schema\":\"x\"}"] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(CaseStatus::read(&path), None, "{text}");
        }
    }
}

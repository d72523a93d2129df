//! The key of a case: a hash of everything that decides its outputs.

use std::path::{Path, PathBuf};

use super::{Case, InputFile};
use crate::formats::{FormatError, input_files, names_are_places, open_plain};

/// Schema of a status, and the first thing in a key.
pub(super) const SCHEMA: &str = "intima.status/1";

/// Key of a case, in hexadecimal digits.
pub type Key = String;

/// Everything beside the input that decides the outputs of a case.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recipe {
    /// Identity of the program's build.
    pub build: String,
    /// Settings after defaults, as text; without those that change no output (threads, limits of
    /// memory, caches, paths).
    pub settings: String,
    /// Device as it was asked for: `auto` takes whichever there is.
    pub device: String,
}

impl Recipe {
    /// The key of a case and its input files. Names and places of files are not in it, but for the names
    /// of chunks, which say where their samples lie.
    ///
    /// * `known`: what an earlier status says of the input. Where the number of files, and size and
    ///   time of a file, are the same, so is its hash; with `None` all bytes are read.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn key(
        &self,
        case: &Case,
        known: Option<&[InputFile]>,
    ) -> Result<(Key, Vec<InputFile>), FormatError> {
        let files = input_files(&case.input)?;
        let known = known.filter(|k| k.len() == files.len());
        let inputs: Vec<InputFile> = files
            .iter()
            .enumerate()
            .map(|(i, path)| InputFile::of(path, known.map(|k| &k[i])))
            .collect::<Result<_, _>>()?;
        let has_places = names_are_places(&case.input);
        let hash = |(file, path): (&InputFile, &PathBuf)| match path.strip_prefix(&case.input) {
            Ok(name) if has_places => format!("{} {}", file.blake3, name.display()),
            _ => file.blake3.clone(),
        };
        let mut hashes: Vec<String> = inputs.iter().zip(&files).map(hash).collect();
        hashes.sort_unstable();
        let mut hasher = blake3::Hasher::new();
        let recipe = [SCHEMA, &self.build, &self.settings, &self.device];
        for part in recipe.into_iter().chain(hashes.iter().map(String::as_str)) {
            // With its length, so that no two lists of parts are the same bytes.
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        }
        Ok((hasher.finalize().to_hex().to_string(), inputs))
    }
}

/// BLAKE3 of a file.
pub(super) fn hash_file(path: &Path) -> Result<String, FormatError> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(open_plain(path)?).map_err(|e| FormatError::io(path, e))?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// Identity of this build of the program: the hash of its executable, as one version is many builds
/// while it is worked on. Where the file cannot be read, the version.
pub fn build_id() -> String {
    let executable = std::env::current_exe().ok();
    let hash = executable.and_then(|path| hash_file(&path).ok());
    hash.map_or_else(|| env!("CARGO_PKG_VERSION").to_owned(), |h| h[..16].to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe() -> Recipe {
        Recipe { build: "b".into(), settings: "s".into(), device: "cpu".into() }
    }

    #[test]
    fn a_key_follows_bytes_and_settings_and_not_names_or_times() {
        let dir = tempfile::tempdir().unwrap();
        let case = |name: &str, files: &[(&str, &str)]| {
            let input = dir.path().join(name);
            std::fs::create_dir_all(&input).unwrap();
            files.iter().for_each(|(n, text)| std::fs::write(input.join(n), text).unwrap());
            Case { name: "sub-1".into(), input, source: None }
        };
        let key = |case: &Case, recipe: &Recipe| recipe.key(case, None).unwrap().0;
        let a = case("a", &[("1", "x"), ("2", "y")]);
        let same = key(&a, &recipe());
        assert_eq!(key(&case("b", &[("7", "y"), ("8", "x")]), &recipe()), same);
        assert_ne!(key(&case("c", &[("1", "xy")]), &recipe()), same);
        assert_ne!(key(&case("d", &[("1", "x"), ("2", "y"), ("3", "")]), &recipe()), same);
        for other in [
            Recipe { build: "c".into(), ..recipe() },
            Recipe { settings: "t".into(), ..recipe() },
            Recipe { device: "auto".into(), ..recipe() },
            Recipe { build: "bs".into(), settings: String::new(), ..recipe() },
        ] {
            assert_ne!(key(&a, &other), same, "{other:?}");
        }
    }

    #[test]
    fn a_known_hash_stands_while_size_and_time_do() {
        let dir = tempfile::tempdir().unwrap();
        let input = dir.path().join("a.nrrd");
        std::fs::write(&input, "x").unwrap();
        let case = Case { name: "sub-1".into(), input: input.clone(), source: None };
        let (key, mut known) = recipe().key(&case, None).unwrap();
        known[0].blake3 = "planted".into();
        assert_ne!(recipe().key(&case, Some(&known)).unwrap().0, key, "the known hash is taken");
        std::fs::write(&input, "xx").unwrap();
        let (longer, files) = recipe().key(&case, Some(&known)).unwrap();
        assert!(longer != key && files[0].blake3 != "planted" && files[0].bytes == 2);
    }

    #[test]
    fn chunks_of_a_zarr_array_that_changed_places_change_the_key() {
        let dir = tempfile::tempdir().unwrap();
        let array = serde_json::json!({
            "zarr_format": 2, "shape": [2, 2, 2], "chunks": [1, 2, 2], "dtype": "|u1",
            "compressor": null, "fill_value": 0, "order": "C", "filters": null,
            "dimension_separator": "."
        });
        let case = |name: &str, layers: [[u8; 4]; 2]| {
            let input = dir.path().join(name);
            std::fs::create_dir_all(&input).unwrap();
            std::fs::write(input.join(".zarray"), array.to_string()).unwrap();
            let layers = ["0.0.0", "1.0.0"].into_iter().zip(layers);
            layers.for_each(|(n, bytes)| std::fs::write(input.join(n), bytes).unwrap());
            Case { name: "sub-1".into(), input, source: None }
        };
        let key = |case: &Case| recipe().key(case, None).unwrap().0;
        let (a, b) = ([1, 2, 3, 4], [5, 6, 7, 8]);
        let upright = key(&case("a", [a, b]));
        assert_eq!(key(&case("b", [a, b])), upright);
        assert_ne!(key(&case("c", [b, a])), upright);
    }
}

//! Title of the window.

use std::path::Path;

use super::Viewer;
use super::open_case::OpenCase;
use crate::formats::shown;
use crate::session::{Source, VolumeSource};

impl Viewer {
    /// The window's title: names of the files or folders that are open, nothing of their contents.
    pub fn title(&self) -> String {
        let names = self.cases.iter().filter_map(OpenCase::name);
        names.chain(["intima".to_owned()]).collect::<Vec<_>>().join(" - ")
    }
}

impl OpenCase {
    /// Name of the file or folder that is open.
    pub(super) fn name(&self) -> Option<String> {
        self.computation.as_ref().and_then(|c| file_name(c.session.source()))
    }

    /// Begins the name of an exported file with that of the case, so that no two cases are mixed up.
    pub(super) fn file_stem(&self, kind: &str) -> String {
        let name = self.options.source.as_ref().and_then(file_name);
        let case = name.as_deref().map(without_extensions).filter(|case| !case.is_empty());
        case.map_or(kind.into(), |case| format!("{case}-{kind}"))
    }
}

/// A file's name up to the endings of volumes, with characters that every system has in names.
fn without_extensions(name: &str) -> String {
    const ENDINGS: [&str; 9] =
        [".gz", ".nii", ".nrrd", ".nhdr", ".mha", ".mhd", ".dcm", ".zarr", ".seg"];
    let mut stem = name;
    while let Some(shorter) = ENDINGS.iter().find_map(|ending| stem.strip_suffix(ending)) {
        stem = shorter;
    }
    let is_plain = |c: char| c.is_alphanumeric() || "._-".contains(c);
    stem.chars().map(|c| if is_plain(c) { c } else { '_' }).take(64).collect()
}

/// Name of the file or folder that the slices show, without the way to it.
fn file_name(source: &Source) -> Option<String> {
    let volume = match source {
        Source::Image(image) | Source::Mask { image: Some(image), .. } => image,
        Source::Mask { mask, image: None } => mask,
    };
    let VolumeSource::File { path, .. } = volume else { return None };
    // A path such as `.` ends in no name of its own.
    let whole = path.file_name().is_none().then(|| path.canonicalize().ok()).flatten();
    whole.as_deref().unwrap_or(path).file_name().map(|name| shown(Path::new(name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exported_files_are_named_by_their_case() {
        let of = without_extensions;
        assert_eq!(of("colon_ct.nii.gz"), "colon_ct");
        assert_eq!(of("label.seg.nrrd"), "label");
        assert_eq!(of("case 1.2"), "case_1.2");
        assert_eq!(of("a\\nb.nrrd"), "a_nb");
        assert_eq!(of(".nrrd"), "");
        assert_eq!(of(&"x".repeat(300)).len(), 64);
    }

    #[test]
    fn a_title_names_the_file_or_folder_and_not_the_way_to_it() {
        let image = |path: &str| Source::Image(VolumeSource::file(path));
        let name = |source| file_name(&source);
        assert_eq!(name(image("/home/someone/ct.nrrd")).as_deref(), Some("ct.nrrd"));
        assert_eq!(name(image("scans/chest/")).as_deref(), Some("chest"));
        assert_eq!(name(image("a\nb.nrrd")).as_deref(), Some("a\\nb.nrrd"));
        let here = std::env::current_dir().unwrap();
        let here = here.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(name(image(".")), Some(here));
        let (mask, ct) = (VolumeSource::file("mask.nrrd"), VolumeSource::file("ct.nrrd"));
        let mask = |image| Source::Mask { mask: mask.clone(), image };
        assert_eq!(name(mask(Some(ct))).as_deref(), Some("ct.nrrd"), "what the slices show");
        assert_eq!(name(mask(None)).as_deref(), Some("mask.nrrd"));
    }
}

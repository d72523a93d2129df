//! Title of the window.

use std::path::Path;

use super::Viewer;
use crate::formats::shown;
use crate::session::{Source, VolumeSource};

impl Viewer {
    /// The window's title: the name of the file or folder that is open, nothing of its contents.
    pub fn title(&self) -> String {
        const PROGRAM: &str = "intima";
        let name = self.computation.as_ref().and_then(|c| file_name(c.session.source()));
        name.map_or(PROGRAM.into(), |name| format!("{name} - {PROGRAM}"))
    }
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

//! Files of a case, as a session file names them: relative to its folder, so that a folder that is
//! moved or copied stays a case.

use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::formats::ReadOptions;
use crate::session::{Source, VolumeSource};

/// A file or a DICOM folder, with what of it is read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SavedInput {
    /// The way to it: from the session file's folder, or a whole one.
    path: String,
    /// DICOM series.
    #[serde(skip_serializing_if = "Option::is_none")]
    series: Option<String>,
    /// Number of the volume among several at the same places.
    #[serde(skip_serializing_if = "Option::is_none")]
    volume: Option<usize>,
    /// Names of the segments that are read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    segments: Vec<String>,
    /// Whether uneven or missing slices are interpolated.
    #[serde(skip_serializing_if = "is_false")]
    fill_gaps: bool,
    /// Whether pixels are read that may show who the patient is.
    #[serde(skip_serializing_if = "is_false")]
    allow_burned_in: bool,
    /// Side of the voxels that the inside of a mesh is cut into, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    mesh_spacing_mm: Option<f64>,
}

fn is_false(flag: &bool) -> bool {
    !flag
}

/// Volumes of a case: at least one of the two.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SavedCase {
    /// Grey values, or a label map.
    #[serde(skip_serializing_if = "Option::is_none")]
    image: Option<SavedInput>,
    /// Label map drawn on the image.
    #[serde(skip_serializing_if = "Option::is_none")]
    mask: Option<SavedInput>,
}

impl SavedInput {
    /// `None` of a volume in memory, and where the way is no text.
    fn of(source: &VolumeSource, folder: Option<&Path>) -> Option<Self> {
        let VolumeSource::File { path, options } = source else { return None };
        let whole = path.canonicalize().ok()?;
        let way = folder.and_then(|folder| way_from(folder, &whole)).unwrap_or(whole);
        let ReadOptions { series, volume, fill_gaps, allow_burned_in, segments, mesh_spacing_mm } =
            options.clone();
        let path = way.to_str()?.to_owned();
        Some(Self { path, series, volume, segments, fill_gaps, allow_burned_in, mesh_spacing_mm })
    }

    /// The file that is there: at the end of the way, or else of the same name beside the session
    /// file.
    fn source(&self, folder: &Path) -> Result<VolumeSource, String> {
        let way = Path::new(&self.path);
        let beside = way.file_name().map(|name| folder.join(name));
        let found = [Some(folder.join(way)), beside].into_iter().flatten().find(|p| p.exists());
        let path = found.ok_or_else(|| format!("its volume is not there: {}", self.path))?;
        let options = ReadOptions {
            series: self.series.clone(),
            volume: self.volume,
            fill_gaps: self.fill_gaps,
            allow_burned_in: self.allow_burned_in,
            segments: self.segments.clone(),
            mesh_spacing_mm: self.mesh_spacing_mm,
        };
        Ok(VolumeSource::File { path, options })
    }
}

impl SavedCase {
    /// Returns the files of a session; `None` where its volumes are in memory.
    ///
    /// * `folder`: that the ways begin in; ways are whole without one.
    pub(super) fn of(source: &Source, folder: Option<&Path>) -> Option<Self> {
        let folder = folder.and_then(|f| match f.as_os_str().is_empty() {
            true => Path::new(".").canonicalize().ok(),
            false => f.canonicalize().ok(),
        });
        let input = |source| SavedInput::of(source, folder.as_deref());
        match source {
            Source::Image(image) => Some(Self { image: Some(input(image)?), mask: None }),
            Source::Mask { mask, image: None } => {
                Some(Self { image: None, mask: Some(input(mask)?) })
            }
            Source::Mask { mask, image: Some(image) } => {
                Some(Self { image: Some(input(image)?), mask: Some(input(mask)?) })
            }
        }
    }

    /// Returns the volumes to read.
    ///
    /// # Errors
    /// The file that is not there.
    pub(super) fn source(&self, folder: &Path) -> Result<Source, String> {
        let find = |input: &Option<SavedInput>| {
            input.as_ref().map(|input| input.source(folder)).transpose()
        };
        match (find(&self.image)?, find(&self.mask)?) {
            (image, Some(mask)) => Ok(Source::Mask { mask, image }),
            (Some(image), None) => Ok(Source::Image(image)),
            (None, None) => Err("it names no volume".into()),
        }
    }

    /// Name of the file or folder that the slices show.
    pub(super) fn name(&self) -> Option<&str> {
        let input = self.image.as_ref().or(self.mask.as_ref())?;
        Path::new(&input.path).file_name()?.to_str()
    }
}

/// The way from a folder to a file, both whole; `None` where they share no root.
fn way_from(folder: &Path, file: &Path) -> Option<PathBuf> {
    let common = folder.components().zip(file.components()).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return None;
    }
    let up = folder.components().skip(common).map(|_| Component::ParentDir);
    Some(up.chain(file.components().skip(common)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_to_a_volume_is_relative_and_a_moved_folder_stays_a_case() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir_all(at("a/notes")).unwrap();
        std::fs::write(at("a/ct.nrrd"), "x").unwrap();
        let source = Source::Image(VolumeSource::file(at("a/ct.nrrd")));
        let case = SavedCase::of(&source, Some(&at("a/notes"))).unwrap();
        assert_eq!(case.image.as_ref().unwrap().path, "../ct.nrrd");
        assert_eq!(case.name(), Some("ct.nrrd"));
        let path_of = |case: &SavedCase, folder: &Path| match case.source(folder) {
            Ok(Source::Image(VolumeSource::File { path, .. })) => path.canonicalize().unwrap(),
            other => panic!("{other:?}"),
        };
        std::fs::rename(at("a"), at("b")).unwrap();
        let moved = at("b/ct.nrrd").canonicalize().unwrap();
        assert_eq!(path_of(&case, &at("b/notes")), moved);
        // The volume alone beside the session file.
        std::fs::rename(at("b/ct.nrrd"), at("b/notes/ct.nrrd")).unwrap();
        assert!(path_of(&case, &at("b/notes")).ends_with("notes/ct.nrrd"));
        std::fs::remove_file(at("b/notes/ct.nrrd")).unwrap();
        let why = case.source(&at("b/notes")).unwrap_err();
        assert_eq!(why, "its volume is not there: ../ct.nrrd");
    }

    #[test]
    fn a_mask_with_its_image_and_what_is_read_of_them_come_back() {
        let dir = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = dir.path().join(name);
            std::fs::write(&path, "x").unwrap();
            path
        };
        let options = ReadOptions { segments: vec!["colon".into()], ..ReadOptions::default() };
        let mask = VolumeSource::File { path: file("m.seg.nrrd"), options };
        let image = Some(VolumeSource::file(file("ct.nrrd")));
        let case = SavedCase::of(&Source::Mask { mask, image }, None).unwrap();
        let json = serde_json::to_string(&case).unwrap();
        let read: SavedCase = serde_json::from_str(&json).unwrap();
        assert_eq!(read, case);
        let found = read.source(Path::new("/nowhere")).expect("whole ways");
        let Source::Mask { mask: VolumeSource::File { options, .. }, image: Some(_) } = found
        else {
            panic!("{found:?}")
        };
        assert_eq!(options.segments, ["colon"]);
        let empty = SavedCase::default().source(dir.path());
        assert_eq!(empty.unwrap_err(), "it names no volume");
    }
}

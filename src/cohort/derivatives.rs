//! Files of a run under the names of BIDS derivatives.

use std::path::Path;

use serde_json::json;

use super::dataset::encoded;
use super::{Case, Dataset, OutputFile};
use crate::formats::{
    FormatError, ReadOptions, atomic_file, read_volume, to_pretty_json, write_volume,
};
use crate::volume::{Samples, Volume};

/// Files of a run that keep their bytes, and the end of their names as derivatives. The mask is
/// converted, frames have a folder of their own.
const RENAMED: [(&str, &str); 10] = [
    ("distance.nrrd", "desc-distance_map.nrrd"),
    ("surface.ply", "desc-lumen_surface.ply"),
    ("base.ply", "desc-base_surface.ply"),
    ("centerline.vtp", "desc-centerline_curve.vtp"),
    ("centerline.csv", "desc-centerline_curve.csv"),
    ("centerline.mrk.json", "desc-centerline_curve.mrk.json"),
    ("branches.vtp", "desc-branches_curve.vtp"),
    ("unseen.csv", "desc-unseen_voxels.csv"),
    ("report.html", "report.html"),
    ("report.json", "report.json"),
];
/// Lumen as 0 and 1.
const MASK: &str = "label-lumen_desc-wall_mask";
/// Classes of voxels: 0 external, 1 internal, 2 boundary.
const CLASSES: &str = "desc-lumen_dseg";

/// Ends of names in the folder of derivatives that others read.
pub(super) const CENTERLINE: &str = "desc-centerline_curve.csv";
pub(super) const REPORT: &str = "report.json";
pub(super) const REPORT_PAGE: &str = "report.html";

/// Path of an output of a case below the dataset.
pub(super) fn output(case: &Case, end: &str) -> String {
    format!("{}/anat/{}_{end}", Dataset::folder_of(case), case.name)
}

/// Folder of the frames of a case below the dataset.
pub(super) fn frames(case: &Case) -> String {
    format!("{}/figures/{}_frames", Dataset::folder_of(case), case.name)
}

/// Puts the files of a finished run in their places and lists them.
///
/// * `run`: folder of the run; its files are moved.
///
/// # Errors
/// A file that cannot be read, written or moved.
pub fn place_outputs(
    dataset: &Dataset,
    case: &Case,
    run: &Path,
) -> Result<Vec<OutputFile>, FormatError> {
    let out = &dataset.folder;
    let mut paths = Vec::new();
    for (end, is_mask) in [(MASK, true), (CLASSES, false)] {
        let path = output(case, &format!("{end}.nii.gz"));
        make_parent(&out.join(&path))?;
        write_labels(&run.join("mask.nrrd"), &out.join(&path), is_mask)?;
        let sidecar = output(case, &format!("{end}.json"));
        let text = sidecar_of(case, is_mask);
        atomic_file::write_atomic(&out.join(&sidecar), |o| o.write_all(text.as_bytes()))?;
        paths.extend([path, sidecar]);
    }
    for (name, end) in RENAMED {
        if run.join(name).is_file() {
            let path = output(case, end);
            move_file(&run.join(name), &out.join(&path))?;
            paths.push(path);
        }
    }
    let folder = frames(case);
    for name in frame_files(&run.join("frames"))? {
        let path = format!("{folder}/{name}");
        make_parent(&out.join(&path))?;
        move_file(&run.join("frames").join(&name), &out.join(&path))?;
        paths.push(path);
    }
    paths.iter().map(|path| OutputFile::of(out, path)).collect()
}

/// Removes what an earlier run of a case has written, so that no file of it stays beside new ones.
///
/// # Errors
/// A file that cannot be removed.
pub fn clear_outputs(dataset: &Dataset, case: &Case) -> Result<(), FormatError> {
    let labels = [MASK, CLASSES].map(|end| [format!("{end}.nii.gz"), format!("{end}.json")]);
    let ends = RENAMED.iter().map(|(_, end)| (*end).to_owned());
    for end in ends.chain(labels.into_iter().flatten()) {
        let path = dataset.folder.join(output(case, &end));
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                return Err(FormatError::io(&path, e));
            }
            _ => {}
        }
    }
    let folder = dataset.folder.join(frames(case));
    if folder.is_dir() {
        for name in frame_files(&folder)? {
            let path = folder.join(name);
            std::fs::remove_file(&path).map_err(|e| FormatError::io(&path, e))?;
        }
    }
    Ok(())
}

/// Names of frames in a folder, in order.
fn frame_files(folder: &Path) -> Result<Vec<String>, FormatError> {
    let io = |e| FormatError::io(folder, e);
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let name = entry.map_err(io)?.file_name().to_string_lossy().into_owned();
        if crate::session::is_frame_file(&name) {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

fn write_labels(classes: &Path, to: &Path, is_mask: bool) -> Result<(), FormatError> {
    let volume = read_volume(classes, &ReadOptions::default())?;
    if !is_mask {
        return write_volume(to, &volume);
    }
    let inside: Vec<u8> = volume.samples.bytes().iter().map(|v| u8::from(*v != 0)).collect();
    write_volume(to, &Volume::new(volume.grid, Samples::from(inside)))
}

fn sidecar_of(case: &Case, is_mask: bool) -> String {
    let mut text = if is_mask {
        json!({ "Type": "ROI", "Description": "lumen, to its wall" })
    } else {
        json!({
            "Description": "classes of voxels",
            "LabelMap": { "0": "external", "1": "internal", "2": "boundary" },
        })
    };
    if let Some(source) = &case.source {
        let source = format!("bids:raw:{}", encoded(source));
        text["Sources"] = json!([source]);
        text["SpatialReference"] = json!(source);
    }
    to_pretty_json(&text).expect("a value is JSON") + "\n"
}

fn make_parent(path: &Path) -> Result<(), FormatError> {
    let parent = path.parent().unwrap_or(path);
    std::fs::create_dir_all(parent).map_err(|e| FormatError::io(parent, e))
}

/// Moves a file; between file systems as a copy that appears whole.
fn move_file(from: &Path, to: &Path) -> Result<(), FormatError> {
    if std::fs::rename(from, to).is_ok() {
        return Ok(());
    }
    let mut source = crate::formats::open_plain(from)?;
    atomic_file::write_atomic(to, |o| std::io::copy(&mut source, o).map(|_| ()))?;
    std::fs::remove_file(from).map_err(|e| FormatError::io(from, e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::RUN_FILES;

    #[test]
    fn every_file_of_a_run_has_a_place() {
        for name in RUN_FILES {
            let is_placed = name == "mask.nrrd" || RENAMED.iter().any(|(n, _)| *n == name);
            assert!(is_placed, "{name}");
        }
    }

    #[test]
    fn names_are_those_of_bids_derivatives() {
        let case =
            |name: &str| Case { name: name.into(), input: "x".into(), source: Some("a b".into()) };
        let mask = format!("{MASK}.nii.gz");
        assert_eq!(
            output(&case("sub-01"), &mask),
            "sub-01/anat/sub-01_label-lumen_desc-wall_mask.nii.gz"
        );
        let long = case("sub-01_ses-2_run-1");
        assert_eq!(
            output(&long, CENTERLINE),
            "sub-01/ses-2/anat/sub-01_ses-2_run-1_desc-centerline_curve.csv"
        );
        assert_eq!(frames(&long), "sub-01/ses-2/figures/sub-01_ses-2_run-1_frames");
        assert!(sidecar_of(&long, true).contains("bids:raw:a%20b"));
    }
}

//! `intima info`.

use std::path::PathBuf;

use super::CliError;
use super::dicom_args::DicomArgs;
use super::global::Global;
use crate::formats::{FormatError, inspect, is_mesh, read_mesh, read_volume};
use crate::session::reading_bytes;

/// `intima info INPUT`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume (DICOM folder or file, OME-Zarr folder, .nii[.gz], .nrrd/.nhdr, .mha/.mhd) or mesh
    input: PathBuf,
    #[command(flatten)]
    dicom: DicomArgs,
}

/// Header and range of a volume, as `--json` prints them.
#[derive(serde::Serialize)]
struct FileInfo {
    /// Header of the input.
    #[serde(flatten)]
    info: crate::formats::InputInfo,
    /// Smallest and largest real value.
    range: Option<[f64; 2]>,
}

impl Args {
    /// Prints a table, or JSON.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let mut options = self.dicom.options();
        if is_mesh(&self.input) {
            return self.mesh(global);
        }
        let info = inspect(&self.input, &options)?;
        if info.format != "DICOM" {
            // Of several volumes the first is described.
            options.volume = options.volume.or(Some(0));
        }
        let range = match &info.image {
            Some(image) => {
                global.check_memory(reading_bytes(image), "estimated for reading")?;
                // A range shows nobody.
                options.allow_burned_in = true;
                match read_volume(&self.input, &options) {
                    Ok(volume) => volume.range().map(|(a, b)| [a, b]),
                    // They are listed here.
                    Err(FormatError::Segments { .. }) if options.segments.is_empty() => None,
                    Err(e) => return Err(e.into()),
                }
            }
            None => None,
        };
        global.say(format_args!("format       {}", info.format))?;
        if let Some(i) = &info.image {
            let [x, y, z] = i.dims;
            let [a, b, c] = i.spacing_mm;
            let [p, q, r] = i.origin_mm;
            global.say(format_args!("dimensions   {x} x {y} x {z}"))?;
            global.say(format_args!("spacing      {a} x {b} x {c} mm"))?;
            global.say(format_args!("origin       {p}, {q}, {r} mm (LPS)"))?;
            let d = i.direction;
            for (name, k) in [("i", 0), ("j", 1), ("k", 2)] {
                global.say(format_args!(
                    "direction {name}  {:.6}, {:.6}, {:.6}",
                    d[k],
                    d[k + 3],
                    d[k + 6]
                ))?;
            }
            global.say(format_args!(
                "orientation  {} ({}), {}",
                i.orientation, i.orientation_words, i.handedness
            ))?;
            let rescale = (i.rescale_slope, i.rescale_intercept);
            global.say(format_args!("samples      {}", i.sample_type))?;
            global
                .say(format_args!("rescale      slope {}, intercept {}", rescale.0, rescale.1))?;
        }
        if let Some([lo, hi]) = range {
            global.say(format_args!("range        {lo} to {hi}"))?;
        }
        for s in &info.series {
            let [x, y, z] = s.dims;
            let (n, of) = (s.slices, s.distinction());
            let of = if of.is_empty() { of } else { format!(" of {of}") };
            global.say(format_args!(
                "series {:3}   {} {} {x} x {y} x {z}, {n} slices{of}",
                s.index, s.uid, s.modality
            ))?;
        }
        for s in &info.segments {
            global.say(format_args!("segment {:3}  {}", s.label, s.name))?;
        }
        for n in &info.notes {
            global.say(format_args!("note         {n}"))?;
        }
        global.answer(&FileInfo { info, range })
    }

    /// Describes a mesh.
    fn mesh(&self, global: &Global) -> Result<(), CliError> {
        let (mesh, notes) = read_mesh(&self.input, None)?;
        let (low, high) = mesh.bounds().unwrap_or_default();
        let [x, y, z] = (high - low).to_array();
        let (vertices, faces) = (mesh.positions.len(), mesh.faces.len());
        global.say(format_args!("format       mesh"))?;
        global.say(format_args!("vertices     {vertices}"))?;
        global.say(format_args!("faces        {faces}"))?;
        global.say(format_args!("box          {x} x {y} x {z} mm"))?;
        for n in &notes {
            global.say(format_args!("note         {n}"))?;
        }
        let size_mm = [x, y, z];
        global.answer(&serde_json::json!({
            "format": "mesh", "vertices": vertices, "faces": faces, "box_mm": size_mm,
            "notes": notes,
        }))
    }
}

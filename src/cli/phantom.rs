//! `intima phantom`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, VOLUMES};
use crate::formats::{shown, write_centerline, write_volume};
use crate::geometry::{Attachment, Branch, Centerline, CenterlinePoint};
use crate::volume::phantom::{Kind, Phantom, Truth};

/// `intima phantom KIND -o VOLUME`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// tube, ellipse, bend, helix, torus, y, colon or aneurysm
    kind: Kind,
    /// Volume to write: .nrrd, .nii, .nii.gz, .mha or .mhd
    #[arg(short, long, value_name = "VOLUME")]
    output: PathBuf,
    /// Voxels along the coarsest axis of the cubic box
    #[arg(long, value_name = "N", default_value_t = 128)]
    size: u32,
    /// Voxel spacing, mm
    #[arg(long, value_name = "X,Y,Z", default_value = "1,1,1")]
    spacing: String,
    /// Write the mask (1 inside) instead of CT-like values
    #[arg(long, conflicts_with = "noise")]
    mask: bool,
    /// Standard deviation of Gaussian noise on CT-like values, HU
    #[arg(long, value_name = "HU", num_args = 0..=1, default_missing_value = "15")]
    noise: Option<f64>,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    noise_seed: u64,
    /// Write the true axis: .vtp, .csv, .swc or .mrk.json
    #[arg(long, value_name = "LINE")]
    truth: Option<PathBuf>,
}

impl Args {
    /// Writes the phantom.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, VOLUMES)?;
        let spacing = super::lumen_args::point(&self.spacing, "--spacing")?.to_array();
        if self.noise.is_some_and(|n| !(0.0..=10_000.0).contains(&n)) {
            return Err(CliError::Usage("--noise: between 0 and 10000 HU".into()));
        }
        let phantom = Phantom::new(self.kind, self.size, spacing)?;
        let bytes = phantom.grid().len() as u64 * 3;
        crate::session::refuse_above(global.max_memory, bytes, "the phantom")?;
        let volume =
            if self.mask { phantom.mask() } else { phantom.grey(self.noise, self.noise_seed) };
        write_volume(&self.output, &volume)?;
        let truth = phantom.truth();
        if let Some(path) = &self.truth {
            write_centerline(path, &axis(&truth))?;
        }
        global.say(format_args!("wrote {}", shown(&self.output)))?;
        global.answer(&serde_json::json!({
            "kind": self.kind.name(),
            "dims": volume.grid.dims.to_array(),
            "spacing_mm": spacing,
            "start_mm": truth.start.to_array(),
            "ends_mm": truth.ends.iter().map(|e| e.to_array()).collect::<Vec<_>>(),
        }))
    }
}

/// The true axis as a centerline.
fn axis(truth: &Truth) -> Centerline {
    let mut line = Centerline::default();
    for b in &truth.branches {
        let mut s = b
            .parent
            .and_then(|p: usize| line.branches[p].points.last())
            .map_or(0.0, |p: &CenterlinePoint| p.abscissa_mm);
        let mut points: Vec<CenterlinePoint> = Vec::with_capacity(b.points.len());
        for [x, y, z, r] in &b.points {
            let position_mm = glam::DVec3::new(*x, *y, *z);
            if let Some(last) = points.last() {
                s += last.position_mm.distance(position_mm);
            }
            points.push(CenterlinePoint { position_mm, radius_mm: *r, abscissa_mm: s });
        }
        let last = |branch: usize| line.branches[branch].points.len() - 1;
        let start = b.parent.map(|branch| Attachment { branch, point: last(branch) });
        line.branches.push(Branch { start, end: None, points });
    }
    line
}

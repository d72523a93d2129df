//! `intima simplify`.

use std::path::PathBuf;

use serde::Serialize;

use super::CliError;
use super::global::{Global, MESHES};
use super::mode::ModeArg;
use super::repeat::timed;
use crate::formats::{Space, read_mesh, shown, write_mesh};
use crate::geometry::Mesh;
use crate::mesh::{
    Deviation, MeshError, Metric, Repairs, Simplified, SimplifyOptions, StopReason, deviation,
    make_manifold, simplify,
};
use crate::session::{Clock, MeshWork, Mode, mesh_bytes};

/// `intima simplify MESH --faces N -o MESH`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Mesh: .ply, .stl, .obj or .vtp
    mesh: PathBuf,
    /// Faces wanted
    #[arg(long, value_name = "N")]
    faces: usize,
    /// Mesh to write: .ply, .stl, .obj, .vtp or .glb
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    mode: ModeArg,
    /// Cost of a collapse (default: normal-qem, in paper mode paper)
    #[arg(long, value_enum)]
    metric: Option<Metric>,
    /// Stop before a vertex is farther than this from the planes it stands for
    #[arg(long, value_name = "MM")]
    max_error: Option<f64>,
    /// Leave the vertices that stay where they were, as paper mode always does; by default they
    /// move, at each collapse, to where they stand best for those that went
    #[arg(long)]
    keep_vertices: bool,
    /// Measure the distance of the result from the mesh too: both ways, from samples of each
    #[arg(long)]
    measure: bool,
    /// Coordinates of a mesh that does not say: lps or ras
    #[arg(long)]
    space: Option<Space>,
}

/// Result of a simplification, as `--json` prints it.
#[derive(Default, Serialize)]
struct Reached {
    /// Faces of the input.
    faces_in: usize,
    /// Faces that are left.
    faces: usize,
    /// Vertices that are left.
    vertices: usize,
    /// Faces asked for.
    wanted: usize,
    /// Edge collapses made.
    collapses: usize,
    /// Reason for stopping.
    stopped: &'static str,
    /// Largest quadric error of a collapse.
    quadric_error_mm: f64,
    /// Distance between the two meshes, where asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    deviation: Option<Deviation>,
}

impl Reached {
    fn of(made: &Simplified, given: &Mesh, wanted: usize, measure: bool) -> Self {
        Self {
            faces_in: given.faces.len(),
            faces: made.mesh.faces.len(),
            vertices: made.mesh.positions.len(),
            wanted,
            collapses: made.collapses,
            stopped: match made.stopped {
                StopReason::Reached => "reached",
                StopReason::NoLegalCollapse => "no legal collapse",
                StopReason::MaxError => "max error",
            },
            quadric_error_mm: made.error_mm,
            deviation: measure.then(|| deviation(&made.mesh, given)).flatten(),
        }
    }
}

impl Args {
    fn metric(&self) -> Metric {
        self.metric.unwrap_or(match self.mode.mode {
            Mode::Default => Metric::NormalQem,
            Mode::Paper => Metric::Paper,
        })
    }

    fn simplified(&self, mesh: &Mesh, clock: &mut Clock) -> Result<Simplified, CliError> {
        let options = SimplifyOptions {
            metric: self.metric(),
            relocate: self.mode.mode == Mode::Default && !self.keep_vertices,
            max_error_mm: self.max_error,
            ..SimplifyOptions::to_faces(self.faces)
        };
        let collapses = |made: &Result<Simplified, _>| {
            made.as_ref().map_or(0, |made: &Simplified| made.collapses as u64)
        };
        let work = || simplify(mesh, &options, &mut ());
        Ok(clock.time("simplify", "collapses", work, collapses)?)
    }

    /// Reads, repairs, simplifies and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, MESHES)?;
        if let Some(e) = self.max_error.filter(|e| e.is_nan() || *e <= 0.0) {
            return Err(CliError::Usage(format!("--max-error {e}: above 0 mm")));
        }
        let (read, warnings) = read_mesh(&self.mesh, self.space)?;
        warnings.iter().for_each(|w| global.warn(w));
        let work = if self.measure { MeshWork::SimplifyAndMeasure } else { MeshWork::Simplify };
        let bytes = mesh_bytes(work, read.faces.len(), false);
        global.check_memory(bytes, "estimated for the simplification")?;
        let (mesh, repairs) = make_manifold(&read).map_err(|e| self.named(e))?;
        drop(read);
        repaired(&repairs).iter().for_each(|w| global.warn(w));
        let wanted = self.faces;
        let (made, timing) = timed(
            global,
            &mut (),
            |()| Ok("cpu".to_owned()),
            |()| (),
            |()| {
                let mut clock = Clock::default();
                let made = self.simplified(&mesh, &mut clock)?;
                Ok((made, clock))
            },
        )?;
        write_mesh(&self.output, &made.mesh)?;
        let reached = Reached::of(&made, &mesh, wanted, self.measure);
        let note = match made.stopped {
            StopReason::Reached => String::new(),
            _ => format!(" ({wanted} wanted: {})", reached.stopped),
        };
        global.say(format_args!(
            "wrote {}: {} faces of {}{note}",
            shown(&self.output),
            reached.faces,
            reached.faces_in
        ))?;
        if let Some(d) = reached.deviation {
            global.say(format_args!(
                "at most {:.4} mm away, {:.4} mm in the mean; normals {:.2} degrees in the mean",
                d.hausdorff_mm, d.mean_mm, d.normal_mean_deg
            ))?;
        }
        global.answer(&timing.with("mesh", &reached))
    }

    fn named(&self, e: MeshError) -> CliError {
        CliError::Input(format!("{}: {e}", shown(&self.mesh)))
    }
}

/// Lists the repairs, a sentence each.
fn repaired(r: &Repairs) -> Vec<String> {
    let mut out = Vec::new();
    let mut say = |n: usize, what: &str| {
        if n > 0 {
            out.push(format!("{n} {what}"));
        }
    };
    say(r.degenerate_faces, "faces name a vertex twice: dropped");
    say(r.duplicate_faces, "faces repeat another: dropped");
    say(r.flipped_faces, "faces looked to the other side than their neighbours: turned over");
    if let Some([a, b]) = r.first_edge {
        let what = format!("edges have more than two faces: cut apart, the first from {a} to {b}");
        say(r.split_edges, &what);
    }
    if let Some(p) = r.first_vertex {
        let what = format!("vertices hold fans of faces together: doubled, the first at {p}");
        say(r.split_vertices, &what);
    }
    out
}

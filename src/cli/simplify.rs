//! `intima simplify`.

use std::path::PathBuf;

use serde::Serialize;

use super::CliError;
use super::global::{Global, MESHES};
use super::surface::{ModeArg, Modes};
use super::timing::timed;
use crate::device::Device;
use crate::formats::{Space, read_mesh, write_mesh};
use crate::geometry::Mesh;
use crate::mesh::{Metric, Simplified, SimplifyOptions, Stopped, simplify};
use crate::pipeline::{Clock, Mode};

/// `intima simplify MESH --faces N -o MESH`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Mesh: .ply, .stl or .obj
    mesh: PathBuf,
    /// Faces wanted
    #[arg(long, value_name = "N")]
    faces: usize,
    /// Mesh to write: .ply, .stl, .obj, .vtp or .glb
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    mode: ModeArg,
    /// What a collapse costs (default: normal-qem, in paper mode paper)
    #[arg(long, value_enum)]
    metric: Option<MetricArg>,
    /// Stop before a vertex is farther than this from the planes it stands for
    #[arg(long, value_name = "MM")]
    max_error: Option<f64>,
    /// Coordinates of a mesh that does not say: lps or ras
    #[arg(long)]
    space: Option<Space>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MetricArg {
    Qem,
    NormalQem,
    Paper,
}

/// What came of it, as `--json` says it.
#[derive(Serialize)]
struct Reached {
    faces_in: usize,
    faces: usize,
    vertices: usize,
    wanted: usize,
    collapses: usize,
    stopped: &'static str,
    quadric_error_mm: f64,
}

impl Reached {
    fn of(given: &Mesh, wanted: usize, s: &Simplified) -> Self {
        Self {
            faces_in: given.faces.len(),
            faces: s.mesh.faces.len(),
            vertices: s.mesh.positions.len(),
            wanted,
            collapses: s.collapses,
            stopped: match s.stopped {
                Stopped::Reached => "reached",
                Stopped::NoLegalCollapse => "no legal collapse",
                Stopped::MaxError => "max error",
            },
            quadric_error_mm: s.error_mm,
        }
    }
}

impl Args {
    fn metric(&self, mode: Mode) -> Metric {
        match (self.metric, mode) {
            (Some(MetricArg::Qem), _) => Metric::Qem,
            (Some(MetricArg::NormalQem), _) | (None, Mode::Default) => Metric::NormalQem,
            (Some(MetricArg::Paper), _) | (None, Mode::Paper) => Metric::Paper,
        }
    }

    fn simplified(
        &self,
        mesh: &Mesh,
        mode: Mode,
        clock: &mut Clock,
    ) -> Result<Simplified, CliError> {
        let options = SimplifyOptions {
            metric: self.metric(mode),
            max_error_mm: self.max_error,
            ..SimplifyOptions::to_faces(self.faces)
        };
        let gone = |r: &Result<Simplified, _>| r.as_ref().map_or(0, |s: &Simplified| s.collapses);
        let work = || simplify(mesh, &options, &mut ());
        Ok(clock.time("simplify", "collapses", work, |r| gone(r) as u64)?)
    }

    /// Reads, simplifies and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, MESHES)?;
        if self.max_error.is_some_and(|e| !(e > 0.0)) {
            return Err(CliError::Usage("--max-error: above 0 mm".into()));
        }
        let (mesh, warnings) = read_mesh(&self.mesh, self.space)?;
        warnings.iter().for_each(|w| global.warn(w));
        let mode = self.mode.main();
        let (done, timing) =
            timed(global, &mut Device::Cpu, |_, clock| self.simplified(&mesh, mode, clock))?;
        write_mesh(&self.output, &done.mesh)?;
        let reached = Reached::of(&mesh, self.faces, &done);
        let note = match done.stopped {
            Stopped::Reached => String::new(),
            _ => format!(", not {}: {}", self.faces, reached.stopped),
        };
        global.say(format_args!(
            "wrote {}: {} faces of {}{note}",
            self.output.display(),
            reached.faces,
            reached.faces_in
        ))?;
        let value = |r: &Reached| serde_json::to_value(r).unwrap_or_default();
        let mut timing = timing.with("mesh", value(&reached));
        if self.mode.mode == Modes::Both {
            let mut clock = Clock::default();
            let paper = self.simplified(&mesh, Mode::Paper, &mut clock)?;
            let paper = Reached::of(&mesh, self.faces, &paper);
            let ms = |c: &Clock| c.stages.iter().map(|s| s.ms).sum::<f64>();
            timing = timing.with(
                "modes",
                serde_json::json!({
                    "default": value(&reached),
                    "paper": value(&paper),
                    "paper_ms": ms(&clock),
                }),
            );
        }
        global.answer(&timing)
    }
}

//! `intima simplify`.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::CliError;
use super::global::{Global, MESHES};
use super::mode::ModeArg;
use super::repeat::timed;
use crate::formats::{FormatError, Space, atomic_file, read_mesh, read_plain, shown, write_mesh};
use crate::geometry::Mesh;
use crate::mesh::{
    Deviation, MeshError, Metric, Parameterization, Repairs, Simplified, SimplifyOptions,
    StopReason, deviation, make_manifold, simplify,
};
use crate::session::{Clock, MeshWork, Mode, mesh_bytes};

/// `intima simplify MESH --faces N -o MESH`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Mesh: .ply, .stl, .obj or .vtp
    mesh: PathBuf,
    /// Faces wanted
    #[arg(long, value_name = "N", required_unless_present = "from_maps")]
    faces: Option<usize>,
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
    /// Keep the parameterisation: where every point of the mesh lies on the base, and back
    #[arg(long, value_name = "FILE")]
    maps: Option<PathBuf>,
    /// Make the base that a kept parameterisation of this mesh ends in, instead of simplifying
    #[arg(long, value_name = "FILE", conflicts_with_all = ["faces", "maps", "metric", "max_error"])]
    from_maps: Option<PathBuf>,
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
    /// Parameterization on the base mesh, where asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    maps: Option<MapsReport>,
    /// Distance between the two meshes, where asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    deviation: Option<Deviation>,
}

/// The parameterisation, as `--json` says it.
#[derive(Serialize)]
struct MapsReport {
    /// Size of the file.
    bytes: usize,
    /// Collapses refused because no map was found.
    refused: u32,
}

/// A simplified mesh and what it lies over.
struct Done {
    simplified: Simplified,
    maps: Option<Parameterization>,
}

impl Done {
    fn reached(&self, given: &Mesh, wanted: usize, measure: bool) -> Reached {
        let s = &self.simplified;
        let of =
            |m: &Parameterization| MapsReport { bytes: m.memory_bytes(), refused: m.refused() };
        Reached {
            faces_in: given.faces.len(),
            faces: s.mesh.faces.len(),
            vertices: s.mesh.positions.len(),
            wanted,
            collapses: s.collapses,
            stopped: match s.stopped {
                StopReason::Reached => "reached",
                StopReason::NoLegalCollapse => "no legal collapse",
                StopReason::MaxError => "max error",
            },
            quadric_error_mm: s.error_mm,
            maps: self.maps.as_ref().map(of),
            deviation: measure.then(|| deviation(&s.mesh, given)).flatten(),
        }
    }
}

impl Args {
    fn metric(&self, mode: Mode) -> Metric {
        self.metric.unwrap_or(match mode {
            Mode::Default => Metric::NormalQem,
            Mode::Paper => Metric::Paper,
        })
    }

    fn simplified(&self, mesh: &Mesh, mode: Mode, clock: &mut Clock) -> Result<Done, CliError> {
        let options = SimplifyOptions {
            metric: self.metric(mode),
            relocate: mode == Mode::Default && !self.keep_vertices,
            max_error_mm: self.max_error,
            ..SimplifyOptions::to_faces(self.faces.unwrap_or(0))
        };
        let mut maps = self.maps.as_ref().map(|_| Parameterization::new(mesh)).transpose()?;
        let gone = |r: &Result<Simplified, _>| r.as_ref().map_or(0, |s: &Simplified| s.collapses);
        let work = || match maps.as_mut() {
            Some(maps) => simplify(mesh, &options, maps),
            None => simplify(mesh, &options, &mut ()),
        };
        let simplified = clock.time("simplify", "collapses", work, |r| gone(r) as u64)?;
        Ok(Done { simplified, maps })
    }

    /// Reads, repairs, simplifies and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, MESHES)?;
        if let Some(e) = self.max_error.filter(|e| e.is_nan() || *e <= 0.0) {
            return Err(CliError::Usage(format!("--max-error {e}: above 0 mm")));
        }
        let (read, warnings) = read_mesh(&self.mesh, self.space)?;
        warnings.iter().for_each(|w| global.warn(w));
        let work = match (&self.maps, self.measure) {
            (Some(_), _) => MeshWork::SimplifyWithMaps,
            (None, true) => MeshWork::SimplifyAndMeasure,
            (None, false) => MeshWork::Simplify,
        };
        let bytes = mesh_bytes(work, read.faces.len(), false);
        global.check_memory(bytes, "estimated for the simplification")?;
        let (mesh, repairs) = make_manifold(&read).map_err(|e| self.named(e))?;
        drop(read);
        repaired(&repairs).iter().for_each(|w| global.warn(w));
        if let Some(path) = &self.from_maps {
            return self.base_of(path, &mesh, global);
        }
        let wanted = self.faces.unwrap_or(0);
        let (done, timing) = timed(
            global,
            &mut (),
            |()| Ok("cpu".to_owned()),
            |()| (),
            |()| {
                let mut clock = Clock::default();
                let done = self.simplified(&mesh, self.mode.main(), &mut clock)?;
                Ok((done, clock))
            },
        )?;
        write_mesh(&self.output, &done.simplified.mesh)?;
        if let (Some(path), Some(maps)) = (&self.maps, &done.maps) {
            let bytes = maps.to_bytes();
            atomic_file::write_atomic(path, |o| o.write_all(&bytes))?;
        }
        let reached = done.reached(&mesh, wanted, self.measure);
        let note = match done.simplified.stopped {
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
        let value = |r: &Reached| serde_json::to_value(r).unwrap_or_default();
        let mut timing = timing.with("mesh", value(&reached));
        if self.mode.is_both() {
            let mut clock = Clock::default();
            let paper = self.simplified(&mesh, Mode::Paper, &mut clock)?;
            let ms = clock.stages.iter().map(|s| s.ms).sum::<f64>();
            timing = timing.with(
                "modes",
                serde_json::json!({
                    "default": value(&reached),
                    "paper": value(&paper.reached(&mesh, wanted, self.measure)),
                    "paper_ms": ms,
                }),
            );
        }
        global.answer(&timing)
    }

    /// Writes the base that a kept parameterisation ends in.
    fn base_of(&self, path: &Path, mesh: &Mesh, global: &Global) -> Result<(), CliError> {
        let io = |e| FormatError::io(path, e);
        // A collapse is 8 bytes and 16 a neighbour, of which there are at most 24.
        let most = 400 * mesh.positions.len() as u64 + 4096;
        if std::fs::metadata(path).map_err(io)?.len() > most {
            let what = "larger than any parameterisation of this mesh";
            return Err(CliError::Input(format!("{}: {what}", shown(path))));
        }
        let bytes = read_plain(path, most)?;
        let maps = Parameterization::from_bytes(&bytes, mesh)
            .map_err(|e| CliError::Input(format!("{}: {e}", shown(path))))?;
        let base = base_mesh(mesh, &maps);
        write_mesh(&self.output, &base)?;
        let (written, faces) = (shown(&self.output), base.faces.len());
        global.say(format_args!("wrote {written}: {faces} faces of {}", mesh.faces.len()))?;
        global.answer(&serde_json::json!({
            "mesh": { "faces_in": mesh.faces.len(), "faces": faces, "collapses": maps.collapses() },
        }))
    }

    fn named(&self, e: MeshError) -> CliError {
        CliError::Input(format!("{}: {e}", shown(&self.mesh)))
    }
}

/// The base of a parameterisation, with its vertices where they lie in the original.
fn base_mesh(mesh: &Mesh, maps: &Parameterization) -> Mesh {
    let mut id = vec![u32::MAX; mesh.positions.len()];
    let mut base = Mesh::default();
    for (_, face) in maps.base_faces() {
        let face = face.map(|v| {
            let new = &mut id[v as usize];
            if *new == u32::MAX {
                *new = base.positions.len() as u32;
                base.positions.push(mesh.positions[v as usize]);
                base.normals.extend(mesh.normals.get(v as usize));
            }
            *new
        });
        base.faces.push(face);
    }
    base
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

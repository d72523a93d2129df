//! `intima surface`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, MESHES};
use super::lumen_args::{LumenArgs, track_from};
use super::mesh_args::SurfaceArgs;
use super::timing::timed;
use crate::formats::write_mesh;
use crate::geometry::Mesh;
use crate::pipeline::{Mode, SurfaceReport, detail, wall};
use crate::surface::{Fairing, Smoothing};

/// `intima surface INPUT LUMEN -o MESH`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Mesh to write: .ply, .stl, .obj, .vtp or .glb
    #[arg(short, long, value_name = "MESH")]
    output: PathBuf,
    #[command(flatten)]
    mode: ModeArg,
    /// Where the surface lies: grey interpolates the threshold between voxels, mask is half way
    #[arg(long, value_name = "grey|mask", value_parser = ["grey", "mask"])]
    from: Option<String>,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    lumen: LumenArgs,
}

/// `--mode`
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ModeArg {
    /// default does what is right; paper does what the paper says; both reports both
    #[arg(long, value_enum, default_value = "default")]
    pub mode: Modes,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Modes {
    Default,
    Paper,
    Both,
}

impl ModeArg {
    /// The mode whose products are written.
    pub fn main(self) -> Mode {
        if self.mode == Modes::Paper { Mode::Paper } else { Mode::Default }
    }
}

/// Smoothing of the normals when the user leaves it open.
pub fn automatic(mode: Mode) -> Smoothing {
    match mode {
        Mode::Paper => Smoothing::Steps(Fairing::PAPER),
        Mode::Default => Smoothing::Multiscale,
    }
}

/// The mesh without its caps.
pub fn without_caps(mesh: &Mesh) -> Mesh {
    let keep = |f: &([u32; 3], bool)| !f.1;
    let faces = mesh.faces.iter().copied().zip(mesh.caps.iter().copied());
    Mesh {
        positions: mesh.positions.clone(),
        normals: mesh.normals.clone(),
        faces: faces.filter(keep).map(|f| f.0).collect(),
        caps: Vec::new(),
    }
}

impl Args {
    /// Extracts, fairs and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, MESHES)?;
        let chosen = self.lumen.load(self.input.as_deref(), global)?;
        let (lumen, _) = chosen.lumen(global)?;
        let mut device = global.open()?;
        let grey = self.from.as_deref() != Some("mask");
        let track = track_from(&chosen.recipe);
        let build = |mode: Mode| self.surface.options(grey, automatic(mode), track);
        let options = build(self.mode.main())?;
        let (wall, timing) = timed(global, &mut device, |device, clock| {
            let (volume, window) = (&chosen.volume, &chosen.recipe.window);
            let wall = wall(device, volume, window, &lumen, options, clock)?;
            let faces = self.surface.decimate.map(|n| n as usize);
            let base = faces.map(|n| detail::base(&wall.mesh, None, n, self.mode.main(), clock));
            Ok((wall, base.transpose()?))
        })?;
        let (wall, base) = wall;
        let whole = base.as_ref().unwrap_or(&wall.mesh);
        let mesh = if self.surface.open_ends && !whole.caps.is_empty() {
            &without_caps(whole)
        } else {
            whole
        };
        write_mesh(&self.output, mesh)?;
        let report = SurfaceReport::of(wall.topology, wall.mesh.area_mm2());
        global.say(format_args!(
            "wrote {}: {} vertices, {} faces, {} component{}, Euler number {}, {}",
            self.output.display(),
            report.vertices,
            report.faces,
            report.components,
            if report.components == 1 { "" } else { "s" },
            report.euler,
            if report.watertight { "watertight" } else { "NOT watertight" }
        ))?;
        if let Some(base) = &base {
            global.say(format_args!("  simplified to {} faces", base.faces.len()))?;
        }
        let timing = timing.with("decimated_faces", base.as_ref().map(|b| b.faces.len()));
        let mut timing = timing.with("surface", serde_json::to_value(&report).unwrap_or_default());
        if self.mode.mode == Modes::Both {
            let options = build(Mode::Paper)?;
            let (volume, window) = (&chosen.volume, &chosen.recipe.window);
            let mut clock = crate::pipeline::Clock::default();
            let paper =
                crate::pipeline::wall(&mut device, volume, window, &lumen, options, &mut clock)?;
            let apart = wall.mesh.normals.iter().zip(&paper.mesh.normals);
            let mean: f64 = apart.map(|(a, b)| f64::from(a.angle_between(*b))).sum::<f64>()
                / wall.mesh.normals.len().max(1) as f64;
            let of = |t| serde_json::to_value(SurfaceReport::of(t, paper.mesh.area_mm2()));
            timing = timing.with(
                "modes",
                serde_json::json!({
                    "default": of(wall.topology).unwrap_or_default(),
                    "paper": of(paper.topology).unwrap_or_default(),
                    "normals_apart_mean_deg": mean.to_degrees(),
                }),
            );
        }
        global.answer(&timing)
    }
}

//! `intima surface`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, MESHES};
use super::lumen_args::LumenArgs;
use super::mode::ModeArg;
use super::repeat::timed_products;
use super::surface_args::{RefineArgs, SurfaceArgs, SurfaceFrom};
use crate::formats::{shown, write_wall};
use crate::session::{
    LevelSettings, Lod, Mode, Product, Session, Settings, SurfaceReport, WallReport, written_mesh,
};

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
    /// The name of --surface-from where no path has a --from
    #[arg(long, value_enum, conflicts_with = "surface_from", hide = true)]
    from: Option<SurfaceFrom>,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    refine: RefineArgs,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl Args {
    /// Extracts, smooths normals and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, MESHES)?;
        self.lumen.check_outputs(global)?;
        let mut wall = self.surface.settings()?;
        wall.from_mask |= self.from == Some(SurfaceFrom::Mask);
        let refine = self.refine.refine;
        if refine.is_some() && self.mode.mode == Mode::Paper {
            let why = "--refine: the wall of --mode paper is not refined";
            return Err(CliError::Usage(why.into()));
        }
        let lod = if refine.is_some() { Lod::Auto } else { Lod::Off };
        let settings = Settings {
            mode: self.mode.mode,
            lumen: self.lumen.settings()?,
            wall,
            levels: LevelSettings { lod, ..LevelSettings::default() },
            ..global.settings()
        };
        let mut session = Session::new(self.lumen.source(self.input.as_deref())?, settings)?;
        let simplify = self.surface.decimate.is_some();
        let products: &[Product] = match (simplify, refine) {
            (true, _) => &[Product::Wall, Product::Base],
            (false, Some(_)) => &[Product::Wall, Product::Levels],
            (false, None) => &[Product::Wall],
        };
        session.expect(&[Product::Wall]);
        let needs = [Product::Lumen, Product::Volume, Product::Device];
        let ((), timing) = timed_products(global, &mut session, &needs, &[Product::Wall], |s| {
            Ok(s.prepare(products)?)
        })?;
        let wall = session.wall()?;
        let base = simplify.then(|| session.base()).transpose()?;
        let refined = refine.map(|level| session.refined_mesh(level)).transpose()?;
        let whole = refined.as_ref().or(base.as_deref()).unwrap_or(&wall.mesh);
        let written = written_mesh(whole, self.surface.open_ends);
        write_wall(&self.output, &written, self.surface.facing)?;
        self.lumen.write_choice(&session, global)?;
        let report = match base.as_deref().or(refined.as_ref()) {
            Some(_) => SurfaceReport::of_mesh(&written),
            None => SurfaceReport::of_written(&wall, self.surface.open_ends),
        };
        global.say(format_args!(
            "wrote {}: {} vertices, {} faces, {} component{}, Euler number {}, {}",
            shown(&self.output),
            report.vertices,
            report.faces,
            report.components,
            if report.components == 1 { "" } else { "s" },
            report.euler,
            if report.watertight { "watertight" } else { "NOT watertight" }
        ))?;
        if base.is_some() {
            global.say(format_args!("  simplified from {} faces", wall.mesh.faces.len()))?;
        }
        let timing = timing.with("decimated_faces", base.as_ref().map(|b| b.faces.len()));
        let timing = timing.with("wall", WallReport::of(&*session.lumen()?));
        global.answer(&timing.with("surface", &report))
    }
}

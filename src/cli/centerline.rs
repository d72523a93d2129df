//! `intima centerline`.

use std::path::PathBuf;

use glam::DVec3;

use super::CliError;
use super::global::{Global, LINES};
use super::lumen_args::{LumenArgs, point};
use super::surface::{ModeArg, Modes};
use super::timing::timed;
use crate::centerline::{Ends, Radius, RouteOptions};
use crate::device::Device;
use crate::formats::write_centerline;
use crate::lumen::Lumen;
use crate::pipeline::{
    Centered, CenterlineReport, Clock, Fields, Mode, Settings, beside, fields, paper_centered,
    route, seen,
};

/// `intima centerline INPUT LUMEN -o LINE`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Centerline to write: .vtp, .mrk.json or .csv
    #[arg(short, long, value_name = "LINE")]
    output: PathBuf,
    /// Write boundary voxels that no kept point sees (i,j,k,x,y,z)
    #[arg(long, value_name = "CSV")]
    unseen: Option<PathBuf>,
    #[command(flatten)]
    mode: ModeArg,
    /// Start here, LPS mm
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    from: Option<String>,
    #[command(flatten)]
    path: PathArgs,
    #[command(flatten)]
    lumen: LumenArgs,
}

/// Flags of the path.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Centerline")]
pub struct PathArgs {
    /// All branches instead of one path
    #[arg(long)]
    pub tree: bool,
    /// End here, LPS mm
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub to: Option<String>,
    /// How far a point sees: paper (Eq. 5) or measured (longest ray across); default by mode
    #[arg(long, value_enum)]
    pub radius: Option<RadiusArg>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RadiusArg {
    Paper,
    Measured,
}

impl PathArgs {
    /// Settings for a mode.
    pub fn settings(&self, mode: Mode, from: Option<DVec3>) -> Result<Settings, CliError> {
        let to = self.to.as_deref().map(|s| point(s, "--to")).transpose()?;
        let ends = Ends { from, to };
        let radius = match (self.radius, mode) {
            (Some(RadiusArg::Paper), _) | (None, Mode::Paper) => Radius::Paper,
            (Some(RadiusArg::Measured), _) | (None, Mode::Default) => Radius::Measured,
        };
        Ok(Settings { route: RouteOptions { ends, tree: self.tree }, radius })
    }
}

/// Fields and centerline in one mode; the route is searched beside the visibility test.
pub fn center(
    device: &mut Device,
    lumen: &Lumen,
    mode: Mode,
    settings: Settings,
    clock: &mut Clock,
) -> Result<(Fields, Centered), CliError> {
    let fields = fields(device, lumen, mode == Mode::Default, clock)?;
    let centered = match mode {
        Mode::Default => {
            let mut aside = clock.beside();
            let (routed, seen) = beside(
                || route(lumen, &fields, settings.route, &mut aside),
                || seen(device, lumen, &fields, settings.radius, clock),
            );
            clock.take(aside);
            Centered::new(lumen, &fields, routed?, seen?)
        }
        Mode::Paper => paper_centered(device, lumen, &fields, settings.radius, clock)?,
    };
    Ok((fields, centered))
}

/// Rows of `unseen.csv`.
pub fn unseen_csv(lumen: &Lumen, unseen: &[u32]) -> String {
    let world = lumen.grid.world_from_voxel();
    let mut out = String::from("i,j,k,x,y,z\n");
    for &e in unseen {
        let v = lumen.bricks.voxel(e as usize);
        let p = world.transform_point3(v.as_dvec3());
        out += &format!("{},{},{},{:.4},{:.4},{:.4}\n", v.x, v.y, v.z, p.x, p.y, p.z);
    }
    out
}

impl Args {
    /// Extracts and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, LINES)?;
        let chosen = self.lumen.load(self.input.as_deref(), global)?;
        let (lumen, _) = chosen.lumen(global)?;
        let mut device = global.open()?;
        let mode = self.mode.main();
        let from = self.from.as_deref().map(|s| point(s, "--from")).transpose()?;
        let settings = self.path.settings(mode, from)?;
        let ((_, found), timing) = timed(global, &mut device, |device, clock| {
            center(device, &lumen, mode, settings, clock)
        })?;
        write_centerline(&self.output, &found.line)?;
        if let Some(path) = &self.unseen {
            let csv = unseen_csv(&lumen, &found.unseen);
            crate::formats::atomic_file::write_atomic(path, |o| o.write_all(csv.as_bytes()))?;
        }
        let report = CenterlineReport::of(&found, &lumen);
        global.say(format_args!(
            "wrote {}: {} points, {:.1} mm, {} branch{}, clearance at least {:.2} mm, {:.2} % of the boundary seen",
            self.output.display(),
            report.points,
            report.length_mm,
            report.branches,
            if report.branches == 1 { "" } else { "es" },
            report.min_clearance_mm,
            100.0 * report.boundary_seen_fraction
        ))?;
        let json = |r: &CenterlineReport| serde_json::to_value(r).unwrap_or_default();
        let mut timing = timing.with("centerline", json(&report));
        if self.mode.mode == Modes::Both {
            let settings = self.path.settings(Mode::Paper, from)?;
            let (_, paper) =
                center(&mut device, &lumen, Mode::Paper, settings, &mut Clock::default())?;
            let paper = CenterlineReport::of(&paper, &lumen);
            timing = timing.with(
                "modes",
                serde_json::json!({ "default": json(&report), "paper": json(&paper) }),
            );
        }
        global.answer(&timing)
    }
}

//! `intima centerline`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, LINES};
use super::lumen_args::{LumenArgs, point};
use super::mode::ModeArg;
use super::repeat::timed_products;
use crate::centerline::Loops;
use crate::formats::{atomic_file, shown, to_json, write_branches, write_centerline};
use crate::session::{CenterlineReport, CenterlineSettings, EndPoint, Product, Session, Settings};

/// `intima centerline INPUT LUMEN -o LINE`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Centerline to write: .vtp, .mrk.json, .csv or .swc
    #[arg(short, long, value_name = "LINE")]
    output: PathBuf,
    /// Write boundary voxels that a flight along the path does not see (i,j,k,x,y,z,patch)
    #[arg(long, value_name = "CSV")]
    unseen: Option<PathBuf>,
    /// Write the paths to all tips split into branches and bifurcations, as VMTK does
    #[arg(long, value_name = "VTP")]
    branches: Option<PathBuf>,
    /// Write all branches with their loops as a graph of nodes and edges (intima.graph/1)
    #[arg(long, value_name = "JSON")]
    graph: Option<PathBuf>,
    #[command(flatten)]
    mode: ModeArg,
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
    /// Treatment of loops in a tree
    #[arg(long, value_enum, default_value = "keep", requires = "tree")]
    pub loops: Loops,
    /// Start here: a place, LPS mm, the root of the tree or the tip of a branch of it (--tree numbers
    /// them)
    #[arg(long, value_name = "X,Y,Z|root|tip:N", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// End here, as --from
    #[arg(long, value_name = "X,Y,Z|root|tip:N", allow_hyphen_values = true)]
    pub to: Option<String>,
}

impl PathArgs {
    /// Checks the flags.
    pub fn settings(&self) -> Result<CenterlineSettings, CliError> {
        let end = |s: &Option<String>, flag| s.as_deref().map(|s| end_point(s, flag)).transpose();
        Ok(CenterlineSettings {
            from: end(&self.from, "--from")?,
            to: end(&self.to, "--to")?,
            tree: self.tree,
            loops: self.loops,
        })
    }
}

/// An end of the path by its place or name.
fn end_point(text: &str, flag: &'static str) -> Result<EndPoint, CliError> {
    if text == "root" {
        return Ok(EndPoint::Root);
    }
    match text.strip_prefix("tip:") {
        None => Ok(EndPoint::Point(point(text, flag)?)),
        Some(number) => number.parse().map(EndPoint::Tip).map_err(|_| {
            CliError::Usage(format!("{flag} {text}: tip:N with the number of a branch"))
        }),
    }
}

impl Args {
    /// Extracts and writes.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, LINES)?;
        self.lumen.check_outputs(global)?;
        self.graph.as_deref().map_or(Ok(()), |p| global.check_output(p, &[".json"]))?;
        self.branches.as_deref().map_or(Ok(()), |p| global.check_output(p, &[".vtp"]))?;
        self.mode.check(self.path.tree)?;
        let settings = Settings {
            mode: self.mode.mode,
            lumen: self.lumen.settings()?,
            centerline: self.path.settings()?,
            ..global.settings()
        };
        let mut session = Session::new(self.lumen.source(self.input.as_deref())?, settings)?;
        session.expect(&[Product::Centerline]);
        let needs = [Product::Lumen, Product::Device];
        let anew = [Product::Distance, Product::Fields, Product::Wall];
        let (found, timing) =
            timed_products(global, &mut session, &needs, &anew, |s| Ok(s.centerline()?))?;
        write_centerline(&self.output, &found.line)?;
        self.branches.as_deref().map_or(Ok(()), |p| write_branches(p, &found.line))?;
        self.lumen.write_choice(&session, global)?;
        if let Some(path) = &self.unseen {
            let csv = global.watched(&session, || session.unseen_csv())?;
            atomic_file::write_atomic(path, |o| o.write_all(csv.as_bytes()))?;
        }
        if let Some(path) = &self.graph {
            let graph = global.watched(&session, || session.graph())?;
            let text = to_json(&graph).map_err(|e| CliError::System(e.to_string()))?;
            atomic_file::write_atomic(path, |o| o.write_all(text.as_bytes()))?;
        }
        let tree = global.watched(&session, || session.tree())?;
        let report = CenterlineReport { tree, ..CenterlineReport::of(&found, &*session.lumen()?) };
        let of_tree = report.tree.as_ref().map(|t| format!("\n  tree: {t}")).unwrap_or_default();
        global.say(format_args!(
            "wrote {}: {} points, {:.1} mm, {} branch{}, clearance at least {:.2} mm{of_tree}",
            shown(&self.output),
            report.points,
            report.length_mm,
            report.branches,
            if report.branches == 1 { "" } else { "es" },
            report.min_clearance_mm,
        ))?;
        global.answer(&timing.with("centerline", &report))
    }
}

//! `intima run`: everything into one folder.

use std::path::Path;

use super::CliError;
use super::global::Global;
use super::repeat::timed_products;
use super::session_args::SessionArgs;
use crate::formats::shown;
use crate::report_page::ReportPage;
use crate::session::{Product, Recording, Report, RunOutcome};

/// `intima run INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Write base.ply too: the wall simplified to a twentieth of its faces, or to --decimate
    #[arg(long)]
    base: bool,
    /// Leave report.html out
    #[arg(long)]
    no_page: bool,
    /// Heading of report.html; the page itself names no file and no patient
    #[arg(long, value_name = "TEXT", conflicts_with = "no_page")]
    title: Option<String>,
    #[command(flatten)]
    flags: SessionArgs,
}

impl Args {
    /// A run by these flags.
    pub fn new(flags: SessionArgs) -> Self {
        Self { flags, base: false, no_page: false, title: None }
    }

    /// Computes everything and writes everything, the report last.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let out = &self.flags.out;
        self.flags.check_files(global, &out.join("frames"))?;
        let mut session = self.flags.session(global)?;
        let frames = out.join("frames");
        let recording = Recording {
            pictures: !self.no_page,
            base: self.base || self.flags.surface.decimate.is_some(),
            release_products: true,
            ..self.flags.recording(frames)
        };
        let mut timing = None;
        if global.repeat.is_some() {
            let needs = [Product::Volume, Product::Device];
            let anew = [Product::Lumen, Product::Inputs];
            let (_, repeats) =
                timed_products(global, &mut session, &needs, &anew, |s| Ok(s.compute_all()?))?;
            timing = Some(repeats);
        }
        let RunOutcome { mut report, pictures, stream: _stream } =
            global.watched(&session, || session.run_to_folder(out, &recording))?;
        self.flags.lumen.write_choice(&session, global)?;
        match &timing {
            Some(repeats) => {
                report.timing = repeats.keys();
                report.stages.clone_from(&repeats.stages);
            }
            None => report.add_own_timing(),
        }
        if !self.no_page {
            let (report, pictures) = (Some(&report), pictures.as_ref());
            let page = ReportPage {
                report,
                pictures,
                title: self.title.as_deref(),
                ..ReportPage::default()
            };
            page.write(out)?;
        }
        session.write_report(out, &report)?;
        global.say(summary(&report, out))?;
        global.answer_only(&report)
    }
}

fn summary(r: &Report, out: &Path) -> String {
    let mut s = format!("wrote {}\n", shown(out));
    if let (Some(l), Some(w), Some(c), Some(f)) = (&r.lumen, &r.surface, &r.centerline, &r.frames) {
        s += &format!(
            "  lumen       {} voxels, {:.2} ml, {} bricks\n",
            l.internal_voxels + l.boundary_voxels,
            l.volume_ml,
            l.bricks
        );
        s += &format!(
            "  surface     {} vertices, {} faces, Euler number {}, {}\n",
            w.vertices,
            w.faces,
            w.euler,
            if w.watertight { "watertight" } else { "NOT watertight" }
        );
        s += &format!(
            "  centerline  {} branch(es), {:.1} mm, clearance at least {:.2} mm\n",
            c.branches, c.length_mm, c.min_clearance_mm,
        );
        if let Some(tree) = &c.tree {
            s += &format!("  tree        {tree}\n");
        }
        s += &format!(
            "  frames      {} of {} x {}, {:.0} ms each (median), {:.1} s of flight\n",
            f.count, f.width, f.height, f.p50_ms, f.flight_seconds
        );
    }
    if let Some(c) = &r.coverage {
        s += &format!(
            "  coverage    {:.1} % of the wall seen one way, {:.1} % both ways; {} missed patch(es) of {} mm² or more\n",
            100.0 * c.one_way_fraction,
            100.0 * c.both_ways_fraction,
            c.patches.len(),
            c.listed_from_mm2
        );
    }
    s + &format!("  {:.2} s in all, {:.0} MB at most", r.total_ms / 1000.0, r.peak_memory_mb)
}

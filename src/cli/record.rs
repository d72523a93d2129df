//! `intima record`.

use super::CliError;
use super::global::Global;
use super::repeat::timed_products;
use super::session_args::SessionArgs;
use crate::formats::shown;
use crate::session::Product;

/// `intima record INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    flags: SessionArgs,
}

impl Args {
    /// Computes what a flight needs, flies, writes frames.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        self.flags.check_files(global, &self.flags.out)?;
        let mut session = self.flags.session(global)?;
        let recording = self.flags.recording(self.flags.out.clone());
        session.expect(&session.products_of_frames());
        let needs = [Product::Lumen, Product::Device];
        let anew = [Product::Distance, Product::Fields, Product::Wall];
        let (stream, timing) = if global.repeat.is_some() {
            let (_, timing) =
                timed_products(global, &mut session, &needs, &anew, |s| Ok(s.draw_all()?))?;
            (session.record(&recording)?, timing)
        } else {
            timed_products(global, &mut session, &needs, &[], |s| Ok(s.record(&recording)?))?
        };
        session.prepare(&[Product::Coverage])?;
        self.flags.lumen.write_choice(&session, global)?;
        let mut report = session.report(Some(&stream))?;
        report.stages = timing.stages.clone();
        report.timing = timing.keys();
        let frames = stream.report();
        global.say(format_args!(
            "wrote {} frames to {} ({:.1} s of flight)",
            frames.count,
            shown(&self.flags.out),
            frames.flight_seconds
        ))?;
        global.answer_only(&report)
    }
}

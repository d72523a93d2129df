//! `intima record`.

use super::CliError;
use super::chain::{ChainArgs, Subject, for_run};
use super::global::Global;
use super::lumen_args::Chosen;
use super::timing::timed;

/// `intima record INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    chain: ChainArgs,
}

impl Args {
    /// Computes what a flight needs, flies, writes frames.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let a = &self.chain;
        let setup = a.frames.check(global)?;
        a.settings(a.mode.main())?;
        let chosen = a.lumen.load(a.input.as_deref(), global)?;
        let (lumen, found) = chosen.lumen(global)?;
        let mut device = global.open()?;
        let Chosen { volume, recipe } = chosen;
        let mut held = Some(volume);
        let ((flown, ()), timing) = timed(global, &mut device, |device, clock| {
            let volume = for_run(&mut held, global);
            let subject = Subject { volume, recipe: &recipe, lumen: &lumen };
            a.fly(device, subject, (&setup, &a.out), clock, |_, _| ())
        })?;
        global.say(format_args!(
            "wrote {} frames to {} ({:.1} s of flight)",
            flown.film.report.count,
            a.out.display(),
            flown.film.report.flight_seconds
        ))?;
        let mut report = flown.report((&lumen, &found), &timing.device, &timing.clock);
        report.timing = timing.keys();
        global.answer_only(&report)
    }
}

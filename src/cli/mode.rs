//! `--mode`.

use super::CliError;
use crate::centerline::CenterlineError;
use crate::session::{CenterlineReport, Mode, Modes, Session, SessionError};

/// `--mode`
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ModeArg {
    /// default does what is right; paper does what the paper says; both reports both
    #[arg(long, value_enum, default_value = "default")]
    pub mode: ModeChoice,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ModeChoice {
    Default,
    Paper,
    Both,
}

impl ModeArg {
    /// The mode whose products are written.
    pub fn main(self) -> Mode {
        if self.mode == ModeChoice::Paper { Mode::Paper } else { Mode::Default }
    }

    /// Refuses a tree before anything is computed where the paper's figures are asked for.
    pub fn check(self, tree: bool) -> Result<(), CliError> {
        if tree && self.mode != ModeChoice::Default {
            return Err(SessionError::from(CenterlineError::PaperTree).into());
        }
        Ok(())
    }

    /// Whether the paper's figures are reported beside the default's.
    pub fn is_both(self) -> bool {
        self.mode == ModeChoice::Both
    }
}

/// The centerline's figures in both modes, if asked for.
pub fn modes(session: &Session, both: bool) -> Result<Option<Modes>, CliError> {
    if !both {
        return Ok(None);
    }
    let lumen = session.lumen()?;
    let paper = session.in_mode(Mode::Paper);
    let of = |s: &Session| -> Result<_, CliError> {
        Ok(CenterlineReport::of(&*s.centerline()?, &lumen.lumen))
    };
    Ok(Some(Modes { default: of(session)?, paper: of(&paper)? }))
}

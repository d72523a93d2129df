//! `--mode`.

use super::CliError;
use crate::centerline::CenterlineError;
use crate::session::{Mode, SessionError};

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

    /// Refuses a tree before anything is computed where the paper's figures are asked for.
    pub fn check(self, tree: bool) -> Result<(), CliError> {
        if tree && self.mode != Modes::Default {
            return Err(SessionError::from(CenterlineError::PaperTree).into());
        }
        Ok(())
    }

    /// Whether the paper's figures are reported beside the default's.
    pub fn is_both(self) -> bool {
        self.mode == Modes::Both
    }
}

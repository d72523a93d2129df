//! `--mode`.

use super::CliError;
use crate::centerline::CenterlineError;
use crate::session::{Mode, SessionError};

/// `--mode`
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ModeArg {
    /// Methods of each stage
    #[arg(long, value_enum, default_value = "default")]
    pub mode: Mode,
}

impl ModeArg {
    /// Refuses a tree in paper mode before anything is computed.
    pub fn check(self, tree: bool) -> Result<(), CliError> {
        if tree && self.mode == Mode::Paper {
            return Err(SessionError::from(CenterlineError::PaperTree).into());
        }
        Ok(())
    }
}

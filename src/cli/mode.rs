//! `--mode`.

use crate::session::Mode;

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

    /// Whether the paper's figures are reported beside the default's.
    pub fn is_both(self) -> bool {
        self.mode == Modes::Both
    }
}

//! Mode of the chain: our methods or the paper's. The paper's stages are rows of the table of stages;
//! this table has the stages that both modes have, with different methods.

use super::WallMethod;
use crate::mesh::Metric;
use crate::surface::{Fairing, Smoothing};

/// Methods that the chain follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Mode {
    /// Our own methods
    #[default]
    Default,
    /// Methods of the paper (Li et al. 2004), errors and all
    Paper,
}

/// Methods of a mode, for what the settings leave open.
pub(super) struct Methods {
    /// Normal smoothing.
    pub smoothing: Smoothing,
    /// Place of the wall.
    pub wall: WallMethod,
    /// Cost of a collapse.
    pub metric: Metric,
    /// Whether vertices of the base move to where they stand best.
    pub relocate: bool,
    /// Whether a centerline has branches and loops.
    pub branches: bool,
}

impl Mode {
    /// Returns the methods of the mode.
    pub(super) fn methods(self) -> &'static Methods {
        match self {
            Self::Default => &Methods {
                smoothing: Smoothing::Multiscale,
                wall: WallMethod::Auto,
                metric: Metric::NormalQem,
                relocate: true,
                branches: true,
            },
            Self::Paper => &Methods {
                smoothing: Smoothing::Steps(Fairing::PAPER),
                wall: WallMethod::Exact,
                metric: Metric::Paper,
                relocate: false,
                branches: false,
            },
        }
    }
}

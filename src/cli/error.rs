//! Errors as the user meets them, and their exit codes.

use crate::cohort::CohortError;
use crate::device::DeviceError;
use crate::flight::CameraPathError;
use crate::formats::FormatError;
use crate::mesh::{MeshError, ParameterizationError};
use crate::session::{SessionError, SettingError};
use crate::volume::GridError;

/// Failure of a command.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CliError {
    /// Arguments that make no sense together.
    #[error("{0}")]
    Usage(String),
    /// Input that is not what the command needs.
    #[error("{0}")]
    Input(String),
    /// Failure of a stage, a file or the device.
    #[error(transparent)]
    Session(SessionError),
    /// More memory than `--max-memory` allows.
    #[error("this needs about {needed_mb} MB, more than --max-memory {allowed_mb} MB ({what})")]
    Memory {
        /// Estimate, MB.
        needed_mb: u64,
        /// Limit, MB.
        allowed_mb: u64,
        /// Data that take the memory.
        what: &'static str,
    },
    /// A cohort as a whole.
    #[error(transparent)]
    Cohort(CohortError),
    /// Cases of a cohort; each has its reason in its status.
    #[error("{failed} of {total} cases failed")]
    CasesFailed {
        /// Number of cases that failed.
        failed: usize,
        /// Number of cases.
        total: usize,
        /// Exit code of all that failed; 1 where they differ.
        code: u8,
    },
    /// No display for a window.
    #[error("{0}")]
    NoDisplay(String),
    /// Standard output.
    #[error("standard output: {0}")]
    Output(std::io::Error),
    /// The system.
    #[error("{0}")]
    System(String),
}

impl CliError {
    /// 1 failed, 2 bad arguments, 3 bad input, 4 no usable device, 130 stopped.
    pub fn exit_code(&self) -> u8 {
        use SessionError as S;
        let error = match self {
            Self::Usage(_) => return 2,
            Self::Input(_) => return 3,
            Self::NoDisplay(_) => return 4,
            Self::CasesFailed { code, .. } => return *code,
            Self::Cohort(error) => return exit_code_of(error),
            Self::Session(error) => error,
            Self::Memory { .. } | Self::Output(_) | Self::System(_) => return 1,
        };
        match error {
            S::LumenNotChosen { .. } => 2,
            S::Format(e) if e.is_bad_input() => 3,
            S::Lumen(_) | S::Organ(_) | S::Centerline(_) | S::Mesh(_) | S::Maps(_) => 3,
            S::Tissue(_)
            | S::Flight(_)
            | S::CameraPath(_)
            | S::ShearedGrid { .. }
            | S::Enclosed { .. } => 3,
            S::Device(e) if e.is_no_device() => 4,
            S::Render(e) if e.is_no_device() => 4,
            S::Cancelled => 130,
            _ => 1,
        }
    }

    /// A code for programs: the kind of error and, where there is one, of its cause, in lower case
    /// with dashes, such as `lumen/seed-outside`. Holds no text of any file.
    pub fn reason(&self) -> String {
        use SessionError as S;
        match self {
            Self::Usage(_) => "usage".into(),
            Self::Input(_) => "input".into(),
            Self::NoDisplay(_) => "no-display".into(),
            Self::Memory { .. } => "memory".into(),
            Self::Output(_) => "output".into(),
            Self::System(_) => "system".into(),
            Self::CasesFailed { .. } => "cases-failed".into(),
            Self::Cohort(error) => format!("cohort/{}", variant(error)),
            Self::Session(error) => match error {
                S::Format(e) => format!("file/{}", variant(e)),
                S::Lumen(e) => format!("lumen/{}", variant(e)),
                S::Organ(e) => format!("organ/{}", variant(e)),
                S::Centerline(e) => format!("centerline/{}", variant(e)),
                S::Device(e) => format!("device/{}", variant(e)),
                S::Mesh(e) => format!("mesh/{}", variant(e)),
                S::Flight(e) => format!("flight/{}", variant(e)),
                S::CameraPath(e) => format!("camera-path/{}", variant(e)),
                S::Tissue(e) => format!("tissue/{}", variant(e)),
                S::Render(e) => format!("render/{}", variant(e)),
                other => variant(other),
            },
        }
    }

    /// Whether standard output was closed by its reader.
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(e) if e.kind() == std::io::ErrorKind::BrokenPipe)
    }
}

fn exit_code_of(error: &CohortError) -> u8 {
    match error {
        CohortError::NoSuchLabel { .. } | CohortError::Output { .. } => 2,
        CohortError::Format(e) if !e.is_bad_input() => 1,
        _ => 3,
    }
}

/// Name of an enum's variant, from the first word of its debug text.
fn variant(error: &impl std::fmt::Debug) -> String {
    let text = format!("{error:?}");
    let name = text.split(|c: char| !c.is_ascii_alphanumeric()).next().unwrap_or_default();
    let mut out = String::new();
    for (i, c) in name.chars().enumerate() {
        if c.is_ascii_uppercase() && i > 0 {
            out.push('-');
        }
        out.push(c.to_ascii_lowercase());
    }
    out
}

impl From<SessionError> for CliError {
    /// Adds the flags that would help, which the library does not know.
    fn from(e: SessionError) -> Self {
        match e {
            SessionError::LumenNotChosen { name, organ } => {
                let organ = organ.map_or("--organ airway, colon or vessel".into(), |organ| {
                    let organ = organ.name();
                    format!("--organ {organ} (there seems to be one)")
                });
                Self::Usage(format!(
                    "{name}: not a label map, so the lumen must be chosen: {organ}, \
                     --mask FILE[:LABEL], --threshold LO:HI with --seed I,J,K, or \
                     --threshold LO:HI alone for the largest component"
                ))
            }
            SessionError::Setting(SettingError { name, value, allowed }) => {
                Self::Usage(format!("--{} {value}: {allowed}", name.replace('_', "-")))
            }
            SessionError::Memory { needed_mb, allowed_mb, what } => {
                Self::Memory { needed_mb, allowed_mb, what }
            }
            other => Self::Session(other),
        }
    }
}

impl From<CohortError> for CliError {
    fn from(e: CohortError) -> Self {
        Self::Cohort(e)
    }
}

impl From<FormatError> for CliError {
    fn from(e: FormatError) -> Self {
        SessionError::from(e).into()
    }
}

impl From<MeshError> for CliError {
    fn from(e: MeshError) -> Self {
        SessionError::from(e).into()
    }
}

impl From<ParameterizationError> for CliError {
    fn from(e: ParameterizationError) -> Self {
        SessionError::from(e).into()
    }
}

impl From<CameraPathError> for CliError {
    fn from(e: CameraPathError) -> Self {
        SessionError::from(e).into()
    }
}

impl From<SettingError> for CliError {
    fn from(e: SettingError) -> Self {
        SessionError::from(e).into()
    }
}

impl From<DeviceError> for CliError {
    fn from(e: DeviceError) -> Self {
        SessionError::from(e).into()
    }
}

impl From<GridError> for CliError {
    fn from(e: GridError) -> Self {
        Self::Usage(e.to_string())
    }
}

#[cfg(feature = "window")]
impl From<crate::app::AppError> for CliError {
    fn from(e: crate::app::AppError) -> Self {
        use crate::app::AppError as A;
        match e {
            A::NoDisplay(_) => Self::NoDisplay(e.to_string()),
            A::Session(e) => e.into(),
            A::Vulkan(e) => SessionError::from(DeviceError::from(e)).into(),
            A::Render(e) => SessionError::from(e).into(),
            A::Format(e) => e.into(),
            A::Script { .. } | A::SessionFile { .. } => Self::Input(e.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::LumenError;

    #[test]
    fn reason_codes_name_kind_and_cause() {
        let e = CliError::from(SessionError::from(LumenError::SeedPoint([0.0; 3])));
        assert_eq!((e.reason().as_str(), e.exit_code()), ("lumen/seed-point", 3));
        let e = CliError::from(SessionError::Cancelled);
        assert_eq!((e.reason().as_str(), e.exit_code()), ("cancelled", 130));
        assert_eq!(CliError::Usage("x".into()).reason(), "usage");
    }
}

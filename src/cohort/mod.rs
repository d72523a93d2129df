//! Cohorts: many scans through the same settings, as a BIDS-App.
//!
//! A [`Case`] is one scan and its name. [`find_cases`] lists those of a BIDS dataset or of a plain
//! folder. A case is done when its [`CaseStatus`] holds exit code 0, its key is that of the present
//! program, settings and input bytes, and every output has its size; so a cohort that was stopped
//! anywhere goes on where it stopped. [`Dataset`] knows the places of all files in the folder of
//! outputs. [`QualityTable`] and [`quality_page`] show all cases side by side.
//!
//! This room computes nothing of a volume: a case is a run of the command line.

mod cases;
mod dataset;
mod derivatives;
mod error;
mod key;
mod labels;
mod outliers;
mod page;
mod pattern;
mod quality;
mod status;

pub use cases::{Case, CaseNames, Selection, find_cases};
pub use dataset::Dataset;
pub use derivatives::{clear_outputs, place_outputs};
pub use error::CohortError;
pub use key::{Key, Recipe, build_id};
pub use page::quality_page;
pub use pattern::Pattern;
pub use quality::{CaseState, QualityRow, QualityTable};
pub use status::{CaseStatus, Check, InputFile, OutputFile};

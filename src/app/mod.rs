//! The window: a [`Session`](crate::session::Session) computes, hands fly. It owns no stage.
//!
//! `model` holds the state and carries out actions; `ui` lays panels out and turns input into
//! commands; `panes` draws the two pictures of the wall; `viewer` puts a frame together from these
//! and has the session compute, for a window (`window`) or on an image with a clock of its own
//! (`script`).

mod action;
mod branch_panel;
mod canvas;
mod colouring;
mod computation;
mod coverage_recorder;
mod doubts;
mod dialogs;
mod error;
mod export;
mod figures;
mod finding;
mod findings_panel;
mod first_page;
mod grey_window;
mod inside_marks;
mod inside_pane;
mod junctions;
mod kept_notes;
mod keys;
mod labels;
mod layout;
mod lumen_panel;
mod lumen_question;
mod marked_view;
mod measure;
mod missed_panel;
mod model;
mod notice;
mod opening;
mod overview_pane;
#[cfg(test)]
mod panel_tests;
mod pane_view;
mod panes;
mod saved_case;
mod saved_flight;
mod script;
mod session_file;
mod side_panel;
mod slice_pane;
mod slices;
mod style;
mod timeline;
mod top_bar;
mod ui;
mod viewer;
mod wall_outline;
mod window;

pub use action::{
    Action, ActionQueue, Colouring, Command, EXTENT_MM, Export, FOV_DEG, LumenChoice, Pane,
    PaneLayout, Request, Ruler, SLAB_MM, SPEED_MM_S, SlabMode, SliceExtent, WallView,
};
pub use coverage_recorder::{CoverageRecorder, SeenFaces};
pub use error::AppError;
pub use finding::{Confidence, FindingEdit, LesionShape};
pub use junctions::BranchChoice;
pub use kept_notes::{KeptOffer, RecentCase};
pub use measure::Measurement;
pub use model::{Bookmark, Model, SavedEye, SavedView, WayTo};
pub use opening::{SavedEnds, SavedLumen, SavedSettings};
pub use saved_case::{SavedCase, SavedInput};
pub use script::{SCRIPT_SCHEMA, Script, ScriptStep, Wait, play};
pub use session_file::{SESSION_SCHEMA, SessionFile};
pub use viewer::ViewerOptions;
pub use window::{WindowOptions, close_window, open};

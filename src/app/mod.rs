//! The window: a [`Session`](crate::session::Session) computes, hands fly. It owns no stage.
//!
//! `model` holds the state and carries out actions; `ui` lays panels out and turns input into
//! actions; `panes` draws the two pictures of the wall; `stage` puts a frame together from these,
//! onto a window (`window`) or onto an image with a clock of its own (`script`).

mod action;
mod colouring;
mod error;
mod export;
mod inside_marks;
mod junctions;
mod keys;
mod measure;
mod model;
mod painter;
mod panes;
mod script;
mod session_file;
mod side_panel;
mod slice_pane;
mod slices;
mod stage;
mod study;
mod style;
mod timeline;
mod ui;
mod window;

pub use action::{
    Action, Colouring, Command, Commands, Export, FOV_DEG, LumenChoice, Pane, Request, Ruler,
    SPEED_MM_S, WallView,
};
pub use error::AppError;
pub use junctions::Choice;
pub use measure::Measurement;
pub use model::{Bookmark, Model, Products};
pub use painter::{Painter, Shown};
pub use script::Playing;
pub use script::{SCRIPT_SCHEMA, Script, ScriptStep, Wait, play};
pub use session_file::{SESSION_SCHEMA, SessionFile};
pub use study::{Case, News, Study};
pub use window::{WindowOptions, open};

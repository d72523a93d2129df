//! The centerline: the lumen's graph, paths and trees along it, smooth centred curves that are proven
//! inside, frames along them; the visibility test.

mod arc_graph;
mod branches;
mod chain_route;
mod recenter;
mod clearance_refine;
pub mod complex;
mod ends;
mod frames;
mod inscribed;
mod pieces;
mod containment;
mod queue;
mod route;
mod route_options;
mod section;
mod spline;
mod visibility;
mod within_wall;

pub use containment::{Proof, safe_by_distance, safe_by_voxels};
pub use ends::{ChosenEnd, EndRule};
pub use frames::{CurveFrame, frames, tangents};
pub use inscribed::measure_radius;
pub use recenter::{arc_lengths, resample};
pub use route::{GraphNode, LumenLoop, Routed, centerline};
pub use route_options::{Ends, Loops, RouteOptions};
pub use visibility::{Pending, Viewpoint, VisibilityInput, add_viewers};
pub use within_wall::{WithinWall, clearance_mm, within_wall};

use glam::DVec3;

/// Reasons why there is no centerline.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CenterlineError {
    /// The lumen has no voxel.
    #[error("no centerline: the lumen is empty")]
    Empty,
    /// A given end is not in the lumen.
    #[error("the {which} ({:.2}, {:.2}, {:.2}) mm is outside the lumen; the nearest inside voxel is {nearest_mm:.1} mm away", .at.x, .at.y, .at.z)]
    OutsideLumen {
        /// Name of the end: `start` or `end`.
        which: &'static str,
        /// Position of the end, LPS mm.
        at: DVec3,
        /// Distance to the nearest inside voxel centre, mm.
        nearest_mm: f64,
    },
    /// The tree has no branch of a number.
    #[error("no branch {branch}: the tree has {branches}, numbered from 0")]
    NoTip {
        /// Number that was asked for.
        branch: usize,
        /// Branches of the tree.
        branches: usize,
    },
    /// The paper's method makes one path: its points carry no order that a tree could be read from.
    #[error("the paper's method (Li et al. 2004) joins its points into one path; it has no tree")]
    PaperTree,
    /// No legal route joins the ends: they touch by edges or corners of voxels at best.
    #[error("no path: the ends lie in parts of the lumen that no face-connected route joins")]
    Unreachable,
}

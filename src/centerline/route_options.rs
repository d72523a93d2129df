//! Options of the extraction of paths and trees.

use glam::DVec3;

/// Given ends, LPS mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// Start of the path, or root of the tree.
    pub from: Option<DVec3>,
    /// End of the path.
    pub to: Option<DVec3>,
}

/// Treatment of loops in a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Loops {
    /// A branch that closes a loop ends on another.
    #[default]
    Keep,
    /// A branch that closes a loop is cut where both sides are equally far from the root.
    Cut,
}

/// Options of the extraction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RouteOptions {
    /// Given ends; the others are found.
    pub ends: Ends,
    /// Whether all branches are extracted instead of one path.
    pub tree: bool,
    /// Treatment of loops in a tree.
    pub loops: Loops,
    /// Point, LPS mm, in the first piece of an organ: where the place of the ends in the patient does
    /// not say which is the start, the end nearer to the point is.
    pub starts_near: Option<DVec3>,
    /// Upper end of a trachea that the organ search found, LPS mm: the start of path and tree.
    pub trachea: Option<DVec3>,
}

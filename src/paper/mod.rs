//! The paper's own chain (Li et al. 2004, sections 3.1 and 3.2): for `--mode paper`.
//!
//! [`ridge`] finds the points of the distance map's ridge; each sees as far as Eq. 5 says
//! ([`RidgePoint::viewpoint`]). [`paper_path`] joins those that the visibility test keeps by Dijkstra's
//! search, and bridges what no ray joins over voxels ([`VoxelRoutes`]). The table of stages has a row
//! for each beside the default mode's. The paper's normals, simplification and subdivision are
//! choices of `surface`, `mesh` and `lod`.

pub mod kernels;
mod path;
mod ridge;
mod voxel_routes;

pub use path::paper_path;
pub use ridge::{RidgePoint, RidgePoints, ridge};
pub use voxel_routes::{NOWHERE, VoxelRoutes};

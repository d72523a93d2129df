//! The wall finer than the voxel, where it is near the eye.
//!
//! Near the eye a voxel is wider than many pixels and the flat faces of a mesh show. There each face
//! is split 1-to-4 as often as a camera asks, and every new vertex is put on the smooth wall
//! ([`SmoothWall`]): the zero of a spline through the field that the mesh was taken from. Faces that
//! look flat stay faces of the mesh. So the drawn wall is never coarser than the mesh, and no face is
//! flat where a pixel would show it.
//!
//! * A new vertex on an edge depends on the ends of the edge alone, and the fineness of an edge on the
//!   edge and the camera. Faces at an edge agree in every bit, so no crack opens.
//! * The vertices of a refined face stay in a slot of a buffer on the device ([`RefinedSlots`]).
//!   Another fineness is another index template and another word of the slot.
//!
//! Normals of new vertices are those of the mesh, interpolated: light does not change with the
//! fineness, positions alone do.
//!
//! Departure from the paper (Li et al. 2004), which refines a coarse base towards the mesh and ends
//! there: a mesh from voxels is the coarse base, and the wall itself is in the grey values.

mod grid;
mod near;
mod slots;
mod wall;

pub use near::RefinedDistance;
pub use slots::{PlacedFaces, RefinedSlots, SlotWrite};
pub use wall::{RefinedFace, RefinedWall, RefinedWallInput, SmoothWall};

#[cfg(test)]
mod tests;

//! The lumen as a cell complex.
//!
//! The complex of a lumen of up to [`CellComplex::MAX_FINE_VOXELS`] voxels has a node for every voxel:
//! a thin lumen, of which a voxel more or less decides where a branch ends. A larger lumen is coarse
//! in space and exact in topology: its bricks are cut into cells of 4³ voxels. A *node* is a 6-connected component of the lumen in a
//! cell; a *contact* a component of the face that two nodes share; a *run* a stretch of the edge
//! where four cells meet whose voxels are all inside; a *corner* eight cells' common corner with all
//! voxels inside. They are the elements of dimension 0 to 3 of a regular complex: a contact joins
//! two nodes, a run is bounded by four contacts, a corner by six runs. It has the homotopy type of
//! the 6-connected mask, except for loops and cavities within one cell.
//!
//! [`collapse`] takes elements away in pairs, those nearest to the wall first, until a graph with
//! every loop of the complex is left (discrete Morse theory: Forman 1998, Advances in Mathematics
//! 134:90, doi:10.1006/aima.1997.1650).

use crate::lumen::Lumen;
use crate::lumen::bricks::BRICK;

mod build;
pub mod cell;
mod collapse;
pub mod net;
pub mod sweep;
mod voxels;

pub use collapse::{Collapsed, collapse};

/// A component of the lumen in a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Voxels of the component ([`cell`]).
    pub voxels: u64,
    /// Cell: eight times the slot of its brick, plus x + 2 y + 4 z of its position in the brick.
    pub cell: u32,
    /// Field element of the deepest voxel, of several the lowest.
    pub deepest: u32,
    /// Depth of that voxel ([`CellComplex`]).
    pub key: u32,
}

/// A component of the face between two nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The nodes on its low and high side.
    pub nodes: [u32; 2],
    /// Voxels on the high side, as bits of a cell, in the plane at position 0 of the axis.
    pub mask: u64,
    /// Axis perpendicular to the contact.
    pub axis: u8,
    /// Field elements of the deepest pair of voxels.
    pub deepest: [u32; 2],
    /// Depth of the shallower voxel of that pair.
    pub key: u32,
}

/// A stretch of a cell edge with all four voxels around it inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeRun {
    /// The contacts around the run.
    pub contacts: [u32; 4],
    /// Positions along the edge, bits 0 to 3.
    places: u8,
    /// Greatest depth along the run.
    pub key: u32,
}

/// A cell corner with all eight voxels around it inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// The runs that end at the corner.
    pub runs: [u32; 6],
    /// Depth of the shallowest of the eight voxels.
    pub key: u32,
}

/// The complex, each kind in the order of cells: the same at any number of threads.
///
/// The depth of a voxel, or key, is 4 (d/h)², rounded, with its distance d to the wall and the smallest
/// spacing h. That of a pair, square or cube is its shallowest voxel's; that of an element the
/// greatest of its pairs, squares or cubes. So no element is deeper than what bounds it.
#[derive(Clone, Debug, Default)]
pub struct CellComplex {
    /// Elements of dimension 0.
    pub nodes: Vec<Node>,
    /// Elements of dimension 1.
    pub contacts: Vec<Contact>,
    /// Elements of dimension 2.
    pub runs: Vec<EdgeRun>,
    /// Elements of dimension 3.
    pub corners: Vec<Corner>,
    /// Node of each field element, where every voxel is a node; empty otherwise.
    node_of: Vec<u32>,
}

impl CellComplex {
    /// Largest number of voxels of a lumen whose complex has a node for each. A larger one would take
    /// longer than a second and hundreds of megabytes.
    pub const MAX_FINE_VOXELS: u64 = 1_000_000;

    /// The complex of a lumen. `distance`: exact distance to the wall, mm, in slot order.
    pub fn new(lumen: &Lumen, distance: &[f32]) -> Self {
        match lumen.inside_voxels() <= Self::MAX_FINE_VOXELS {
            true => Self::of_voxels(lumen, distance),
            false => Self::of_cells(lumen, distance),
        }
    }

    /// Whether every voxel is a node.
    pub fn is_fine(&self) -> bool {
        !self.node_of.is_empty()
    }

    /// Number of nodes along a chain that are about a cell's side apart.
    pub fn stride(&self) -> usize {
        if self.is_fine() { cell::SIDE } else { 1 }
    }

    /// Field element of a voxel of a node's cell, by its bit ([`cell`]).
    pub fn element(&self, node: u32, bit: u32) -> u32 {
        let (slot, place) =
            (self.nodes[node as usize].cell / 8, self.nodes[node as usize].cell % 8);
        let x = 4 * (place & 1) + (bit & 3);
        let y = 4 * (place >> 1 & 1) + (bit >> 2 & 3);
        let z = 4 * (place >> 2) + (bit >> 4);
        slot * BRICK as u32 + x + 8 * y + 64 * z
    }

    /// The node of an inside voxel, by its field element.
    pub fn node_at(&self, element: usize) -> Option<u32> {
        if self.is_fine() {
            return self.node_of.get(element).copied().filter(|n| *n != u32::MAX);
        }
        let (slot, place) = (element / BRICK, element % BRICK);
        let (x, y, z) = (place & 7, place >> 3 & 7, place >> 6);
        let cell = (8 * slot + (x >> 2) + 2 * (y >> 2) + 4 * (z >> 2)) as u32;
        let bit = (x & 3) + 4 * (y & 3) + 16 * (z & 3);
        let first = self.nodes.partition_point(|n| n.cell < cell);
        let of_cell = self.nodes[first..].iter().take_while(|n| n.cell == cell);
        let at = of_cell.enumerate().find(|(_, n)| n.voxels >> bit & 1 != 0)?.0;
        Some((first + at) as u32)
    }

    /// Euler characteristic.
    pub fn euler(&self) -> i64 {
        let [n, c, r, k] =
            [self.nodes.len(), self.contacts.len(), self.runs.len(), self.corners.len()]
                .map(|n| n as i64);
        n - c + r - k
    }

    /// Euler characteristic of the complex less that of the mask: due to loops and cavities of
    /// nodes and contacts within a cell.
    pub fn euler_within_cells(&self) -> i64 {
        let nodes: i64 = self.nodes.iter().map(|n| 1 - cell::euler(n.voxels)).sum();
        let contacts: i64 = self.contacts.iter().map(|c| 1 - cell::euler(c.mask)).sum();
        nodes - contacts
    }
}

#[cfg(test)]
mod tests;

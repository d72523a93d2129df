//! The complex of a thin lumen: every voxel is a node.
//!
//! Elements are numbered in the order of their places, not of the bricks that hold them, so that
//! ties between them do not depend on where the sides of bricks lie.

use glam::IVec3;
use rayon::prelude::*;

use super::{CellComplex, Contact, Corner, EdgeRun, Node};
use crate::lumen::Lumen;
use crate::lumen::bricks::BRICK;
use crate::task::checkpoint;

/// Number of a voxel or element that is not there.
const NONE: u32 = u32::MAX;
/// The two axes across each one.
const ACROSS: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// Numbers of nodes and contacts by place.
struct Numbered<'a> {
    lumen: &'a Lumen,
    /// Field element of each node.
    elements: Vec<u32>,
    /// Node of each field element.
    node_of: Vec<u32>,
    depths: Vec<u32>,
}

impl CellComplex {
    /// The complex of a lumen's voxels. `distance`: exact distance to the wall, mm, in slot order.
    pub(super) fn of_voxels(lumen: &Lumen, distance: &[f32]) -> Self {
        let numbered = Numbered::new(lumen, distance);
        let nodes = numbered.nodes();
        let (contacts, contact_of) = numbered.contacts();
        let (runs, run_of) = numbered.runs(&contact_of);
        let corners = numbered.corners(&run_of);
        Self { nodes, contacts, runs, corners, node_of: numbered.node_of }
    }
}

impl<'a> Numbered<'a> {
    fn new(lumen: &'a Lumen, distance: &[f32]) -> Self {
        let mut places: Vec<([i32; 3], u32)> = lumen
            .elements(&lumen.inside)
            .map(|element| {
                let v = lumen.bricks.voxel(element);
                ([v.z, v.y, v.x], element as u32)
            })
            .collect();
        places.par_sort_unstable();
        let elements: Vec<u32> = places.iter().map(|place| place.1).collect();
        let mut node_of = vec![NONE; lumen.bricks.field_len()];
        for (node, element) in (0..).zip(&elements) {
            node_of[*element as usize] = node;
        }
        let scale = (2.0 / lumen.grid.spacing_mm.min_element()) as f32;
        let depth = |element: &u32| {
            let root = distance[*element as usize] * scale;
            (root * root).round() as u32
        };
        let depths = elements.par_iter().map(depth).collect();
        Self { lumen, elements, node_of, depths }
    }

    fn nodes(&self) -> Vec<Node> {
        let node = |(element, key): (&u32, &u32)| {
            let (slot, place) = (element / BRICK as u32, element % BRICK as u32);
            let [x, y, z] = [place & 7, place >> 3 & 7, place >> 6];
            let cell = 8 * slot + (x >> 2) + 2 * (y >> 2) + 4 * (z >> 2);
            let voxels = 1 << ((x & 3) + 4 * (y & 3) + 16 * (z & 3));
            Node { voxels, cell, deepest: *element, key: *key }
        };
        self.elements.par_iter().zip(&self.depths).map(node).collect()
    }

    /// The node a step away.
    #[inline]
    fn beside(&self, node: u32, step: IVec3) -> Option<u32> {
        let to = self.lumen.bricks.step(self.elements[node as usize] as usize, step)?;
        Some(self.node_of[to]).filter(|n| *n != NONE)
    }

    /// Contacts with the next voxel along each axis, and their numbers by node and axis.
    fn contacts(&self) -> (Vec<Contact>, Vec<[u32; 3]>) {
        let mut contacts = Vec::with_capacity(3 * self.elements.len());
        let mut number = vec![[NONE; 3]; self.elements.len()];
        for node in 0..self.elements.len() as u32 {
            check(node);
            for (axis, number) in number[node as usize].iter_mut().enumerate() {
                let Some(next) = self.beside(node, IVec3::AXES[axis]) else { continue };
                *number = contacts.len() as u32;
                let [a, b] = [node, next].map(|n| n as usize);
                contacts.push(Contact {
                    nodes: [node, next],
                    mask: 1,
                    axis: axis as u8,
                    deepest: [self.elements[a], self.elements[b]],
                    key: self.depths[a].min(self.depths[b]),
                });
            }
        }
        (contacts, number)
    }

    /// Squares of four voxels, by their lowest voxel and the axis across them, and their numbers.
    fn runs(&self, contact_of: &[[u32; 3]]) -> (Vec<EdgeRun>, Vec<[u32; 3]>) {
        let mut runs = Vec::with_capacity(2 * self.elements.len());
        let mut number = vec![[NONE; 3]; self.elements.len()];
        for node in 0..self.elements.len() as u32 {
            check(node);
            for (axis, [i, j]) in ACROSS.into_iter().enumerate() {
                let along = |axis: usize| self.beside(node, IVec3::AXES[axis]);
                let (Some(right), Some(up)) = (along(i), along(j)) else { continue };
                let contacts = [
                    contact_of[node as usize][i],
                    contact_of[up as usize][i],
                    contact_of[node as usize][j],
                    contact_of[right as usize][j],
                ];
                let Some(across) = self.beside(right, IVec3::AXES[j]) else { continue };
                number[node as usize][axis] = runs.len() as u32;
                let depth = |n: u32| self.depths[n as usize];
                let key = depth(node).min(depth(right)).min(depth(up)).min(depth(across));
                runs.push(EdgeRun { contacts, places: 1, key });
            }
        }
        (runs, number)
    }

    /// Cubes of eight voxels, by their lowest voxel.
    fn corners(&self, run_of: &[[u32; 3]]) -> Vec<Corner> {
        let mut corners = Vec::with_capacity(self.elements.len() / 2);
        for node in 0..self.elements.len() as u32 {
            check(node);
            let mut runs = [NONE; 6];
            for axis in 0..3 {
                let next = self.beside(node, IVec3::AXES[axis]);
                runs[2 * axis] = run_of[node as usize][axis];
                runs[2 * axis + 1] = next.map_or(NONE, |next| run_of[next as usize][axis]);
            }
            if runs.contains(&NONE) {
                continue;
            }
            let block = (0..8).map(|k| IVec3::new(k & 1, k >> 1 & 1, k >> 2));
            let depth = |step| self.beside(node, step).map_or(0, |n| self.depths[n as usize]);
            corners.push(Corner { runs, key: block.map(depth).min().unwrap_or(0) });
        }
        corners
    }
}

/// Looks at the cancellation token now and then.
#[inline]
fn check(node: u32) {
    if node.is_multiple_of(1 << 16) {
        checkpoint();
    }
}

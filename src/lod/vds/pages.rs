//! Leaves cut into pages.

use super::levels::Fineness;
use super::surface::Surface;
use super::tessellate::{Block, Cell};
use crate::geometry::Vertex;
use crate::lod::octree::{Item, around};
use crate::lod::{Cone, PAGE_TRIANGLES, PAGE_VERTICES, Sphere};

/// A page to be: what is on it, and its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    /// Equal for equal content of the same place.
    pub key: u64,
    /// Triangles.
    pub triangles: u32,
    blocks: Vec<Block>,
}

/// A page as it is written.
pub struct Content {
    /// At most [`PAGE_VERTICES`].
    pub vertices: Vec<Vertex>,
    /// At most [`PAGE_TRIANGLES`].
    pub triangles: Vec<[u8; 3]>,
    /// Holds all of it.
    pub sphere: Sphere,
    /// Holds the normals of its faces.
    pub cone: Cone,
}

/// Mixes one more number in (the finaliser of SplitMix64).
pub fn mix(hash: u64, more: u64) -> u64 {
    let mut x = (hash ^ more).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// A face as fine as `fine` says, its edges as fine as the finer of their faces.
pub fn cell(surface: &Surface, fine: &[Fineness], face: u32) -> Cell {
    let own = fine[face as usize];
    let edge = |e| surface.base.across(face, e).map_or(own, |g| own.max(fine[g as usize]));
    Cell { face, own, edges: [edge(0), edge(1), edge(2)] }
}

/// Pages of a leaf: its faces' blocks in order, as many to a page as fit.
pub fn pages(surface: &Surface, fine: &[Fineness], leaf: u32) -> Vec<Page> {
    let mut all: Vec<Page> = Vec::new();
    let mut vertices = PAGE_VERTICES;
    for &f in &surface.leaves[leaf as usize].faces {
        for block in cell(surface, fine, f).blocks() {
            let triangles = block.triangles() as u32;
            let full = |p: &Page| (p.triangles + triangles) as usize > PAGE_TRIANGLES;
            if vertices + block.vertices() > PAGE_VERTICES || all.last().is_some_and(full) {
                let key = mix(u64::from(leaf), all.len() as u64);
                all.push(Page { key, triangles: 0, blocks: Vec::new() });
                vertices = 0;
            }
            vertices += block.vertices();
            if let Some(page) = all.last_mut() {
                page.key = block.content().into_iter().fold(page.key, mix);
                page.triangles += triangles;
                page.blocks.push(block);
            }
        }
    }
    all
}

impl Page {
    /// Gathers the page.
    pub fn content(&self, surface: &Surface) -> Content {
        let mut vertices = Vec::with_capacity(PAGE_VERTICES);
        let mut triangles = Vec::with_capacity(PAGE_TRIANGLES);
        for block in &self.blocks {
            block.write(&surface.base, &surface.samples, &mut vertices, &mut triangles);
        }
        let items = triangles
            .iter()
            .map(|t: &[u8; 3]| Item::triangle(t.map(|v| vertices[usize::from(v)].position())));
        let items: Vec<Item> = items.collect();
        let normals = items.iter().map(|i| i.cone).filter(|c| c.sine < 1.0);
        let cone = around(normals);
        let at = |v: &Vertex| v.position();
        let lo = vertices.iter().map(at).reduce(|a, b| a.min(b)).unwrap_or_default();
        let hi = vertices.iter().map(at).reduce(|a, b| a.max(b)).unwrap_or_default();
        let centre = 0.5 * (lo + hi);
        let reach = vertices.iter().map(|v| at(v).distance(centre)).fold(0.0, f32::max);
        let sphere = Sphere { centre, radius: reach * (1.0 + 1e-6) };
        Content { vertices, triangles, sphere, cone }
    }

    /// Its blocks.
    #[cfg(test)]
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }
}

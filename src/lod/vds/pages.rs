//! Splits octree leaves into pages.

use super::fineness::Fineness;
use super::surface::SubdivisionSurface;
use super::tessellate::{Block, FaceFineness};
use crate::geometry::{Cone, Sphere, Vertex};
use crate::lod::octree::{Item, bounding_cone};
use crate::lod::{PAGE_TRIANGLES, PAGE_VERTICES};

/// Description of a page before its content is gathered: blocks and key.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    /// Hash of leaf, index and content.
    pub key: u64,
    /// Number of triangles.
    pub triangles: u32,
    blocks: Vec<Block>,
}

/// Content of a page.
pub struct PageContent {
    /// Vertices of the page, at most [`PAGE_VERTICES`].
    pub vertices: Vec<Vertex>,
    /// Triangles of the page, at most [`PAGE_TRIANGLES`], as indices into `vertices`.
    pub triangles: Vec<[u8; 3]>,
    /// Bounding sphere.
    pub sphere: Sphere,
    /// Cone that contains the normals of its faces.
    pub cone: Cone,
}

/// Hash combination (the finaliser of SplitMix64).
pub fn mix(hash: u64, more: u64) -> u64 {
    let mut x = (hash ^ more).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// A face at its fineness; each edge takes the larger fineness of its faces.
pub fn cell(surface: &SubdivisionSurface, fine: &[Fineness], face: u32) -> FaceFineness {
    let own = fine[face as usize];
    let edge = |e| surface.base.across(face, e).map_or(own, |g| own.max(fine[g as usize]));
    FaceFineness { face, own, edges: [edge(0), edge(1), edge(2)] }
}

/// Pages of a leaf: the blocks of its faces in order, as many to a page as fit.
pub fn pages(surface: &SubdivisionSurface, fine: &[Fineness], leaf: u32) -> Vec<Page> {
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
    /// Gathers vertices and triangles.
    pub fn content(&self, surface: &SubdivisionSurface) -> PageContent {
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
        let cone = bounding_cone(normals);
        let at = |v: &Vertex| v.position();
        let lo = vertices.iter().map(at).reduce(|a, b| a.min(b)).unwrap_or_default();
        let hi = vertices.iter().map(at).reduce(|a, b| a.max(b)).unwrap_or_default();
        let centre = 0.5 * (lo + hi);
        let reach = vertices.iter().map(|v| at(v).distance(centre)).fold(0.0, f32::max);
        let sphere = Sphere { centre, radius: reach * (1.0 + 1e-6) };
        PageContent { vertices, triangles, sphere, cone }
    }

    /// Returns the blocks of the page.
    #[cfg(test)]
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }
}

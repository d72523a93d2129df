//! How fine a camera wants each leaf: a function of the camera alone.

use super::levels::Fineness;
use super::surface::{Leaf, Surface};
use crate::lod::Eye;

/// Distance to the original of a leaf at a fineness, mm: on their way from one level to the next
/// points pass between places of the one and places of the other.
pub fn error_mm(leaf: &Leaf, q: Fineness) -> f32 {
    if q == 0 {
        return leaf.error_mm[0];
    }
    let (l, a) = (super::levels::level(q) as usize, super::levels::morph(q) as f32 / 8.0);
    (1.0 - a) * leaf.error_mm[l - 1] + a * leaf.error_mm[l]
}

/// The least fineness of a leaf whose error stays below `pixels`: 0 outside the picture and where
/// every face shows its back.
pub fn wanted(leaf: &Leaf, eye: &Eye, pixels: f64, morph: bool) -> Fineness {
    if !eye.sees(&leaf.sphere) || eye.behind(&leaf.sphere, &leaf.cone) {
        return 0;
    }
    let enough = |q: &Fineness| eye.error_px(&leaf.sphere, error_mm(leaf, *q)) <= pixels;
    let finest = 8 * (leaf.error_mm.len() - 1) as Fineness;
    let q = (0..=finest).step_by(8).find(enough).unwrap_or(finest);
    if q == 0 || !morph {
        return q;
    }
    (q - 7..q).find(enough).unwrap_or(q)
}

/// Fineness of every leaf. Whole branches of the octree stay at the base where they are out of
/// sight or where the base is good enough.
pub fn select(surface: &Surface, eye: &Eye, pixels: f64) -> Vec<Fineness> {
    let mut all = vec![0; surface.leaves.len()];
    let tree = &surface.tree;
    let mut open = vec![0];
    while let Some(at) = open.pop() {
        let node = &tree.nodes[at];
        let mut sphere = node.sphere;
        // What the spheres of its leaves have over theirs in the tree is no more than that.
        sphere.radius += surface.node_error_mm[at];
        if node.is_leaf() {
            let leaf = surface.leaf_at[at] as usize;
            let morph = surface.options.morph;
            all[leaf] = wanted(&surface.leaves[leaf], eye, pixels, morph);
        } else if eye.sees(&sphere) && eye.error_px(&sphere, surface.node_error_mm[at]) > pixels {
            open.extend(tree.children(at));
        }
    }
    all
}

//! An adaptive octree over items with bounding boxes: each item belongs to the one cell that
//! contains its centre.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Cone, Sphere};

/// Most items of a leaf, unless it is at [`MAX_DEPTH`].
pub const LEAF_ITEMS: usize = 128;
/// Most levels below the root: coincident items cannot be separated.
pub const MAX_DEPTH: u32 = 10;

/// An item of the tree.
#[derive(Clone, Copy, Debug)]
pub struct Item {
    /// Smallest corner of its box, mm.
    pub lo: Vec3,
    /// Largest corner of its box, mm.
    pub hi: Vec3,
    /// Selects the cell that owns it.
    pub centre: Vec3,
    /// Cone that contains its normals.
    pub cone: Cone,
}

impl Item {
    /// A triangle with its face normal; a degenerate one may face any direction.
    pub fn triangle(corners: [Vec3; 3]) -> Self {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).try_normalize();
        Self {
            lo: a.min(b).min(c),
            hi: a.max(b).max(c),
            centre: (a + b + c) / 3.0,
            // Rounding of the normal itself.
            cone: normal.map_or_else(Cone::default, |axis| Cone { axis, sine: 1e-5 }),
        }
    }
}

/// A non-empty cell.
#[derive(Clone, Debug, PartialEq)]
pub struct OctreeNode {
    /// Smallest corner of the box around the items, not of the cell, mm.
    pub lo: Vec3,
    /// Largest corner of the box around the items, mm.
    pub hi: Vec3,
    /// Bounding sphere of all items.
    pub sphere: Sphere,
    /// Cone that contains the normals of all items.
    pub cone: Cone,
    /// First of its items in [`Octree::items`].
    pub first: u32,
    /// Number of its items.
    pub count: u32,
    /// First of its non-empty child cells.
    pub children: u32,
    /// Number of child cells; 0 for a leaf.
    pub child_count: u32,
    /// Levels below the root.
    pub depth: u32,
}

impl OctreeNode {
    /// Whether it has no smaller cells.
    pub fn is_leaf(&self) -> bool {
        self.child_count == 0
    }

    /// Sets the bounds of a node whose items have this box and this cone.
    fn enclose(&mut self, lo: Vec3, hi: Vec3, cone: Cone) {
        let centre = 0.5 * (lo + hi);
        // The rounded centre may be off the middle.
        let reach = (hi.as_dvec3() - centre.as_dvec3()).max(centre.as_dvec3() - lo.as_dvec3());
        let radius = (reach.length() * (1.0 + 1e-6)) as f32;
        (self.lo, self.hi, self.cone) = (lo, hi, cone);
        self.sphere = Sphere { centre, radius };
    }
}

/// Centre of an item and its number.
#[derive(Clone, Copy)]
struct PlacedItem {
    centre: Vec3,
    id: u32,
}

/// Sorts places by the octant about `middle` that they are in, those of one octant as they were.
/// Returns the number in each.
fn sort_by_octant(places: &mut [PlacedItem], middle: Vec3) -> [u32; 8] {
    let octant = |p: &PlacedItem| p.centre.cmpge(middle).bitmask() as usize;
    let mut counts = [0u32; 8];
    places.iter().for_each(|p| counts[octant(p)] += 1);
    let mut next = [0usize; 8];
    for o in 1..8 {
        next[o] = next[o - 1] + counts[o - 1] as usize;
    }
    let before = places.to_vec();
    for p in before {
        let o = octant(&p);
        places[next[o]] = p;
        next[o] += 1;
    }
    counts
}

/// The tree. Node 0 is the root; there is none without items. Children follow their parents.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Octree {
    /// Cells, a parent before its children, siblings next to each other.
    pub nodes: Vec<OctreeNode>,
    /// Item numbers, each once; those of one node are next to each other.
    pub items: Vec<u32>,
}

impl Octree {
    /// Builds the tree. A NaN centre counts as the lowest corner.
    pub fn new(items: &[Item]) -> Self {
        Self::with_leaves(items, LEAF_ITEMS)
    }

    /// Builds the tree as [`Octree::new`], with at most `leaf_items` items in a leaf.
    pub fn with_leaves(items: &[Item], leaf_items: usize) -> Self {
        Self::from_fn(items.len(), leaf_items, |i| items[i as usize])
    }

    /// Builds the tree as [`Octree::with_leaves`] of `count` items that are made when they are
    /// needed, twice each. The tree does not depend on the number of threads.
    pub fn from_fn(count: usize, leaf_items: usize, item: impl Fn(u32) -> Item + Sync) -> Self {
        let place = |id| PlacedItem { centre: item(id).centre, id };
        let mut places: Vec<PlacedItem> = (0..count as u32).into_par_iter().map(place).collect();
        if places.is_empty() {
            return Self::default();
        }
        let finite = places.par_iter().filter(|p| p.centre.is_finite());
        let (lo, hi) = finite
            .map(|p| (p.centre, p.centre))
            .reduce(|| EMPTY, |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (lo, side) =
            if lo.x <= hi.x { (lo, (hi - lo).max_element()) } else { (Vec3::ZERO, 0.0) };
        let mut nodes = vec![node(0, count as u32, 0)];
        let mut cells = vec![(lo, side)];
        let mut level = 0..1;
        while !level.is_empty() {
            crate::task::checkpoint();
            let mut rest = &mut places[..];
            let mut at = 0;
            // The nodes of a level are in the order of their items; leaves of upper levels lie between.
            let own: Vec<&mut [PlacedItem]> = nodes[level.clone()]
                .iter()
                .map(|n| {
                    rest = &mut std::mem::take(&mut rest)[(n.first - at) as usize..];
                    at = n.first + n.count;
                    rest.split_off_mut(..n.count as usize).unwrap_or_default()
                })
                .collect();
            let splits: Vec<Option<[u32; 8]>> = own
                .into_par_iter()
                .zip(&nodes[level.clone()])
                .zip(&cells)
                .map(|((own, n), (lo, side))| {
                    let splits = own.len() > leaf_items && n.depth < MAX_DEPTH;
                    splits.then(|| sort_by_octant(own, *lo + 0.5 * *side))
                })
                .collect();
            let mut below = Vec::new();
            for ((at, counts), (lo, side)) in level.clone().zip(splits).zip(cells) {
                let OctreeNode { mut first, depth, .. } = nodes[at];
                nodes[at].children = nodes.len() as u32;
                for (o, count) in counts.into_iter().flatten().enumerate().filter(|c| c.1 > 0) {
                    let upper = Vec3::from_array([0, 1, 2].map(|k| (o >> k & 1) as f32));
                    below.push((lo + 0.5 * side * upper, 0.5 * side));
                    nodes.push(node(first, count, depth + 1));
                    nodes[at].child_count += 1;
                    first += count;
                }
            }
            cells = below;
            level = level.end..nodes.len();
        }
        let items = places.par_iter().map(|p| p.id).collect();
        let mut tree = Self { nodes, items };
        tree.bound(item);
        tree
    }

    /// Boxes, spheres and cones, from the leaves up.
    fn bound(&mut self, item: impl Fn(u32) -> Item + Sync) {
        let Self { nodes, items } = self;
        nodes.par_iter_mut().filter(|n| n.is_leaf()).for_each(|n| {
            let own = &items[n.first as usize..(n.first + n.count) as usize];
            let own: Vec<Item> = own.iter().map(|i| item(*i)).collect();
            let (lo, hi) = own.iter().fold(EMPTY, |b, i| (b.0.min(i.lo), b.1.max(i.hi)));
            n.enclose(lo, hi, bounding_cone(own.iter().map(|i| i.cone)));
        });
        for at in (0..nodes.len()).rev().filter(|at| !nodes[*at].is_leaf()).collect::<Vec<_>>() {
            let (upper, lower) = nodes.split_at_mut(at + 1);
            let n = &mut upper[at];
            let first = n.children as usize - at - 1;
            let own = &lower[first..first + n.child_count as usize];
            let (lo, hi) = own.iter().fold(EMPTY, |b, i| (b.0.min(i.lo), b.1.max(i.hi)));
            n.enclose(lo, hi, bounding_cone(own.iter().map(|i| i.cone)));
        }
    }

    /// Children of a node.
    pub fn children(&self, node: usize) -> std::ops::Range<usize> {
        let n = &self.nodes[node];
        n.children as usize..(n.children + n.child_count) as usize
    }

    /// Items of a node and of all below it.
    pub fn items_of(&self, node: usize) -> &[u32] {
        let n = &self.nodes[node];
        &self.items[n.first as usize..(n.first + n.count) as usize]
    }

    /// Traverses the tree from the root wherever `enter` returns true, and calls `leaf` at each
    /// leaf.
    pub fn traverse(
        &self,
        mut enter: impl FnMut(&OctreeNode) -> bool,
        mut leaf: impl FnMut(usize, &OctreeNode),
    ) {
        let mut open: Vec<usize> = (0..self.nodes.len().min(1)).collect();
        while let Some(at) = open.pop() {
            let n = &self.nodes[at];
            if !enter(n) {
                continue;
            }
            if n.is_leaf() {
                leaf(at, n);
            } else {
                open.extend(self.children(at).rev());
            }
        }
    }
}

const EMPTY: (Vec3, Vec3) = (Vec3::INFINITY, Vec3::NEG_INFINITY);

fn node(first: u32, count: u32, depth: u32) -> OctreeNode {
    OctreeNode {
        lo: Vec3::ZERO,
        hi: Vec3::ZERO,
        sphere: Sphere::default(),
        cone: Cone::default(),
        first,
        count,
        children: 0,
        child_count: 0,
        depth,
    }
}

/// Smallest cone about the mean axis that contains all cones; every direction if they do not fit a
/// half-space.
pub fn bounding_cone(cones: impl Iterator<Item = Cone> + Clone) -> Cone {
    let sum: Vec3 = cones.clone().map(|c| c.axis).sum();
    let Some(axis) = sum.try_normalize() else {
        return Cone::default();
    };
    // Angles add, by the cosine and sine of their sum; f64, since a cosine near 1 says little in f32.
    let a = axis.as_dvec3().normalize();
    let (mut cosine, mut sine): (f64, f64) = (1.0, 0.0);
    // Largest angle to an axis and largest sine so far: cones within both need no sum.
    let mut of_widest = (1.0, -1.0);
    for c in cones {
        if c.sine.is_nan() || c.sine >= 1.0 {
            return Cone::default();
        }
        let (b, own) = (c.axis.as_dvec3(), f64::from(c.sine));
        let towards = (a.dot(b) / b.length()).clamp(-1.0, 1.0);
        if towards >= of_widest.0 && own <= of_widest.1 {
            continue;
        }
        let [away, own_cosine] = [towards, own].map(|part| (1.0 - part * part).sqrt());
        let sum = towards * own_cosine - away * own;
        if sum <= cosine {
            (cosine, sine) = (sum, away * own_cosine + towards * own);
            of_widest = (towards, own);
        }
    }
    // A half-space, or a sum beyond it.
    if cosine <= 0.0 {
        return Cone::default();
    }
    Cone { axis, sine: (sine * (1.0 + 1e-6)) as f32 + 1e-6 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: &mut u64) -> f32 {
        *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*seed >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Triangles on a dented ball of radius 10, all the same way out.
    fn triangles(n: usize) -> Vec<Item> {
        let seed = &mut 5;
        let mut one = || {
            let mut v = || 2.0 * noise(seed) - 1.0;
            let d = Vec3::new(v(), v(), v()).normalize_or(Vec3::X);
            let (x, y) = d.any_orthonormal_pair();
            let at = 10.0 * d + 0.5 * Vec3::new(v(), v(), v());
            Item::triangle([at, at + 0.2 * x + 0.05 * v() * d, at + 0.2 * y])
        };
        (0..n).map(|_| one()).collect()
    }

    #[test]
    fn every_item_is_in_one_leaf_and_inside_all_bounds_above_it() {
        let items = triangles(20_000);
        let tree = Octree::new(&items);
        let mut owner = vec![0; items.len()];
        for (at, n) in tree.nodes.iter().enumerate() {
            for i in tree.items_of(at) {
                let i = &items[*i as usize];
                assert!(n.lo.cmple(i.lo).all() && n.hi.cmpge(i.hi).all());
                for corner in [i.lo, i.hi] {
                    let away = corner.as_dvec3().distance(n.sphere.centre.as_dvec3());
                    assert!(away <= f64::from(n.sphere.radius));
                }
                let off = n.cone.axis.angle_between(i.cone.axis);
                assert!(n.cone.sine >= 1.0 || off.sin() <= n.cone.sine + 1e-4 && off < 1.6);
            }
            if n.is_leaf() {
                assert!(n.count as usize <= LEAF_ITEMS && n.count > 0);
                tree.items_of(at).iter().for_each(|i| owner[*i as usize] += 1);
            } else {
                let sum: u32 = tree.children(at).map(|c| tree.nodes[c].count).sum();
                assert_eq!(sum, n.count);
            }
        }
        assert!(owner.iter().all(|n| *n == 1));
        let narrow = tree.nodes.iter().filter(|n| n.is_leaf() && n.cone.sine < 0.95).count();
        assert!(narrow > 100, "only {narrow} leaves know where they look");
        let mut met = 0;
        tree.traverse(|_| true, |_, n| met += n.count);
        assert_eq!(met as usize, items.len());
        tree.traverse(|n| n.hi.x < 0.0, |_, n| assert!(n.hi.x < 0.0));
    }

    #[test]
    fn coincident_and_nan_items_do_not_split_forever() {
        assert!(Octree::new(&[]).nodes.is_empty());
        let at = |p: Vec3| Item::triangle([p, p + Vec3::X, p + Vec3::Y]);
        let same = Octree::new(&vec![at(Vec3::ONE); 1000]);
        assert!(same.nodes.len() <= 1 + MAX_DEPTH as usize);
        let mut lost = vec![at(Vec3::NAN); 300];
        assert!(Octree::new(&lost).nodes.len() <= 1 + MAX_DEPTH as usize);
        lost.extend((0..300).map(|i| at(Vec3::splat(i as f32))));
        assert_eq!(Octree::new(&lost).items.len(), 600);
    }
}

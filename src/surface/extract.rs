//! Iso-surface of the lumen from its bricks by bit operations: a brick layer of 64 cells is
//! classified at once, and a vertex id is a population count.

use glam::{DAffine3, IVec3, Vec3};
use rayon::prelude::*;

use super::table::{EDGES, TRIANGLES};
use crate::geometry::Mesh;
use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, Bricks, NONE, near_index};

/// Position of a vertex between the inside and the outside voxel of its edge.
pub trait Crossing: Sync {
    /// Returns the position of the vertex as a share of the edge from the inside voxel to the
    /// outside one, in [1/256, 255/256]. `outside` may lie outside the grid.
    fn fraction(&self, inside: IVec3, outside: IVec3) -> f32;
}

/// Crossing half way, for the surface of a binary mask.
pub struct Midpoint;

impl Crossing for Midpoint {
    fn fraction(&self, _: IVec3, _: IVec3) -> f32 {
        0.5
    }
}

/// Clamps a crossing away from voxel centres, so that no two vertices coincide.
pub fn clamp_fraction(t: f32) -> f32 {
    if t.is_nan() { 0.5 } else { t.clamp(1.0 / 256.0, 255.0 / 256.0) }
}

/// Crossed edges of a brick: for layer z and axis a, word `3 z + a` has a bit for each voxel whose
/// edge along a is crossed, and `before` counts the crossings of all words ahead of it.
struct Edges {
    words: [u64; 24],
    before: [u16; 24],
    count: u32,
}

/// Shifts the bits of a layer by one voxel along +x, given the layer of the +x neighbour.
#[inline]
fn shift_x(m: u64, beyond: u64) -> u64 {
    const LOW: u64 = 0x0101_0101_0101_0101;
    (m >> 1 & !(LOW << 7)) | (beyond & LOW) << 7
}

#[inline]
fn shift_y(m: u64, beyond: u64) -> u64 {
    m >> 8 | beyond << 56
}

/// Returns for each layer the four masks at (0,0), (1,0), (0,1), (1,1) in x, y; nine layers, the
/// last from the brick above.
fn layers(bricks: &Bricks, inside: &[u64], slot: usize) -> [[u64; 4]; 9] {
    let near = &bricks.near()[slot];
    let word = |dx: i32, dy: i32, dz: i32, z: usize| match near[near_index(dx, dy, dz)] {
        NONE => 0,
        s => inside[s as usize * 8 + z],
    };
    std::array::from_fn(|z| {
        let (dz, z) = if z == 8 { (1, 0) } else { (0, z) };
        let m = word(0, 0, dz, z);
        let my = word(0, 1, dz, z);
        let x = shift_x(m, word(1, 0, dz, z));
        let y = shift_y(m, my);
        let xy = shift_y(x, shift_x(my, word(1, 1, dz, z)));
        [m, x, y, xy]
    })
}

fn edges(layers: &[[u64; 4]; 9]) -> Edges {
    let mut e = Edges { words: [0; 24], before: [0; 24], count: 0 };
    for z in 0..8 {
        let [m, x, y, _] = layers[z];
        for (a, w) in [m ^ x, m ^ y, m ^ layers[z + 1][0]].into_iter().enumerate() {
            e.words[3 * z + a] = w;
            e.before[3 * z + a] = e.count as u16;
            e.count += w.count_ones();
        }
    }
    e
}

/// Returns the cells of a layer with corners both inside and outside.
#[inline]
fn mixed(low: &[u64; 4], high: &[u64; 4]) -> u64 {
    let any = low.iter().chain(high).fold(0, |a, b| a | b);
    let all = low.iter().chain(high).fold(!0, |a, b| a & b);
    any & !all
}

#[inline]
fn case_at(low: &[u64; 4], high: &[u64; 4], bit: u32) -> u8 {
    let mut c = 0;
    for k in 0..4 {
        c |= ((low[k] >> bit & 1) as u8) << k | ((high[k] >> bit & 1) as u8) << (k + 4);
    }
    c
}

fn set_bits(mut w: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        (w != 0).then(|| {
            let b = w.trailing_zeros();
            w &= w - 1;
            b
        })
    })
}

/// Splits a buffer into consecutive parts of the given lengths.
pub(super) fn parts<T>(mut rest: &mut [T], lens: impl Iterator<Item = usize>) -> Vec<&mut [T]> {
    lens.map(|n| {
        let (part, tail) = std::mem::take(&mut rest).split_at_mut(n);
        rest = tail;
        part
    })
    .collect()
}

/// Grid edge that a vertex lies on: two 6-adjacent voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GridEdge {
    /// Voxel of the lumen.
    pub inside: IVec3,
    /// Voxel outside the lumen; it may lie outside the grid.
    pub outside: IVec3,
}

/// Returns the grid edge of every vertex of [`extract`], in its order.
pub fn vertex_edges(lumen: &Lumen) -> Vec<GridEdge> {
    each_vertex(lumen, &crossed_edges(lumen), |edge| edge)
}

/// Returns the crossed edges of every brick.
fn crossed_edges(lumen: &Lumen) -> Vec<Edges> {
    let bricks = &lumen.bricks;
    (0..bricks.len())
        .into_par_iter()
        .with_min_len(16)
        .map(|s| {
            crate::task::checkpoint();
            edges(&layers(bricks, &lumen.inside, s))
        })
        .collect()
}

/// Computes a value for every vertex, in the order of the bricks.
fn each_vertex<T: Clone + Default + Send>(
    lumen: &Lumen,
    all: &[Edges],
    value: impl Fn(GridEdge) -> T + Sync,
) -> Vec<T> {
    let mut values = vec![T::default(); all.iter().map(|e| e.count as usize).sum()];
    parts(&mut values, all.iter().map(|e| e.count as usize))
        .into_par_iter()
        .zip(all)
        .enumerate()
        .with_min_len(16)
        .for_each(|(slot, (out, e))| {
            crate::task::checkpoint();
            let corner = IVec3::from(lumen.bricks.corners()[slot]);
            let mut out = out.iter_mut();
            for (w, &word) in e.words.iter().enumerate() {
                let (z, axis) = (w / 3, w % 3);
                for b in set_bits(word) {
                    let p = corner + IVec3::new(b as i32 & 7, b as i32 >> 3, z as i32);
                    let mut q = p;
                    q[axis] += 1;
                    let from_low = lumen.inside[slot * 8 + z] >> b & 1 != 0;
                    let (inside, outside) = if from_low { (p, q) } else { (q, p) };
                    if let Some(v) = out.next() {
                        *v = value(GridEdge { inside, outside });
                    }
                }
            }
        });
    values
}

/// Returns a point on a grid edge, LPS mm.
pub(super) fn point_on(edge: GridEdge, world: &DAffine3, fraction: f32) -> Vec3 {
    let at = edge.inside.as_dvec3().lerp(edge.outside.as_dvec3(), f64::from(fraction));
    world.transform_point3(at).as_vec3()
}

/// Extracts the whole surface of the lumen: positions in LPS mm, faces turned towards the inside,
/// faces of cells that reach outside the volume tagged as caps. Vertices and faces are in brick
/// order: the same at any number of threads.
///
/// V is the number of 6-adjacent inside/outside pairs; the mesh is a closed 2-manifold.
pub fn extract(lumen: &Lumen, crossing: &impl Crossing) -> Mesh {
    let bricks = &lumen.bricks;
    let all = crossed_edges(lumen);
    let base: Vec<u32> = all
        .iter()
        .scan(0u32, |at, e| {
            let b = *at;
            *at += e.count;
            Some(b)
        })
        .collect();
    let world = lumen.grid.world_from_voxel();
    let positions = each_vertex(lumen, &all, |edge| {
        point_on(edge, &world, crossing.fraction(edge.inside, edge.outside))
    });

    // Groups of bricks, each into a list of its own: the number of faces is not known before.
    let groups: Vec<(Vec<[u32; 3]>, Vec<bool>)> = (0..bricks.len().div_ceil(GROUP))
        .into_par_iter()
        .map(|g| {
            crate::task::checkpoint();
            let (mut faces, mut caps) = (Vec::with_capacity(GROUP * 128), Vec::new());
            for slot in g * GROUP..(g * GROUP + GROUP).min(bricks.len()) {
                faces_of(lumen, slot, (&all, &base), &mut faces, &mut caps);
            }
            (faces, caps)
        })
        .collect();
    let mut faces = vec![[0u32; 3]; groups.iter().map(|g| g.0.len()).sum()];
    parts(&mut faces, groups.iter().map(|g| g.0.len()))
        .into_par_iter()
        .zip(&groups)
        .for_each(|(part, g)| part.copy_from_slice(&g.0));
    let caps = groups.iter().flat_map(|g| &g.1).copied().collect();
    Mesh { positions, normals: Vec::new(), faces, caps }
}

/// Number of bricks of a parallel task.
const GROUP: usize = 32;

/// Appends the faces of a brick's cells, and whether each is a cap if the lumen reaches the edge.
///
/// * `(edges, base)`: crossed edges and first vertex id of every brick.
fn faces_of(
    lumen: &Lumen,
    slot: usize,
    (edges, base): (&[Edges], &[u32]),
    faces: &mut Vec<[u32; 3]>,
    caps: &mut Vec<bool>,
) {
    let table = &*TRIANGLES;
    let l = layers(&lumen.bricks, &lumen.inside, slot);
    let near = &lumen.bricks.near()[slot];
    let corner = IVec3::from(lumen.bricks.corners()[slot]);
    let mirrored = lumen.grid.is_left_handed();
    for z in 0..8usize {
        for b in set_bits(mixed(&l[z], &l[z + 1])) {
            let p = IVec3::new(b as i32 & 7, b as i32 >> 3, z as i32);
            let vertex = |edge: u8| {
                let e = EDGES[edge as usize];
                let c = i32::from(e.corner);
                let q = p + IVec3::new(c & 1, c >> 1 & 1, c >> 2);
                let over: IVec3 = q >> 3i32;
                let s = near[near_index(over.x, over.y, over.z)] as usize;
                let bit = (q.x & 7) + 8 * (q.y & 7);
                let w = 3 * (q.z & 7) as usize + e.axis as usize;
                let below = edges[s].words[w] & ((1u64 << bit) - 1);
                base[s] + u32::from(edges[s].before[w]) + below.count_ones()
            };
            let before = faces.len();
            for t in &table[case_at(&l[z], &l[z + 1], b) as usize] {
                let [a, b, c] = t.map(vertex);
                faces.push(if mirrored { [a, c, b] } else { [a, b, c] });
            }
            if lumen.touches_edge {
                let low = corner + p;
                let cap = !(lumen.is_in_volume(low) && lumen.is_in_volume(low + 1));
                caps.resize(caps.len() + faces.len() - before, cap);
            }
        }
    }
}

/// Returns the id of the vertex where a ray from an inside voxel along +x leaves the lumen.
pub(super) fn vertex_beyond(lumen: &Lumen, from: IVec3) -> Option<u32> {
    let bricks = &lumen.bricks;
    let mut p = from;
    if !lumen.holds(p) {
        return None;
    }
    while lumen.holds(p + IVec3::X) {
        p.x += 1;
    }
    let slot = bricks.slot_of(p)?;
    let count = |s: usize| edges(&layers(bricks, &lumen.inside, s));
    let base: u32 = (0..slot).map(|s| count(s).count).sum();
    let e = count(slot);
    let local = bricks.element(p)? % BRICK;
    let (bit, w) = (local & 63, 3 * (local >> 6));
    Some(base + u32::from(e.before[w]) + (e.words[w] & ((1 << bit) - 1)).count_ones())
}

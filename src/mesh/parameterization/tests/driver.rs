//! Small meshes and a small simplifier to feed the recorder.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use glam::DVec3;

use super::super::*;

/// A sequence of numbers that is the same everywhere.
pub struct Dice(u64);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }
    /// A number below `n`.
    pub fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let n64 = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let n64 = (n64 ^ n64 >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((n64 ^ n64 >> 31) >> 33) as usize % n
    }
    /// A number in 0..1.
    pub fn unit(&mut self) -> f64 {
        self.below(1 << 30) as f64 / f64::from(1 << 30)
    }
    /// Three weights that sum to 1, now and then on an edge or a corner.
    pub fn weights(&mut self) -> [f64; 3] {
        let w = match self.below(8) {
            0 => [1.0, 0.0, 0.0],
            1 => [0.0, self.unit(), 1.0],
            _ => [self.unit(), self.unit(), self.unit()],
        };
        let sum: f64 = w.iter().sum();
        w.map(|w| w / sum)
    }
}

fn mesh(positions: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Mesh {
    let positions = positions.into_iter().map(|p| p.as_vec3()).collect();
    Mesh { positions, faces, ..Mesh::default() }
}

/// A grid of nu × nv cells bent by `at`, closed in u and in v where asked.
pub fn sheet(
    [nu, nv]: [u32; 2],
    [close_u, close_v]: [bool; 2],
    at: impl Fn(f64, f64) -> DVec3,
) -> Mesh {
    let (wide, high) = (nu + u32::from(!close_u), nv + u32::from(!close_v));
    let id = |i: u32, j: u32| i % wide + j % high * wide;
    let mut positions = Vec::new();
    for j in 0..high {
        for i in 0..wide {
            positions.push(at(f64::from(i) / f64::from(nu), f64::from(j) / f64::from(nv)));
        }
    }
    let mut faces = Vec::new();
    for j in 0..nv {
        for i in 0..nu {
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
            // Diagonals alternate, so that valences differ.
            if (i + j) % 2 == 0 {
                faces.extend([[a, b, c], [a, c, d]]);
            } else {
                faces.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    mesh(positions, faces)
}

pub fn torus() -> Mesh {
    sheet([48, 24], [true, true], |u, v| {
        let (u, v) = (u * TAU, v * TAU);
        let r = 10.0 + 4.0 * v.cos();
        DVec3::new(r * u.cos(), r * u.sin(), 4.0 * v.sin())
    })
}

/// An open tube with a bumpy wall: two boundary loops.
pub fn tube() -> Mesh {
    sheet([24, 40], [true, false], |u, v| {
        let r = 5.0 + 0.4 * (u * TAU * 5.0).sin() * (v * 30.0).cos();
        DVec3::new(r * (u * TAU).cos(), r * (u * TAU).sin(), 30.0 * v)
    })
}

/// An open patch: one boundary loop with corners.
pub fn patch() -> Mesh {
    sheet([30, 30], [false, false], |u, v| {
        DVec3::new(20.0 * u, 20.0 * v, (u * 7.0).sin() * (v * 5.0).cos())
    })
}

/// A sphere from an icosahedron, divided `level` times.
pub fn sphere(level: u32) -> Mesh {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut at: Vec<DVec3> = Vec::new();
    for (a, b) in [(1.0, g), (-1.0, g), (1.0, -g), (-1.0, -g)] {
        at.extend([DVec3::new(0.0, a, b), DVec3::new(a, b, 0.0), DVec3::new(b, 0.0, a)]);
    }
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for a in 0..12u32 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let p = [a, b, c].map(|v| at[v as usize]);
                let near = |p: DVec3, q: DVec3| (p - q).length() < 2.1;
                if near(p[0], p[1]) && near(p[1], p[2]) && near(p[2], p[0]) {
                    let out = (p[1] - p[0]).cross(p[2] - p[0]).dot(p[0]) > 0.0;
                    faces.push(if out { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..level {
        let mut middle = BTreeMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in faces {
            let [x, y, z] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                *middle.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    at.push(at[p as usize] + at[q as usize]);
                    at.len() as u32 - 1
                })
            });
            finer.extend([[a, x, z], [x, b, y], [z, y, c], [x, y, z]]);
        }
        faces = finer;
        at.iter_mut().for_each(|p| *p = p.normalize());
    }
    mesh(at.iter().map(|p| *p * 10.0).collect(), faces)
}

/// Position of a point of the mesh.
pub fn point(mesh: &Mesh, at: MeshPoint) -> DVec3 {
    Parameterization::point(mesh, at).expect("a face of the original")
}

/// Length of the diagonal of the box.
pub fn diagonal(mesh: &Mesh) -> f64 {
    let (lo, hi) = mesh.bounds().expect("a mesh with vertices");
    f64::from((hi - lo).length())
}

/// A mesh being simplified: faces by slot, slots by vertex.
struct Soup<'a> {
    mesh: &'a Mesh,
    faces: Vec<Option<[u32; 3]>>,
    of: Vec<Vec<u32>>,
}

impl Soup<'_> {
    /// Ring and faces of `u` from the vertex that is not entered by any face, or from any, and
    /// whether it is open.
    fn ring(&self, u: u32) -> Option<(Vec<u32>, Vec<u32>, bool)> {
        let mut next = BTreeMap::new();
        for &f in &self.of[u as usize] {
            let mut t = self.faces[f as usize]?;
            let corner = t.iter().position(|&v| v == u)?;
            t.rotate_left(corner);
            next.insert(t[1], (t[2], f));
        }
        let ends: Vec<u32> = next.values().map(|(b, _)| *b).collect();
        let first = next.keys().find(|a| !ends.contains(a));
        let (open, mut at) = (first.is_some(), *first.or(next.keys().next())?);
        let (mut ring, mut faces) = (vec![at], Vec::new());
        while let Some((b, f)) = next.remove(&at) {
            faces.push(f);
            at = b;
            if at == ring[0] {
                break;
            }
            ring.push(at);
        }
        next.is_empty().then_some((ring, faces, open))
    }

    /// Whether u → v leaves a manifold without folds.
    fn legal(&self, u: u32, v: u32, ring: &[u32], open: bool) -> bool {
        let Some((around, _, open_v)) = self.ring(v) else { return false };
        let common = ring.iter().filter(|r| around.contains(r)).count();
        let ends = [ring[0], ring[ring.len() - 1]];
        let along = open && open_v && ends.contains(&v);
        if ring.len() < 3 || open && !along || common != if along { 1 } else { 2 } {
            return false;
        }
        // A tetrahedron would fold onto itself.
        if !open && ring.len() == 3 && around.len() == 3 {
            return false;
        }
        let p = |v: u32| DVec3::from(self.mesh.positions[v as usize]);
        self.of[u as usize].iter().filter_map(|&f| self.faces[f as usize]).all(|t| {
            let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
            let after = t.map(|w| if w == u { v } else { w });
            let [a, b] = [t, after].map(|t| cross(t.map(p)));
            t.contains(&v) || a.dot(b) > 0.3
        })
    }
}

/// Tells of one collapse.
pub fn hears(maps: &mut Parameterization, collapse: &Collapse<'_>) -> bool {
    let mut log = FlattenLog::default();
    let agreed = log.record(collapse);
    maps.merge(log);
    agreed
}

/// Collapses a random vertex along its shortest legal edge until `faces` are left or nothing
/// works any more. Returns the base's faces by slot.
pub fn simplify(
    mesh: &Mesh,
    faces: usize,
    seed: u64,
    recorder: &mut Parameterization,
) -> Vec<Option<[u32; 3]>> {
    let mut of = vec![Vec::new(); mesh.positions.len()];
    for (f, t) in mesh.faces.iter().enumerate() {
        t.iter().for_each(|&v| of[v as usize].push(f as u32));
    }
    let mut soup = Soup { mesh, faces: mesh.faces.iter().copied().map(Some).collect(), of };
    let position = |v: u32| DVec3::from(mesh.positions[v as usize]);
    let (mut dice, mut left) = (Dice::new(seed), mesh.faces.len());
    for _ in 0..40 * mesh.positions.len() {
        let u = dice.below(mesh.positions.len()) as u32;
        if left <= faces {
            break;
        }
        let Some((mut ring, mut around, boundary)) = soup.ring(u) else { continue };
        let mut targets = ring.clone();
        targets.sort_by(|a, b| {
            let d = |v: u32| (position(v) - position(u)).length();
            d(*a).total_cmp(&d(*b))
        });
        let Some(&to) = targets.iter().find(|&&v| soup.legal(u, v, &ring, boundary)) else {
            continue;
        };
        if !boundary {
            let at = ring.iter().position(|&r| r == to).unwrap_or(0);
            ring.rotate_left(at);
            around.rotate_left(at);
        }
        let (from_at, ring_at) =
            (position(u), ring.iter().map(|r| position(*r)).collect::<Vec<_>>());
        let (faces, ring_at) = (&around, &ring_at);
        let collapse = Collapse { from: u, to, ring: &ring, faces, from_at, ring_at, boundary };
        if !hears(recorder, &collapse) {
            continue;
        }
        for &f in &around {
            let t = soup.faces[f as usize].take().expect("a live face");
            if t.contains(&to) {
                t.iter().for_each(|&v| soup.of[v as usize].retain(|&g| g != f));
                left -= 1;
            } else {
                soup.faces[f as usize] = Some(t.map(|v| if v == u { to } else { v }));
                soup.of[to as usize].push(f);
            }
        }
        soup.of[u as usize].clear();
    }
    soup.faces
}

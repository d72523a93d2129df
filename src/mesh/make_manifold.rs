//! Makes any mesh manifold and consistently oriented, and counts the repairs.

use glam::Vec3;

use super::halfedge::{NONE, by_lower_vertex, check_sizes, face, next, prev};
use super::{HalfEdges, MeshError};
use crate::geometry::{Mesh, in_rows};

/// Counts of what was repaired.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Repairs {
    /// Faces dropped because they name a vertex twice.
    pub degenerate_faces: usize,
    /// Faces dropped because an earlier one has the same vertices.
    pub duplicate_faces: usize,
    /// Faces flipped to the orientation that most of their component has.
    pub flipped_faces: usize,
    /// Edges with more than two faces, cut apart.
    pub split_edges: usize,
    /// Ends of the first of them, mm.
    pub first_edge: Option<[Vec3; 2]>,
    /// Vertices duplicated, as separate fans of faces touched in one.
    pub split_vertices: usize,
    /// The first of them, mm.
    pub first_vertex: Option<Vec3>,
}

impl Repairs {
    /// Whether nothing had to be repaired.
    pub fn none(&self) -> bool {
        *self == Self::default()
    }
}

/// Repairs a mesh so that [`HalfEdges::new`] accepts it. Faces that name a vertex twice or repeat
/// another are dropped; faces are flipped to agree with their neighbours; edges with more than two
/// faces are cut, and vertices in which fans of faces touch are duplicated, the new ones at the end
/// of the list. Positions, the order of what is kept, and vertices without faces are kept.
///
/// # Errors
/// [`MeshError`]: lists that do not fit together, a coordinate that is not finite, an index out of
/// range, no face left, a one-sided surface.
pub fn make_manifold(mesh: &Mesh) -> Result<(Mesh, Repairs), MeshError> {
    check_sizes(mesh)?;
    let vertices = mesh.positions.len();
    for (i, f) in mesh.faces.iter().enumerate() {
        if let Some(&vertex) = f.iter().find(|v| **v as usize >= vertices) {
            return Err(MeshError::Index { face: i, vertex, vertices });
        }
    }
    let mut repairs = Repairs::default();
    let mut mesh = mesh.clone();
    drop_bad_faces(&mut mesh, &mut repairs);
    if mesh.faces.is_empty() {
        return Err(MeshError::Empty);
    }
    let mut pairs = pair_up(&mesh, &mut repairs);
    orient(&mut mesh, &mut pairs, &mut repairs)?;
    split_vertices(&mut mesh, &pairs, &mut repairs);
    debug_assert!(HalfEdges::new(&mesh).is_ok());
    Ok((mesh, repairs))
}

/// Drops degenerate and duplicate faces; of equal ones the first is kept.
fn drop_bad_faces(mesh: &mut Mesh, repairs: &mut Repairs) {
    let sorted = |f: &[u32; 3]| {
        let mut f = *f;
        f.sort_unstable();
        f
    };
    // Faces in rows of their lowest vertex.
    let (start, rows) = in_rows(mesh.positions.len(), || {
        mesh.faces.iter().zip(0u32..).map(|(f, i)| (sorted(f)[0], i))
    });
    let mut keep = vec![true; mesh.faces.len()];
    let mut row: Vec<([u32; 3], u32)> = Vec::new();
    for ends in start.windows(2) {
        row.clear();
        let faces = &rows[ends[0] as usize..ends[1] as usize];
        row.extend(faces.iter().map(|&f| (sorted(&mesh.faces[f as usize]), f)));
        row.sort_unstable();
        for (i, &([a, b, c], f)) in row.iter().enumerate() {
            if a == b || b == c {
                repairs.degenerate_faces += 1;
                keep[f as usize] = false;
            } else if i > 0 && row[i - 1].0 == [a, b, c] {
                repairs.duplicate_faces += 1;
                keep[f as usize] = false;
            }
        }
    }
    let mut kept = keep.iter();
    mesh.faces.retain(|_| *kept.next().unwrap_or(&true));
    let mut kept = keep.iter();
    mesh.caps.retain(|_| *kept.next().unwrap_or(&true));
}

/// The other half-edge of every half-edge at edges with two faces, of either orientation.
fn pair_up(mesh: &Mesh, repairs: &mut Repairs) -> Vec<u32> {
    let mut pairs = vec![NONE; 4 * mesh.faces.len()];
    let (start, mut edges) = by_lower_vertex(&mesh.faces, mesh.positions.len());
    for low in 0..mesh.positions.len() {
        let row = &mut edges[start[low] as usize..start[low + 1] as usize];
        row.sort_unstable();
        for same in row.chunk_by(|a, b| a.0 == b.0) {
            match same {
                [(_, a), (_, b)] => {
                    pairs[*a as usize] = *b;
                    pairs[*b as usize] = *a;
                }
                [(high, _), _, _, ..] => {
                    repairs.split_edges += 1;
                    let ends = [low, *high as usize].map(|v| mesh.positions[v]);
                    repairs.first_edge.get_or_insert(ends);
                }
                _ => {}
            }
        }
    }
    pairs
}

/// Flips faces until those that share an edge are oriented alike: as most of each component are, or
/// as its first face is where both are equally many.
fn orient(mesh: &mut Mesh, pairs: &mut [u32], repairs: &mut Repairs) -> Result<(), MeshError> {
    let origin = |mesh: &Mesh, h: u32| mesh.faces[face(h) as usize][(h & 3) as usize];
    let faces = mesh.faces.len();
    // Whether a face is oriented against the first one of its component.
    let mut turned: Vec<Option<bool>> = vec![None; faces];
    let mut component = Vec::new();
    for first in 0..faces {
        if turned[first].is_some() {
            continue;
        }
        turned[first] = Some(false);
        component.clear();
        component.push(first as u32);
        let mut done = 0;
        while let Some(&f) = component.get(done) {
            done += 1;
            let mine = turned[f as usize] == Some(true);
            for h in 4 * f..4 * f + 3 {
                let p = pairs[h as usize];
                if p == NONE {
                    continue;
                }
                let wanted = mine ^ (origin(mesh, h) == origin(mesh, p));
                match turned[face(p) as usize] {
                    None => {
                        turned[face(p) as usize] = Some(wanted);
                        component.push(face(p));
                    }
                    Some(found) if found != wanted => {
                        let ends = [h, next(h)].map(|h| origin(mesh, h) as usize);
                        return Err(MeshError::OneSided { edge: ends.map(|v| mesh.positions[v]) });
                    }
                    _ => {}
                }
            }
        }
        let against = component.iter().filter(|f| turned[**f as usize] == Some(true)).count();
        let over = 2 * against > component.len();
        repairs.flipped_faces += if over { component.len() - against } else { against };
        component.iter().for_each(|f| turned[*f as usize] = turned[*f as usize].map(|t| t ^ over));
    }
    // Turning [a, b, c] to [a, c, b] exchanges the first and the third half-edge.
    let flip =
        |h: u32| if turned[face(h) as usize] == Some(true) { h & !3 | (2 - (h & 3)) } else { h };
    if repairs.flipped_faces > 0 {
        let old = pairs.to_vec();
        for f in 0..faces as u32 {
            for h in 4 * f..4 * f + 3 {
                let p = old[h as usize];
                pairs[flip(h) as usize] = if p == NONE { NONE } else { flip(p) };
            }
            if turned[f as usize] == Some(true) {
                mesh.faces[f as usize].swap(1, 2);
            }
        }
    }
    Ok(())
}

/// Gives every fan of faces its own vertex.
fn split_vertices(mesh: &mut Mesh, pairs: &[u32], repairs: &mut Repairs) {
    let mut seen = vec![false; 4 * mesh.faces.len()];
    let mut taken = vec![false; mesh.positions.len()];
    for first in (0..mesh.faces.len() as u32).flat_map(|f| [4 * f, 4 * f + 1, 4 * f + 2]) {
        if seen[first as usize] {
            continue;
        }
        // Back to the first half-edge of the fan, then through it.
        let mut begin = first;
        while pairs[begin as usize] != NONE {
            begin = next(pairs[begin as usize]);
            if begin == first {
                break;
            }
        }
        let old = mesh.faces[face(first) as usize][(first & 3) as usize];
        let mut name = old;
        if std::mem::replace(&mut taken[old as usize], true) {
            let position = mesh.positions[old as usize];
            repairs.split_vertices += 1;
            repairs.first_vertex.get_or_insert(position);
            name = mesh.positions.len() as u32;
            mesh.positions.push(position);
            if let Some(&normal) = mesh.normals.get(old as usize) {
                mesh.normals.push(normal);
            }
        }
        let mut h = begin;
        loop {
            seen[h as usize] = true;
            mesh.faces[face(h) as usize][(h & 3) as usize] = name;
            h = pairs[prev(h) as usize];
            if h == NONE || h == begin {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(vertices: usize, faces: &[[u32; 3]]) -> Mesh {
        let at = |i: usize| Vec3::new(i as f32, (i * i) as f32, (i % 3) as f32);
        let positions = (0..vertices).map(at).collect();
        Mesh { positions, faces: faces.to_vec(), ..Mesh::default() }
    }

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    fn sound(mesh: &Mesh) -> HalfEdges {
        let edges = HalfEdges::new(mesh).unwrap();
        edges.check().unwrap();
        edges
    }

    #[test]
    fn a_good_mesh_comes_back_as_it_was() {
        let m = mesh(4, &TETRAHEDRON);
        let (out, repairs) = make_manifold(&m).unwrap();
        assert!(out == m && repairs.none());
        sound(&out);
    }

    #[test]
    fn degenerate_and_duplicate_faces_are_dropped_with_their_cap_flags() {
        let mut faces = TETRAHEDRON.to_vec();
        faces.insert(1, [1, 1, 2]);
        faces.insert(3, [1, 0, 2]);
        faces.push([2, 3, 1]);
        let mut m = mesh(4, &faces);
        m.caps = vec![false, true, false, true, false, false, true];
        let (out, repairs) = make_manifold(&m).unwrap();
        assert_eq!((repairs.degenerate_faces, repairs.duplicate_faces), (1, 2));
        assert_eq!((out.faces.len(), out.caps), (4, vec![false; 4]));
        assert_eq!(out.faces, TETRAHEDRON);
    }

    #[test]
    fn faces_turned_over_are_turned_back() {
        for flipped in 0..4 {
            let mut m = mesh(4, &TETRAHEDRON);
            m.faces[flipped].swap(0, 1);
            assert!(matches!(HalfEdges::new(&m), Err(MeshError::Misoriented { .. })));
            let (out, repairs) = make_manifold(&m).unwrap();
            assert_eq!(repairs, Repairs { flipped_faces: 1, ..Repairs::default() });
            sound(&out);
            let volume = mesh(4, &TETRAHEDRON).volume_mm3();
            assert!((out.volume_mm3() - volume).abs() < 1e-9, "{flipped}");
        }
    }

    #[test]
    fn two_tetrahedra_on_one_edge_are_cut_apart_and_stay_closed() {
        let mut faces = TETRAHEDRON.to_vec();
        // The second shares the edge 0–1.
        faces.extend(TETRAHEDRON.map(|f| f.map(|v| if v < 2 { v } else { v + 2 })));
        let m = mesh(6, &faces);
        assert!(matches!(HalfEdges::new(&m), Err(MeshError::NonManifoldEdge { .. })));
        let (out, repairs) = make_manifold(&m).unwrap();
        assert_eq!((repairs.split_edges, repairs.split_vertices), (1, 2));
        assert_eq!(repairs.first_edge, Some([m.positions[0], m.positions[1]]));
        assert_eq!((out.positions.len(), out.faces.len()), (8, 8));
        let edges = sound(&out);
        assert!((0..8).all(|v| !edges.on_boundary(v)));
    }

    #[test]
    fn fans_that_touch_in_a_vertex_get_one_each() {
        let m = mesh(5, &[[0, 1, 2], [0, 3, 4]]);
        let found = HalfEdges::new(&m).unwrap_err();
        assert_eq!(found, MeshError::NonManifoldVertex { vertex: 0, position: m.positions[0] });
        let (out, repairs) = make_manifold(&m).unwrap();
        assert_eq!((repairs.split_vertices, repairs.first_vertex), (1, Some(m.positions[0])));
        assert_eq!(out.faces, [[0, 1, 2], [5, 3, 4]]);
        sound(&out);
    }

    #[test]
    fn a_fin_on_a_closed_surface_comes_off() {
        let mut faces = TETRAHEDRON.to_vec();
        faces.push([0, 1, 4]);
        let (out, repairs) = make_manifold(&mesh(5, &faces)).unwrap();
        assert_eq!(repairs.split_edges, 1);
        sound(&out);
    }

    #[test]
    fn a_moebius_strip_is_refused_at_an_edge() {
        let faces: Vec<[u32; 3]> = (0..5).map(|i| [i, (i + 1) % 5, (i + 2) % 5]).collect();
        assert!(matches!(make_manifold(&mesh(5, &faces)), Err(MeshError::OneSided { .. })));
    }

    #[test]
    fn what_cannot_be_repaired_is_named() {
        let good = mesh(4, &TETRAHEDRON);
        let bad = |change: fn(&mut Mesh)| {
            let mut m = good.clone();
            change(&mut m);
            let other = HalfEdges::new(&m).map(|_| ()).unwrap_err();
            assert_eq!(make_manifold(&m).unwrap_err().to_string(), other.to_string());
            make_manifold(&m).unwrap_err()
        };
        let index = MeshError::Index { face: 2, vertex: 4, vertices: 4 };
        assert_eq!(bad(|m| m.faces[2][1] = 4), index);
        let nan = bad(|m| m.positions[3].y = f32::NAN);
        assert!(matches!(nan, MeshError::NotFinite { what: "position", vertex: 3, .. }));
        let inf = bad(|m| m.normals = vec![Vec3::INFINITY; 4]);
        assert!(matches!(inf, MeshError::NotFinite { what: "normal", vertex: 0, .. }));
        let caps = MeshError::Length { what: "cap flags", found: 1, wanted: 4 };
        assert_eq!(bad(|m| m.caps = vec![true]), caps);
        assert_eq!(make_manifold(&Mesh::default()).unwrap_err(), MeshError::Empty);
        assert_eq!(make_manifold(&mesh(3, &[[0, 1, 1]])).unwrap_err(), MeshError::Empty);
    }

    #[test]
    fn any_heap_of_triangles_becomes_a_manifold_or_is_one_sided() {
        let mut seed = 11u64;
        let mut noise = |n: u64| {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((seed >> 33) % n) as u32
        };
        let (mut made, mut refused) = (0, 0);
        for round in 0..2000 {
            let vertices = 4 + noise(12);
            let count = 1 + noise(1 + round / 40);
            let faces: Vec<[u32; 3]> =
                (0..count).map(|_| [0; 3].map(|_| noise(u64::from(vertices)))).collect();
            match make_manifold(&mesh(vertices as usize, &faces)) {
                Ok((out, _)) => {
                    sound(&out);
                    made += 1;
                }
                Err(MeshError::OneSided { .. } | MeshError::Empty) => refused += 1,
                Err(e) => panic!("{e}"),
            }
        }
        assert!(made > 500 && refused > 20, "{made} {refused}");
    }
}

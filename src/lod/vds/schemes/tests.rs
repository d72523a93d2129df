use super::*;
use crate::lod::vds::tests::Ring;

const ALL: [Scheme; 3] = [Scheme::OneToFour, Scheme::Sqrt3, Scheme::FourEight];

fn closed(mesh: &Mesh) -> bool {
    let mut edges: Vec<(u32, u32)> =
        mesh.faces.iter().flat_map(|f| [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])]).collect();
    edges.sort_unstable();
    edges.windows(2).all(|w| w[0] != w[1])
        && edges.iter().all(|&(a, b)| edges.binary_search(&(b, a)).is_ok())
}

/// Share of faces whose orientation contradicts the normals of their corners.
fn flipped(mesh: &Mesh) -> f64 {
    let back = |f: &&[u32; 3]| {
        let n: glam::Vec3 = f.iter().map(|v| mesh.normals[*v as usize]).sum();
        mesh.face_cross(**f).dot(n) <= 0.0
    };
    mesh.faces.iter().filter(back).count() as f64 / mesh.faces.len() as f64
}

#[test]
fn uniform_refinement_multiplies_faces_by_four_three_and_two() {
    let ring = Ring::new([12, 6], 5);
    for (scheme, first, factor) in
        [(Scheme::OneToFour, 1, 4usize), (Scheme::Sqrt3, 1, 3), (Scheme::FourEight, 3, 2)]
    {
        for rounds in 0..4 {
            let mesh = refine(&ring.base(), &ring, scheme, -1.0, rounds);
            assert_eq!(mesh.faces.len(), 144 * first * factor.pow(rounds), "{scheme:?}");
            assert!(closed(&mesh), "{scheme:?}");
            assert!(flipped(&mesh) < 0.005, "{scheme:?}");
        }
    }
}

/// Over a base that is its own original any scheme stays on it, and where its triangles do too,
/// their areas add up.
#[test]
fn over_its_own_base_each_scheme_preserves_area() {
    let ring = Ring::new([12, 6], 1);
    let area = ring.base().area_mm2();
    for (scheme, rounds) in
        [(Scheme::OneToFour, 3), (Scheme::Sqrt3, 2), (Scheme::Sqrt3, 4), (Scheme::FourEight, 3)]
    {
        let mesh = refine(&ring.base(), &ring, scheme, -1.0, rounds);
        assert!((mesh.area_mm2() / area - 1.0).abs() < 1e-4, "{scheme:?} {rounds}");
    }
    // At odd steps √3 cuts across the edges of the base.
    assert!(refine(&ring.base(), &ring, Scheme::Sqrt3, -1.0, 1).area_mm2() < 0.99 * area);
}

#[test]
fn adaptive_refinement_is_watertight_and_local() {
    let ring = Ring::new([12, 6], 9);
    for scheme in ALL {
        let mut before = 0;
        for tolerance in [1.0, 0.3, 0.1] {
            let mesh = refine(&ring.base(), &ring, scheme, tolerance, 20);
            assert!(closed(&mesh), "{scheme:?} {tolerance}");
            assert!(flipped(&mesh) < 0.005, "{scheme:?} {tolerance}");
            assert!(mesh.faces.len() > before, "{scheme:?} {tolerance}");
            before = mesh.faces.len();
        }
        // Finer in one half of the ring alone.
        let base = ring.base();
        let part = Half { ring: &ring, base: ring.base() };
        let mesh = refine(&base, &part, scheme, 0.05, 20);
        assert!(closed(&mesh), "{scheme:?}");
        let side = |right: bool| {
            let x = |f: &[u32; 3]| f.iter().map(|v| mesh.positions[*v as usize].x).sum::<f32>();
            mesh.faces.iter().filter(|f| (x(f) > 0.0) == right).count()
        };
        assert!(side(true) > 3 * side(false), "{scheme:?} {} {}", side(true), side(false));
    }
}

/// A mesh that is its own original.
struct Itself(Mesh);

impl Original for Itself {
    fn at(&self, face: u32, weights: [f64; 3]) -> crate::geometry::Vertex {
        let corners = self.0.faces[face as usize].map(|v| self.0.positions[v as usize].as_dvec3());
        let at: glam::DVec3 = (0..3).map(|c| weights[c] * corners[c]).sum();
        crate::geometry::Vertex::new(at.as_vec3(), glam::Vec3::ZERO, 0.0)
    }
    fn vertices(&self) -> u32 {
        0
    }
    fn vertex(&self, _: u32) -> Option<(u32, [f64; 3], crate::geometry::Vertex)> {
        None
    }
    fn faces(&self) -> u64 {
        self.0.faces.len() as u64
    }
    fn distance_mm(&self, _: glam::DVec3) -> f64 {
        0.0
    }
}

/// Tetrahedra, in which any two corners are neighbours and also lie opposite an edge.
#[test]
fn tetrahedra_whose_neighbours_are_also_opposite_are_refined() {
    use glam::Vec3;
    let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    let faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let solid = Itself(Mesh { positions, faces, ..Mesh::default() });
    for (scheme, rounds, count) in
        [(Scheme::OneToFour, 3, 4 * 64), (Scheme::Sqrt3, 2, 4 * 9), (Scheme::FourEight, 4, 4 * 48)]
    {
        let mesh = refine(&solid.0, &solid, scheme, -1.0, rounds);
        assert_eq!(mesh.faces.len(), count, "{scheme:?}");
        assert!(closed(&mesh), "{scheme:?}");
        assert!((mesh.area_mm2() / solid.0.area_mm2() - 1.0).abs() < 1e-5, "{scheme:?}");
    }
}

/// The ring on one side, its base on the other.
struct Half<'a> {
    ring: &'a Ring,
    base: Mesh,
}

impl Original for Half<'_> {
    fn at(&self, face: u32, weights: [f64; 3]) -> crate::geometry::Vertex {
        let mesh = &self.base;
        let corners = mesh.faces[face as usize].map(|v| mesh.positions[v as usize].as_dvec3());
        let flat: glam::DVec3 = (0..3).map(|c| weights[c] * corners[c]).sum();
        let real = self.ring.at(face, weights);
        let share = (flat.x / 10.0).clamp(0.0, 1.0) as f32;
        let at = flat.as_vec3().lerp(real.position(), share);
        crate::geometry::Vertex::new(at, real.normal(), 0.0)
    }
    fn vertices(&self) -> u32 {
        0
    }
    fn vertex(&self, _: u32) -> Option<(u32, [f64; 3], crate::geometry::Vertex)> {
        None
    }
    fn faces(&self) -> u64 {
        1
    }
    fn distance_mm(&self, _: glam::DVec3) -> f64 {
        0.0
    }
}

#[test]
fn an_open_base_has_no_boundary_but_its_own_after_refinement() {
    let ring = Ring::new([12, 6], 5);
    let mut base = ring.base();
    base.faces.truncate(96);
    for scheme in ALL {
        let mesh = refine(&base, &ring, scheme, -1.0, 3);
        let mut edges = std::collections::HashMap::new();
        for f in &mesh.faces {
            for e in 0..3 {
                let (a, b) = (f[e], f[(e + 1) % 3]);
                *edges.entry((a.min(b), a.max(b))).or_insert(0) += if a < b { 1 } else { -1 };
            }
        }
        let rim = edges.values().filter(|n| **n != 0).count();
        // Two rims of six edges each, halved by each round, by every other one, or not at all.
        let want = match scheme {
            Scheme::OneToFour => 12 * 8,
            Scheme::Sqrt3 => 12,
            Scheme::FourEight => 12 * 4,
        };
        assert_eq!(rim, want, "{scheme:?}");
    }
}

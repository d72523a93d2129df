//! Which faces a camera refines, how fine, and their vertices.

use std::collections::HashMap;
use std::fmt::Debug;
use std::sync::{Arc, OnceLock};

use glam::Vec3;
use rayon::prelude::*;

use super::grid::{FaceGrid, FacePoint, MAX_LEVEL, STEPS};
use super::near::NearFaces;
use crate::geometry::{Camera, Cone, Mesh, Sphere, Vertex};
use crate::lod::morph::{MORPH_STEPS, PatchVertex};
use crate::lod::octree::{Item, OctreeNode};
use crate::lod::{
    DrawnWall, ExteriorGrid, FaceOctree, OcclusionTest, Tolerance, ViewFrustum, VisibleWall,
};
use crate::surface::Shading;
use crate::wall::WallSpline;

/// Largest distance of a new vertex of the first level from the edge that it splits, lengths of the
/// edge; half as much at each level after it. An arc that turns by a right angle bulges by 0.207.
const MAX_BULGE: f32 = 0.4;
/// Largest distance of a point of a refined face from the face, lengths of its longest edge. Edges of
/// the levels are at most 1, 0.9, 0.63 and 0.38 as long: 0.4 + 0.2 · 0.9 + 0.1 · 0.63 + 0.05 · 0.38.
pub(super) const MAX_DEPARTURE: f32 = 0.67;
/// Largest distance of a new vertex of the last level from the edge that it splits, lengths of the
/// longest edge of the face: 0.05 · 0.38, as above.
pub(super) const MAX_LAST_BULGE: f32 = 0.019;
/// Largest sag of an edge, lengths of the edge: in its middle, or by its normals.
const MAX_SAG: f32 = MAX_BULGE;
/// Sine of the angle by which the normals of a refined face may differ from those of the face and of
/// its corners.
const CONE_SINE: f32 = 0.3;

/// The smooth wall that a mesh is an approximation of.
pub trait SmoothWall: Debug + Send + Sync {
    /// Returns how far along a line the wall is, mm, at most `reach_mm` away in both directions;
    /// `None` if it is not found there.
    ///
    /// * `from`: point on the line, LPS mm.
    /// * `way`: unit vector along the line, into the lumen.
    fn root(&self, from: Vec3, way: Vec3, reach_mm: f32) -> Option<f32>;

    /// Returns about how far a point (LPS mm) is from the wall along a line, mm: the first step of the
    /// search for a root. `None` far from the wall, and where the line runs along it.
    fn off(&self, p: Vec3, way: Vec3) -> Option<f32>;
}

impl SmoothWall for WallSpline {
    fn root(&self, from: Vec3, way: Vec3, reach_mm: f32) -> Option<f32> {
        WallSpline::root(self, from, way, reach_mm)
    }

    fn off(&self, p: Vec3, way: Vec3) -> Option<f32> {
        WallSpline::off(self, p, way)
    }
}

/// A face that is refined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefinedFace {
    /// Number of the face, in the order of the tree.
    pub face: u32,
    /// Fineness inside and on the three sides, a byte each, 32 to a level.
    pub fineness: u32,
}

impl RefinedFace {
    /// Returns the face with its sides as fine as this, 32 steps a level, and as fine inside as the
    /// finest side; `None` of a face that stays flat.
    pub(super) fn of_sides(face: u32, sides: [u32; 3]) -> Option<Self> {
        let inside = sides.into_iter().max().filter(|most| *most > 0)?;
        let fineness = inside | sides[0] << 8 | sides[1] << 16 | sides[2] << 24;
        Some(Self { face, fineness })
    }

    /// Fineness of the three sides.
    pub(super) fn sides(self) -> [u32; 3] {
        [8, 16, 24].map(|shift| self.fineness >> shift & 0xff)
    }

    /// Returns the number of splits inside.
    pub(super) fn level(self) -> u32 {
        (self.fineness & 0xff).div_ceil(MORPH_STEPS)
    }

    /// Returns the numbers of splits of the sides.
    pub(super) fn side_levels(self) -> [u32; 3] {
        self.sides().map(|fineness| fineness.div_ceil(MORPH_STEPS))
    }

    /// Returns the number of triangles.
    pub fn triangles(self) -> u32 {
        FaceGrid::get().template(self.level(), self.side_levels()).triangles
    }
}

/// What a refined wall is made of.
pub struct RefinedWallInput<'a> {
    /// Mesh that is drawn.
    pub mesh: &'a Mesh,
    /// Its vertices as drawn.
    pub shading: &'a Shading,
    /// For each vertex whether it stays where it is: on a cap, the wall is cut and not smooth.
    pub is_fixed: Vec<bool>,
    /// The smooth wall. If it is `None`, the normals of the mesh say how the mesh curves.
    pub smooth: Option<Arc<dyn SmoothWall>>,
    /// Exterior of the mesh, if it is closed.
    pub exterior: Option<Arc<ExteriorGrid>>,
    /// Largest distance that a vertex of the mesh moves onto the smooth wall, mm.
    pub reach_mm: f32,
    /// Largest deviation of a drawn edge from the smooth wall.
    pub tolerance: Tolerance,
}

/// A wall whose faces are refined near the eye.
#[derive(Debug)]
pub struct RefinedWall {
    pub(super) octree: FaceOctree,
    /// Vertices of the mesh, put on the smooth wall.
    shading: Arc<Shading>,
    /// Vertices of the faces, in the order of the tree.
    faces: Vec<[u32; 3]>,
    is_fixed: Vec<bool>,
    leaves: Vec<Leaf>,
    smooth: Option<Arc<dyn SmoothWall>>,
    closed: Option<OcclusionTest>,
    tolerance: Tolerance,
    pub(super) near: NearFaces,
    departure_mm: f32,
}

/// Sag of the edges of a leaf of the tree, by node; empty of other nodes.
#[derive(Debug, Default)]
struct Leaf {
    /// Largest sag that its edges can have, mm.
    most_mm: f32,
    /// Sag of the three edges of each face, mm, found when an eye first comes near.
    sag_mm: OnceLock<Vec<[f32; 3]>>,
}

/// A point of a face while its vertices are made.
#[derive(Clone, Copy, Debug, Default)]
struct WallPoint {
    at: Vec3,
    normal: Vec3,
    tint: f32,
    /// Whether it lies on the plane of a cut.
    is_fixed: bool,
}

impl WallPoint {
    fn of(vertex: &Vertex, is_fixed: bool) -> Self {
        let [at, normal] = [vertex.position(), vertex.normal()];
        Self { at, normal, tint: vertex.w(), is_fixed }
    }

    fn vertex(&self) -> Vertex {
        Vertex::new(self.at, self.normal, self.tint)
    }
}

impl RefinedWall {
    /// Puts the vertices of a mesh on the smooth wall and builds the tree of its faces.
    pub fn new(input: RefinedWallInput<'_>) -> Self {
        let RefinedWallInput { mesh, shading, is_fixed, smooth, exterior, .. } = input;
        let reach = input.reach_mm;

        // 1. Vertices.
        let placed = |(v, is_fixed): (&Vertex, &bool)| match &smooth {
            Some(smooth) if !is_fixed => {
                let p = WallPoint::of(v, false);
                let way = p.normal.normalize_or_zero();
                let t = smooth.root(p.at, way, reach).unwrap_or(0.0);
                WallPoint { at: p.at + t * way, ..p }.vertex()
            }
            _ => *v,
        };
        let vertices: Vec<Vertex> =
            shading.vertices.par_iter().zip(&is_fixed).with_min_len(256).map(placed).collect();

        // 2. Tree, with room for the bulge of each face.
        let corners = |f: u32| mesh.faces[f as usize].map(|v| &vertices[v as usize]);
        let item = |f: u32| {
            let own = corners(f);
            let [a, b, c] = own.map(Vertex::position);
            let flat = Item::triangle([a, b, c]);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let room = MAX_DEPARTURE * longest;
            let cone = cone_about(flat.cone, own.map(Vertex::normal));
            Item { lo: flat.lo - room, hi: flat.hi + room, cone, ..flat }
        };
        let octree = FaceOctree::of_items(mesh.faces.len(), item);
        let faces: Vec<[u32; 3]> =
            octree.faces().par_iter().map(|f| mesh.faces[*f as usize]).collect();

        // 3. Leaves.
        let mut wall = Self {
            octree,
            shading: Arc::new(Shading { vertices, mean_radius_mm: shading.mean_radius_mm }),
            faces,
            is_fixed,
            leaves: Vec::new(),
            smooth,
            closed: None,
            tolerance: input.tolerance,
            near: NearFaces::default(),
            departure_mm: 0.0,
        };
        let leaf = |n: &OctreeNode| {
            let faces = if n.is_leaf() { n.first..n.first + n.count } else { 0..0 };
            let longest = faces.map(|f| wall.longest_edge_mm(f as usize)).fold(0.0, f32::max);
            Leaf { most_mm: MAX_SAG * longest, sag_mm: OnceLock::new() }
        };
        wall.leaves = wall.octree.nodes().par_iter().map(leaf).collect();

        // 4. Occlusion by the mesh, from which the drawn wall departs.
        let longest = wall.leaves.iter().map(|leaf| leaf.most_mm / MAX_SAG).fold(0.0, f32::max);
        wall.departure_mm = MAX_DEPARTURE * longest + reach;
        let margin = f64::from(wall.departure_mm);
        wall.closed = exterior.map(|grid| OcclusionTest::new(grid, margin, margin));
        wall
    }

    /// Returns the vertices of the mesh, put on the smooth wall.
    pub fn shading(&self) -> &Arc<Shading> {
        &self.shading
    }

    /// Returns the largest distance of any drawn point from the mesh, mm, whatever the smooth wall.
    pub fn departure_mm(&self) -> f32 {
        self.departure_mm
    }

    /// Position of a vertex of the mesh, LPS mm.
    pub(super) fn position(&self, v: u32) -> Vec3 {
        self.shading.vertices[v as usize].position()
    }

    /// A vertex of the mesh.
    #[inline]
    fn point(&self, v: u32) -> WallPoint {
        WallPoint::of(&self.shading.vertices[v as usize], self.is_fixed[v as usize])
    }

    /// Returns the vertices of the faces, in the order of the tree.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Ends of an edge of a face.
    #[inline]
    fn edge(&self, face: usize, edge: usize) -> [WallPoint; 2] {
        let f = self.faces[face];
        [f[edge], f[(edge + 1) % 3]].map(|v| self.point(v))
    }

    /// Length of the longest edge of a face, mm.
    pub(super) fn longest_edge_mm(&self, face: usize) -> f32 {
        let lengths = (0..3).map(|e| self.edge(face, e)).map(|[a, b]| a.at.distance(b.at));
        lengths.fold(0.0, f32::max)
    }

    /// How far the smooth wall departs from an edge, mm: in its middle, by the slope of the field
    /// there, or by the normals at its ends; 0 of an edge that is cut. It is the same from both faces.
    fn sag_mm(&self, face: usize, edge: usize) -> f32 {
        let [a, b] = self.edge(face, edge);
        if a.is_fixed && b.is_fixed {
            return 0.0;
        }
        let along = b.at - a.at;
        let by_normals = 0.25 * along.dot(a.normal).abs().max(along.dot(b.normal).abs());
        let normal = (a.normal + b.normal).normalize_or_zero();
        let off = self.smooth.as_ref().and_then(|s| s.off(0.5 * (a.at + b.at), normal));
        by_normals.max(off.unwrap_or(0.0)).min(MAX_SAG * along.length())
    }

    /// Returns a face as fine as a camera asks; `None` if it stays flat.
    ///
    /// * `sag`: of its edges, mm.
    /// * `allowed_mm`: sag that is allowed anywhere in its leaf, whose box holds the ball about each
    ///   edge.
    fn refined(
        &self,
        frustum: &ViewFrustum,
        face: u32,
        sag: [f32; 3],
        allowed_mm: f32,
    ) -> Option<RefinedFace> {
        let f = face as usize;
        let sides = [0, 1, 2].map(|e| match sag[e] <= allowed_mm {
            true => 0,
            false => self.fineness(frustum, f, e, sag[e]),
        });
        let refined = RefinedFace::of_sides(face, sides)?;
        self.is_seen(frustum, f).then_some(refined)
    }

    /// Fineness of an edge, [`MORPH_STEPS`] to a level: the least at which its sag is allowed. It is
    /// the same from both faces.
    fn fineness(&self, frustum: &ViewFrustum, face: usize, edge: usize, sag: f32) -> u32 {
        let [a, b] = self.edge(face, edge).map(|p| p.at);
        let sphere = Sphere { centre: 0.5 * (a + b), radius: 0.5 * a.distance(b) };
        let pixels = frustum.error_scale(&sphere).px(f64::from(sag));
        let tolerance = f64::from(self.tolerance.pixels);
        // A split quarters the sag. New vertices move gradually into place.
        let (mut left, mut level) = (pixels / tolerance, 0);
        while left > 4.0 && level < MAX_LEVEL {
            left *= 0.25;
            level += 1;
        }
        if left <= 1.0 || level == MAX_LEVEL {
            return level * MORPH_STEPS;
        }
        let share = (1.0 - left.recip()) / 0.75;
        level * MORPH_STEPS + (share * f64::from(MORPH_STEPS)) as u32
    }

    /// Whether a camera may see any of a refined face.
    fn is_seen(&self, frustum: &ViewFrustum, face: usize) -> bool {
        let corners = self.faces[face].map(|v| self.point(v));
        let [a, b, c] = corners.map(|p| p.at);
        let middle = (a + b + c) / 3.0;
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let radius = (2.0 / 3.0 + MAX_DEPARTURE) * longest;
        let sphere = Sphere { centre: middle, radius };
        if !frustum.intersects(&sphere) {
            return false;
        }
        let looks_away = |n: Vec3| {
            let cone = Cone { axis: n, sine: CONE_SINE };
            frustum.is_backfacing(&sphere, &cone)
        };
        let flat = (b - a).cross(c - a).normalize_or_zero();
        self.closed.is_none() || !(looks_away(flat) && corners.iter().all(|p| looks_away(p.normal)))
    }

    /// Returns the vertices of a face up to a level, coarse levels first.
    ///
    /// * `face`: in the order of the tree.
    pub(super) fn patch(&self, face: u32, level: u32) -> Vec<PatchVertex> {
        let grid = FaceGrid::get();
        let corners = self.faces[face as usize];
        let mut points = [WallPoint::default(); FaceGrid::points_at(MAX_LEVEL)];
        let count = FaceGrid::points_at(level);
        let one = |(i, shape): (usize, &FacePoint)| {
            let carrier = PatchVertex::carrier_word(shape.carrier, shape.born);
            if shape.born == 0 {
                let own = self.shading.vertices[corners[i] as usize];
                points[i] = self.point(corners[i]);
                return PatchVertex { own, on_edge: own, carrier };
            }
            let [a, b] = shape.parents.map(|p| points[p]);
            let (own, middle) = self.middle(&a, &b, shape.born);
            points[i] = own;
            PatchVertex { own: own.vertex(), on_edge: middle.vertex(), carrier }
        };
        grid.points[..count].iter().enumerate().map(one).collect()
    }

    /// Returns the point of the wall that splits an edge at a level, and the middle of the edge. Both are the
    /// same, in every bit, if the ends change places.
    fn middle(&self, a: &WallPoint, b: &WallPoint, born: u32) -> (WallPoint, WallPoint) {
        let along = b.at - a.at;
        let normal = (a.normal + b.normal).normalize_or_zero();
        let (at, tint) = (0.5 * (a.at + b.at), 0.5 * (a.tint + b.tint));
        let middle = WallPoint { at, normal, tint, is_fixed: a.is_fixed && b.is_fixed };
        if middle.is_fixed {
            return (middle, middle);
        }

        // 1. Prediction by the normals: the middle of a cubic (PN triangles: Vlachos et al. 2001,
        // doi:10.1145/364338.364387).
        let bend = along.dot(b.normal) * b.normal - along.dot(a.normal) * a.normal;
        let most = MAX_BULGE * 0.5f32.powi(born as i32 - 1) * along.length();
        let predicted = middle.at + (0.125 * bend).clamp_length_max(most);

        // 2. The wall along the normal.
        let root = self.smooth.as_ref().and_then(|smooth| smooth.root(predicted, normal, most));
        let found = root.map(|t| predicted + t * normal);
        let found = found.filter(|p| p.distance(middle.at) <= most);
        (WallPoint { at: found.unwrap_or(predicted), ..middle }, middle)
    }

    /// Returns the mesh with all its faces split so many times, with normals.
    ///
    /// * `level`: 1 to 4; a split quadruples the faces.
    /// * `caps`: of the mesh that `self` was made of, whether each face is a cap, or nothing.
    pub fn mesh(&self, level: u32, caps: &[bool]) -> Mesh {
        let grid = FaceGrid::get();
        let indices = grid.indices_of(level, [level; 3]);
        let mut mesh = Mesh::default();
        // Points on edges by the ends of the edge, the lower first, and steps from there.
        let mut shared: HashMap<[u32; 3], u32> = HashMap::new();
        for (number, face) in self.octree.faces().iter().zip(&self.faces).enumerate() {
            let of_face = self.patch(number as u32, level);
            let mut add = |vertex: &Vertex| {
                mesh.positions.push(vertex.position());
                mesh.normals.push(vertex.normal().normalize_or(Vec3::Z));
                mesh.positions.len() as u32 - 1
            };
            let mut place =
                |(vertex, point): (&PatchVertex, &FacePoint)| match edge_place(*face.1, point) {
                    Some(key) => *shared.entry(key).or_insert_with(|| add(&vertex.own)),
                    None => add(&vertex.own),
                };
            let numbers: Vec<u32> = of_face.iter().zip(&grid.points).map(&mut place).collect();
            let own = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]);
            mesh.faces.extend(own.map(|t| t.map(|i| numbers[i as usize])));
            if let Some(is_cap) = caps.get(*face.0 as usize) {
                mesh.caps.resize(mesh.faces.len(), *is_cap);
            }
        }
        mesh
    }

    /// Returns the triangles of a refined face as the device draws them.
    pub fn triangles(&self, refined: RefinedFace) -> Vec<[Vertex; 3]> {
        let grid = FaceGrid::get();
        let own = self.patch(refined.face, refined.level());
        let indices = grid.indices_of(refined.level(), refined.side_levels());
        let at = |i: &u32| own[*i as usize].morphed(refined.fineness);
        indices.chunks_exact(3).map(|t| [at(&t[0]), at(&t[1]), at(&t[2])]).collect()
    }
}

/// Cone of the normals of a refined face.
///
/// * `flat`: about the normal of the face; all directions if it has none.
/// * `normals`: of its corners.
fn cone_about(flat: Cone, normals: [Vec3; 3]) -> Cone {
    let cosines = normals.map(|n| flat.axis.dot(n) / n.length());
    let least = cosines.into_iter().fold(1.0, f32::min);
    // Sine and cosine of the sum of both angles.
    let (away, own) = ((1.0 - least * least).max(0.0).sqrt(), (1.0 - CONE_SINE * CONE_SINE).sqrt());
    let cosine = least * own - away * CONE_SINE;
    let is_narrow = flat.sine < 1.0 && cosine > 0.0 && cosines.iter().all(|c| c.is_finite());
    let sine = away * own + least * CONE_SINE;
    if is_narrow { Cone { sine: sine + 1e-5, ..flat } } else { Cone::default() }
}

/// Name of a point that faces share: the lower and the higher end of its edge, and steps from the
/// lower; `None` of a point inside a face.
fn edge_place(face: [u32; 3], point: &FacePoint) -> Option<[u32; 3]> {
    let away = point.at.iter().position(|c| *c == 0)?;
    let [from, to] = [(away + 1) % 3, (away + 2) % 3];
    let (a, b, steps) = (face[from], face[to], point.at[to]);
    Some(match steps {
        0 => [a, a, 0],
        STEPS => [b, b, 0],
        _ if a < b => [a, b, steps],
        _ => [b, a, STEPS - steps],
    })
}

impl DrawnWall for RefinedWall {
    fn visible(&self, camera: &Camera) -> VisibleWall {
        let frustum = ViewFrustum::new(camera);
        let depths = self.closed.as_ref().map(|test| test.depths(&frustum));
        let tolerance = f64::from(self.tolerance.pixels);
        let mut seen = VisibleWall::default();
        self.octree.visible_leaves(&frustum, depths.as_ref(), |at, n| {
            let faces = n.first..n.first + n.count;
            let leaf = &self.leaves[at];
            let allowed_mm = frustum.error_scale(&n.sphere).error_mm(tolerance) as f32;
            if leaf.most_mm <= allowed_mm {
                seen.add_faces(faces);
                return;
            }
            let own = faces.clone();
            let sag = leaf.sag_mm.get_or_init(|| {
                own.map(|f| [0, 1, 2].map(|e| self.sag_mm(f as usize, e))).collect()
            });
            for (face, sag) in faces.zip(sag) {
                match self.refined(&frustum, face, *sag, allowed_mm) {
                    Some(refined) => seen.refined.push(refined),
                    None => seen.add_faces(face..face + 1),
                }
            }
        });
        seen
    }

    fn shows_backs(&self) -> bool {
        self.closed.is_none()
    }
}

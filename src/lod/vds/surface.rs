//! Surface prepared for view-dependent subdivision: patches, their bounds, and the octree over the
//! base.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::base_mesh::BaseMesh;
use super::butterfly::Predicted;
use super::forest::PatchForest;
use super::measure::{OriginalPoint, PatchBounds, PatchSampler};
use super::original::Original;
use super::patch::{PatchVertex, ResidentPatches, vertices};
use super::scheme::Scheme;
use super::template::{PatchShape, SPLITS};
use crate::geometry::{Mesh, Vertex};
use crate::lod::octree::{Item, Octree, bounding_cone};
use crate::lod::{ExteriorGrid, OcclusionTest, occlusion_grid_around};

/// Most patches: 0.8 GB of vertices.
const MAX_PATCHES: usize = 1 << 18;

/// Options of the subdivision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VdsOptions {
    /// Distance from the original at which a patch is not split further, mm.
    pub finest_mm: f32,
    /// Triangles of the finest level, as a multiple of the original's. The base alone may have
    /// more.
    pub finest_share: f64,
    /// Shading tolerance: root mean square angle between the normals that are drawn and those of
    /// the original, radians.
    pub shading_rad: f32,
    /// Subdivision scheme.
    pub scheme: Scheme,
    /// Geomorphing, where the scheme has it: new vertices move into place instead of popping.
    pub morph: bool,
}

impl Default for VdsOptions {
    fn default() -> Self {
        Self {
            finest_mm: 0.0,
            finest_share: 1.2,
            shading_rad: DEFAULT_SHADING_RAD,
            scheme: Scheme::default(),
            morph: true,
        }
    }
}

/// Shading tolerance, radians. It changes the light by a tenth at most.
const DEFAULT_SHADING_RAD: f32 = 0.1;

/// A patch is far from the original beyond this multiple of [`VdsOptions::finest_mm`].
const FAR: f32 = 10.0;

/// Base faces of a leaf of the octree.
const LEAF_FACES: usize = 12;

/// Reasons why a surface cannot be subdivided.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum VdsError {
    /// The base mesh is empty.
    #[error("the base mesh has no faces")]
    Empty,
    /// A face with a vertex index out of range.
    #[error("base face {face} names vertex {vertex}, but there are {vertices}")]
    NoVertex {
        /// Index of the face.
        face: usize,
        /// Vertex index that is out of range.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// More patches than memory is planned for.
    #[error("{faces} base faces, at most {MAX_PATCHES} patches can be kept")]
    TooLarge {
        /// Number of base faces.
        faces: usize,
    },
    /// A sample of the original that is not finite.
    #[error("the original has no finite position at a sample of base face {face}")]
    NotFinite {
        /// Base face of the sample.
        face: u32,
    },
}

/// A base mesh and the patches over it.
#[derive(Clone, Debug)]
pub struct SubdivisionSurface {
    pub(super) forest: PatchForest,
    /// Bounds of each node. Spheres and cones contain those of all nodes below.
    pub(super) bounds: Vec<PatchBounds>,
    /// Finest level at which each base face is drawn unless a neighbour is finer.
    pub(super) finest: Vec<u32>,
    /// Over the base faces.
    pub(super) tree: Octree,
    patches: Arc<ResidentPatches>,
    pub(super) options: VdsOptions,
    finest_faces: u64,
}

/// Patches while they are made.
struct PatchGrowth<'a> {
    sampler: PatchSampler<'a>,
    forest: PatchForest,
    bounds: Vec<PatchBounds>,
    vertices: Vec<PatchVertex>,
    /// Vertices of the original in each leaf.
    inside: Vec<Vec<OriginalPoint>>,
}

impl PatchGrowth<'_> {
    /// Samples and measures the nodes that are new.
    fn measure(&mut self) -> Result<(), VdsError> {
        let one = |id: usize| {
            let node = &self.forest.nodes[id];
            let samples = self.sampler.samples(node);
            if samples.iter().any(|s| !s.position().is_finite()) {
                return Err(VdsError::NotFinite { face: node.face });
            }
            Ok((self.sampler.measure(node.depth, &samples, &self.inside[id]), samples))
        };
        let from = self.bounds.len();
        let new: Vec<(PatchBounds, Vec<Vertex>)> =
            (from..self.forest.nodes.len()).into_par_iter().map(one).collect::<Result<_, _>>()?;
        for (bounds, samples) in new {
            self.bounds.push(bounds);
            self.vertices.extend(vertices(self.sampler.shape(), &samples));
        }
        Ok(())
    }

    /// Splits a node; returns how many were split with it, itself included.
    fn split(&mut self, id: u32) -> u64 {
        let split = self.forest.split(id);
        self.inside.resize_with(self.forest.nodes.len(), Vec::new);
        for n in &split {
            let first = self.forest.children(*n).start;
            for p in std::mem::take(&mut self.inside[*n as usize]) {
                let (child, p) = p.in_child();
                self.inside[(first + child) as usize].push(p);
            }
        }
        split.len() as u64
    }

    fn error_mm(&self, id: u32) -> f32 {
        self.bounds[id as usize].error_mm[self.sampler.shape().finest() as usize]
    }
}

impl SubdivisionSurface {
    /// Takes the samples of the base, and of finer patches where the original is furthest.
    ///
    /// # Errors
    /// [`VdsError`].
    pub fn new(
        base: &Mesh,
        original: &dyn Original,
        options: VdsOptions,
    ) -> Result<Self, VdsError> {
        let vertices = base.positions.len();
        for (face, f) in base.faces.iter().enumerate() {
            if let Some(&vertex) = f.iter().find(|v| **v as usize >= vertices) {
                return Err(VdsError::NoVertex { face, vertex, vertices });
            }
        }
        match base.faces.len() {
            0 => return Err(VdsError::Empty),
            faces if faces > MAX_PATCHES => return Err(VdsError::TooLarge { faces }),
            _ => {}
        }
        let scheme = options.scheme;
        let predicted = (scheme == Scheme::Butterfly).then(|| Predicted::new(base, original));
        let original = predicted.as_ref().map_or(original, |p| p);
        let base = BaseMesh::new(base.faces.clone(), vertices);
        let mut growth = PatchGrowth {
            sampler: PatchSampler::new(&base, original, scheme),
            forest: PatchForest::new(&base),
            bounds: Vec::new(),
            vertices: Vec::new(),
            inside: vec![Vec::new(); base.faces.len()],
        };
        for v in 0..original.vertices() {
            if let Some((face, weights, vertex)) = original.vertex(v)
                && let Some(own) = growth.inside.get_mut(face as usize)
            {
                own.push(OriginalPoint { weights, vertex });
            }
        }
        growth.measure()?;
        let shape = PatchShape::of(scheme);
        let finest: Vec<u32> = (0..base.faces.len())
            .map(|f| enough(shape, &growth.bounds[f], growth.inside[f].len(), options.finest_mm))
            .collect();
        let mut total: u64 = finest.iter().map(|l| shape.triangles(*l)).sum();
        let budget = (options.finest_share * original.faces() as f64) as u64;
        if scheme.nests() {
            grow(&mut growth, &finest, options.finest_mm, budget, &mut total)?;
        }
        Ok(Self::finish(growth, finest, options, total))
    }

    fn finish(
        growth: PatchGrowth,
        finest: Vec<u32>,
        options: VdsOptions,
        finest_faces: u64,
    ) -> Self {
        let PatchGrowth { forest, mut bounds, vertices, .. } = growth;
        let shape = PatchShape::of(options.scheme);
        for id in (0..forest.nodes.len() as u32).rev() {
            let mut own = bounds[id as usize];
            let below = || forest.children(id).map(|c| &bounds[c as usize]);
            let mut least_mm = below().map(|b| b.error_mm[SPLITS as usize - 1]).fold(0.0, f32::max);
            for error_mm in own.error_mm[..=shape.finest() as usize].iter_mut().rev() {
                *error_mm = error_mm.max(least_mm);
                least_mm = *error_mm;
            }
            let reach = |b: &PatchBounds| {
                own.sphere.centre.distance(b.sphere.centre) * (1.0 + 1e-6) + b.sphere.radius
            };
            let radius = below().map(reach).fold(own.sphere.radius, f32::max);
            let extent = |b: &PatchBounds| {
                ((own.sphere.centre - b.sphere.centre).abs() + b.half) * (1.0 + 1e-6)
            };
            let half = below().map(extent).fold(own.half, Vec3::max);
            let cones: Vec<_> = below().map(|b| b.cone).chain([own.cone]).collect();
            own.sphere.radius = radius;
            bounds[id as usize] =
                PatchBounds { half, cone: bounding_cone(cones.into_iter()), ..own };
        }
        let item = |b: &PatchBounds| {
            let PatchBounds { sphere, half, cone, .. } = *b;
            let centre = sphere.centre;
            Item { lo: centre - half, hi: centre + half, centre, cone }
        };
        let items: Vec<Item> = bounds[..finest.len()].iter().map(item).collect();
        let tree = Octree::with_leaves(&items, LEAF_FACES);
        let patches = Arc::new(ResidentPatches { vertices, scheme: options.scheme });
        Self { forest, bounds, finest, tree, patches, options, finest_faces }
    }

    pub(super) fn shape(&self) -> &'static PatchShape {
        PatchShape::of(self.options.scheme)
    }

    /// Vertices of all patches and the index templates.
    pub fn patches(&self) -> &Arc<ResidentPatches> {
        &self.patches
    }

    /// Faces of the base mesh.
    pub fn base_faces(&self) -> u64 {
        self.finest.len() as u64
    }

    /// Triangles of the finest level.
    pub fn finest_faces(&self) -> u64 {
        self.finest_faces
    }

    /// Two-sided distance of the coarsest surface to the original, mm: that of the worst patch.
    pub fn coarsest_error_mm(&self) -> f32 {
        self.bounds[..self.finest.len()].iter().map(|b| b.error_mm[0]).fold(0.0, f32::max)
    }

    /// Two-sided distance of the finest surface to the original, mm; the paper assumes 0.
    pub fn finest_error_mm(&self) -> f32 {
        self.leaves().map(|(_, error_mm)| error_mm).fold(0.0, f32::max)
    }

    /// Occlusion test of this surface. A few patches that stay far from the original would widen
    /// the margin everywhere; where they are drawn nothing counts as exterior instead.
    ///
    /// * `grid`: exterior of `wall`, the closed original.
    pub fn occlusion_test(&self, grid: Arc<ExteriorGrid>, wall: &Mesh) -> OcclusionTest {
        let far_mm = self.finest_error_mm().min(FAR * self.options.finest_mm);
        let far = self.far_boxes(far_mm);
        let grid = if far.is_empty() { grid } else { Arc::new(occlusion_grid_around(wall, &far)) };
        OcclusionTest::new(grid, f64::from(far_mm), f64::from(self.coarsest_error_mm()))
    }

    /// Boxes, smallest and largest corner, around the patches of the finest surface that are further
    /// than `limit_mm` from the original.
    fn far_boxes(&self, limit_mm: f32) -> Vec<[Vec3; 2]> {
        let corners = |n: u32| {
            let positions = self.patches.vertices_of(n).iter().map(|v| v.own.position());
            positions.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |b, p| [b[0].min(p), b[1].max(p)])
        };
        let far = self.leaves().filter(|(_, error_mm)| *error_mm > limit_mm);
        far.map(|(n, _)| corners(n)).collect()
    }

    /// Patches of the finest surface, and their distance to the original, mm.
    fn leaves(&self) -> impl Iterator<Item = (u32, f32)> + '_ {
        let finest = self.shape().finest();
        let leaves = (0..self.bounds.len()).filter(|n| self.forest.children(*n as u32).is_empty());
        leaves.map(move |n| {
            let level = self.finest.get(n).copied().unwrap_or(finest);
            (n as u32, self.bounds[n].error_mm[level as usize])
        })
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        self.patches.vertex_bytes().len()
            + size_of_val(&self.forest.nodes[..])
            + size_of_val(&self.bounds[..])
            + self.tree.nodes.len() * size_of::<crate::lod::octree::OctreeNode>()
    }
}

/// The least level of a base face that is near enough to the original, or has as many triangles.
fn enough(shape: &PatchShape, bounds: &PatchBounds, vertices: usize, finest_mm: f32) -> u32 {
    let faces = 2 * vertices as u64;
    (0..shape.finest())
        .find(|l| bounds.error_mm[*l as usize] <= finest_mm || shape.triangles(*l) >= faces)
        .unwrap_or(shape.finest())
}

/// Splits the patches that are furthest from the original, in rounds of half the distance, until
/// all are near enough or there are `budget` triangles.
fn grow(
    growth: &mut PatchGrowth,
    finest: &[u32],
    finest_mm: f32,
    budget: u64,
    total: &mut u64,
) -> Result<(), VdsError> {
    let shape = growth.sampler.shape();
    let (most, patch_faces) = (shape.finest(), shape.triangles(shape.finest()));
    let can_grow = |id: u32| finest.get(id as usize).is_none_or(|l| *l == most);
    let ids = |g: &PatchGrowth| 0..g.forest.nodes.len() as u32;
    let mut limit = ids(growth).map(|n| growth.error_mm(n)).fold(0.0, f32::max);
    loop {
        limit = f32::max(0.5 * limit, finest_mm);
        let mut worst: Vec<u32> = ids(growth)
            .filter(|n| can_grow(*n) && growth.forest.can_split(*n) && growth.error_mm(*n) > limit)
            .collect();
        if worst.is_empty() && (limit <= finest_mm || limit < f32::MIN_POSITIVE) {
            return Ok(());
        }
        let key = |g: &PatchGrowth, n: u32| (std::cmp::Reverse(g.error_mm(n).to_bits()), n);
        worst.sort_unstable_by_key(|n| key(growth, *n));
        for id in worst {
            let room = growth.forest.nodes.len() + 4 * 16 <= MAX_PATCHES;
            if *total + 3 * patch_faces > budget || !room {
                return growth.measure();
            }
            if growth.forest.can_split(id) {
                *total += 3 * patch_faces * growth.split(id);
            }
        }
        growth.measure()?;
    }
}

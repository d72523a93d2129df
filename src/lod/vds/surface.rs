//! Surface prepared for view-dependent subdivision: samples, octree, distance bounds.

use glam::Vec3;
use rayon::prelude::*;

use super::base_mesh::BaseMesh;
use super::level_bounds;
use super::original::Original;
use super::samples::{SurfaceSamples, count, triangles};
use crate::geometry::{Cone, Mesh, Sphere};
use crate::lod::octree::{Item, Octree, bounding_cone};

/// Most levels: 4^6 triangles for one of the base.
const MAX_DEPTH: u32 = 6;
/// Most samples: 5 GiB.
const MAX_SAMPLES: usize = 1 << 28;

/// Options of the subdivision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VdsOptions {
    /// Most base triangles of an octree leaf (1 ..= 128). A leaf is refined as a whole, so small
    /// ones follow the view better; 42 at the base level just fill a page.
    pub leaf_faces: u32,
    /// Finest level (1 ..= 6); by default the least with as many triangles as the original.
    pub depth: Option<u32>,
    /// Geomorphing: new vertices move into place in eighths instead of popping; costs uploads
    /// whenever the camera moves.
    pub morph: bool,
}

impl Default for VdsOptions {
    fn default() -> Self {
        Self { leaf_faces: 42, depth: None, morph: true }
    }
}

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
    /// An option outside its range.
    #[error("{name} is {value}, must be {lowest} to {highest}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Value given.
        value: u32,
        /// Least value allowed.
        lowest: u32,
        /// Largest value allowed.
        highest: u32,
    },
    /// More samples than memory is planned for.
    #[error("{samples} samples at level {depth}, at most {MAX_SAMPLES} can be kept")]
    TooLarge {
        /// Number of samples needed.
        samples: usize,
        /// Finest level.
        depth: u32,
    },
    /// A sample of the original that is not finite.
    #[error("the original has no finite position at sample {sample} of {samples}")]
    NotFinite {
        /// Index of the sample.
        sample: usize,
        /// Number of samples.
        samples: usize,
    },
}

/// A leaf of the octree: the unit of selection, refinement and drawing.
#[derive(Clone, Debug)]
pub(super) struct Leaf {
    /// Base faces, ascending.
    pub faces: Vec<u32>,
    /// Bounding sphere of the surface at every level, and of the original.
    pub sphere: Sphere,
    /// Cone that contains the normals of every level.
    pub cone: Cone,
    /// Two-sided distance bound of each level to the original, mm; never grows.
    pub error_mm: Vec<f32>,
}

/// A base mesh, samples of the original at every vertex of its finest level, and the distance bound
/// of every level.
#[derive(Clone, Debug)]
pub struct SubdivisionSurface {
    pub(super) base: BaseMesh,
    pub(super) samples: SurfaceSamples,
    pub(super) tree: Octree,
    /// Leaves, in the order of [`Octree::traverse`].
    pub(super) leaves: Vec<Leaf>,
    /// Leaf of each base face.
    pub(super) leaf_of: Vec<u32>,
    /// Leaf of each octree node that is one.
    pub(super) leaf_at: Vec<u32>,
    /// Largest error of the base level in each node, mm.
    pub(super) node_error_mm: Vec<f32>,
    pub(super) options: VdsOptions,
}

impl SubdivisionSurface {
    /// Samples `original` at every vertex of the finest level of `base` and measures every level.
    /// Positions of `base` are not used: its vertices are samples too.
    ///
    /// # Errors
    /// See [`VdsError`].
    pub fn new(
        base: &Mesh,
        original: &dyn Original,
        options: VdsOptions,
    ) -> Result<Self, VdsError> {
        let vertices = base.positions.len();
        if base.faces.is_empty() {
            return Err(VdsError::Empty);
        }
        for (face, f) in base.faces.iter().enumerate() {
            if let Some(&vertex) = f.iter().find(|v| **v as usize >= vertices) {
                return Err(VdsError::NoVertex { face, vertex, vertices });
            }
        }
        let range = |name, value, lowest, highest| {
            let fits = (lowest..=highest).contains(&value);
            fits.then_some(value).ok_or(VdsError::Option { name, value, lowest, highest })
        };
        range("leaf_faces", options.leaf_faces, 1, 128)?;
        let enough = |l: &u32| (base.faces.len() as u64) << (2 * l) >= original.faces();
        let depth = match options.depth {
            Some(depth) => range("depth", depth, 1, MAX_DEPTH)?,
            None => (1..MAX_DEPTH).find(enough).unwrap_or(MAX_DEPTH),
        };
        let base = BaseMesh::new(base.faces.clone(), vertices);
        let wanted = count(&base, depth);
        if wanted > MAX_SAMPLES {
            return Err(VdsError::TooLarge { samples: wanted, depth });
        }
        let samples = SurfaceSamples::take(&base, depth, original);
        let lost = |v: &crate::geometry::Vertex| !v.position().is_finite();
        if let Some(sample) = samples.all().iter().position(lost) {
            return Err(VdsError::NotFinite { sample, samples: samples.all().len() });
        }
        let errors = level_bounds::bounds(&base, &samples, original);
        Ok(Self::grown(base, samples, &errors, options))
    }

    fn grown(
        base: BaseMesh,
        samples: SurfaceSamples,
        errors: &[Vec<f32>],
        options: VdsOptions,
    ) -> Self {
        let item = |f: u32| face_item(&base, &samples, f);
        let items: Vec<Item> = (0..base.faces.len() as u32).into_par_iter().map(item).collect();
        let tree = Octree::with_leaves(&items, options.leaf_faces as usize);
        let mut leaves = Vec::new();
        let mut leaf_of = vec![0; base.faces.len()];
        let mut leaf_at = vec![u32::MAX; tree.nodes.len()];
        let mut node_error_mm = vec![0.0; tree.nodes.len()];
        tree.traverse(
            |_| true,
            |at, node| {
                let mut faces = tree.items_of(at).to_vec();
                faces.sort_unstable();
                let mut error_mm = vec![0.0f32; samples.depth() as usize + 1];
                for &f in &faces {
                    leaf_of[f as usize] = leaves.len() as u32;
                    let own = &errors[f as usize];
                    error_mm.iter_mut().zip(own).for_each(|(e, own)| *e = e.max(*own));
                }
                leaf_at[at] = leaves.len() as u32;
                node_error_mm[at] = error_mm[0];
                // The original is no further from the finest samples than that.
                let off = error_mm[samples.depth() as usize];
                let centre = node.sphere.centre;
                let reach = faces.iter().map(|f| reach(&base, &samples, *f, centre));
                let radius = reach.fold(0.0, f32::max) * (1.0 + 1e-6) + off;
                let sphere = Sphere { centre, radius };
                leaves.push(Leaf { faces, sphere, cone: node.cone, error_mm });
            },
        );
        for at in (0..tree.nodes.len()).rev() {
            for child in tree.children(at) {
                node_error_mm[at] = f32::max(node_error_mm[at], node_error_mm[child]);
            }
        }
        Self { base, samples, tree, leaves, leaf_of, leaf_at, node_error_mm, options }
    }

    /// Finest level L.
    pub fn depth(&self) -> u32 {
        self.samples.depth()
    }

    /// Faces of the base mesh.
    pub fn base_faces(&self) -> u64 {
        self.base.faces.len() as u64
    }

    /// Leaves of the octree.
    pub fn leaves(&self) -> usize {
        self.leaves.len()
    }

    /// Two-sided distance bound of level `level` to the original, mm.
    pub fn error_mm(&self, level: u32) -> f32 {
        let level = level.min(self.depth()) as usize;
        self.leaves.iter().map(|l| l.error_mm[level]).fold(0.0, f32::max)
    }

    /// Distance bound of the finest level, mm; the paper assumes 0.
    pub fn finest_error_mm(&self) -> f32 {
        self.error_mm(self.depth())
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        let base = &self.base;
        size_of_val(self.samples.all())
            + size_of_val(&base.edges[..])
            + size_of_val(&base.faces[..])
            + size_of_val(&base.face_edges[..])
            + size_of_val(&self.leaf_of[..])
            + self.tree.nodes.len() * size_of::<crate::lod::octree::OctreeNode>()
            + self.leaves.len() * (size_of::<Leaf>() + 4 * self.depth() as usize + 4)
    }
}

/// Largest distance of a face's samples from a point.
fn reach(base: &BaseMesh, samples: &SurfaceSamples, f: u32, from: Vec3) -> f32 {
    let n = 1u32 << samples.depth();
    let grid = (0..=n).flat_map(|i| (0..=n - i).map(move |j| [i, j, n - i - j]));
    grid.map(|g| samples.position(base, f, g).distance(from)).fold(0.0, f32::max)
}

/// Bounding box of a face at all its levels, and cone of its triangles at all its levels. Triangles
/// of templates and geomorphs have their corners between these samples; their normals are not
/// included.
fn face_item(base: &BaseMesh, samples: &SurfaceSamples, f: u32) -> Item {
    let depth = samples.depth();
    let n = 1u32 << depth;
    let mut cones = Vec::new();
    let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let mut centre = Vec3::ZERO;
    for level in 0..=depth {
        let step = n >> level;
        for t in triangles(1 << level) {
            let p = t.map(|g| samples.position(base, f, g.map(|c| c * step)));
            let item = Item::triangle(p);
            (lo, hi) = (lo.min(item.lo), hi.max(item.hi));
            if level == 0 {
                centre = item.centre;
            }
            // Degenerate triangles have no normal and are not visible.
            if item.cone.sine < 1.0 {
                cones.push(item.cone);
            }
        }
    }
    Item { lo, hi, centre, cone: bounding_cone(cones.iter().copied()) }
}

//! Analytic phantoms with exact reference data.
//!
//! A phantom is an implicit function of a point, negative in the lumen. It is defined in a box of
//! side one and scaled to the grid, so that the same organ appears at any size. Nothing of it
//! touches the border of the grid.

mod colon;
mod ellipse;
mod helix;
mod path;
mod raster;
mod shape;
mod tree;

use std::str::FromStr;

use glam::{DMat3, DVec3};

use super::{Grid, GridError};
use shape::Shape;

/// Organs that phantoms imitate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Straight oblique tube with round ends. Exact distance.
    Tube,
    /// Straight oblique tube, section an ellipse with semi-axes 1.5 : 1. Exact distance.
    Ellipse,
    /// Tube along an S of lines and arcs. Exact distance.
    Bend,
    /// Tube along two and a half turns of a helix. Exact distance.
    Helix,
    /// Tilted ring: a lumen without ends, genus one. Exact distance.
    Torus,
    /// Two generations of branching: seven straight segments. Exact distance outside; inside, a
    /// lower bound of the depth near the junctions.
    Y,
    /// Long winding tube of varying calibre with haustral folds. A radial function, not a distance:
    /// steeper than one at the folds.
    Colon,
    /// Bent tube with a ball-shaped sac at its side. Exact distance outside; inside, a lower bound
    /// of the depth near the neck.
    Aneurysm,
}

impl Kind {
    /// All kinds, in the order of the command line's help.
    pub const ALL: [Self; 8] = [
        Self::Tube,
        Self::Ellipse,
        Self::Bend,
        Self::Helix,
        Self::Torus,
        Self::Y,
        Self::Colon,
        Self::Aneurysm,
    ];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tube => "tube",
            Self::Ellipse => "ellipse",
            Self::Bend => "bend",
            Self::Helix => "helix",
            Self::Torus => "torus",
            Self::Y => "y",
            Self::Colon => "colon",
            Self::Aneurysm => "aneurysm",
        }
    }
}

/// No phantom has this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no phantom is called `{0}`; there are tube, ellipse, bend, helix, torus, y, colon, aneurysm"
)]
pub struct UnknownKind(pub String);

impl FromStr for Kind {
    type Err = UnknownKind;
    fn from_str(s: &str) -> Result<Self, UnknownKind> {
        Self::ALL.into_iter().find(|k| k.name() == s).ok_or_else(|| UnknownKind(s.to_owned()))
    }
}

/// One branch of the true axis.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthBranch {
    /// Name of the branch (`trunk`, `left`, …).
    pub name: &'static str,
    /// Index of the branch on which the first point lies, `None` for the root.
    pub parent: Option<usize>,
    /// Whether the last point repeats the first.
    pub closed: bool,
    /// Points of the axis: x, y, z (LPS) and radius of the largest ball about that point within the
    /// lumen; all mm.
    pub points: Vec<[f64; 4]>,
}

/// Exact centerline of a phantom.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Branches, parents before children.
    pub branches: Vec<TruthBranch>,
    /// First point of the axis, LPS mm. The lumen extends one radius beyond it.
    pub start: DVec3,
    /// Last points of the axis, LPS mm; for the ring, the point opposite to the start.
    pub ends: Vec<DVec3>,
}

/// An analytic organ on a grid.
#[derive(Clone, Debug)]
pub struct Phantom {
    kind: Kind,
    grid: Grid,
    shape: Shape,
    /// Position of the unit box's centre, LPS mm.
    centre_mm: DVec3,
    /// Side of the unit box, mm.
    side_mm: f64,
}

impl Phantom {
    /// Creates the organ in a box that is a cube in millimetres: `size` voxels along the axis with
    /// the coarsest spacing and, along the others, as many as make them equally long. The first
    /// voxel's centre is the origin, axes are LPS.
    ///
    /// The organ sits 0.3, 0.2 and 0.1 voxels off the centre so that no voxel centre is special.
    /// Every kind is one 6-connected piece from 32 voxels on; below, thin branches may fall apart.
    ///
    /// # Errors
    /// [`GridError`] for spacings that are not positive and for boxes too large.
    pub fn new(kind: Kind, size: u32, spacing_mm: [f64; 3]) -> Result<Self, GridError> {
        let coarsest = spacing_mm.iter().copied().fold(0.0, f64::max);
        let dims = spacing_mm.map(|s| {
            // Unusable spacings come out as zero, infinity or NaN here; `Grid::new` names them.
            let n = f64::from(size) * coarsest / s;
            if n.is_finite() { ((n - 1e-9).ceil() as u64).max(u64::from(size)) } else { 1 }
        });
        let spacing = DVec3::from(spacing_mm);
        let grid = Grid::new(dims, spacing, DVec3::ZERO, DMat3::IDENTITY)?;
        let extent = (grid.dims.as_dvec3() - 1.0) * spacing;
        let centre_mm = 0.5 * extent + DVec3::new(0.3, 0.2, 0.1) * spacing;
        let side_mm = extent.min_element().max(1e-3 * coarsest);
        Ok(Self { kind, grid, shape: Shape::new(kind), centre_mm, side_mm })
    }

    /// Returns the kind of organ.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the grid the organ is sampled on.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Whether [`Phantom::field`] is the exact signed distance everywhere.
    pub fn is_exact(&self) -> bool {
        !matches!(self.kind, Kind::Y | Kind::Colon | Kind::Aneurysm)
    }

    /// Returns the implicit function at a point (LPS mm), in mm: negative in the lumen. [`Kind`]
    /// says for which organs it is the signed distance.
    pub fn field(&self, p_mm: DVec3) -> f64 {
        self.side_mm * self.shape.field(self.to_unit(p_mm))
    }

    /// Returns the unit normal of the level set through a point (LPS mm), pointing into the lumen:
    /// against the gradient of the field. On the axis, where the gradient vanishes, it is some unit
    /// vector.
    pub fn normal(&self, p_mm: DVec3) -> DVec3 {
        (-self.shape.gradient(self.to_unit(p_mm))).normalize_or(DVec3::Z)
    }

    /// Returns the signed distance to the wall, mm, to first order: exact where the field is, and
    /// elsewhere the field over its slope, which is right near the wall.
    pub fn distance(&self, p_mm: DVec3) -> f64 {
        let f = self.field(p_mm);
        if self.kind != Kind::Colon {
            return f;
        }
        f / self.shape.gradient(self.to_unit(p_mm)).length().max(0.1)
    }

    /// Returns the volume of the lumen, mm³, where a formula gives it (all but `y`, `colon`,
    /// `aneurysm`).
    pub fn volume_mm3(&self) -> Option<f64> {
        self.shape.volume().map(|v| v * self.side_mm.powi(3))
    }

    /// Returns the exact centerline.
    pub fn truth(&self) -> Truth {
        let place = |q: DVec3| self.centre_mm + self.side_mm * q;
        let mut branches = self.shape.axis();
        for p in branches.iter_mut().flat_map(|b| &mut b.points) {
            let q = place(DVec3::new(p[0], p[1], p[2]));
            *p = [q.x, q.y, q.z, p[3] * self.side_mm];
        }
        let at = |p: &[f64; 4]| DVec3::new(p[0], p[1], p[2]);
        let start = at(&branches[0].points[0]);
        let is_leaf = |i: usize| !branches.iter().any(|b| b.parent == Some(i));
        let tip = |b: &TruthBranch| {
            let last = b.points.len() - 1;
            at(&b.points[if b.closed { last / 2 } else { last }])
        };
        let ends = (0..branches.len()).filter(|&i| is_leaf(i)).map(|i| tip(&branches[i])).collect();
        Truth { branches, start, ends }
    }

    fn to_unit(&self, p_mm: DVec3) -> DVec3 {
        (p_mm - self.centre_mm) / self.side_mm
    }
}

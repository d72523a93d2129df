//! Regular grid in patient space.

use glam::{DAffine3, DMat3, DVec3, IVec3, UVec3};

use super::AxisOrder;

/// Errors of a grid's geometry. Readers wrap this with the file and the field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridError {
    /// A dimension is zero or the voxel count does not fit.
    #[error("dimensions {0:?} hold no voxels or too many")]
    Dims([u64; 3]),
    /// Spacing is not a positive finite length.
    #[error("spacing {0:?} mm is not positive and finite")]
    Spacing([f64; 3]),
    /// Origin is not finite.
    #[error("origin {0:?} mm is not finite")]
    Origin([f64; 3]),
    /// Axes are not finite, or nearly coplanar.
    #[error("axis directions {0:?} do not span space")]
    Direction([f64; 9]),
}

/// A regular grid of voxel centres in patient space.
///
/// LPS millimetres: +x to the patient's left, +y to the back, +z to the head. Axes may be oblique
/// or left-handed; they are unit vectors but not necessarily orthogonal, as in some files: code
/// that needs orthogonal axes calls [`Grid::is_orthogonal`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Number of voxels along i, j, k; i is fastest in memory.
    pub dims: UVec3,
    /// Distance between voxel centres along each axis, mm, positive.
    pub spacing_mm: DVec3,
    /// Centre of voxel (0, 0, 0), LPS mm.
    pub origin_mm: DVec3,
    /// Unit direction of each index axis, as columns.
    pub direction: DMat3,
    /// Order of the axes in the file; another than the identity after [`Grid::canonical`].
    pub order: AxisOrder,
}

impl Grid {
    /// Creates a grid with checks; columns of `direction` are normalised.
    ///
    /// # Errors
    /// [`GridError`] names the part that is unusable.
    pub fn new(
        dims: [u64; 3],
        spacing_mm: DVec3,
        origin_mm: DVec3,
        direction: DMat3,
    ) -> Result<Self, GridError> {
        let count = dims.iter().try_fold(1u64, |n, &d| n.checked_mul(d));
        let fits = dims.iter().all(|&d| d > 0 && d <= Self::MAX_SIDE);
        if !fits || count.is_none_or(|n| n > Self::MAX_VOXELS) {
            return Err(GridError::Dims(dims));
        }
        if !(spacing_mm.is_finite() && spacing_mm.min_element() > 0.0) {
            return Err(GridError::Spacing(spacing_mm.to_array()));
        }
        if !origin_mm.is_finite() {
            return Err(GridError::Origin(origin_mm.to_array()));
        }
        let unit = DMat3::from_cols(
            direction.x_axis.normalize_or_zero(),
            direction.y_axis.normalize_or_zero(),
            direction.z_axis.normalize_or_zero(),
        );
        if !unit.is_finite() || unit.determinant().abs() < 1e-3 {
            return Err(GridError::Direction(direction.to_cols_array()));
        }
        let dims = UVec3::new(dims[0] as u32, dims[1] as u32, dims[2] as u32);
        let order = AxisOrder::IDENTITY;
        Ok(Self { dims, spacing_mm, origin_mm, direction: unit, order })
    }

    /// Largest number of voxels along an axis: run ends and brick coordinates are kept in 16 bits
    /// with room for a rim.
    pub const MAX_SIDE: u64 = 32_000;
    /// Largest number of voxels: linear indices are `usize`, but 2^36 u8 voxels is already 64 GiB.
    pub const MAX_VOXELS: u64 = 1 << 36;

    /// Creates an axis-aligned grid at the origin.
    ///
    /// # Panics
    /// On invalid numbers; for phantoms and tests, whose numbers are ours.
    pub fn axis_aligned(dims: [u32; 3], spacing_mm: [f64; 3]) -> Self {
        Self::new(dims.map(u64::from), DVec3::from(spacing_mm), DVec3::ZERO, DMat3::IDENTITY)
            .expect("own numbers")
    }

    /// Returns the number of voxels.
    pub fn len(&self) -> usize {
        self.dims.x as usize * self.dims.y as usize * self.dims.z as usize
    }

    /// Whether the grid has no voxel: never true for one made by [`Grid::new`].
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the linear index of a voxel inside the grid.
    #[inline]
    pub fn index(&self, v: UVec3) -> usize {
        v.x as usize + self.dims.x as usize * (v.y as usize + self.dims.y as usize * v.z as usize)
    }

    /// Returns the voxel of a linear index.
    #[inline]
    pub fn voxel(&self, i: usize) -> UVec3 {
        let (nx, ny) = (self.dims.x as usize, self.dims.y as usize);
        UVec3::new((i % nx) as u32, (i / nx % ny) as u32, (i / nx / ny) as u32)
    }

    /// Whether a (possibly negative) voxel lies in the grid.
    #[inline]
    pub fn contains(&self, v: IVec3) -> bool {
        v.cmpge(IVec3::ZERO).all() && v.cmplt(self.dims.as_ivec3()).all()
    }

    /// Returns the transform from continuous voxel coordinates to LPS mm.
    pub fn world_from_voxel(&self) -> DAffine3 {
        let s = self.spacing_mm;
        let d = self.direction;
        let m = DMat3::from_cols(d.x_axis * s.x, d.y_axis * s.y, d.z_axis * s.z);
        DAffine3::from_mat3_translation(m, self.origin_mm)
    }

    /// Returns the transform from LPS mm to continuous voxel coordinates.
    pub fn voxel_from_world(&self) -> DAffine3 {
        self.world_from_voxel().inverse()
    }

    /// Returns the voxel whose centre is nearest to a world point, if the point lies in the grid.
    pub fn nearest_voxel(&self, p_mm: DVec3) -> Option<UVec3> {
        let v = self.voxel_from_world().transform_point3(p_mm);
        if !v.is_finite() || v.abs().max_element() > 1e9 {
            return None;
        }
        let v = v.round().as_ivec3();
        self.contains(v).then(|| v.as_uvec3())
    }

    /// Whether the axes are orthogonal to within 0.1 degree.
    pub fn is_orthogonal(&self) -> bool {
        self.largest_cosine() < 1.75e-3
    }

    /// Returns the largest deviation of an angle between two axes from a right angle, radians.
    pub fn shear_rad(&self) -> f64 {
        self.largest_cosine().min(1.0).asin()
    }

    /// Returns the largest absolute cosine of an angle between two axes.
    fn largest_cosine(&self) -> f64 {
        let d = self.direction;
        [d.x_axis.dot(d.y_axis), d.y_axis.dot(d.z_axis), d.z_axis.dot(d.x_axis)]
            .iter()
            .fold(0.0, |most, c| c.abs().max(most))
    }

    /// Whether index space is mirrored against patient space.
    pub fn is_left_handed(&self) -> bool {
        self.direction.determinant() < 0.0
    }

    /// Returns the volume of one voxel, mm³.
    pub fn voxel_mm3(&self) -> f64 {
        self.spacing_mm.element_product() * self.direction.determinant().abs()
    }

    /// Returns the length of a voxel's diagonal, mm.
    pub fn diagonal_mm(&self) -> f64 {
        self.spacing_mm.length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn world_and_voxel_are_inverse_on_an_oblique_left_handed_grid() {
        let d = DMat3::from_cols(
            DVec3::new(-0.8, 0.6, 0.0),
            DVec3::new(0.6, 0.8, 0.0),
            DVec3::new(0.0, 0.0, 1.0),
        );
        let g =
            Grid::new([5, 6, 7], DVec3::new(0.7, 0.8, 2.5), DVec3::new(-3.0, 4.0, 9.0), d).unwrap();
        assert!(g.is_left_handed() && g.is_orthogonal());
        let v = DVec3::new(1.25, 2.6, 3.75);
        let w = g.world_from_voxel().transform_point3(v);
        assert!((g.voxel_from_world().transform_point3(w) - v).length() < 1e-12);
        assert_eq!(g.nearest_voxel(w), Some(UVec3::new(1, 3, 4)));
        assert_eq!(g.voxel(g.index(UVec3::new(4, 2, 6))), UVec3::new(4, 2, 6));
    }

    #[test]
    fn unusable_numbers_are_named() {
        let ok = (DVec3::ONE, DVec3::ZERO, DMat3::IDENTITY);
        let e = |d, s, o, m| Grid::new(d, s, o, m).unwrap_err();
        assert!(matches!(e([0, 1, 1], ok.0, ok.1, ok.2), GridError::Dims(_)));
        assert!(matches!(e([1 << 40, 1 << 40, 1], ok.0, ok.1, ok.2), GridError::Dims(_)));
        let nan = DVec3::new(f64::NAN, 1.0, 1.0);
        assert!(matches!(e([1; 3], nan, ok.1, ok.2), GridError::Spacing(_)));
        assert!(matches!(e([1; 3], DVec3::ZERO, ok.1, ok.2), GridError::Spacing(_)));
        assert!(matches!(e([1; 3], ok.0, nan, ok.2), GridError::Origin(_)));
        assert!(matches!(e([1; 3], ok.0, ok.1, DMat3::ZERO), GridError::Direction(_)));
    }
}

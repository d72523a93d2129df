//! Order and direction of a grid's axes: the canonical one, nearest to LPS, and that of a file.

use glam::{DMat3, DVec3, IVec3, UVec3};
use rayon::prelude::*;

use super::{Grid, SampleBuffer, Samples, Volume, with_samples};

/// Order and direction in which a file stores the axes of a canonical grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisOrder {
    /// Stored axis of each canonical axis.
    axes: [usize; 3],
    /// Whether the stored axis runs against the canonical one.
    reversed: [bool; 3],
}

/// All orders of three axes; of equally near ones the first is taken.
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
/// Sum of cosines by which another order must be nearer to LPS than one before it: an oblique grid
/// halfway between two orders does not turn with the last bit of its direction.
const NEARER: f64 = 1e-3;

impl AxisOrder {
    /// Axes as they were stored.
    pub const IDENTITY: Self = Self { axes: [0, 1, 2], reversed: [false; 3] };

    /// Returns the order in which the axes of a grid lie nearest to left, posterior and superior.
    ///
    /// * `direction`: unit direction of each stored axis, as columns.
    pub fn nearest_to_lps(direction: &DMat3) -> Self {
        let along = |stored: usize, world: usize| direction.col(stored)[world];
        let nearness =
            |order: &[usize; 3]| -> f64 { (0..3).map(|k| along(order[k], k).abs()).sum() };
        let nearer = |best: [usize; 3], next: &[usize; 3]| {
            if nearness(next) > nearness(&best) + NEARER { *next } else { best }
        };
        let axes = ORDERS.iter().fold(ORDERS[0], nearer);
        Self { axes, reversed: [0, 1, 2].map(|k| along(axes[k], k) < 0.0) }
    }

    /// Whether voxels lie as they were stored.
    pub fn is_identity(&self) -> bool {
        *self == Self::IDENTITY
    }

    /// Returns a vector of stored axes along the canonical ones, without regard to direction.
    pub fn canonical<T: Copy>(&self, stored: [T; 3]) -> [T; 3] {
        self.axes.map(|axis| stored[axis])
    }

    /// Returns a vector of canonical axes along the stored ones, without regard to direction.
    pub fn stored<T: Copy + Default>(&self, canonical: [T; 3]) -> [T; 3] {
        let mut out = [T::default(); 3];
        for (k, axis) in self.axes.into_iter().enumerate() {
            out[axis] = canonical[k];
        }
        out
    }

    /// Returns the stored voxel of a canonical one.
    ///
    /// * `dims`: size of the canonical grid.
    pub fn stored_voxel(&self, dims: UVec3, canonical: IVec3) -> IVec3 {
        let last = dims.as_ivec3() - 1;
        self.stored([0, 1, 2].map(|k| match self.reversed[k] {
            true => last[k] - canonical[k],
            false => canonical[k],
        }))
        .into()
    }

    /// Returns the canonical voxel of a stored one.
    ///
    /// * `dims`: size of the canonical grid.
    pub fn canonical_voxel(&self, dims: UVec3, stored: IVec3) -> IVec3 {
        let last = dims.as_ivec3() - 1;
        let turned: [i32; 3] = self.canonical(stored.to_array());
        let along = |k: usize| if self.reversed[k] { last[k] - turned[k] } else { turned[k] };
        [0, 1, 2].map(along).into()
    }
}

impl Grid {
    /// Returns the same voxels with the axes nearest to left, posterior and superior.
    /// [`Grid::as_stored`] leads back.
    #[must_use]
    pub fn canonical(&self) -> Self {
        let stored = self.as_stored();
        let order = AxisOrder::nearest_to_lps(&stored.direction);
        // Adding 0 turns -0 into 0: both are equal, but their bytes are not.
        let column = |k: usize| {
            let axis = stored.direction.col(order.axes[k]);
            (if order.reversed[k] { -axis } else { axis }) + DVec3::ZERO
        };
        let dims = UVec3::from(order.canonical(stored.dims.to_array()));
        let first = order.stored_voxel(dims, IVec3::ZERO);
        Self {
            dims,
            spacing_mm: order.canonical(stored.spacing_mm.to_array()).into(),
            origin_mm: stored.world_from_voxel().transform_point3(first.as_dvec3()) + DVec3::ZERO,
            direction: DMat3::from_cols(column(0), column(1), column(2)),
            order,
        }
    }

    /// Returns the grid with the axes as the file has them.
    #[must_use]
    pub fn as_stored(&self) -> Self {
        let order = self.order;
        if order.is_identity() {
            return *self;
        }
        let mut direction = DMat3::ZERO;
        for k in 0..3 {
            let axis = self.direction.col(k);
            *direction.col_mut(order.axes[k]) = if order.reversed[k] { -axis } else { axis };
        }
        let last = (self.dims - 1).as_dvec3();
        let first =
            DVec3::from_array([0, 1, 2].map(|k| if order.reversed[k] { last[k] } else { 0.0 }));
        Self {
            dims: order.stored(self.dims.to_array()).into(),
            spacing_mm: order.stored(self.spacing_mm.to_array()).into(),
            origin_mm: self.world_from_voxel().transform_point3(first),
            direction,
            order: AxisOrder::IDENTITY,
        }
    }

    /// Returns the voxel of the file that a voxel of this grid is.
    pub fn stored_voxel(&self, v: IVec3) -> IVec3 {
        self.order.stored_voxel(self.dims, v)
    }

    /// Returns the voxel of this grid that a voxel of the file is.
    pub fn canonical_voxel(&self, stored: IVec3) -> IVec3 {
        self.order.canonical_voxel(self.dims, stored)
    }
}

impl Volume {
    /// Returns the same volume with the axes nearest to left, posterior and superior. Samples that
    /// only lie in reverse are turned where they are; another order of axes takes a copy.
    #[must_use]
    pub fn canonical(mut self) -> Self {
        let grid = self.grid.canonical();
        let order = grid.order;
        if order.is_identity() || !self.grid.order.is_identity() {
            return self;
        }
        self.samples = canonical_samples(self.samples, grid.dims, order);
        self.grid = grid;
        self
    }
}

/// Samples in canonical order.
///
/// * `dims`: size of the canonical grid.
pub fn canonical_samples(samples: Samples, dims: UVec3, order: AxisOrder) -> Samples {
    if order.is_identity() {
        return samples;
    }
    fn turned<T: Copy + Default + Send + Sync>(
        samples: SampleBuffer<T>,
        dims: UVec3,
        order: AxisOrder,
    ) -> SampleBuffer<T> {
        match samples {
            SampleBuffer::Owned(mut own) if order.axes == AxisOrder::IDENTITY.axes => {
                reverse(&mut own, dims, order.reversed);
                own.into()
            }
            other => reordered(&other, dims, order).into(),
        }
    }
    with_samples!(samples, |s| turned(s, dims, order).into())
}

/// Reverses samples along axes.
fn reverse<T: Send>(samples: &mut [T], dims: UVec3, [x, y, z]: [bool; 3]) {
    let [width, height, depth] = dims.to_array().map(|n| n as usize);
    if x || y {
        samples.par_chunks_exact_mut(width * height).for_each(|slice| {
            if y {
                // All of a slice in reverse turns both of its axes.
                slice.reverse();
            }
            if x != y {
                slice.chunks_exact_mut(width).for_each(<[T]>::reverse);
            }
        });
    }
    if z {
        let slice = width * height;
        let (low, high) = samples.split_at_mut(depth / 2 * slice);
        let from = high.len() - low.len();
        let (low, high) =
            (low.par_chunks_exact_mut(slice), high[from..].par_chunks_exact_mut(slice));
        low.zip(high.rev()).for_each(|(a, b)| a.swap_with_slice(b));
    }
}

/// Copies samples into canonical order.
fn reordered<T: Copy + Default + Send + Sync>(from: &[T], dims: UVec3, order: AxisOrder) -> Vec<T> {
    /// Side of the blocks that are copied at a time: what they read lies together whichever axis the
    /// file stores fastest.
    const BLOCK: usize = 16;
    let stored = UVec3::from(order.stored(dims.to_array())).as_usizevec3();
    let strides = [1, stored.x, stored.x * stored.y].map(|stride| stride as isize);
    let first = order.stored_voxel(dims, IVec3::ZERO);
    let start: isize = (0..3).map(|k| first[k] as isize * strides[k]).sum();
    let step = [0, 1, 2].map(|k| {
        let stride = strides[order.axes[k]];
        if order.reversed[k] { -stride } else { stride }
    });
    let [width, height, depth] = dims.to_array().map(|n| n as usize);
    let mut out = vec![T::default(); from.len()];
    out.par_chunks_mut(BLOCK * width * height).enumerate().for_each(|(block, out)| {
        let z0 = block * BLOCK;
        for y0 in (0..height).step_by(BLOCK) {
            for x0 in (0..width).step_by(BLOCK) {
                for z in z0..(z0 + BLOCK).min(depth) {
                    for y in y0..(y0 + BLOCK).min(height) {
                        let row = start + z as isize * step[2] + y as isize * step[1];
                        let to = width * (y + height * (z - z0));
                        for x in x0..(x0 + BLOCK).min(width) {
                            out[to + x] = from[(row + x as isize * step[0]) as usize];
                        }
                    }
                }
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every order and direction of axes, oblique by a few degrees.
    fn directions() -> impl Iterator<Item = DMat3> {
        let tilt = DMat3::from_rotation_x(0.2) * DMat3::from_rotation_z(-0.3);
        ORDERS.into_iter().flat_map(move |order| {
            (0..8u32).map(move |signs| {
                let column = |k: usize| {
                    let sign = if signs >> k & 1 != 0 { -1.0 } else { 1.0 };
                    sign * tilt.col(order[k])
                };
                DMat3::from_cols(column(0), column(1), column(2))
            })
        })
    }

    #[test]
    fn a_canonical_volume_has_each_value_where_the_stored_one_has_it() {
        for direction in directions() {
            let (spacing, origin) = (DVec3::new(0.7, 1.0, 2.5), DVec3::new(-9.0, 4.0, 30.0));
            let grid = Grid::new([19, 7, 18], spacing, origin, direction).unwrap();
            let stored = Volume::new(grid, (0..grid.len() as u32).collect::<Vec<_>>().into());
            let canonical = stored.clone().canonical();
            let c = &canonical.grid;
            for k in 0..3 {
                assert!(c.direction.col(k)[k] > 0.9, "{direction:?}");
            }
            for i in 0..grid.len() {
                let at = grid.world_from_voxel().transform_point3(grid.voxel(i).as_dvec3());
                let v = c.nearest_voxel(at).unwrap();
                assert_eq!(canonical.samples.get(c.index(v)), stored.samples.get(i));
                assert_eq!(c.stored_voxel(v.as_ivec3()), grid.voxel(i).as_ivec3());
                assert_eq!(c.canonical_voxel(grid.voxel(i).as_ivec3()), v.as_ivec3());
                let back = c.world_from_voxel().transform_point3(v.as_dvec3());
                assert!(back.distance(at) < 1e-9);
            }
            let back = c.as_stored();
            assert_eq!(
                (back.dims, back.spacing_mm, back.direction),
                (grid.dims, spacing, direction)
            );
            assert!(back.origin_mm.distance(origin) < 1e-9);
        }
    }

    #[test]
    fn all_orders_of_axes_have_the_same_canonical_grid() {
        let all: Vec<Grid> = directions()
            .map(|direction| {
                // A box of 6 x 8 x 10 voxels of 1 x 2 x 3 mm along the tilted axes.
                let order = AxisOrder::nearest_to_lps(&direction);
                let dims = order.stored([6u64, 8, 10]);
                let spacing = DVec3::from_array(order.stored([1.0, 2.0, 3.0]));
                let grid = Grid::new(dims, spacing, DVec3::ZERO, direction).unwrap();
                let middle = 0.5 * (grid.dims.as_dvec3() - 1.0);
                let at = grid.world_from_voxel().transform_point3(middle);
                Grid { origin_mm: -at, ..grid }.canonical()
            })
            .collect();
        for grid in &all[1..] {
            assert_eq!((grid.dims, grid.spacing_mm), (all[0].dims, all[0].spacing_mm));
            assert_eq!(grid.direction, all[0].direction);
            assert!(grid.origin_mm.distance(all[0].origin_mm) < 1e-9);
        }
    }
}

//! Grids in LPS mm from step vectors in a file's frame.

use std::path::Path;

use glam::{DMat3, DVec3};

use super::FormatError;
use crate::volume::{Grid, GridError};

/// RAS to LPS and back: x and y turn round.
pub(super) const RAS: DVec3 = DVec3::new(-1.0, -1.0, 1.0);

/// Grid from the step of each index axis (as columns) and the centre of the first voxel.
/// `to_lps_mm` scales each component of the file's frame: sign and unit.
pub(super) fn grid_from_steps(
    file: &Path,
    dims: [u64; 3],
    steps: DMat3,
    origin: DVec3,
    to_lps_mm: DVec3,
) -> Result<Grid, FormatError> {
    let col = |v: DVec3| v * to_lps_mm;
    let steps = DMat3::from_cols(col(steps.x_axis), col(steps.y_axis), col(steps.z_axis));
    let spacing = DVec3::new(steps.x_axis.length(), steps.y_axis.length(), steps.z_axis.length());
    grid(file, dims, spacing, origin * to_lps_mm, steps)
}

/// [`Grid::new`] with the file named, -0 tidied away.
pub(super) fn grid(
    file: &Path,
    dims: [u64; 3],
    spacing_mm: DVec3,
    origin_mm: DVec3,
    direction: DMat3,
) -> Result<Grid, FormatError> {
    let wrap = |source: GridError| FormatError::Grid { file: file.to_owned(), source };
    let zero = DVec3::ZERO;
    let plain =
        DMat3::from_cols(direction.x_axis + zero, direction.y_axis + zero, direction.z_axis + zero);
    Grid::new(dims, spacing_mm, origin_mm + zero, plain).map_err(wrap)
}

/// The words of a pure axis direction: letter and phrase of where the index grows to.
pub(super) fn toward(v: DVec3) -> (char, &'static str) {
    let a = v.abs();
    let (value, plus, minus) = if a.x >= a.y && a.x >= a.z {
        (v.x, ('L', "to the left"), ('R', "to the right"))
    } else if a.y >= a.z {
        (v.y, ('P', "to the back"), ('A', "to the front"))
    } else {
        (v.z, ('S', "to the head"), ('I', "to the feet"))
    };
    if value < 0.0 { minus } else { plus }
}

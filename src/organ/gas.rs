//! Gas in the body of a CT, sorted into colon and other gas.

use glam::{DVec3, UVec3};

use super::airway;
use super::body::PatientBody;
use super::colon_order::{SegmentGap, in_order};
use super::depth::Depth;
use super::lungs::{Lungs, lung_of};
use super::numbers::of_colon::gas::*;
pub(super) use super::numbers::of_colon::gas::{GAS_HU, MIN_ML};
use super::rivals::{GasFeatures, GasName, Rival};
use super::values::{MIN_HU, between, share};
use crate::lumen::{BitVolume, Piece, dilated, fill_cavities, pieces};
use crate::volume::{Grid, Volume};

/// The gas in a body.
pub(super) struct Gas {
    /// Segments of the colon, from the one nearest the feet on.
    pub colon: Vec<ColonCandidate>,
    /// Gas that is not colon.
    pub others: BitVolume,
    /// One line for each piece that was left out: its volume and names.
    pub left_out: Vec<String>,
    /// Whether a piece that was left out as stomach may be colon.
    pub is_stomach_doubtful: bool,
}

/// Masks of the volume by kind of value.
struct Kinds {
    gas: BitVolume,
    deep_gas: BitVolume,
    tissue: BitVolume,
}

/// A piece of gas that may be colon.
pub(super) struct ColonCandidate {
    pub mask: BitVolume,
    pub seed: UVec3,
    /// Longest side of its box, mm.
    pub extent_mm: f64,
    pub features: GasFeatures,
    pub name: GasName,
    /// Gap between the previous segment and this one.
    pub gap: Option<SegmentGap>,
}

impl Gas {
    /// Sorts the gas of a volume; `None` if there is none.
    pub fn of(volume: &Volume) -> Option<Self> {
        let grid = &volume.grid;
        let gas = between(volume, MIN_HU, GAS_HU);
        if gas.is_empty() {
            return None;
        }

        // 1. Cut the gas inside the body into pieces. Lung joined to other gas becomes a piece of its own.
        let body =
            PatientBody::of(volume).map_or_else(|| BitVolume::new(grid.dims), |found| found.inside);
        let mut inside = gas.clone();
        inside.keep(&body);
        let mut out = Self {
            colon: Vec::new(),
            others: inside.clone(),
            left_out: Vec::new(),
            is_stomach_doubtful: false,
        };
        let (parts, mut lung_parts) = out.without_lungs(volume, &inside);

        // 2. Measure the values of each piece and name it; its position is not measured yet.
        let airway = airway::find(volume, false).ok();
        let kinds = Kinds {
            deep_gas: between(volume, MIN_HU, DEEP_GAS_HU),
            tissue: between(volume, TISSUE_HU, f64::INFINITY),
            gas,
        };
        let airway_mask = airway.as_ref().map(|airway| &airway.mask);
        let candidate = |piece| ColonCandidate::new(grid, piece, &kinds, airway_mask);
        let mut candidates: Vec<ColonCandidate> = parts.iter().map(candidate).collect();

        // 3. Locate the lungs: those of phase 1, and the pieces named lung.
        for (piece, candidate) in parts.into_iter().zip(&candidates) {
            if candidate.name.best.rival == Rival::Lung {
                lung_parts.push(piece);
            }
        }
        let lungs = Lungs::of(grid, &lung_parts);

        // 4. Measure the position of each piece relative to body and lungs, and name it again.
        let place = BodyPlace::of(grid, &body, lungs);
        for c in &mut candidates {
            place.measure(&c.mask, &mut c.features);
            c.name = GasName::of(&c.features);
        }

        // 5. Keep the pieces named colon; record the others.
        for c in candidates {
            if c.name.best.rival == Rival::Colon && !c.name.is_undecided() {
                out.colon.push(c);
            } else {
                out.is_stomach_doubtful |= c.name.is_near_tie();
                out.leave_out(c.features.volume_ml, &c.name.line());
            }
        }
        out.colon.iter().for_each(|c| out.others.remove(&c.mask));

        // 6. Order the segments along the colon.
        out.colon = in_order(volume, out.colon);
        Some(out)
    }

    /// Separates lung from other gas. Returns the pieces of other gas and those of lung; records the lung
    /// as left out.
    fn without_lungs(&mut self, volume: &Volume, inside: &BitVolume) -> (Vec<Piece>, Vec<Piece>) {
        let ml = volume.grid.voxel_mm3() / 1000.0;
        let least = (MIN_ML / ml).ceil() as u64;
        let (mut parts, mut lungs) = (Vec::new(), Vec::new());
        for piece in pieces(inside, least) {
            let mut mask = piece.mask(volume.grid.dims);
            match lung_of(volume, &mask) {
                None => parts.push(piece),
                Some(lung) => {
                    self.leave_out(lung.count() as f64 * ml, "lung, joined to other gas");
                    mask.remove(&lung);
                    parts.extend(pieces(&mask, least));
                    lungs.extend(pieces(&lung, least));
                }
            }
        }
        (parts, lungs)
    }

    fn leave_out(&mut self, volume_ml: f64, why: &str) {
        self.left_out.push(format!("{volume_ml:.0} ml of gas: {why}"));
    }
}

impl ColonCandidate {
    /// Measures the values and size of a piece, and names it. [`BodyPlace::measure`] adds its position.
    fn new(grid: &Grid, piece: &Piece, kinds: &Kinds, airway: Option<&BitVolume>) -> Self {
        let mask = piece.mask(grid.dims);
        let mut shell = dilated(&mask, DVec3::ONE, 3.0);
        shell.remove(&dilated(&mask, DVec3::ONE, 2.0));
        // Neighbouring gas is a piece of its own, not part of the shell.
        shell.remove(&kinds.gas);
        // Noise leaves specks in the gas.
        let mut filled = mask.clone();
        fill_cavities(&mut filled);
        let (seed, radius_mm) = Depth::of(*grid, &filled).deepest();
        let (lo, hi) = piece.bounds();
        let features = GasFeatures {
            volume_ml: piece.component.volume_ml(grid),
            radius_mm,
            deep: share(&mask, &kinds.deep_gas),
            tissue: share(&shell, &kinds.tissue),
            in_airway: airway.map_or(0.0, |airway| share(&mask, airway)),
            ..GasFeatures::default()
        };
        Self {
            name: GasName::of(&features),
            extent_mm: ((hi - lo).as_dvec3() * grid.spacing_mm).max_element(),
            mask,
            seed,
            features,
            gap: None,
        }
    }
}

/// Extent of the body and lungs, to which positions of pieces relate.
struct BodyPlace<'a> {
    grid: &'a Grid,
    lungs: Option<Lungs>,
    /// Middle between left and right, and half the width, LPS x, mm.
    middle_mm: f64,
    half_mm: f64,
    /// The scan's end at the patient's head, LPS z, mm.
    head_mm: f64,
}

/// Least and greatest coordinates of a box of voxels, LPS mm: of all its corners, for the axes of an
/// oblique grid are not the patient's.
fn extent_mm(grid: &Grid, low: DVec3, high: DVec3) -> (DVec3, DVec3) {
    let to_world = grid.world_from_voxel();
    let corner = |n: u32| {
        let is_high = glam::BVec3::new(n & 1 != 0, n & 2 != 0, n & 4 != 0);
        to_world.transform_point3(DVec3::select(is_high, high, low))
    };
    let around = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    (0..8).map(corner).fold(around, |(lo, hi), p| (lo.min(p), hi.max(p)))
}

impl<'a> BodyPlace<'a> {
    fn of(grid: &'a Grid, body: &BitVolume, lungs: Option<Lungs>) -> Self {
        let (low, high) = body.bounds().unwrap_or_default();
        let (left, right) = extent_mm(grid, low.as_dvec3(), high.as_dvec3());
        let middle_mm = lungs.map_or(0.5 * (left.x + right.x), |lungs| lungs.middle_mm);
        let half_mm = (0.5 * (right.x - left.x)).max(1.0);
        let head_mm = extent_mm(grid, DVec3::ZERO, grid.dims.as_dvec3() - 1.0).1.z;
        Self { grid, lungs, middle_mm, half_mm, head_mm }
    }

    /// Measures the position of a piece and adds it to its features.
    fn measure(&self, mask: &BitVolume, features: &mut GasFeatures) {
        let to_world = self.grid.world_from_voxel();
        let places = || mask.voxels().map(|v| to_world.transform_point3(v.as_dvec3()));
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        places().for_each(|p| (low, high) = (low.min(p), high.max(p)));
        // Mean x of the upper part.
        let top_from = high.z - TOP_SHARE * (high.z - low.z);
        let (mut top_x_sum, mut top_count) = (0.0, 0u64);
        for p in places().filter(|p| p.z >= top_from) {
            top_x_sum += p.x;
            top_count += 1;
        }
        let top_x = top_x_sum / top_count.max(1) as f64;
        features.top_left = (top_x - self.middle_mm) / self.half_mm;
        features.right = (self.middle_mm - low.x) / self.half_mm;
        features.height_mm = high.z - low.z;
        features.below_lung_mm = self.lungs.map(|lungs| lungs.lowest_mm - high.z);
        features.below_end_mm = self.head_mm - high.z;
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;

    #[test]
    fn a_body_is_as_wide_on_an_oblique_grid_as_it_is() {
        let straight = Grid::axis_aligned([190, 125, 60], [2.0; 3]);
        let (low, high) = (DVec3::ZERO, straight.dims.as_dvec3() - 1.0);
        for degrees in [-30.0f64, 30.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let grid = Grid { direction: DMat3::from_rotation_z(degrees.to_radians()), ..straight };
            let (lo, hi) = extent_mm(&grid, low, high);
            let want = 378.0 * cos + 248.0 * sin.abs();
            assert!((hi.x - lo.x - want).abs() < 1e-9, "{degrees}: {}", hi.x - lo.x);
            assert!((hi.z - lo.z - 118.0).abs() < 1e-9);
        }
    }
}

//! Gas in the body of a CT, sorted into colon and other gas.

use glam::{DVec3, UVec3};

use super::body::PatientBody;
use super::depth::Depth;
use super::lungs::{Lungs, lung_of};
use super::values::{MIN_HU, between, share};
use super::{SIDES, airway};
use crate::lumen::{BitVolume, Piece, dilated, pieces};
use crate::volume::{Grid, Volume};

/// Highest value of gas, HU.
pub(super) const GAS_HU: f64 = -800.0;
/// Highest value of gas away from walls, HU, and least share of a segment that has it.
const DEEP_GAS_HU: f64 = -900.0;
pub(super) const MIN_DEEP: f64 = 0.8;
/// Least volume of a segment, ml.
pub(super) const MIN_ML: f64 = 15.0;
/// Least value of the tissue that encloses the colon, HU, and least share of a segment's shell that
/// has it.
const TISSUE_HU: f64 = -300.0;
pub(super) const MIN_TISSUE: f64 = 0.9;
/// Least radius of the largest sphere in a segment, mm.
pub(super) const MIN_RADIUS_MM: f64 = 6.0;
/// Greatest length of a stomach, in radii of its widest place …
const STOMACH_RADII: f64 = 6.0;
/// … and its greatest distance below the lungs, mm.
const BELOW_LUNG_MM: f64 = 40.0;
/// Greatest distance below the lungs, mm, at which a short pocket on the left may still be stomach.
const DOUBTFUL_BELOW_LUNG_MM: f64 = 80.0;

/// The gas in a body.
pub(super) struct Gas {
    /// Segments of the colon, from the one nearest the feet on.
    pub colon: Vec<ColonCandidate>,
    /// Gas that is not colon.
    pub others: BitVolume,
    /// Volume left out, and the reason: a line for each piece.
    pub left_out: Vec<String>,
    /// Segments that may be stomach: a line for each.
    pub doubtful: Vec<String>,
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
    pub volume_ml: f64,
    pub seed: UVec3,
    pub radius_mm: f64,
    /// Longest side of its box, mm.
    pub extent_mm: f64,
    /// Share of its voxels that are gas away from walls.
    pub deep: f64,
    /// Share of its shell that is tissue.
    pub tissue: f64,
}

impl Gas {
    /// Sorts the gas of a volume; `None` if there is none.
    pub fn of(volume: &Volume) -> Option<Self> {
        let grid = &volume.grid;
        let gas = between(volume, MIN_HU, GAS_HU);
        if gas.is_empty() {
            return None;
        }
        let body = PatientBody::of(volume).map(|body| body.inside);
        let body = body.unwrap_or_else(|| BitVolume::new(grid.dims));
        let mut inside = gas.clone();
        inside.keep(&body);
        let mut out = Self {
            colon: Vec::new(),
            others: inside.clone(),
            left_out: Vec::new(),
            doubtful: Vec::new(),
        };
        let (parts, mut other_parts) = out.without_lungs(volume, &inside);
        let airway = airway::find(volume, false).ok();
        let kinds = Kinds {
            deep_gas: between(volume, MIN_HU, DEEP_GAS_HU),
            tissue: between(volume, TISSUE_HU, f64::INFINITY),
            gas,
        };
        for piece in parts {
            let candidate = ColonCandidate::new(grid, &piece, &kinds);
            let is_airway = airway.as_ref().is_some_and(|a| share(&candidate.mask, &a.mask) > 0.1);
            let why = if is_airway { Some("airway".to_owned()) } else { candidate.refusal() };
            match why {
                None => out.colon.push(candidate),
                Some(why) => {
                    out.leave_out(candidate.volume_ml, &why);
                    other_parts.push(piece);
                }
            }
        }
        let lungs = Lungs::of(grid, &other_parts);
        let middle_mm = lungs.map_or_else(|| middle_mm(grid, &body), |l| l.middle_mm);
        let looks = |c: &mut ColonCandidate| {
            c.is_short_and_left(grid, middle_mm)
                && c.below_lung_mm(grid, lungs).is_some_and(|mm| mm < BELOW_LUNG_MM)
        };
        for stomach in out.colon.extract_if(.., looks).collect::<Vec<_>>() {
            out.leave_out(stomach.volume_ml, "short, left, under the lung: stomach");
        }
        for c in out.colon.iter().filter(|c| c.is_short_and_left(grid, middle_mm)) {
            let below = c.below_lung_mm(grid, lungs);
            if below.is_none_or(|mm| mm < DOUBTFUL_BELOW_LUNG_MM) {
                let place = below.map_or("no lung in the scan to tell".to_owned(), |mm| {
                    format!("{mm:.0} mm below the lung, stomach up to {BELOW_LUNG_MM:.0}")
                });
                let (ml, at) = (c.volume_ml, c.seed);
                let line =
                    format!("{ml:.0} ml of gas at {at} may be stomach: short, left, {place}");
                out.doubtful.push(line);
            }
        }
        out.colon.iter().for_each(|c| out.others.remove(&c.mask));
        out.colon = in_order(grid, out.colon);
        Some(out)
    }

    /// Returns the pieces of gas that may be colon, and the lung that was joined to them.
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
    fn new(grid: &Grid, piece: &Piece, kinds: &Kinds) -> Self {
        let mask = piece.mask(grid.dims);
        let mut shell = dilated(&mask, DVec3::ONE, 3.0);
        shell.remove(&dilated(&mask, DVec3::ONE, 2.0));
        // Other gas is judged by itself.
        shell.remove(&kinds.gas);
        let (seed, radius_mm) = Depth::of(*grid, &mask).deepest();
        let (lo, hi) = piece.bounds();
        let extent_mm = ((hi - lo).as_dvec3() * grid.spacing_mm).max_element();
        Self {
            volume_ml: piece.component.volume_ml(grid),
            deep: share(&mask, &kinds.deep_gas),
            tissue: share(&shell, &kinds.tissue),
            mask,
            seed,
            radius_mm,
            extent_mm,
        }
    }

    /// Returns the reason why the candidate is no colon, if there is one.
    fn refusal(&self) -> Option<String> {
        let Self { deep, tissue, radius_mm, .. } = self;
        if *deep < MIN_DEEP {
            return Some(format!("only {:.0} % below {DEEP_GAS_HU} HU", 100.0 * deep));
        }
        if *tissue < MIN_TISSUE {
            return Some(format!("only {:.0} % of its shell is tissue", 100.0 * tissue));
        }
        let narrow = *radius_mm < MIN_RADIUS_MM;
        narrow.then(|| format!("its widest place has a radius of {radius_mm:.1} mm"))
    }

    /// Whether it is a wide, short pocket on the patient's left, as a stomach is.
    fn is_short_and_left(&self, grid: &Grid, middle_mm: f64) -> bool {
        let at = grid.world_from_voxel().transform_point3(self.seed.as_dvec3());
        self.extent_mm < STOMACH_RADII * self.radius_mm && at.x > middle_mm
    }

    /// Returns the distance of the candidate's widest place below the lungs, mm.
    fn below_lung_mm(&self, grid: &Grid, lungs: Option<Lungs>) -> Option<f64> {
        let at = grid.world_from_voxel().transform_point3(self.seed.as_dvec3());
        lungs.map(|lungs| lungs.lowest_mm - (at.z + self.radius_mm))
    }
}

/// Middle of a body between left and right, LPS x.
fn middle_mm(grid: &Grid, body: &BitVolume) -> f64 {
    let (low, high) = body.bounds().unwrap_or_default();
    let middle = 0.5 * (low.as_dvec3() + high.as_dvec3());
    grid.world_from_voxel().transform_point3(middle).x
}

/// Segments from the feet-most one on, each followed by the one with the narrowest gap to it.
fn in_order(grid: &Grid, mut left: Vec<ColonCandidate>) -> Vec<ColonCandidate> {
    let to_world = grid.world_from_voxel();
    // A sample of up to about a thousand of the rim's voxels.
    let rim = |c: &ColonCandidate| -> Vec<DVec3> {
        let on_rim = |v: &UVec3| SIDES.iter().any(|d| !c.mask.get(v.as_ivec3() + d));
        let all: Vec<UVec3> = c.mask.voxels().filter(on_rim).collect();
        let each = all.len().div_ceil(1000).max(1);
        let some = all.iter().step_by(each);
        some.map(|v| to_world.transform_point3(v.as_dvec3())).collect()
    };
    let mut rims: Vec<Vec<DVec3>> = left.iter().map(rim).collect();
    let lowest = |r: &Vec<DVec3>| r.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    let first = (0..left.len()).min_by(|a, b| lowest(&rims[*a]).total_cmp(&lowest(&rims[*b])));
    let mut out = Vec::new();
    let mut next = first;
    while let Some(i) = next {
        let here = rims.remove(i);
        out.push(left.remove(i));
        let gap = |r: &Vec<DVec3>| {
            let to = |p: &DVec3| {
                here.iter().map(|q| p.distance_squared(*q)).fold(f64::INFINITY, f64::min)
            };
            r.iter().map(to).fold(f64::INFINITY, f64::min)
        };
        let gaps: Vec<f64> = rims.iter().map(gap).collect();
        next = (0..gaps.len()).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b]));
    }
    out
}

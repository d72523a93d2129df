//! Finding a hollow organ in a CT or MR volume without a threshold, a seed or a click.
//!
//! Each organ is found by what defines it in the image: the trachea by its round air-filled cross
//! sections, the colon by large gas segments enclosed by soft tissue, vessels by their contrast to
//! their surroundings. Every decision is a gate: a measured value beside a limit. All gates are
//! reported, and one that fails is an error that names it.

mod airway;
mod aorta;
mod arteries;
mod body;
mod branches;
mod bronchi;
mod coarse;
mod colon;
mod colon_ends;
mod colon_order;
mod depth;
mod explain;
mod fluid;
mod frame;
mod gas;
mod gates;
mod glance;
mod lungs;
mod numbers;
mod rivals;
mod sections;
mod smooth;
mod trachea;
mod values;
mod vertebrae;
mod vessel;
mod walled;

pub use colon_ends::ColonEnds;
pub use explain::{Picture, explain, named_components};
pub use glance::{Glance, glance};

use glam::{IVec3, UVec3};

use crate::lumen::{BitVolume, IntensitySelection, LumenError};
use crate::volume::{Grid, Volume};

/// An organ that can be found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Organ {
    /// Trachea and bronchi, CT.
    Airway,
    /// Colon filled with gas, CT.
    Colon,
    /// Aorta and its branches, or the brightest tree of an angiogram, CT or MR.
    Vessel,
}

impl Organ {
    /// All organs, in the order in which one is suggested.
    pub const ALL: [Self; 3] = [Self::Airway, Self::Colon, Self::Vessel];

    /// Returns the organ's name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Airway => "airway",
            Self::Colon => "colon",
            Self::Vessel => "vessel",
        }
    }
}

/// Options of the search for an organ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OrganOptions {
    /// Organ to find.
    pub organ: Organ,
    /// Whether a colon's tagged fluid is taken too, where there is some.
    pub tagged: bool,
    /// Whether an airway's bronchi beyond the threshold of its tree are taken too.
    pub thin: bool,
}

impl From<Organ> for OrganOptions {
    fn from(organ: Organ) -> Self {
        Self { organ, tagged: false, thin: true }
    }
}

/// An organ that was found.
#[derive(Clone, Debug)]
pub struct FoundOrgan {
    /// Organ that was looked for.
    pub organ: Organ,
    /// Voxels of the organ's lumen.
    pub mask: BitVolume,
    /// Certain part of the mask, without mixed voxels at its wall, where that is less than the
    /// mask: the core of a wall field.
    pub core: Option<BitVolume>,
    /// Tagged fluid in the mask, where the mask holds both gas and fluid.
    pub fluid: Option<TaggedFluid>,
    /// Range of the lumen's values; the mask is not all voxels of this range.
    pub selection: IntensitySelection,
    /// Chosen end of the range, real units.
    pub threshold: f64,
    /// Parts of the organ, each 6-connected, in the order in which they follow each other.
    pub segments: Vec<Segment>,
    /// Voxel at the upper end of an airway's trachea, where the path begins.
    pub root: Option<UVec3>,
    /// Least margin by which a gate was passed: 0 at its limit, at most 1.
    pub confidence: f64,
    /// Measurements and decisions, one line each.
    pub reasons: Vec<String>,
}

/// Fluid with contrast medium in a lumen of gas.
#[derive(Clone, Debug)]
pub struct TaggedFluid {
    /// Voxels of the fluid.
    pub mask: BitVolume,
    /// Step from gas to fluid, voxels: the direction of gravity.
    pub down: IVec3,
}

/// A connected part of an organ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Voxel deep inside the part.
    pub seed: UVec3,
    /// Volume of the part, ml.
    pub volume_ml: f64,
}

/// Reasons why an organ was not found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OrganError {
    /// Nothing passed the gates.
    #[error("no {} found: {why}", .organ.name())]
    NotFound {
        /// Organ that was looked for.
        organ: Organ,
        /// The gate that failed, with the value and the limit.
        why: String,
    },
    /// Segmentation of the lumen failed.
    #[error(transparent)]
    Lumen(#[from] LumenError),
}

impl OrganOptions {
    /// Finds the organ.
    ///
    /// # Errors
    /// [`OrganError::NotFound`] with the gate that failed; [`LumenError::Sheared`] for a grid whose
    /// axes are not at right angles.
    pub fn find(&self, volume: &Volume) -> Result<FoundOrgan, OrganError> {
        if !volume.grid.is_orthogonal() {
            let degrees = volume.grid.shear_rad().to_degrees();
            return Err(LumenError::Sheared { degrees }.into());
        }
        match self.organ {
            Organ::Airway => airway::find(volume, self.thin),
            Organ::Colon => colon::find(volume, self.tagged),
            Organ::Vessel => vessel::find(volume),
        }
    }
}

/// Returns the organ that a volume seems to show: the first one found.
pub fn suggest(volume: &Volume) -> Option<Organ> {
    let found = |organ: &Organ| OrganOptions::from(*organ).find(volume).is_ok();
    Organ::ALL.into_iter().find(found)
}

/// Offsets of the six voxels that share a side with one.
const SIDES: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];

/// The index axis nearest to the patient's head–foot direction.
fn head_foot_axis(grid: &Grid) -> usize {
    let along = |axis: usize| grid.direction.col(axis).z.abs();
    (0..3).rev().max_by(|a, b| along(*a).total_cmp(&along(*b))).unwrap_or(2)
}

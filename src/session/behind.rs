//! The tissue behind the wall, from the volume that the lumen lies in.

use std::sync::Arc;

use super::load::{InputVolume, canonical};
use super::surface::MAX_GAS_HU;
use super::{
    Clock, Segmented, Session, SessionError, Source, present, read_any_volume, refuse_above,
};
use crate::behind::{BehindWall, Opacity, TissueBricks, TissueError, TissueField};
use crate::lumen::{GreyBricks, GreyValues, IntensitySelection, Lumen};
use crate::organ::Organ;
use crate::volume::Volume;

/// Voxels of the lumen that are looked at for its own value.
const LUMEN_SAMPLES: usize = 4096;
/// Depth behind the wall that is shown unless somebody asks for another, mm: of a colon or a vessel, and
/// of an airway, where vessels lie behind the wall.
const USUAL_DEPTH_MM: [f32; 2] = [5.0, 8.0];
/// Noise where no stage measured it, HU.
const USUAL_NOISE_HU: f64 = 20.0;

impl Session {
    pub(super) fn run_behind(&self, clock: &mut Clock) -> Result<BehindWall, SessionError> {
        let segmented = present(&self.slots.lumen);
        let wall = present(&self.slots.triangle_tree);
        let lumen = &segmented.lumen;
        let usual_mm = if self.is_airway() { USUAL_DEPTH_MM[1] } else { USUAL_DEPTH_MM[0] };
        let depth_mm = self.settings.flight.behind_mm.unwrap_or(usual_mm);

        let bricks = TissueBricks::new(lumen, f64::from(depth_mm))?;
        refuse_above(
            self.settings.max_memory_mb,
            bricks.working_bytes(),
            "values and distances behind the wall; less with a smaller depth",
        )?;
        let whole;
        let parts;
        let values = match self.volume_of_values(&segmented)? {
            ValueSource::Whole(volume) => {
                whole = volume;
                GreyValues::Whole(&whole)
            }
            ValueSource::Parts => {
                let loaded = present(&self.slots.loaded);
                let InputVolume::Parts(input) = &loaded.volume else {
                    unreachable!("a volume that is read in parts");
                };
                parts = GreyBricks::read(&input.parts, bricks.of_volume(lumen))?;
                GreyValues::Bricks(&parts)
            }
        };
        let noise = segmented.wall.as_ref().map_or(USUAL_NOISE_HU, |w| w.stats.contrast.noise);
        let make = || {
            let opacity = self.opacity(lumen, &bricks, values);
            let tissue = TissueField::new(lumen, bricks, values, &wall);
            BehindWall::new(tissue, opacity, noise as f32, depth_mm)
        };
        Ok(clock.time("behind the wall", "bytes", make, |behind| behind.tissue.bytes()))
    }

    /// The volume that has the values of the tissue.
    fn volume_of_values(&self, segmented: &Segmented) -> Result<ValueSource, SessionError> {
        let loaded = present(&self.slots.loaded);
        let volume = match &self.source {
            Source::Mask { image: None, .. } => return Err(TissueError::NoValues.into()),
            Source::Mask { image: Some(image), .. } => {
                canonical(read_any_volume(image, self.settings.max_memory_mb)?)
            }
            Source::Image(_) => {
                if matches!(segmented.options.selection, IntensitySelection::Labels(_)) {
                    return Err(TissueError::NoValues.into());
                }
                if matches!(loaded.volume, InputVolume::Parts(_)) {
                    return Ok(ValueSource::Parts);
                }
                self.whole(&loaded)?
            }
        };
        match &volume.acquisition {
            Some(a) if a.modality != "CT" && a.modality != "other" => {
                let modality = a.modality.to_owned();
                Err(TissueError::NoCtNumbers { modality }.into())
            }
            _ => Ok(ValueSource::Whole(volume)),
        }
    }

    /// Opacity of the tissue behind the wall of this lumen: by the organ, or by what fills the lumen.
    fn opacity(&self, lumen: &Lumen, bricks: &TissueBricks, values: GreyValues<'_>) -> Opacity {
        let filling = value_inside(lumen, bricks, values);
        match self.is_airway() {
            _ if filling > MAX_GAS_HU => Opacity::Vessel(filling as f32),
            true => Opacity::Airway,
            false => Opacity::Colon,
        }
    }

    fn is_airway(&self) -> bool {
        self.settings.lumen.organ.is_some_and(|o| o.organ == Organ::Airway)
    }
}

/// Volume that has the values.
enum ValueSource {
    Whole(Arc<Volume>),
    /// The session's own, which is read in parts.
    Parts,
}

/// Returns the median value of voxels inside a lumen and near its wall, taken at even steps: of a volume
/// that is read in parts, values deep inside are not read.
fn value_inside(lumen: &Lumen, bricks: &TissueBricks, values: GreyValues<'_>) -> f64 {
    let step = (lumen.inside_voxels() as usize / LUMEN_SAMPLES).max(1);
    let inside = lumen.elements(&lumen.inside).step_by(step).map(|e| lumen.bricks.voxel(e));
    let near = inside.filter(|v| bricks.holds(*v)).map(|v| lumen.volume_voxel(v).as_uvec3());
    let mut all: Vec<f64> = near.map(|v| values.real(v)).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(f64::NEG_INFINITY)
}

//! Choosing the lumen.

use glam::IVec3;

use super::settings::Seed;
use super::{Clock, Session, SessionError, estimate_bytes, present, put, refuse_above};
use crate::lumen::{Lumen, LumenError, SegmentationOptions, SegmentationStats};
use crate::volume::Volume;

/// The lumen with what choosing it found.
pub struct Segmented {
    /// Bricks and classes.
    pub lumen: Lumen,
    /// Components left out, cavities filled, leaks.
    pub found: SegmentationStats,
    /// The options it was chosen with, the seed as a voxel.
    pub options: SegmentationOptions,
    /// What a user should know about how it came out.
    pub notes: Vec<String>,
}

impl Segmented {
    /// A voxel from which the surface is tracked: the seed, where one was given.
    pub fn track_from(&self) -> Option<IVec3> {
        self.options.seed.filter(|_| !self.options.all_components).map(|s| s.as_ivec3())
    }
}

impl Session {
    pub(super) fn run_lumen(&self, clock: &mut Clock) -> Result<(), SessionError> {
        let loaded = present(&self.slots.volume);
        let volume = &*loaded.volume;
        let settings = &self.settings.lumen;
        let seed = match settings.seed {
            None => None,
            Some(Seed::Voxel(v)) => Some(v),
            Some(Seed::Point(p)) => {
                let v = volume.grid.nearest_voxel(p);
                Some(v.ok_or(LumenError::SeedPoint(p.to_array()))?)
            }
        };
        let options = SegmentationOptions {
            selection: loaded.select.clone(),
            seed,
            all_components: settings.all_components,
            fill: settings.fill,
            leak_control: settings.leak_control,
        };
        let voxels = |r: &Result<(Lumen, SegmentationStats), _>| {
            r.as_ref().map_or(0, |r| r.0.inside_voxels())
        };
        let (lumen, found) = clock.time("segment", "voxels", || options.apply(volume), voxels)?;
        if lumen.bricks.is_empty() {
            let (selection, range) = (options.selection.clone(), volume.range());
            return Err(LumenError::Empty { selection, range }.into());
        }
        let notes = notes(&options, &lumen, &found);
        notes.iter().for_each(|line| tracing::warn!("{line}"));
        self.check_memory(volume, &lumen)?;
        put(&self.slots.lumen, Segmented { lumen, found, options, notes });
        Ok(())
    }

    fn check_memory(&self, volume: &Volume, lumen: &Lumen) -> Result<(), SessionError> {
        let bytes = estimate_bytes(
            volume.samples.bytes().len() as u64,
            volume.grid.len() as u64,
            lumen.bricks.len() as u64,
        );
        tracing::info!("about {} MB will be needed", bytes / 1_000_000);
        refuse_above(self.settings.max_memory_mb, bytes, "volume, fields and surface")
    }
}

fn notes(options: &SegmentationOptions, lumen: &Lumen, found: &SegmentationStats) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(leak) = found.leak {
        let leaks = leak.leak_ml.map_or("no leak found".to_owned(), |ml| {
            format!("the next step would fill {ml:.0} ml")
        });
        let (t, v) = (leak.threshold, leak.volume_ml);
        out.push(format!("leak control: threshold {t} holds {v:.1} ml; {leaks}"));
    }
    if options.seed.is_none() && !options.all_components && !found.others.is_empty() {
        let listed: Vec<String> =
            found.others.iter().take(3).map(|c| format!("{} at {}", c.voxels, c.first)).collect();
        out.push(format!(
            "kept the largest of {} components; left out {} voxels ({}{})",
            found.others.len() + 1,
            found.other_voxels,
            listed.join(", "),
            if found.others.len() > 3 { ", …" } else { "" }
        ));
    }
    if lumen.touches_edge {
        out.push("the lumen touches the edge of the volume; it is closed there by caps".into());
    }
    out
}

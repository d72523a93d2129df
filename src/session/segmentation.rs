//! Choosing the lumen.

use glam::IVec3;

use super::settings::{Seed, Source};
use super::{Clock, Session, SessionError, estimate_bytes, present, put, refuse_above};
use crate::lumen::{
    Component, Lumen, LumenError, SegmentationOptions, SegmentationStats, fill_cavities,
};
use crate::organ::{self, FoundOrgan, OrganOptions};
use crate::volume::{Grid, Volume};

/// The lumen with what choosing it found.
pub struct Segmented {
    /// Bricks and classes.
    pub lumen: Lumen,
    /// Components left out, cavities filled, leaks.
    pub found: SegmentationStats,
    /// The options it was chosen with, the seed as a voxel.
    pub options: SegmentationOptions,
    /// The organ, where one was looked for.
    pub organ: Option<FoundOrgan>,
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
        let name = || match &self.source {
            Source::Image(source) | Source::Mask { mask: source, .. } => source.name(),
        };
        if let Some(options) = settings.organ {
            return self.run_organ(volume, options, clock);
        }
        let selection = loaded.select.clone();
        let selection = selection.ok_or_else(|| SessionError::LumenNotChosen {
            name: name(),
            organ: organ::suggest(volume),
        })?;
        let seed = match settings.seed {
            None => None,
            Some(Seed::Voxel(v)) => Some(v),
            Some(Seed::Point(p)) => {
                let v = volume.grid.nearest_voxel(p);
                Some(v.ok_or(LumenError::SeedPoint(p.to_array()))?)
            }
        };
        let options = SegmentationOptions {
            selection,
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
        let notes = notes(&lumen, &found);
        notes.iter().for_each(|line| tracing::warn!("{line}"));
        self.check_memory(volume, &lumen)?;
        put(&self.slots.lumen, Segmented { lumen, found, options, organ: None, notes });
        Ok(())
    }

    fn run_organ(
        &self,
        volume: &Volume,
        options: OrganOptions,
        clock: &mut Clock,
    ) -> Result<(), SessionError> {
        let voxels = |r: &Result<FoundOrgan, _>| r.as_ref().map_or(0, |r| r.mask.count());
        let mut organ = clock.time("organ", "voxels", || options.find(volume), voxels)?;
        let mut found =
            SegmentationStats { grown_voxels: organ.mask.count(), ..Default::default() };
        if self.settings.lumen.fill {
            found.filled = fill_cavities(&mut organ.mask);
        }
        let lumen = Lumen::new(volume.grid, &organ.mask);
        let seed = organ.segments.first().map(|s| s.seed);
        let options = SegmentationOptions {
            seed,
            all_components: organ.segments.len() > 1,
            fill: self.settings.lumen.fill,
            ..SegmentationOptions::new(organ.selection.clone())
        };
        let mut notes = vec![format!(
            "{}: {} (confidence {:.2})",
            organ.organ.name(),
            organ.reasons.join("; "),
            organ.confidence
        )];
        notes.extend(self::notes(&lumen, &found));
        notes.iter().for_each(|line| tracing::warn!("{line}"));
        self.check_memory(volume, &lumen)?;
        put(&self.slots.lumen, Segmented { lumen, found, options, organ: Some(organ), notes });
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

fn notes(lumen: &Lumen, found: &SegmentationStats) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(leak) = found.leak {
        let leaks = leak.leak_ml.map_or("no leak found".to_owned(), |ml| {
            format!("the next step would fill {ml:.0} ml")
        });
        let (t, v) = (leak.threshold, leak.volume_ml);
        out.push(format!("leak control: threshold {t} holds {v:.1} ml; {leaks}"));
    }
    if !found.others.is_empty() || !found.outside.is_empty() {
        out.push(taken_note(&lumen.grid, found));
    }
    if lumen.touches_edge {
        out.push("the lumen touches the edge of the volume; it is closed there by caps".into());
    }
    out
}

/// What was taken, and what was left out.
fn taken_note(grid: &Grid, found: &SegmentationStats) -> String {
    let list = |all: &[Component]| {
        let named = |c: &Component| format!("{:.3} ml from voxel {}", c.volume_ml(grid), c.first);
        let listed: Vec<String> = all.iter().take(3).map(named).collect();
        listed.join(", ") + if all.len() > 3 { ", …" } else { "" }
    };
    let mut note = found.taken.map_or_else(
        || "took every component in the body".to_owned(),
        |taken| format!("took the component of {}", list(&[taken])),
    );
    let (others, outside) = (&found.others, &found.outside);
    if !others.is_empty() {
        note += &format!(
            ", the largest of {}; left out {} voxels ({})",
            others.len() + 1,
            found.other_voxels,
            list(others)
        );
    }
    if !outside.is_empty() {
        note += &format!("; left out the air outside the body ({})", list(outside));
    }
    note
}

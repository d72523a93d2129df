//! Volumes and settings of a session that a request opens.

use std::sync::Arc;

use glam::DVec3;

use super::action::{LumenChoice, Request};
use crate::formats::ReadOptions;
use crate::lumen::IntensitySelection;
use crate::session::{
    CenterlineSettings, LumenSettings, Seed, Session, Settings, Source, VolumeSource,
};

/// Volumes and settings that a session takes in place of its own.
pub struct Opening {
    /// Other volumes; `None` leaves those that are there.
    pub source: Option<Source>,
    /// Choice of the lumen and settings of each stage.
    pub settings: Settings,
    /// Whether it is another lumen of the same volume.
    pub is_same_volume: bool,
}

impl Opening {
    /// Returns what a request opens; `None` where it opens nothing.
    ///
    /// * `session`: what is open.
    /// * `settings`: those of the session, or of one to come.
    /// * `is_mask`: whether what has to be chosen from is the mask.
    pub fn of(
        request: &Request,
        session: Option<&Session>,
        settings: &Settings,
        is_mask: bool,
    ) -> Option<Self> {
        let settings = settings.clone();
        let source = session.map(|s| s.source().clone());
        let read = |is_mask, set: &dyn Fn(&mut ReadOptions)| {
            let source = source.clone().map(|s| with_options(s, is_mask, set));
            Some(Self { source, settings: settings.clone(), is_same_volume: false })
        };
        let lumen = match request {
            Request::Open(path) => {
                let ends = CenterlineSettings { from: None, to: None, ..settings.centerline };
                // The lumen of another volume is not chosen yet.
                let lumen = LumenSettings::default();
                let settings = Settings { lumen, centerline: ends, ..settings };
                let source = Some(Source::Image(VolumeSource::file(path)));
                return Some(Self { source, settings, is_same_volume: false });
            }
            Request::Series(index) => {
                return read(is_mask, &|o| o.series = Some(index.to_string()));
            }
            Request::Segment(name) => return read(true, &|o| o.segments = vec![name.clone()]),
            Request::Organ(organ) => {
                LumenSettings { organ: Some((*organ).into()), ..LumenSettings::default() }
            }
            Request::Lumen(LumenChoice { range: [lo, hi], seed_mm }) => LumenSettings {
                select: Some(IntensitySelection::Range { lo: *lo, hi: *hi }),
                seed: seed_mm.map(|p| Seed::Point(DVec3::from(p))),
                ..LumenSettings::default()
            },
            _ => return None,
        };
        // Of a mask it is the labels that the slices show that are chosen from.
        let source = source.filter(|s| matches!(s, Source::Mask { .. })).and_then(|_| {
            let volume = session?.products(&[crate::session::Product::Volume]);
            Some(Source::Image(VolumeSource::Memory(Arc::clone(volume.volume()?))))
        });
        let settings = Settings { lumen, ..settings };
        Some(Self { source, settings, is_same_volume: true })
    }
}

/// Settings with all branches of the lumen, which the window lets choose from. Parts of a lumen
/// that follow each other, as the segments of a colon do, and a path that ends where it is told to
/// have one way to be flown.
pub(super) fn with_branches(mut settings: Settings) -> Settings {
    let lumen = &settings.lumen;
    let has_parts =
        lumen.all_components || lumen.organ.is_some_and(|o| o.organ == crate::organ::Organ::Colon);
    settings.centerline.tree |= !has_parts && settings.centerline.to.is_none();
    settings
}

/// Another choice of what is read of the same file: of the mask, or of the image. Segments are a
/// mask's, and an image's where there is none.
fn with_options(mut source: Source, is_mask: bool, set: &dyn Fn(&mut ReadOptions)) -> Source {
    let volume = match &mut source {
        Source::Image(image) => Some(image),
        Source::Mask { mask, .. } if is_mask => Some(mask),
        Source::Mask { image, .. } => image.as_mut(),
    };
    if let Some(VolumeSource::File { options, .. }) = volume {
        set(options);
    }
    source
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::organ::Organ;

    #[test]
    fn the_window_has_the_tree_of_a_lumen_but_where_parts_are_flown_in_order() {
        let of = |change: &dyn Fn(&mut Settings)| {
            let mut settings = Settings::default();
            change(&mut settings);
            with_branches(settings).centerline.tree
        };
        assert!(of(&|_| {}));
        assert!(of(&|s| s.lumen.organ = Some(Organ::Airway.into())));
        assert!(!of(&|s| s.lumen.organ = Some(Organ::Colon.into())));
        assert!(!of(&|s| s.lumen.all_components = true));
        assert!(!of(&|s| s.centerline.to = Some(DVec3::ZERO)), "it ends there");
        assert!(of(&|s| (s.centerline.tree, s.lumen.all_components) = (true, true)), "asked for");
    }
}

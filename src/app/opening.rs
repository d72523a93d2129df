//! Volumes and settings of a session that a request opens.

use std::sync::Arc;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::action::{LumenChoice, Request};
use crate::formats::ReadOptions;
use crate::lumen::IntensitySelection;
use crate::organ::Organ;
use crate::session::{
    CenterlineSettings, EndPoint, LumenSettings, Seed, Session, Settings, Source, VolumeSource,
};

/// Choice of a lumen as it is made in the window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SavedLumen {
    /// An organ that is found.
    Organ(Organ),
    /// Grey values, and where the lumen begins.
    Range(LumenChoice),
}

impl SavedLumen {
    /// Returns the choice that has these settings; `None` where no window can make it.
    pub(super) fn of(settings: &LumenSettings) -> Option<Self> {
        let choice = match (&settings.organ, &settings.select) {
            (Some(organ), _) => Self::Organ(organ.organ),
            (None, Some(IntensitySelection::Range { lo, hi })) => {
                let seed_mm = match settings.seed {
                    Some(Seed::Point(p)) => Some(p.to_array()),
                    Some(Seed::Voxel(_)) | None => None,
                };
                Self::Range(LumenChoice { range: [*lo, *hi], seed_mm })
            }
            (None, _) => return None,
        };
        (choice.settings() == *settings && choice.is_finite()).then_some(choice)
    }

    /// Whether its numbers are some: JSON has no others.
    fn is_finite(&self) -> bool {
        match self {
            Self::Organ(_) => true,
            Self::Range(LumenChoice { range, seed_mm }) => {
                range.iter().chain(seed_mm.iter().flatten()).all(|v| v.is_finite())
            }
        }
    }

    /// Returns the request that makes the choice.
    pub(super) fn request(&self) -> Request {
        match self {
            Self::Organ(organ) => Request::Organ(*organ),
            Self::Range(choice) => Request::Lumen(*choice),
        }
    }

    fn settings(&self) -> LumenSettings {
        match self {
            Self::Organ(organ) => {
                LumenSettings { organ: Some((*organ).into()), ..LumenSettings::default() }
            }
            Self::Range(LumenChoice { range: [lo, hi], seed_mm }) => LumenSettings {
                select: Some(IntensitySelection::Range { lo: *lo, hi: *hi }),
                seed: seed_mm.map(|p| Seed::Point(DVec3::from(p))),
                ..LumenSettings::default()
            },
        }
    }
}

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
            Request::StartAt(at) | Request::EndAt(at) => {
                let mut settings = settings;
                let at = Some(EndPoint::Point(DVec3::from(*at)));
                match request {
                    Request::StartAt(_) => settings.centerline.from = at,
                    _ => settings.centerline.to = at,
                }
                return Some(Self { source: None, settings, is_same_volume: true });
            }
            Request::Organ(organ) => SavedLumen::Organ(*organ).settings(),
            Request::Lumen(choice) => SavedLumen::Range(*choice).settings(),
            _ => return None,
        };
        // Of a mask it is the labels that the slices show that are chosen from.
        let source = source.filter(|s| matches!(s, Source::Mask { .. })).and_then(|_| {
            let volume = session?.products(&[crate::session::Product::Volume]);
            Some(Source::Image(VolumeSource::Memory(Arc::clone(volume.volume()?))))
        });
        // Ends are of one lumen.
        let ends = match SavedLumen::of(&settings.lumen) {
            Some(_) => CenterlineSettings { from: None, to: None, ..settings.centerline },
            None => settings.centerline,
        };
        let settings = Settings { lumen, centerline: ends, ..settings };
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

    #[test]
    fn a_choice_of_the_lumen_is_saved_where_a_window_can_make_it_again() {
        let range = |hi| LumenChoice { range: [-1000.0, hi], seed_mm: Some([1.0, 2.0, 3.0]) };
        for choice in [SavedLumen::Organ(Organ::Colon), SavedLumen::Range(range(-500.0))] {
            assert_eq!(SavedLumen::of(&choice.settings()), Some(choice));
        }
        assert_eq!(SavedLumen::of(&SavedLumen::Range(range(f64::INFINITY)).settings()), None);
        let voxel = Some(Seed::Voxel(glam::UVec3::ONE));
        let by_voxel = LumenSettings { seed: voxel, ..SavedLumen::Range(range(0.0)).settings() };
        assert_eq!(SavedLumen::of(&by_voxel), None, "its place is not known");
        assert_eq!(SavedLumen::of(&LumenSettings::default()), None, "nobody chose");
    }

    #[test]
    fn ends_that_were_chosen_stay_with_their_lumen() {
        let after = |settings: &Settings, request| {
            Opening::of(&request, None, settings, false).unwrap().settings
        };
        let settings = after(&Settings::default(), Request::Organ(Organ::Vessel));
        let at = [1.0, 2.0, 3.0];
        let started = after(&settings, Request::StartAt(at));
        assert_eq!(started.centerline.from, Some(DVec3::from(at).into()));
        assert_eq!(started.lumen.organ, settings.lumen.organ);
        let ended = after(&started, Request::EndAt(at));
        assert_eq!(
            (ended.centerline.from, ended.centerline.to),
            (started.centerline.from, ended.centerline.from)
        );
        let other = after(&ended, Request::Organ(Organ::Airway)).centerline;
        assert_eq!((other.from, other.to), (None, None), "ends of another lumen");
    }

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
        assert!(!of(&|s| s.centerline.to = Some(DVec3::ZERO.into())), "it ends there");
        assert!(of(&|s| (s.centerline.tree, s.lumen.all_components) = (true, true)), "asked for");
    }
}

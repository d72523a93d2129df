//! Volumes and settings of a session that a request opens.

use std::sync::Arc;

use glam::{DVec3, UVec3};
use serde::{Deserialize, Serialize};

use super::action::{LumenChoice, Request};
use crate::formats::ReadOptions;
use crate::lumen::IntensitySelection;
use crate::organ::{Organ, OrganOptions};
use crate::session::{
    CenterlineSettings, EndPoint, LumenSettings, Seed, Session, Settings, Source, VolumeSource,
    WallMethod,
};

/// Choice of a lumen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SavedLumen {
    /// An organ that is found.
    Organ(Organ),
    /// Grey values, and where the lumen begins.
    Range(LumenChoice),
    /// Any other choice, as the command line makes it.
    Settings(SavedSettings),
}

/// Every setting of a lumen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SavedSettings {
    /// Organ that is found.
    organ: Option<Organ>,
    /// Whether a colon's tagged fluid is taken too.
    tagged: bool,
    /// Whether an airway's thinnest bronchi are left out.
    no_thin_bronchi: bool,
    /// Least and largest value inside; without a number the end is open.
    range: Option<[Option<f64>; 2]>,
    /// Label values inside; all but 0 where the list is empty.
    labels: Option<Vec<i64>>,
    /// Place where the lumen begins, LPS mm.
    seed_mm: Option<[f64; 3]>,
    /// Voxel where the lumen begins, as the file counts them.
    seed_voxel: Option<[u32; 3]>,
    /// Whether every component is kept.
    all_components: bool,
    /// Whether closed cavities stay.
    no_fill: bool,
    /// Whether the threshold is drawn in to just before the first leak.
    leak_control: bool,
    /// Method by which the wall is placed.
    wall: WallMethod,
}

impl SavedSettings {
    fn of(settings: &LumenSettings) -> Self {
        let end = |v: f64| v.is_finite().then_some(v);
        let (range, labels) = match &settings.select {
            Some(IntensitySelection::Range { lo, hi }) => (Some([end(*lo), end(*hi)]), None),
            Some(IntensitySelection::Labels(labels)) => (None, Some(labels.clone())),
            None => (None, None),
        };
        let (seed_mm, seed_voxel) = match settings.seed {
            Some(Seed::Point(p)) => (Some(p.to_array()), None),
            Some(Seed::Voxel(v)) => (None, Some(v.to_array())),
            None => (None, None),
        };
        Self {
            organ: settings.organ.map(|o| o.organ),
            tagged: settings.organ.is_some_and(|o| o.tagged),
            no_thin_bronchi: settings.organ.is_some_and(|o| !o.thin),
            range,
            labels,
            seed_mm,
            seed_voxel,
            all_components: settings.all_components,
            no_fill: !settings.fill,
            leak_control: settings.leak_control,
            wall: settings.wall,
        }
    }

    fn settings(&self) -> LumenSettings {
        let (tagged, thin) = (self.tagged, !self.no_thin_bronchi);
        let range = self.range.map(|[lo, hi]| IntensitySelection::Range {
            lo: lo.unwrap_or(f64::NEG_INFINITY),
            hi: hi.unwrap_or(f64::INFINITY),
        });
        let by_point = self.seed_mm.map(|p| Seed::Point(DVec3::from(p)));
        let by_voxel = self.seed_voxel.map(|v| Seed::Voxel(UVec3::from(v)));
        LumenSettings {
            organ: self.organ.map(|organ| OrganOptions { organ, tagged, thin }),
            select: range.or_else(|| self.labels.clone().map(IntensitySelection::Labels)),
            seed: by_point.or(by_voxel),
            all_components: self.all_components,
            fill: !self.no_fill,
            leak_control: self.leak_control,
            wall: self.wall,
        }
    }
}

/// Ends of the path that someone has set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SavedEnds {
    /// Start of the path, LPS mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    start_mm: Option<[f64; 3]>,
    /// Its end, LPS mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    end_mm: Option<[f64; 3]>,
}

impl SavedEnds {
    pub(super) fn of(settings: &CenterlineSettings) -> Self {
        let place = |end: Option<EndPoint>| match end {
            Some(EndPoint::Point(at)) => Some(at.to_array()),
            Some(EndPoint::Root | EndPoint::Tip(_)) | None => None,
        };
        Self { start_mm: place(settings.from), end_mm: place(settings.to) }
    }

    pub(super) fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Whether its numbers are some.
    pub(super) fn is_finite(&self) -> bool {
        self.start_mm.iter().chain(&self.end_mm).flatten().all(|v| v.is_finite())
    }

    pub(super) fn put_into(self, settings: &mut CenterlineSettings) {
        let end = |at: [f64; 3]| EndPoint::Point(DVec3::from(at));
        (settings.from, settings.to) = (self.start_mm.map(end), self.end_mm.map(end));
    }
}

impl SavedLumen {
    /// Returns the choice that has these settings; `None` where nobody has chosen.
    pub(super) fn of(settings: &LumenSettings) -> Option<Self> {
        let all = Self::Settings(SavedSettings::of(settings));
        match (&settings.organ, &settings.select) {
            (None, None) => None,
            _ => Some(Self::in_the_window(settings).unwrap_or(all)),
        }
    }

    /// Returns the choice if a window offers it.
    fn in_the_window(settings: &LumenSettings) -> Option<Self> {
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

    /// Whether it is an organ that is found.
    pub(super) fn is_of_an_organ(&self) -> bool {
        self.settings().organ.is_some()
    }

    /// Whether it says what the lumen is.
    pub(super) fn is_choice(&self) -> bool {
        let settings = self.settings();
        self.is_finite() && (settings.organ.is_some() || settings.select.is_some())
    }

    /// Whether its numbers are some: JSON has no others.
    fn is_finite(&self) -> bool {
        match self {
            Self::Organ(_) | Self::Settings(_) => true,
            Self::Range(LumenChoice { range, seed_mm }) => {
                range.iter().chain(seed_mm.iter().flatten()).all(|v| v.is_finite())
            }
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
            Self::Settings(saved) => saved.settings(),
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
    /// Returns the lumen of a session file, of the same volume.
    ///
    /// * `session`: the session that is open.
    /// * `settings`: settings of that session.
    pub fn of_saved(saved: &SavedLumen, session: Option<&Session>, settings: &Settings) -> Self {
        match saved {
            // A label map's own lumen: its labels are chosen.
            SavedLumen::Settings(_) => Self {
                source: None,
                settings: Settings { lumen: saved.settings(), ..settings.clone() },
                is_same_volume: true,
            },
            SavedLumen::Organ(_) | SavedLumen::Range(_) => {
                Self::with_lumen(saved, session, settings.clone())
            }
        }
    }

    /// Another lumen of the same volume. Of a mask it is the labels that the slices show that are
    /// chosen from.
    fn with_lumen(lumen: &SavedLumen, session: Option<&Session>, settings: Settings) -> Self {
        let is_mask = session.is_some_and(|s| matches!(s.source(), Source::Mask { .. }));
        let labels = session.filter(|_| is_mask).and_then(|session| {
            let volume = session.products(&[crate::session::Product::Volume]);
            Some(Source::Image(VolumeSource::Memory(Arc::clone(volume.volume()?))))
        });
        // Ends are of one lumen.
        let ends = match SavedLumen::of(&settings.lumen) {
            Some(_) => CenterlineSettings { from: None, to: None, ..settings.centerline },
            None => settings.centerline,
        };
        let settings = Settings { lumen: lumen.settings(), centerline: ends, ..settings };
        Self { source: labels, settings, is_same_volume: true }
    }

    /// Returns a case's files, without a lumen.
    ///
    /// * `settings`: settings of the window, with the ends and the lumen of the case that was open before.
    pub fn of_case(source: Source, settings: &Settings) -> Self {
        let settings = Self::settings_of_case(settings);
        Self { source: Some(source), settings, is_same_volume: false }
    }

    /// Returns settings without those that are of one lumen.
    pub fn settings_of_case(settings: &Settings) -> Settings {
        let ends = CenterlineSettings { from: None, to: None, ..settings.centerline };
        let lumen = LumenSettings::default();
        Settings { lumen, centerline: ends, ..settings.clone() }
    }

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
        match request {
            Request::Open(path) => {
                Some(Self::of_case(Source::Image(VolumeSource::file(path)), &settings))
            }
            Request::Series(index) => read(is_mask, &|o| o.series = Some(index.to_string())),
            Request::Segment(name) => read(true, &|o| o.segments = vec![name.clone()]),
            Request::StartAt(at) | Request::EndAt(at) => {
                let mut settings = settings;
                let at = Some(EndPoint::Point(DVec3::from(*at)));
                match request {
                    Request::StartAt(_) => settings.centerline.from = at,
                    _ => settings.centerline.to = at,
                }
                Some(Self { source: None, settings, is_same_volume: true })
            }
            Request::Organ(organ) => {
                Some(Self::with_lumen(&SavedLumen::Organ(*organ), session, settings))
            }
            Request::TaggedColon => {
                let organ = Some(Organ::Colon);
                let tagged = SavedSettings { organ, tagged: true, ..SavedSettings::default() };
                Some(Self::with_lumen(&SavedLumen::Settings(tagged), session, settings))
            }
            Request::Lumen(choice) => {
                Some(Self::with_lumen(&SavedLumen::Range(*choice), session, settings))
            }
            _ => None,
        }
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

    /// The choice as a file gives it back.
    fn read_back(settings: &LumenSettings) -> LumenSettings {
        let saved = SavedLumen::of(settings).expect("it is chosen");
        let json = serde_json::to_string(&saved).unwrap();
        serde_json::from_str::<SavedLumen>(&json).unwrap().settings()
    }

    #[test]
    fn any_choice_of_a_lumen_is_saved_and_read_back() {
        let below = |hi| Some(IntensitySelection::Range { lo: f64::NEG_INFINITY, hi });
        let tagged = OrganOptions { organ: Organ::Colon, tagged: true, thin: true };
        let coarse = OrganOptions { organ: Organ::Airway, tagged: false, thin: false };
        let none = LumenSettings::default;
        let labels = Some(IntensitySelection::Labels(vec![3, 5]));
        for settings in [
            LumenSettings { organ: Some(Organ::Vessel.into()), ..none() },
            LumenSettings { organ: Some(tagged), ..none() },
            LumenSettings { organ: Some(coarse), fill: false, ..none() },
            LumenSettings { select: below(-800.0), ..none() },
            LumenSettings {
                select: below(-500.0),
                seed: Some(Seed::Voxel(UVec3::new(1, 2, 3))),
                leak_control: true,
                ..none()
            },
            LumenSettings {
                select: labels,
                all_components: true,
                wall: WallMethod::Relaxed,
                ..none()
            },
        ] {
            assert_eq!(read_back(&settings), settings);
        }
        assert_eq!(SavedLumen::of(&none()), None, "nobody chose");
        // What a window offers is written as windows before wrote it.
        let choice = LumenChoice { range: [-1000.0, -500.0], seed_mm: Some([1.0, 2.0, 3.0]) };
        let range = SavedLumen::Range(choice);
        assert_eq!(SavedLumen::of(&range.settings()), Some(range));
    }

    /// *Find* while a flight was saved stopped the saving and removed its frames without a word.
    #[test]
    fn whatever_opens_another_volume_or_lumen_is_known_to_end_the_saving_of_a_flight() {
        let choice = LumenChoice { range: [0.0, 1.0], seed_mm: None };
        for request in [
            Request::Open("ct.nrrd".into()),
            Request::Series(0),
            Request::Segment("colon".into()),
            Request::Lumen(choice),
            Request::Organ(Organ::Colon),
            Request::TaggedColon,
            Request::StartAt([0.0; 3]),
            Request::EndAt([0.0; 3]),
        ] {
            let opening = Opening::of(&request, None, &Settings::default(), false);
            assert!(opening.is_some() && request.ends_saving(), "{request:?}");
            let is_same_volume = opening.unwrap().is_same_volume;
            assert_eq!(request.leaves_volume(), !is_same_volume, "{request:?}");
        }
        for request in [Request::Branch(1), Request::FlyThrough([0.0; 3]), Request::Cancel] {
            assert!(!request.ends_saving() && !request.leaves_volume(), "{request:?}");
        }
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

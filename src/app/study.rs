//! A session on a thread of its own: products arrive one after the other, most wanted first.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use glam::DVec3;

use super::action::{LumenChoice, Request};
use crate::flight::{Coverage, Flight, Frames, SectionFigures, WallIndex};
use crate::formats::{InputInfo, ReadOptions, VideoWriter, shown};
use crate::geometry::{CenterlineDistances, TriangleBvh};
use crate::lumen::IntensitySelection;
use crate::render::PreparedMesh;
use crate::session::{
    CancelToken, Centered, CenterlineSettings, Exterior, Fields, FlightRoute, Levels,
    LumenSettings, Progress, Recording, Seed, Segmented, Session, SessionError, Settings, Source,
    VolumeSource, Wall,
};
use crate::volume::Volume;
use crate::wall::Evidence;

/// A product that is there now, or the end.
pub enum News {
    /// The volume the slices show, and the window (level, width) they show it with at first.
    Volume(Arc<Volume>, [f64; 2]),
    /// BLAKE3 of the volume's samples.
    Identity(String),
    /// The lumen.
    Lumen(Arc<Segmented>),
    /// The wall and its vertices as drawn: from here on there is a picture.
    Wall(Arc<Wall>, Arc<PreparedMesh>),
    /// Distances: from here on the eye can be moved by hand.
    Fields(Arc<Fields>),
    /// The path.
    Centerline(Arc<Centered>),
    /// The flight along it, and what it follows.
    Flight(Arc<Flight>, FlightRoute),
    /// The hierarchy of the wall's triangles: from here on the wall can be clicked.
    Tree(Arc<TriangleBvh>),
    /// Distance of the wall's vertices from the centerline, mm.
    Radii(Arc<CenterlineDistances>),
    /// What the wall was drawn on, one a vertex.
    Evidence(Arc<Vec<Evidence>>),
    /// The wall's triangles by place, which proofs of a near plane ask.
    Index(Arc<WallIndex>),
    /// Space outside the wall, by which what the views show of it is found.
    Exterior(Arc<Exterior>),
    /// Cross-sections along the flight, one a pose.
    Sections(Arc<Vec<Option<SectionFigures>>>),
    /// Something to tell the user.
    Said(String),
    /// Levels of detail.
    Levels(Arc<Levels>),
    /// What the flight sees.
    Coverage(Arc<Coverage>),
    /// The series or segments of an input from which one has to be chosen, and whether it is the
    /// mask.
    Contents(Box<InputInfo>, bool),
    /// Nothing more comes, because of this.
    Failed(SessionError),
    /// Everything came.
    Complete,
}

/// What a study is of: a volume, how its lumen is chosen, how each stage works.
#[derive(Clone, Debug)]
pub struct Case {
    /// The volume; `None` before one is opened.
    pub source: Option<Source>,
    /// Lumen and stages.
    pub settings: Settings,
}

/// Another volume, or another lumen of it.
#[derive(Clone, Debug, PartialEq)]
pub enum Change {
    /// Open this file or folder.
    Open(PathBuf),
    /// Of the opened folder, this DICOM series; whether the folder is the mask.
    Series(usize, bool),
    /// Of the opened file, this segment.
    Segment(String),
    /// Of the volume, this lumen.
    Lumen(LumenSettings),
}

impl Change {
    /// What a request changes; nothing where it does not.
    ///
    /// * `is_mask`: whether what has to be chosen from is the mask.
    pub fn of(request: &Request, is_mask: bool) -> Option<Self> {
        let lumen = match request {
            Request::Open(path) => return Some(Self::Open(path.clone())),
            Request::Series(index) => return Some(Self::Series(*index, is_mask)),
            Request::Segment(name) => return Some(Self::Segment(name.clone())),
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
        Some(Self::Lumen(lumen))
    }
}

impl Case {
    /// Makes a change.
    ///
    /// * `volume`: the one that is there, which need not be read again for another lumen.
    pub fn change(&mut self, change: Change, volume: Option<Arc<Volume>>) {
        match change {
            Change::Open(path) => self.open(path),
            Change::Series(index, is_mask) => {
                self.with_options(is_mask, |o| o.series = Some(index.to_string()));
            }
            Change::Segment(name) => self.with_options(true, |o| o.segments = vec![name]),
            Change::Lumen(lumen) => {
                if let Some(volume) = volume {
                    self.source = Some(Source::Image(VolumeSource::Memory(volume)));
                }
                self.settings.lumen = lumen;
            }
        }
    }

    /// Another choice of what is read of the same file: of the mask, or of the image. Segments are a
    /// mask's, and an image's where there is none.
    fn with_options(&mut self, is_mask: bool, set: impl FnOnce(&mut ReadOptions)) {
        let volume = match &mut self.source {
            Some(Source::Image(image)) => Some(image),
            Some(Source::Mask { mask, .. }) if is_mask => Some(mask),
            Some(Source::Mask { image, .. }) => image.as_mut(),
            None => None,
        };
        if let Some(VolumeSource::File { options, .. }) = volume {
            set(options);
        }
    }

    /// Another volume, whose lumen is not chosen yet.
    fn open(&mut self, path: PathBuf) {
        self.source = Some(Source::Image(VolumeSource::file(path)));
        self.settings.lumen = LumenSettings::default();
        let ends = CenterlineSettings { from: None, to: None, ..self.settings.centerline };
        self.settings.centerline = ends;
    }

    /// Begins to compute it; `None` without a volume.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn begin(
        &self,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Option<Study>, SessionError> {
        let Some(source) = self.source.clone() else { return Ok(None) };
        let session = Session::new(source, self.settings.clone())?;
        Study::begin(session, wake).map(Some)
    }
}

/// A session at work.
pub struct Study {
    session: Arc<Session>,
    news: Receiver<News>,
    sender: Sender<News>,
    wake: Arc<dyn Fn() + Send + Sync>,
    cancel: CancelToken,
    threads: Vec<JoinHandle<()>>,
}

impl Study {
    /// Starts a session's products.
    ///
    /// * `wake`: called on the study's thread after each piece of news.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn begin(
        mut session: Session,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, SessionError> {
        session.keep_volume();
        let (sender, news) = channel();
        let cancel = session.cancel_token();
        let session = Arc::new(session);
        let wake: Arc<dyn Fn() + Send + Sync> = Arc::new(wake);
        let mut study = Self { session, news, sender, wake, cancel, threads: Vec::new() };
        study.spawn("study", |session, tell| {
            let last = match each_product(session, tell) {
                Ok(()) => News::Complete,
                Err(e) => {
                    if let Some((info, is_mask)) = session.contents(&e) {
                        tell(News::Contents(Box::new(info), is_mask));
                    }
                    News::Failed(e)
                }
            };
            tell(last);
        })?;
        Ok(study)
    }

    /// Does something on a thread of its own; `tell` answers whether anybody still listens.
    fn spawn(
        &mut self,
        name: &str,
        work: impl FnOnce(&Session, &dyn Fn(News) -> bool) + Send + 'static,
    ) -> Result<(), SessionError> {
        let session = Arc::clone(&self.session);
        let (sender, wake) = (self.sender.clone(), Arc::clone(&self.wake));
        let work = move || {
            work(&session, &|n| {
                let sent = sender.send(n).is_ok();
                wake();
                sent
            });
        };
        self.threads.retain(|t| !t.is_finished());
        let thread = std::thread::Builder::new()
            .name(name.into())
            .spawn(work)
            .map_err(|e| SessionError::System(e.to_string()))?;
        self.threads.push(thread);
        Ok(())
    }

    /// Plans another flight along the centerline; it comes as news.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn fly_along(&mut self, route: FlightRoute) -> Result<(), SessionError> {
        self.spawn("flight", move |session, tell| {
            let flown = || {
                let flight = Arc::new(session.flight_along(route)?);
                let sections = Arc::new(session.sections_along(&flight)?);
                tell(News::Flight(flight, route));
                tell(News::Sections(sections));
                Ok::<_, SessionError>(())
            };
            if let Err(e) = flown() {
                tell(News::Said(format!("no flight along that branch: {e}")));
            }
        })
    }

    /// Draws the flight and writes it; where it is, or why not, comes as news.
    ///
    /// * `folder`: gets `flight/` with the frames and, where there is ffmpeg, `flight.mp4`.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn export_flight(&mut self, folder: PathBuf) -> Result<(), SessionError> {
        self.spawn("export", move |session, tell| {
            let Frames::Speed { fps, .. } = session.settings().flight.frames else { return };
            let video = VideoWriter::available().then(|| (folder.join("flight.mp4"), fps));
            let has_video = video.is_some();
            let frames = folder.join("flight");
            let to = Recording { frames: frames.clone(), video, camera_path: None };
            let said = match session.record(&to) {
                Ok(stream) => {
                    let n = stream.report().count;
                    let what = if has_video { " and flight.mp4" } else { "; no ffmpeg, no video" };
                    format!("wrote {n} frames to {}{what}", shown(&frames))
                }
                Err(e) => format!("the flight is not written: {e}"),
            };
            tell(News::Said(said));
        })
    }

    /// The next piece of news, if there is one. Never waits.
    pub fn poll(&self) -> Option<News> {
        self.news.try_recv().ok()
    }

    /// Waits for the next piece of news; `None` after the last, or when the time is over.
    pub fn wait(&self, most: Duration) -> Option<News> {
        self.news.recv_timeout(most).ok()
    }

    /// How far it has come.
    pub fn progress(&self) -> Progress {
        self.session.progress()
    }

    /// Stops it; what is there stays.
    pub fn cancel(&self) {
        self.cancel.cancel();
    }
}

impl Drop for Study {
    fn drop(&mut self) {
        self.cancel();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Asks for product after product; `tell` answers whether anybody still listens.
fn each_product(session: &Session, tell: &dyn Fn(News) -> bool) -> Result<(), SessionError> {
    let volume = session.volume()?;
    let route = session.settings().flight.route;
    let listens = tell(News::Volume(Arc::clone(&volume), default_window(&volume)))
        && tell(News::Lumen(session.lumen()?))
        && tell(News::Wall(session.wall()?, session.prepared_wall()?))
        && evidence(session)?.is_none_or(|e| tell(News::Evidence(Arc::new(e))))
        && tell(News::Identity(session.identity()?.to_string()))
        && tell(News::Index(session.wall_index()?))
        && tell(News::Tree(session.triangle_tree()?))
        && tell(News::Exterior(session.exterior()?))
        && tell(News::Fields(session.fields()?))
        && tell(News::Centerline(session.centerline()?))
        && tell(News::Flight(session.flight()?, route))
        && tell(News::Levels(session.levels()?))
        && tell(News::Sections(session.sections()?))
        && tell(News::Radii(session.centerline_distances()?))
        && tell(News::Coverage(session.coverage()?));
    if listens { Ok(()) } else { Err(SessionError::Cancelled) }
}

/// What the wall was drawn on; `None` where it does not follow grey values.
fn evidence(session: &Session) -> Result<Option<Vec<Evidence>>, SessionError> {
    Ok(session.evidence()?.as_ref().clone())
}

/// Grey values of slices to begin with: gas, soft tissue and bone of a CT; what is there otherwise.
fn default_window(volume: &Volume) -> [f64; 2] {
    let (low, high) = volume.range().unwrap_or((0.0, 1.0));
    if low < -500.0 { [-200.0, 1800.0] } else { [0.5 * (low + high), (high - low).max(1.0)] }
}

//! State of the window: the eye, the view, bookmarks and measurements. No drawing here and
//! no input devices: panels and scripts alike send [`Action`]s, and [`Model::step`] carries them out.

mod beside;
mod cine;
mod history;
mod missed;
mod moves;
mod notes;
mod outcome;
mod path;
mod restored;
mod route;
mod sliced;
mod speedometer;

pub use missed::MissedMark;
pub use restored::{SavedEye, SavedView};
pub use route::WayTo;
#[cfg(test)]
pub(super) use sliced::tests::flown_model;

use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::action::{
    Action, Colouring, FOV_DEG, Pane, PaneLayout, Request, Ruler, SLAB_MM, SPEED_MM_S, SlabMode,
    SliceExtent, WallView,
};
use super::coverage_recorder::SeenFaces;
use super::finding::{Confidence, LesionShape};
use super::grey_window::default_window;
use super::junctions::BranchChoice;
use super::kept_notes::{KeptOffer, RecentCase};
use super::measure::Measurement;
use crate::flight::CrossSection;
use crate::flight::{Coverage, Flight, FlightPath, NoSection};
use crate::formats::InputInfo;
use crate::geometry::Pose;
use crate::organ::{ColonEnds, Glance, Organ};
use crate::render::Framing;
use crate::session::{FlightRoute, Product, Products};
use crate::volume::Volume;
use crate::wall::Evidence;
use cine::Cine;
use history::History;
use speedometer::Speedometer;

/// A noted place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bookmark {
    /// A remark.
    pub text: String,
    /// The eye, LPS mm.
    pub position_mm: [f64; 3],
    /// World from camera, unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
    /// Vertical field of view, degrees.
    pub fov_deg: f32,
    /// Millimetres along the path, where the eye was on it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arc_mm: Option<f64>,
    /// Name of its picture, in the folder of the session file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<String>,
    /// The picture itself, PNG.
    #[serde(skip)]
    pub png: Option<Arc<Vec<u8>>>,
    /// Number that tells it from others, and by which measurements name it; 0 where it has none yet.
    #[serde(default)]
    pub id: u64,
    /// Place of the wall in the middle of the view, LPS mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_mm: Option<[f64; 3]>,
    /// Segment of the organ, or name of the branch, as the reader calls it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub segment: Option<String>,
    /// Form of the lesion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<LesionShape>,
    /// Confidence of the reader.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confidence: Option<Confidence>,
    /// Whether the flight looks at it in passing.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub in_flight: bool,
}

impl Bookmark {
    /// Without its picture: what it says.
    pub(super) fn plain(&self) -> Self {
        Self { picture: None, png: None, ..self.clone() }
    }
}

/// Largest centre and width of the grey values' window: what a panel has room for.
const MAX_VALUE: f64 = 1e7;

/// State of the window.
#[derive(Default)]
pub struct Model {
    /// Products of the session, as they were read last.
    pub products: Products,
    /// The flight by length.
    pub path: Option<FlightPath>,
    /// The eye; `None` before there is a place for it.
    pub pose: Option<Pose>,
    /// Near plane at the eye, mm, proven not to cut the wall.
    pub near_mm: f32,
    /// Vertical field of view, degrees.
    pub fov_deg: f32,
    /// Millimetres from the start of the path: of the eye, or of where it left the path.
    pub arc_mm: f64,
    /// Whether the eye is on the path.
    pub on_path: bool,
    /// Whether it flies.
    pub playing: bool,
    /// Whether the flight goes towards the start.
    pub reverse: bool,
    /// Cruising speed, mm/s.
    pub speed_mm_s: f64,
    /// Place where the slices cross, LPS mm.
    pub crosshair_mm: DVec3,
    /// Plane along a finding, which takes the place of that across the path while the crosshair is
    /// there.
    along_finding: Option<Pose>,
    /// Part of the volume that slices show.
    pub extent: SliceExtent,
    /// Number of times that the slices were led to a place: they are centred on it.
    pub centred: u64,
    /// Whether crosshair and grey window are those of the volume that comes: it was open before.
    keeps_slices: bool,
    /// Longest side of the lumen's box, mm.
    lumen_side_mm: Option<f64>,
    /// Side from which the overview shows the organ, and how near.
    pub framing: Framing,
    /// Whether that side was chosen by someone.
    is_framed: bool,
    /// Corners of the wall's box, LPS mm.
    wall_bounds: Option<(Vec3, Vec3)>,
    /// Centre and width of the slices' grey values.
    pub window: [f64; 2],
    /// What thick slices show; thin ones where `None`.
    pub slab: Option<SlabMode>,
    /// Thickness of thick slices, mm.
    pub slab_mm: f64,
    /// The pane that fills the window.
    pub maximised: Option<Pane>,
    /// Arrangement of the panes.
    pub layout: PaneLayout,
    /// The slice that is shown large.
    pub large_slice: Pane,
    /// Whether the panel on the right is hidden.
    pub hides_panel: bool,
    /// Where the notes are, in a few words.
    pub notes_are: &'static str,
    /// Noted places.
    pub bookmarks: Vec<Bookmark>,
    /// Number of the noted place that is looked at, by its place in the list.
    pub selected: Option<usize>,
    /// Tells the notes of this window from the same ones of another.
    window_number: u64,
    /// Number of changes of the notes, and of those that the user's file has.
    notes_version: u64,
    saved_version: u64,
    /// Notes as they were before the changes that can be taken back.
    history: History,
    /// Coverage of the path that is flown, once it is known.
    pub coverage: Option<Arc<Coverage>>,
    /// The flight along a branch, where that is flown.
    branch_flight: Option<Arc<Flight>>,
    /// Whether the coverage of that flight is still to be computed.
    is_uncovered: bool,
    /// Faces of the missed patches, each with its patch and its area, mm².
    missed_faces: Vec<(u32, u32, f32)>,
    /// Missed patch that was asked for last.
    pub missed: Option<MissedMark>,
    /// Slices that are shown one after another.
    cine: Option<Cine>,
    /// Place on the path that the eye flies to, mm from the start.
    goal_mm: Option<f64>,
    /// Place that the eye looks at once it is there, LPS mm.
    gaze_mm: Option<DVec3>,
    /// Place that a branch is taken for, LPS mm.
    way_goes_on_to: Option<(FlightRoute, DVec3)>,
    /// The way that was set out on last.
    pub way: Option<WayTo>,
    /// Place on the path to begin at, mm, once there is one.
    start_mm: f64,
    /// View of a session file whose eye waits for its path.
    restoring: Option<SavedView>,
    /// Route that the path was, or will be, made of.
    pub route: FlightRoute,
    /// The path is the flight of the session's settings.
    is_planned_path: bool,
    /// Names of the ends of the path, of a colon.
    pub ends: Option<ColonEnds>,
    /// Whether the path of the session's settings begins at the rectum, if someone has said so.
    pub(super) rectum_at_start: Option<bool>,
    /// Branches that can be taken, along the path.
    pub choices: Vec<BranchChoice>,
    /// Projection of the inside pane.
    pub view: WallView,
    /// Quantity that colours the wall.
    pub colouring: Colouring,
    /// Opacity of the overview's wall: 0 none, 1 as glass, 2 solid.
    pub opacity: f32,
    /// Whether the local contrast of the inside view is raised.
    pub local_contrast: bool,
    /// Ruler of the measurement in progress.
    pub ruler: Option<Ruler>,
    /// Points of the measurement in progress, LPS mm.
    pub marks_mm: Vec<DVec3>,
    /// Finished measurements.
    pub measurements: Vec<Measurement>,
    /// Part of the wall that the inside view has shown.
    pub seen: SeenFaces,
    /// Number of changes of `shown`.
    pub seen_version: u64,
    /// The cross-section of the lumen at the eye, across the path; before there is one across the
    /// view. `None` where the plane runs along the lumen.
    pub section: Option<CrossSection>,
    /// Reason why there is no section, where the wall was cut.
    pub no_section: Option<NoSection>,
    /// Whether the keys are shown.
    pub help: bool,
    /// Request that waits for the answer whether notes are to be saved before.
    pub leaving: Option<Request>,
    /// Whether the notes are kept for the next time, if in no file of the user's.
    pub are_notes_kept: bool,
    /// Notes of this volume from before, which can be taken.
    pub kept_offer: Option<KeptOffer>,
    /// Cases that were opened before.
    pub recent: Vec<RecentCase>,
    /// Whether that request would leave notes that are in no file of the user's.
    pub leaves_notes: bool,
    /// Whether that request would end a flight that is being saved.
    pub leaves_flight: bool,
    /// The last message to the user.
    pub message: Option<String>,
    /// Reason why nothing more is computed.
    pub failure: Option<String>,
    /// Choice that has to be made before anything more is computed.
    pub question: Option<&'static str>,
    /// Part of a patient and organs that the volume seems to show.
    pub glance: Option<Glance>,
    /// Organ that was found where none was asked for.
    found: Option<Organ>,
    /// Series or segments of the input, where one has to be chosen, and whether that input is the
    /// mask.
    pub contents: Option<(InputInfo, bool)>,
    /// Whether everything is computed.
    pub is_complete: bool,
    /// Whether the computation was stopped before its end; it can go on.
    pub is_stopped: bool,
    /// Width over height of the inside view.
    pub aspect: f32,
    /// Speed the flight was planned with, mm/s.
    planned_mm_s: f64,
    /// Speed of the eye as it is flown.
    speedometer: Speedometer,
    /// Whether the panels of the last frame, laid out before its step, showed a speed.
    showed_speed: bool,
}

impl Model {
    /// Nothing yet.
    ///
    /// * `planned_mm_s`: cruising speed of the session's flight.
    pub fn new(planned_mm_s: f64) -> Self {
        Self {
            near_mm: moves::NEAR_MM,
            fov_deg: 90.0,
            on_path: true,
            speed_mm_s: planned_mm_s,
            window: [0.0, 1.0],
            slab_mm: 10.0,
            opacity: 1.0,
            aspect: 4.0 / 3.0,
            planned_mm_s,
            ..Self::default()
        }
    }

    /// Nothing yet but the cases that were opened before.
    ///
    /// * `window_number`: of no other window; scripts have the same notes at each play.
    pub(super) fn of_window(
        planned_mm_s: f64,
        recent: Vec<RecentCase>,
        window_number: u64,
    ) -> Self {
        Self { recent, window_number, ..Self::new(planned_mm_s) }
    }

    /// A model of another volume; how the window shows it stays.
    pub fn reset(&self) -> Self {
        let (aspect, fov_deg) = (self.aspect, self.fov_deg);
        Self {
            aspect,
            fov_deg,
            view: self.view,
            local_contrast: self.local_contrast,
            layout: self.layout,
            large_slice: self.large_slice,
            hides_panel: self.hides_panel,
            slab: self.slab,
            slab_mm: self.slab_mm,
            recent: self.recent.clone(),
            window_number: self.window_number,
            ..Self::new(self.planned_mm_s)
        }
    }

    /// A model of another lumen of the same volume. Notes stay as they are: a finding's length along the
    /// path counts only where the present path passes there.
    pub fn reset_lumen(&self) -> Self {
        let (bookmarks, measurements) = (self.bookmarks.clone(), self.measurements.clone());
        let (notes_version, saved_version) = (self.notes_version, self.saved_version);
        let (window, extent) = (self.window, self.extent);
        Self {
            bookmarks,
            measurements,
            notes_version,
            saved_version,
            kept_offer: self.kept_offer.clone(),
            selected: self.selected,
            history: self.history.clone(),
            crosshair_mm: self.crosshair_mm,
            keeps_slices: self.volume().is_some(),
            window,
            extent,
            ..self.reset()
        }
    }

    /// Takes in newer coverage of the wall by the inside view.
    pub fn set_seen(&mut self, seen: SeenFaces) {
        self.seen = seen;
        self.seen_version += 1;
    }

    /// The volume, once it is known how its values are shown.
    pub fn volume(&self) -> Option<&Arc<Volume>> {
        self.products.volume().filter(|_| self.products.value_range.is_some())
    }

    /// Smallest and largest value of the volume.
    pub fn value_range(&self) -> (f64, f64) {
        self.products.value_range.as_deref().copied().flatten().unwrap_or((0.0, 1.0))
    }

    /// Evidence for the wall at each vertex, where the wall follows grey values.
    pub fn evidence(&self) -> Option<&[Evidence]> {
        self.products.evidence.as_ref()?.as_deref()
    }

    /// Takes in what there is of the session's products, and does what waited for them.
    pub fn update(&mut self, products: Products) {
        let had = std::mem::replace(&mut self.products, products);
        let is_there = |p: &Product| self.products.has(*p);
        let came = |of: &[Product]| of.iter().all(is_there) && !of.iter().all(|p| had.has(*p));
        let volume_came = came(&[Product::Volume, Product::ValueRange]);
        let lumen_came = came(&[Product::Lumen]);
        let wall_came = came(&[Product::Wall]);
        let line_came = came(&[Product::Centerline]);
        let fields_came = came(&[Product::Fields, Product::TriangleTree]);
        let sections_came = came(&[Product::Sections]);
        let coverage_came = came(&[Product::Coverage, Product::Wall]);
        let is_new = volume_came && !std::mem::take(&mut self.keeps_slices);
        if let Some(volume) = self.volume().filter(|_| is_new) {
            let middle = 0.5 * (volume.grid.dims.as_dvec3() - 1.0);
            self.crosshair_mm = volume.grid.world_from_voxel().transform_point3(middle);
            self.window = default_window(self.value_range());
        }
        if let Some(lumen) = self.products.lumen.as_ref().filter(|_| lumen_came) {
            self.lumen_side_mm = sliced::longest_side_mm(&lumen.lumen);
        }
        if coverage_came && (self.is_planned_path || self.path.is_none()) {
            self.set_coverage(self.products.coverage.clone());
        }
        if wall_came {
            self.wall_bounds = self.products.wall.as_ref().and_then(|w| w.mesh.bounds());
        }
        if fields_came {
            self.stand_in_the_widest_place();
        }
        if let Some(centered) = self.products.centerline.as_ref().filter(|_| line_came)
            && !self.is_framed
        {
            let points = centered.line.branches.iter().flat_map(|b| &b.points);
            self.framing = Framing::of_path(points.map(|p| p.position_mm));
        }
        if let (None, Some(flight)) = (&self.path, self.products.flight.clone()) {
            self.set_path(&flight, self.route);
            self.is_planned_path = true;
        }
        if let Some(sections) = self.products.sections.clone().filter(|_| sections_came)
            && self.is_planned_path
        {
            self.set_sections(&sections);
        }
        self.restore_eye();
    }

    /// Before there is a path, the eye is where the wall is farthest.
    fn stand_in_the_widest_place(&mut self) {
        let (Some(lumen), Some(fields)) = (&self.products.lumen, &self.products.fields) else {
            return;
        };
        let d = &fields.distance;
        let deepest = (0..d.len()).max_by(|a, b| d[*a].total_cmp(&d[*b]).then(b.cmp(a)));
        let Some(deepest) = deepest.filter(|_| self.pose.is_none()) else { return };
        let voxel = lumen.lumen.bricks.voxel(deepest).as_dvec3();
        let at = lumen.lumen.grid.world_from_voxel().transform_point3(voxel);
        self.place(Pose::looking(at.as_vec3(), Vec3::Z, Vec3::NEG_Y));
    }

    /// Whether there are changes of the notes that no file of the user's has.
    pub fn has_unsaved_notes(&self) -> bool {
        self.notes_version != self.saved_version
    }

    /// Number of changes of the notes.
    pub(super) fn notes_version(&self) -> u64 {
        self.notes_version
    }

    /// A file has the notes as they are now.
    pub fn notes_saved(&mut self) {
        self.saved_version = self.notes_version;
    }

    fn notes_changed(&mut self) {
        self.notes_version += 1;
    }

    /// Whether the last frame belonged to a drag, or to a text that is typed.
    pub(super) fn is_in_gesture(&self) -> bool {
        self.history.is_in_gesture()
    }

    /// Forgets notes and what led to them, before those of a file take their place.
    pub(super) fn forget_notes(&mut self) {
        self.bookmarks.clear();
        self.measurements.clear();
        (self.selected, self.kept_offer, self.history) = Default::default();
    }

    /// Carries out actions, then lets `dt` seconds pass.
    pub fn step(&mut self, dt: f64, actions: &[Action]) {
        self.showed_speed = self.flown_mm_s().is_some();
        for action in actions {
            self.act_with_history(action);
        }
        self.history.end_of_frame(actions);
        if dt > 0.0 && self.goal_mm.is_some() {
            self.approach_goal(dt);
        } else if self.playing && dt > 0.0 {
            self.play(dt);
        }
        if dt > 0.0 {
            self.speedometer.pass(dt);
            self.pass_cine(dt);
        }
    }

    fn act(&mut self, action: &Action) {
        match action {
            Action::TogglePlay => self.toggle_play(),
            Action::Reverse => self.reverse = !self.reverse,
            Action::Speed(v) if v.is_finite() => {
                self.speed_mm_s = v.clamp(*SPEED_MM_S.start(), *SPEED_MM_S.end());
            }
            Action::Travel(mm) => self.fly_along(self.arc_mm + mm, self.playing),
            Action::Seek(mm) => self.seek(*mm),
            Action::Fly(by) => self.fly(DVec3::from(*by)),
            Action::Turn([right, up, roll]) => {
                (self.playing, self.goal_mm, self.gaze_mm) = (false, None, None);
                if let Some(pose) = self.pose {
                    let turn = Quat::from_rotation_y(-right)
                        * Quat::from_rotation_x(*up)
                        * Quat::from_rotation_z(-roll);
                    let rotation = (pose.rotation * turn).normalize();
                    if rotation.is_finite() {
                        self.on_path = false;
                        self.place(Pose { rotation, ..pose });
                    }
                }
            }
            Action::FieldOfView(deg) if deg.is_finite() => {
                self.fov_deg = deg.clamp(*FOV_DEG.start(), *FOV_DEG.end());
                self.pose.into_iter().for_each(|p| self.place(p));
            }
            Action::BackToPath => {
                self.on_path = true;
                let near = self.pose.map(|p| p.position_mm.as_dvec3());
                if let (Some(path), Some(p)) = (&self.path, near) {
                    self.seek(path.nearest_to(p));
                }
            }
            Action::GoNear(p) if DVec3::from(*p).is_finite() => {
                let near = self.path.as_ref().map(|path| path.nearest_to(DVec3::from(*p)));
                near.into_iter().for_each(|arc| self.fly_to(arc));
            }
            Action::FlyTo(arc) => self.fly_to(*arc),
            Action::LookAt(p) if DVec3::from(*p).is_finite() => self.look_at(DVec3::from(*p)),
            Action::ShowInSlices(p) if DVec3::from(*p).is_finite() => {
                self.show_in_slices(DVec3::from(*p));
            }
            Action::Extent(extent) => self.set_extent(*extent),
            Action::View(view) => self.view = *view,
            Action::Colour(colouring) => self.colouring = *colouring,
            Action::LocalContrast(raised) => self.local_contrast = *raised,
            Action::Opacity(o) if o.is_finite() => self.opacity = o.clamp(0.0, 2.0),
            Action::Measure(ruler) => {
                self.ruler = *ruler;
                self.marks_mm.clear();
            }
            Action::Mark(p) if DVec3::from(*p).is_finite() => self.mark(DVec3::from(*p), false),
            Action::MarkInSlice(p) if DVec3::from(*p).is_finite() => {
                self.mark(DVec3::from(*p), true);
            }
            Action::NameMeasurement(i, name) => self.name_measurement(*i, name),
            Action::MoveMark { measurement, point, to } if DVec3::from(*to).is_finite() => {
                self.move_mark(*measurement, *point, *to);
            }
            Action::RemoveMeasurement(i) if *i < self.measurements.len() => {
                self.measurements.remove(*i);
                self.notes_changed();
            }
            Action::Orbit([about, tilt]) if about.is_finite() && tilt.is_finite() => {
                let full = std::f32::consts::TAU;
                let upright = std::f32::consts::FRAC_PI_2;
                self.framing.orbit[0] = (self.framing.orbit[0] + about).rem_euclid(full);
                self.is_framed = true;
                self.framing.orbit[1] = (self.framing.orbit[1] + tilt).clamp(-upright, upright);
            }
            Action::Frame { zoom, pan_mm } if pan_mm.iter().all(|v| v.is_finite()) => {
                self.frame_overview(*zoom, *pan_mm);
            }
            Action::Crosshair(p) if DVec3::from(*p).is_finite() => {
                self.crosshair_mm = DVec3::from(*p);
            }
            Action::Window([centre, width]) if centre.is_finite() && width.is_finite() => {
                self.window = [centre.clamp(-MAX_VALUE, MAX_VALUE), width.clamp(1e-3, MAX_VALUE)];
            }
            Action::Slab(mode) => self.slab = *mode,
            Action::SlabThickness(mm) if mm.is_finite() => {
                self.slab_mm = mm.clamp(*SLAB_MM.start(), *SLAB_MM.end());
            }
            Action::Cine(runs) => self.run_cine(*runs),
            Action::Maximise(pane) => self.maximised = *pane,
            Action::Layout(layout) => (self.layout, self.maximised) = (*layout, None),
            Action::LargeSlice(pane) if Pane::SLICES.contains(pane) => self.large_slice = *pane,
            Action::TogglePanel => self.hides_panel = !self.hides_panel,
            Action::RectumAtStart(at_start) => self.set_rectum_at_start(*at_start),
            Action::Bookmark(text) => self.bookmark(text),
            Action::RemoveBookmark(i) if *i < self.bookmarks.len() => self.remove_bookmark(*i),
            Action::SelectFinding(i) => self.selected = i.filter(|i| *i < self.bookmarks.len()),
            Action::MeasureInSlice(i) => self.measure_in_slice(*i),
            Action::MeasureFinding(i) => self.measure_finding(*i),
            Action::EditFinding(i, edit) => self.edit_finding(*i, edit),
            Action::NextFinding => self.go_to_finding_beside(1),
            Action::PreviousFinding => self.go_to_finding_beside(-1),
            Action::GoToBookmark(i) => self.go_to_bookmark(*i),
            Action::NextMissed => self.go_to_missed_beside(1),
            Action::PreviousMissed => self.go_to_missed_beside(-1),
            Action::GoToMissed(patch) => self.go_to_missed(*patch),
            Action::HideMissed => self.missed = None,
            Action::ToggleHelp => self.help = !self.help,
            Action::Stay => self.leaving = None,
            // Numbers that are none.
            _ => {}
        }
    }
}

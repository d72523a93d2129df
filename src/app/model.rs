//! What the window is about: where the eye is, what is shown, what was noted. No drawing here and
//! no input devices: panels and scripts alike send [`Action`]s, and [`Model::step`] carries them out.

mod moves;
mod notes;

use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::action::{Action, Colouring, FOV_DEG, Pane, Ruler, SPEED_MM_S, WallView};
use super::junctions::{Choice, choices};
use super::measure::Measurement;
use super::painter::Shown;
use super::study::News;
use crate::flight::{Coverage, Flight, FlightPath, WallIndex};
use crate::formats::InputInfo;
use crate::geometry::{CenterlineDistances, CrossSection, Pose, TriangleBvh};
use crate::render::PreparedMesh;
use crate::session::{Centered, Exterior, Fields, FlightRoute, Levels, Segmented, Wall};
use crate::volume::Volume;
use crate::wall::Evidence;

/// A noted place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bookmark {
    /// What was said of it.
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
}

/// Products that have come so far.
#[derive(Default)]
pub struct Products {
    /// What the slices show.
    pub volume: Option<Arc<Volume>>,
    /// The lumen.
    pub lumen: Option<Arc<Segmented>>,
    /// The wall.
    pub wall: Option<Arc<Wall>>,
    /// Its vertices as drawn.
    pub drawn_wall: Option<Arc<PreparedMesh>>,
    /// Distances to the wall.
    pub fields: Option<Arc<Fields>>,
    /// The path.
    pub centerline: Option<Arc<Centered>>,
    /// Levels of detail.
    pub levels: Option<Arc<Levels>>,
    /// What the flight sees.
    pub coverage: Option<Arc<Coverage>>,
    /// The hierarchy of the wall's triangles.
    pub tree: Option<Arc<TriangleBvh>>,
    /// The wall's triangles in buckets.
    pub wall_index: Option<Arc<WallIndex>>,
    /// Space outside the wall.
    pub exterior: Option<Arc<Exterior>>,
    /// Distances of the wall's vertices from the centerline.
    pub radii: Option<Arc<CenterlineDistances>>,
    /// What the wall was drawn on at each vertex, where it follows grey values.
    pub evidence: Option<Arc<Vec<Evidence>>>,
}

/// State of the window.
pub struct Model {
    /// What there is.
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
    /// Whether towards the start.
    pub reverse: bool,
    /// Cruising speed, mm/s.
    pub speed_mm_s: f64,
    /// Where the slices cross, LPS mm.
    pub crosshair_mm: DVec3,
    /// How far the overview is turned, radians: zero is from in front of the patient.
    pub orbit: [f32; 2],
    /// Centre and width of the slices' grey values.
    pub window: [f64; 2],
    /// The pane that fills the window.
    pub maximised: Option<Pane>,
    /// Noted places.
    pub bookmarks: Vec<Bookmark>,
    /// Bookmarks were made or forgotten since they were saved.
    unsaved: bool,
    /// Missed patches that were visited, by their rank.
    visited: Vec<usize>,
    /// Where the eye flies to along the path, mm from its start.
    goal_mm: Option<f64>,
    /// What the path was made of.
    pub route: FlightRoute,
    /// Branches that can be taken, along the path.
    pub choices: Vec<Choice>,
    /// How the inside pane shows the wall.
    pub view: WallView,
    /// What colours the wall.
    pub colouring: Colouring,
    /// Of the overview's wall: 0 none, 1 as glass, 2 solid.
    pub opacity: f32,
    /// What is being measured.
    pub ruler: Option<Ruler>,
    /// Its points so far, LPS mm.
    pub marks_mm: Vec<DVec3>,
    /// What was measured.
    pub measurements: Vec<Measurement>,
    /// What the inside view has shown of the wall.
    pub shown: Shown,
    /// Counts changes of it.
    pub shown_version: u64,
    /// The cross-section of the lumen at the eye: across the path, or across the view off it.
    pub section: Option<CrossSection>,
    /// Whether the keys are shown.
    pub help: bool,
    /// BLAKE3 of the volume's samples.
    pub identity: Option<String>,
    /// What was last said to the user.
    pub message: Option<String>,
    /// Why nothing more is computed.
    pub failure: Option<String>,
    /// Series or segments of the input, where one has to be chosen.
    pub contents: Option<InputInfo>,
    /// Whether that input is the mask.
    pub contents_of_mask: bool,
    /// Everything is computed.
    pub is_complete: bool,
    /// Width over height of the inside view.
    pub aspect: f32,
    /// Speed the flight was planned with, mm/s.
    planned_mm_s: f64,
}

impl Model {
    /// Nothing yet.
    ///
    /// * `planned_mm_s`: cruising speed of the session's flight.
    pub fn new(planned_mm_s: f64) -> Self {
        Self {
            products: Products::default(),
            path: None,
            pose: None,
            near_mm: moves::NEAR_MM,
            fov_deg: 90.0,
            arc_mm: 0.0,
            on_path: true,
            playing: false,
            reverse: false,
            speed_mm_s: planned_mm_s,
            crosshair_mm: DVec3::ZERO,
            orbit: [0.0; 2],
            window: [0.0, 1.0],
            maximised: None,
            bookmarks: Vec::new(),
            unsaved: false,
            visited: Vec::new(),
            goal_mm: None,
            route: FlightRoute::Trunk,
            choices: Vec::new(),
            view: WallView::Eye,
            colouring: Colouring::Tissue,
            opacity: 1.0,
            ruler: None,
            marks_mm: Vec::new(),
            measurements: Vec::new(),
            shown: Shown::default(),
            shown_version: 0,
            section: None,
            help: false,
            identity: None,
            message: None,
            failure: None,
            contents: None,
            contents_of_mask: false,
            is_complete: false,
            aspect: 4.0 / 3.0,
            planned_mm_s,
        }
    }

    /// Nothing of another volume; how the window shows it stays.
    pub fn anew(&self) -> Self {
        let (aspect, fov_deg) = (self.aspect, self.fov_deg);
        Self { aspect, fov_deg, view: self.view, ..Self::new(self.planned_mm_s) }
    }

    /// Takes in newer coverage of the wall.
    pub fn take_shown(&mut self, shown: Shown) {
        self.shown = shown;
        self.shown_version += 1;
    }

    /// Takes a product in.
    pub fn learn(&mut self, news: News) {
        let p = &mut self.products;
        match news {
            News::Volume(volume, window) => {
                self.window = window;
                let middle = 0.5 * (volume.grid.dims.as_dvec3() - 1.0);
                self.crosshair_mm = volume.grid.world_from_voxel().transform_point3(middle);
                p.volume = Some(volume);
            }
            News::Identity(identity) => self.identity = Some(identity),
            News::Lumen(lumen) => p.lumen = Some(lumen),
            News::Wall(wall, drawn) => (p.wall, p.drawn_wall) = (Some(wall), Some(drawn)),
            News::Tree(tree) => p.tree = Some(tree),
            News::Radii(radii) => p.radii = Some(radii),
            News::Evidence(evidence) => p.evidence = Some(evidence),
            News::Index(index) => p.wall_index = Some(index),
            News::Exterior(exterior) => p.exterior = Some(exterior),
            News::Sections(sections) => {
                self.path.iter_mut().for_each(|p| p.set_sections(&sections));
            }
            News::Fields(fields) => {
                p.fields = Some(fields);
                self.stand_in_the_widest_place();
            }
            News::Centerline(centerline) => p.centerline = Some(centerline),
            News::Flight(flight, route) => self.take_flight(&flight, route),
            News::Said(text) => self.message = Some(text),
            News::Levels(levels) => p.levels = Some(levels),
            News::Coverage(coverage) => p.coverage = Some(coverage),
            News::Contents(info, of_mask) => {
                (self.contents, self.contents_of_mask) = (Some(*info), of_mask);
            }
            News::Failed(crate::session::SessionError::Cancelled) => {
                self.message = Some("stopped; what is there stays".into());
                self.is_complete = true;
            }
            News::Failed(e) => {
                self.failure = Some(e.to_string());
                self.is_complete = true;
            }
            News::Complete => self.is_complete = true,
        }
    }

    /// Takes a flight in; of another one along the same centerline the eye keeps its place.
    fn take_flight(&mut self, flight: &Flight, route: FlightRoute) {
        let Some(centerline) = self.products.centerline.clone() else { return };
        let Some(path) = FlightPath::new(flight, &centerline.line) else { return };
        let stays = self.pose.filter(|_| self.path.is_some());
        let start = stays.map_or(0.0, |p| path.nearest_to(p.position_mm.as_dvec3()));
        self.route = route;
        self.choices = choices(&centerline.line, &path, route);
        self.path = Some(path);
        self.goal_mm = None;
        if self.on_path {
            self.seek_while(start, self.playing);
        }
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

    /// Whether there are changes of the bookmarks that no file has.
    pub fn has_unsaved_notes(&self) -> bool {
        self.unsaved
    }

    /// A file has the bookmarks as they are now.
    pub fn notes_saved(&mut self) {
        self.unsaved = false;
    }

    /// Carries out actions, then lets `dt` seconds pass.
    pub fn step(&mut self, dt: f64, actions: &[Action]) {
        for action in actions {
            self.act(action);
        }
        if dt > 0.0 && self.goal_mm.is_some() {
            self.approach_goal(dt);
        } else if self.playing && dt > 0.0 {
            let Some(path) = &self.path else { return };
            let way = if self.reverse { -dt } else { dt };
            let to = path.after(self.arc_mm, way * self.speed_mm_s / self.planned_mm_s);
            let end = if self.reverse { 0.0 } else { path.length_mm() };
            let playing = (to - end).abs() >= 1e-9;
            self.seek_while(to, playing);
        }
    }

    fn act(&mut self, action: &Action) {
        match action {
            Action::TogglePlay => self.toggle_play(),
            Action::Reverse => self.reverse = !self.reverse,
            Action::Speed(v) if v.is_finite() => {
                self.speed_mm_s = v.clamp(*SPEED_MM_S.start(), *SPEED_MM_S.end());
            }
            Action::Travel(mm) => self.seek(self.arc_mm + mm),
            Action::Seek(mm) => self.seek(*mm),
            Action::Fly(by) => self.fly(DVec3::from(*by)),
            Action::Turn([right, up, roll]) => {
                (self.playing, self.goal_mm) = (false, None);
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
            Action::View(view) => self.view = *view,
            Action::Colour(colouring) => self.colouring = *colouring,
            Action::Opacity(o) if o.is_finite() => self.opacity = o.clamp(0.0, 2.0),
            Action::Measure(ruler) => {
                self.ruler = *ruler;
                self.marks_mm.clear();
            }
            Action::Mark(p) if DVec3::from(*p).is_finite() => self.mark(DVec3::from(*p)),
            Action::RemoveMeasurement(i) if *i < self.measurements.len() => {
                self.measurements.remove(*i);
                self.unsaved = true;
            }
            Action::Orbit([about, tilt]) if about.is_finite() && tilt.is_finite() => {
                let full = std::f32::consts::TAU;
                let upright = std::f32::consts::FRAC_PI_2;
                self.orbit[0] = (self.orbit[0] + about).rem_euclid(full);
                self.orbit[1] = (self.orbit[1] + tilt).clamp(-upright, upright);
            }
            Action::Crosshair(p) if DVec3::from(*p).is_finite() => {
                self.crosshair_mm = DVec3::from(*p);
            }
            Action::Window([centre, width]) if centre.is_finite() && width.is_finite() => {
                self.window = [*centre, width.max(1e-3)];
            }
            Action::Maximise(pane) => self.maximised = *pane,
            Action::Bookmark(text) => self.bookmark(text),
            Action::RemoveBookmark(i) if *i < self.bookmarks.len() => {
                self.bookmarks.remove(*i);
                self.unsaved = true;
            }
            Action::GoToBookmark(i) => self.go_to_bookmark(*i),
            Action::NextMissed => self.next_missed(),
            Action::ToggleHelp => self.help = !self.help,
            // Numbers that are none.
            _ => {}
        }
    }
}

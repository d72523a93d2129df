//! What the window is about: where the eye is, what is shown, what was noted. No drawing here and
//! no input devices: panels and scripts alike send [`Action`]s, and [`Model::step`] carries them out.

use std::sync::{Arc, OnceLock};

use glam::{DVec3, Quat, Vec3};
use serde::{Deserialize, Serialize};

use super::action::{Action, Colouring, FOV_DEG, Pane, Ruler, SPEED_MM_S, WallView};
use super::junctions::{Choice, choices};
use super::measure::Measurement;
use super::painter::Shown;
use super::path::{FlightPath, SectionFigures};
use super::study::News;
use crate::flight::{Clearance, Coverage, Flight, LISTED_FROM_MM2, WallIndex, collide_and_slide};
use crate::geometry::{CrossSection, Lens, Pose, TriangleBvh, cross_section};
use crate::session::{Centered, Fields, FlightRoute, Levels, Segmented, Wall};
use crate::volume::Volume;

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
    /// Distance of each vertex of the wall from the centerline, mm.
    pub radii_mm: Option<Arc<Vec<f32>>>,
}

/// Least speed at which the eye flies to a place that was clicked, mm/s.
const LEAST_APPROACH_MM_S: f64 = 60.0;
/// A branch is offered from so far before the place where it leaves, mm, to so far behind.
const OFFERED_MM: std::ops::Range<f64> = -5.0..25.0;
/// Wished near plane, mm; nearer where the wall is.
const NEAR_MM: f32 = 2.0;
/// The near plane that the eye keeps room for while it is moved by hand, mm.
const HAND_NEAR_MM: f32 = 0.4;

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
    /// Everything is computed.
    pub is_complete: bool,
    /// Width over height of the inside view.
    pub aspect: f32,
    /// Speed the flight was planned with, mm/s.
    planned_mm_s: f64,
    index: Arc<OnceLock<WallIndex>>,
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
            near_mm: NEAR_MM,
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
            is_complete: false,
            aspect: 4.0 / 3.0,
            planned_mm_s,
            index: Arc::default(),
        }
    }

    /// Nothing of another volume; how the window shows it stays.
    pub fn anew(&self) -> Self {
        let (aspect, fov_deg) = (self.aspect, self.fov_deg);
        Self { aspect, fov_deg, view: self.view, ..Self::new(self.planned_mm_s) }
    }

    /// Takes a product in.
    pub fn learn(&mut self, news: News) {
        let p = &mut self.products;
        match news {
            News::Volume(volume) => {
                self.window = default_window(&volume);
                let middle = 0.5 * (volume.grid.dims.as_dvec3() - 1.0);
                self.crosshair_mm = volume.grid.world_from_voxel().transform_point3(middle);
                p.volume = Some(volume);
            }
            News::Identity(identity) => self.identity = Some(identity),
            News::Lumen(lumen) => p.lumen = Some(lumen),
            News::Wall(wall) => p.wall = Some(wall),
            News::Tree(tree) => p.tree = Some(tree),
            News::Radii(radii) => p.radii_mm = Some(radii),
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

    /// Notes were changed from outside.
    pub fn notes_changed(&mut self) {
        self.unsaved = true;
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

    /// Flies towards the goal: a third of a second more takes it nearer by a factor of e, and it is
    /// never slower than [`LEAST_APPROACH_MM_S`].
    fn approach_goal(&mut self, dt: f64) {
        let Some(goal) = self.goal_mm else { return };
        let left = goal - self.arc_mm;
        let step = (3.0 * left.abs()).max(LEAST_APPROACH_MM_S) * dt;
        self.seek_while(self.arc_mm + left.clamp(-step, step), false);
        // Seeking forgets it.
        self.goal_mm = (left.abs() > step).then_some(goal);
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
            // Of the window's own; or numbers that are none.
            _ => {}
        }
    }

    fn toggle_play(&mut self) {
        let Some(path) = &self.path else { return };
        self.playing = !self.playing;
        if self.playing {
            // From the end it begins anew.
            let length = path.length_mm();
            let start = match (self.reverse, self.arc_mm) {
                (false, at) if at >= length - 1e-6 => 0.0,
                (true, at) if at <= 1e-6 => length,
                (_, at) => at,
            };
            self.seek_while(start, true);
        }
    }

    /// To a place on the path.
    pub fn seek(&mut self, arc_mm: f64) {
        self.seek_while(arc_mm, self.playing);
    }

    fn seek_while(&mut self, arc_mm: f64, playing: bool) {
        let Some(path) = self.path.as_ref().filter(|_| arc_mm.is_finite()) else { return };
        self.arc_mm = arc_mm.clamp(0.0, path.length_mm());
        let pose = path.pose_at(self.arc_mm);
        (self.on_path, self.playing, self.goal_mm) = (true, playing, None);
        self.place(pose);
    }

    /// Sets out to a place on the path, from where it was left.
    fn fly_to(&mut self, arc_mm: f64) {
        let Some(path) = self.path.as_ref().filter(|_| arc_mm.is_finite()) else { return };
        let goal = arc_mm.clamp(0.0, path.length_mm());
        self.seek_while(self.arc_mm, false);
        self.goal_mm = Some(goal);
    }

    /// Whether the eye moves by itself.
    pub fn is_moving(&self) -> bool {
        self.playing || self.goal_mm.is_some()
    }

    fn mark(&mut self, p: DVec3) {
        let Some(ruler) = self.ruler else { return };
        self.marks_mm.push(p);
        if let Some(done) = Measurement::of(ruler, &self.marks_mm) {
            self.measurements.push(done);
            self.marks_mm.clear();
            self.unsaved = true;
        }
    }

    /// Branches that can be taken here, those ahead of the eye first to come.
    pub fn offered(&self) -> Vec<Choice> {
        let way = if self.reverse { -1.0 } else { 1.0 };
        let near = |c: &&Choice| OFFERED_MM.contains(&(way * (c.arc_mm - self.arc_mm)));
        let mut offered: Vec<Choice> = self.choices.iter().filter(near).copied().collect();
        if self.reverse {
            offered.reverse();
        }
        offered
    }

    /// What was shown of the wall has changed.
    pub fn take_shown(&mut self, shown: Shown) {
        self.shown = shown;
        self.shown_version += 1;
    }

    /// The place on the wall that the eye sees in a direction of its own, LPS mm.
    pub fn wall_behind(&self, ray: DVec3) -> Option<DVec3> {
        let (tree, pose) = (self.products.tree.as_ref()?, self.pose?);
        const FAR_MM: f64 = 10_000.0;
        let along = pose.rotation.as_dquat() * ray.try_normalize()? * FAR_MM;
        tree.first_hit(pose.position_mm.as_dvec3(), along)
    }

    /// Moves the eye by hand.
    fn fly(&mut self, by: DVec3) {
        let Some(pose) = self.pose.filter(|_| by.is_finite()) else { return };
        (self.playing, self.on_path, self.goal_mm) = (false, false, None);
        let delta = pose.rotation.as_dquat() * DVec3::new(by.x, by.y, -by.z);
        // Where it is narrower than a hand's room already, that much is kept.
        let near_mm = self.near_mm.min(HAND_NEAR_MM);
        let lens = Lens { near_mm, ..self.lens() };
        let from = pose.position_mm.as_dvec3();
        let to = self.with_clearance(|wall| collide_and_slide(from, delta, wall, lens));
        if let Some(to) = to {
            self.place(Pose { position_mm: to.as_vec3(), ..pose });
        }
    }

    /// The lens, its near plane as proven at the eye.
    pub fn lens(&self) -> Lens {
        let fov_y_rad = self.fov_deg.to_radians();
        Lens { fov_y_rad, aspect: self.aspect, near_mm: self.near_mm }
    }

    /// Width over height of the inside view changed: what was proven may hold no more.
    pub fn set_aspect(&mut self, aspect: f32) {
        if aspect.is_finite() && aspect > 0.0 && aspect != self.aspect {
            self.aspect = aspect;
            self.pose.into_iter().for_each(|p| self.place(p));
        }
    }

    /// Puts the eye somewhere, if a near plane can be proven there; else it stays where it is.
    fn place(&mut self, pose: Pose) {
        let wish = Lens { near_mm: NEAR_MM, ..self.lens() };
        let at = pose.position_mm.as_dvec3();
        let Some(Ok((near, _))) = self.with_clearance(|wall| wall.near_mm(at, wish)) else {
            return;
        };
        (self.pose, self.near_mm) = (Some(pose), near);
        self.crosshair_mm = at;
        self.section = self.section_at(at, pose);
    }

    fn section_at(&self, at: DVec3, pose: Pose) -> Option<CrossSection> {
        let (wall, tree) = (self.products.wall.as_ref()?, self.products.tree.as_ref()?);
        let along = self.path.as_ref().filter(|_| self.on_path).map(|p| p.tangent_at(self.arc_mm));
        let normal = along.unwrap_or(pose.forward().as_dvec3());
        cross_section(&wall.mesh, tree, at, normal)
    }

    fn with_clearance<T>(&self, ask: impl FnOnce(&Clearance<'_>) -> T) -> Option<T> {
        let p = &self.products;
        let (lumen, fields) = (p.lumen.as_ref()?, p.fields.as_ref()?);
        let mesh = p.wall.as_ref().map(|w| &w.mesh);
        let wall = Clearance::new(&lumen.lumen, &fields.distance, mesh).sharing(&self.index);
        Some(ask(&wall))
    }

    fn bookmark(&mut self, text: &str) {
        let Some(pose) = self.pose else { return };
        let text = match text.trim() {
            "" => format!("Place {}", self.bookmarks.len() + 1),
            text => text.to_owned(),
        };
        self.unsaved = true;
        self.bookmarks.push(Bookmark {
            text,
            position_mm: pose.position_mm.as_dvec3().to_array(),
            rotation: pose.rotation.as_dquat().to_array(),
            fov_deg: self.fov_deg,
            arc_mm: self.on_path.then_some(self.arc_mm),
            picture: None,
            png: None,
        });
    }

    fn go_to_bookmark(&mut self, i: usize) {
        let Some(b) = self.bookmarks.get(i).cloned() else { return };
        let rotation = Quat::from_array(b.rotation.map(|v| v as f32));
        let position_mm = DVec3::from(b.position_mm).as_vec3();
        self.fov_deg = b.fov_deg.clamp(*FOV_DEG.start(), *FOV_DEG.end());
        self.playing = false;
        match b.arc_mm {
            Some(arc) => self.seek(arc),
            None => {
                self.on_path = false;
                self.place(Pose { position_mm, rotation: rotation.normalize() });
            }
        }
    }

    /// To the largest patch that the flight misses, is not visited yet and was not shown since.
    fn next_missed(&mut self) {
        let (Some(coverage), Some(wall)) =
            (self.products.coverage.clone(), self.products.wall.clone())
        else {
            return;
        };
        let mut unseen_mm2 = vec![0.0; coverage.patches.len()];
        for (face, patch) in coverage.patch_of_face.iter().enumerate() {
            let Some(area) = patch.and_then(|p| unseen_mm2.get_mut(p as usize)) else { continue };
            if !self.shown.faces.get(face).copied().unwrap_or(false) {
                *area += 0.5 * f64::from(wall.mesh.face_cross(wall.mesh.faces[face]).length());
            }
        }
        let open = |i: &usize| unseen_mm2[*i] >= LISTED_FROM_MM2;
        let left: Vec<usize> = (0..unseen_mm2.len()).filter(open).collect();
        if left.iter().all(|i| self.visited.contains(i)) {
            self.visited.clear();
        }
        let Some(next) = left.iter().find(|i| !self.visited.contains(i)) else {
            self.message = Some("no missed patch of 300 mm² or more is left".into());
            return;
        };
        self.visited.push(*next);
        self.playing = false;
        let centre = coverage.patches[*next].center_mm;
        if let Some(path) = &self.path {
            self.seek(path.nearest_to(centre));
        }
        if let Some(pose) = self.pose {
            let to = centre.as_vec3() - pose.position_mm;
            if to.length() > 1e-3 {
                self.on_path = false;
                self.place(Pose::looking(pose.position_mm, to, pose.up()));
            }
        }
        let area = unseen_mm2[*next];
        self.message = Some(format!("missed patch of {area:.0} mm² ahead"));
    }

    /// Figures of the cross-section at the eye.
    pub fn section_figures(&self) -> Option<SectionFigures> {
        self.section.as_ref().map(SectionFigures::of)
    }
}

/// Grey values of slices to begin with: gas, soft tissue and bone of a CT; what is there otherwise.
fn default_window(volume: &Volume) -> [f64; 2] {
    let (low, high) = volume.range().unwrap_or((0.0, 1.0));
    if low < -500.0 { [-200.0, 1800.0] } else { [0.5 * (low + high), (high - low).max(1.0)] }
}

//! Places and extents of the slices and the overview.

use glam::{DMat3, DQuat, DVec3, IVec3, Vec3};

use super::super::action::{EXTENT_MM, Pane, Ruler, SliceExtent};
use super::super::finding::{longest, middle};
use super::super::grey_window::{LUNG, is_hounsfield};
use super::Model;
use crate::geometry::Pose;
use crate::lumen::Lumen;
use crate::render::Framing;

/// Extent of slices that are led to a place: so many radii of the lumen there, mm within bounds.
const PLACE_RADII: f64 = 8.0;
const PLACE_MM: std::ops::RangeInclusive<f64> = 30.0..=150.0;
/// Extent where the radius is not known, mm.
const UNKNOWN_MM: f64 = 80.0;
/// Largest enlargement of the overview.
const MAX_ZOOM: f32 = 40.0;
/// Share of the lumen's longest side that slices of it show.
const MARGIN: f64 = 1.1;

impl Model {
    /// Leads the slices to a place and near to it.
    pub(super) fn show_in_slices(&mut self, place: DVec3) {
        let radius = |path: &crate::flight::FlightPath| path.radius_at(path.nearest_to(place));
        let span = self.path.as_ref().map_or(UNKNOWN_MM, |path| PLACE_RADII * radius(path));
        (self.playing, self.goal_mm, self.gaze_mm) = (false, None, None);
        self.crosshair_mm = place;
        self.extent = SliceExtent::Mm(span.clamp(*PLACE_MM.start(), *PLACE_MM.end()));
        self.centred += 1;
    }

    /// The place that the slices show, if it is not the eye's own and no wall hides it.
    pub fn crosshair_in_view(&self) -> Option<DVec3> {
        /// Way behind the wall at which a place is still that of the wall, mm.
        const BEHIND_MM: f64 = 1.0;
        let pose = self.pose?;
        let way = self.crosshair_mm - pose.position_mm.as_dvec3();
        let is_elsewhere = way.length() > BEHIND_MM;
        let ray = pose.rotation.as_dquat().conjugate() * way;
        let wall = is_elsewhere.then(|| self.wall_behind(ray)).flatten()?;
        let to_wall = wall.distance(pose.position_mm.as_dvec3());
        (way.length() <= to_wall + BEHIND_MM).then_some(self.crosshair_mm)
    }

    /// Returns the pose whose picture lies in the slice across the path: at the crosshair, along the
    /// path there, wherever the eye looks. Before there is a path it is the eye's.
    pub fn across_pose(&self) -> Option<Pose> {
        if let Some(along) = self.plane_along_finding() {
            return Some(along);
        }
        let (pose, place) = (self.pose?, self.crosshair_mm);
        let Some(path) = &self.path else { return Some(pose) };
        let is_at_eye = self.on_path && place == pose.position_mm.as_dvec3();
        let (arc, along) = match is_at_eye {
            true => (self.arc_mm, path.across_at(self.arc_mm)),
            false => (path.nearest_to(place), path.direction_near(place)?),
        };
        Some(Pose::looking(place.as_vec3(), along.as_vec3(), path.pose_at(arc).up()))
    }

    /// Returns the pose whose picture lies in the plane along a finding, while the slices are there.
    pub fn plane_along_finding(&self) -> Option<Pose> {
        self.along_finding.filter(|pose| pose.position_mm == self.crosshair_mm.as_vec3())
    }

    /// Leads the large slice to a finding, in the plane of its largest diameter and of the way from the
    /// eye to the wall. Without a length the plane is that across the middle of the view.
    pub(super) fn measure_in_slice(&mut self, i: usize) {
        let Some(finding) = self.bookmarks.get(i).cloned() else { return };
        let Some(place) = middle(self, &finding) else { return };
        let rotation = DQuat::from_array(finding.rotation);
        let ends = longest(self, &finding).map(|m| m.points()[1] - m.points()[0]);
        let right = ends.unwrap_or(rotation * DVec3::X).normalize_or(DVec3::X);
        let ahead = place - DVec3::from(finding.position_mm);
        let down = ahead.reject_from_normalized(right).normalize_or(right.any_orthonormal_vector());
        // Columns of the pose: right, up, and towards the viewer.
        let turn = DMat3::from_cols(right, -down, right.cross(-down));
        let rotation = DQuat::from_mat3(&turn).as_quat().normalize();
        self.show_in_slices(place);
        // The crosshair is where the pose is, in single precision.
        let position_mm = place.as_vec3();
        self.crosshair_mm = position_mm.as_dvec3();
        self.along_finding = Some(Pose { position_mm, rotation });
        self.selected = Some(i);
        (self.large_slice, self.ruler) = (Pane::Across, Some(Ruler::Length));
        self.maximised = None;
        if is_hounsfield(self.value_range()) {
            self.window = LUNG;
        }
    }

    pub(super) fn set_extent(&mut self, extent: SliceExtent) {
        self.extent = match extent {
            SliceExtent::Mm(mm) if !mm.is_finite() => return,
            SliceExtent::Mm(mm) => SliceExtent::Mm(mm.clamp(*EXTENT_MM.start(), *EXTENT_MM.end())),
            whole => {
                self.centred += 1;
                whole
            }
        };
    }

    /// Whether the lumen is to be chosen: nothing says which, or it is known that organs may be
    /// there while nothing was found yet.
    pub fn asks_for_lumen(&self) -> bool {
        let organs = self.glance.as_ref().is_some_and(|g| !g.organs.is_empty());
        let is_asked = self.question.is_some() && self.contents.is_none();
        let is_open = self.products.lumen.is_none() && self.failure.is_none();
        self.volume().is_some() && is_open && (is_asked || organs)
    }

    /// Corners of the wall's box, LPS mm.
    pub fn wall_bounds(&self) -> Option<(Vec3, Vec3)> {
        self.wall_bounds
    }

    /// Draws the overview nearer, about another place; all of the organ where it is no nearer.
    pub(super) fn frame_overview(&mut self, zoom: f32, pan_mm: [f32; 2]) {
        self.is_framed = true;
        let framing = &mut self.framing;
        *framing = match zoom > 1.0 {
            true => Framing { zoom: zoom.min(MAX_ZOOM), pan_mm, ..*framing },
            false => Framing { orbit: framing.orbit, ..Framing::default() },
        };
    }

    /// Millimetres across the shorter side of a pane of slices; `None` where it shows all of the
    /// volume.
    pub fn extent_mm(&self, pane: Pane) -> Option<f64> {
        match (self.extent, self.lumen_side_mm) {
            (SliceExtent::Mm(mm), _) => Some(mm),
            (SliceExtent::Volume, _) | (SliceExtent::Lumen, None) => None,
            (SliceExtent::Lumen, Some(side)) => {
                // Across the path there is no more to see than the wall about the eye.
                let near = self.path.as_ref().filter(|_| pane == Pane::Across);
                let widest = near.map(|path| path.radius_mm.iter().copied().fold(0.0, f64::max));
                let all = MARGIN * side;
                Some(widest.map_or(all, |r| (PLACE_RADII * r).max(*PLACE_MM.start()).min(all)))
            }
        }
    }
}

/// Longest side of a lumen's box, mm along the index axes.
pub(super) fn longest_side_mm(lumen: &Lumen) -> Option<f64> {
    let inside = lumen.elements(&lumen.inside).map(|element| lumen.bricks.voxel(element));
    let (low, high) =
        inside.fold((IVec3::MAX, IVec3::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let size = (high - low + 1).as_dvec3() * lumen.grid.spacing_mm;
    high.cmpge(low).all().then(|| size.max_element())
}

#[cfg(test)]
pub(in crate::app) mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::app::action::Action;
    use crate::app::slices::SlicePlane;
    use crate::session::{Product, Session, Settings, Source, VolumeSource};
    use crate::volume::phantom::{Kind, Phantom};

    /// A model of a label map with everything that the eye needs, and the session of it.
    pub fn flown_model(kind: Kind, change: impl FnOnce(&mut Settings)) -> (Model, Session) {
        let mask = Phantom::new(kind, 48, [1.0; 3]).unwrap().mask();
        let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
        let mut settings = Settings::default();
        change(&mut settings);
        let mut session = Session::new(source, settings).unwrap();
        session.keep_volume();
        let wanted = [
            Product::Volume,
            Product::ValueRange,
            Product::Lumen,
            Product::Wall,
            Product::TriangleTree,
            Product::Fields,
            Product::Centerline,
            Product::Flight,
            Product::Coverage,
        ];
        session.prepare(&wanted).unwrap();
        let mut model = Model::new(20.0);
        model.update(session.products(&wanted));
        (model, session)
    }

    #[test]
    fn a_finding_is_measured_in_the_plane_of_its_largest_diameter() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        model.step(0.0, &[Action::Bookmark("polyp".into())]);
        let at = DVec3::from(model.bookmarks[0].wall_mm.unwrap());
        let ends = [at + DVec3::new(3.0, 1.0, 0.5), at - DVec3::new(2.5, 1.5, 0.0)];
        let marks = ends.map(|p| Action::Mark(p.to_array()));
        model.step(0.0, &[Action::Measure(Some(Ruler::Length))]);
        model.step(0.0, &marks);
        model.step(0.0, &[Action::MeasureInSlice(0)]);
        let plane =
            SlicePlane::of(Pane::Across, model.crosshair_mm, 0.2, model.across_pose()).unwrap();
        let off = ends.map(|p| plane.px(p, [200, 200]).1.abs());
        assert!(off.iter().all(|mm| *mm < 1e-3), "both ends lie in it: {off:?}");
        assert_eq!((model.large_slice, model.ruler), (Pane::Across, Some(Ruler::Length)));
        // The lumen is above the wall.
        let eye = plane.px(DVec3::from(model.bookmarks[0].position_mm), [200, 200]).0;
        assert!(eye[1] < 100.0, "{eye:?}");
        // A length measured there is its size in a slice.
        model.step(
            0.0,
            &[Action::MarkInSlice(ends[0].to_array()), Action::MarkInSlice(ends[1].to_array())],
        );
        assert!(model.measurements[1].in_slice && model.measurements[1].finding.is_some());
        // Elsewhere it is the plane across the path again.
        model.step(0.0, &[Action::Crosshair([0.0; 3])]);
        assert!(model.plane_along_finding().is_none());
    }

    #[test]
    fn the_slice_across_the_path_stays_across_it_wherever_the_eye_looks() {
        let (mut model, _session) = flown_model(Kind::Bend, |_| {});
        let arc = 0.4 * model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::Seek(arc)]);
        let along = model.path.as_ref().unwrap().across_at(arc);
        let on = model.across_pose().unwrap();
        assert!(on.forward().as_dvec3().dot(along) > 0.9999);
        // What is up in the picture stays so too.
        model.step(0.0, &[Action::Turn([1.2, 0.5, 0.7])]);
        let off = model.across_pose().unwrap();
        assert!(!model.on_path && off.up().dot(on.up()) > 0.99, "{:?} {:?}", off.up(), on.up());
        assert!(off.forward().as_dvec3().dot(along) > 0.99, "{:?} {along}", off.forward());
        assert!(model.pose.unwrap().forward().as_dvec3().dot(along) < 0.5, "the eye turned");
    }

    #[test]
    fn slices_show_the_lumen_first_and_a_place_on_the_wall_near_by() {
        let (mut model, _session) = flown_model(Kind::Bend, |_| {});
        let all = model.extent_mm(Pane::Axial).unwrap();
        assert!((20.0..=48.0 * MARGIN).contains(&all), "the lumen's side: {all} mm");
        model.step(0.0, &[Action::Seek(20.0), Action::TogglePlay]);
        let wall = model.wall_behind(DVec3::new(0.6, 0.0, -1.0)).unwrap();
        model.step(0.1, &[Action::ShowInSlices(wall.to_array())]);
        assert_eq!(model.crosshair_mm, wall);
        assert_eq!(model.crosshair_in_view(), Some(wall), "marked in the inside view");
        let [eye, behind] = [0.0, 1.5].map(|share| {
            let eye = model.pose.unwrap().position_mm.as_dvec3();
            eye + share * (wall - eye)
        });
        for hidden in [eye, behind] {
            let place = Action::Crosshair(hidden.to_array());
            model.step(0.0, &[place]);
            assert_eq!(model.crosshair_in_view(), None);
        }
        model.step(0.0, &[Action::Crosshair(wall.to_array())]);
        assert!(!model.playing, "the flight would take the slices away");
        let near = model.extent_mm(Pane::Axial).unwrap();
        assert!(PLACE_MM.contains(&near) && near == model.extent_mm(Pane::Across).unwrap());
        let centred = model.centred;
        model.step(0.0, &[Action::Extent(SliceExtent::Mm(f64::NAN))]);
        model.step(0.0, &[Action::Extent(SliceExtent::Mm(0.0))]);
        assert_eq!(model.extent_mm(Pane::Axial), Some(*EXTENT_MM.start()));
        assert_eq!(model.centred, centred, "zoom keeps the place");
        model.step(0.0, &[Action::Extent(SliceExtent::Volume)]);
        assert_eq!(model.extent_mm(Pane::Axial), None);
    }

    #[test]
    fn a_place_in_a_slice_is_flown_to_and_looked_at() {
        let (mut model, _session) = flown_model(Kind::Bend, |_| {});
        let path = model.path.as_ref().unwrap();
        let at = path.pose_at(0.7 * path.length_mm());
        let place = at.position_mm.as_dvec3() + 6.0 * at.up().as_dvec3();
        let near = path.nearest_to(place);
        model.step(0.0, &[Action::LookAt(place.to_array())]);
        assert!(model.is_moving() && model.arc_mm == 0.0, "it sets out");
        (0..600).for_each(|_| model.step(1.0 / 30.0, &[]));
        assert!(!model.is_moving() && (model.arc_mm - near).abs() < 1e-6);
        let pose = model.pose.unwrap();
        let towards = (place - pose.position_mm.as_dvec3()).normalize();
        let off = pose.forward().as_dvec3().angle_between(towards).to_degrees();
        assert!(off < 0.1, "{off} degrees beside the place");
        assert_eq!(model.crosshair_mm, place, "slices show it too");
        // Another movement on the way forgets it.
        model.step(0.0, &[Action::LookAt(place.to_array()), Action::Seek(1.0)]);
        model.step(1.0, &[]);
        assert!(model.arc_mm == 1.0 && model.on_path);
    }
}

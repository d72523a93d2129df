//! Wall that the flight does not show: coverage of the path that is flown, and visits to missed
//! patches.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::DVec3;

use super::Model;
use crate::flight::{Coverage, Flight, LISTED_FROM_MM2};
use crate::geometry::Mesh;
use crate::session::FlightRoute;

/// A missed patch, where the path is nearest to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissedPlace {
    /// Its rank in area.
    pub patch: usize,
    /// Millimetres along the path.
    pub arc_mm: f64,
    /// Area that the flight misses, mm².
    pub area_mm2: f64,
    /// Area of it that no picture has shown since, mm².
    pub unseen_mm2: f64,
    /// Whether next to all of it has been shown since.
    pub is_shown: bool,
}

/// Missed patch that is marked in the panes.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedMark {
    /// Its rank in area.
    pub patch: usize,
    /// Area that no picture has shown, mm².
    pub area_mm2: f64,
    /// Middle of the patch, LPS mm.
    pub center_mm: DVec3,
    /// Edges of the wall about the patch, LPS mm.
    pub outline_mm: Vec<[DVec3; 2]>,
}

impl MissedMark {
    fn of(wall: &Mesh, coverage: &Coverage, patch: usize, area_mm2: f64) -> Self {
        // An edge of one face of the patch alone is one of its outline.
        let mut edges = BTreeMap::new();
        for (face, own) in wall.faces.iter().zip(&coverage.patch_of_face) {
            if own.is_some_and(|own| own.get() as usize == patch + 1) {
                for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, k)| (face[i], face[k])) {
                    *edges.entry((a.min(b), a.max(b))).or_insert(0u32) += 1;
                }
            }
        }
        let place = |v: u32| wall.positions[v as usize].as_dvec3();
        let outline = edges.into_iter().filter(|(_, faces)| *faces == 1);
        Self {
            patch,
            area_mm2,
            center_mm: coverage.patches[patch].center_mm,
            outline_mm: outline.map(|((a, b), _)| [place(a), place(b)]).collect(),
        }
    }
}

impl Model {
    /// Takes in the coverage of the path that is flown, or that it is not known any more.
    pub(super) fn set_coverage(&mut self, coverage: Option<Arc<Coverage>>) {
        (self.coverage, self.missed) = (coverage, None);
        self.missed_faces = self.faces_of_patches();
    }

    /// Returns the flight along a branch whose coverage is to be computed, once.
    pub(in super::super) fn take_uncovered(&mut self) -> Option<(FlightRoute, Arc<Flight>)> {
        let flight = self.branch_flight.as_ref().filter(|_| self.is_uncovered)?;
        // Not before the first path: its coverage comes first.
        self.is_uncovered = self.products.coverage.is_none();
        (!self.is_uncovered).then(|| (self.route, Arc::clone(flight)))
    }

    /// Takes in the coverage of a flight along a branch, if that is flown still.
    pub(in super::super) fn cover_branch(&mut self, route: FlightRoute, coverage: Coverage) {
        if self.route == route && !self.is_planned_path {
            self.set_coverage(Some(Arc::new(coverage)));
        }
    }

    /// Returns the missed patches of [`LISTED_FROM_MM2`] or more in the order of the path; `None` before
    /// the coverage is known.
    pub fn missed_in_order(&self) -> Option<Vec<MissedPlace>> {
        let (coverage, path) = (self.coverage.as_ref()?, self.path.as_ref()?);
        let mut unseen_mm2 = vec![0.0; coverage.patches.len()];
        for (face, patch, area_mm2) in &self.missed_faces {
            if !self.seen.faces.get(*face as usize).copied().unwrap_or(false) {
                unseen_mm2[*patch as usize] += f64::from(*area_mm2);
            }
        }
        let of = |(patch, unseen): (usize, f64)| MissedPlace {
            patch,
            arc_mm: path.nearest_to(coverage.patches[patch].center_mm),
            area_mm2: coverage.patches[patch].area_mm2,
            unseen_mm2: unseen,
            is_shown: unseen < LISTED_FROM_MM2,
        };
        let mut places: Vec<_> = unseen_mm2.into_iter().enumerate().map(of).collect();
        places.retain(|p| p.area_mm2 >= LISTED_FROM_MM2);
        places.sort_by(|a, b| a.arc_mm.total_cmp(&b.arc_mm).then(a.patch.cmp(&b.patch)));
        Some(places)
    }

    /// Returns the faces of the missed patches, each with its patch and its area, mm².
    pub(super) fn faces_of_patches(&self) -> Vec<(u32, u32, f32)> {
        let (Some(coverage), Some(wall)) = (&self.coverage, &self.products.wall) else {
            return Vec::new();
        };
        let of = |(face, patch): (usize, &Option<std::num::NonZeroU32>)| {
            let patch = patch.as_ref()?.get() - 1;
            let area = 0.5 * wall.mesh.face_cross(wall.mesh.faces[face]).length();
            ((patch as usize) < coverage.patches.len()).then_some((face as u32, patch, area))
        };
        coverage.patch_of_face.iter().enumerate().filter_map(of).collect()
    }

    /// Moves the eye to the next patch along the path that was not shown since, or to the one before;
    /// the list goes round.
    pub(super) fn go_to_missed_beside(&mut self, by: isize) {
        let Some(places) = self.missed_in_order() else {
            self.message = Some("the coverage of the flight is not computed yet".into());
            return;
        };
        // From the patch that is marked, else from the eye.
        let marked = self.missed.as_ref().map(|m| m.patch);
        let marked = places.iter().position(|p| Some(p.patch) == marked);
        let ahead = || places.partition_point(|p| p.arc_mm <= self.arc_mm) as isize;
        let count = places.len() as isize;
        let first = match (marked, by > 0) {
            (Some(i), _) => i as isize + by,
            (None, true) => ahead(),
            (None, false) => ahead() - 1,
        };
        let order = (0..count).map(|k| &places[(first + k * by).rem_euclid(count) as usize]);
        match order.clone().find(|p| !p.is_shown) {
            Some(place) => self.go_to_missed(place.patch),
            None => {
                self.message =
                    Some(format!("no missed patch of {LISTED_FROM_MM2} mm² or more is left"));
            }
        }
    }

    /// Moves the eye to a missed patch, looks at it and marks it.
    pub(super) fn go_to_missed(&mut self, patch: usize) {
        let (Some(coverage), Some(wall)) = (self.coverage.clone(), self.products.wall.clone())
        else {
            return;
        };
        let places = self.missed_in_order().unwrap_or_default();
        let Some(place) = places.iter().find(|p| p.patch == patch) else { return };
        self.playing = false;
        self.missed = Some(MissedMark::of(&wall.mesh, &coverage, patch, place.unseen_mm2));
        self.seek(place.arc_mm);
        self.turn_to(coverage.patches[patch].center_mm);
        let left = places.iter().filter(|p| !p.is_shown).count();
        let (area, all) = (place.unseen_mm2, places.len());
        self.message = Some(format!("missed patch of {area:.0} mm² ahead; {left} of {all} left"));
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use super::super::flown_model;
    use super::*;
    use crate::app::action::Action;
    use crate::flight::MissedPatch;
    use crate::volume::phantom::Kind;

    #[test]
    fn a_missed_patch_is_marked_with_its_outline_where_the_eye_is_led() {
        let (mut model, _session) = flown_model(Kind::Y, |_| {});
        let wall = model.products.wall.clone().unwrap();
        // Half of the wall, as if the flight had missed it.
        let centre = model.pose.unwrap().position_mm;
        let is_missed = |face: &[u32; 3]| wall.mesh.positions[face[0] as usize].x > centre.x;
        let faces = &wall.mesh.faces;
        let mut coverage = Coverage::clone(model.coverage.as_ref().unwrap());
        coverage.patch_of_face =
            faces.iter().map(|f| is_missed(f).then_some(NonZeroU32::MIN)).collect();
        let area_mm2 = 1000.0;
        let center_mm = centre.as_dvec3() + DVec3::X;
        coverage.patches = vec![MissedPatch { area_mm2, center_mm, arc_mm: 0.0, faces: 1 }];
        model.set_coverage(Some(Arc::new(coverage)));
        model.step(0.0, &[Action::NextMissed]);
        let missed = model.missed.clone().expect("a patch of half the wall");
        let mut ends = BTreeMap::new();
        for p in missed.outline_mm.iter().flatten() {
            *ends.entry(p.to_array().map(f64::to_bits)).or_insert(0u32) += 1;
        }
        assert!(!ends.is_empty() && ends.values().all(|n| n % 2 == 0), "closed lines");
        assert_eq!((missed.center_mm, model.crosshair_mm), (center_mm, center_mm));
    }

    #[test]
    fn the_coverage_shown_is_that_of_the_branch_that_is_flown() {
        let (mut model, session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let first = model.coverage.clone().unwrap();
        assert!(model.take_uncovered().is_none());
        let route = FlightRoute::Leaf(1);
        let flight = session.flight_along(route).unwrap();
        let sections = session.sections_along(&flight).unwrap();
        model.take_branch(flight, &sections, route);
        assert!(model.coverage.is_none() && model.missed_in_order().is_none());
        model.step(0.0, &[Action::NextMissed]);
        assert!(model.message.as_ref().unwrap().ends_with("not computed yet"), "it says why");
        let (of, flight) = model.take_uncovered().unwrap();
        assert!(model.take_uncovered().is_none(), "once");
        let covered = session.coverage_along(&flight).unwrap();
        // Another branch was taken meanwhile.
        model.cover_branch(FlightRoute::Leaf(9), covered.clone());
        assert!(model.coverage.is_none());
        model.cover_branch(of, covered);
        // As a session that flies this branch and no other one says.
        let mut alone = session.settings().clone();
        alone.flight.route = route;
        let (alone, _session) = flown_model(Kind::Y, |s| *s = alone);
        let (own, shown) = (alone.coverage.unwrap(), model.coverage.clone().unwrap());
        assert_eq!(shown.both_ways_fraction, own.both_ways_fraction);
        assert_eq!(shown.patches, own.patches);
        assert_ne!(shown.one_way_fraction, first.one_way_fraction);
    }
}

//! Ways through the tree of a lumen: to the place of the centerline that is nearest to another place,
//! along whichever branch leads there.

use glam::DVec3;

use super::super::junctions::BranchChoice;
use super::super::slices::side_letters;
use super::Model;
use crate::flight::FlightPath;
use crate::geometry::Centerline;
use crate::session::FlightRoute;

/// A path passes a place of the tree if it comes as near, mm.
const PASSES_MM: f64 = 2.0;

/// A way to a place, with what a bronchoscopist asks of it.
#[derive(Clone, Debug, PartialEq)]
pub struct WayTo {
    /// Millimetres along the path to where it is nearest to the place.
    pub arc_mm: f64,
    /// From there to the place, mm.
    pub beside_mm: f64,
    /// Branchings on the way: millimetres along the path, and the sides of the patient that it turns
    /// to.
    pub turns: Vec<(f64, String)>,
    /// Least diameter of the lumen on the way, mm, and where.
    pub narrowest: (f64, f64),
}

impl Model {
    /// Sets out for the place of the tree that is nearest to another place: along the path if that leads
    /// there. Else returns the route that does; the way goes on when it is taken.
    pub(in super::super) fn set_out_through_tree(&mut self, place: DVec3) -> Option<FlightRoute> {
        let line = &self.products.centerline.as_ref()?.line;
        let path = self.path.as_ref()?;
        let (branch, near) = nearest_in_tree(line, place)?;
        let on_path = path.pose_at(path.nearest_to(near)).position_mm.as_dvec3();
        if on_path.distance(near) <= PASSES_MM || self.choices.is_empty() {
            self.arrive_at(place);
            return None;
        }
        // The trunk's ends have names.
        let route = if branch == 0 { FlightRoute::Trunk } else { FlightRoute::Leaf(branch) };
        self.way_goes_on_to = Some((route, place));
        Some(route)
    }

    /// Flies on to the place that a route was taken for.
    pub(super) fn go_on_along(&mut self, route: FlightRoute) {
        if let Some((_, place)) = self.way_goes_on_to.take_if(|(wanted, _)| *wanted == route) {
            self.arrive_at(place);
        }
    }

    /// Goes nowhere else: another branch was chosen, or there is no flight along that one.
    pub(in super::super) fn give_up_way(&mut self) {
        self.way_goes_on_to = None;
    }

    fn arrive_at(&mut self, place: DVec3) {
        self.look_at(place);
        self.way = self.path.as_ref().map(|path| way_to(path, &self.choices, place));
    }
}

/// The branch and the place of the centerline nearest to a place.
fn nearest_in_tree(line: &Centerline, place: DVec3) -> Option<(usize, DVec3)> {
    let points = line.branches.iter().enumerate();
    let points = points.flat_map(|(i, b)| b.points.iter().map(move |p| (i, p.position_mm)));
    points.min_by(|a, b| a.1.distance_squared(place).total_cmp(&b.1.distance_squared(place)))
}

fn way_to(path: &FlightPath, choices: &[BranchChoice], place: DVec3) -> WayTo {
    let arc_mm = path.nearest_to(place);
    let there = path.pose_at(arc_mm).position_mm.as_dvec3();
    let before = path.arcs_mm().iter().zip(&path.radius_mm).filter(|(arc, _)| **arc <= arc_mm);
    let narrowest = before.min_by(|a, b| a.1.total_cmp(b.1)).map(|(arc, r)| (2.0 * r, *arc));
    let (turns, narrowest) = (turns(path, choices, arc_mm), narrowest.unwrap_or_default());
    WayTo { arc_mm, beside_mm: there.distance(place), turns, narrowest }
}

/// The branchings before a place of the path, with the sides of the patient that the path turns to.
fn turns(path: &FlightPath, choices: &[BranchChoice], to_mm: f64) -> Vec<(f64, String)> {
    /// Way behind a branching over which the direction is taken, mm.
    const BEHIND_MM: f64 = 8.0;
    /// Branches that leave nearer to each other do so at one place.
    const ONE_PLACE_MM: f64 = 2.0;
    let mut found: Vec<(f64, String)> = Vec::new();
    for choice in choices.iter().filter(|choice| choice.arc_mm <= to_mm) {
        let arc = choice.arc_mm;
        if found.last().is_some_and(|(last, _)| arc - last < ONE_PLACE_MM) {
            continue;
        }
        let [from, behind] = [arc, arc + BEHIND_MM].map(|arc| path.pose_at(arc).position_mm);
        found.push((arc, side_letters((behind - from).as_dvec3().normalize_or_zero())));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::super::super::junctions::choices;
    use super::super::super::junctions::tests::{path, tree};
    use super::*;

    #[test]
    fn a_way_names_its_turns_and_its_narrowest_place() {
        let line = tree();
        let path = path(&line, 3);
        // Up the branch at 20 mm, and off it at 10 mm more towards the patient's right.
        let choices = choices(&line, &path, FlightRoute::Leaf(3));
        let way = way_to(&path, &choices, DVec3::new(12.0, 11.0, 0.0));
        let turns: Vec<(f64, &str)> = way.turns.iter().map(|t| (t.0.round(), &t.1[..])).collect();
        assert_eq!(turns, [(20.0, "P"), (30.0, "R")]);
        assert_eq!(way.narrowest.0, 2.0);
        assert!(way.beside_mm < 3.0 && way.arc_mm > 30.0, "{way:?}");
        let (branch, near) = nearest_in_tree(&line, DVec3::new(41.0, -9.0, 1.0)).unwrap();
        assert_eq!((branch, near), (2, DVec3::new(40.0, -10.0, 0.0)));
    }
}

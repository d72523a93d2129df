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

/// Share of the radius about the path within which a place is in the middle of the lumen.
const MIDDLE: f64 = 0.5;

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
        let Some(path) = &self.path else { return };
        let arc_mm = path.nearest_to(place);
        let beside_mm = path.pose_at(arc_mm).position_mm.as_dvec3().distance(place);
        // The camera arrives at a place in the middle of the lumen: it gives no direction to look in.
        match beside_mm > MIDDLE * path.radius_at(arc_mm) {
            true => self.look_at(place),
            false => self.fly_to(arc_mm),
        }
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
    use super::super::flown_model;
    use super::*;
    use crate::app::action::Action;
    use crate::volume::phantom::Kind;

    /// A click on another bronchus flew to the nearest place of the present path.
    #[test]
    fn a_place_of_another_branch_is_flown_to_along_that_branch() {
        let (mut model, session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let line = model.products.centerline.clone().unwrap();
        let tip = line.line.branches[1].points.last().unwrap().position_mm;
        let to_tip = |m: &Model| {
            let path = m.path.as_ref().unwrap();
            path.pose_at(path.nearest_to(tip)).position_mm.as_dvec3().distance(tip)
        };
        assert!(to_tip(&model) > 5.0, "the first path passes by");
        let route = model.set_out_through_tree(tip).expect("another route");
        assert_eq!(route, FlightRoute::Leaf(1));
        assert!(!model.is_moving() && model.way.is_none(), "not before that route is planned");
        let flight = session.flight_along(route).unwrap();
        let sections = session.sections_along(&flight).unwrap();
        model.take_branch(flight, &sections, route);
        assert!(model.is_moving());
        (0..600).for_each(|_| model.step(1.0 / 30.0, &[]));
        let eye = model.pose.unwrap().position_mm.as_dvec3();
        assert!(eye.distance(tip) < 3.0 && !model.is_moving(), "{eye} beside {tip}");
        // A place on the line is no place to turn to: the eye came to rest with any gaze.
        let path = model.path.as_ref().unwrap();
        let ahead = path.pose_at(model.arc_mm).forward();
        assert!(model.on_path && model.pose.unwrap().forward().dot(ahead) > 0.999);
        let way = model.way.clone().unwrap();
        assert!((way.arc_mm - model.arc_mm).abs() < 1e-6 && !way.turns.is_empty(), "{way:?}");
        // A place of this path needs no other one; a branch that was chosen ends the way.
        let start = model.path.as_ref().unwrap().pose_at(0.0).position_mm.as_dvec3();
        assert_eq!(model.set_out_through_tree(start), None);
        assert!(model.is_moving());
        let first = line.line.branches[0].points.last().unwrap().position_mm;
        assert_eq!(model.set_out_through_tree(first), Some(FlightRoute::Trunk));
        model.give_up_way();
        model.step(0.0, &[Action::Seek(0.0)]);
        model.go_on_along(FlightRoute::Trunk);
        assert!(!model.is_moving());
    }

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

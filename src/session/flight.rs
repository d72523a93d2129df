//! The flight along the centerline.

use super::settings::{FlightRoute, Lod};
use super::{Centered, Clock, Session, SessionError, present};
use crate::flight::{Clearance, Flight, FlightError, FlightOptions, WallDistance};
use crate::geometry::{Centerline, CenterlinePoint};
use crate::lumen::Lumen;
use crate::render::View;

impl Session {
    pub(super) fn run_flight(&self, clock: &mut Clock) -> Result<Flight, SessionError> {
        let tree = present(&self.slots.triangle_tree);
        self.plan_flight(&*tree, clock)
    }

    /// Plans the flight with room for a wall that is refined near the eye.
    pub(super) fn run_flight_by_refined_wall(
        &self,
        clock: &mut Clock,
    ) -> Result<Flight, SessionError> {
        let levels = present(&self.slots.levels);
        let tree = present(&self.slots.triangle_tree);
        self.plan_flight(levels.drawn_distance().unwrap_or(&*tree), clock)
    }

    fn plan_flight(
        &self,
        wall: &dyn WallDistance,
        clock: &mut Clock,
    ) -> Result<Flight, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        let centered = present(&self.slots.centerline);
        let route = self.settings.flight.route;
        let plan = || self.fly(&lumen.lumen, &fields.distance, &centered, wall, route);
        let count = |f: &Result<Flight, _>| f.as_ref().map_or(0, |f| f.poses.len() as u64);
        clock.time("flight", "frames", plan, count)
    }

    /// A flight along other ways of the same centerline than the settings say; it is not kept.
    ///
    /// # Errors
    /// What the stages fail with; [`FlightError::NoBranch`].
    pub fn flight_along(&self, route: FlightRoute) -> Result<Flight, SessionError> {
        let (lumen, fields) = (self.lumen()?, self.fields()?);
        let (centered, tree) = (self.centerline()?, self.triangle_tree()?);
        let is_refined = self.settings.drawn_lod() == Lod::Auto;
        let levels = is_refined.then(|| self.levels()).transpose()?;
        let wall = levels.as_ref().and_then(|levels| levels.drawn_distance()).unwrap_or(&*tree);
        self.pool.install(|| self.fly(&lumen.lumen, &fields.distance, &centered, wall, route))
    }

    fn fly(
        &self,
        lumen: &Lumen,
        distance: &[f32],
        centered: &Centered,
        wall: &dyn WallDistance,
        route: FlightRoute,
    ) -> Result<Flight, SessionError> {
        let s = &self.settings.flight;
        // In a split view the eye fills half the frame.
        let width = if s.view == View::Split { s.size[0] / 2 } else { s.size[0] };
        let aspect = width as f32 / s.size[1] as f32;
        let wall = Some(wall);
        if let Some(script) = &s.script {
            let clearance = Clearance::new(lumen, distance, wall);
            return Ok(match s.script_frames {
                Some(n) => script.resampled(n).fly(&clearance, aspect)?,
                None => script.fly(&clearance, aspect)?,
            });
        }
        let paths = route.paths(&centered.line)?;
        let paths: Vec<&[CenterlinePoint]> = paths.iter().map(Vec::as_slice).collect();
        let options = FlightOptions {
            frames: s.frames,
            fov_y_rad: s.fov_y_rad,
            aspect,
            reverse: s.reverse,
            wall,
        };
        Ok(Flight::along(&paths, lumen, distance, options)?)
    }
}

impl FlightRoute {
    /// The pieces of a centerline that are flown, in order.
    ///
    /// # Errors
    /// [`FlightError::NoBranch`].
    pub(super) fn paths(self, line: &Centerline) -> Result<Vec<Vec<CenterlinePoint>>, FlightError> {
        let branches = line.branches.len();
        Ok(match self {
            Self::Trunk => line.pieces().map(|b| b.points.clone()).collect(),
            Self::Leaf(branch) if branch < branches => vec![line.path_to(branch)],
            Self::Leaf(branch) => return Err(FlightError::NoBranch { branch, branches }),
            Self::All => line.branches.iter().map(|b| b.points.clone()).collect(),
        })
    }
}

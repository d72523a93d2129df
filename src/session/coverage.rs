//! Coverage of the wall by the frames of the flight.

use std::fmt::Write as _;

use glam::Quat;

use super::report::{CoverageReport, CoveredFlight, PatchReport};
use super::settings::FlightRoute;
use super::{Clock, Session, SessionError, present};
use crate::flight::{Coverage, CoverageMap, Flight, LISTED_FROM_MM2, coverage, unseen_voxels};
use crate::geometry::{Lens, Pose, cube_faces};
use crate::task::catch_cancelled;

impl Session {
    pub(super) fn run_coverage(&self, clock: &mut Clock) -> Result<Coverage, SessionError> {
        let (wall, flight) = (present(&self.slots.wall), present(&self.slots.flight));
        let (tree, exterior) = (present(&self.slots.triangle_tree), present(&self.slots.exterior));
        let map = CoverageMap::new(&wall.mesh, &tree, exterior.grid.as_deref());
        let seen = || self.covered(map, &flight);
        Ok(clock.time("coverage", "faces", seen, |_| wall.mesh.faces.len() as u64))
    }

    /// Coverage by another flight than the session's; it is not kept.
    ///
    /// # Errors
    /// The errors of the stages that make the wall; [`SessionError::Cancelled`].
    pub fn coverage_along(&self, flight: &Flight) -> Result<Coverage, SessionError> {
        let (wall, tree, exterior) = (self.wall()?, self.triangle_tree()?, self.exterior()?);
        let seen = || {
            let map = CoverageMap::new(&wall.mesh, &tree, exterior.grid.as_deref());
            catch_cancelled(|| Ok(self.covered(map, flight)))
        };
        self.pool.install(seen).unwrap_or(Err(SessionError::Cancelled))
    }

    fn covered(&self, map: CoverageMap<'_>, flight: &Flight) -> Coverage {
        let (there, back) = match self.settings.flight.view.is_all_round() {
            false => (views(flight), reversed_views(flight)),
            // What is behind the eye is seen on the way there already.
            true => (all_round(flight), Vec::new()),
        };
        let views_a_pose = there.len() / flight.poses.len().max(1);
        let arcs = flight.arc_mm.iter().flat_map(|arc| std::iter::repeat_n(*arc, views_a_pose));
        coverage(map, &there, &back, &arcs.collect::<Vec<f64>>())
    }

    /// Rows of `unseen.csv`: boundary voxels that the flight sees in neither direction, with the
    /// number of their missed patch.
    ///
    /// # Errors
    /// What the stages fail with.
    pub fn unseen_csv(&self) -> Result<String, SessionError> {
        let (segmented, tree) = (self.lumen()?, self.triangle_tree()?);
        let coverage = self.coverage()?;
        let lumen = &segmented.lumen;
        let world = lumen.grid.world_from_voxel();
        let mut out = String::from("i,j,k,x,y,z,patch\n");
        let unseen = self.pool.install(|| unseen_voxels(lumen, &tree, &coverage));
        for (element, patch) in unseen {
            let v = lumen.bricks.voxel(element as usize);
            let p = world.transform_point3(v.as_dvec3());
            let v = lumen.stored_voxel(v);
            let (x, y, z) = (p.x, p.y, p.z);
            let _ = writeln!(out, "{},{},{},{x:.4},{y:.4},{z:.4},{patch}", v.x, v.y, v.z);
        }
        Ok(out)
    }

    /// Report of the coverage by the session's flight.
    pub(super) fn coverage_report(&self, c: &Coverage, flight: &Flight) -> CoverageReport {
        let s = &self.settings.flight;
        let route = match (&s.script, s.route) {
            (Some(_), _) => "path".into(),
            (None, FlightRoute::Trunk) => "trunk".into(),
            (None, FlightRoute::All) => "all".into(),
            (None, FlightRoute::Leaf(branch)) => format!("leaf:{branch}"),
        };
        let first = (!flight.poses.is_empty()).then(|| f64::from(flight.lens(0).fov_y_rad));
        let field_of_view_deg = match s.view.is_all_round() {
            true => 360.0,
            // Radians are stored in single precision.
            false => (1e3 * first.unwrap_or(0.0).to_degrees()).round() / 1e3,
        };
        let cameras = flight.poses.len();
        report(c, CoveredFlight { route, reverse: s.reverse, cameras, field_of_view_deg })
    }
}

fn views(flight: &Flight) -> Vec<(Pose, Lens)> {
    flight.poses.iter().enumerate().map(|(i, pose)| (*pose, flight.lens(i))).collect()
}

/// Everything about each place.
fn all_round(flight: &Flight) -> Vec<(Pose, Lens)> {
    views(flight).iter().flat_map(|(pose, lens)| cube_faces(pose, lens, 0.0)).collect()
}

/// Returns the views of the flight backwards: each camera turned half about its own up.
fn reversed_views(flight: &Flight) -> Vec<(Pose, Lens)> {
    let half_turn = Quat::from_xyzw(0.0, 1.0, 0.0, 0.0);
    let mut views = views(flight);
    views.reverse();
    views.iter_mut().for_each(|(pose, _)| pose.rotation *= half_turn);
    views
}

/// Returns the report of a coverage by some flight.
fn report(c: &Coverage, of: CoveredFlight) -> CoverageReport {
    let patch = |p: &crate::flight::MissedPatch| PatchReport {
        area_mm2: p.area_mm2,
        center_mm: p.center_mm.to_array(),
        arc_mm: p.arc_mm,
    };
    CoverageReport {
        of,
        one_way_fraction: c.one_way_fraction,
        both_ways_fraction: c.both_ways_fraction,
        by: "area",
        area_mm2: c.area_mm2,
        patches: c.patches.iter().map(patch).collect(),
        listed_from_mm2: LISTED_FROM_MM2,
        smaller_patches: c.smaller_patches,
        smaller_patches_mm2: c.smaller_patches_mm2,
    }
}

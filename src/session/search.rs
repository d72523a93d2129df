//! Structures that find parts of the wall by place: built once, used by flight, levels of detail,
//! coverage and whoever points at the wall.

use std::sync::Arc;

use glam::DVec3;

use super::{Centered, Clock, Session, SessionError, present};
use crate::centerline::EndRule;
use crate::flight::{CenterlineDistances, CenterlinePlaces};
use crate::flight::{Flight, FlightPath, LumenProfile, SectionFigures, sections_along};
use crate::geometry::{Centerline, Mesh, TriangleBvh};
use crate::lod::ExteriorGrid;
use crate::lod::occlusion_grid;
use crate::organ::{ColonEnds, Organ};

/// Space outside the wall.
pub struct Exterior {
    /// `None` for a wall that is not watertight: what is outside is not known then.
    pub grid: Option<Arc<ExteriorGrid>>,
}

impl Session {
    pub(super) fn run_triangle_tree(&self, clock: &mut Clock) -> Result<TriangleBvh, SessionError> {
        Ok(triangle_tree(&present(&self.slots.wall).mesh, clock))
    }

    /// The drawn wall's triangles by place.
    pub(super) fn drawn_tree(&self, clock: &mut Clock) -> Arc<TriangleBvh> {
        match &present(&self.slots.shown_wall).open {
            None => present(&self.slots.triangle_tree),
            Some(open) => Arc::new(triangle_tree(open, clock)),
        }
    }

    pub(super) fn run_exterior(&self, clock: &mut Clock) -> Result<Exterior, SessionError> {
        let wall = present(&self.slots.wall);
        let faces = wall.mesh.faces.len() as u64;
        let work = || Arc::new(occlusion_grid(&wall.mesh));
        let closed = wall.topology.watertight;
        let grid = closed.then(|| clock.time("outside", "faces", work, |_| faces));
        Ok(Exterior { grid })
    }

    pub(super) fn run_centerline_distances(
        &self,
        clock: &mut Clock,
    ) -> Result<CenterlineDistances, SessionError> {
        let (wall, tree) = (present(&self.slots.wall), present(&self.slots.triangle_tree));
        let centered = present(&self.slots.centerline);
        let vertices = wall.mesh.positions.len() as u64;
        let find = || CenterlineDistances::new(&wall.mesh, &tree, &centered.line);
        Ok(clock.time("centerline distances", "vertices", find, |_| vertices))
    }

    pub(super) fn run_sections(
        &self,
        clock: &mut Clock,
    ) -> Result<Vec<Option<SectionFigures>>, SessionError> {
        let (wall, tree) = (present(&self.slots.wall), present(&self.slots.triangle_tree));
        let (centered, flight) = (present(&self.slots.centerline), present(&self.slots.flight));
        let find = || sections(&flight, &centered.line, &wall.mesh, &tree);
        Ok(clock.time("sections", "poses", find, |s| s.len() as u64))
    }

    pub(super) fn run_lumen_profile(
        &self,
        clock: &mut Clock,
    ) -> Result<LumenProfile, SessionError> {
        let (wall, tree) = (present(&self.slots.wall), present(&self.slots.triangle_tree));
        let centered = present(&self.slots.centerline);
        let pieces = self.route_pieces(&centered.line, self.settings.flight.route)?;
        let start = self.start_of_route(&centered);
        let voxel_mm = present(&self.slots.lumen).lumen.grid.spacing_mm.max_element();
        let measured = || {
            let places = CenterlinePlaces::new(&centered.line);
            LumenProfile::new(&pieces, &wall.mesh, &tree, &places, &centered.junctions, voxel_mm)
        };
        let find = || LumenProfile { start, ..measured() };
        Ok(clock.time("profile", "samples", find, |p| p.arc_mm.len() as u64))
    }

    /// Part of the organ that the path starts in, where a rule says so without doubt.
    fn start_of_route(&self, centered: &Centered) -> Option<&'static str> {
        let [start, end] = centered.ends.as_ref()?;
        if self.settings.flight.reverse || start.is_doubtful() {
            return None;
        }
        let [from, to] = [start, end].map(|e| DVec3::from(e.at_mm));
        match (present(&self.slots.lumen).organ.as_ref()?.organ, start.rule) {
            (Organ::Airway, EndRule::Trachea) => Some("trachea"),
            (Organ::Colon, EndRule::Rectum) => {
                let ends = ColonEnds::of(from, to, centered.line.length_mm())?;
                (ends.is_sure && ends.starts_at_rectum).then_some("rectum")
            }
            _ => None,
        }
    }

    /// Cross-sections along another flight than the session's, one a pose; they are not kept.
    ///
    /// # Errors
    /// What the stages fail with.
    pub fn sections_along(
        &self,
        flight: &Flight,
    ) -> Result<Vec<Option<SectionFigures>>, SessionError> {
        let (wall, tree, centered) = (self.wall()?, self.triangle_tree()?, self.centerline()?);
        Ok(self.pool.install(|| sections(flight, &centered.line, &wall.mesh, &tree)))
    }
}

fn triangle_tree(mesh: &Mesh, clock: &mut Clock) -> TriangleBvh {
    let faces = mesh.faces.len() as u64;
    clock.time("triangle tree", "faces", || TriangleBvh::new(mesh), |_| faces)
}

/// Cross-sections along a flight, one a pose; none along a flight of fewer than two poses.
fn sections(
    flight: &Flight,
    line: &Centerline,
    wall: &Mesh,
    tree: &TriangleBvh,
) -> Vec<Option<SectionFigures>> {
    let path = FlightPath::new(flight, line);
    path.map_or_else(Vec::new, |path| sections_along(&path, wall, tree))
}

//! Flights along branches of the centerline: one that is asked for, or that a saved eye flew; and
//! their coverage.

use super::super::computation::TaskKind;
use super::open_case::OpenCase;
use crate::session::{FlightRoute, SessionError};

impl OpenCase {
    /// Plans a flight along another branch of the centerline.
    pub(super) fn plan_branch(&mut self, route: FlightRoute) -> Result<(), SessionError> {
        self.spawn(TaskKind::Branch, move |session| {
            let planned = session.flight_along(route).and_then(|flight| {
                let sections = session.sections_along(&flight)?;
                Ok((flight, sections))
            });
            Box::new(move |model| match planned {
                Ok((flight, sections)) => model.take_branch(flight, &sections, route),
                Err(e) => {
                    model.message = Some(format!("no flight along that branch: {e}"));
                    model.give_up_branch();
                    model.give_up_way();
                }
            })
        })
    }

    /// Computes how much of the wall the flight along a branch shows, once that of the first path is
    /// known.
    pub(super) fn cover_branch(&mut self) -> Result<(), SessionError> {
        let Some((route, flight)) = self.model.take_uncovered() else { return Ok(()) };
        self.spawn(TaskKind::Coverage, move |session| {
            let covered = session.coverage_along(&flight);
            Box::new(move |model| match covered {
                Ok(coverage) => model.cover_branch(route, coverage),
                Err(e) => model.message = Some(format!("no coverage of that branch: {e}")),
            })
        })
    }

    /// Plans the branch that a saved eye flew, once there is a path; no other task plans one then.
    pub(super) fn restore_branch(&mut self) -> Result<(), SessionError> {
        let Some(branch) = self.model.branch_to_restore() else { return Ok(()) };
        let line = self.model.products.centerline.as_ref().map(|centered| &centered.line);
        if line.is_some_and(|line| branch >= line.branches.len()) {
            self.model.give_up_branch();
            return Ok(());
        }
        if self.computation.as_ref().is_some_and(|c| !c.runs(TaskKind::Branch)) {
            self.plan_branch(FlightRoute::Leaf(branch))?;
        }
        Ok(())
    }
}

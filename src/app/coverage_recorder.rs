//! Coverage of the wall by the pictures so far, computed on a thread of its own while the eye
//! moves.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use crate::flight::CoverageMap;
use crate::geometry::{Lens, Pose, TriangleBvh};
use crate::session::{Exterior, SessionError, Wall};

/// Part of the wall that was shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeenFaces {
    /// Share of the wall's area, 0 to 1.
    pub fraction: f64,
    /// One flag a face of the wall.
    pub faces: Vec<bool>,
}

type Views = Vec<(Pose, Lens)>;

/// Adds views to a [`CoverageMap`] as they are drawn.
pub struct CoverageRecorder {
    views: Sender<Views>,
    seen: Receiver<(usize, SeenFaces)>,
    /// Batches of views that were sent and are not in what came back yet.
    outstanding: usize,
    last: Option<(Pose, Lens)>,
}

impl CoverageRecorder {
    /// Starts the thread, which ends when the recorder is dropped.
    ///
    /// * `(wall, tree, exterior)`: the wall, its triangles by place and the space outside it.
    /// * `wake`: called on that thread after each answer.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn spawn(
        (wall, tree, exterior): (Arc<Wall>, Arc<TriangleBvh>, Arc<Exterior>),
        wake: impl Fn() + Send + 'static,
    ) -> Result<Self, SessionError> {
        let (views, theirs) = channel::<Views>();
        let (ours, seen) = channel();
        let work = move || {
            let mut map = CoverageMap::new(&wall.mesh, &tree, exterior.grid.as_deref());
            while let Ok(mut batch) = theirs.recv() {
                let mut batches = 1;
                // All that has come since: one answer does for them.
                while let Ok(more) = theirs.try_recv() {
                    batch.extend(more);
                    batches += 1;
                }
                map.add(&batch);
                let seen = SeenFaces { fraction: map.fraction(), faces: map.seen().to_vec() };
                if ours.send((batches, seen)).is_err() {
                    return;
                }
                wake();
            }
        };
        std::thread::Builder::new()
            .name("coverage".into())
            .spawn(work)
            .map_err(|e| SessionError::System(e.to_string()))?;
        Ok(Self { views, seen, outstanding: 0, last: None })
    }

    /// Adds views, unless the first of them is the one that was added last.
    pub fn add(&mut self, views: &[(Pose, Lens)]) {
        let first = views.first().copied();
        if first.is_none() || self.last == first {
            return;
        }
        self.last = first;
        if self.views.send(views.to_vec()).is_ok() {
            self.outstanding += 1;
        }
    }

    /// Returns the part shown, if there is more than at the last time. Never waits.
    pub fn poll(&mut self) -> Option<SeenFaces> {
        let mut newest = None;
        while let Ok((batches, seen)) = self.seen.try_recv() {
            self.outstanding -= batches;
            newest = Some(seen);
        }
        newest
    }

    /// Waits for all added views, then returns the part shown, if there is more than before.
    pub fn settle(&mut self) -> Option<SeenFaces> {
        let mut newest = None;
        while self.outstanding > 0 {
            let Ok((batches, seen)) = self.seen.recv() else { break };
            self.outstanding -= batches;
            newest = Some(seen);
        }
        newest
    }
}

//! A cut as the device holds it: pages written and drawn by steps.

use std::collections::HashMap;
use std::sync::Arc;

use glam::DVec3;
use intima::geometry::{Camera, Vertex};
use intima::lod::vds::ResidentPatches;
use intima::lod::{
    LodHierarchy, LodStep, PAGE_TRIANGLES, PAGE_VERTICES, PageCache, Tolerance, VisiblePatch,
};

/// Page contents, and the last step.
#[derive(Default)]
pub struct Pages {
    content: HashMap<u32, (Vec<Vertex>, Vec<[u8; 3]>)>,
    resident: Option<Arc<ResidentPatches>>,
    pub last: LodStep,
}

impl Pages {
    /// Pages, or the patches that stay on the device.
    pub fn of(resident: Option<Arc<ResidentPatches>>) -> Self {
        Self { resident, ..Self::default() }
    }

    /// Applies a step.
    pub fn apply(&mut self, step: LodStep) {
        for u in &step.uploads {
            assert!(u.vertices.len() <= PAGE_VERTICES && u.triangles.len() <= PAGE_TRIANGLES);
            let corners = u.triangles.iter().flatten();
            assert!(corners.into_iter().all(|c| usize::from(*c) < u.vertices.len()));
            self.content.insert(u.page, (u.vertices.clone(), u.triangles.clone()));
        }
        self.last = step;
    }

    /// Steps until the cut is settled.
    pub fn settle(
        &mut self,
        refine: &mut dyn LodHierarchy,
        camera: &Camera,
        tolerance: &Tolerance,
        cache: &mut PageCache,
    ) {
        for _ in 0..100_000 {
            cache.begin_step();
            self.apply(refine.step(camera, tolerance, cache));
            if self.last.settled {
                return;
            }
        }
        panic!("no cut settles");
    }

    /// Every triangle that is drawn.
    pub fn triangles(&self) -> Vec<[Vertex; 3]> {
        self.triangles_where(|_| true)
    }

    /// The triangles of the patches that pass a test.
    pub fn triangles_where(&self, keep: impl Fn(&VisiblePatch) -> bool) -> Vec<[Vertex; 3]> {
        let mut out = Vec::new();
        for d in self.last.drawn.iter().filter(|d| keep(d)) {
            if let Some(patches) = &self.resident {
                out.extend(patches.triangles(d));
                continue;
            }
            let (vertices, triangles) = &self.content[&d.page];
            assert_eq!(triangles.len(), d.triangles as usize);
            out.extend(triangles.iter().map(|t| t.map(|c| vertices[usize::from(c)])));
        }
        out
    }

    /// The same as bare corners.
    pub fn corners(&self) -> Vec<[DVec3; 3]> {
        corners(&self.triangles())
    }
}

/// Bare corners of triangles.
pub fn corners(triangles: &[[Vertex; 3]]) -> Vec<[DVec3; 3]> {
    triangles.iter().map(|t| t.map(|v| v.position().as_dvec3())).collect()
}

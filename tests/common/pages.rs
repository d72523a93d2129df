//! A cut as the device would hold it: pages written and drawn by steps.
#![allow(dead_code)]

use std::collections::HashMap;

use glam::DVec3;
use intima::geometry::Vertex;
use intima::lod::{Camera, PAGE_TRIANGLES, PAGE_VERTICES, Pool, Refine, Step, Tolerance};

/// What was written where, and what is drawn.
#[derive(Default)]
pub struct Pages {
    content: HashMap<u32, (Vec<Vertex>, Vec<[u8; 3]>)>,
    pub last: Step,
}

impl Pages {
    /// Writes and draws what a step says.
    pub fn apply(&mut self, step: Step) {
        for u in &step.uploads {
            assert!(u.vertices.len() <= PAGE_VERTICES && u.triangles.len() <= PAGE_TRIANGLES);
            let corners = u.triangles.iter().flatten();
            assert!(corners.into_iter().all(|c| usize::from(*c) < u.vertices.len()));
            self.content.insert(u.page, (u.vertices.clone(), u.triangles.clone()));
        }
        self.last = step;
    }

    /// Steps until nothing changes any more.
    pub fn settle(
        &mut self,
        refine: &mut dyn Refine,
        camera: &Camera,
        tolerance: &Tolerance,
        pool: &mut Pool,
    ) {
        for _ in 0..100_000 {
            pool.begin();
            self.apply(refine.step(camera, tolerance, pool));
            if self.last.settled {
                return;
            }
        }
        panic!("no cut settles");
    }

    /// Every triangle that is drawn.
    pub fn triangles(&self) -> Vec<[Vertex; 3]> {
        let mut out = Vec::new();
        for d in &self.last.drawn {
            let (vertices, triangles) = &self.content[&d.page];
            assert_eq!(triangles.len(), d.triangles as usize);
            out.extend(triangles.iter().map(|t| t.map(|c| vertices[usize::from(c)])));
        }
        out
    }

    /// The same as bare corners.
    pub fn corners(&self) -> Vec<[DVec3; 3]> {
        self.triangles().iter().map(|t| t.map(|v| v.position().as_dvec3())).collect()
    }
}

//! Where a central route is looked for first.

use glam::IVec3;
use rayon::prelude::*;

use super::graph::Graph;
use crate::lumen::bricks::{BRICK, NONE, SIDE};

/// Places deep for where they are: a route through them is found among far fewer nodes.
pub(super) struct SearchCorridor {
    /// Least distance to the wall, mm, by brick.
    least: Vec<f32>,
}

impl SearchCorridor {
    /// Share of the greatest distance in a brick and those around it.
    const SHARE: f32 = 0.5;

    /// All places near `ends` count as deep: they lie where they were put.
    pub fn new(graph: &Graph<'_>, distance: &[f32], ends: [u32; 2]) -> Self {
        let bricks = &graph.lumen().bricks;
        let deepest: Vec<f32> = distance
            .par_chunks_exact(BRICK)
            .with_min_len(64)
            .map(|d| d.iter().copied().fold(0.0, f32::max))
            .collect();
        let around = |slot: &[u32; 27]| {
            let known = slot.iter().filter(|s| **s != NONE);
            known.map(|s| deepest[*s as usize]).fold(0.0, f32::max)
        };
        let mut least: Vec<f32> = bricks.near().iter().map(|s| Self::SHARE * around(s)).collect();
        let h = graph.lumen().grid.spacing_mm;
        for end in ends {
            let at = graph.voxel(end).as_dvec3();
            let reach = 2.0 * f64::from(around(&bricks.near()[end as usize / BRICK]));
            for (least, corner) in least.iter_mut().zip(bricks.corners()) {
                let low = IVec3::from_array(*corner).as_dvec3();
                let nearest = at.clamp(low, low + f64::from(SIDE - 1));
                if ((nearest - at) * h).length() <= reach {
                    *least = 0.0;
                }
            }
        }
        Self { least }
    }

    /// Whether to look at an element, `distance` mm from the wall.
    pub fn holds(&self, element: usize, distance: f32) -> bool {
        distance >= self.least[element / BRICK]
    }
}

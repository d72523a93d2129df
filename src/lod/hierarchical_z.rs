//! Hierarchical z-buffer of a view from inside a closed wall, for occlusion culling.
//!
//! Greene, Kass & Miller, "Hierarchical Z-buffer visibility", SIGGRAPH 1993,
//! doi:10.1145/166117.166147. Ours draws no occluders: the depth of a tile of the image is the one at
//! which the cross-section of its beam lies wholly in the exterior of the wall, found by sphere
//! tracing (Hart 1996, doi:10.1007/s003710050084) in the exterior grid. Thus it is ready before the
//! frame is drawn, and bounds the depth of every visible point of the tile instead of sampling it.

use glam::{DVec3, UVec2, Vec3};
use rayon::prelude::*;

use super::{ExteriorGrid, ViewFrustum};
use crate::geometry::Sphere;

/// Tiles along the height of the image.
const ROWS: u32 = 26;
/// Level of the widest beams: 2³ by 2³ tiles.
const TOP: u32 = 3;

/// Largest distance of any drawn surface from the wall, by view depth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthMargin {
    /// Millimetres a millimetre of depth.
    pub slope: f64,
    /// Least margin, mm.
    pub least_mm: f64,
    /// Largest margin, mm.
    pub most_mm: f64,
}

impl DepthMargin {
    /// Margin that is the same at all depths.
    pub fn constant(mm: f64) -> Self {
        Self { slope: 0.0, least_mm: mm, most_mm: mm }
    }

    /// Returns the margin at a view depth, mm both.
    pub fn at(&self, depth: f64) -> f64 {
        (self.slope * depth).max(self.least_mm).min(self.most_mm)
    }
}

/// Depths behind which each tile of an image is hidden, at several resolutions.
#[derive(Debug, PartialEq)]
pub struct HierarchicalZ {
    frustum: ViewFrustum,
    /// Tiles a unit of the tangent, horizontally and vertically.
    scale: [f64; 2],
    /// Resolutions, the finest first.
    levels: Vec<DepthTiles>,
}

/// Largest visible depth in each tile, mm; infinite where nothing is known to hide.
#[derive(Debug, PartialEq)]
struct DepthTiles {
    dims: UVec2,
    depths: Vec<f32>,
}

impl DepthTiles {
    /// Returns the largest of the depths of tiles `lo` to `hi`.
    fn largest(&self, lo: UVec2, hi: UVec2) -> f32 {
        let mut largest = 0f32;
        for y in lo.y..=hi.y {
            let row = (y * self.dims.x) as usize;
            let tiles = &self.depths[row + lo.x as usize..=row + hi.x as usize];
            largest = tiles.iter().fold(largest, |a, b| a.max(*b));
        }
        largest
    }

    /// Returns half the resolution.
    fn halved(&self) -> Self {
        let dims = (self.dims + 1) / 2;
        let tile = |i: u32| {
            let lo = 2 * UVec2::new(i % dims.x, i / dims.x);
            self.largest(lo, (lo + 1).min(self.dims - 1))
        };
        Self { dims, depths: (0..dims.x * dims.y).map(tile).collect() }
    }
}

impl HierarchicalZ {
    /// Traces the beams of a view. From an eye outside the wall no depth is known.
    ///
    /// * `frustum`: of the view.
    /// * `margin`: of the surfaces drawn in this view.
    pub fn new(frustum: &ViewFrustum, exterior: &ExteriorGrid, margin: DepthMargin) -> Self {
        let [t_x, t_y] = frustum.tangents();
        let columns = (f64::from(ROWS) * t_x / t_y).round().clamp(1.0, f64::from(8 * ROWS));
        let dims = UVec2::new(columns as u32, ROWS);
        let scale = [f64::from(dims.x) / (2.0 * t_x), f64::from(dims.y) / (2.0 * t_y)];
        if !exterior.is_interior(frustum.position()) {
            let depths = vec![f32::INFINITY; (dims.x * dims.y) as usize];
            return Self { frustum: *frustum, scale, levels: vec![DepthTiles { dims, depths }] };
        }
        // Depths up to which the wide beams lie wholly inside the wall.
        let mut above = vec![0f32];
        let mut width = 1;
        for level in (0..=TOP).rev() {
            let size = f64::from(1u32 << level);
            let tiles = UVec2::new(dims.x.div_ceil(1 << level), dims.y.div_ceil(1 << level));
            let beam = |i: u32| {
                let (x, y) = (i % tiles.x, i / tiles.x);
                let from = above[if level == TOP { 0 } else { (y / 2 * width + x / 2) as usize }];
                let centre = [x, y].map(|t| (f64::from(t) + 0.5) * size);
                let way = frustum.way(centre[0] / scale[0] - t_x, centre[1] / scale[1] - t_y);
                let reach = frustum.reach(0.5 * size / scale[0], 0.5 * size / scale[1]);
                let beam = exterior.beam(frustum.position(), way, reach, margin);
                let free = beam.inside_to(f64::from(from));
                if level > 0 { free as f32 } else { beam.hidden_from(free).next_up() }
            };
            let all = 0..tiles.x * tiles.y;
            above = if level > 0 {
                all.map(beam).collect()
            } else {
                all.into_par_iter().with_min_len(256).map(beam).collect()
            };
            width = tiles.x;
        }
        let mut levels = vec![DepthTiles { dims, depths: above }];
        while levels.last().is_some_and(|l| l.dims.max_element() > 4) {
            levels.extend(levels.last().map(DepthTiles::halved));
        }
        Self { frustum: *frustum, scale, levels }
    }

    /// Returns the view.
    pub fn frustum(&self) -> &ViewFrustum {
        &self.frustum
    }

    /// [`Self::hides`] of a box, LPS mm.
    pub fn hides_box(&self, centre: Vec3, half: Vec3) -> bool {
        self.hides(centre.as_dvec3() - self.frustum.position(), half.as_dvec3())
    }

    /// [`Self::hides`] of a sphere, LPS mm.
    pub fn hides_sphere(&self, s: &Sphere) -> bool {
        self.hides_box(s.centre, Vec3::splat(s.radius))
    }

    /// Whether the wall hides a whole box, or it is outside the image; `false` where that is not
    /// known.
    ///
    /// * `centre`: of the box, relative to the eye, along the axes of LPS like `half`, its half
    ///   extent.
    pub fn hides(&self, centre: DVec3, half: DVec3) -> bool {
        let Some((lo, hi, depth)) = self.frustum.rectangle(centre, half) else {
            return false;
        };
        let [t_x, t_y] = self.frustum.tangents();
        let tangents = [t_x, t_y];
        let dims = self.levels[0].dims;
        let tile = |k: usize, t: f64| ((t + tangents[k]) * self.scale[k]).floor();
        let (lo, hi) = ([0, 1].map(|k| tile(k, lo[k])), [0, 1].map(|k| tile(k, hi[k])));
        let last = [dims.x - 1, dims.y - 1].map(f64::from);
        if (0..2).any(|k| hi[k] < 0.0 || lo[k] > last[k]) {
            return true;
        }
        let place = |t: [f64; 2]| {
            UVec2::new(t[0].clamp(0.0, last[0]) as u32, t[1].clamp(0.0, last[1]) as u32)
        };
        let (lo, hi) = (place(lo), place(hi));
        // At most three tiles along each side.
        let span = (hi - lo).max_element();
        let level = (u32::BITS - (span / 2).leading_zeros()).min(self.levels.len() as u32 - 1);
        depth > f64::from(self.levels[level as usize].largest(lo >> level, hi >> level))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::torus;
    use crate::geometry::{Camera, Lens, Pose, TriangleBvh};

    fn view(eye: Vec3, to: Vec3, aspect: f32) -> ViewFrustum {
        let lens = Lens { fov_y_rad: 1.2, aspect, near_mm: 0.01 };
        let pose = Pose::looking(eye, to, Vec3::Z);
        ViewFrustum::new(&Camera { pose, lens, height_px: 100 })
    }

    #[test]
    fn a_ray_meets_the_wall_before_the_depth_of_each_tile_that_holds_it() {
        let mesh = torus(300, 90);
        let tree = TriangleBvh::new(&mesh);
        let exterior = ExteriorGrid::new(&mesh, 30_000);
        for (turn, aspect) in [(0.0f32, 1.6f32), (0.4, 1.0), (1.3, 0.3), (2.6, 2.4)] {
            let eye = Vec3::new(10.0, 0.5, 0.2);
            let view = view(eye, eye + Vec3::new(turn.sin(), turn.cos(), 0.1), aspect);
            let z = HierarchicalZ::new(&view, &exterior, DepthMargin::default());
            let [t_x, t_y] = view.tangents();
            let mut found = 0;
            for (level, tiles) in z.levels.iter().enumerate() {
                for (i, depth) in tiles.depths.iter().enumerate() {
                    if !depth.is_finite() {
                        continue;
                    }
                    found += 1;
                    let i = i as u32;
                    let place = [i % tiles.dims.x, i / tiles.dims.x];
                    for part in [[0.001, 0.001], [0.5, 0.4], [0.999, 0.2], [0.3, 0.999]] {
                        let t = [0, 1].map(|k| {
                            (f64::from(place[k]) + part[k]) * f64::from(1 << level) / z.scale[k]
                        });
                        let way = view.way((t[0] - t_x).min(t_x), (t[1] - t_y).min(t_y));
                        let along = f64::from(*depth) * way;
                        let hit = tree.first_hit(view.position(), along);
                        assert!(hit.is_some(), "level {level}, tile {place:?}, depth {depth}");
                    }
                }
            }
            assert!(found > 100, "{found} depths");
        }
    }

    #[test]
    fn a_box_is_hidden_behind_the_depths_of_its_tiles_and_outside_the_image() {
        let view = view(Vec3::ZERO, Vec3::Y, 1.0);
        let dims = UVec2::new(32, 32);
        let [t_x, t_y] = view.tangents();
        let scale = [t_x, t_y].map(|t| 32.0 / (2.0 * t));
        let mut depths = vec![10f32; 32 * 32];
        // One tile, in the middle, is open.
        depths[16 * 32 + 16] = f32::INFINITY;
        let mut levels = vec![DepthTiles { dims, depths }];
        levels.extend(levels.last().map(DepthTiles::halved));
        let z = HierarchicalZ { frustum: view, scale, levels };
        let half = DVec3::splat(0.1);
        let at = |column: f64, row: f64, depth: f64| {
            depth * view.way(column / scale[0] - t_x, row / scale[1] - t_y)
        };
        assert!(z.hides(at(5.0, 5.0, 12.0), half) && !z.hides(at(5.0, 5.0, 10.05), half));
        assert!(!z.hides(at(16.5, 16.5, 100.0), half) && z.hides(at(20.5, 16.5, 100.0), half));
        // Tiles of the level that a wide box looks up are wider.
        assert!(!z.hides(at(19.5, 16.5, 12.0), DVec3::splat(1.2)));
        assert!(z.hides(at(60.0, 16.0, 5.0), half), "beside the image");
        assert!(!z.hides(DVec3::ZERO, half), "about the eye");
    }
}

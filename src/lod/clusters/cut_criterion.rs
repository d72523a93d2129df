//! Refinement criterion of the view-dependent cut: the screen-space error of a group against the
//! tolerances, where the group is visible.

use super::{Cluster, Clusters, Group};
use crate::geometry::{HierarchicalZ, ProjectedBounds, Sphere, ViewFrustum};
use crate::lod::FULL_SHADING_PX;

/// Decides whether a camera accepts a group.
pub struct CutCriterion<'a> {
    /// View frustum of the camera.
    pub frustum: ViewFrustum,
    /// Distance tolerance, pixels.
    pub pixels: f64,
    /// Shading tolerance, radians.
    pub shading: f64,
    /// The hierarchy.
    pub clusters: &'a Clusters,
    /// Depths behind which the wall hides, if they are known.
    pub depths: Option<&'a HierarchicalZ>,
}

impl CutCriterion<'_> {
    /// Whether any point of the sphere may be visible: inside the frustum and not occluded.
    fn is_visible(&self, s: &Sphere) -> bool {
        self.frustum.intersects(s) && !self.depths.is_some_and(|d| d.hides_sphere(s))
    }

    /// Whether the wall hides a whole cluster and all that is within its error of it.
    fn is_hidden(&self, cluster: &Cluster) -> bool {
        let half = cluster.half + cluster.error_mm * (1.0 + 1e-6);
        self.depths.is_some_and(|d| d.hides_box(cluster.sphere.centre, half))
    }

    /// Ratio of the screen-space error of a group to what is allowed; `px` maps millimetres to
    /// pixels.
    ///
    /// Two criteria. Distance: no point may look farther off than the tolerance. Shading: the angle
    /// between normals, scaled down where coarse triangles look smaller than [`FULL_SHADING_PX`],
    /// may not exceed the shading tolerance; a wrong shade over one or two pixels is noise, over a
    /// large triangle it is a dent.
    fn error_ratio(
        &self,
        g: &Group,
        (error_mm, edge_mm): (f32, f32),
        px: impl Fn(f32) -> f64,
    ) -> f64 {
        let place = px(error_mm) / self.pixels;
        let size = (px(edge_mm) / FULL_SHADING_PX).min(1.0);
        place.max(f64::from(g.angle_rad) * size / self.shading)
    }

    /// Largest [`Self::error_ratio`] at any point of `s`; 0 if `s` is not visible.
    fn error_ratio_in(&self, g: &Group, error_mm: f32, s: &Sphere) -> f64 {
        if !self.is_visible(s) {
            return 0.0;
        }
        self.error_ratio(g, (error_mm, g.edge_mm), self.frustum.error_px_fn(s))
    }

    /// Whether the error of a group is larger than allowed. Every deviation is inside its outputs
    /// or within its error of them, so their triangles, much smaller than the bounding sphere of
    /// the group, tell more tightly how near it is and whether it is visible.
    pub fn too_coarse(&self, group: u32) -> bool {
        let c = self.clusters;
        let g = &c.groups[group as usize];
        if self.error_ratio_in(g, g.error_mm, &g.sphere) <= 1.0 {
            return false;
        }
        let shown: Vec<u32> =
            c.outputs(group).filter(|id| !self.is_hidden(&c.clusters[*id as usize])).collect();
        // Most groups that fail do so everywhere in some cluster; then its triangles need not be
        // fetched.
        let everywhere = |id: &u32| {
            let own = &c.clusters[*id as usize];
            self.frustum.min_error_px(&own.sphere, own.error_mm) > self.pixels
        };
        if shown.iter().any(everywhere) {
            return true;
        }
        // Each cluster has its own error, and each triangle its own longest edge.
        let coarse = |id: u32| -> Option<f32> {
            let own = &c.clusters[id as usize];
            let (e, s) = (own.error_mm, own.sphere);
            let wider = Sphere { radius: (s.radius + e).next_up(), ..s };
            (self.error_ratio_in(g, e, &wider) > 1.0).then_some(e)
        };
        let place = |v: u32| c.vertices[v as usize].position();
        let exceeds = |f: [u32; 3], [x, y, z]: [&ProjectedBounds; 3], e: f32| {
            let [a, b, d] = f.map(place);
            let edge = a.distance(b).max(b.distance(d)).max(d.distance(a));
            let s = x.union(y).union(z);
            self.error_ratio(g, (e, edge), |mm| self.frustum.bounds_error_px(&s, mm)) > 1.0
        };
        // Most of the remaining ones fail at their first triangle.
        let first = |id: &u32| {
            let e = c.clusters[*id as usize].error_mm;
            let bounds = |f: [u32; 3]| f.map(|v| self.frustum.project(place(v), e));
            c.faces(*id).next().is_some_and(|f| exceeds(f, bounds(f).each_ref(), e))
        };
        shown.iter().any(first)
            || shown.iter().filter_map(|id| Some((*id, coarse(*id)?))).any(|(id, e)| {
                let ids = c.vertex_ids(id);
                let bounds: Vec<ProjectedBounds> =
                    ids.iter().map(|v| self.frustum.project(place(*v), e)).collect();
                c.triangles(id).iter().any(|t| {
                    let t = t.map(usize::from);
                    exceeds(t.map(|v| ids[v]), t.map(|v| &bounds[v]), e)
                })
            })
    }

    /// Upper bound of the error ratio of a group and of every group below.
    pub fn subtree_error_ratio(&self, group: u32) -> f64 {
        let g = &self.clusters.groups[group as usize];
        if !self.is_visible(&g.subtree_sphere) {
            return 0.0;
        }
        let px = self.frustum.error_px_fn(&g.subtree_sphere);
        // The angle is weighted by the projected length of the longest edge: shorter edges look
        // shorter at least in proportion. Without edges, or where the length is unbounded, by the
        // angle alone.
        let turn = f64::from(g.subtree_turn_mm / g.edge_mm) * px(g.edge_mm) / FULL_SHADING_PX;
        let shade = turn.min(f64::from(g.subtree_angle_rad));
        (px(g.error_mm) / self.pixels).max(shade / self.shading)
    }
}

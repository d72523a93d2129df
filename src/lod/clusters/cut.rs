//! View-dependent cut: selects the clusters that a camera needs and moves there step by step within
//! the page cache.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::sync::Arc;

use super::cut_criterion::CutCriterion;
use super::{Cluster, Clusters, NO_GROUP};
use crate::geometry::{Camera, ViewFrustum};
use crate::lod::{
    LodHierarchy, LodStep, NoPage, OcclusionTest, PageCache, Tolerance, Upload, VisiblePatch,
};

/// Shading tolerance, radians: root mean square angle between the normals drawn and those of the
/// original that is accepted where triangles look large. It changes the light by a tenth at most,
/// and on a colon of 1 M faces at one pixel it adds hardly a triangle to what the distance
/// tolerance asks for.
pub const DEFAULT_SHADING_RAD: f32 = 0.1;

/// A cluster hierarchy and its current cut.
#[derive(Debug)]
pub struct ClusterLod {
    clusters: Arc<Clusters>,
    shading_rad: f32,
    occlusion: Option<Arc<OcclusionTest>>,
    /// Whether each group is open.
    open: Vec<bool>,
    opened: BTreeSet<u32>,
    /// Clusters of the cut.
    cut: BTreeSet<u32>,
    roots: Vec<u32>,
    /// Groups whose outputs are all roots.
    top_groups: Vec<u32>,
    /// Number of clusters of the cut that are not roots. Roots are always resident, so these take
    /// pages in addition.
    pages_beyond_roots: u32,
    widest: u32,
    /// Last step that visited each group, and last step that required it open.
    visited: Vec<[u64; 2]>,
    steps: u64,
}

/// The cut that a camera requires.
struct TargetCut {
    /// Groups that are open, ascending.
    groups: Vec<u32>,
    /// Whether groups were left out for lack of pages.
    degraded: bool,
}

/// Priority: largest error ratio first, then smallest id. Ratios are not negative, so their bits
/// order them.
fn priority(error_ratio: f64, group: u32) -> (u64, Reverse<u32>) {
    (error_ratio.to_bits(), Reverse(group))
}

impl ClusterLod {
    /// Starts with the coarsest cut. `shading_rad`: see [`DEFAULT_SHADING_RAD`]; infinite for no
    /// shading criterion.
    pub fn new(clusters: Arc<Clusters>, shading_rad: f32) -> Self {
        let roots: Vec<u32> = clusters.roots().collect();
        let last = |c: u32| clusters.clusters[c as usize].input_of == NO_GROUP;
        let groups = 0..clusters.groups.len() as u32;
        Self {
            shading_rad,
            occlusion: None,
            open: vec![false; clusters.groups.len()],
            visited: vec![[0; 2]; clusters.groups.len()],
            steps: 0,
            opened: BTreeSet::new(),
            cut: roots.iter().copied().collect(),
            top_groups: groups.filter(|g| clusters.outputs(*g).all(last)).collect(),
            roots,
            pages_beyond_roots: 0,
            widest: clusters.widest_group(),
            clusters,
        }
    }

    /// Never refines what the occlusion test rejects. Cameras must be inside the wall.
    #[must_use]
    pub fn with_occlusion(self, occlusion: Arc<OcclusionTest>) -> Self {
        Self { occlusion: Some(occlusion), ..self }
    }

    /// The hierarchy.
    pub fn clusters(&self) -> &Clusters {
        &self.clusters
    }

    /// Ids of the clusters of the cut, ascending.
    pub fn drawn(&self) -> impl Iterator<Item = u32> + '_ {
        self.cut.iter().copied()
    }

    /// Least number of pages: the coarsest surface and one group.
    pub fn least_pages(&self) -> u32 {
        self.roots.len() as u32 + self.widest
    }

    /// Groups that made the inputs of a group.
    fn below(&self, group: u32) -> impl Iterator<Item = u32> + '_ {
        let output_of = |c: &u32| self.clusters.clusters[*c as usize].output_of;
        self.clusters.inputs(group).iter().map(output_of).filter(|g| *g != NO_GROUP)
    }

    /// Groups that use the outputs of a group.
    fn above(&self, group: u32) -> impl Iterator<Item = u32> + '_ {
        let input_of = |c: u32| self.clusters.clusters[c as usize].input_of;
        self.clusters.outputs(group).map(input_of).filter(|g| *g != NO_GROUP)
    }

    /// Pages that opening a group takes in addition.
    fn page_gain(&self, group: u32) -> i64 {
        let root = |c: &u32| self.clusters.clusters[*c as usize].input_of == NO_GROUP;
        let outputs = self.clusters.outputs(group).filter(|c| !root(c)).count();
        self.clusters.inputs(group).len() as i64 - outputs as i64
    }

    /// Groups that must be open: those whose own error is too large, and all groups above them.
    /// Visits open surroundings only: from the top down while the bound of a subtree is still too
    /// large.
    fn wanted(&mut self, criterion: &CutCriterion<'_>, room: i64) -> TargetCut {
        self.steps += 1;
        let now = self.steps;
        let mut visited = std::mem::take(&mut self.visited);
        // Whether this is the first visit in this step.
        let mut first =
            |what: usize, g: u32| std::mem::replace(&mut visited[g as usize][what], now) != now;
        let mut wanted = Vec::new();
        let mut queue: Vec<u32> = self.top_groups.clone();
        let mut climb = Vec::new();
        while let Some(g) = queue.pop() {
            if !first(0, g) || criterion.subtree_error_ratio(g) <= 1.0 {
                continue;
            }
            queue.extend(self.below(g));
            if criterion.too_coarse(g) {
                climb.push(g);
                while let Some(g) = climb.pop() {
                    if first(1, g) {
                        wanted.push(g);
                        climb.extend(self.above(g));
                    }
                }
            }
        }
        self.visited = visited;
        wanted.sort_unstable();
        let size: i64 = wanted.iter().map(|g| self.page_gain(*g)).sum();
        if size <= room {
            return TargetCut { groups: wanted, degraded: false };
        }
        // Largest error ratio first, as far as pages go.
        let mut taken = BTreeSet::new();
        let mut size = 0;
        let ready = |taken: &BTreeSet<u32>, g: u32| self.above(g).all(|a| taken.contains(&a));
        let mut heap: BinaryHeap<_> = wanted
            .iter()
            .filter(|g| ready(&taken, **g))
            .map(|g| priority(criterion.subtree_error_ratio(*g), *g))
            .collect();
        while let Some((_, Reverse(g))) = heap.pop() {
            if taken.contains(&g) {
                continue;
            }
            if size + self.page_gain(g) > room {
                break;
            }
            size += self.page_gain(g);
            taken.insert(g);
            let next =
                self.below(g).filter(|b| wanted.binary_search(b).is_ok() && ready(&taken, *b));
            heap.extend(next.map(|b| priority(criterion.subtree_error_ratio(b), b)));
        }
        TargetCut { groups: taken.into_iter().collect(), degraded: true }
    }

    fn upload(&self, cluster: u32, page: u32) -> Upload {
        let c = &self.clusters;
        let vertices = c.vertex_ids(cluster).iter().map(|v| c.vertices[*v as usize]).collect();
        Upload { page, vertices, triangles: c.triangles(cluster).to_vec() }
    }

    /// Makes clusters resident; those that succeeded stay so if one fails.
    fn make_resident(
        &self,
        clusters: impl Iterator<Item = u32> + Clone,
        cache: &mut PageCache,
        uploads: &mut Vec<Upload>,
    ) -> Result<(), NoPage> {
        // Touch first, then allocate: an allocation may evict what was not touched.
        let missing: Vec<u32> = clusters.filter(|c| cache.touch(u64::from(*c)).is_none()).collect();
        for c in missing {
            let page = cache.allocate(u64::from(c))?;
            uploads.push(self.upload(c, page));
        }
        Ok(())
    }

    fn set_open(&mut self, group: u32, open: bool) {
        self.open[group as usize] = open;
        let clusters = Arc::clone(&self.clusters);
        let page_gain = self.page_gain(group);
        if open {
            self.opened.insert(group);
            clusters.outputs(group).for_each(|c| {
                self.cut.remove(&c);
            });
            self.cut.extend(clusters.inputs(group));
            self.pages_beyond_roots = (i64::from(self.pages_beyond_roots) + page_gain) as u32;
        } else {
            self.opened.remove(&group);
            clusters.inputs(group).iter().for_each(|c| {
                self.cut.remove(c);
            });
            self.cut.extend(clusters.outputs(group));
            self.pages_beyond_roots = (i64::from(self.pages_beyond_roots) - page_gain) as u32;
        }
    }

    /// Opens required groups, largest error ratio first; returns whether all are open.
    fn open_wanted(
        &mut self,
        wanted: &[u32],
        criterion: &CutCriterion<'_>,
        room: i64,
        cache: &mut PageCache,
        step: &mut LodStep,
    ) -> bool {
        let is_wanted = |g: &u32| wanted.binary_search(g).is_ok();
        let closed = wanted.iter().filter(|g| !self.open[**g as usize]);
        let mut heap: BinaryHeap<_> = closed
            .filter(|g| self.above(**g).all(|a| self.open[a as usize]))
            .map(|g| priority(criterion.subtree_error_ratio(*g), *g))
            .collect();
        while let Some((_, Reverse(g))) = heap.pop() {
            if self.open[g as usize] {
                continue;
            }
            if i64::from(self.pages_beyond_roots) + self.page_gain(g) > room {
                return false;
            }
            let clusters = Arc::clone(&self.clusters);
            let inputs = clusters.inputs(g).iter().copied();
            if self.make_resident(inputs, cache, &mut step.uploads).is_err() {
                return false;
            }
            self.set_open(g, true);
            step.leaves_changed += 1;
            let next: Vec<u32> = self
                .below(g)
                .filter(|b| is_wanted(b) && !self.open[*b as usize])
                .filter(|b| self.above(*b).all(|a| self.open[a as usize]))
                .collect();
            heap.extend(next.into_iter().map(|b| priority(criterion.subtree_error_ratio(b), b)));
        }
        true
    }

    /// Closes open groups that are not required, finest first; returns whether none is left.
    fn close_unwanted(
        &mut self,
        wanted: &[u32],
        cache: &mut PageCache,
        step: &mut LodStep,
    ) -> bool {
        let extra: Vec<u32> =
            self.opened.iter().copied().filter(|g| wanted.binary_search(g).is_err()).collect();
        let mut all = true;
        // Ids ascend with level, so finer groups come first.
        for g in extra {
            if self.below(g).any(|b| self.open[b as usize]) {
                all = false;
                continue;
            }
            let mut outputs = self.clusters.outputs(g);
            // Without allocations left, only resident outputs can be used.
            if !all && !outputs.all(|c| cache.contains(u64::from(c))) {
                continue;
            }
            let outputs = self.clusters.outputs(g);
            if self.make_resident(outputs, cache, &mut step.uploads).is_err() {
                all = false;
                continue;
            }
            self.set_open(g, false);
            step.leaves_changed += 1;
        }
        all
    }
}

impl LodHierarchy for ClusterLod {
    fn step(&mut self, camera: &Camera, tolerance: &Tolerance, cache: &mut PageCache) -> LodStep {
        let mut step = LodStep::default();
        // The current cut and the roots must not be evicted.
        for c in self.cut.iter().chain(&self.roots) {
            cache.touch(u64::from(*c));
        }
        let rooted = self.make_resident(self.roots.iter().copied(), cache, &mut step.uploads);
        if rooted.is_ok() {
            let clusters = Arc::clone(&self.clusters);
            let frustum = ViewFrustum::new(camera);
            let pixels = f64::from(tolerance.pixels).max(1e-9);
            let within = |test: &Arc<OcclusionTest>| test.depths_within(&frustum, pixels);
            let depths = self.occlusion.as_ref().map(within).map(Arc::new);
            let criterion = CutCriterion {
                frustum,
                pixels,
                shading: f64::from(self.shading_rad).max(1e-9),
                clusters: &clusters,
                depths: depths.as_deref(),
            };
            // Pages of one group stay free, so that any change can be made.
            let room = i64::from(cache.pages()) - i64::from(self.least_pages());
            let wanted = self.wanted(&criterion, room);
            let opened = self.open_wanted(&wanted.groups, &criterion, room, cache, &mut step);
            let closed = self.close_unwanted(&wanted.groups, cache, &mut step);
            step.settled = opened && closed;
            step.degraded = wanted.degraded;
            step.depths = depths.filter(|_| step.settled && !step.degraded);
        } else {
            // Too few pages for the coarsest surface, or not yet.
            step.degraded = rooted == Err(NoPage::AllDrawn);
            step.settled = step.degraded;
        }
        let all = &self.clusters.clusters;
        step.drawn.reserve(self.cut.len());
        for &c in &self.cut {
            if let Some(page) = cache.touch(u64::from(c)) {
                let Cluster { sphere, half, cone, triangles, .. } = all[c as usize];
                let resident = None;
                step.drawn.push(VisiblePatch { page, resident, triangles, sphere, half, cone });
            }
        }
        step
    }

    fn state_hash(&self) -> u64 {
        // FNV-1a.
        let bytes = self.cut.iter().flat_map(|c| c.to_le_bytes());
        bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }

    fn finest_faces(&self) -> u64 {
        self.clusters.finest_faces()
    }
}

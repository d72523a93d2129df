//! The cut that a camera wants, reached step by step within the pages there are.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::sync::Arc;

use super::{Clusters, Group, NONE};
use crate::lod::{
    Camera, Drawn, Eye, Full, Outside, Pool, Refine, Sphere, Spot, Step, Tolerance, Upload,
};

/// Root mean square angle between the normals drawn and the original's that is let pass where
/// triangles look large: a tenth of the light at most, and on a colon of 1 M faces at one pixel
/// hardly a triangle more than the tolerance of places asks for anyway.
pub const DEFAULT_SHADING_RAD: f32 = 0.1;
/// Triangles whose edges look at least this long show their shading in full, pixels.
const FULL_SHADING_PX: f64 = 16.0;

/// Clusters and which of their groups are open.
#[derive(Debug)]
pub struct ClusterLod {
    clusters: Arc<Clusters>,
    shading_rad: f32,
    outside: Option<Arc<Outside>>,
    /// By group.
    open: Vec<bool>,
    opened: BTreeSet<u32>,
    /// Drawn clusters.
    cut: BTreeSet<u32>,
    roots: Vec<u32>,
    /// Groups whose outputs are all coarsest.
    tops: Vec<u32>,
    /// Of the cut, those that are no roots: they take pages beside the roots'.
    beside_roots: u32,
    widest: u32,
    /// By group: the last step that met it, and the last that wanted it.
    met: Vec<[u64; 2]>,
    steps: u64,
}

/// What a camera wants to be open.
struct Wanted {
    /// Groups, ascending.
    groups: Vec<u32>,
    /// Fewer than it wants, for lack of pages.
    degraded: bool,
}

struct View<'a> {
    eye: Eye,
    pixels: f64,
    shading: f64,
    clusters: &'a Clusters,
    outside: Option<&'a Outside>,
}

impl View<'_> {
    /// Whether any point of the sphere may be seen.
    fn sees(&self, s: &Sphere) -> bool {
        self.eye.sees(s) && !self.outside.is_some_and(|o| o.hides(self.eye.position(), s))
    }

    /// How many times what is allowed the errors of a group look, where an error of so many
    /// millimetres looks as large as `px` says.
    ///
    /// Two rules. No point may look farther off than the tolerance. And the angle between normals,
    /// scaled down where the coarse triangles look smaller than [`FULL_SHADING_PX`], may not be
    /// larger than the shading tolerance: a wrong shade over a pixel or two is noise, over a broad
    /// triangle it is a dent.
    fn excess(&self, g: &Group, (error_mm, edge_mm): (f32, f32), px: impl Fn(f32) -> f64) -> f64 {
        let place = px(error_mm) / self.pixels;
        let size = (px(edge_mm) / FULL_SHADING_PX).min(1.0);
        place.max(f64::from(g.angle_rad) * size / self.shading)
    }

    /// That anywhere in `s`; 0 if unseen.
    fn within(&self, g: &Group, error_mm: f32, s: &Sphere) -> f64 {
        if !self.sees(s) {
            return 0.0;
        }
        self.excess(g, (error_mm, g.edge_mm), self.eye.errors_px(s))
    }

    /// Whether the errors of a group look larger than allowed. What errs lies in its outputs or
    /// within its error of them, so that their triangles, much smaller than the group's sphere, say
    /// better how near it is and whether it is in the picture at all.
    fn too_coarse(&self, group: u32) -> bool {
        let c = self.clusters;
        let g = &c.groups[group as usize];
        if self.within(g, g.error_mm, &g.sphere) <= 1.0 {
            return false;
        }
        // Most that are, are so everywhere in some cluster: no need to fetch its triangles then.
        let everywhere = |id: u32| {
            let own = &c.clusters[id as usize];
            self.eye.least_error_px(&own.sphere, own.error_mm) > self.pixels
        };
        if c.outputs(group).any(everywhere) {
            return true;
        }
        // Each cluster errs as far as it does, near or far, and each triangle is as broad as it is.
        let coarse = |id: u32| -> Option<f32> {
            let own = &c.clusters[id as usize];
            let (e, s) = (own.error_mm, own.sphere);
            let wider = Sphere { radius: (s.radius + e).next_up(), ..s };
            (self.within(g, e, &wider) > 1.0).then_some(e)
        };
        let place = |v: u32| c.vertices[v as usize].position();
        let exceeds = |f: [u32; 3], [x, y, z]: [&Spot; 3], e: f32| {
            let [a, b, d] = f.map(place);
            let edge = a.distance(b).max(b.distance(d)).max(d.distance(a));
            let s = x.with(y).with(z);
            self.excess(g, (e, edge), |mm| self.eye.error_in_spot_px(&s, mm)) > 1.0
        };
        // Most others are so nearly everywhere.
        let first = |id: u32| {
            let e = c.clusters[id as usize].error_mm;
            let spots = |f: [u32; 3]| f.map(|v| self.eye.spot(place(v), e));
            c.faces(id).next().is_some_and(|f| exceeds(f, spots(f).each_ref(), e))
        };
        c.outputs(group).any(first)
            || c.outputs(group).filter_map(|id| Some((id, coarse(id)?))).any(|(id, e)| {
                let ids = c.vertex_ids(id);
                let spots: Vec<Spot> = ids.iter().map(|v| self.eye.spot(place(*v), e)).collect();
                c.triangles(id).iter().any(|t| {
                    let t = t.map(usize::from);
                    exceeds(t.map(|v| ids[v]), t.map(|v| &spots[v]), e)
                })
            })
    }

    /// At least that of the group and of every one below.
    fn reach(&self, group: u32) -> f64 {
        let g = &self.clusters.groups[group as usize];
        if !self.sees(&g.reach) {
            return 0.0;
        }
        let px = self.eye.errors_px(&g.reach);
        // An angle counts as the longest edge looks: shorter ones look shorter at least in
        // proportion. Where there is no edge or no end to how long it looks, the angle alone.
        let turn = f64::from(g.reach_turn_mm / g.edge_mm) * px(g.edge_mm) / FULL_SHADING_PX;
        let shade = turn.min(f64::from(g.reach_angle_rad));
        (px(g.error_mm) / self.pixels).max(shade / self.shading)
    }
}

/// Largest excess first, then smallest id; `f64` not negative, so its bits order it.
fn rank(excess: f64, group: u32) -> (u64, Reverse<u32>) {
    (excess.to_bits(), Reverse(group))
}

impl ClusterLod {
    /// Nothing open. `shading_rad`: see [`DEFAULT_SHADING_RAD`]; infinite to let any shading pass.
    pub fn new(clusters: Arc<Clusters>, shading_rad: f32) -> Self {
        let roots: Vec<u32> = clusters.roots().collect();
        let last = |c: u32| clusters.clusters[c as usize].used_by == NONE;
        let groups = 0..clusters.groups.len() as u32;
        Self {
            shading_rad,
            outside: None,
            open: vec![false; clusters.groups.len()],
            met: vec![[0; 2]; clusters.groups.len()],
            steps: 0,
            opened: BTreeSet::new(),
            cut: roots.iter().copied().collect(),
            tops: groups.filter(|g| clusters.outputs(*g).all(last)).collect(),
            roots,
            beside_roots: 0,
            widest: clusters.widest_group(),
            clusters,
        }
    }

    /// The same, with nothing refined that the wall hides. Cameras stand within it.
    #[must_use]
    pub fn within(self, outside: Arc<Outside>) -> Self {
        Self { outside: Some(outside), ..self }
    }

    /// The hierarchy.
    pub fn clusters(&self) -> &Clusters {
        &self.clusters
    }

    /// Ids of the drawn clusters, ascending.
    pub fn drawn(&self) -> impl Iterator<Item = u32> + '_ {
        self.cut.iter().copied()
    }

    /// Pages below which not even the coarsest surface can be drawn, and above which detail begins.
    pub fn least_pages(&self) -> u32 {
        self.roots.len() as u32 + self.widest
    }

    /// Groups that made the inputs of a group.
    fn below(&self, group: u32) -> impl Iterator<Item = u32> + '_ {
        let made_by = |c: &u32| self.clusters.clusters[*c as usize].made_by;
        self.clusters.inputs(group).iter().map(made_by).filter(|g| *g != NONE)
    }

    /// Groups that use the outputs of a group.
    fn above(&self, group: u32) -> impl Iterator<Item = u32> + '_ {
        let used_by = |c: u32| self.clusters.clusters[c as usize].used_by;
        self.clusters.outputs(group).map(used_by).filter(|g| *g != NONE)
    }

    /// Clusters beside the roots that a group adds to the cut when opened.
    fn gain(&self, group: u32) -> i64 {
        let root = |c: &u32| self.clusters.clusters[*c as usize].used_by == NONE;
        let outputs = self.clusters.outputs(group).filter(|c| !root(c)).count();
        self.clusters.inputs(group).len() as i64 - outputs as i64
    }

    /// Groups that have to be open: those whose own errors look too large, and whatever lies above
    /// them. Looks only at open surroundings: from the tops down while the reach of a group, which
    /// holds all below it, still shows too large an error.
    fn wanted(&mut self, view: &View<'_>, room: i64) -> Wanted {
        self.steps += 1;
        let now = self.steps;
        let mut met = std::mem::take(&mut self.met);
        // Whether this is the first time.
        let mut first =
            |what: usize, g: u32| std::mem::replace(&mut met[g as usize][what], now) != now;
        let mut wanted = Vec::new();
        let mut look: Vec<u32> = self.tops.clone();
        let mut climb = Vec::new();
        while let Some(g) = look.pop() {
            if !first(0, g) || view.reach(g) <= 1.0 {
                continue;
            }
            look.extend(self.below(g));
            if view.too_coarse(g) {
                climb.push(g);
                while let Some(g) = climb.pop() {
                    if first(1, g) {
                        wanted.push(g);
                        climb.extend(self.above(g));
                    }
                }
            }
        }
        self.met = met;
        wanted.sort_unstable();
        let size: i64 = wanted.iter().map(|g| self.gain(*g)).sum();
        if size <= room {
            return Wanted { groups: wanted, degraded: false };
        }
        // The worst first, as far as pages go.
        let mut taken = BTreeSet::new();
        let mut size = 0;
        let ready = |taken: &BTreeSet<u32>, g: u32| self.above(g).all(|a| taken.contains(&a));
        let mut heap: BinaryHeap<_> = wanted
            .iter()
            .filter(|g| ready(&taken, **g))
            .map(|g| rank(view.reach(*g), *g))
            .collect();
        while let Some((_, Reverse(g))) = heap.pop() {
            if taken.contains(&g) {
                continue;
            }
            if size + self.gain(g) > room {
                break;
            }
            size += self.gain(g);
            taken.insert(g);
            let next =
                self.below(g).filter(|b| wanted.binary_search(b).is_ok() && ready(&taken, *b));
            heap.extend(next.map(|b| rank(view.reach(b), b)));
        }
        Wanted { groups: taken.into_iter().collect(), degraded: true }
    }

    fn upload(&self, cluster: u32, page: u32) -> Upload {
        let c = &self.clusters;
        let vertices = c.vertex_ids(cluster).iter().map(|v| c.vertices[*v as usize]).collect();
        Upload { page, vertices, triangles: c.triangles(cluster).to_vec() }
    }

    /// Makes all of these resident; those that got there stay so if one does not.
    fn gather(
        &self,
        clusters: impl Iterator<Item = u32> + Clone,
        pool: &mut Pool,
        uploads: &mut Vec<Upload>,
    ) -> Result<(), Full> {
        // First keep, then claim: a claim may drive out what was not kept.
        let missing: Vec<u32> = clusters.filter(|c| pool.keep(u64::from(*c)).is_none()).collect();
        for c in missing {
            let page = pool.claim(u64::from(c))?;
            uploads.push(self.upload(c, page));
        }
        Ok(())
    }

    fn set(&mut self, group: u32, open: bool) {
        self.open[group as usize] = open;
        let clusters = Arc::clone(&self.clusters);
        let gain = self.gain(group);
        if open {
            self.opened.insert(group);
            clusters.outputs(group).for_each(|c| {
                self.cut.remove(&c);
            });
            self.cut.extend(clusters.inputs(group));
            self.beside_roots = (i64::from(self.beside_roots) + gain) as u32;
        } else {
            self.opened.remove(&group);
            clusters.inputs(group).iter().for_each(|c| {
                self.cut.remove(c);
            });
            self.cut.extend(clusters.outputs(group));
            self.beside_roots = (i64::from(self.beside_roots) - gain) as u32;
        }
    }

    /// Opens what is wanted and not open, worst first; whether all is.
    fn open_wanted(
        &mut self,
        wanted: &[u32],
        view: &View<'_>,
        room: i64,
        pool: &mut Pool,
        step: &mut Step,
    ) -> bool {
        let is_wanted = |g: &u32| wanted.binary_search(g).is_ok();
        let closed = wanted.iter().filter(|g| !self.open[**g as usize]);
        let mut heap: BinaryHeap<_> = closed
            .filter(|g| self.above(**g).all(|a| self.open[a as usize]))
            .map(|g| rank(view.reach(*g), *g))
            .collect();
        while let Some((_, Reverse(g))) = heap.pop() {
            if self.open[g as usize] {
                continue;
            }
            if i64::from(self.beside_roots) + self.gain(g) > room {
                return false;
            }
            let clusters = Arc::clone(&self.clusters);
            let inputs = clusters.inputs(g).iter().copied();
            if self.gather(inputs, pool, &mut step.uploads).is_err() {
                return false;
            }
            self.set(g, true);
            step.leaves_changed += 1;
            let next: Vec<u32> = self
                .below(g)
                .filter(|b| is_wanted(b) && !self.open[*b as usize])
                .filter(|b| self.above(*b).all(|a| self.open[a as usize]))
                .collect();
            heap.extend(next.into_iter().map(|b| rank(view.reach(b), b)));
        }
        true
    }

    /// Closes what is open and not wanted, finest first; whether nothing such is left.
    fn close_unwanted(&mut self, wanted: &[u32], pool: &mut Pool, step: &mut Step) -> bool {
        let extra: Vec<u32> =
            self.opened.iter().copied().filter(|g| wanted.binary_search(g).is_err()).collect();
        let mut all = true;
        // Groups come after those below them.
        for g in extra {
            if self.below(g).any(|b| self.open[b as usize]) {
                all = false;
                continue;
            }
            let mut outputs = self.clusters.outputs(g);
            // Without a claim left, only what is resident can be gone back to.
            if !all && !outputs.all(|c| pool.holds(u64::from(c))) {
                continue;
            }
            let outputs = self.clusters.outputs(g);
            if self.gather(outputs, pool, &mut step.uploads).is_err() {
                all = false;
                continue;
            }
            self.set(g, false);
            step.leaves_changed += 1;
        }
        all
    }
}

impl Refine for ClusterLod {
    fn step(&mut self, camera: &Camera, tolerance: &Tolerance, pool: &mut Pool) -> Step {
        let mut step = Step::default();
        // What is drawn or always resident must not be driven out by what is claimed.
        for c in self.cut.iter().chain(&self.roots) {
            pool.keep(u64::from(*c));
        }
        let rooted = self.gather(self.roots.iter().copied(), pool, &mut step.uploads);
        if rooted.is_ok() {
            let clusters = Arc::clone(&self.clusters);
            let outside = self.outside.clone();
            let view = View {
                eye: Eye::new(camera),
                pixels: f64::from(tolerance.pixels).max(1e-9),
                shading: f64::from(self.shading_rad).max(1e-9),
                clusters: &clusters,
                outside: outside.as_deref(),
            };
            // One group's worth of pages stays free, so that any change can be made.
            let room = i64::from(pool.pages()) - i64::from(self.least_pages());
            let wanted = self.wanted(&view, room);
            let opened = self.open_wanted(&wanted.groups, &view, room, pool, &mut step);
            let closed = self.close_unwanted(&wanted.groups, pool, &mut step);
            step.settled = opened && closed;
            step.degraded = wanted.degraded;
        } else {
            // Too few pages for the coarsest surface, or not yet.
            step.degraded = rooted == Err(Full::Pages);
            step.settled = step.degraded;
        }
        let all = &self.clusters.clusters;
        step.drawn.reserve(self.cut.len());
        for &c in &self.cut {
            if let Some(page) = pool.keep(u64::from(c)) {
                let c = &all[c as usize];
                let (sphere, cone) = (c.sphere, c.cone);
                step.drawn.push(Drawn { page, triangles: c.triangles, sphere, cone });
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

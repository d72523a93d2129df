//! The current cut, and how it changes within the page cache.
//!
//! A cut is given by one fineness for each leaf; any values give a surface without cracks. A step
//! moves from the current cut to one where some leaves have the fineness that the camera requires
//! and the others what they had: the largest number of leaves, in order of their screen-space
//! error, whose pages can be written now. If not even one leaf can change at once, its pages are
//! written ahead, step by step, and drawn when all of them are resident.
//!
//! Pages of the base are always resident. A cut may use half of all pages, so the current cut and
//! the next fit side by side and no sequence of cameras leads to a deadlock; the other half holds
//! patches of earlier cuts. A cut that needs more is coarsened as a whole.

use std::sync::Arc;

use rayon::prelude::*;

use super::fineness::{Fineness, balance};
use super::pages::{Page, mix, pages};
use super::select::{error_mm, select};
use super::surface::SubdivisionSurface;
use crate::geometry::{Camera, ViewFrustum};
use crate::lod::{LodHierarchy, LodStep, PageCache, Tolerance, Upload, VisiblePatch};

/// Factor of the tolerance, in octaves, by which a cut that does not fit is coarsened.
const COARSER: f64 = 0.25;

/// View-dependent subdivision of a surface and its current cut.
pub struct Vds {
    surface: Arc<SubdivisionSurface>,
    /// Pages of every leaf at the base level.
    base_pages: Vec<Vec<Page>>,
    base_page_count: usize,
    /// Fineness of each leaf, and of each base face.
    leaf: Vec<Fineness>,
    pub(super) face: Vec<Fineness>,
    /// Pages of each leaf in the current cut.
    pub(super) now: Vec<Vec<Page>>,
    pub(super) drawn: Vec<Vec<VisiblePatch>>,
    /// Number of pages of the cut and of the base.
    pages: usize,
    /// Whether the base has been drawn.
    started: bool,
    /// The cache had no page although uploads were left: head directly for the final cut, so that
    /// pages written ahead are not evicted by those of intermediate ones.
    direct: bool,
}

/// A cut that could be drawn next.
pub(super) struct CutGoal {
    leaf: Vec<Fineness>,
    face: Vec<Fineness>,
    /// Leaves whose pages differ from the current cut.
    changed: Vec<(u32, Vec<Page>)>,
    /// Number of pages of the whole cut and of the base.
    pages: usize,
}

impl Vds {
    /// Starts with nothing drawn.
    pub fn new(surface: Arc<SubdivisionSurface>) -> Self {
        let leaves = surface.leaves.len();
        let face = vec![0; surface.base.faces.len()];
        let at_base = |l: usize| pages(&surface, &face, l as u32);
        let base_pages: Vec<Vec<Page>> = (0..leaves).into_par_iter().map(at_base).collect();
        let base_page_count = base_pages.iter().map(Vec::len).sum();
        Self {
            now: base_pages.clone(),
            base_pages,
            base_page_count,
            pages: base_page_count,
            leaf: vec![0; leaves],
            face,
            drawn: vec![Vec::new(); leaves],
            started: false,
            direct: false,
            surface,
        }
    }

    /// Least number of pages: those of the base mesh.
    pub fn least_pages(&self) -> u32 {
        self.base_page_count as u32
    }

    /// The surface.
    pub fn surface(&self) -> &Arc<SubdivisionSurface> {
        &self.surface
    }

    /// Fineness of each base face, in eighths of a level.
    pub fn fineness(&self) -> &[u8] {
        &self.face
    }

    /// Number of pages that a cut may use.
    fn room(&self, cache: &PageCache) -> usize {
        (cache.pages() as usize / 2).max(self.base_page_count)
    }

    /// Number of pages of a leaf that are not those of the base.
    fn pages_beyond_base(&self, leaf: u32, own: &[Page]) -> usize {
        let base_pages = &self.base_pages[leaf as usize];
        let same = own.len() == base_pages.len()
            && own.iter().zip(base_pages).all(|(a, b)| a.key == b.key);
        if same { 0 } else { own.len() }
    }

    /// The cut with the given fineness of leaves.
    pub(super) fn cut_for(&self, leaf: Vec<Fineness>) -> CutGoal {
        let s = &*self.surface;
        let mut face = self.face.clone();
        let moved = (0..leaf.len()).filter(|l| leaf[*l] != self.leaf[*l]);
        let seeds = moved.flat_map(|l| s.leaves[l].faces.iter().copied());
        let of = |f: u32| leaf[s.leaf_of[f as usize] as usize];
        let near = balance(&s.base, &of, seeds, s.depth(), &mut face);
        let mut touched = Vec::new();
        for f in near {
            let (old, new) = (self.face[f as usize], face[f as usize]);
            if old == new {
                continue;
            }
            touched.push(s.leaf_of[f as usize]);
            for g in (0..3).filter_map(|e| s.base.across(f, e)) {
                if old.max(self.face[g as usize]) != new.max(face[g as usize]) {
                    touched.push(s.leaf_of[g as usize]);
                }
            }
        }
        touched.sort_unstable();
        touched.dedup();
        let changed: Vec<(u32, Vec<Page>)> =
            touched.into_iter().map(|l| (l, pages(s, &face, l))).collect();
        let finer = |l: u32, own: &[Page]| self.pages_beyond_base(l, own);
        let pages = changed.iter().fold(self.pages, |sum, (l, own)| {
            sum + finer(*l, own) - finer(*l, &self.now[*l as usize])
        });
        CutGoal { leaf, face, changed, pages }
    }

    /// The cut that the camera requires, coarsened until it fits, and whether it had to be.
    fn wanted(&self, frustum: &ViewFrustum, tolerance: &Tolerance, room: usize) -> (CutGoal, bool) {
        let finest = 8 * self.surface.depth() as i32;
        let mut rung = 0;
        loop {
            let pixels = f64::from(tolerance.pixels) * (COARSER * f64::from(rung)).exp2();
            let mut leaf = select(&self.surface, frustum, pixels);
            // Where the camera touches the wall no tolerance is large enough.
            let most = (finest - rung).max(0) as Fineness;
            let most = if self.surface.options.morph { most } else { most / 8 * 8 };
            leaf.iter_mut().for_each(|q| *q = (*q).min(most));
            let goal = self.cut_for(leaf);
            if goal.pages <= room || most == 0 {
                return (goal, rung > 0);
            }
            rung += 1;
        }
    }

    /// Leaves that change, sorted: refined ones first, by screen-space error.
    fn order(&self, frustum: &ViewFrustum, goal: &CutGoal) -> Vec<u32> {
        let error = |l: u32| {
            let (leaf, q) = (&self.surface.leaves[l as usize], self.leaf[l as usize]);
            if goal.leaf[l as usize] < q {
                -1.0
            } else {
                frustum.error_px(&leaf.sphere, error_mm(leaf, q))
            }
        };
        let moved = (0..self.leaf.len() as u32)
            .filter(|l| goal.leaf[*l as usize] != self.leaf[*l as usize]);
        let mut order: Vec<(f64, u32)> = moved.map(|l| (error(l), l)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.into_iter().map(|(_, l)| l).collect()
    }

    /// The next cut on the way to `end`, and whether it is `end`.
    fn next(
        &self,
        frustum: &ViewFrustum,
        end: CutGoal,
        room: usize,
        cache: &PageCache,
    ) -> (CutGoal, bool) {
        let fits =
            |g: &CutGoal| g.pages <= room && missing(g, cache) <= cache.uploads_left() as usize;
        let order = self.order(frustum, &end);
        if order.len() < 2 || self.direct || fits(&end) {
            return (end, true);
        }
        let first = |n: usize| {
            let mut leaf = self.leaf.clone();
            order[..n].iter().for_each(|l| leaf[*l as usize] = end.leaf[*l as usize]);
            self.cut_for(leaf)
        };
        // Pages grow with the number of leaves, nearly: bisection.
        let (mut good, mut bad) = (0, order.len());
        let mut best = None;
        while bad - good > 1 {
            let n = usize::midpoint(good, bad);
            let goal = first(n);
            if fits(&goal) {
                (good, best) = (n, Some(goal));
            } else {
                bad = n;
            }
        }
        if let Some(best) = best {
            return (best, false);
        }
        let one = first(1);
        if one.pages <= room { (one, false) } else { (end, true) }
    }

    /// Uploads the missing pages of a cut, and makes it the current one if all are resident.
    pub(super) fn commit(
        &mut self,
        goal: CutGoal,
        cache: &mut PageCache,
        uploads: &mut Vec<Upload>,
    ) -> bool {
        let s = self.surface.clone();
        let keys = || goal.changed.iter().flat_map(|(_, pages)| pages);
        keys().for_each(|p| {
            cache.touch(p.key);
        });
        let mut places = Vec::new();
        for p in keys() {
            let place = match cache.touch(p.key) {
                Some(page) => Ok((page, false)),
                None => cache.allocate(p.key).map(|page| (page, true)),
            };
            let Ok(place) = place else { break };
            places.push(place);
        }
        let complete = places.len() == keys().count();
        let all: Vec<(&Page, (u32, bool))> = keys().zip(places).collect();
        let write = |&(p, (page, fresh)): &(&Page, (u32, bool))| {
            let c = (complete || fresh).then(|| p.content(&s))?;
            let drawn =
                VisiblePatch { page, triangles: p.triangles, sphere: c.sphere, cone: c.cone };
            let upload = Upload { page, vertices: c.vertices, triangles: c.triangles };
            Some((drawn, fresh.then_some(upload)))
        };
        let mut drawn = Vec::new();
        for (d, upload) in all.par_iter().map(write).collect::<Vec<_>>().into_iter().flatten() {
            drawn.push(d);
            uploads.extend(upload);
        }
        if complete {
            let mut drawn = drawn.into_iter();
            for (l, own) in goal.changed {
                self.drawn[l as usize] = drawn.by_ref().take(own.len()).collect();
                self.now[l as usize] = own;
            }
            (self.leaf, self.face, self.pages) = (goal.leaf, goal.face, goal.pages);
        }
        complete
    }

    /// Touches the current cut; false if a page of it is gone, as with another cache.
    fn touch_drawn(&self, cache: &mut PageCache) -> bool {
        let stays = |(p, d): (&Page, &VisiblePatch)| cache.touch(p.key) == Some(d.page);
        self.started
            && self
                .now
                .iter()
                .flatten()
                .zip(self.drawn.iter().flatten())
                .map(stays)
                .fold(true, |a, b| a & b)
    }

    /// Restarts from the base mesh; true once all of it is resident.
    fn restart(&mut self, cache: &mut PageCache, uploads: &mut Vec<Upload>) -> bool {
        self.leaf.fill(0);
        self.face.fill(0);
        let changed =
            self.base_pages.iter().cloned().enumerate().map(|(l, p)| (l as u32, p)).collect();
        let goal = CutGoal {
            leaf: self.leaf.clone(),
            face: self.face.clone(),
            changed,
            pages: self.base_page_count,
        };
        self.started = self.commit(goal, cache, uploads);
        self.started
    }
}

/// Number of pages of a cut that are not resident.
fn missing(goal: &CutGoal, cache: &PageCache) -> usize {
    goal.changed.iter().flat_map(|(_, p)| p).filter(|p| !cache.contains(p.key)).count()
}

impl LodHierarchy for Vds {
    fn step(&mut self, camera: &Camera, tolerance: &Tolerance, cache: &mut PageCache) -> LodStep {
        let mut step = LodStep::default();
        if self.base_page_count > cache.pages() as usize {
            // Not even the base fits: draws nothing rather than a part.
            return LodStep { settled: true, degraded: true, ..step };
        }
        if !self.touch_drawn(cache) && !self.restart(cache, &mut step.uploads) {
            return step;
        }
        self.base_pages.iter().flatten().for_each(|p| {
            cache.touch(p.key);
        });
        let frustum = ViewFrustum::new(camera);
        let room = self.room(cache);
        let (end, coarser) = self.wanted(&frustum, tolerance, room);
        if end.leaf == self.leaf {
            (step.settled, step.degraded) = (true, coarser);
        } else {
            let before = self.leaf.clone();
            let (goal, last) = self.next(&frustum, end, room, cache);
            let enough = missing(&goal, cache) <= cache.uploads_left() as usize;
            let there = self.commit(goal, cache, &mut step.uploads);
            self.direct = !there && (enough || self.direct);
            step.settled = there && last;
            step.degraded = step.settled && coarser;
            step.leaves_changed =
                before.iter().zip(&self.leaf).filter(|(a, b)| a != b).count() as u32;
        }
        step.drawn = self.drawn.iter().flatten().copied().collect();
        step
    }

    fn state_hash(&self) -> u64 {
        self.face.iter().fold(u64::from(self.started), |h, q| mix(h, u64::from(*q)))
    }

    fn finest_faces(&self) -> u64 {
        self.surface.base_faces() << (2 * self.surface.depth())
    }
}

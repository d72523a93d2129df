//! From cut to cut, within what the pages allow.
//!
//! A cut is told by one fineness a leaf; whatever these are, the surface has no crack. A step goes
//! from the cut that is drawn to one where some leaves have what the camera wants and the others
//! what they had: the largest number, in order of their error on screen, whose pages can be
//! written now. If not even one leaf can be changed at once, its pages are written ahead, step by
//! step, and drawn when all of them are there.
//!
//! Pages of the base are always resident. A cut may use half of all pages, so that a cut and the
//! next one fit side by side and no order of cameras leads into a dead end; the other half holds
//! what was left behind. A cut that needs more is coarsened as a whole.

use std::sync::Arc;

use rayon::prelude::*;

use super::levels::{Fineness, spread};
use super::pages::{Page, mix, pages};
use super::select::{error_mm, select};
use super::surface::Surface;
use crate::lod::{Camera, Drawn, Eye, Pool, Refine, Step, Tolerance, Upload};

/// Steps of the tolerance while a cut does not fit, a quarter of an octave each.
const COARSER: f64 = 0.25;

/// The cut of a subdivided surface that is drawn.
pub struct Vds {
    surface: Arc<Surface>,
    /// Pages of every leaf at the base, and what is drawn of them.
    floor: Vec<Vec<Page>>,
    floor_pages: usize,
    /// Fineness of each leaf, and of each base face.
    leaf: Vec<Fineness>,
    pub(super) face: Vec<Fineness>,
    /// Pages of each leaf as it is drawn.
    pub(super) now: Vec<Vec<Page>>,
    pub(super) drawn: Vec<Vec<Drawn>>,
    /// Pages of the cut, and of the base.
    pages: usize,
    /// Whether anything is drawn yet.
    started: bool,
    /// The pool had no page although the step had uploads left: head straight for the end, so that
    /// pages written ahead are not driven out by those of another way there.
    straight: bool,
}

/// A cut that could be drawn next.
pub(super) struct Goal {
    leaf: Vec<Fineness>,
    face: Vec<Fineness>,
    /// Leaves whose pages differ.
    changed: Vec<(u32, Vec<Page>)>,
    /// Pages of the whole cut, and of the base.
    pages: usize,
}

impl Vds {
    /// Begins with nothing drawn.
    pub fn new(surface: Arc<Surface>) -> Self {
        let leaves = surface.leaves.len();
        let face = vec![0; surface.base.faces.len()];
        let at_base = |l: usize| pages(&surface, &face, l as u32);
        let floor: Vec<Vec<Page>> = (0..leaves).into_par_iter().map(at_base).collect();
        let floor_pages = floor.iter().map(Vec::len).sum();
        Self {
            now: floor.clone(),
            floor,
            floor_pages,
            pages: floor_pages,
            leaf: vec![0; leaves],
            face,
            drawn: vec![Vec::new(); leaves],
            started: false,
            straight: false,
            surface,
        }
    }

    /// Pages without which nothing can be drawn at all: those of the base mesh.
    pub fn least_pages(&self) -> u32 {
        self.floor_pages as u32
    }

    /// The surface.
    pub fn surface(&self) -> &Arc<Surface> {
        &self.surface
    }

    /// Fineness of each base face, in eighths of a level.
    pub fn fineness(&self) -> &[u8] {
        &self.face
    }

    /// Pages that a cut may use.
    fn room(&self, pool: &Pool) -> usize {
        (pool.pages() as usize / 2).max(self.floor_pages)
    }

    /// Pages of a leaf that are not those of the base.
    fn beyond_floor(&self, leaf: u32, own: &[Page]) -> usize {
        let floor = &self.floor[leaf as usize];
        let same = own.len() == floor.len() && own.iter().zip(floor).all(|(a, b)| a.key == b.key);
        if same { 0 } else { own.len() }
    }

    /// The cut in which the leaves are as fine as given.
    pub(super) fn goal(&self, leaf: Vec<Fineness>) -> Goal {
        let s = &*self.surface;
        let mut face = self.face.clone();
        let moved = (0..leaf.len()).filter(|l| leaf[*l] != self.leaf[*l]);
        let seeds = moved.flat_map(|l| s.leaves[l].faces.iter().copied());
        let of = |f: u32| leaf[s.leaf_of[f as usize] as usize];
        let near = spread(&s.base, &of, seeds, s.depth(), &mut face);
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
        let finer = |l: u32, own: &[Page]| self.beyond_floor(l, own);
        let pages = changed.iter().fold(self.pages, |sum, (l, own)| {
            sum + finer(*l, own) - finer(*l, &self.now[*l as usize])
        });
        Goal { leaf, face, changed, pages }
    }

    /// The cut that the camera wants, coarser where it does not fit, and whether it had to be.
    fn wanted(&self, eye: &Eye, tolerance: &Tolerance, room: usize) -> (Goal, bool) {
        let finest = 8 * self.surface.depth() as i32;
        let mut rung = 0;
        loop {
            let pixels = f64::from(tolerance.pixels) * (COARSER * f64::from(rung)).exp2();
            let mut leaf = select(&self.surface, eye, pixels);
            // Where the camera touches the wall no tolerance is large enough.
            let most = (finest - rung).max(0) as Fineness;
            let most = if self.surface.options.morph { most } else { most / 8 * 8 };
            leaf.iter_mut().for_each(|q| *q = (*q).min(most));
            let goal = self.goal(leaf);
            if goal.pages <= room || most == 0 {
                return (goal, rung > 0);
            }
            rung += 1;
        }
    }

    /// Puts the leaves that are to change in order: finer ones first, by the error that is seen.
    fn order(&self, eye: &Eye, goal: &Goal) -> Vec<u32> {
        let error = |l: u32| {
            let (leaf, q) = (&self.surface.leaves[l as usize], self.leaf[l as usize]);
            if goal.leaf[l as usize] < q {
                -1.0
            } else {
                eye.error_px(&leaf.sphere, error_mm(leaf, q))
            }
        };
        let moved = (0..self.leaf.len() as u32)
            .filter(|l| goal.leaf[*l as usize] != self.leaf[*l as usize]);
        let mut order: Vec<(f64, u32)> = moved.map(|l| (error(l), l)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        order.into_iter().map(|(_, l)| l).collect()
    }

    /// The next cut on the way to `end`, and whether it is `end`.
    fn next(&self, eye: &Eye, end: Goal, room: usize, pool: &Pool) -> (Goal, bool) {
        let fits = |g: &Goal| g.pages <= room && missing(g, pool) <= pool.left() as usize;
        let order = self.order(eye, &end);
        if order.len() < 2 || self.straight || fits(&end) {
            return (end, true);
        }
        let first = |n: usize| {
            let mut leaf = self.leaf.clone();
            order[..n].iter().for_each(|l| leaf[*l as usize] = end.leaf[*l as usize]);
            self.goal(leaf)
        };
        // More leaves need more pages, near enough: halve.
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

    /// Has the pages of `goal` written, and draws it if all are there.
    pub(super) fn draw(&mut self, goal: Goal, pool: &mut Pool, uploads: &mut Vec<Upload>) -> bool {
        let s = self.surface.clone();
        let keys = || goal.changed.iter().flat_map(|(_, pages)| pages);
        keys().for_each(|p| {
            pool.keep(p.key);
        });
        let mut places = Vec::new();
        for p in keys() {
            let place = match pool.keep(p.key) {
                Some(page) => Ok((page, false)),
                None => pool.claim(p.key).map(|page| (page, true)),
            };
            let Ok(place) = place else { break };
            places.push(place);
        }
        let complete = places.len() == keys().count();
        let all: Vec<(&Page, (u32, bool))> = keys().zip(places).collect();
        let write = |&(p, (page, fresh)): &(&Page, (u32, bool))| {
            let c = (complete || fresh).then(|| p.content(&s))?;
            let drawn = Drawn { page, triangles: p.triangles, sphere: c.sphere, cone: c.cone };
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

    /// Keeps what is drawn; false if something of it is gone, as when the pool is another one.
    fn keep(&self, pool: &mut Pool) -> bool {
        let stays = |(p, d): (&Page, &Drawn)| pool.keep(p.key) == Some(d.page);
        self.started
            && self
                .now
                .iter()
                .flatten()
                .zip(self.drawn.iter().flatten())
                .map(stays)
                .fold(true, |a, b| a & b)
    }

    /// Begins anew with the base mesh; true once all of it is there.
    fn start(&mut self, pool: &mut Pool, uploads: &mut Vec<Upload>) -> bool {
        self.leaf.fill(0);
        self.face.fill(0);
        let changed = self.floor.iter().cloned().enumerate().map(|(l, p)| (l as u32, p)).collect();
        let goal = Goal {
            leaf: self.leaf.clone(),
            face: self.face.clone(),
            changed,
            pages: self.floor_pages,
        };
        self.started = self.draw(goal, pool, uploads);
        self.started
    }
}

/// Pages of a cut that would have to be written.
fn missing(goal: &Goal, pool: &Pool) -> usize {
    goal.changed.iter().flat_map(|(_, p)| p).filter(|p| !pool.holds(p.key)).count()
}

impl Refine for Vds {
    fn step(&mut self, camera: &Camera, tolerance: &Tolerance, pool: &mut Pool) -> Step {
        let mut step = Step::default();
        if self.floor_pages > pool.pages() as usize {
            // Not even the base fits: rather nothing than a part.
            return Step { settled: true, degraded: true, ..step };
        }
        if !self.keep(pool) && !self.start(pool, &mut step.uploads) {
            return step;
        }
        self.floor.iter().flatten().for_each(|p| {
            pool.keep(p.key);
        });
        let eye = Eye::new(camera);
        let room = self.room(pool);
        let (end, coarser) = self.wanted(&eye, tolerance, room);
        if end.leaf == self.leaf {
            (step.settled, step.degraded) = (true, coarser);
        } else {
            let before = self.leaf.clone();
            let (goal, last) = self.next(&eye, end, room, pool);
            let enough = missing(&goal, pool) <= pool.left() as usize;
            let there = self.draw(goal, pool, &mut step.uploads);
            self.straight = !there && (enough || self.straight);
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

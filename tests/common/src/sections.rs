//! Walls in pages for tests: a mesh cut as it stands, and a tube of sections with two levels.

use std::collections::HashMap;

use glam::Vec3;
use intima::geometry::{Camera, Cone, Mesh, Sphere, Vertex};
use intima::lod::{
    LodHierarchy, LodStep, NoPage, PAGE_TRIANGLES, PAGE_VERTICES, PageCache, Tolerance, Upload,
    VisiblePatch,
};
use intima::surface::shading;

use crate::tube;

/// A patch: what goes into its page and what the renderer needs to know of it.
#[derive(Clone)]
pub struct Patch {
    pub upload: Upload,
    pub drawn: VisiblePatch,
}

impl Patch {
    /// In another page.
    pub fn at(&self, page: u32) -> (Upload, VisiblePatch) {
        (Upload { page, ..self.upload.clone() }, VisiblePatch { page, ..self.drawn })
    }
}

/// Faces in their order, `most` to a patch or as many as fit.
pub fn cut(vertices: &[Vertex], faces: &[[u32; 3]], most: usize) -> Vec<Patch> {
    let mut patches = Vec::new();
    let mut from = 0;
    while from < faces.len() {
        let mut local: HashMap<u32, u8> = HashMap::new();
        let mut own: Vec<Vertex> = Vec::new();
        let mut triangles = Vec::new();
        for f in &faces[from..] {
            let fresh = f.iter().filter(|v| !local.contains_key(v)).count();
            if triangles.len() == most.min(PAGE_TRIANGLES) || own.len() + fresh > PAGE_VERTICES {
                break;
            }
            triangles.push(f.map(|v| {
                *local.entry(v).or_insert_with(|| {
                    own.push(vertices[v as usize]);
                    own.len() as u8 - 1
                })
            }));
        }
        from += triangles.len();
        let sphere = sphere(&own);
        let drawn = VisiblePatch {
            page: 0,
            resident: None,
            triangles: triangles.len() as u32,
            sphere,
            half: Vec3::splat(sphere.radius),
            cone: cone(&own, &triangles),
        };
        patches.push(Patch { upload: Upload { page: 0, vertices: own, triangles }, drawn });
    }
    patches
}

fn sphere(vertices: &[Vertex]) -> Sphere {
    let points = vertices.iter().map(Vertex::position);
    let low = points.clone().fold(Vec3::INFINITY, Vec3::min);
    let high = points.clone().fold(Vec3::NEG_INFINITY, Vec3::max);
    let centre = 0.5 * (low + high);
    Sphere { centre, radius: points.map(|p| p.distance(centre)).fold(0.0, f32::max) }
}

fn cone(vertices: &[Vertex], triangles: &[[u8; 3]]) -> Cone {
    let normals: Vec<Vec3> = triangles
        .iter()
        .filter_map(|t| {
            let [a, b, c] = t.map(|v| vertices[usize::from(v)].position());
            (b - a).cross(c - a).try_normalize()
        })
        .collect();
    let Some(axis) = normals.iter().sum::<Vec3>().try_normalize() else { return Cone::default() };
    let least = normals.iter().map(|n| n.dot(axis)).fold(1.0, f32::min);
    // A little wider than it is, for rounding.
    let sine = if least <= 0.0 { 1.0 } else { (1.0 - least * least).sqrt() + 1e-4 };
    Cone { axis, sine }
}

/// All of a mesh, patch `i` in page `i`.
pub fn whole(mesh: &Mesh, most: usize) -> LodStep {
    let patches = cut(&shading(mesh).vertices, &mesh.faces, most);
    let (uploads, drawn) = patches.iter().enumerate().map(|(i, p)| p.at(i as u32)).unzip();
    LodStep { uploads, drawn, settled: true, ..LodStep::default() }
}

const SIDES: u32 = PAGE_TRIANGLES as u32 / 2;
/// Rings of a section; a band between two rings fills a page.
const RINGS: u32 = 8;
const SECTIONS: u32 = 30;
/// Sections whose middle is nearer than this are fine, mm.
const REACH_MM: f32 = 50.0;

/// The closed tube in sections, each coarse (one band) or fine (eight). The rings between sections
/// are the same in both, so no mixture has a crack.
pub struct Sections {
    /// By section: the coarse patch, then the fine ones.
    patches: Vec<Vec<Patch>>,
    middles: Vec<Vec3>,
    /// Patches of both ends, always drawn.
    ends: Vec<Patch>,
    fine: Vec<bool>,
    started: bool,
}

/// Pages that the coarse tube fills.
pub const BASE_PAGES: u32 = SECTIONS + 2;
/// Pages of a fine section.
pub const FINE_PAGES: u32 = RINGS;

impl Sections {
    /// All of them coarse.
    pub fn of_tube() -> Self {
        let mesh = tube::tube(SECTIONS * RINGS + 1, SIDES);
        let vertices = shading(&mesh).vertices;
        let band = |a: u32, b: u32| -> Vec<[u32; 3]> {
            let side = |k: u32| {
                let l = (k + 1) % SIDES;
                let (a, b) = (a * SIDES, b * SIDES);
                [[a + k, b + k, a + l], [a + l, b + k, b + l]]
            };
            (0..SIDES).flat_map(side).collect()
        };
        // Turned as the tube's own faces are.
        let turned = mesh.faces.contains(&[0, 1, SIDES]);
        let turn = |mut faces: Vec<[u32; 3]>| {
            faces.iter_mut().filter(|_| turned).for_each(|f| f.swap(1, 2));
            let mut patch = cut(&vertices, &faces, PAGE_TRIANGLES);
            assert_eq!(patch.len(), 1);
            patch.remove(0)
        };
        let section = |s: u32| {
            let (from, to) = (s * RINGS, (s + 1) * RINGS);
            let fine = (from..to).map(|i| turn(band(i, i + 1)));
            std::iter::once(turn(band(from, to))).chain(fine).collect()
        };
        let last = SIDES * (SECTIONS * RINGS + 1);
        let end = |pole: u32| {
            let fan = mesh.faces.iter().filter(|f| f.contains(&pole));
            let mut patch = cut(&vertices, &fan.copied().collect::<Vec<_>>(), PAGE_TRIANGLES);
            assert_eq!(patch.len(), 1);
            patch.remove(0)
        };
        let middle = |s: u32| tube::axis(tube::length() * (s as f32 + 0.5) / SECTIONS as f32).0;
        Self {
            patches: (0..SECTIONS).map(section).collect(),
            middles: (0..SECTIONS).map(middle).collect(),
            ends: vec![end(last), end(last + 1)],
            fine: vec![false; SECTIONS as usize],
            started: false,
        }
    }

    fn patch(&self, key: u64) -> &Patch {
        let (section, part) = ((key / 100) as usize, (key % 100) as usize);
        self.patches.get(section).map_or_else(|| &self.ends[part], |s| &s[part])
    }

    /// Keys of what is drawn for a section.
    fn keys(section: usize, fine: bool) -> Vec<u64> {
        let of = |part: u64| 100 * section as u64 + part;
        if fine { (1..=u64::from(RINGS)).map(of).collect() } else { vec![of(0)] }
    }

    fn end_keys() -> [u64; 2] {
        [0, 1].map(|part| 100 * u64::from(SECTIONS) + part)
    }

    /// Makes all of `keys` resident, or as many as there is room for.
    fn bring(&self, keys: &[u64], cache: &mut PageCache, step: &mut LodStep) -> Result<(), NoPage> {
        for &key in keys {
            if cache.touch(key).is_none() {
                let page = cache.allocate(key)?;
                step.uploads.push(self.patch(key).at(page).0);
            }
        }
        Ok(())
    }
}

impl LodHierarchy for Sections {
    fn step(&mut self, camera: &Camera, _: &Tolerance, cache: &mut PageCache) -> LodStep {
        let mut step = LodStep { settled: true, ..LodStep::default() };
        let eye = camera.pose.position_mm;
        let mut near: Vec<usize> = (0..self.middles.len()).collect();
        near.sort_by(|a, b| {
            self.middles[*a].distance(eye).total_cmp(&self.middles[*b].distance(eye))
        });
        near.retain(|s| self.middles[*s].distance(eye) < REACH_MM);
        let room = cache.pages().saturating_sub(BASE_PAGES) / FINE_PAGES;
        step.degraded = near.len() > room as usize;
        near.truncate(room as usize);

        let drawn_keys = |fine: &[bool]| -> Vec<u64> {
            let sections = fine.iter().enumerate().flat_map(|(s, f)| Self::keys(s, *f));
            Self::end_keys().into_iter().chain(sections).collect()
        };
        if self.started {
            // What is drawn stays, whatever else finds no room.
            for key in drawn_keys(&self.fine) {
                assert!(cache.touch(key).is_some(), "a drawn page was taken away");
            }
        } else {
            let all = drawn_keys(&self.fine);
            self.started = self.bring(&all, cache, &mut step).is_ok();
            step.settled = self.started;
        }
        for wanted in [false, true] {
            let change: Vec<usize> = match wanted {
                false => {
                    (0..self.fine.len()).filter(|s| self.fine[*s] && !near.contains(s)).collect()
                }
                true => near.iter().copied().filter(|s| !self.fine[*s]).collect(),
            };
            for s in change.into_iter().filter(|_| self.started) {
                if self.bring(&Self::keys(s, wanted), cache, &mut step).is_err() {
                    step.settled = false;
                    break;
                }
                self.fine[s] = wanted;
                step.leaves_changed += 1;
            }
        }
        if self.started {
            for key in drawn_keys(&self.fine) {
                let page = cache.touch(key).expect("brought before");
                step.drawn.push(self.patch(key).at(page).1);
            }
        }
        step
    }

    fn state_hash(&self) -> u64 {
        self.fine.iter().fold(1, |h, f| h << 1 | u64::from(*f))
    }

    fn finest_faces(&self) -> u64 {
        u64::from(SECTIONS * RINGS * SIDES * 2 + 2 * SIDES)
    }
}

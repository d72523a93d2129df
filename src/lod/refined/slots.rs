//! Which refined faces have their vertices on the device, and where.

use std::collections::HashMap;
use std::hash::BuildHasherDefault;

use super::grid::{FaceGrid, MAX_LEVEL};
use super::wall::{RefinedFace, RefinedWall};
use crate::lod::morph::{MORPH_STEPS, PatchVertex};
use crate::lod::slot_cache::KeyHasher;
use crate::lod::{SlotCache, VisibleWall};

/// Slots for faces of each level, from 1: 14 to 22 MB a level.
const SLOTS: [u32; MAX_LEVEL as usize] = [1 << 16, 1 << 15, 1 << 13, 1 << 11];
/// Bytes of a vertex.
const VERTEX: u64 = size_of::<PatchVertex>() as u64;

/// Vertices to be written to the buffer before a frame is drawn.
#[derive(Clone, Debug)]
pub struct SlotWrite {
    /// First byte of the buffer.
    pub offset: u64,
    /// Vertices from there on.
    pub vertices: Vec<PatchVertex>,
}

/// What one camera draws of a refined wall.
#[derive(Clone, Debug, Default)]
pub struct PlacedFaces {
    /// Ranges of the mesh.
    pub flat: VisibleWall,
    /// Indices of the triangles of its refined faces, into the vertices of all slots.
    pub indices: Vec<u32>,
    /// By level: fineness of the faces in its slots, inside and on the three sides a byte each, up to
    /// the last slot that is drawn.
    pub fineness: [Vec<u32>; MAX_LEVEL as usize],
    /// Triangles of both.
    pub triangles: u64,
}

impl PlacedFaces {
    /// Returns the fineness of the slots from some slot on, for each level that is drawn: the first
    /// slot, counted over all levels, and a word a slot.
    pub fn fineness_of_slots(&self) -> impl Iterator<Item = (u32, &[u32])> {
        let by_level = (1..).zip(&self.fineness).filter(|(_, words)| !words.is_empty());
        by_level.map(|(level, words)| (first_slot(level), &words[..]))
    }
}

/// A face that is drawn refined.
#[derive(Clone, Copy, Debug)]
struct WantedFace {
    face: u32,
    /// The finest level that a camera needs.
    level: u32,
    /// Level and slot of its vertices; `None` while the device has no vertices of the face.
    place: Option<SlotPlace>,
}

impl WantedFace {
    /// The finest level that it can be drawn at.
    fn drawn_level(&self) -> u32 {
        self.place.map_or(0, |place| place.level.min(self.level))
    }

    /// Whether it is drawn coarser than a camera needs.
    fn waits(&self) -> bool {
        self.drawn_level() < self.level
    }
}

/// A slot of a level.
#[derive(Clone, Copy, Debug)]
struct SlotPlace {
    level: u32,
    slot: u32,
}

impl SlotPlace {
    /// Number of the slot, counted over all levels.
    fn number(self) -> u32 {
        first_slot(self.level) + self.slot
    }

    /// Its first vertex in the buffer. The vertices of finer levels lie behind.
    fn first_vertex(self) -> u32 {
        let points = |level: u32| FaceGrid::points_at(level) as u32;
        let before: u32 = (1..self.level).map(|l| SLOTS[l as usize - 1] * points(l)).sum();
        before + self.slot * points(self.level)
    }
}

/// Slots of all coarser levels.
fn first_slot(level: u32) -> u32 {
    SLOTS[..level as usize - 1].iter().sum()
}

/// Slots of one buffer on the device that hold the vertices of refined faces. The faces that were not
/// drawn for the longest time give way.
///
/// A frame draws at most as many faces of a level as the level has slots. A face without a slot of its
/// level, or that waits for its vertices, is as fine as its vertices of a coarser level allow, or flat.
/// Its neighbours are no finer along the common edge, so that no crack opens.
#[derive(Debug)]
pub struct RefinedSlots {
    /// By level, from 1.
    caches: [SlotCache; MAX_LEVEL as usize],
}

impl Default for RefinedSlots {
    fn default() -> Self {
        Self::new()
    }
}

impl RefinedSlots {
    /// Creates slots without content.
    pub fn new() -> Self {
        Self { caches: SLOTS.map(SlotCache::new) }
    }

    /// Returns the bytes of the buffer.
    pub fn buffer_bytes() -> u64 {
        VERTEX * u64::from(SlotPlace { level: MAX_LEVEL + 1, slot: 0 }.first_vertex())
    }

    /// Returns the number of slots of all levels.
    pub fn count() -> u32 {
        SLOTS.iter().sum()
    }

    /// Finds slots for the faces that a frame refines, and makes the vertices of those that have
    /// none.
    ///
    /// * `seen`: what each camera of the frame sees.
    /// * `made`: largest number of faces of each level that are made.
    ///
    /// Returns what each camera draws, the vertices to write, and the number of faces that wait for
    /// a later frame.
    pub fn place(
        &mut self,
        wall: &RefinedWall,
        seen: &[&VisibleWall],
        made: u32,
    ) -> (Vec<PlacedFaces>, Vec<SlotWrite>, usize) {
        // 1. The finest level that each face needs, in the order in which they are seen.
        let mut wanted: Vec<WantedFace> = Vec::new();
        let mut numbers: HashMap<u32, u32, BuildHasherDefault<KeyHasher>> = HashMap::default();
        let mut want = |refined: &RefinedFace| {
            let number = *numbers.entry(refined.face).or_insert(wanted.len() as u32);
            if number as usize == wanted.len() {
                wanted.push(WantedFace { face: refined.face, level: 0, place: None });
            }
            let wanted = &mut wanted[number as usize];
            wanted.level = wanted.level.max(refined.level());
            number
        };
        let by_camera: Vec<Vec<u32>> =
            seen.iter().map(|s| s.refined.iter().map(&mut want).collect()).collect();

        // 2. Slots, for the finest first: a coarser face may stay in the slot of a finer one.
        self.caches.iter_mut().for_each(|cache| cache.begin_step(made));
        let mut new: Vec<WantedFace> = Vec::new();
        let mut allocate = |caches: &mut [SlotCache], wanted: &mut WantedFace, level: u32| {
            let slot = caches[level as usize - 1].allocate(wanted.face)?;
            wanted.place = Some(SlotPlace { level, slot });
            new.push(*wanted);
            Some(())
        };
        for level in (1..=MAX_LEVEL).rev() {
            for w in wanted.iter_mut().filter(|w| w.level == level) {
                w.place = self.touched(w.face, level);
            }
            for w in wanted.iter_mut().filter(|w| w.level == level && w.place.is_none()) {
                allocate(&mut self.caches, w, level);
            }
        }
        // A face without a slot of its level is drawn from a coarser slot that it has. A recorded frame
        // is drawn once: there the face gets a coarser slot that is free.
        for w in wanted.iter_mut().filter(|w| w.place.is_none()) {
            let coarser = (1..w.level).rev();
            let there = coarser.clone().find_map(|level| self.touched_at(w.face, level));
            w.place = there;
            if made == u32::MAX && there.is_none() {
                let _ = coarser.into_iter().find_map(|l| allocate(&mut self.caches, w, l));
            }
        }

        // 3. Vertices.
        let make = |new: &WantedFace| {
            let place = new.place.expect("a slot of its own");
            let vertices = wall.patch(new.face, place.level);
            let vertices = vertices.into_iter().map(|v| v.in_slot(place.number())).collect();
            SlotWrite { offset: VERTEX * u64::from(place.first_vertex()), vertices }
        };
        let writes = new.iter().map(make).collect();

        // 4. Draws.
        let waiting = || wanted.iter().filter(|w| w.waits());
        let mut limits = EdgeLimits::new();
        for w in waiting() {
            for edge in edges(wall, w.face) {
                let limit = limits.entry(edge).or_insert(u32::MAX);
                *limit = (MORPH_STEPS * w.drawn_level()).min(*limit);
            }
        }
        let of_camera = |(seen, numbers): (&&VisibleWall, &Vec<u32>)| {
            let places = numbers.iter().map(|i| wanted[*i as usize].place);
            drawn(wall, seen, places, &limits)
        };
        let drawn = seen.iter().zip(&by_camera).map(of_camera).collect();
        (drawn, writes, waiting().count())
    }

    /// Marks a face as drawn that is there at this level or a finer one; returns its place.
    fn touched(&mut self, face: u32, level: u32) -> Option<SlotPlace> {
        (level..=MAX_LEVEL).find_map(|level| self.touched_at(face, level))
    }

    fn touched_at(&mut self, face: u32, level: u32) -> Option<SlotPlace> {
        let slot = self.caches[level as usize - 1].touch(face)?;
        Some(SlotPlace { level, slot })
    }
}

/// Largest fineness of the edges of faces that wait.
type EdgeLimits = HashMap<[u32; 2], u32>;

/// Edges of a face, each with the lower vertex first.
fn edges(wall: &RefinedWall, face: u32) -> [[u32; 2]; 3] {
    let f = wall.faces()[face as usize];
    [0, 1, 2].map(|e| {
        let (a, b) = (f[e], f[(e + 1) % 3]);
        [a.min(b), a.max(b)]
    })
}

/// What a camera draws.
///
/// * `places`: of each face that it refines, if its vertices are there.
/// * `limits`: of the edges of the faces that wait.
fn drawn(
    wall: &RefinedWall,
    seen: &VisibleWall,
    places: impl Iterator<Item = Option<SlotPlace>>,
    limits: &EdgeLimits,
) -> PlacedFaces {
    let grid = FaceGrid::get();
    let mut all = PlacedFaces {
        flat: VisibleWall { ranges: seen.ranges.clone(), refined: Vec::new() },
        ..PlacedFaces::default()
    };
    for (wanted, place) in seen.refined.iter().zip(places) {
        let refined = if limits.is_empty() {
            Some(*wanted)
        } else {
            let own = edges(wall, wanted.face);
            let mut sides = wanted.sides();
            for (side, edge) in sides.iter_mut().zip(&own) {
                *side = limits.get(edge).map_or(*side, |limit| *limit.min(side));
            }
            RefinedFace::of_sides(wanted.face, sides)
        };
        let (Some(refined), Some(place)) = (refined, place) else {
            all.flat.add_faces(wanted.face..wanted.face + 1);
            continue;
        };
        let corners = grid.indices_of(refined.level(), refined.side_levels());
        let first = place.first_vertex();
        all.indices.extend(corners.iter().map(|i| first + i));
        let fineness = &mut all.fineness[place.level as usize - 1];
        if fineness.len() <= place.slot as usize {
            fineness.resize(place.slot as usize + 1, 0);
        }
        fineness[place.slot as usize] = refined.fineness;
    }
    all.triangles = all.flat.triangles() + all.indices.len() as u64 / 3;
    all
}

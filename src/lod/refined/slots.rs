//! Which refined faces have their vertices on the device, and where.

use std::collections::{HashMap, HashSet};

use super::grid::{FaceGrid, MAX_LEVEL};
use super::wall::{RefinedFace, RefinedWall};
use crate::lod::morph::PatchVertex;
use crate::lod::{DrawnRange, SlotCache, VisibleWall};

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
    /// Ranges of the templates, with vertices in slots.
    pub refined: Vec<DrawnRange>,
    /// Triangles of both.
    pub triangles: u64,
}

/// Slots of one buffer on the device that hold the vertices of refined faces. The faces that were not
/// drawn for the longest time give way.
///
/// A frame draws at most as many faces of a level as the level has slots. All other faces stay flat,
/// also faces that wait for their vertices. A neighbour of a flat face is flat along the common edge,
/// so that no crack opens.
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
        // Copies wait for the frames before: a slot can be written as soon as it is not drawn.
        Self { caches: SLOTS.map(|slots| SlotCache::new(slots, 0)) }
    }

    /// Returns the bytes of the buffer.
    pub fn buffer_bytes() -> u64 {
        VERTEX * u64::from(first_vertex(MAX_LEVEL + 1, 0))
    }

    /// Returns the index templates.
    pub fn indices() -> &'static [u32] {
        &FaceGrid::get().indices
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
        let mut levels: HashMap<u32, u32> = HashMap::new();
        for refined in seen.iter().flat_map(|s| &s.refined) {
            let level = levels.entry(refined.face).or_default();
            *level = refined.level().max(*level);
        }
        let mut order: Vec<(u32, u32)> = Vec::with_capacity(levels.len());
        for refined in seen.iter().flat_map(|s| &s.refined) {
            order.extend(levels.remove_entry(&refined.face));
        }

        // 2. Slots, for the finest first: a coarser face may stay in the slot of a finer one.
        self.caches.iter_mut().for_each(|cache| cache.begin_step(made));
        let mut places: HashMap<u32, u32> = HashMap::with_capacity(order.len());
        let mut new: Vec<(u32, u32, u32)> = Vec::new();
        let mut waiting: HashSet<u32> = HashSet::new();
        for level in (1..=MAX_LEVEL).rev() {
            let wanted: Vec<u32> =
                order.iter().filter(|(_, own)| *own == level).map(|(face, _)| *face).collect();
            let (wanted, beyond) =
                wanted.split_at(wanted.len().min(SLOTS[level as usize - 1] as usize));
            waiting.extend(beyond);
            let mut absent = Vec::new();
            for face in wanted {
                match self.touched(*face, level) {
                    Some(vertex) => {
                        places.insert(*face, vertex);
                    }
                    None => absent.push(*face),
                }
            }
            for face in absent {
                match self.caches[level as usize - 1].allocate(u64::from(face)) {
                    Ok(slot) => {
                        let vertex = first_vertex(level, slot);
                        places.insert(face, vertex);
                        new.push((face, level, vertex));
                    }
                    Err(_) => {
                        waiting.insert(face);
                    }
                }
            }
        }

        // 3. Vertices.
        let make = |(face, level, vertex): &(u32, u32, u32)| SlotWrite {
            offset: VERTEX * u64::from(*vertex),
            vertices: wall.patch(*face, *level),
        };
        let writes = new.iter().map(make).collect();

        // 4. Draws.
        let flat_edges: HashSet<[u32; 2]> =
            waiting.iter().flat_map(|face| edges(wall, *face)).collect();
        let of_camera = |seen: &&VisibleWall| drawn(wall, seen, &places, &flat_edges);
        (seen.iter().map(of_camera).collect(), writes, waiting.len())
    }

    /// Marks a face as drawn that is there at this level or a finer one; returns its first vertex.
    fn touched(&mut self, face: u32, level: u32) -> Option<u32> {
        (level..=MAX_LEVEL).find_map(|level| {
            let slot = self.caches[level as usize - 1].touch(u64::from(face))?;
            Some(first_vertex(level, slot))
        })
    }
}

/// Returns the first vertex of a slot of a level; those of finer levels lie behind.
fn first_vertex(level: u32, slot: u32) -> u32 {
    let points = |level: u32| FaceGrid::points_at(level) as u32;
    let before: u32 = (1..level).map(|l| SLOTS[l as usize - 1] * points(l)).sum();
    before + slot * points(level)
}

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
/// * `places`: first vertex of each face that is there.
/// * `flat_edges`: edges of the faces that are not.
fn drawn(
    wall: &RefinedWall,
    seen: &VisibleWall,
    places: &HashMap<u32, u32>,
    flat_edges: &HashSet<[u32; 2]>,
) -> PlacedFaces {
    let grid = FaceGrid::get();
    let mut all = PlacedFaces {
        flat: VisibleWall { ranges: seen.ranges.clone(), refined: Vec::new() },
        ..PlacedFaces::default()
    };
    for wanted in &seen.refined {
        let refined = if flat_edges.is_empty() {
            Some(*wanted)
        } else {
            let own = edges(wall, wanted.face);
            let mut sides = wanted.sides();
            for (side, edge) in sides.iter_mut().zip(&own) {
                *side = if flat_edges.contains(edge) { 0 } else { *side };
            }
            RefinedFace::of_sides(wanted.face, sides)
        };
        match (refined, places.get(&wanted.face)) {
            (Some(refined), Some(vertex)) => {
                let template = grid.template(refined.level(), refined.side_levels());
                all.triangles += u64::from(template.triangles);
                all.refined.push(DrawnRange {
                    first_index: template.first,
                    indices: 3 * template.triangles,
                    first_vertex: *vertex,
                    morph: refined.fineness,
                });
            }
            _ => all.flat.add_faces(wanted.face..wanted.face + 1),
        }
    }
    all.triangles += all.flat.triangles();
    all
}

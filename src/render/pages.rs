//! A wall in pages: persistent buffers, changes waiting for the next frame, and the part of the cut
//! that a camera can see.
//!
//! A page may be written while frames that drew its old content are still running on the device.
//! This is safe for three reasons:
//! - **Contents**, by order on the queue: copies wait until the vertex work of every earlier
//!   submission is done, and draws of this one wait for the copies (barriers in `vk::frame`). This
//!   holds whatever pages are written, also where several steps are merged into one frame.
//! - **Staged bytes**, by the timeline: the ring hands them out again once their submission is
//!   done.
//! - **No page half new**, by [`PageCache`](crate::lod::PageCache): what a step writes was not drawn in the
//!   last `in_flight` steps. On one queue the first point alone would do; this one would let the
//!   copies run on a queue of their own.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use super::renderer::Renderer;
use super::scene::PagesHandle;
use super::{FrameStats, RenderError};
use crate::geometry::{Camera, HierarchicalZ, Vertex, ViewFrustum};
use crate::lod::vds::ResidentPatches;
use crate::lod::{LodStep, OcclusionTest, PAGE_TRIANGLES, PAGE_VERTICES, Upload, VisiblePatch};
use crate::vk::{BufferId, Frame, Gpu, ImageId, IndexedRange, Pass, Releaser, Write};

/// Largest number of pages of one wall: 624 MiB on the device, 5 MiB of commands a frame.
pub const MAX_PAGES: u32 = 1 << 18;

/// Most bytes of changes in one submission; the further changes of a frame go in submissions of
/// their own. With the commands of 100,000 pages it is a quarter of the staging ring, so that a
/// frame with three before it in flight does not wait.
const CHUNK_BYTES: u64 = 6 << 20;

const VERTEX_BYTES: u64 = (PAGE_VERTICES * size_of::<Vertex>()) as u64;
const INDICES: u32 = 3 * PAGE_TRIANGLES as u32;
const INDEX_BYTES: u64 = 2 * INDICES as u64;

/// New content of a page.
struct PageWrite {
    vertices: Vec<Vertex>,
    indices: Vec<u16>,
}

impl PageWrite {
    fn bytes(&self) -> u64 {
        (size_of_val(&self.vertices[..]) + size_of_val(&self.indices[..])) as u64
    }
}

pub(super) struct Pages {
    pub vertices: BufferId,
    pub indices: BufferId,
    pub mean_radius_mm: f32,
    /// Number of patches that stay on the device, of vertices of each, and of indices of all
    /// templates.
    pub resident: Option<[u32; 3]>,
    /// Occlusion of the wall by itself: hidden patches are not drawn, unless backs are.
    outside: Option<Arc<OcclusionTest>>,
    /// Number of triangles in each page, once what is pending has been written.
    filled: Vec<u32>,
    /// Pending changes by page, in ascending order so that copies ascend.
    pending: BTreeMap<u32, PageWrite>,
    drawn: Vec<VisiblePatch>,
    /// Depths behind which the wall hides from the camera of the cut, if it is within its tolerance.
    depths: Option<Arc<HierarchicalZ>>,
    leaves_changed: u64,
    degraded: bool,
}

impl Pages {
    fn new(gpu: &mut Gpu, pages: u32, mean_radius_mm: f32) -> Result<Self, RenderError> {
        if pages == 0 || pages > MAX_PAGES {
            return Err(RenderError::BadPages { pages });
        }
        let n = u64::from(pages);
        let each = u64::from(INDICES);
        let (vertices, indices) = gpu.all_or_none(|gpu| {
            let vertices = gpu.empty_vertices("page vertices", n * VERTEX_BYTES)?;
            Ok::<_, RenderError>((vertices, gpu.empty_indices("page indices", n * each, each)?))
        })?;
        let filled = vec![0; pages as usize];
        Ok(Self { filled, ..Self::of_buffers(vertices, indices, mean_radius_mm) })
    }

    /// A wall of patches that all stay on the device.
    fn resident(
        gpu: &mut Gpu,
        patches: &ResidentPatches,
        mean_radius_mm: f32,
    ) -> Result<Self, RenderError> {
        let (vertices, indices) = gpu.all_or_none(|gpu| {
            let vertices = gpu.vertex_buffer("patch vertices", patches.vertex_bytes())?;
            Ok::<_, RenderError>((vertices, gpu.index_buffer("templates", patches.indices())?))
        })?;
        let count = patches.patches() as u32;
        let resident = Some([count, patches.patch_vertices(), patches.indices().len() as u32]);
        Ok(Self { resident, ..Self::of_buffers(vertices, indices, mean_radius_mm) })
    }

    fn of_buffers(vertices: BufferId, indices: BufferId, mean_radius_mm: f32) -> Self {
        Self {
            vertices,
            indices,
            mean_radius_mm,
            resident: None,
            outside: None,
            filled: Vec::new(),
            pending: BTreeMap::new(),
            drawn: Vec::new(),
            depths: None,
            leaves_changed: 0,
            degraded: false,
        }
    }

    /// Applies a step, or nothing of it.
    fn apply(&mut self, step: LodStep) -> Result<(), RenderError> {
        for u in &step.uploads {
            check(u, self.filled.len())?;
        }
        let mut filled = BTreeMap::new();
        for u in &step.uploads {
            filled.insert(u.page, u.triangles.len() as u32);
        }
        for d in &step.drawn {
            if d.resident.is_some() || self.resident.is_some() {
                self.check_resident(d)?;
                continue;
            }
            let there = filled.get(&d.page).or(self.filled.get(d.page as usize)).copied();
            if there.is_none_or(|n| d.triangles > n) {
                let (page, triangles, there) = (d.page, d.triangles, there.unwrap_or(0));
                return Err(RenderError::EmptyPage { page, triangles, there });
            }
        }
        for u in step.uploads {
            self.filled[u.page as usize] = u.triangles.len() as u32;
            let indices = u.triangles.iter().flatten().map(|i| u16::from(*i)).collect();
            self.pending.insert(u.page, PageWrite { vertices: u.vertices, indices });
        }
        self.drawn = step.drawn;
        self.leaves_changed += u64::from(step.leaves_changed);
        self.degraded = step.degraded;
        self.depths = step.depths;
        Ok(())
    }

    fn check_resident(&self, d: &VisiblePatch) -> Result<(), RenderError> {
        let [patches, _, indices] = self.resident.unwrap_or_default();
        let fits = d.resident.is_some_and(|r| {
            d.page < patches
                && u64::from(r.first_index) + 3 * u64::from(d.triangles) <= u64::from(indices)
        });
        if fits {
            return Ok(());
        }
        Err(RenderError::NoPatch { patch: d.page, patches, triangles: d.triangles })
    }

    /// Takes out the changes of the first pages, at least one and about `most` bytes at most.
    fn first_changes(&mut self, most: u64) -> Vec<(u32, PageWrite)> {
        let mut out = Vec::new();
        let mut bytes = 0;
        while let Some(entry) = self.pending.first_entry() {
            bytes += entry.get().bytes();
            if bytes > most && !out.is_empty() {
                break;
            }
            out.push(entry.remove_entry());
        }
        out
    }

    fn pending_bytes(&self) -> u64 {
        self.pending.values().map(PageWrite::bytes).sum()
    }

    /// Returns the writes of changes: vertices first, then indices, so that each kind is one copy
    /// command.
    fn writes<'a>(&self, changes: &'a [(u32, PageWrite)]) -> Vec<Write<'a>> {
        let write = |to, offset, bytes| Write { to, offset, bytes: Cow::Borrowed(bytes) };
        let vertices = changes.iter().map(|(page, c)| {
            let at = u64::from(*page) * VERTEX_BYTES;
            write(self.vertices, at, bytemuck::cast_slice(&c.vertices))
        });
        let indices = changes.iter().map(|(page, c)| {
            let at = u64::from(*page) * INDEX_BYTES;
            write(self.indices, at, bytemuck::cast_slice(&c.indices))
        });
        vertices.chain(indices).collect()
    }

    /// Returns the index ranges of the patches that `camera` can see, in the cut's order, and their
    /// number of triangles. With `backs`, patches that face away or are hidden are drawn too.
    pub fn visible_ranges(&self, camera: &Camera, backs: bool) -> (Vec<IndexedRange>, u64) {
        let frustum = ViewFrustum::new(camera);
        // Those of the cut, if it is of this camera.
        let known = self.depths.as_ref().filter(|d| *d.frustum() == frustum);
        let of_any = || self.outside.as_ref().map(|o| Arc::new(o.depths(&frustum)));
        let depths = if backs { None } else { known.cloned().or_else(of_any) };
        let mut triangles = 0;
        let seen = |d: &&VisiblePatch| {
            let shown = if backs {
                d.is_inside(&frustum)
            } else {
                d.is_visible(&frustum, depths.as_deref())
            };
            d.triangles > 0 && shown
        };
        let range = |d: &VisiblePatch| {
            triangles += u64::from(d.triangles);
            let indices = 3 * d.triangles;
            match (d.resident, self.resident) {
                (Some(r), Some([_, vertices, _])) => IndexedRange {
                    first_index: r.first_index,
                    indices,
                    first_vertex: d.page * vertices,
                    instance: r.morph,
                },
                _ => IndexedRange {
                    first_index: d.page * INDICES,
                    indices,
                    first_vertex: d.page * PAGE_VERTICES as u32,
                    instance: 0,
                },
            }
        };
        (self.drawn.iter().filter(seen).map(range).collect(), triangles)
    }

    /// Submits about `most` bytes of changes, then passes; returns how many bytes changed. After
    /// an error they are still pending.
    fn send(
        &mut self,
        gpu: &mut Gpu,
        most: u64,
        passes: Vec<Pass>,
        picture: Option<(ImageId, BufferId)>,
    ) -> Result<u64, RenderError> {
        let changes = self.first_changes(most);
        let frame = Frame { writes: self.writes(&changes), passes, picture, ..Frame::default() };
        let sent = gpu.make_room(frame.staged_bytes()).and_then(|()| gpu.submit_draws(&frame));
        drop(frame);
        let bytes = changes.iter().map(|c| c.1.bytes()).sum();
        match sent {
            Ok(()) => Ok(bytes),
            Err(e) => {
                self.pending.extend(changes);
                Err(e.into())
            }
        }
    }

    pub fn release(&self, releaser: &Releaser) {
        releaser.buffer(self.vertices);
        releaser.buffer(self.indices);
    }
}

fn check(u: &Upload, pages: usize) -> Result<(), RenderError> {
    let (vertices, triangles) = (u.vertices.len(), u.triangles.len());
    let fits = vertices <= PAGE_VERTICES && triangles <= PAGE_TRIANGLES;
    let within = u.triangles.iter().flatten().all(|i| usize::from(*i) < vertices);
    if (u.page as usize) < pages && fits && within {
        return Ok(());
    }
    Err(RenderError::BadUpload { page: u.page, pages, vertices, triangles })
}

impl Renderer {
    /// Makes room for a wall of `pages` pages, empty until steps are applied to it.
    ///
    /// * `mean_radius_mm`: mean radius of the organ, for the light (see
    ///   [`crate::surface::shading`]).
    ///
    /// # Errors
    /// [`RenderError::BadPages`]; [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn open_pages(
        &mut self,
        gpu: &mut Gpu,
        pages: u32,
        mean_radius_mm: f32,
    ) -> Result<PagesHandle, RenderError> {
        self.check_device(gpu);
        self.pages.push(Some(Pages::new(gpu, pages, mean_radius_mm)?));
        Ok(PagesHandle(self.pages.len() - 1))
    }

    /// Puts the patches of a wall on the device, where they stay; nothing is drawn until a step is
    /// applied.
    ///
    /// * `mean_radius_mm`: as for [`Renderer::open_pages`].
    ///
    /// # Errors
    /// [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn open_patches(
        &mut self,
        gpu: &mut Gpu,
        patches: &ResidentPatches,
        mean_radius_mm: f32,
    ) -> Result<PagesHandle, RenderError> {
        self.check_device(gpu);
        self.pages.push(Some(Pages::resident(gpu, patches, mean_radius_mm)?));
        Ok(PagesHandle(self.pages.len() - 1))
    }

    /// Leaves patches that the wall itself hides out of later frames. Cameras are within the wall.
    ///
    /// # Panics
    /// If the wall was closed.
    pub fn hide(&mut self, pages: PagesHandle, outside: Arc<OcclusionTest>) {
        self.pages[pages.0].as_mut().expect("a wall that was not closed").outside = Some(outside);
    }

    /// Frees a wall once no frame in flight uses it.
    pub fn close_pages(&mut self, pages: PagesHandle) {
        if let Some(p) = self.pages[pages.0].take() {
            p.release(&self.releaser);
        }
    }

    /// Applies a step: its uploads are written by the next frame that shows this wall, before it
    /// draws, and that frame draws its list of patches. Several steps before one frame are as one
    /// step: each page is written once, with its latest content. Draws nothing and does not wait.
    ///
    /// # Errors
    /// [`RenderError::BadUpload`], [`RenderError::EmptyPage`]; then nothing of the step was taken.
    ///
    /// # Panics
    /// If the wall was closed.
    pub fn apply(&mut self, pages: PagesHandle, step: LodStep) -> Result<(), RenderError> {
        self.pages[pages.0].as_mut().expect("a wall that was not closed").apply(step)
    }

    pub(super) fn wall_pages(&self, pages: PagesHandle) -> &Pages {
        self.pages[pages.0].as_ref().expect("a wall that was not closed")
    }

    /// Submits passes together with the pending changes of a wall. Changes too large for one
    /// submission go before them, in submissions of their own that draw nothing.
    pub(super) fn submit_with_changes(
        &mut self,
        gpu: &mut Gpu,
        pages: Option<PagesHandle>,
        passes: Vec<Pass>,
        picture: Option<(ImageId, BufferId)>,
        stats: &mut FrameStats,
    ) -> Result<(), RenderError> {
        let Some(handle) = pages else {
            return Ok(gpu.submit_draws(&Frame { passes, picture, ..Frame::default() })?);
        };
        let own = self.pages[handle.0].as_mut().expect("a wall that was not closed");
        let mut left = own.pending_bytes();
        stats.uploaded_bytes = left;
        stats.leaves_changed = std::mem::take(&mut own.leaves_changed);
        stats.degraded = own.degraded;
        while left > CHUNK_BYTES {
            left -= own.send(gpu, CHUNK_BYTES, Vec::new(), None)?;
        }
        own.send(gpu, u64::MAX, passes, picture).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Cone, Lens, Pose, Sphere};
    use glam::Vec3;

    #[test]
    fn a_page_that_would_read_past_its_vertices_is_refused() {
        let upload = |page, vertices, triangles| Upload {
            page,
            vertices: vec![Vertex::default(); vertices],
            triangles,
        };
        let last = PAGE_VERTICES as u8 - 1;
        let full = vec![[0, 1, last]; PAGE_TRIANGLES];
        assert!(check(&upload(3, PAGE_VERTICES, full), 4).is_ok());
        for bad in [
            upload(4, 3, vec![[0, 1, 2]]),
            upload(0, 3, vec![[0, 1, 3]]),
            upload(0, 0, vec![[0, 0, 0]]),
            upload(0, PAGE_VERTICES + 1, vec![[0, 1, 2]]),
            upload(0, 3, vec![[0, 1, 2]; PAGE_TRIANGLES + 1]),
        ] {
            let e = check(&bad, 4).unwrap_err();
            assert!(matches!(e, RenderError::BadUpload { .. }), "{e}");
        }
    }

    #[test]
    fn index_ranges_keep_the_cuts_order_and_leave_out_culled_patches() {
        let pose = Pose::looking(Vec3::ZERO, Vec3::X, Vec3::Z);
        let lens = Lens { fov_y_rad: 1.0, aspect: 1.0, near_mm: 0.1 };
        let camera = Camera { pose, lens, height_px: 100 };
        let drawn = |page, x: f32, axis, triangles| VisiblePatch {
            page,
            resident: None,
            triangles,
            sphere: Sphere { centre: Vec3::new(x, 0.0, 0.0), radius: 0.5 },
            half: Vec3::splat(0.5),
            cone: Cone { axis, sine: 0.1 },
        };
        let (away, facing) = (Vec3::X, Vec3::NEG_X);
        let none = crate::vk::BufferId::default();
        let mut pages = Pages { filled: vec![9; 8], ..Pages::of_buffers(none, none, 1.0) };
        pages.drawn = vec![
            drawn(5, 9.0, facing, 7),
            drawn(1, 5.0, away, 8),
            drawn(2, -5.0, facing, 9),
            drawn(3, 4.0, facing, 0),
            drawn(4, 3.0, facing, 2),
        ];
        let (ranges, triangles) = pages.visible_ranges(&camera, false);
        let range = |page, indices| {
            let (first_index, first_vertex) = (page * INDICES, page * PAGE_VERTICES as u32);
            IndexedRange { first_index, indices, first_vertex, instance: 0 }
        };
        assert_eq!((ranges, triangles), (vec![range(5, 21), range(4, 6)], 9));
        assert_eq!(pages.visible_ranges(&camera, true).1, 17);
    }
}

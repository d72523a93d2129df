//! Meshes and paths on the device: how they get there, change and go.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::RenderError;
use super::lines::Tubes;
use super::mesh::{self, PreparedMesh, WallVertices};
use super::refined_faces::RefinedFaces;
use super::renderer::Renderer;
use super::scene::{MeshHandle, PathHandle};
use crate::geometry::{Mesh, Vertex};
use crate::lod::{CulledWall, DrawnWall};
use crate::surface::Shading;
use crate::vk::{BufferId, Gpu, Releaser};

/// A mesh, or a wall of patches, on the device.
pub(super) struct PlacedMesh {
    pub vertices: BufferId,
    pub indices: BufferId,
    pub count: u32,
    pub bounds: Option<(Vec3, Vec3)>,
    pub mean_radius_mm: f32,
    /// Vertices without their colours, of a mesh that has colours, to be coloured anew.
    pub uncoloured: Option<Arc<Shading>>,
    /// Whether its vertices are those of patches.
    pub is_patches: bool,
    /// Part of it that a camera sees; all of it where `None`.
    pub drawn: Option<Arc<dyn DrawnWall>>,
    /// Faces of it that are refined, of such a wall.
    pub refined: Option<RefinedFaces>,
}

impl PlacedMesh {
    pub fn release(&self, releaser: &Releaser) {
        releaser.buffer(self.vertices);
        releaser.buffer(self.indices);
        if let Some(refined) = &self.refined {
            refined.release(releaser);
        }
    }
}

impl Renderer {
    /// Puts a mesh on the device; faces tagged as caps are left out on request.
    ///
    /// # Errors
    /// [`RenderError::BadFace`]; [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn upload_mesh(
        &mut self,
        gpu: &mut Gpu,
        mesh: &Mesh,
        skip_caps: bool,
    ) -> Result<MeshHandle, RenderError> {
        self.check_device(gpu);
        let prepared = mesh::prepare(mesh, skip_caps)?;
        self.upload_prepared_mesh(gpu, &prepared)
    }

    /// Puts a mesh on the device that was prepared before, on any thread.
    ///
    /// # Errors
    /// As [`Renderer::upload_mesh`].
    pub fn upload_prepared_mesh(
        &mut self,
        gpu: &mut Gpu,
        mesh: &PreparedMesh,
    ) -> Result<MeshHandle, RenderError> {
        self.check_device(gpu);
        let vertices = match &mesh.vertices {
            WallVertices::Mesh(shading) => bytemuck::cast_slice(&shading.vertices),
            WallVertices::Patches(patches) => patches.vertex_bytes(),
        };
        let model = upload(gpu, vertices, &mesh.indices, mesh.bounds, mesh.mean_radius_mm)?;
        let is_patches = matches!(mesh.vertices, WallVertices::Patches(_));
        let refined = mesh.refined.clone();
        let refined = refined.map(|wall| RefinedFaces::new(gpu, wall)).transpose();
        let refined = refined.inspect_err(|_| model.release(&self.releaser))?;
        let drawn = mesh.drawn.clone();
        self.models.push(Some(PlacedMesh { is_patches, drawn, refined, ..model }));
        Ok(MeshHandle(self.models.len() - 1))
    }

    /// Puts a mesh on the device with a colour for each vertex.
    ///
    /// * `colours`: one a vertex, linear, eight bits each; the last is the share of the tissue's
    ///   colour that it replaces.
    ///
    /// # Errors
    /// As [`Renderer::upload_mesh`].
    ///
    /// # Panics
    /// If there are more or fewer colours than vertices.
    pub fn upload_coloured_mesh(
        &mut self,
        gpu: &mut Gpu,
        mesh: &PreparedMesh,
        colours: &[[u8; 4]],
    ) -> Result<MeshHandle, RenderError> {
        self.check_device(gpu);
        let shading = mesh.shading();
        let coloured = coloured(&shading.vertices, colours);
        let model = upload(gpu, &coloured, &mesh.indices, mesh.bounds, shading.mean_radius_mm)?;
        self.models.push(Some(PlacedMesh { uncoloured: Some(Arc::clone(shading)), ..model }));
        Ok(MeshHandle(self.models.len() - 1))
    }

    /// Gives the vertices of a mesh with colours other ones, from the next frame on.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`] when the device runs out of memory; the colours are as before then.
    ///
    /// # Panics
    /// If the mesh was removed or has no colours, or if their number is wrong.
    pub fn recolour(
        &mut self,
        gpu: &mut Gpu,
        mesh: MeshHandle,
        colours: &[[u8; 4]],
    ) -> Result<(), RenderError> {
        self.check_device(gpu);
        let plain = self.model(mesh).uncoloured.as_ref().expect("a mesh with colours");
        let coloured = coloured(&plain.vertices, colours);
        let vertices = gpu.vertex_buffer("vertices", bytemuck::cast_slice(&coloured))?;
        let model = self.models[mesh.0].as_mut().expect("a mesh that was not removed");
        self.releaser.buffer(std::mem::replace(&mut model.vertices, vertices));
        self.glass_of = None;
        Ok(())
    }

    /// Leaves what a camera cannot see of a mesh out of later inside views.
    ///
    /// * `prepared`: the mesh as it was put on the device, with all its faces.
    /// * `wall`: with the octree of these faces.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`] when the device runs out of memory; nothing is left out then.
    ///
    /// # Panics
    /// If the mesh was removed or has another number of faces.
    pub fn cull_mesh(
        &mut self,
        gpu: &mut Gpu,
        mesh: MeshHandle,
        prepared: &PreparedMesh,
        wall: Arc<CulledWall>,
    ) -> Result<(), RenderError> {
        self.check_device(gpu);
        let ordered = mesh::ordered(&wall, prepared.indices.as_chunks().0);
        assert_eq!(ordered.len(), self.model(mesh).count as usize, "the faces of the mesh");
        let indices = gpu.index_buffer("indices", &ordered)?;
        let model = self.models[mesh.0].as_mut().expect("a mesh that was not removed");
        self.releaser.buffer(std::mem::replace(&mut model.indices, indices));
        model.drawn = Some(wall);
        Ok(())
    }

    /// Returns the mean radius of the organ a mesh encloses, mm: for its light.
    ///
    /// # Panics
    /// If the mesh was removed.
    pub fn mean_radius_mm(&self, mesh: MeshHandle) -> f32 {
        self.model(mesh).mean_radius_mm
    }

    /// Frees a mesh once no frame in flight uses it.
    pub fn remove_mesh(&mut self, mesh: MeshHandle) {
        if let Some(m) = self.models[mesh.0].take() {
            m.release(&self.releaser);
            self.glass_of = None;
        }
    }

    /// Puts a path on the device: its pieces in order, each LPS mm from start to end.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn upload_path(
        &mut self,
        gpu: &mut Gpu,
        pieces: &[Vec<Vec3>],
    ) -> Result<PathHandle, RenderError> {
        self.check_device(gpu);
        let model = upload_tubes(gpu, &Tubes::along(pieces))?;
        self.paths.push(Some(model));
        Ok(PathHandle(self.paths.len() - 1))
    }

    /// Frees a path once no frame in flight uses it.
    pub fn remove_path(&mut self, path: PathHandle) {
        self.paths[path.0].take().iter().for_each(|p| p.release(&self.releaser));
    }
}

pub(super) fn upload_tubes(gpu: &mut Gpu, tubes: &Tubes) -> Result<PlacedMesh, RenderError> {
    let bounds = tubes.vertices.iter().fold(None, |b: Option<(Vec3, Vec3)>, v| {
        let p = v.position();
        Some(b.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))))
    });
    upload(gpu, &tubes.vertices, &tubes.indices, bounds, 0.0)
}

/// A vertex with a colour.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct ColouredVertex {
    vertex: Vertex,
    colour: [u8; 4],
}

fn coloured(vertices: &[Vertex], colours: &[[u8; 4]]) -> Vec<ColouredVertex> {
    assert_eq!(vertices.len(), colours.len(), "one colour a vertex");
    let with =
        |(vertex, colour): (&Vertex, &[u8; 4])| ColouredVertex { vertex: *vertex, colour: *colour };
    vertices.iter().zip(colours).map(with).collect()
}

fn upload<V: Pod>(
    gpu: &mut Gpu,
    vertices: &[V],
    indices: &[u32],
    bounds: Option<(Vec3, Vec3)>,
    mean_radius_mm: f32,
) -> Result<PlacedMesh, RenderError> {
    let count = indices.len() as u32;
    gpu.all_or_none(|gpu| {
        let vertices = gpu.vertex_buffer("vertices", bytemuck::cast_slice(vertices))?;
        let indices = gpu.index_buffer("indices", indices)?;
        Ok(PlacedMesh {
            vertices,
            indices,
            count,
            bounds,
            mean_radius_mm,
            uncoloured: None,
            is_patches: false,
            drawn: None,
            refined: None,
        })
    })
}

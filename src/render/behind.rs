//! The tissue behind the wall, laid over the wall's picture.

use super::RenderError;
use super::host;
use super::pipelines::whole_pass;
use super::renderer::Renderer;
use super::scene::{Scene, Shot, TissueHandle, UnfoldedFace};
use crate::behind::BehindWall;
use crate::vk::{BufferId, Gpu, Pass, Releaser};

/// Tissue on the device.
pub(super) struct PlacedTissue {
    table: BufferId,
    tiles: BufferId,
    opacity: BufferId,
    /// Parameters that no camera changes.
    params: host::behind::Params,
    /// Transform from LPS mm to voxels, counted from the table's first brick.
    voxel_from_world: glam::DAffine3,
}

impl PlacedTissue {
    pub fn release(&self, releaser: &Releaser) {
        [self.table, self.tiles, self.opacity].into_iter().for_each(|b| releaser.buffer(b));
    }
}

impl Renderer {
    /// Puts the tissue behind a wall on the device, for [`Scene::behind`].
    ///
    /// # Errors
    /// [`RenderError::Vulkan`] when the device runs out of memory or cannot bind so much.
    pub fn upload_tissue(
        &mut self,
        gpu: &mut Gpu,
        behind: &BehindWall,
    ) -> Result<TissueHandle, RenderError> {
        self.check_device(gpu);
        let tissue = &behind.tissue;
        let (first, dims, table) = tissue.table();
        let placed = gpu.all_or_none(|gpu| {
            let mut buffer = |name, words: &[u8]| gpu.storage_buffer(name, words);
            Ok::<_, RenderError>(PlacedTissue {
                table: buffer("bricks about the wall", bytemuck::cast_slice(table))?,
                tiles: buffer("tissue", bytemuck::cast_slice(tissue.words()))?,
                opacity: buffer("opacity", bytemuck::cast_slice(&behind.table.entries))?,
                params: host::behind::Params {
                    skin: behind.band.skin_vox,
                    step: behind.table.step_mm,
                    band: behind.band.depth_mm,
                    reach: tissue.reach_mm(),
                    least: tissue.least_step_mm(),
                    dims_x: dims.x,
                    dims_y: dims.y,
                    dims_z: dims.z,
                    ..bytemuck::Zeroable::zeroed()
                },
                voxel_from_world: glam::DAffine3::from_translation(-8.0 * first.as_dvec3())
                    * tissue.voxel_from_world(),
            })
        })?;
        self.tissues.push(Some(placed));
        Ok(TissueHandle(self.tissues.len() - 1))
    }

    /// Frees tissue once no frame in flight uses it.
    pub fn remove_tissue(&mut self, tissue: TissueHandle) {
        if let Some(tissue) = self.tissues[tissue.0].take() {
            tissue.release(&self.releaser);
        }
    }

    /// Returns the pass that shows the tissue behind the wall in a finished inside view.
    ///
    /// # Panics
    /// If the scene's tissue was removed.
    pub(super) fn behind_pass(
        &self,
        scene: &Scene,
        shot: &Shot,
        eye: &UnfoldedFace,
    ) -> Option<Pass> {
        let tissue = self.tissues[scene.behind?.0].as_ref().expect("tissue that was not removed");
        let UnfoldedFace { camera, area } = eye;
        let pose = camera.pose;
        let axes = glam::DMat3::from_quat(pose.rotation.as_dquat());
        let per_mm = tissue.voxel_from_world.matrix3 * axes;
        let at = tissue.voxel_from_world.transform_point3(pose.position_mm.as_dvec3());
        let row = |axis: usize| per_mm.col(axis).as_vec3().extend(at[axis] as f32).to_array();
        let lamp = self.lamp(scene, shot);
        let half = 0.5 * area.height as f32;
        let push = host::behind::Params {
            right: row(0),
            up: row(1),
            back: row(2),
            middle: [area.x as f32 + 0.5 * area.width as f32, area.y as f32 + half],
            depth: half / (0.5 * camera.lens.fov_y_rad).tan(),
            near: camera.lens.near_mm,
            light: lamp.above_mm,
            falloff: lamp.falloff_mm,
            ..tissue.params
        };
        let targets = self.inside_targets(shot.view);
        let (to, pipeline) = (targets.picture, self.pipelines.behind);
        let push = bytemuck::bytes_of(&push);
        let mut pass = whole_pass(to, *area, pipeline, push, &[targets.kept_depth]);
        pass.draws[0].buffers = vec![tissue.table, tissue.tiles, tissue.opacity];
        Some(pass)
    }
}

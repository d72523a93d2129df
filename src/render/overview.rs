//! The overview: the organ as glass over path and camera.
//!
//! The glass depends on mesh, size, framing and opacity alone, so it is drawn once into an image
//! of its own (colour of all layers, and in alpha their remaining transmittance) and laid over each
//! frame's path and camera. It consists of two kinds of layer: the nearest wall, drawn first with a
//! depth test; and under it every wall, faint, all of one colour, so that their order cannot show.
//! Where frames have four samples a pixel, the glass has four pixels, averaged as it is laid.

use glam::Vec3;

use super::camera::clip_from_world;
use super::host;
use super::inside::surface_push;
use super::pipelines::whole_pass;
use super::renderer::{Renderer, draw};
use super::scene::{GlassKey, Scene, Shot};
use crate::geometry::{Lens, Pose};
use crate::vk::{Area, Draw, Pass};

/// Thickness of the path and size of the camera, as shares of the organ's diagonal.
const PATH_RADIUS: f32 = 0.0045;
const CAMERA_DEPTH: f32 = 0.07;

const PATH: [f32; 3] = [0.10, 0.85, 0.55];
const CAMERA: [f32; 3] = [1.0, 0.75, 0.05];

impl Renderer {
    /// Appends the passes that fill `area`.
    pub(super) fn overview_passes(
        &mut self,
        scene: &Scene,
        shot: &Shot,
        area: Area,
        passes: &mut Vec<Pass>,
    ) {
        let mesh = scene.overview;
        let path = scene.path.and_then(|p| self.paths[p.0].as_ref());
        let bounds = mesh.map_or(path.and_then(|p| p.bounds), |m| self.model(m).bounds);
        let (low, high) = bounds.unwrap_or((Vec3::ZERO, Vec3::ONE));
        let aspect = area.width as f32 / area.height as f32;
        let (pose, lens) = scene.framing.camera(low, high, aspect);
        let opacity = scene.look.opacity;
        let key = GlassKey { mesh, area, framing: scene.framing, opacity };
        if self.glass_of != Some(key) {
            passes.push(self.glass_pass(key, &pose, &lens));
            self.glass_of = Some(key);
        }
        let [r, g, b] = scene.look.background;
        let (colour, resolve) = self.targets.drawn_and_resolved();
        passes.push(Pass {
            colour,
            resolve,
            depth: Some(self.targets.depth),
            kept_depth: None,
            encoded: false,
            clear: Some([r, g, b, 1.0]),
            area,
            // Path and camera stay as large on the picture, however near the organ is.
            draws: self.marks(
                scene,
                shot,
                &pose,
                &lens,
                (high - low).length() / scene.framing.zoom,
            ),
        });
        let glass = self.targets.glass();
        let push = host::stack::Params { grid: glass.grid };
        let (to, pipeline) = (self.targets.picture, self.pipelines.stack);
        passes.push(whole_pass(to, area, pipeline, bytemuck::bytes_of(&push), &[glass.image]));
    }

    fn glass_pass(&self, key: GlassKey, pose: &Pose, lens: &Lens) -> Pass {
        let glass = self.targets.glass();
        let grid = glass.grid;
        let Area { x, y, width, height } = key.area;
        let area = Area { x: grid * x, y: grid * y, width: grid * width, height: grid * height };
        let model = key.mesh.map(|m| self.model(m));
        // From above and the side, far enough that it does not fall off.
        let corner = model.and_then(|m| m.bounds).map_or(Vec3::ZERO, |b| b.0);
        let lift = pose.position_mm.distance(corner);
        let aside = pose.rotation * Vec3::new(-0.35, 0.55, 0.0);
        let light = pose.position_mm + lift * aside;
        // Glass does not ask how light falls off.
        let push = surface_push(pose, lens, area, light, 1.0);
        let push = host::surface::Params { opacity: key.opacity, ..push };
        let push = bytemuck::bytes_of(&push);
        let p = &self.pipelines;
        let has_colours = model.is_some_and(|m| m.uncoloured.is_some());
        let layers = if has_colours { p.glass_coloured } else { p.glass };
        Pass {
            colour: glass.image,
            resolve: None,
            depth: Some(glass.depth),
            kept_depth: None,
            encoded: false,
            clear: Some([0.0, 0.0, 0.0, 1.0]),
            area,
            draws: model
                .map(|m| layers.iter().filter_map(|l| draw(*l, m, push, Vec::new())).collect())
                .unwrap_or_default(),
        }
    }

    /// Returns the draws of path and camera.
    fn marks(
        &self,
        scene: &Scene,
        shot: &Shot,
        pose: &Pose,
        lens: &Lens,
        diagonal: f32,
    ) -> Vec<Draw> {
        let base = host::lines::Params {
            clip: clip_from_world(pose, lens).to_cols_array(),
            origin: [0.0; 3],
            radius: PATH_RADIUS * diagonal,
            turn: [0.0, 0.0, 0.0, 1.0],
            scale: [1.0; 3],
            progress: shot.progress,
            colour: PATH,
            ahead: 0.35,
        };
        let depth = CAMERA_DEPTH * diagonal;
        let half = depth * (0.5 * shot.lens.fov_y_rad).tan().min(1.0);
        let camera = host::lines::Params {
            origin: shot.pose.position_mm.to_array(),
            turn: shot.pose.rotation.to_array(),
            scale: [half * shot.lens.aspect.min(1.5), half, depth],
            radius: 0.6 * base.radius,
            colour: CAMERA,
            progress: 1.0,
            ..base
        };
        let eye = host::lines::Params { radius: 2.2 * base.radius, ..camera };
        let lines = self.pipelines.lines;
        let path = scene.path.and_then(|p| self.paths[p.0].as_ref());
        let of = |model, push: &host::lines::Params| {
            draw(lines, model, bytemuck::bytes_of(push), Vec::new())
        };
        let path = path.and_then(|p| of(p, &base)).into_iter();
        if !scene.camera {
            return path.collect();
        }
        path.chain(of(&self.frustum, &camera)).chain(of(&self.ball, &eye)).collect()
    }
}

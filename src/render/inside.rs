//! The inside view: the wall under a lamp beside the eye.

use glam::{Vec2, Vec3};

use super::host;
use super::renderer::{Renderer, draw};
use super::scene::{FrameStats, Scene, Shot, UnfoldedFace, View};
use super::targets::Targets;
use crate::geometry::{Lens, Pose};
use crate::lod::DrawnRange;
use crate::vk::{Area, Draw, DrawRange, IndexedRange, Pass};

impl Renderer {
    /// Returns the lamp of a shot. It is beside the lens, as on an endoscope: relief needs a shadow
    /// side. The faces of a cube share one light, in the eye, or they would not meet.
    pub(super) fn lamp(&self, scene: &Scene, shot: &Shot) -> Lamp {
        let radius = self.mean_radius_mm(scene.wall);
        let room = shot.room_mm.filter(|r| *r > 0.0).unwrap_or(radius);
        let above_mm = super::look::LIGHT_ROOMS * room;
        Lamp {
            above_mm: if shot.view.is_all_round() { 0.0 } else { above_mm },
            falloff_mm: scene.look.falloff_mm.unwrap_or(super::look::FALLOFF_ROOMS * room),
        }
    }

    /// Returns the images that the inside views of a view are drawn to.
    pub(super) fn inside_targets(&self, view: View) -> &Targets {
        match (&self.faces, view) {
            (Some(faces), View::Panorama) => faces,
            _ => &self.targets,
        }
    }

    pub(super) fn inside_pass(
        &self,
        scene: &Scene,
        shot: &Shot,
        eye: &UnfoldedFace,
        visible: Option<DrawnParts<'_>>,
        stats: &mut FrameStats,
    ) -> Pass {
        let UnfoldedFace { camera, area } = eye;
        let (camera, area) = (*camera, *area);
        let model = self.model(scene.wall);
        let lamp = self.lamp(scene, shot);
        let light = shot.pose.position_mm + lamp.above_mm * shot.pose.up();
        let push = surface_push(&camera.pose, &camera.lens, area, light, lamp.falloff_mm);
        let push = bytemuck::bytes_of(&push);
        let p = &self.pipelines;
        let shows_backs = model.drawn.as_ref().is_none_or(|drawn| drawn.shows_backs());
        let patches = if shows_backs { p.patches } else { p.patch_fronts };
        let pipeline = match (&model.uncoloured, model.is_patches, shows_backs) {
            (Some(_), ..) => p.inside_coloured,
            (None, true, _) => patches,
            (None, false, true) => p.inside,
            (None, false, false) => p.inside_fronts,
        };
        let mut draws: Vec<Draw> = draw(pipeline, model, push, Vec::new()).into_iter().collect();
        match visible {
            None => {
                stats.draws += draws.len() as u32;
                stats.triangles += u64::from(model.count / 3);
            }
            Some(visible) => {
                let indirect =
                    |of: &[DrawnRange]| DrawRange::Indirect(of.iter().map(indexed).collect());
                draws.iter_mut().for_each(|draw| draw.range = indirect(visible.ranges));
                let is_empty =
                    |d: &Draw| matches!(&d.range, DrawRange::Indirect(of) if of.is_empty());
                draws.retain(|draw| !is_empty(draw));
                stats.draws += visible.ranges.len() as u32;
                if let (Some(range), Some(faces)) = (visible.refined, &model.refined) {
                    draws.push(Draw {
                        pipeline: if shows_backs { p.faces } else { p.face_fronts },
                        push: push.to_vec(),
                        vertices: Some(faces.vertices),
                        indices: Some(faces.indices),
                        range: DrawRange::Indirect(vec![range]),
                        images: Vec::new(),
                        buffers: vec![faces.fineness],
                        scissor: None,
                    });
                    stats.draws += 1;
                }
                stats.triangles += visible.triangles;
            }
        }
        let targets = self.inside_targets(shot.view);
        let (colour, resolve) = targets.drawn_and_resolved();
        let encoded = resolve.is_none();
        let reads_depth = scene.behind.is_some() || Self::raises_contrast(scene, shot.view);
        let background = scene.look.background;
        let [r, g, b] = if encoded { super::look::srgb(background) } else { background };
        Pass {
            colour,
            resolve,
            depth: Some(targets.depth),
            kept_depth: (reads_depth && targets.kept_depth != targets.depth)
                .then_some(targets.kept_depth),
            encoded,
            clear: Some([r, g, b, 1.0]),
            area,
            draws,
        }
    }
}

/// Lamp beside the eye.
pub(super) struct Lamp {
    /// Height above the eye, mm.
    pub above_mm: f32,
    /// Distance at which its light is halved, mm.
    pub falloff_mm: f32,
}

/// What an eye sees of a wall.
pub(super) struct DrawnParts<'a> {
    /// Ranges of the wall's own indices.
    pub ranges: &'a [DrawnRange],
    /// Its refined faces, if there are any.
    pub refined: Option<IndexedRange>,
    pub triangles: u64,
}

fn indexed(range: &DrawnRange) -> IndexedRange {
    IndexedRange {
        first_index: range.first_index,
        indices: range.indices,
        first_vertex: range.first_vertex,
        instance: range.morph,
    }
}

/// Range of the falloff, mm, within which squares of distances stay finite.
const FALLOFFS_MM: (f32, f32) = (1e-3, 1e6);

/// Returns the parameters of the surface shader; `light` in LPS mm, halved at `falloff` mm. Pixels
/// are square: the lens has the area's aspect.
pub(super) fn surface_push(
    pose: &Pose,
    lens: &Lens,
    area: Area,
    light: Vec3,
    falloff: f32,
) -> host::surface::Params {
    let focal = super::camera::focal(lens);
    let size = Vec2::new(area.width as f32, area.height as f32);
    let middle = Vec2::new(area.x as f32, area.y as f32) + 0.5 * size;
    let depth = -0.5 * size.y * focal.y;
    let falloff = falloff.clamp(FALLOFFS_MM.0, FALLOFFS_MM.1);
    let scale = (depth * falloff).recip();
    let turn = pose.rotation.conjugate();
    host::surface::Params {
        turn: turn.to_array(),
        eye: pose.position_mm.to_array(),
        near: lens.near_mm * scale,
        light: ((turn * (light - pose.position_mm)) / falloff).to_array(),
        scale,
        focal: focal.to_array(),
        middle: middle.to_array(),
        depth,
        opacity: 1.0,
        ..bytemuck::Zeroable::zeroed()
    }
}

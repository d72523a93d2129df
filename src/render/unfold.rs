//! Everything about the eye in one picture: a cube unfolded to a cross, or a panorama.
//!
//! Both are six square views. The cross shows them as they are (Vos, van Gelder, Serlie, Florie,
//! Nio, Glas, Post, Truyen, Gerritsen, Stoker 2003, Three-dimensional display modes for CT
//! colonography: conventional 3D virtual colonoscopy versus unfolded cube projection, Radiology
//! 228:878, doi:10.1148/radiol.2283020846); the panorama takes its colours from them.

use super::RenderError;
use super::host;
use super::pipelines::whole_pass;
use super::renderer::Renderer;
use super::scene::{Shot, UnfoldedFace, View};
use super::targets::Targets;
use crate::geometry::{Camera, cube_faces};
use crate::vk::{Area, Gpu, Pass};

/// Columns and rows of the cross: front in the middle of the left three, back on the right.
const CROSS: [u32; 2] = [4, 3];
/// Column and row of front, right, back, left, up, down in the cross.
const IN_CROSS: [[u32; 2]; 6] = [[1, 1], [2, 1], [3, 1], [0, 1], [1, 0], [1, 2]];
/// Columns of the image that a panorama takes its colours from, and their rows.
const IN_ROWS: [u32; 2] = [3, 2];

/// Returns the largest area of these proportions in the middle of a picture.
pub(super) fn fitted([width, height]: [u32; 2], [across, down]: [u32; 2]) -> Area {
    let unit = (width / across).min(height / down).max(1);
    let (w, h) = ((unit * across).min(width), (unit * down).min(height));
    Area { x: (width - w) / 2, y: (height - h) / 2, width: w, height: h }
}

/// Returns the areas of the six faces of a cube in a picture: front, right, back, left, up, down.
pub fn cube_areas(size: [u32; 2]) -> [[u32; 4]; 6] {
    faces_in_cross(size).map(|a| [a.x, a.y, a.width, a.height])
}

fn faces_in_cross(size: [u32; 2]) -> [Area; 6] {
    let all = fitted(size, CROSS);
    let side = (all.width / CROSS[0]).min(all.height / CROSS[1]).max(1);
    IN_CROSS.map(|[x, y]| {
        let (x, y) = ((all.x + x * side).min(size[0] - 1), (all.y + y * side).min(size[1] - 1));
        Area { x, y, width: side.min(size[0] - x), height: side.min(size[1] - y) }
    })
}

/// Returns the side of a cube face, texels, at which a panorama so wide is not coarser than the
/// face.
fn side_for(width: u32) -> u32 {
    (width as f32 / std::f32::consts::PI).ceil() as u32 + 2
}

impl Renderer {
    /// Returns the six views of a shot that is a cube or a panorama.
    pub(super) fn faces(&self, shot: &Shot) -> Vec<UnfoldedFace> {
        let (areas, margin) = match shot.view {
            View::Cube => (faces_in_cross(self.size()), 0.0),
            View::Panorama => {
                let side = side_for(fitted(self.size(), [2, 1]).width);
                let at = |i: u32| {
                    let (x, y) = (i % IN_ROWS[0] * side, i / IN_ROWS[0] * side);
                    Area { x, y, width: side, height: side }
                };
                // A texel beyond each edge.
                (std::array::from_fn(|i| at(i as u32)), 2.0 / (side as f32 - 2.0))
            }
            View::Inside | View::Translucent | View::Overview | View::Split => return Vec::new(),
        };
        let views = cube_faces(&shot.pose, &shot.lens, margin);
        let face = |((pose, lens), area): (_, Area)| UnfoldedFace {
            camera: Camera { pose, lens, height_px: area.height },
            area,
        };
        views.into_iter().zip(areas).map(face).collect()
    }

    /// Makes room for the faces of a panorama, where a shot is one.
    pub(super) fn room_for_faces(&mut self, gpu: &mut Gpu, view: View) -> Result<(), RenderError> {
        if view != View::Panorama {
            return Ok(());
        }
        let side = side_for(fitted(self.size(), [2, 1]).width);
        let extent = IN_ROWS.map(|n| n * side);
        if self.faces.as_ref().is_some_and(|f| f.extent == extent) {
            return Ok(());
        }
        let new = Targets::new(gpu, extent, self.samples, false)?;
        if let Some(old) = self.faces.replace(new) {
            old.release(&self.releaser);
        }
        Ok(())
    }

    /// Returns the pass that clears a picture before the faces of a cross are drawn to parts of it.
    pub(super) fn clear_pass(&self, background: [f32; 3]) -> Pass {
        let [width, height] = self.size();
        let [r, g, b] = background;
        Pass {
            colour: self.targets.picture,
            resolve: None,
            depth: None,
            kept_depth: None,
            encoded: false,
            clear: Some([r, g, b, 1.0]),
            area: Area { x: 0, y: 0, width, height },
            draws: Vec::new(),
        }
    }

    /// Returns the pass that makes a panorama of its six faces.
    pub(super) fn panorama_pass(&self) -> Option<Pass> {
        let faces = self.faces.as_ref()?;
        let area = fitted(self.size(), [2, 1]);
        let push = host::panorama::Params {
            origin: [area.x as f32, area.y as f32],
            size: [area.width as f32, area.height as f32],
            side: (faces.extent[0] / IN_ROWS[0]) as f32,
            ..bytemuck::Zeroable::zeroed()
        };
        let (to, pipeline) = (self.targets.picture, self.pipelines.panorama);
        Some(whole_pass(to, area, pipeline, bytemuck::bytes_of(&push), &[faces.picture]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cross_fits_every_picture_and_its_faces_are_squares_that_do_not_overlap() {
        for size in [[1280, 720], [640, 480], [100, 900], [900, 100], [7, 5], [2, 1]] {
            let faces = faces_in_cross(size);
            for a in faces {
                assert!(a.x + a.width <= size[0] && a.y + a.height <= size[1], "{size:?}: {a:?}");
                assert!(a.width > 0 && a.height > 0);
            }
            if size[0] >= 4 && size[1] >= 3 {
                assert!(faces.iter().all(|a| a.width == a.height));
                let side = faces[0].width;
                assert_eq!([faces[1].x, faces[3].x], [faces[0].x + side, faces[0].x - side]);
                assert_eq!([faces[4].y, faces[5].y], [faces[0].y - side, faces[0].y + side]);
            }
        }
        assert_eq!(fitted([1280, 720], [2, 1]), Area { x: 0, y: 40, width: 1280, height: 640 });
    }
}

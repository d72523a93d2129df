//! Pictures for the page of the report: the organ from in front with the path and the patches of
//! wall that the flight missed, and places of the flight from inside.

use std::sync::Arc;
use std::time::Instant;

use glam::{DVec3, Mat4, Vec3};

use super::frames::Display;
use super::{DrawnFrame, FrameStream, Product, Session, SessionError, locked, present};
use crate::flight::{Coverage, Flight};
use crate::formats::encode_png;
use crate::geometry::Mesh;
use crate::render::{
    FrameStats, Framing, MISSED, MeshHandle, PreparedMesh, RenderError, Renderer, Scene, Shot,
    View, clip_from_world,
};
use crate::surface::shading;
use crate::vk::{Gpu, return_freed_memory};

/// Number of places of the flight that are shown from inside.
const INSIDE: usize = 4;
/// Largest width of a picture from inside.
const INSIDE_WIDTH: u32 = 480;
/// Least height of the overview before its margins are cut off; frames that are as high are drawn
/// in their own size, which keeps the renderer's images.
const OVERVIEW_HEIGHT: u32 = 480;
/// Size of the overview otherwise.
const SMALL_OVERVIEW: [u32; 2] = [960, 720];
/// Margin that stays about the organ, as a share of the picture's height.
const MARGIN: f32 = 0.03;

/// A picture of the report.
#[derive(Clone, Debug, PartialEq)]
pub struct PngPicture {
    /// Columns and rows.
    pub size: [u32; 2],
    /// The picture as PNG.
    pub png: Vec<u8>,
}

/// Pictures of the report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportPictures {
    /// The organ from in front of the patient.
    pub overview: Option<OverviewPicture>,
    /// Places from inside, in the order of the flight.
    pub inside: Vec<InsidePicture>,
}

/// The organ as glass, with the path.
#[derive(Clone, Debug, PartialEq)]
pub struct OverviewPicture {
    /// The picture.
    pub picture: PngPicture,
    /// Transform from LPS mm to clip space of the picture before it was cut.
    clip: Mat4,
    /// Size of that picture.
    whole: [u32; 2],
    /// Column and row of its corner that the picture begins at.
    corner: [u32; 2],
    /// Direction to the right in the picture, LPS.
    right: Vec3,
}

impl OverviewPicture {
    /// Returns the side of the patient that is on the picture's right: `left` where it was taken from
    /// in front.
    pub fn on_the_right(&self) -> &'static str {
        let Vec3 { x, y, .. } = self.right;
        match (x.abs() >= y.abs(), x > 0.0, y > 0.0) {
            (true, true, _) => "left",
            (true, false, _) => "right",
            (false, _, true) => "back",
            (false, _, false) => "front",
        }
    }

    /// Returns the column and row over a point, LPS mm.
    pub fn at(&self, p_mm: [f64; 3]) -> [f64; 2] {
        let [x, y] = pixel(&self.clip, DVec3::from(p_mm).as_vec3(), self.whole);
        [f64::from(x) - f64::from(self.corner[0]), f64::from(y) - f64::from(self.corner[1])]
    }
}

/// A frame of the flight, reduced.
#[derive(Clone, Debug, PartialEq)]
pub struct InsidePicture {
    /// The picture.
    pub picture: PngPicture,
    /// Number of the frame, from 1.
    pub frame: usize,
    /// Length of the path up to it, mm; jumps between pieces do not count.
    pub arc_mm: f64,
}

/// Frames of a flight that are kept for the report, reduced.
#[derive(Default)]
pub(super) struct KeptFrames(Vec<(usize, [u32; 2], Vec<u8>)>);

impl KeptFrames {
    /// Keeps a frame if it is one of those that are shown.
    ///
    /// * `count`: frames of the flight.
    pub fn offer(&mut self, frame: &DrawnFrame, count: usize) {
        if is_shown(frame.index, count) {
            let (size, rgb) = reduced(&frame.rgb, frame.size);
            self.0.push((frame.index, size, rgb));
        }
    }
}

/// Whether a frame is in the middle of one of [`INSIDE`] equal parts of the flight.
fn is_shown(index: usize, count: usize) -> bool {
    (0..INSIDE).any(|k| (2 * k + 1) * count / (2 * INSIDE) == index)
}

/// Averages squares of pixels, so that no row is longer than [`INSIDE_WIDTH`].
fn reduced(rgb: &[u8], [width, height]: [u32; 2]) -> ([u32; 2], Vec<u8>) {
    let side = width.div_ceil(INSIDE_WIDTH).min(height).max(1);
    let size = [width / side, height / side];
    let (row, side) = (3 * width as usize, side as usize);
    let mut out = Vec::with_capacity(3 * size[0] as usize * size[1] as usize);
    for y in 0..size[1] as usize {
        for x in 0..size[0] as usize {
            for c in 0..3 {
                let first = y * side * row + 3 * x * side + c;
                let line = |j: usize| (0..side).map(move |i| first + j * row + 3 * i);
                let sum: usize = (0..side).flat_map(line).map(|at| usize::from(rgb[at])).sum();
                out.push(((sum + side * side / 2) / (side * side)) as u8);
            }
        }
    }
    (size, out)
}

/// Colours the vertices of the missed patches that are listed.
fn patch_colours(wall: &Mesh, coverage: Option<&Coverage>) -> Vec<[u8; 4]> {
    let mut colours = vec![[0; 4]; wall.positions.len()];
    let Some(coverage) = coverage else { return colours };
    for (face, patch) in wall.faces.iter().zip(&coverage.patch_of_face) {
        if patch.is_some_and(|p| p.get() as usize <= coverage.patches.len()) {
            face.iter().for_each(|v| colours[*v as usize] = MISSED);
        }
    }
    colours
}

fn pixel(clip: &Mat4, p: Vec3, [width, height]: [u32; 2]) -> [f32; 2] {
    let c = *clip * p.extend(1.0);
    [0.5 * (c.x / c.w + 1.0) * width as f32, 0.5 * (c.y / c.w + 1.0) * height as f32]
}

/// Returns first and last column and row about the projected box, with a margin.
fn frame_about(clip: &Mat4, (low, high): (Vec3, Vec3), size: [u32; 2]) -> [[u32; 2]; 2] {
    let corners = (0..8u32).map(|k| {
        let pick = |axis: u32| k >> axis & 1 == 1;
        Vec3::select(glam::BVec3::new(pick(0), pick(1), pick(2)), high, low)
    });
    let pixels: Vec<[f32; 2]> = corners.map(|p| pixel(clip, p, size)).collect();
    let margin = MARGIN * size[1] as f32;
    [0, 1].map(|axis| {
        let ends = pixels.iter().map(|p| p[axis]);
        let least = ends.clone().fold(f32::INFINITY, f32::min) - margin;
        let most = ends.fold(f32::NEG_INFINITY, f32::max) + margin;
        let first = (least.max(0.0) as u32).min(size[axis] - 1);
        [first, (most.ceil().max(0.0) as u32).clamp(first + 1, size[axis])]
    })
}

/// The part of a picture within columns and rows.
fn cut(rgb: &[u8], width: u32, [[left, right], [top, bottom]]: [[u32; 2]; 2]) -> PngPicture {
    let rows = (top as usize..bottom as usize).map(|y| {
        let row = 3 * y * width as usize;
        &rgb[row + 3 * left as usize..row + 3 * right as usize]
    });
    let size = [right - left, bottom - top];
    PngPicture { size, png: encode_png(size[0], size[1], &rows.collect::<Vec<_>>().concat()) }
}

impl Session {
    /// Pictures for the page of the report. Those from inside are the frames of `stream` that were
    /// kept for it; without one they are drawn.
    ///
    /// # Errors
    /// Errors of the stages and of the drawing.
    pub fn report_pictures(
        &self,
        stream: Option<&mut FrameStream>,
    ) -> Result<ReportPictures, SessionError> {
        let flight = self.flight()?;
        self.prepare(&[Product::ShownWall, Product::Display])?;
        let start = Instant::now();
        let display = present(&self.slots.display);
        // Memory that was freed after the products were written is room for the overview.
        return_freed_memory();
        let (overview, kept) = match stream {
            Some(stream) => {
                let kept = std::mem::take(&mut stream.kept);
                let drawn = self.draw_pictures(&display, stream.end(), &flight, false)?;
                (drawn.0, kept)
            }
            None => {
                let mut renderer = self.take_renderer(&display)?;
                let drawn = self.draw_pictures(&display, &mut renderer, &flight, true);
                *locked(&display.renderer) = Some(renderer);
                drawn?
            }
        };
        let pictures = ReportPictures { overview, inside: kept.named(&flight) };
        let count = pictures.inside.len() + usize::from(pictures.overview.is_some());
        let items = (count as u64, "pictures");
        self.clock().record("pictures", &display.name, start, items, Vec::new());
        Ok(pictures)
    }

    /// Draws the organ with the path, as large as it is within a frame, and on request the places
    /// from inside.
    fn draw_pictures(
        &self,
        display: &Display,
        renderer: &mut Renderer,
        flight: &Flight,
        inside: bool,
    ) -> Result<(Option<OverviewPicture>, KeptFrames), SessionError> {
        let (drawn, wall) = (present(&self.slots.shown_wall), present(&self.slots.wall));
        let mut kept = KeptFrames::default();
        let (Some(bounds), Some(_)) = (drawn.mesh().bounds(), flight.poses.first()) else {
            return Ok((None, kept));
        };
        let shaded = locked(&self.slots.shading).clone();
        let shaded = shaded.unwrap_or_else(|| Arc::new(shading(drawn.mesh())));
        let prepared = PreparedMesh::shaded(drawn.mesh(), shaded)?;
        let coverage = locked(&self.slots.coverage).clone();
        let colours = patch_colours(&wall.mesh, coverage.as_deref());
        let pieces =
            self.flown_pieces(&present(&self.slots.centerline).line, self.settings.flight.route)?;
        let side = Framing::of_path(pieces.iter().flatten().map(|p| p.as_dvec3()));
        let frame = renderer.size();
        let size = if frame[1] >= OVERVIEW_HEIGHT { frame } else { SMALL_OVERVIEW };
        let rgb = display.draw(renderer, |renderer, gpu| {
            if inside {
                let mesh = renderer.upload_prepared_mesh(gpu, &prepared)?;
                let outcome = draw_inside(gpu, renderer, mesh, flight, &mut kept);
                renderer.remove_mesh(mesh);
                outcome?;
            }
            let mesh = renderer.upload_coloured_mesh(gpu, &prepared, &colours)?;
            // The device needs room for the triangles of the whole organ now.
            drop((prepared, colours));
            return_freed_memory();
            let outcome = draw_overview(gpu, renderer, mesh, &pieces, size, (flight, side));
            renderer.remove_mesh(mesh);
            renderer.resize(gpu, frame[0], frame[1])?;
            outcome
        })?;
        let (pose, lens) = side.camera(bounds.0, bounds.1, size[0] as f32 / size[1] as f32);
        let clip = clip_from_world(&pose, &lens);
        let part = frame_about(&clip, bounds, size);
        let (picture, corner) = (cut(&rgb, size[0], part), part.map(|ends| ends[0]));
        let right = pose.rotation * Vec3::X;
        Ok((Some(OverviewPicture { picture, clip, whole: size, corner, right }), kept))
    }
}

/// Draws the whole organ with the path, without a camera, from a side.
fn draw_overview(
    gpu: &mut Gpu,
    renderer: &mut Renderer,
    mesh: MeshHandle,
    pieces: &[Vec<Vec3>],
    size: [u32; 2],
    (flight, framing): (&Flight, Framing),
) -> Result<Vec<u8>, RenderError> {
    let has_path = pieces.iter().any(|p| p.len() > 1);
    let path = has_path.then(|| renderer.upload_path(gpu, pieces)).transpose()?;
    let scene = Scene { path, framing, camera: false, ..Scene::of(mesh) };
    let drawn = renderer
        .resize(gpu, size[0], size[1])
        .and_then(|()| renderer.render(gpu, &scene, &shot(flight, 0, View::Overview)));
    path.into_iter().for_each(|path| renderer.remove_path(path));
    drawn
}

/// Draws the places from inside.
fn draw_inside(
    gpu: &mut Gpu,
    renderer: &mut Renderer,
    mesh: MeshHandle,
    flight: &Flight,
    kept: &mut KeptFrames,
) -> Result<(), RenderError> {
    let (scene, size, count) = (Scene::of(mesh), renderer.size(), flight.poses.len());
    for index in (0..count).filter(|i| is_shown(*i, count)) {
        let rgb = renderer.render(gpu, &scene, &shot(flight, index, View::Inside))?;
        kept.offer(&DrawnFrame { index, size, rgb, stats: FrameStats::default() }, count);
    }
    Ok(())
}

fn shot(flight: &Flight, frame: usize, view: View) -> Shot {
    let (pose, lens) = (flight.poses[frame], flight.lens(frame));
    Shot { view, pose, lens, progress: 1.0, room_mm: flight.room_mm.get(frame).copied() }
}

impl KeptFrames {
    /// The frames as pictures, with their places.
    fn named(self, flight: &Flight) -> Vec<InsidePicture> {
        let named = |(index, size, rgb): (usize, [u32; 2], Vec<u8>)| InsidePicture {
            picture: PngPicture { size, png: encode_png(size[0], size[1], &rgb) },
            frame: index + 1,
            arc_mm: flight.arc_mm.get(index).copied().unwrap_or(0.0),
        };
        self.0.into_iter().map(named).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_in_the_middle_of_quarters_are_shown_and_each_once() {
        let shown = |count: usize| (0..count).filter(|i| is_shown(*i, count)).collect::<Vec<_>>();
        assert_eq!(shown(120), [15, 45, 75, 105]);
        assert_eq!(shown(4), [0, 1, 2, 3]);
        assert_eq!(shown(2), [0, 1]);
        assert_eq!(shown(1), [0]);
    }

    #[test]
    fn a_reduced_picture_has_the_mean_of_each_square() {
        let mut rgb = vec![0; 3 * 1000 * 5];
        for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
            pixel.copy_from_slice(&[(i % 1000 % 3 * 60) as u8, 10, (i / 1000 * 9) as u8]);
        }
        let (size, out) = reduced(&rgb, [1000, 5]);
        assert_eq!((size, out.len()), ([333, 1], 999));
        assert_eq!(out[..3], [60, 10, 9]);
        assert_eq!(reduced(&rgb[..15], [5, 1]), ([5, 1], rgb[..15].to_vec()), "small ones stay");
    }

    #[test]
    fn a_cut_overview_shows_the_whole_box_and_knows_where_points_are() {
        let (low, high) = (Vec3::new(-40.0, 10.0, 300.0), Vec3::new(25.0, 60.0, 420.0));
        let size = [960, 720];
        let (pose, lens) = Framing::default().camera(low, high, 960.0 / 720.0);
        let clip = clip_from_world(&pose, &lens);
        let kept = frame_about(&clip, (low, high), size);
        let picture = cut(&vec![7; 3 * 960 * 720], 960, kept);
        let corner = kept.map(|ends| ends[0]);
        let right = pose.rotation * Vec3::X;
        let overview = OverviewPicture { picture, clip, whole: size, corner, right };
        let [width, height] = overview.picture.size.map(f64::from);
        assert!(width < 500.0 && height > 600.0, "{width} x {height}");
        for p in [low, high] {
            let [x, y] = overview.at(p.as_dvec3().to_array());
            assert!(0.0 < x && x < width && 0.0 < y && y < height, "{x} {y}");
        }
        let [left, bottom] = overview.at(low.as_dvec3().to_array());
        let [right, top] = overview.at(high.as_dvec3().to_array());
        assert!(left < right && top < bottom, "the patient's left on the right, head up");
        assert_eq!(overview.on_the_right(), "left");
        let from_left = OverviewPicture { right: Vec3::new(0.3, 0.9, 0.0), ..overview };
        assert_eq!(from_left.on_the_right(), "back");
    }
}

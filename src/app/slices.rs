//! Slices of the volume: a plane in patient space, sampled at each pixel, with the lumen's outline.
//!
//! Patient's right is on the left of axial and coronal slices, front is up in axial and on the left
//! of sagittal ones, head is up in the other two: as radiology shows them.

use glam::{DAffine3, DVec3, USizeVec3};

use super::action::{Pane, SlabMode};
use crate::geometry::Pose;
use crate::lumen::Lumen;
use crate::volume::{Sample, Volume, with_samples};

/// A plane that is looked at: LPS mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlicePlane {
    /// Centre of the picture.
    pub centre_mm: DVec3,
    /// Unit, to the right of the picture.
    pub right: DVec3,
    /// Unit, to its lower edge.
    pub down: DVec3,
    /// Side of a pixel, mm.
    pub mm_per_px: f64,
}

impl SlicePlane {
    /// The plane of a pane of slices; `None` of the others.
    pub fn of(pane: Pane, centre_mm: DVec3, mm_per_px: f64, pose: Option<Pose>) -> Option<Self> {
        let (right, down) = match pane {
            Pane::Axial => (DVec3::X, DVec3::Y),
            Pane::Coronal => (DVec3::X, DVec3::NEG_Z),
            Pane::Sagittal => (DVec3::Y, DVec3::NEG_Z),
            Pane::Across => {
                let rotation = pose?.rotation.as_dquat();
                (rotation * DVec3::X, rotation * DVec3::NEG_Y)
            }
            Pane::Inside | Pane::Overview => return None,
        };
        Some(Self { centre_mm, right, down, mm_per_px })
    }

    /// Returns the way of the picture's centre, in its plane, to where the volume fills the picture,
    /// or lies in its middle where it is smaller. Beyond an end of the volume there is nothing to
    /// see.
    pub fn way_into(&self, volume: &Volume, size: [usize; 2]) -> DVec3 {
        let axes = [self.right, self.down];
        let [x, y] = match self.range_in(volume) {
            None => return DVec3::ZERO,
            Some(ranges) => [0, 1].map(|i| {
                let half = 0.5 * size[i] as f64 * self.mm_per_px;
                let [low, high] = ranges[i];
                match high - low > 2.0 * half {
                    true => 0.0f64.clamp(low + half, high - half),
                    false => 0.5 * (low + high),
                }
            }),
        };
        axes[0] * x + axes[1] * y
    }

    /// Ranges of the part of the plane that lies in a volume, along both of its axes from its
    /// centre, mm; `None` where the plane passes it by.
    fn range_in(&self, volume: &Volume) -> Option<[[f64; 2]; 2]> {
        let grid = &volume.grid;
        let to_world = grid.world_from_voxel();
        let corner = |i: u32| {
            let far = DVec3::from_array([0, 1, 2].map(|axis| f64::from(i >> axis & 1)));
            let voxel = far * (grid.dims.as_dvec3() - 1.0);
            to_world.transform_point3(voxel) - self.centre_mm
        };
        let normal = self.right.cross(self.down);
        let mut ranges = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for (a, axis) in (0..8u32).flat_map(|a| [1, 2, 4].map(|axis| (a, axis))) {
            if a & axis != 0 {
                continue;
            }
            let (p, q) = (corner(a), corner(a | axis));
            let (from, to) = (p.dot(normal), q.dot(normal));
            // An edge in the plane, or one that crosses it.
            const IN_PLANE_MM: f64 = 1e-6;
            let ends = match (from.abs() < IN_PLANE_MM, to.abs() < IN_PLANE_MM) {
                (true, true) => [p, q],
                _ if from * to <= 0.0 => [p.lerp(q, from / (from - to)); 2],
                _ => continue,
            };
            for point in ends {
                for (range, along) in ranges.iter_mut().zip([self.right, self.down]) {
                    let at = point.dot(along);
                    *range = [range[0].min(at), range[1].max(at)];
                }
            }
        }
        (ranges[0][0] <= ranges[0][1]).then_some(ranges)
    }

    /// The place under a pixel of a picture so large.
    pub fn at(&self, px: [f64; 2], size: [usize; 2]) -> DVec3 {
        let [x, y] = [0, 1].map(|i| (px[i] - 0.5 * size[i] as f64) * self.mm_per_px);
        self.centre_mm + self.right * x + self.down * y
    }

    /// The pixel over a place, and how far the place is from the plane, mm.
    pub fn px(&self, p_mm: DVec3, size: [usize; 2]) -> ([f64; 2], f64) {
        let off = p_mm - self.centre_mm;
        let x = off.dot(self.right) / self.mm_per_px + 0.5 * size[0] as f64;
        let y = off.dot(self.down) / self.mm_per_px + 0.5 * size[1] as f64;
        ([x, y], off.dot(self.right.cross(self.down)))
    }

    /// Letters of the patient's sides at the left, right, upper and lower edge of the picture.
    pub fn sides(&self) -> [String; 4] {
        [-self.right, self.right, -self.down, self.down].map(side_letters)
    }
}

/// Returns the letters of the sides that a direction points to: the main one, a second if oblique.
pub fn side_letters(direction: DVec3) -> String {
    let mut parts: Vec<(f64, char)> =
        [(direction.x, 'L', 'R'), (direction.y, 'P', 'A'), (direction.z, 'H', 'F')]
            .map(|(v, plus, minus)| (v.abs(), if v > 0.0 { plus } else { minus }))
            .to_vec();
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    parts.iter().take(2).filter(|p| p.0 > 0.4).map(|p| p.1).collect()
}

/// The place of a volume that is nearest to another, LPS mm.
pub fn nearest_inside(volume: &Volume, p_mm: DVec3) -> DVec3 {
    let grid = &volume.grid;
    let v = grid.voxel_from_world().transform_point3(p_mm);
    let inside = v.clamp(DVec3::ZERO, grid.dims.as_dvec3() - 1.0);
    if v == inside { p_mm } else { grid.world_from_voxel().transform_point3(inside) }
}

/// Millimetres from one slice of a volume to the next along a unit direction.
pub fn slice_step_mm(volume: &Volume, along: DVec3) -> f64 {
    let grid = &volume.grid;
    (grid.direction.transpose() * along).abs().dot(grid.spacing_mm).max(0.1)
}

/// Value of the voxel at a place, as the scan has it: between voxels nothing was measured.
pub fn value_at(volume: &Volume, p_mm: DVec3) -> Option<f64> {
    let voxel = volume.grid.nearest_voxel(p_mm)?;
    Some(volume.real(volume.grid.index(voxel)))
}

/// Colour of the lumen's outline.
pub(super) const OUTLINE: [u8; 3] = [77, 234, 172];
/// Colour of what lies outside the volume.
const OUTSIDE: [u8; 3] = [12, 12, 14];

/// Values along the normal of a slice that make a pixel of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// What is shown of them.
    pub mode: SlabMode,
    /// Thickness, mm, half of it to each side.
    pub thickness_mm: f64,
    /// Most planes: fewer while things move.
    pub most: u32,
}

impl Slab {
    /// Most planes of a slice at rest, and of one that moves.
    pub const PLANES: [u32; 2] = [64, 6];
}

/// A slice: RGB, rows from the top.
///
/// * `window`: centre and width of the grey values, black to white.
/// * `slab`: of a thick slice.
pub fn slice(
    volume: &Volume,
    lumen: Option<&Lumen>,
    plane: &SlicePlane,
    size: [usize; 2],
    window: [f64; 2],
    slab: Option<Slab>,
) -> Vec<[u8; 3]> {
    let walk = Walk::new(plane, &volume.grid.voxel_from_world(), size);
    let planes = slab.map_or(Planes::one(), |slab| Planes::of(slab, plane, volume));
    // The samples' type is matched once, not for each of eight values a pixel.
    let mut out = with_samples!(&volume.samples, |s| grey(volume, s, &walk, size, window, &planes));
    if let Some(lumen) = lumen {
        outline(lumen, plane, size, &mut out);
    }
    out
}

/// Grey values of a slice, without the lumen.
fn grey<T: Sample>(
    volume: &Volume,
    samples: &[T],
    walk: &Walk,
    [width, height]: [usize; 2],
    window: [f64; 2],
    planes: &Planes,
) -> Vec<[u8; 3]> {
    let low = window[0] - 0.5 * window[1];
    let scale = 255.0 / window[1];
    let mut out = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let value = planes.value(walk.at(x, y), |v| trilinear(volume, samples, v));
            out.push(value.map_or(OUTSIDE, |v| [((v - low) * scale).clamp(0.0, 255.0) as u8; 3]));
        }
    }
    out
}

/// Draws the edge of the lumen's voxels: pixels inside whose right or lower neighbour is not, and
/// the other way round.
fn outline(lumen: &Lumen, plane: &SlicePlane, [width, height]: [usize; 2], out: &mut [[u8; 3]]) {
    let walk = Walk::new(plane, &lumen.grid.voxel_from_world(), [width, height]);
    let inside = |x: usize, y: usize| {
        // Rounded by truncation, which is no call.
        let voxel = walk.at(x, y) + 0.5;
        voxel.cmpge(DVec3::ZERO).all() && lumen.holds(voxel.as_ivec3())
    };
    let row = |y: usize| (0..width).map(|x| inside(x, y)).collect::<Vec<bool>>();
    let mut above = row(0);
    for y in 1..height {
        let here = row(y);
        for x in 1..width {
            if here[x] != here[x - 1] || here[x] != above[x] {
                out[y * width + x] = OUTLINE;
            }
        }
        above = here;
    }
}

/// Planes of a slice, as offsets from its middle in voxels.
struct Planes {
    mode: SlabMode,
    offsets: Vec<DVec3>,
}

impl Planes {
    fn one() -> Self {
        Self { mode: SlabMode::Mean, offsets: vec![DVec3::ZERO] }
    }

    /// Planes a voxel apart, those of the thickest slices farther.
    fn of(slab: Slab, plane: &SlicePlane, volume: &Volume) -> Self {
        let normal = plane.right.cross(plane.down);
        let voxel_mm = normal.abs().dot(volume.grid.spacing_mm).max(1e-3);
        let steps = (slab.thickness_mm / voxel_mm).ceil().clamp(1.0, f64::from(slab.most)) as i32;
        let step = slab.thickness_mm / f64::from(steps);
        let to_voxel = volume.grid.voxel_from_world();
        let at = |i: i32| (f64::from(i) + 0.5) * step - 0.5 * slab.thickness_mm;
        let offset = |i: i32| to_voxel.transform_vector3(normal * at(i));
        Self { mode: slab.mode, offsets: (0..steps).map(offset).collect() }
    }

    /// The value of a pixel; planes outside the volume do not count.
    #[inline]
    fn value(&self, middle: DVec3, sample: impl Fn(DVec3) -> Option<f64>) -> Option<f64> {
        let values = self.offsets.iter().filter_map(|offset| sample(middle + *offset));
        let (count, value) = values.fold((0u32, 0.0), |(count, so_far), value| {
            let both = match self.mode {
                _ if count == 0 => value,
                SlabMode::Mean => so_far + value,
                SlabMode::Max => so_far.max(value),
                SlabMode::Min => so_far.min(value),
            };
            (count + 1, both)
        });
        match self.mode {
            _ if count == 0 => None,
            SlabMode::Mean => Some(value / f64::from(count)),
            SlabMode::Max | SlabMode::Min => Some(value),
        }
    }
}

/// Voxel coordinates of pixels.
struct Walk {
    first: DVec3,
    along_x: DVec3,
    along_y: DVec3,
}

impl Walk {
    fn new(plane: &SlicePlane, voxel_from_world: &DAffine3, size: [usize; 2]) -> Self {
        let first = voxel_from_world.transform_point3(plane.at([0.5, 0.5], size));
        let step = |d: DVec3| voxel_from_world.transform_vector3(d * plane.mm_per_px);
        Self { first, along_x: step(plane.right), along_y: step(plane.down) }
    }

    fn at(&self, x: usize, y: usize) -> DVec3 {
        self.first + self.along_x * x as f64 + self.along_y * y as f64
    }
}

/// The value between eight voxels; `None` farther than half a voxel outside.
fn trilinear<T: Sample>(volume: &Volume, samples: &[T], v: DVec3) -> Option<f64> {
    let last = volume.grid.dims.as_dvec3() - 1.0;
    if !(v.cmpge(DVec3::splat(-0.5)) & v.cmple(last + 0.5)).all() {
        return None;
    }
    let v = v.clamp(DVec3::ZERO, last);
    let d = volume.grid.dims.as_usizevec3();
    // Truncation instead of floor, which is a call: nothing is below 0.
    let i = v.as_usizevec3().min(d.saturating_sub(USizeVec3::splat(2)));
    let t = v - i.as_dvec3();
    let step = |n: usize, s: usize| if n > 1 { s } else { 0 };
    let (sx, sy, sz) = (step(d.x, 1), step(d.y, d.x), step(d.z, d.x * d.y));
    let first = i.x + d.x * (i.y + d.y * i.z);
    let get = |o: usize| samples[first + o].to_f64();
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let row = |o: usize| mix(get(o), get(o + sx), t.x);
    let face = |o: usize| mix(row(o), row(o + sy), t.y);
    Some(volume.rescale.real(mix(face(0), face(sz), t.z)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Grid, Samples};
    use glam::Quat;

    fn volume() -> Volume {
        let grid = Grid::axis_aligned([5, 6, 7], [1.0, 2.0, 3.0]);
        let value = |i: usize| {
            let v = grid.voxel(i).as_ivec3();
            (v.x + 10 * v.y + 100 * v.z) as i16
        };
        let samples = Samples::I16((0..grid.len()).map(value).collect::<Vec<_>>().into());
        Volume::new(grid, samples)
    }

    #[test]
    fn values_between_voxels_are_those_of_a_linear_field_and_there_are_none_outside() {
        let v = volume();
        let Samples::I16(samples) = &v.samples else { panic!("the samples above") };
        let at = |x, y, z| trilinear(&v, samples, DVec3::new(x, y, z));
        assert_eq!(at(1.5, 2.25, 3.75), Some(1.5 + 22.5 + 375.0));
        assert_eq!(at(4.0, 5.0, 6.0), Some(654.0));
        assert_eq!(at(-0.4, 0.0, 0.0), Some(0.0));
        assert_eq!(at(4.6, 0.0, 0.0), None);
        assert_eq!(at(f64::NAN, 0.0, 0.0), None);
    }

    #[test]
    fn the_value_at_a_place_is_that_of_its_voxel_and_there_is_none_outside() {
        let v = volume();
        // Voxel (3, 2, 4), a third of a voxel beside its centre.
        assert_eq!(value_at(&v, DVec3::new(3.3, 4.0, 12.9)), Some(423.0));
        assert_eq!(value_at(&v, DVec3::new(-5.0, 0.0, 0.0)), None);
    }

    #[test]
    fn slices_are_turned_as_radiology_shows_them() {
        let plane = |pane| SlicePlane::of(pane, DVec3::ZERO, 1.0, None).unwrap();
        let sides = |pane| plane(pane).sides().concat();
        assert_eq!(sides(Pane::Axial), "RLAP");
        assert_eq!(sides(Pane::Coronal), "RLHF");
        assert_eq!(sides(Pane::Sagittal), "APHF");
        assert!(SlicePlane::of(Pane::Inside, DVec3::ZERO, 1.0, None).is_none());
        let pose = Pose { position_mm: glam::Vec3::ZERO, rotation: Quat::IDENTITY };
        let across = SlicePlane::of(Pane::Across, DVec3::ZERO, 1.0, Some(pose)).unwrap();
        assert_eq!(across.sides().concat(), "RLPA");
        assert_eq!(side_letters(DVec3::new(0.7, -0.7, 0.0)).len(), 2);
    }

    #[test]
    fn a_pixel_and_its_place_belong_together() {
        let plane = SlicePlane::of(Pane::Sagittal, DVec3::new(1.0, 2.0, 3.0), 0.5, None).unwrap();
        let (px, off) = plane.px(plane.at([10.0, 30.0], [64, 48]), [64, 48]);
        assert!((px[0] - 10.0).abs() < 1e-9 && (px[1] - 30.0).abs() < 1e-9 && off.abs() < 1e-9);
    }

    #[test]
    fn a_thick_slice_shows_mean_largest_and_least_of_the_planes_in_the_volume() {
        let v = volume();
        // Values grow by 100 a plane, planes lie 3 mm apart, and the middle one is the third.
        let plane = SlicePlane::of(Pane::Axial, DVec3::new(2.0, 4.0, 9.0), 1.0, None).unwrap();
        let of = |mode, thickness_mm| {
            let planes = Planes::of(Slab { mode, thickness_mm, most: 64 }, &plane, &v);
            let Samples::I16(samples) = &v.samples else { panic!("the samples above") };
            planes.value(DVec3::new(1.0, 2.0, 3.0), |p| trilinear(&v, samples, p)).unwrap()
        };
        let middle = 1.0 + 20.0 + 300.0;
        assert!((of(SlabMode::Mean, 9.0) - middle).abs() < 1e-9);
        assert!((of(SlabMode::Max, 9.0) - (middle + 100.0)).abs() < 1e-9);
        assert!((of(SlabMode::Min, 9.0) - (middle - 100.0)).abs() < 1e-9);
        let most = of(SlabMode::Max, 50.0);
        assert!(most > 21.0 + 590.0 && most <= 21.0 + 600.0, "no more than there is: {most}");
    }

    #[test]
    fn the_window_maps_its_ends_to_black_and_white() {
        let v = volume();
        let plane = SlicePlane::of(Pane::Axial, DVec3::new(2.0, 4.0, 9.0), 1.0, None).unwrap();
        let of = |window| slice(&v, None, &plane, [2, 2], window, None)[0][0];
        let Samples::I16(samples) = &v.samples else { panic!("the samples above") };
        let place = v.grid.voxel_from_world().transform_point3(plane.at([0.5, 0.5], [2, 2]));
        let value = trilinear(&v, samples, place).unwrap();
        assert_eq!(of([value, 2.0]), 127);
        assert_eq!((of([value + 10.0, 2.0]), of([value - 10.0, 2.0])), (0, 255));
    }
}

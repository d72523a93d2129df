//! A picture of the segmented organ: the volume seen from the front, from the left and from the
//! feet, as an X-ray would show it, with the organ and its seeds in colour. And the names of the
//! components of a CT, one line for each piece of gas and each chain of bright sections.

use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::arteries;
use super::gas::Gas;
use super::vessel::CT_HU;
use crate::lumen::Lumen;
use crate::volume::{Grid, Volume};

/// Longest side of a view, pixels.
const SIDE_PX: f64 = 480.0;
/// Margin between views and around them, pixels.
const GAP_PX: usize = 8;
/// Samples that are looked at for a view, about.
const SAMPLES: usize = 1 << 24;
/// Colour of the organ and of a seed.
const ORGAN: [f32; 3] = [255.0, 150.0, 40.0];
const SEED: [f32; 3] = [60.0, 230.0, 255.0];

/// Width, height and RGB of a picture.
pub type Picture = (u32, u32, Vec<u8>);

/// Draws a lumen in its volume.
pub fn explain(volume: &Volume, lumen: &Lumen, seeds: &[UVec3]) -> Picture {
    // Right and down in patient space: to the left and the feet, to the back and the feet, to the
    // left and the back.
    let views = [
        AxisView::new(volume, DVec3::X, DVec3::NEG_Z),
        AxisView::new(volume, DVec3::Y, DVec3::NEG_Z),
        AxisView::new(volume, DVec3::X, DVec3::Y),
    ];
    let width = GAP_PX + views.iter().map(|v| v.width + GAP_PX).sum::<usize>();
    let height = 2 * GAP_PX + views.iter().map(|v| v.height).max().unwrap_or(0);
    let mut rgb = vec![0; 3 * width * height];
    let mut left = GAP_PX;
    for view in &views {
        let picture = view.draw(volume, lumen, seeds);
        for (row, pixels) in picture.chunks(3 * view.width).enumerate() {
            let at = 3 * (left + width * (row + GAP_PX));
            rgb[at..at + pixels.len()].copy_from_slice(pixels);
        }
        left += view.width + GAP_PX;
    }
    (width as u32, height as u32, rgb)
}

/// Describes the patient's frame and the components of a CT with their names, a line each; of other
/// volumes nothing.
pub fn named_components(volume: &Volume) -> Vec<String> {
    if volume.range().is_none_or(|(low, _)| low >= CT_HU) {
        return Vec::new();
    }
    let mut lines = arteries::named(volume);
    if let Some(gas) = Gas::of(volume) {
        let taken = gas.colon.iter().map(|c| {
            let ml = c.features.volume_ml;
            format!("{ml:.0} ml of gas at {}: {}", c.seed, c.name.line())
        });
        lines.extend(taken);
        lines.extend(gas.left_out);
    }
    lines
}

/// A view along the index axis nearest to a direction of patient space.
struct AxisView {
    /// Index axes of right, down and the rays.
    axes: [usize; 3],
    /// Whether right and down run against their axes.
    flipped: [bool; 2],
    width: usize,
    height: usize,
}

impl AxisView {
    fn new(volume: &Volume, right: DVec3, down: DVec3) -> Self {
        let grid = &volume.grid;
        let nearest = |way: DVec3, but: Option<usize>| {
            let along = |axis: &usize| grid.direction.col(*axis).dot(way).abs();
            let free = (0..3).filter(|axis| Some(*axis) != but);
            free.max_by(|a, b| along(a).total_cmp(&along(b))).unwrap_or(0)
        };
        let u = nearest(right, None);
        let v = nearest(down, Some(u));
        let through = 3 - u - v;
        let flip = |axis: usize, way: DVec3| grid.direction.col(axis).dot(way) < 0.0;
        let extent = extent_mm(grid);
        let px = SIDE_PX / extent.max_element();
        let side = |axis: usize| ((extent[axis] * px).round() as usize).max(1);
        Self {
            axes: [u, v, through],
            flipped: [flip(u, right), flip(v, down)],
            width: side(u),
            height: side(v),
        }
    }

    /// The voxel of a pixel's ray at a step.
    fn voxel(&self, grid: &Grid, p: usize, q: usize, step: usize) -> UVec3 {
        let [u, v, w] = self.axes;
        let pick = |at: usize, side: usize, n: u32, flipped: bool| {
            let i = (at * n as usize / side) as u32;
            if flipped { n - 1 - i } else { i }
        };
        let mut out = UVec3::ZERO;
        out[u] = pick(p, self.width, grid.dims[u], self.flipped[0]);
        out[v] = pick(q, self.height, grid.dims[v], self.flipped[1]);
        out[w] = step as u32;
        out
    }

    fn draw(&self, volume: &Volume, lumen: &Lumen, seeds: &[UVec3]) -> Vec<u8> {
        let grid = &volume.grid;
        let along = grid.dims[self.axes[2]] as usize;
        let stride = (self.width * self.height * along).div_ceil(SAMPLES).max(1);
        let (low, high) = volume.range().unwrap_or((0.0, 1.0));
        let (low, high) = if low < -500.0 { (-1000.0, 700.0) } else { (low, high) };
        // Of each ray: the mean value and the share that is organ.
        let rays: Vec<(f32, f32)> = (0..self.width * self.height)
            .into_par_iter()
            .map(|i| {
                let (mut sum, mut inside, mut n) = (0.0, 0, 0);
                for step in (0..along).step_by(stride) {
                    let v = self.voxel(grid, i % self.width, i / self.width, step);
                    sum += volume.real(grid.index(v)).clamp(low, high) - low;
                    inside += u32::from(lumen.holds(lumen.own_voxel(v.as_ivec3())));
                    n += 1;
                }
                let n = f64::from(n.max(1));
                ((sum / n) as f32, (f64::from(inside) / n) as f32)
            })
            .collect();
        let most = |of: fn(&(f32, f32)) -> f32| rays.iter().map(of).fold(1e-6, f32::max);
        let (bright, thick) = (most(|r| r.0), most(|r| r.1));
        let mut rgb: Vec<f32> = Vec::with_capacity(3 * rays.len());
        for (mean, share) in &rays {
            let grey = 220.0 * (mean / bright).sqrt();
            let cover = if *share > 0.0 { 0.25 + 0.65 * (share / thick).sqrt() } else { 0.0 };
            rgb.extend(ORGAN.map(|c| grey + cover * (c - grey)));
        }
        for seed in seeds {
            self.mark(grid, *seed, &mut rgb);
        }
        rgb.iter().map(|c| c.round() as u8).collect()
    }

    /// A cross over a voxel.
    fn mark(&self, grid: &Grid, voxel: UVec3, rgb: &mut [f32]) {
        let place = |k: usize, side: usize| {
            let n = grid.dims[self.axes[k]];
            let i = voxel[self.axes[k]];
            let i = if self.flipped[k] { n - 1 - i } else { i };
            (i as usize * side / n as usize + side / n as usize / 2) as i64
        };
        let (x, y) = (place(0, self.width), place(1, self.height));
        for d in -6..=6i64 {
            for (px, py) in [(x + d, y), (x, y + d)] {
                let inside =
                    (0..self.width as i64).contains(&px) && (0..self.height as i64).contains(&py);
                if inside && d.abs() > 1 {
                    let at = 3 * (px as usize + self.width * py as usize);
                    rgb[at..at + 3].copy_from_slice(&SEED);
                }
            }
        }
    }
}

fn extent_mm(grid: &Grid) -> DVec3 {
    grid.dims.as_dvec3() * grid.spacing_mm
}

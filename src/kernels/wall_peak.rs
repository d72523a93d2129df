//! CPU twin of `wall_peak`: peaks of the wall and crests of sheets.

use rayon::prelude::*;

use super::blocks::{bit, element, excess_bits, length_of, place};
pub use super::host::wall_peak::{Bindings, Params};
use super::host::wall_peak::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/wall_peak.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

/// Bit of a mark: voxel outside the core, or beside one that growth has not reached.
pub const RIM: u32 = 1;
/// Bit of a mark: crest of a sheet.
pub const CREST: u32 = 2;
/// Bit of a mark: voxel of the core, or joined in growth.
pub const JOINED: u32 = 8;

/// Value of the wall; the lumen's is 0.
const WALL: i32 = 4096;
/// Least value of a crest above the lumen.
const MIN_CREST: i32 = 614;
/// Steps of a ray within two least spacings.
const NEAR_STEPS: i32 = 4;

/// Values about a brick, positions counted from its first voxel.
#[derive(Clone, Copy)]
struct BrickView<'a> {
    near: &'a [u32],
    slot: usize,
    corner: [i32; 3],
    size: [i32; 3],
    value: &'a [i32],
    sharp: &'a [i32],
}

impl BrickView<'_> {
    /// Returns the element of a voxel, clamped to the volume.
    #[inline]
    fn held(&self, p: [i32; 3]) -> Option<usize> {
        let q: [i32; 3] = std::array::from_fn(|a| {
            (p[a] + self.corner[a]).clamp(0, self.size[a] - 1) - self.corner[a]
        });
        if q.iter().any(|c| !(-8..=15).contains(c)) {
            return None;
        }
        element(self.near, self.slot, q)
    }

    /// Returns the trilinear sharpened value at a position in 1/65536 of a voxel.
    #[inline]
    fn sample(&self, at: [i32; 3]) -> Option<i32> {
        let p = at.map(|c| c >> 16);
        let f = at.map(|c| c >> 8 & 255);
        let blend = |a: i32, b: i32, f: i32| a + (((b - a) * f + 128) >> 8);
        let mut v = [0; 8];
        let inside = |a: usize| (0..7).contains(&p[a]) && p[a] + self.corner[a] + 1 < self.size[a];
        if (0..3).all(inside) {
            let e = self.slot * BRICK + (p[0] + 8 * p[1] + 64 * p[2]) as usize;
            v = [0, 1, 8, 9, 64, 65, 72, 73].map(|d| self.sharp[e + d]);
        } else {
            for (n, v) in v.iter_mut().enumerate() {
                let n = n as i32;
                *v = self.sharp
                    [self.held([p[0] + (n & 1), p[1] + (n >> 1 & 1), p[2] + (n >> 2)])?];
            }
        }
        let low = blend(blend(v[0], v[1], f[0]), blend(v[2], v[3], f[0]), f[1]);
        let high = blend(blend(v[4], v[5], f[0]), blend(v[6], v[7], f[0]), f[1]);
        Some(blend(low, high, f[2]))
    }

    /// Returns the fall on the weaker side of a crest, the largest over the 13 directions; 0 where
    /// it is none.
    fn crest_fall(&self, p: [i32; 3], here: i32) -> i32 {
        let mut most = 0;
        for n in 14..27 {
            let d = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
            let at =
                |k: i32| self.held(std::array::from_fn(|a| p[a] + k * d[a])).map(|e| self.value[e]);
            let (Some(a1), Some(b1)) = (at(1), at(-1)) else { continue };
            if a1 > here || b1 > here {
                continue;
            }
            let (Some(a2), Some(b2)) = (at(2), at(-2)) else { continue };
            most = most.max((here - a1.min(a2)).min(here - b1.min(b2)));
        }
        most
    }
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let is_rim = |slot: usize, q: [i32; 3], e: usize| {
        !bit(s.core, e)
            || (0..6).any(|n| {
                let mut at = q;
                at[n / 2] += if n % 2 == 0 { -1 } else { 1 };
                element(s.near, slot, at).is_none_or(|e| s.path[e] == 0)
            })
    };
    s.mark
        .par_chunks_exact_mut(BRICK)
        .zip(s.peak.par_chunks_exact_mut(BRICK))
        .zip(s.weight.par_chunks_exact_mut(BRICK))
        .enumerate()
        .with_min_len(4)
        .for_each(|(slot, ((mark, peak), weight))| {
            crate::task::checkpoint();
            mark.fill(0);
            peak.fill(0);
            weight.fill(0);
            let corner = [0, 1, 2].map(|a| s.corner[slot * 3 + a]);
            let (value, sharp) = (s.value, s.sharp);
            let view = BrickView { near: s.near, slot, corner, size: p.size, value, sharp };
            for local in 0..BRICK {
                let e = slot * BRICK + local;
                if s.path[e] == 0 {
                    continue;
                }
                let q = place(local);
                if !is_rim(slot, q, e) {
                    mark[local] = JOINED;
                    continue;
                }
                let here = s.value[e];
                let fall = view.crest_fall(q, here);
                let (ray_top, ray_weight, rise) = along_gradient(view, s.calm, q, here, &p);
                let is_thin = fall > p.crest && 2 * fall > here && 3 * fall >= p.rise * rise;
                let (top, w, flags);
                if is_thin && here > MIN_CREST {
                    let strong = if fall > p.strong { 4 } else { 0 };
                    let top_between = ((here + s.sharp[e]) / 2).clamp(0, WALL);
                    (top, w, flags) = (top_between, 64, RIM | CREST | JOINED | strong);
                } else {
                    (top, w, flags) = (ray_top, ray_weight, RIM | JOINED);
                }
                mark[local] = flags | (top as u32) << 8;
                peak[local] = top * w;
                weight[local] = w << 12;
            }
        });
}

/// Returns the first maximum along the gradient, the weight of this voxel, and the rise of the value
/// within two least spacings.
fn along_gradient(
    view: BrickView<'_>,
    calm: &[i32],
    q: [i32; 3],
    here: i32,
    p: &Params,
) -> (i32, i32, i32) {
    let g: [i32; 3] = std::array::from_fn(|axis| {
        let mut d = [0; 3];
        d[axis] = 1;
        let at = |k: i32| view.held(std::array::from_fn(|a| q[a] + k * d[a]));
        match (at(1), at(-1)) {
            (Some(a), Some(b)) => (calm[a] - calm[b]) * p.slope[axis],
            _ => 0,
        }
    });
    let excess = excess_bits(g);
    let g = g.map(|c| c >> excess);
    let length = length_of(g);
    let mut run = here;
    let mut rise = 0;
    if length > 0 {
        let step: [i32; 3] = std::array::from_fn(|a| g[a] * p.step[a] / length);
        let mut at = q.map(|c| c << 16);
        for n in 0..p.steps {
            at = std::array::from_fn(|a| at[a] + step[a]);
            let Some(v) = view.sample(at) else { break };
            run = run.max(v);
            if n < NEAR_STEPS {
                rise = run - here;
            }
            if run - v > p.fall {
                break;
            }
        }
    }
    let root = ((length * p.gain) >> (20 - excess)).clamp(5, 256);
    (run.clamp(0, WALL), ((root * root) >> 10).max(1), rise)
}

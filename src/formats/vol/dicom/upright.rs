//! Slices that lie askew or unevenly, sampled onto a box.
//!
//! Only positions are asked: no angle, sign or vendor's rule (the tilt tag is not made for it). With
//! the slice's own axes u, v and normal n, slice k lies at t_k = p_k·n and is shifted within its plane
//! by (p_k − p_0)·u and (p_k − p_0)·v. A sample of the box is linear within its two slices, then
//! linear between them.

use glam::DVec2;
use rayon::prelude::*;

/// Arrangement of slices in the box that is made of them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Upright {
    /// Columns and rows of a slice as stored.
    pub stored: [u32; 2],
    /// Shift of each slice within its plane, pixels, against the first.
    pub shifts_px: Vec<DVec2>,
    /// Place of each slice along the normal, mm, ascending.
    pub places_mm: Vec<f64>,
    /// Column and row of the box's first pixel, in those of the first slice.
    pub first: [i64; 2],
    /// Columns, rows and slices of the box.
    pub dims: [u32; 3],
    /// Distance between the slices of the box, mm.
    pub step_mm: f64,
}

impl Upright {
    /// The box that holds all slices.
    pub fn new(stored: [u32; 2], shifts_px: Vec<DVec2>, places_mm: Vec<f64>, step_mm: f64) -> Self {
        let low = shifts_px.iter().copied().fold(DVec2::INFINITY, DVec2::min).floor();
        let high = shifts_px.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max).ceil();
        let grown = |k: usize| u32::try_from((high[k] - low[k]) as i64).unwrap_or(u32::MAX);
        let run = places_mm.last().copied().unwrap_or(0.0) - places_mm[0];
        // A rounding's worth beyond the last slice does not add one.
        let slices = ((run / step_mm + 1e-6).floor() as u32).saturating_add(1);
        let dims = [stored[0].saturating_add(grown(0)), stored[1].saturating_add(grown(1)), slices];
        let first = [low.x as i64, low.y as i64];
        Self { stored, shifts_px, places_mm, first, dims, step_mm }
    }

    /// Samples of the box.
    ///
    /// * `values`: of the stored slices in their order, rows of columns.
    /// * `outside`: what is beyond every slice; samples beside `padding` are not mixed with it.
    pub fn sampled(&self, values: &[f32], outside: f32, padding: Option<f32>) -> Vec<f32> {
        let [columns, rows, slices] = self.dims.map(|d| d as usize);
        let mut out = vec![outside; columns * rows * slices];
        out.par_chunks_mut(columns * rows).enumerate().for_each(|(z, slice)| {
            crate::task::checkpoint();
            let place = self.places_mm[0] + z as f64 * self.step_mm;
            let last = self.places_mm.len() - 1;
            let k =
                self.places_mm.partition_point(|p| *p <= place + 1e-9).clamp(1, last.max(1)) - 1;
            let next = (k + 1).min(last);
            let gap = self.places_mm[next] - self.places_mm[k];
            let t =
                if gap > 0.0 { ((place - self.places_mm[k]) / gap).clamp(0.0, 1.0) } else { 0.0 };
            // A millionth of a step is a rounding.
            let t = if t < 1e-6 {
                0.0
            } else if t > 1.0 - 1e-6 {
                1.0
            } else {
                t
            } as f32;
            for y in 0..rows {
                for x in 0..columns {
                    let at = DVec2::new(
                        (x as i64 + self.first[0]) as f64,
                        (y as i64 + self.first[1]) as f64,
                    );
                    let value = |slice| self.within(values, slice, at, padding);
                    slice[y * columns + x] = match (value(k), value(next)) {
                        (a, _) if t == 0.0 => a.unwrap_or(outside),
                        (_, b) if t == 1.0 => b.unwrap_or(outside),
                        (Some(a), Some(b)) if Some(a) != padding && Some(b) != padding => {
                            a + (b - a) * t
                        }
                        (a, b) => if t < 0.5 { a } else { b }.or(a).or(b).unwrap_or(outside),
                    };
                }
            }
        });
        out
    }

    /// The value of a slice at a place of the first one's pixels; `None` beyond it.
    fn within(&self, values: &[f32], k: usize, at: DVec2, padding: Option<f32>) -> Option<f32> {
        let p = at - self.shifts_px[k];
        let [columns, rows] = self.stored.map(|d| d as usize);
        let last = DVec2::new((columns - 1) as f64, (rows - 1) as f64);
        if p.x < -0.5 || p.y < -0.5 || p.x > last.x + 0.5 || p.y > last.y + 0.5 {
            return None;
        }
        let p = p.clamp(DVec2::ZERO, last);
        let low = p.floor().min((last - 1.0).max(DVec2::ZERO));
        let (fx, fy) = ((p.x - low.x) as f32, (p.y - low.y) as f32);
        let (x, y) = (low.x as usize, low.y as usize);
        let get = |dx: usize, dy: usize| {
            let (x, y) = ((x + dx).min(columns - 1), (y + dy).min(rows - 1));
            values[k * columns * rows + y * columns + x]
        };
        let four = [get(0, 0), get(1, 0), get(0, 1), get(1, 1)];
        if padding.is_some_and(|p| four.contains(&p)) {
            let (dx, dy) = (usize::from(fx >= 0.5), usize::from(fy >= 0.5));
            return Some(four[dx + 2 * dy]);
        }
        // Whole pixels keep their values, whatever is beside them.
        let mix = |a: f32, b: f32, t: f32| if t == 0.0 { a } else { a + (b - a) * t };
        Some(mix(mix(four[0], four[1], fx), mix(four[2], four[3], fx), fy))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slices of a linear field, each shifted within its plane.
    fn linear(shifts: &[[f64; 2]], places: &[f64]) -> (Upright, Vec<f32>) {
        let shifts: Vec<DVec2> = shifts.iter().map(|s| DVec2::from(*s)).collect();
        let upright = Upright::new([9, 7], shifts.clone(), places.to_vec(), 1.5);
        let value = |k: usize, x: usize, y: usize| {
            let p = DVec2::new(x as f64, y as f64) + shifts[k];
            (3.0 * p.x - 2.0 * p.y + 5.0 * places[k]) as f32
        };
        let values = (0..places.len())
            .flat_map(|k| (0..7).flat_map(move |y| (0..9).map(move |x| (k, x, y))))
            .map(|(k, x, y)| value(k, x, y))
            .collect();
        (upright, values)
    }

    #[test]
    fn a_linear_field_on_askew_and_uneven_slices_comes_out_as_it_is() {
        let shifts = [[0.0, 0.0], [0.4, 0.6], [0.8, 1.2], [1.2, 1.8]];
        let (u, values) = linear(&shifts, &[10.0, 11.5, 14.0, 16.0]);
        assert_eq!((u.dims, u.first), ([11, 9, 5], [0, 0]));
        let out = u.sampled(&values, -999.0, None);
        let mut compared = 0;
        for z in 0..5 {
            for y in 2..7 {
                for x in 2..9 {
                    let wanted = 3.0 * x as f32 - 2.0 * y as f32 + 5.0 * (10.0 + 1.5 * z as f32);
                    let got = out[(z * 9 + y) * 11 + x];
                    assert!((got - wanted).abs() < 1e-3, "{x} {y} {z}: {got} {wanted}");
                    compared += 1;
                }
            }
        }
        assert_eq!(compared, 5 * 35);
        // Beyond the first slice there is nothing of it.
        assert_eq!(out[10], -999.0);
    }

    #[test]
    fn slices_that_are_a_box_already_stay_as_they_are() {
        let (u, values) = linear(&[[0.0; 2]; 3], &[0.0, 1.5, 3.0]);
        assert_eq!(u.dims, [9, 7, 3]);
        assert_eq!(u.sampled(&values, 0.0, None), values);
    }

    #[test]
    fn beside_padding_the_nearest_sample_is_taken() {
        let upright =
            Upright::new([4, 1], vec![DVec2::ZERO, DVec2::new(0.25, 0.0)], vec![0.0, 1.0], 1.0);
        let values = [-2000.0, 100.0, 200.0, 300.0, -2000.0, 100.0, 200.0, 300.0];
        let out = upright.sampled(&values, -2000.0, Some(-2000.0));
        // The second slice lies a quarter of a pixel to the right.
        assert_eq!(out[upright.dims[0] as usize..][..4], [-2000.0, 100.0, 175.0, 275.0]);
        assert!(out.iter().all(|v| *v == -2000.0 || (100.0..=300.0).contains(v)), "{out:?}");
    }
}

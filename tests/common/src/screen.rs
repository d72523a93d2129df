//! A drawn cut against the original, pixel by pixel, by casting rays at both.

use glam::DVec3;
use intima::geometry::Camera;
use rayon::prelude::*;

use super::cast::Cast;

/// What was found in one or many pictures.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Pixels that were cast.
    pub pixels: u64,
    /// Rays at the cut that met nothing.
    pub holes: u64,
    /// Drawn points with no point of the original within the bound on screen.
    pub away: u64,
    /// Points of the original with no point of the cut within the bound on screen.
    pub missed: u64,
    /// Depths outside those of the original in the surrounding pixels.
    pub depth: u64,
    /// Largest distance on screen, pixels, both ways.
    pub worst_px: f64,
    /// Some of the exceptions: column, row, what.
    pub listed: Vec<(u32, u32, &'static str)>,
}

impl Found {
    pub fn exceptions(&self) -> u64 {
        self.away + self.missed + self.depth + self.holes
    }

    /// Share of pixels inside the bound.
    pub fn inside(&self) -> f64 {
        1.0 - self.exceptions() as f64 / self.pixels.max(1) as f64
    }

    pub fn and(mut self, other: Self) -> Self {
        self.pixels += other.pixels;
        self.holes += other.holes;
        self.away += other.away;
        self.missed += other.missed;
        self.depth += other.depth;
        self.worst_px = self.worst_px.max(other.worst_px);
        self.listed.extend(other.listed);
        self.listed.truncate(20);
        self
    }
}

/// Casts every pixel. `tau` is the bound in pixels.
pub fn compare(original: &Cast, cut: &Cast, camera: &Camera, tau: f64) -> Found {
    let height = camera.height_px;
    let width = (f64::from(height) * f64::from(camera.lens.aspect)).round() as u32;
    let eye = camera.pose.position_mm.as_dvec3();
    let world = camera.pose.rotation.as_dquat().normalize();
    let t_y = (0.5 * f64::from(camera.lens.fov_y_rad)).tan();
    let focal = f64::from(height) / (2.0 * t_y);
    let along = |x: u32, y: u32| {
        let across = (f64::from(x) + 0.5 - 0.5 * f64::from(width)) / focal;
        let up = -(f64::from(y) + 0.5 - 0.5 * f64::from(height)) / focal;
        DVec3::new(across, up, -1.0)
    };
    let local = |p: DVec3| world.inverse() * (p - eye);
    let apart = |p: DVec3, q: DVec3| {
        let (p, q) = (local(p), local(q));
        (p.truncate() / p.z).distance(q.truncate() / q.z) * focal
    };
    let ids = || (0..width * height).into_par_iter().map(|i| (i % width, i / width));
    let reference: Vec<_> = ids().map(|(x, y)| original.ray(eye, world * along(x, y))).collect();
    let reach = tau.ceil() as i64 + 1;
    ids()
        .map(|(x, y)| {
            let mut found = Found { pixels: 1, ..Default::default() };
            let here = reference[(y * width + x) as usize];
            let drawn = cut.ray(eye, world * along(x, y));
            let note = |found: &mut Found, what| found.listed.push((x, y, what));
            if drawn.is_none() && here.is_some() {
                found.holes += 1;
                note(&mut found, "hole");
                return found;
            }
            // A little is lost to positions in f32.
            let slack = 1e-3;
            if let Some(d) = drawn
                && let Some((q, _)) = original.nearest(d.point)
            {
                let px = apart(d.point, q);
                found.worst_px = found.worst_px.max(px);
                if px > tau + slack {
                    found.away += 1;
                    note(&mut found, "away");
                    return found;
                }
            }
            if let Some(h) = here
                && let Some((q, _)) = cut.nearest(h.point)
            {
                let px = apart(h.point, q);
                found.worst_px = found.worst_px.max(px);
                if px > tau + slack {
                    found.missed += 1;
                    note(&mut found, "missed");
                    return found;
                }
            }
            if let Some(d) = drawn {
                let mut low = f64::INFINITY;
                let mut high: f64 = 0.0;
                for dy in -reach..=reach {
                    for dx in -reach..=reach {
                        let (i, j) = (i64::from(x) + dx, i64::from(y) + dy);
                        if i < 0 || j < 0 || i >= i64::from(width) || j >= i64::from(height) {
                            // Beyond the frame anything may lie.
                            (low, high) = (0.0, f64::INFINITY);
                        } else if let Some(h) = reference[(j * i64::from(width) + i) as usize] {
                            (low, high) = (low.min(h.t), high.max(h.t));
                        } else {
                            high = f64::INFINITY;
                        }
                    }
                }
                // An error of tau pixels at this depth, mm.
                let error = tau * d.t / focal;
                if d.t < low - error || d.t > high + error {
                    found.depth += 1;
                    note(&mut found, "depth");
                }
            }
            found
        })
        .reduce(Found::default, Found::and)
}

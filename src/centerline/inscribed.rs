//! Radius of the largest sphere inside a wall at each point of a centerline.
//!
//! A wall through voxels has bumps of a tenth of a voxel and more, and the distance of a point to it
//! is that to the nearest bump: in a tube of three voxels it is 0.12 mm less than the tube's radius.
//! So the wall about a point is measured by rays in the plane across the curve, and its bumps are
//! averaged: over the rays by the harmonics of a shifted ellipse, along the curve over a radius.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::frames::{CurveFrame, frames};
use super::recenter::arc_lengths;
use crate::geometry::{Branch, Centerline, TriangleBvh};

/// Rays about a station.
const RAYS: usize = 32;
/// Distance between stations, in distances to the wall; at least a voxel.
const APART: f64 = 0.25;
/// Half the length over which sections are averaged, in distances to the wall; at least in voxels.
const ALONG: (f64, f64) = (1.0, 2.0);
/// Length of a ray, in lower quartiles of all, beyond which it looks into a branch.
const FAR: f64 = 1.6;
/// Least offset of the curve from the middle of a section at which the section is measured from its
/// middle, in distances to the wall.
const OFF_MIDDLE: f64 = 0.3;
/// Greatest amount by which the radius exceeds the distance from the point, or from the middle of the
/// section, to the nearest triangle, voxels: what a bump of the wall takes away.
const BUMP: f64 = 0.4;

/// Shape of a section: its mean radius, and the second harmonic of the radius by direction, whose
/// length is what an ellipse is narrower than a circle by.
#[derive(Clone, Copy, Default)]
struct SectionShape {
    mean_mm: f64,
    oval: DVec2,
    /// Distance from the middle of the section to the nearest triangle.
    inscribed_mm: f64,
}

/// A place along a branch at which a section is measured.
struct Station {
    arc_mm: f64,
    distance_mm: f64,
    shape: Option<SectionShape>,
}

/// Sets the radius of every point: the radius of the largest sphere inside the wall, with the bumps of
/// the wall averaged. The radius is at least the distance to the nearest triangle.
///
/// * `tree`: triangles of a closed wall, LPS mm.
/// * `voxel_mm`: largest side of a voxel.
pub fn measure_radius(line: &mut Centerline, tree: &TriangleBvh, voxel_mm: f64) {
    line.branches.par_iter_mut().for_each(|branch| {
        crate::task::checkpoint();
        measure_branch(branch, tree, voxel_mm);
    });
}

fn measure_branch(branch: &mut Branch, tree: &TriangleBvh, voxel_mm: f64) {
    let places: Vec<DVec3> = branch.points.iter().map(|p| p.position_mm).collect();
    let distance_mm: Vec<f64> =
        places.par_iter().with_min_len(64).map(|p| tree.distance(*p, f64::INFINITY)).collect();
    let arc_mm = arc_lengths(&places);
    // Small turns of the curve are not turns of the lumen.
    let tangent = |i: usize| {
        let reach = (0.5 * distance_mm[i]).max(voxel_mm);
        let a = arc_mm.partition_point(|s| *s < arc_mm[i] - reach).min(i);
        let b = arc_mm.partition_point(|s| *s <= arc_mm[i] + reach).max(i + 1) - 1;
        (places[b] - places[a]).try_normalize().unwrap_or(DVec3::Z)
    };
    let tangents: Vec<DVec3> = (0..places.len()).map(tangent).collect();
    let frames = frames(&places, &tangents, DVec3::X);
    // 1. Sections at stations as far apart as the lumen is wide.
    let mut chosen: Vec<usize> = Vec::new();
    for i in 0..places.len() {
        let apart = (APART * distance_mm[i]).max(voxel_mm);
        if chosen.last().is_none_or(|last| arc_mm[i] - arc_mm[*last] >= apart) {
            chosen.push(i);
        }
    }
    let station = |i: &usize| Station {
        arc_mm: arc_mm[*i],
        distance_mm: distance_mm[*i],
        shape: section(tree, places[*i], &frames[*i], distance_mm[*i]),
    };
    let stations: Vec<Station> = chosen.par_iter().with_min_len(4).map(station).collect();
    // 2. Their means about each station, and the radius between stations.
    let smooth: Vec<Option<f64>> =
        (0..stations.len()).map(|i| averaged(&stations, i, voxel_mm)).collect();
    for (i, point) in branch.points.iter_mut().enumerate() {
        let after = stations.partition_point(|s| s.arc_mm <= arc_mm[i]).min(stations.len() - 1);
        let before = after.saturating_sub(usize::from(stations[after].arc_mm > arc_mm[i]));
        let span = stations[after].arc_mm - stations[before].arc_mm;
        let share = if span > 0.0 { (arc_mm[i] - stations[before].arc_mm) / span } else { 0.0 };
        let radius = match (smooth[before], smooth[after]) {
            (Some(a), Some(b)) => a + (b - a) * share,
            (a, b) => a.or(b).unwrap_or(distance_mm[i]),
        };
        let inscribed = [before, after].map(|k| stations[k].shape.map_or(0.0, |s| s.inscribed_mm));
        let most = inscribed.into_iter().fold(distance_mm[i], f64::max) + BUMP * voxel_mm;
        point.radius_mm = radius.min(most).max(distance_mm[i]);
    }
}

/// Radius of the largest circle in the mean of the sections about a station.
fn averaged(stations: &[Station], i: usize, voxel_mm: f64) -> Option<f64> {
    let own = &stations[i];
    let reach = (ALONG.0 * own.distance_mm).max(ALONG.1 * voxel_mm);
    // As far on either side: a taper does not count then.
    let (first, last) = (stations[0].arc_mm, stations[stations.len() - 1].arc_mm);
    let reach = reach.min(own.arc_mm - first).min(last - own.arc_mm).max(1e-9);
    let from = stations.partition_point(|s| s.arc_mm < own.arc_mm - reach);
    let (mut weights, mut mean, mut oval, mut squares) = (0.0, 0.0, DVec2::ZERO, 0.0);
    let mut count = 0.0;
    for s in stations[from..].iter().take_while(|s| s.arc_mm <= own.arc_mm + reach) {
        let Some(shape) = s.shape else { continue };
        let weight = 1.0 - 0.9 * (s.arc_mm - own.arc_mm).abs() / reach;
        count += 1.0;
        weights += weight;
        mean += weight * shape.mean_mm;
        oval += weight * shape.oval;
        squares += weight * shape.oval.length_squared();
    }
    if weights == 0.0 {
        return None;
    }
    // Noise makes a circle oval by what its mean scatters, of which half the sections are one sample.
    let oval = (oval / weights).length_squared();
    let scatter = (squares / weights - oval).max(0.0) * (2.0f64 / count).min(1.0);
    Some(mean / weights - (oval - scatter).max(0.0).sqrt())
}

/// Measures the section across a curve; `None` where most of it is open.
///
/// A curve in a thin lumen runs up to half a radius beside the middle, from where the far wall looks
/// like an opening; the section is then measured from its middle.
fn section(
    tree: &TriangleBvh,
    p: DVec3,
    frame: &CurveFrame,
    distance_mm: f64,
) -> Option<SectionShape> {
    let rays = SectionRays::cast(tree, p, frame, distance_mm);
    let middle = rays.roughly_middle();
    let is_middle = middle.length() < OFF_MIDDLE * distance_mm;
    let (p, rays) = match rays.can_see(tree, middle).filter(|_| !is_middle) {
        Some(at) => (at, SectionRays::cast(tree, at, frame, tree.distance(at, f64::INFINITY))),
        None => (p, rays),
    };
    let near = rays.near()?;
    // The middle of the section: the first harmonic of a shifted circle.
    let open_ways = || (0..RAYS).filter(|k| rays.is_open(*k)).map(ray_direction);
    let count = near.len() as f64;
    let mut middle = DVec2::ZERO;
    for _ in 0..3 {
        let (mut sum, mut mean) = (DVec2::ZERO, 0.0);
        for (way, range) in &near {
            let off = *way * *range - middle;
            mean += off.length();
            sum += off;
        }
        // What rays into a branch leave out of the sum is taken as round.
        let open: DVec2 = open_ways().sum();
        middle += (sum + open * (mean / count)) / RAYS as f64;
    }
    let (mut mean, mut oval) = (0.0, DVec2::ZERO);
    for (way, range) in &near {
        let off = *way * *range - middle;
        let angle = off.to_angle();
        mean += off.length();
        oval += DVec2::from_angle(2.0 * angle) * off.length();
    }
    let open: DVec2 = open_ways().map(|way| DVec2::from_angle(2.0 * way.to_angle())).sum();
    let oval = (oval + open * (mean / count)) * (2.0 / RAYS as f64);
    let inscribed_mm = tree.distance(p + rays.across(middle), f64::INFINITY);
    Some(SectionShape { mean_mm: mean / count, oval, inscribed_mm })
}

/// Directions of the rays in the plane across a curve.
fn ray_direction(k: usize) -> DVec2 {
    DVec2::from_angle(std::f64::consts::TAU * k as f64 / RAYS as f64)
}

/// Rays to the wall about a place, in the plane across a curve.
struct SectionRays {
    eye: DVec3,
    normal: DVec3,
    binormal: DVec3,
    ranges: [f64; RAYS],
    /// Length beyond which a ray looks into a branch.
    most: f64,
}

impl SectionRays {
    fn cast(tree: &TriangleBvh, p: DVec3, frame: &CurveFrame, distance_mm: f64) -> Self {
        // A ray begins at a place that single precision holds.
        let eye = p.as_vec3().as_dvec3();
        let (normal, binormal) = (frame.normal, frame.tangent.cross(frame.normal));
        let longest = 6.0 * distance_mm + 1.0;
        let ray = |k: usize| {
            let way = ray_direction(k);
            let along = (normal * way.x + binormal * way.y) * longest;
            tree.first_hit(eye, along).map_or(longest, |hit| hit.distance(eye))
        };
        let ranges: [f64; RAYS] = std::array::from_fn(ray);
        let mut sorted = ranges;
        sorted.sort_by(f64::total_cmp);
        Self { eye, normal, binormal, ranges, most: FAR * sorted[RAYS / 4] }
    }

    fn is_open(&self, k: usize) -> bool {
        self.ranges[k] > self.most
    }

    /// Directions and lengths of the rays that do not look into a branch; `None` where those are less
    /// than three quarters.
    fn near(&self) -> Option<Vec<(DVec2, f64)>> {
        let near = (0..RAYS).filter(|k| !self.is_open(*k));
        let near: Vec<(DVec2, f64)> = near.map(|k| (ray_direction(k), self.ranges[k])).collect();
        (4 * near.len() >= 3 * RAYS).then_some(near)
    }

    /// Middle of the section with rays into branches cut off at their median length.
    fn roughly_middle(&self) -> DVec2 {
        let mut sorted = self.ranges;
        sorted.sort_by(f64::total_cmp);
        let most = FAR * sorted[RAYS / 2];
        (0..RAYS).map(|k| ray_direction(k) * self.ranges[k].min(most)).sum::<DVec2>() / RAYS as f64
    }

    fn across(&self, at: DVec2) -> DVec3 {
        self.normal * at.x + self.binormal * at.y
    }

    /// The place in the plane, if the eye sees it.
    fn can_see(&self, tree: &TriangleBvh, at: DVec2) -> Option<DVec3> {
        let way = self.across(at);
        tree.first_hit(self.eye, way).is_none().then(|| self.eye + way)
    }
}

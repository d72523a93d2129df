//! Largest diameter of a lesion that stands out of the wall into the lumen.

use std::collections::HashMap;

use glam::{DQuat, DVec2, DVec3};

use super::cross_section::{OutlineSegment, pieces};
use crate::geometry::{Mesh, TriangleBvh};

/// Number of times that the top of the lesion is looked for.
const CENTRINGS: usize = 3;
/// Planes through the place, evenly turned about the normal of the wall.
const PLANES: usize = 36;
/// Farthest edge of a lesion from the place, mm along the wall.
const MAX_REACH_MM: f64 = 40.0;
/// Least inclination of a flank, and the inclination by which the wall has to level out behind the
/// flank, degrees.
const MIN_FLANK_DEG: f64 = 35.0;
const LEVELS_OUT_DEG: f64 = 25.0;
/// Share of the planes in which both edges have to be found.
const MIN_BOUNDED: f64 = 0.8;
/// Largest ratio of the diameters in two planes: a longer form is the ridge of a fold.
const MAX_ELONGATION: f64 = 3.0;
/// Length over which the inclination is taken, mm; a voxel where voxels are larger.
const MIN_BASE_MM: f64 = 1.0;

/// Diameter of a lesion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LesionDiameter {
    /// Its ends on the wall, LPS mm.
    pub ends_mm: [DVec3; 2],
    /// Share of the planes through the place in which both edges of the lesion were found.
    pub bounded: f64,
}

/// Diameters and edges of a lesion in the planes through a place.
struct Around {
    /// Ends of the largest diameter in each plane where both edges were found.
    diameters: Vec<[DVec3; 2]>,
    /// Edges of the lesion, once round the place; edges that were not found are left out.
    ring: Vec<DVec3>,
}

impl LesionDiameter {
    /// Returns the length of the diameter, mm.
    pub fn length_mm(&self) -> f64 {
        length(&self.ends_mm)
    }

    /// Finds the largest diameter of a lesion. `None` where the wall about the place has no edge: on a
    /// flat wall, and on a fold, whose ridge goes on.
    ///
    /// 1. In each of 36 planes through the place and the normal of the wall, the outline of the wall is
    ///    walked to both sides. The edge of the lesion is where the outline is steepest: where it turns
    ///    from convex to concave.
    /// 2. The same again, three times, from the top of the lesion, over the middle of the edges and along
    ///    the normal of the ring that they form: the first place may lie on a flank. The view in which
    ///    the diameters differ least counts.
    /// 3. The largest distance of two points of an outline between both edges is the diameter in that
    ///    plane, so that a head wider than its base counts. The largest of all planes is the result.
    ///
    /// The inclination is taken over a voxel, or a millimetre.
    ///
    /// * `wall`: faces look into the lumen, LPS mm; `tree` is its hierarchy.
    /// * `place_mm`: on the lesion, within its edges.
    /// * `voxel_mm`: mean size of a voxel.
    pub fn find(wall: &Mesh, tree: &TriangleBvh, place_mm: DVec3, voxel_mm: f64) -> Option<Self> {
        let base_mm = voxel_mm.max(MIN_BASE_MM);
        let place = tree.closest(place_mm)?.point;
        let normal = mean_normal(wall, tree, place, base_mm)?;
        let mut views = vec![Around::new(wall, tree, place, normal, base_mm)];
        let mut normal = normal;
        while views.len() <= CENTRINGS {
            let Some((top, up)) = views[views.len() - 1].top(tree, normal) else { break };
            views.push(Around::new(wall, tree, top, up, base_mm));
            normal = up;
        }
        // Seen from aside, or along a stalk, a lesion looks longer.
        let found = views.iter().filter_map(Around::largest);
        found.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(diameter, _)| diameter)
    }
}

fn length(ends: &[DVec3; 2]) -> f64 {
    ends[0].distance(ends[1])
}

impl Around {
    fn new(wall: &Mesh, tree: &TriangleBvh, place: DVec3, normal: DVec3, base_mm: f64) -> Self {
        let across = normal.any_orthonormal_vector();
        let mut diameters = Vec::new();
        let mut halves = [Vec::new(), Vec::new()];
        for k in 0..PLANES {
            let angle = std::f64::consts::PI * k as f64 / PLANES as f64;
            let along = DQuat::from_axis_angle(normal, angle) * across;
            let Some(outline) = LesionOutline::cut(wall, tree, place, [along, normal]) else {
                continue;
            };
            let world = |p: DVec2| place + along * p.x + normal * p.y;
            let (edges, between) = outline.lesion(base_mm);
            for (half, edge) in halves.iter_mut().zip(edges) {
                half.extend(edge.map(world));
            }
            let ends = between.and_then(|outline| farthest(&outline));
            diameters.extend(ends.map(|ends| ends.map(world)));
        }
        let ring = halves.concat();
        Self { diameters, ring }
    }

    /// The place of the wall over the middle of the edges, and the normal of their ring.
    fn top(&self, tree: &TriangleBvh, normal: DVec3) -> Option<(DVec3, DVec3)> {
        if self.ring.len() < PLANES / 2 {
            return None;
        }
        let middle = self.ring.iter().sum::<DVec3>() / self.ring.len() as f64;
        let around = self.ring.iter().zip(self.ring.iter().cycle().skip(1));
        let area: DVec3 = around.map(|(a, b)| (a - middle).cross(b - middle)).sum();
        let up = area.try_normalize()?;
        let up = if up.dot(normal) < 0.0 { -up } else { up };
        let top = tree.first_hit(middle, up * MAX_REACH_MM)?;
        Some((top, up))
    }

    /// The largest diameter, and its ratio to that of the plane with the least.
    fn largest(&self) -> Option<(LesionDiameter, f64)> {
        let bounded = self.diameters.len() as f64 / PLANES as f64;
        let lengths = || self.diameters.iter().map(length);
        let (least, most) = (lengths().reduce(f64::min)?, lengths().reduce(f64::max)?);
        if bounded < MIN_BOUNDED || most > MAX_ELONGATION * least {
            return None;
        }
        let ends_mm = *self.diameters.iter().find(|ends| length(ends) == most)?;
        Some((LesionDiameter { ends_mm, bounded }, most / least))
    }
}

/// The mean normal of the faces about a place, by their area.
fn mean_normal(wall: &Mesh, tree: &TriangleBvh, place: DVec3, reach: f64) -> Option<DVec3> {
    let mut sum = DVec3::ZERO;
    let mut open = vec![tree.root()];
    while let Some(part) = open.pop() {
        if part.count == 0 {
            continue;
        }
        let (lo, hi) = tree.bounds(part);
        let nearest = place.clamp(lo.as_dvec3(), hi.as_dvec3());
        if nearest.distance(place) > reach {
            continue;
        }
        if !part.is_leaf() {
            open.extend(part.children());
            continue;
        }
        for i in part.triangles() {
            sum += wall.face_cross(wall.faces[tree.face(i) as usize]).as_dvec3();
        }
    }
    sum.try_normalize()
}

/// Outline of the wall in a plane, from the place to both sides; x along the wall, y into the lumen.
struct LesionOutline {
    sides: [Vec<DVec2>; 2],
    /// Whether the outline goes round the lesion: the plane misses the stalk of a head.
    is_island: bool,
}

impl LesionOutline {
    /// * `axes`: along the wall, and into the lumen.
    fn cut(
        wall: &Mesh,
        tree: &TriangleBvh,
        place: DVec3,
        [along, normal]: [DVec3; 2],
    ) -> Option<Self> {
        let axes = [along.cross(normal), along, normal];
        let all = pieces(wall, tree, place, axes, MAX_REACH_MM);
        let first = (0..all.len()).min_by(|a, b| {
            all[*a].start.length_squared().total_cmp(&all[*b].start.length_squared())
        })?;
        let by_from: HashMap<_, _> = all.iter().enumerate().map(|(i, p)| (p.from, i)).collect();
        let by_to: HashMap<_, _> = all.iter().enumerate().map(|(i, p)| (p.to, i)).collect();
        // The next piece starts where one ends, so that a walk back is one of starts too.
        let forward = walk(&all, first, |p| by_from.get(&p.to).copied());
        let back = walk(&all, first, |p| by_to.get(&p.from).copied());
        let mut sides = [forward, back];
        // The side of the walk that goes along x comes first.
        let first_mm = |side: &[DVec2]| {
            side.iter().find(|p| p.distance(side[0]) > 0.5 * MIN_BASE_MM).map_or(0.0, |p| p.x)
        };
        if first_mm(&sides[0]) < first_mm(&sides[1]) {
            sides.swap(0, 1);
        }
        // Round a lesion the walk along x turns down, round a lumen up.
        let is_closed = sides[0].len() > 3 && sides[0].last() == sides[0].first();
        let pairs = sides[0].windows(2).map(|pair| pair[0].perp_dot(pair[1]));
        let is_island = is_closed && pairs.sum::<f64>() < 0.0;
        Some(Self { sides, is_island })
    }

    /// The edges on both sides, and the outline between them where both are found.
    fn lesion(&self, base_mm: f64) -> ([Option<DVec2>; 2], Option<Vec<DVec2>>) {
        let ends = [edge(&self.sides[0], 1.0, base_mm), edge(&self.sides[1], -1.0, base_mm)];
        if self.is_island && ends == [None, None] {
            let by_x = |a: &&DVec2, b: &&DVec2| a.x.total_cmp(&b.x);
            let round = &self.sides[0];
            let edges = [round.iter().max_by(by_x), round.iter().min_by(by_x)];
            return (edges.map(|p| p.copied()), Some(round.clone()));
        }
        let edges = [0, 1].map(|i: usize| ends[i].map(|end| self.sides[i][end]));
        let [Some(a), Some(b)] = ends else { return (edges, None) };
        (edges, Some([&self.sides[0][..=a], &self.sides[1][..=b]].concat()))
    }
}

/// The two points that are farthest from each other.
fn farthest(points: &[DVec2]) -> Option<[DVec2; 2]> {
    let pairs = points.iter().enumerate();
    let pairs = pairs.flat_map(|(i, a)| points[..i].iter().map(move |b| [*a, *b]));
    pairs.max_by(|a, b| a[0].distance_squared(a[1]).total_cmp(&b[0].distance_squared(b[1])))
}

/// Starts of the pieces from one on, as far as a lesion may reach.
fn walk(
    all: &[OutlineSegment],
    first: usize,
    next: impl Fn(&OutlineSegment) -> Option<usize>,
) -> Vec<DVec2> {
    let (mut points, mut length, mut at) = (vec![all[first].start], 0.0, first);
    while length < MAX_REACH_MM && points.len() <= all.len() {
        let Some(beside) = next(&all[at]) else { break };
        length += all[beside].start.distance(all[at].start);
        at = beside;
        points.push(all[at].start);
        if at == first {
            break;
        }
    }
    points
}

/// Index of the steepest point of a flank, behind which the wall levels out.
///
/// * `way`: 1 for a side that goes along x, −1 for the other.
fn edge(side: &[DVec2], way: f64, base_mm: f64) -> Option<usize> {
    let mut lengths = vec![0.0];
    for pair in side.windows(2) {
        lengths.push(lengths[lengths.len() - 1] + pair[0].distance(pair[1]));
    }
    let at = |length: f64| {
        let i = lengths.partition_point(|l| *l <= length).clamp(1, side.len().max(2) - 1);
        let part = (lengths[i] - lengths[i - 1]).max(1e-12);
        side[i - 1].lerp(side[i], ((length - lengths[i - 1]) / part).clamp(0.0, 1.0))
    };
    let (last, half) = (*lengths.last()?, 0.5 * base_mm);
    if side.len() < 2 {
        return None;
    }
    let (mut before, mut turn) = (0.0, 0.0);
    let mut steepest = (f64::NEG_INFINITY, 0.0);
    let mut length = half;
    while length + half <= last {
        let step = at(length + half) - at(length - half);
        // Downwards counts; beyond the vertical the angle goes on.
        let angle = (-step.y).atan2(way * step.x).to_degrees();
        turn += (angle - before + 180.0f64).rem_euclid(360.0) - 180.0;
        before = angle;
        if turn > steepest.0 {
            steepest = (turn, length);
        } else if steepest.0 >= MIN_FLANK_DEG && turn < steepest.0 - LEVELS_OUT_DEG {
            let end = lengths.partition_point(|l| *l < steepest.1);
            return Some(end.min(side.len() - 1));
        }
        length += 0.25 * base_mm;
    }
    None
}

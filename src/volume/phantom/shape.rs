//! The organs in a box of side one about the origin.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::helix::Helix;
use super::path::Path;
use super::tree::{Capsule, tree};
use super::{Kind, TruthBranch, colon, ellipse};

/// Distance between axis points, in sides of the box.
const STEP: f64 = 0.002;

#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// Ball swept along a path, and a sac: centre and radius.
    Swept {
        path: Path,
        radius: f64,
        sac: Option<(DVec3, f64)>,
    },
    /// Ellipse swept along a line; `wide` and `thin` are its semi-axes, the former along `across`.
    Ellipse {
        a: DVec3,
        b: DVec3,
        across: DVec3,
        wide: f64,
        thin: f64,
    },
    Helix {
        curve: Helix,
        radius: f64,
    },
    Torus {
        x: DVec3,
        y: DVec3,
        normal: DVec3,
        ring: f64,
        radius: f64,
    },
    Tree(Vec<Capsule>),
    Colon {
        path: Path,
    },
}

impl Shape {
    pub fn new(kind: Kind) -> Self {
        let swept = |corners: &[[f64; 3]], bend: f64, radius: f64| Self::Swept {
            path: Path::rounded(corners, bend),
            radius,
            sac: None,
        };
        match kind {
            Kind::Tube => swept(&[[-0.22, -0.15, -0.31], [0.2, 0.17, 0.32]], 0.1, 0.11),
            Kind::Bend => swept(
                &[
                    [-0.28, -0.32, -0.34],
                    [-0.26, 0.28, -0.12],
                    [0.26, -0.26, 0.12],
                    [0.3, 0.32, 0.34],
                ],
                0.17,
                0.075,
            ),
            Kind::Ellipse => {
                let (a, b) = (DVec3::new(-0.17, 0.2, -0.29), DVec3::new(0.19, -0.16, 0.3));
                let along = (b - a).normalize();
                let across = DVec3::new(0.6, 0.7, 0.1).reject_from(along).normalize();
                Self::Ellipse { a, b, across, wide: 0.15, thin: 0.1 }
            }
            Kind::Helix => Self::Helix {
                curve: Helix { radius: 0.28, turns: 2.5, height: 0.64 },
                radius: 0.06,
            },
            Kind::Torus => {
                let normal = DVec3::new(0.3, 0.2, 1.0).normalize();
                let x = DVec3::X.reject_from(normal).normalize();
                Self::Torus { x, y: normal.cross(x), normal, ring: 0.28, radius: 0.11 }
            }
            Kind::Y => Self::Tree(tree()),
            Kind::Colon => Self::Colon { path: Path::rounded(&colon::AXIS, colon::BEND) },
            Kind::Aneurysm => {
                let corner = [0.0, 0.12, 0.0];
                let path =
                    Path::rounded(&[[-0.36, -0.28, -0.12], corner, [0.36, -0.28, 0.12]], 0.2);
                let (radius, sac) = (0.06, 0.13);
                let top = path.at(path.foot(corner.into()).s);
                // The ball opens into the tube but leaves the tube's axis outside, so that the
                // largest ball about an axis point still is the tube's.
                let out = (DVec3::from(corner) - top).normalize();
                Self::Swept { radius, sac: Some((top + (sac + 0.3 * radius) * out, sac)), path }
            }
        }
    }

    /// Returns the implicit function at a point: negative inside.
    pub fn field(&self, p: DVec3) -> f64 {
        match self {
            Self::Swept { path, radius, sac } => {
                let tube = path.distance(p) - radius;
                sac.map_or(tube, |(c, r)| tube.min(p.distance(c) - r))
            }
            Self::Ellipse { a, b, across, wide, thin } => {
                let along = (*b - *a).normalize();
                let d = p - *a;
                let t = d.dot(along);
                let over = t - t.clamp(0.0, a.distance(*b));
                // An end is half of the ellipsoid that the ellipse makes turning about its wide
                // axis, so that thin axis and overshoot are one coordinate.
                let v = d.dot(along.cross(*across)).hypot(over);
                ellipse::distance(*wide, *thin, d.dot(*across).abs(), v)
            }
            Self::Helix { curve, radius } => curve.distance(p) - radius,
            Self::Torus { normal, ring, radius, .. } => {
                let h = p.dot(*normal);
                (p.reject_from_normalized(*normal).length() - ring).hypot(h) - radius
            }
            Self::Tree(segments) => {
                segments.iter().map(|s| s.distance(p)).fold(f64::INFINITY, f64::min)
            }
            Self::Colon { path } => {
                let foot = path.foot(p);
                foot.distance - colon::radius(path, foot.s, foot.a, foot.b, foot.distance)
            }
        }
    }

    /// Returns a lower and an upper bound of the field near the lumen, each with a slope of at most
    /// one: where the lower one is positive the point is outside, where the upper one is negative
    /// it is inside.
    pub fn bounds(&self, p: DVec3) -> (f64, f64) {
        match self {
            Self::Colon { path } => {
                let d = path.distance(p);
                (d - colon::MAX, d - colon::MIN)
            }
            _ => {
                let f = self.field(p);
                (f, f)
            }
        }
    }

    /// Returns the gradient of the field by central differences.
    pub fn gradient(&self, p: DVec3) -> DVec3 {
        let h = 1e-5;
        let slope = |e: DVec3| (self.field(p + h * e) - self.field(p - h * e)) / (2.0 * h);
        DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z))
    }

    pub fn volume(&self) -> Option<f64> {
        // A section swept square to a curve of smaller curvature has the volume of the straight
        // sweep; two round ends make a ball.
        let round = |length: f64, a: f64, b: f64| PI * a * b * (length + 4.0 / 3.0 * b);
        match self {
            Self::Swept { path, radius, sac: None } => Some(round(path.length, *radius, *radius)),
            Self::Helix { curve, radius } => Some(round(curve.length(), *radius, *radius)),
            Self::Ellipse { a, b, wide, thin, .. } => Some(round(a.distance(*b), *wide, *thin)),
            Self::Torus { ring, radius, .. } => Some(2.0 * PI * PI * ring * radius * radius),
            _ => None,
        }
    }

    /// Returns the axis in unit coordinates.
    pub fn axis(&self) -> Vec<TruthBranch> {
        let branch = |name, length: f64, at: &dyn Fn(f64) -> (DVec3, f64)| {
            let n = (length / STEP).ceil();
            let point = |i| {
                let (p, r) = at(f64::from(i) / n);
                [p.x, p.y, p.z, r]
            };
            TruthBranch {
                name,
                parent: None,
                closed: false,
                points: (0..=n as u32).map(point).collect(),
            }
        };
        match self {
            Self::Swept { path, radius, .. } => {
                vec![branch("tube", path.length, &|t| (path.at(t * path.length), *radius))]
            }
            Self::Ellipse { a, b, thin, .. } => {
                vec![branch("tube", a.distance(*b), &|t| (a.lerp(*b, t), *thin))]
            }
            Self::Helix { curve, radius } => {
                vec![branch("helix", curve.length(), &|t| (curve.at(t), *radius))]
            }
            Self::Torus { x, y, ring, radius, .. } => {
                let at = |t: f64| {
                    let (sin, cos) = (TAU * t).sin_cos();
                    (*ring * (cos * *x + sin * *y), *radius)
                };
                let mut ring = branch("ring", TAU * ring, &at);
                ring.closed = true;
                // Not merely near: a closed curve ends in the very point it began with.
                let last = ring.points.len() - 1;
                ring.points[last] = ring.points[0];
                vec![ring]
            }
            Self::Tree(segments) => {
                let one = |s: &Capsule| {
                    // Near a junction the wider neighbour gives the larger ball.
                    let at = |t: f64| (s.a.lerp(s.b, t), -self.field(s.a.lerp(s.b, t)));
                    TruthBranch { parent: s.parent, ..branch(s.name, s.a.distance(s.b), &at) }
                };
                segments.iter().map(one).collect()
            }
            Self::Colon { path } => vec![branch("colon", path.length, &|t| {
                (path.at(t * path.length), colon::inscribed(path, t * path.length))
            })],
        }
    }
}

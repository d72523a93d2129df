//! Space curves of lines joined by arcs, whose nearest point is known in closed form.

use glam::DVec3;

/// The nearest point of a curve to a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Foot {
    /// Distance to the curve.
    pub distance: f64,
    /// Arc length from the curve's start.
    pub s: f64,
    /// Components of the offset across the curve, in its rotation-minimising frame.
    pub a: f64,
    pub b: f64,
}

/// Straight line from `a`, or arc around `centre` from `centre + radius * x` towards `y`.
#[derive(Clone, Copy, Debug)]
enum Form {
    Line { a: DVec3, along: DVec3 },
    Arc { centre: DVec3, x: DVec3, y: DVec3, radius: f64 },
}

/// A piece of a path, `u` and `v` its frame at its start.
#[derive(Clone, Copy, Debug)]
struct PathArc {
    form: Form,
    length: f64,
    /// Arc length at the piece's start.
    s: f64,
    u: DVec3,
    v: DVec3,
    /// Centre and radius of a ball around the piece, so that a far piece costs one comparison.
    ball: (DVec3, f64),
}

/// A polyline whose corners are rounded by arcs of one radius: its curvature is bounded by
/// construction, so a section thinner than that radius cannot fold over itself.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pieces: Vec<PathArc>,
    pub length: f64,
}

impl Path {
    /// Rounds the corners of a polyline.
    ///
    /// # Panics
    /// If an arc does not fit between its neighbours; the corners are ours.
    pub fn rounded(corners: &[[f64; 3]], radius: f64) -> Self {
        let c: Vec<DVec3> = corners.iter().copied().map(DVec3::from).collect();
        let mut path = Self { pieces: Vec::new(), length: 0.0 };
        let mut from = c[0];
        let first = (c[1] - c[0]).normalize();
        let mut u = first.any_orthonormal_vector();
        for w in c.windows(3) {
            let (d, e) = ((w[1] - w[0]).normalize(), (w[2] - w[1]).normalize());
            let turn = d.angle_between(e);
            let cut = radius * (0.5 * turn).tan();
            let (start, end) = (w[1] - cut * d, w[1] + cut * e);
            assert!((start - from).dot(d) > 0.0 && (w[2] - end).dot(e) > 0.0, "arc does not fit");
            path.push_line(from, start, u);
            let y = d;
            let inward = (e - e.dot(d) * d).normalize();
            let centre = start + radius * inward;
            path.push(Form::Arc { centre, x: -inward, y, radius }, radius * turn, u, d);
            u = turned(u, (-inward).cross(y), turn);
            from = end;
        }
        path.push_line(from, c[c.len() - 1], u);
        path
    }

    fn push_line(&mut self, a: DVec3, b: DVec3, u: DVec3) {
        let along = (b - a).normalize();
        self.push(Form::Line { a, along }, a.distance(b), u, along);
    }

    fn push(&mut self, form: Form, length: f64, u: DVec3, tangent: DVec3) {
        let mut piece = PathArc {
            form,
            length,
            s: self.length,
            u,
            v: tangent.cross(u),
            ball: (DVec3::ZERO, 0.0),
        };
        piece.ball = (piece.at(0.5 * length), 0.5 * length);
        self.pieces.push(piece);
        self.length += length;
    }

    /// Returns the point at an arc length.
    pub fn at(&self, s: f64) -> DVec3 {
        let piece = self.piece(s);
        piece.at((s - piece.s).clamp(0.0, piece.length))
    }

    /// Returns the rotation-minimising frame at an arc length: two unit vectors across the curve.
    pub fn frame(&self, s: f64) -> (DVec3, DVec3) {
        let piece = self.piece(s);
        piece.frame((s - piece.s).clamp(0.0, piece.length))
    }

    fn piece(&self, s: f64) -> &PathArc {
        let k = self.pieces.partition_point(|p| p.s <= s).max(1) - 1;
        &self.pieces[k]
    }

    /// Returns the distance to the path.
    pub fn distance(&self, p: DVec3) -> f64 {
        self.nearest(p).0
    }

    /// Returns the nearest point of the path; of equally near ones that of the first piece.
    pub fn foot(&self, p: DVec3) -> Foot {
        let (distance, k, t) = self.nearest(p);
        let piece = &self.pieces[k];
        let (u, v) = piece.frame(t);
        let d = p - piece.at(t);
        Foot { distance, s: piece.s + t, a: d.dot(u), b: d.dot(v) }
    }

    fn nearest(&self, p: DVec3) -> (f64, usize, f64) {
        let mut best = (f64::INFINITY, 0, 0.0);
        for (k, piece) in self.pieces.iter().enumerate() {
            if p.distance(piece.ball.0) - piece.ball.1 >= best.0 {
                continue;
            }
            let t = piece.nearest(p);
            let d = p.distance(piece.at(t));
            if d < best.0 {
                best = (d, k, t);
            }
        }
        best
    }
}

impl PathArc {
    fn at(&self, t: f64) -> DVec3 {
        match self.form {
            Form::Line { a, along } => a + t * along,
            Form::Arc { centre, x, y, radius } => {
                let (sin, cos) = (t / radius).sin_cos();
                centre + radius * (cos * x + sin * y)
            }
        }
    }

    fn frame(&self, t: f64) -> (DVec3, DVec3) {
        match self.form {
            Form::Line { .. } => (self.u, self.v),
            Form::Arc { x, y, radius, .. } => {
                let axis = x.cross(y);
                (turned(self.u, axis, t / radius), turned(self.v, axis, t / radius))
            }
        }
    }

    /// Returns the arc length within the piece of the point nearest to `p`.
    fn nearest(&self, p: DVec3) -> f64 {
        match self.form {
            Form::Line { a, along } => (p - a).dot(along).clamp(0.0, self.length),
            Form::Arc { centre, x, y, radius } => {
                let d = p - centre;
                // Measured from the middle of the arc the angle is cut where it is farthest.
                let half = 0.5 * self.length / radius;
                let (sin, cos) = half.sin_cos();
                let (mx, my) = (cos * x + sin * y, cos * y - sin * x);
                let angle = d.dot(my).atan2(d.dot(mx)).clamp(-half, half);
                radius * (angle + half)
            }
        }
    }
}

/// Rotates `v` about a unit axis.
fn turned(v: DVec3, axis: DVec3, angle: f64) -> DVec3 {
    glam::DQuat::from_axis_angle(axis, angle) * v
}

//! Ray casting and nearest-point queries on a triangle soup, by a bounding volume hierarchy in f64:
//! an independent check of everything that is drawn or measured, with no code in common with the
//! crate.

use glam::DVec3;
use intima::geometry::Mesh;

const LEAF: usize = 4;

struct Node {
    low: DVec3,
    high: DVec3,
    /// Leaves: triangles `at..at + count`; inner nodes: children `at` and `at + 1`, count 0.
    at: usize,
    count: usize,
}

/// A triangle soup with its bounding volume hierarchy.
pub struct Cast {
    triangles: Vec<[DVec3; 3]>,
    nodes: Vec<Node>,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// In lengths of the direction.
    pub t: f64,
    pub point: DVec3,
}

impl Cast {
    pub fn new(mut triangles: Vec<[DVec3; 3]>) -> Self {
        let mut nodes = Vec::new();
        if !triangles.is_empty() {
            nodes.push(Node { low: DVec3::ZERO, high: DVec3::ZERO, at: 0, count: 0 });
            build(&mut triangles, 0, &mut nodes, 0);
        }
        Self { triangles, nodes }
    }

    pub fn of(mesh: &Mesh) -> Self {
        let at = |v: u32| mesh.positions[v as usize].as_dvec3();
        Self::new(mesh.faces.iter().map(|f| f.map(at)).collect())
    }

    /// The first triangle on a ray, from either side.
    pub fn ray(&self, from: DVec3, along: DVec3) -> Option<Hit> {
        let mut best = f64::INFINITY;
        let inverse = along.recip();
        let enter = |n: &Node| {
            let (a, b) = ((n.low - from) * inverse, (n.high - from) * inverse);
            let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
            // A ray along a face of a box gives NaN there, which min and max pass over.
            if near <= far && far >= 0.0 { near } else { f64::INFINITY }
        };
        let mut open = vec![0];
        while let Some(i) = open.pop() {
            let Some(n) = self.nodes.get(i) else { continue };
            if enter(n) >= best {
                continue;
            }
            if n.count == 0 {
                let (a, b) = (enter(&self.nodes[n.at]), enter(&self.nodes[n.at + 1]));
                let (first, second) = if a <= b { (n.at, n.at + 1) } else { (n.at + 1, n.at) };
                open.push(second);
                open.push(first);
            }
            for t in &self.triangles[n.at..n.at + n.count] {
                if let Some(t) = meet(t, from, along)
                    && t < best
                {
                    best = t;
                }
            }
        }
        best.is_finite().then(|| Hit { t: best, point: from + best * along })
    }

    /// The nearest point, and how far it is.
    pub fn nearest(&self, p: DVec3) -> Option<(DVec3, f64)> {
        let mut best: Option<(DVec3, f64)> = None;
        let far = |n: &Node| (n.low - p).max(p - n.high).max(DVec3::ZERO).length_squared();
        let mut open = vec![0];
        while let Some(i) = open.pop() {
            let Some(n) = self.nodes.get(i) else { continue };
            if best.is_some_and(|b| far(n) >= b.1) {
                continue;
            }
            if n.count == 0 {
                let (a, b) = (n.at, n.at + 1);
                let swap = far(&self.nodes[a]) > far(&self.nodes[b]);
                open.push(if swap { a } else { b });
                open.push(if swap { b } else { a });
            }
            for t in &self.triangles[n.at..n.at + n.count] {
                let q = on_triangle(t, p);
                let d = q.distance_squared(p);
                if best.is_none_or(|b| d < b.1) {
                    best = Some((q, d));
                }
            }
        }
        best.map(|(q, d)| (q, d.sqrt()))
    }
}

fn build(triangles: &mut [[DVec3; 3]], offset: usize, nodes: &mut Vec<Node>, me: usize) {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (mut c_low, mut c_high) = (low, high);
    for t in triangles.iter() {
        for p in t {
            (low, high) = (low.min(*p), high.max(*p));
        }
        let c = t[0] + t[1] + t[2];
        (c_low, c_high) = (c_low.min(c), c_high.max(c));
    }
    if triangles.len() <= LEAF {
        nodes[me] = Node { low, high, at: offset, count: triangles.len() };
        return;
    }
    let axis = (c_high - c_low).max_position();
    let key = |t: &[DVec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
    let half = triangles.len() / 2;
    triangles.select_nth_unstable_by(half, |a, b| key(a).total_cmp(&key(b)));
    let at = nodes.len();
    for _ in 0..2 {
        nodes.push(Node { low, high, at: 0, count: 0 });
    }
    nodes[me] = Node { low, high, at, count: 0 };
    let (a, b) = triangles.split_at_mut(half);
    build(a, offset, nodes, at);
    build(b, offset + half, nodes, at + 1);
}

/// Möller and Trumbore 1997; edges count as inside with a little to spare, so that no ray slips
/// between two triangles.
fn meet([a, b, c]: &[DVec3; 3], from: DVec3, along: DVec3) -> Option<f64> {
    let (e, f) = (b - a, c - a);
    let p = along.cross(f);
    let det = e.dot(p);
    if det == 0.0 {
        return None;
    }
    let s = from - a;
    let u = s.dot(p) / det;
    let q = s.cross(e);
    let v = along.dot(q) / det;
    let t = f.dot(q) / det;
    const SPARE: f64 = 1e-9;
    (u >= -SPARE && v >= -SPARE && u + v <= 1.0 + SPARE && t > 0.0).then_some(t)
}

/// Nearest point of a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
fn on_triangle([a, b, c]: &[DVec3; 3], p: DVec3) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let n = 1.0 / (va + vb + vc);
    a + ab * (vb * n) + ac * (vc * n)
}

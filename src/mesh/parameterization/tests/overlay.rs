//! The common refinement of original and base: every original face cut wherever a fan of a later
//! collapse cuts it. Uses none of the code that looks for a point in a fan.

use super::super::*;

/// A part of an original face that lies in one base face, affinely.
pub struct OverlayPart {
    /// Centre of the part on the base.
    pub base: MeshPoint,
    /// Centre of the part on the original.
    pub fine: MeshPoint,
    /// Signed area, the whole base face being 1.
    pub area: f64,
}

/// Weights in the triangle reached so far, and weights in the original face.
type Corner = ([f64; 3], [f64; 3]);

fn mix(a: [f64; 3], b: [f64; 3], x: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + x * (b[i] - a[i]))
}

/// The part of a convex polygon where weight `i` is not negative.
fn clip(polygon: &[Corner], i: usize) -> Vec<Corner> {
    let mut out = Vec::new();
    for (n, &p) in polygon.iter().enumerate() {
        let q = polygon[(n + 1) % polygon.len()];
        if p.0[i] >= 0.0 {
            out.push(p);
        }
        if (p.0[i] < 0.0) != (q.0[i] < 0.0) {
            let x = p.0[i] / (p.0[i] - q.0[i]);
            let mut cut = mix(p.0, q.0, x);
            cut[i] = 0.0;
            out.push((cut, mix(p.1, q.1, x)));
        }
    }
    out
}

fn area(polygon: &[Corner]) -> f64 {
    let cross = |n: usize| {
        let [a, b, c] = [0, n, n + 1].map(|i| polygon[i].0);
        (b[1] - a[1]) * (c[2] - a[2]) - (c[1] - a[1]) * (b[2] - a[2])
    };
    (1..polygon.len().saturating_sub(1)).map(cross).sum()
}

/// The pieces of an original face.
pub fn pieces(maps: &Parameterization, face: u32) -> Vec<OverlayPart> {
    let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut open = vec![(face, unit.map(|w| (w, w)).to_vec())];
    let mut done = Vec::new();
    while let Some((t, polygon)) = open.pop() {
        let triangle = maps.triangles[t as usize];
        if triangle.pre == NONE {
            let n = polygon.len() as f64;
            let mean = |pick: fn(&Corner) -> [f64; 3]| {
                [0, 1, 2].map(|i| polygon.iter().map(|c| pick(c)[i]).sum::<f64>() / n)
            };
            done.push(OverlayPart {
                base: MeshPoint { face: triangle.slot, weights: mean(|c| c.0) },
                fine: MeshPoint { face, weights: mean(|c| c.1) },
                area: area(&polygon),
            });
            continue;
        }
        let (record, ring) = maps.polygon(triangle.pre);
        let place = |v: u32| {
            let entry = ring.ring.iter().find(|e| e.vertex == v);
            entry.map_or([0.0; 2], |e| e.flat.map(f64::from))
        };
        let corners = triangle.vertices.map(place);
        let flat: Vec<[f64; 2]> = polygon
            .iter()
            .map(|(w, _)| [0, 1].map(|x| (0..3).map(|k| w[k] * corners[k][x]).sum()))
            .collect();
        for j in 0..ring.ring.len() as u32 - 2 {
            let next = record.first_post + j;
            // By vertex ids alone; no order of the fan is taken for granted.
            let [a, b, c] = maps.triangles[next as usize].vertices.map(place);
            let cross = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
                (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
            };
            let whole = cross(a, b, c);
            let weights = |p: [f64; 2]| [cross(p, b, c), cross(p, c, a), cross(p, a, b)];
            let mut part: Vec<Corner> = (flat.iter().zip(&polygon))
                .map(|(&p, (_, fine))| (weights(p).map(|w| w / whole), *fine))
                .collect();
            for i in 0..3 {
                part = clip(&part, i);
            }
            // Slivers of rounding along an edge.
            if area(&part).abs() > 1e-11 {
                open.push((next, part));
            }
        }
    }
    done
}

//! TriangleX8 faces of a star at once: what they deviate and how thin they are when the centre moves.

use std::array::from_fn;

use glam::Vec3;

/// cos² of the most that a face may turn, 75°.
const COS2_TURN: f32 = 0.066_987_3;
/// Square of the least fairness of a face, its area by [`fair`]: smallest angles of 0.1°. More
/// would keep the cheapest collapses on a plane, which go by way of needles, from being made.
const FAIR2_THIN: f32 = 9e-6;
/// How much of a face's area counts as the fair one by its sides in what it deviates; the rest is
/// its true area. Fair faces make fair normals of vertices; true areas alone lie nearer.
const FAIR_SHARE: f32 = 0.7;
/// How much more a face counts the more it deviates: twice as much at 1 − cos = 1/180, 6.0°.
const STEEP: f32 = 180.0;
/// Faces looked at side by side.
pub const LANES: usize = 8;

/// One number of each of eight faces.
pub type Lanes = [f32; LANES];

/// TriangleX8 vectors, component by component.
type Vectors = [Lanes; 3];

/// TriangleX8 faces of a star. Lengths are in units of the longest spoke, places from the centre.
#[derive(Clone, Copy, Default)]
pub struct TriangleX8 {
    /// The two corners beside the centre.
    a: Vectors,
    b: Vectors,
    /// Sum of their normals.
    normals: Vectors,
    /// Twice the area times the normal, and its squared length.
    cross: Vectors,
    cross2: Lanes,
    /// Squared length of the edge across.
    across2: Lanes,
    /// Square of [`fair`].
    fair2: Lanes,
}

impl TriangleX8 {
    /// Puts in one face: its corners beside the centre, and the sum of their normals.
    #[inline]
    pub fn set(&mut self, lane: usize, a: Vec3, b: Vec3, normals: Vec3) {
        for c in 0..3 {
            self.a[c][lane] = a[c];
            self.b[c][lane] = b[c];
            self.normals[c][lane] = normals[c];
        }
    }

    /// Fills in what follows from the corners.
    #[inline]
    pub fn measure(&mut self) {
        let across = from_fn(|c| minus(&self.b[c], &self.a[c]));
        self.cross = cross(&self.a, &self.b);
        self.cross2 = dot(&self.cross, &self.cross);
        self.across2 = dot(&across, &across);
        let fairest = fair(&dot(&self.a, &self.a), &dot(&self.b, &self.b), &self.across2);
        self.fair2 = from_fn(|l| fairest[l] * fairest[l]);
    }

    /// Adds what the faces that stay (1, others 0) deviate with the centre at `to`, whose normal
    /// is `normal`; says whether none turns or thins too much.
    #[inline]
    pub fn moved(&self, to: Vec3, normal: Vec3, stays: &Lanes, sum: &mut Lanes) -> bool {
        let a = from_fn(|c| minus(&self.a[c], &[to[c]; LANES]));
        let b = from_fn(|c| minus(&self.b[c], &[to[c]; LANES]));
        let mean = from_fn(|c| from_fn(|l| self.normals[c][l] + normal[c]));
        let new = cross(&a, &b);
        let (new2, along, facing) = (dot(&new, &new), dot(&self.cross, &new), dot(&new, &mean));
        let fairest = fair(&dot(&a, &a), &dot(&b, &b), &self.across2);
        let bad: [bool; LANES] = from_fn(|l| {
            let old2 = self.cross2[l];
            // A face without area has no direction to keep.
            let turns = (old2 > 0.0)
                & ((along[l] <= 0.0) | (along[l] * along[l] < COS2_TURN * old2 * new2[l]));
            let fair2 = fairest[l] * fairest[l];
            let thins = (new2[l] < FAIR2_THIN * fair2) & (new2[l] * self.fair2[l] <= old2 * fair2);
            (stays[l] > 0.0) & (turns | thins)
        });
        *sum = from_fn(|l| {
            let twice = new2[l].sqrt();
            let off = (twice - facing[l] * (1.0 / 3.0)).max(0.0);
            let size = FAIR_SHARE * fairest[l] + (1.0 - FAIR_SHARE) * twice;
            sum[l] + stays[l] * 0.5 * off * (size + STEEP * off)
        });
        !bad.contains(&true)
    }
}

#[inline]
fn minus(a: &Lanes, b: &Lanes) -> Lanes {
    from_fn(|l| a[l] - b[l])
}

#[inline]
fn cross(a: &Vectors, b: &Vectors) -> Vectors {
    from_fn(|c| {
        let (d, e) = ((c + 1) % 3, (c + 2) % 3);
        from_fn(|l| a[d][l] * b[e][l] - a[e][l] * b[d][l])
    })
}

#[inline]
fn dot(a: &Vectors, b: &Vectors) -> Lanes {
    from_fn(|l| a[0][l] * b[0][l] + a[1][l] * b[1][l] + a[2][l] * b[2][l])
}

/// Twice the area of the fair (equilateral) face whose squared sides have the sum of these three;
/// no face with that sum is larger.
#[inline]
fn fair(x: &Lanes, y: &Lanes, z: &Lanes) -> Lanes {
    const BY_SUM: f32 = 0.288_675_13; // 1/√12
    from_fn(|l| BY_SUM * (x[l] + y[l] + z[l]))
}

//! Eight faces of a star in SIMD lanes: how far they turn, thin, and deviate from given normals when
//! the centre moves.

use std::array::from_fn;

use glam::Vec3;

/// cos² of the largest angle that a face may turn by, 75°.
const COS2_TURN: f32 = 0.066_987_3;
/// Square of the least quality of a face, its area over [`equilateral`]: smallest angles of 0.1°. A
/// stricter limit forbids the cheapest collapses on a plane, which pass through needles.
const MIN_QUALITY2: f32 = 9e-6;
/// Share of [`equilateral`] in the size of a face by which its deviation is weighted; the rest is its
/// true area. More gives better shaped faces and vertex normals, less a nearer surface.
const EQUILATERAL_SHARE: f32 = 0.7;
/// Growth of a face's weight with its deviation: twice as much at 1 − cos = 1/180, 6.0°.
const STEEPNESS: f32 = 180.0;
/// Faces computed together.
pub const LANES: usize = 8;

/// One number for each of eight faces.
pub type Lanes = [f32; LANES];

/// Eight vectors, component by component.
type Vectors = [Lanes; 3];

/// Eight faces of a star. Lengths are in units of the longest spoke, positions relative to the centre.
#[derive(Clone, Copy, Default)]
pub struct TriangleX8 {
    /// The two corners other than the centre.
    a: Vectors,
    b: Vectors,
    /// Sum of their normals.
    normals: Vectors,
    /// Twice the area times the normal, and its squared length.
    cross: Vectors,
    cross2: Lanes,
    /// Squared length of the edge across.
    across2: Lanes,
    /// Square of [`equilateral`].
    equilateral2: Lanes,
}

impl TriangleX8 {
    /// Sets one face: its two corners other than the centre, and the sum of their normals.
    #[inline]
    pub fn set(&mut self, lane: usize, a: Vec3, b: Vec3, normals: Vec3) {
        for c in 0..3 {
            self.a[c][lane] = a[c];
            self.b[c][lane] = b[c];
            self.normals[c][lane] = normals[c];
        }
    }

    /// Computes areas and qualities from the corners.
    #[inline]
    pub fn measure(&mut self) {
        let across = from_fn(|c| minus(&self.b[c], &self.a[c]));
        self.cross = cross(&self.a, &self.b);
        self.cross2 = dot(&self.cross, &self.cross);
        self.across2 = dot(&across, &across);
        let equilateral_area =
            equilateral(&dot(&self.a, &self.a), &dot(&self.b, &self.b), &self.across2);
        self.equilateral2 = from_fn(|l| equilateral_area[l] * equilateral_area[l]);
    }

    /// Adds the deviation of the kept faces (`stays` 1, others 0) with the centre at `to` and of
    /// normal `normal`; returns whether none of them turns or thins too much.
    #[inline]
    pub fn moved(&self, to: Vec3, normal: Vec3, stays: &Lanes, sum: &mut Lanes) -> bool {
        let a = from_fn(|c| minus(&self.a[c], &[to[c]; LANES]));
        let b = from_fn(|c| minus(&self.b[c], &[to[c]; LANES]));
        let mean = from_fn(|c| from_fn(|l| self.normals[c][l] + normal[c]));
        let new = cross(&a, &b);
        let (new2, along, facing) = (dot(&new, &new), dot(&self.cross, &new), dot(&new, &mean));
        let equilateral_area = equilateral(&dot(&a, &a), &dot(&b, &b), &self.across2);
        let bad: [bool; LANES] = from_fn(|l| {
            let old2 = self.cross2[l];
            // A face without area has no direction to keep.
            let turns = (old2 > 0.0)
                & ((along[l] <= 0.0) | (along[l] * along[l] < COS2_TURN * old2 * new2[l]));
            let equilateral2 = equilateral_area[l] * equilateral_area[l];
            let thins = (new2[l] < MIN_QUALITY2 * equilateral2)
                & (new2[l] * self.equilateral2[l] <= old2 * equilateral2);
            (stays[l] > 0.0) & (turns | thins)
        });
        *sum = from_fn(|l| {
            let twice = new2[l].sqrt();
            let off = (twice - facing[l] * (1.0 / 3.0)).max(0.0);
            let size = EQUILATERAL_SHARE * equilateral_area[l] + (1.0 - EQUILATERAL_SHARE) * twice;
            sum[l] + stays[l] * 0.5 * off * (size + STEEPNESS * off)
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

/// Twice the area of the equilateral triangle whose squared sides have the sum of these three, the
/// largest of any triangle with that sum.
#[inline]
fn equilateral(x: &Lanes, y: &Lanes, z: &Lanes) -> Lanes {
    const BY_SUM: f32 = 0.288_675_13; // 1/√12
    from_fn(|l| BY_SUM * (x[l] + y[l] + z[l]))
}

//! A torso made by formula: lungs with trachea and bronchi, a colon in gas segments, stomach, small
//! bowel, spine, contrast-filled aorta, a table. Patient space is LPS, mm.

use glam::{DVec3, UVec3};
use intima::lumen::BitVolume;
use intima::volume::{Grid, Volume};

/// A tube along a polyline with a radius at each of its points.
pub struct Tube(pub Vec<(DVec3, f64)>);

impl Tube {
    fn new(points: &[([f64; 3], f64)]) -> Self {
        Self(points.iter().map(|(p, r)| (DVec3::from(*p), *r)).collect())
    }

    fn scaled(&self, factor: f64) -> Self {
        Self(self.0.iter().map(|(p, r)| (*p, factor * r)).collect())
    }

    /// Signed distance, negative inside: a union of cones with round ends.
    pub fn distance(&self, p: DVec3) -> f64 {
        let part = |w: &[(DVec3, f64)]| {
            let ((a, ra), (b, rb)) = (w[0], w[1]);
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, t)) - (ra + t * (rb - ra))
        };
        self.0.windows(2).map(part).fold(f64::INFINITY, f64::min)
    }
}

fn ellipsoid(p: DVec3, centre: [f64; 3], radii: [f64; 3]) -> f64 {
    let (c, r) = (DVec3::from(centre), DVec3::from(radii));
    (((p - c) / r).length() - 1.0) * r.min_element()
}

/// What a torso holds.
pub struct Torso {
    pub airway: Vec<Tube>,
    /// From rectum to caecum.
    pub colon: Vec<Tube>,
    pub aorta: Vec<Tube>,
    pub has_stomach: bool,
    pub noise_hu: f64,
}

impl Default for Torso {
    fn default() -> Self {
        let airway = vec![
            Tube::new(&[([0., -5., 222.], 9.), ([0., 5., 130.], 9.)]),
            Tube::new(&[([0., 5., 130.], 7.), ([45., 10., 90.], 5.5), ([75., 20., 60.], 4.)]),
            Tube::new(&[([0., 5., 130.], 7.), ([-40., 10., 95.], 5.5), ([-75., 15., 60.], 4.)]),
        ];
        let colon = vec![
            Tube::new(&[
                ([0., 50., -215.], 22.),
                ([10., 40., -170.], 20.),
                ([55., 0., -165.], 17.),
            ]),
            Tube::new(&[
                ([100., 0., -135.], 18.),
                ([115., 30., -80.], 20.),
                ([112., 25., -45.], 18.),
            ]),
            Tube::new(&[
                ([85., -45., -65.], 20.),
                ([0., -65., -80.], 22.),
                ([-75., -45., -68.], 22.),
            ]),
            Tube::new(&[([-110., 15., -80.], 24.), ([-110., 20., -140.], 30.)]),
        ];
        let aorta = vec![
            Tube::new(&[([10., 38., 120.], 11.), ([5., 32., -90.], 10.)]),
            Tube::new(&[([5., 32., -90.], 7.), ([40., 45., -140.], 6.)]),
            Tube::new(&[([5., 32., -90.], 7.), ([-35., 30., -160.], 6.)]),
        ];
        Self { airway, colon, aorta, has_stomach: true, noise_hu: 15.0 }
    }
}

impl Torso {
    const SPACING_MM: f64 = 2.5;

    pub fn grid() -> Grid {
        let dims = [160u32, 116, 180];
        let h = Self::SPACING_MM;
        let origin = -0.5 * h * (DVec3::from(dims.map(f64::from)) - 1.0);
        Grid::new(dims.map(u64::from), DVec3::splat(h), origin, glam::DMat3::IDENTITY).unwrap()
    }

    /// Voxels whose centre lies in one of some tubes.
    pub fn truth(tubes: &[Tube]) -> BitVolume {
        let grid = Self::grid();
        let mut out = BitVolume::new(grid.dims);
        for (v, p) in voxels(&grid) {
            if tubes.iter().any(|t| t.distance(p) < 0.0) {
                out.set(v.x, v.y, v.z);
            }
        }
        out
    }

    /// The scan, HU.
    pub fn scan(&self) -> Volume {
        let grid = Self::grid();
        let mut seed = 1u64;
        let mut random = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / (1u64 << 24) as f64
        };
        let mut noise = || (0..6).map(|_| random()).sum::<f64>() * 2f64.sqrt() - 3.0 * 2f64.sqrt();
        let mut out = Vec::with_capacity(grid.len());
        for (_, p) in voxels(&grid) {
            let hu = self.value(p) + self.noise_hu * noise();
            out.push(hu.round().clamp(-1024.0, 3071.0) as i16);
        }
        Volume::new(grid, out.into())
    }

    fn value(&self, p: DVec3) -> f64 {
        let mut hu = -1000.0;
        let mut put = |distance: f64, value: f64| {
            let share = (0.5 - distance / Self::SPACING_MM).clamp(0.0, 1.0);
            hu += share * (value - hu);
        };
        let of = |tubes: &[Tube]| tubes.iter().map(|t| t.distance(p)).fold(f64::INFINITY, f64::min);
        let torso = ((p.x / 165.0).powi(2) + (p.y / 105.0).powi(2)).sqrt();
        put((torso - 1.0) * 105.0, -90.0);
        put((torso - 0.9) * 105.0, 45.0);
        // A table, thin, below the patient's back.
        put((p.y - 118.0).abs() - 3.0, -200.0);
        let lungs = ellipsoid(p, [72., 5., 112.], [56., 75., 78.]).min(ellipsoid(
            p,
            [-70., 5., 115.],
            [58., 75., 100.],
        ));
        put(lungs, -860.0);
        // Walls are as thick as the airway is wide: thin ones let lung through.
        let walls: Vec<Tube> = self.airway.iter().map(|t| t.scaled(1.35)).collect();
        put(of(&walls), 20.0);
        put(of(&self.airway), -1000.0);
        let spine = DVec3::new(p.x, p.y - 75.0, 0.0).length() - 18.0;
        // Cancellous bone in a cortex.
        put(spine, 250.0 + 250.0 * (p.z / 9.0).sin() * (p.x / 5.0).cos());
        put((spine + 2.0).abs() - 2.0, 700.0);
        put(of(&self.aorta), 340.0);
        // Folds of the colon.
        put(of(&self.colon) + 2.5 * (p.x + p.y + p.z).mul_add(0.25, 0.0).sin().abs(), -1000.0);
        if self.has_stomach {
            put(ellipsoid(p, [50., -30., -2.], [36., 30., 25.]), -1000.0);
        }
        for i in 0..6 {
            let at = [
                -50. + 18. * f64::from(i),
                -20. + 9. * f64::from(i % 3),
                -110. - 4. * f64::from(i),
            ];
            put(ellipsoid(p, at, [9., 8., 8.]), -1000.0);
        }
        hu
    }
}

fn voxels(grid: &Grid) -> impl Iterator<Item = (UVec3, DVec3)> {
    let to_world = grid.world_from_voxel();
    let grid = *grid;
    (0..grid.len()).map(move |i| {
        let v = grid.voxel(i);
        (v, to_world.transform_point3(v.as_dvec3()))
    })
}

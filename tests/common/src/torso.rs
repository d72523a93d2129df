//! A torso made by formula: lungs with trachea and bronchi, oesophagus, heart, kidneys, liver, spine with
//! discs, canal and arches, ribs, pelvis, aorta and vena cava, colon in gas segments, stomach, small
//! bowel, a table. Patient space is LPS, mm. Sizes after textbook anatomy of an adult, rounded.

use glam::{DMat3, DVec2, DVec3, UVec3};
use intima::lumen::BitVolume;
use intima::volume::{Grid, Volume};
use rayon::prelude::*;

/// A tube along a polyline with a radius at each of its points.
pub struct Tube {
    points: Vec<(DVec3, f64)>,
    low: DVec3,
    high: DVec3,
}

impl Tube {
    fn new(points: &[([f64; 3], f64)]) -> Self {
        Self::through(points.iter().map(|(p, r)| (DVec3::from(*p), *r)).collect())
    }

    fn through(points: Vec<(DVec3, f64)>) -> Self {
        let low = points.iter().map(|(p, r)| *p - *r).fold(DVec3::INFINITY, DVec3::min);
        let high = points.iter().map(|(p, r)| *p + *r).fold(DVec3::NEG_INFINITY, DVec3::max);
        Self { points, low, high }
    }

    fn scaled(&self, factor: f64) -> Self {
        Self::through(self.points.iter().map(|(p, r)| (*p, factor * r)).collect())
    }

    /// Signed distance, negative inside: a union of cones with round ends. Far off it is that to the
    /// tube's box.
    pub fn distance(&self, p: DVec3) -> f64 {
        let off = (self.low - p).max(p - self.high).max(DVec3::ZERO).length();
        if off > 12.0 {
            return off;
        }
        let part = |w: &[(DVec3, f64)]| {
            let ((a, ra), (b, rb)) = (w[0], w[1]);
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a.lerp(b, t)) - (ra + t * (rb - ra))
        };
        self.points.windows(2).map(part).fold(f64::INFINITY, f64::min)
    }
}

fn ellipsoid(p: DVec3, centre: [f64; 3], radii: [f64; 3]) -> f64 {
    let (c, r) = (DVec3::from(centre), DVec3::from(radii));
    (((p - c) / r).length() - 1.0) * r.min_element()
}

/// A disease of the descending aorta, or its treatment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AortaDisease {
    /// A flap of 1.5 mm that turns about the middle, and the value of the false lumen, HU.
    Dissection { false_hu: f64 },
    /// Rings of wire in the wall, 1 mm thick, 8 mm apart, and their value, HU.
    Stent { wire_hu: f64 },
    /// A sac of this radius about the lumen below the diaphragm, filled with clot of 60 HU, mm.
    Clot { radius_mm: f64 },
}

/// What a torso holds, and how it was scanned.
pub struct Torso {
    pub airway: Vec<Tube>,
    /// From rectum to caecum.
    pub colon: Vec<Tube>,
    /// Empty without contrast medium.
    pub aorta: Vec<Tube>,
    pub disease: Option<AortaDisease>,
    pub has_stomach: bool,
    /// Height of the fluid in the stomach over its back, mm, and gas in the oesophagus.
    pub stomach_fluid_mm: f64,
    pub has_oesophagus: bool,
    pub blood_hu: f64,
    pub vein_hu: f64,
    pub marrow_hu: f64,
    pub cortex_hu: f64,
    pub noise_hu: f64,
    /// Whether gas rises to the back.
    pub is_prone: bool,
    /// Turn of the patient on the table, radians.
    pub roll: f64,
    /// Size beside the default's.
    pub scale: f64,
    pub grid: Grid,
    pub seed: u64,
}

impl Default for Torso {
    fn default() -> Self {
        Self {
            airway: airway(),
            colon: colon(),
            aorta: aorta(),
            disease: None,
            has_stomach: true,
            stomach_fluid_mm: 0.0,
            has_oesophagus: false,
            blood_hu: 340.0,
            vein_hu: 120.0,
            marrow_hu: 200.0,
            cortex_hu: 600.0,
            noise_hu: 15.0,
            is_prone: false,
            roll: 0.0,
            scale: 1.0,
            grid: whole([2.5; 3], 1.0),
            seed: 1,
        }
    }
}

fn airway() -> Vec<Tube> {
    vec![
        Tube::new(&[([0., -5., 222.], 9.), ([0., 0., 130.], 9.)]),
        Tube::new(&[([0., 0., 130.], 7.), ([45., 5., 90.], 5.5), ([75., 20., 60.], 4.)]),
        Tube::new(&[([0., 0., 130.], 7.), ([-40., 5., 95.], 5.5), ([-75., 15., 60.], 4.)]),
    ]
}

fn colon() -> Vec<Tube> {
    vec![
        Tube::new(&[([0., 32., -215.], 22.), ([10., 24., -170.], 20.), ([55., 0., -165.], 17.)]),
        Tube::new(&[([100., 0., -135.], 18.), ([115., 30., -80.], 20.), ([112., 25., -45.], 18.)]),
        Tube::new(&[([85., -45., -73.], 20.), ([0., -65., -92.], 22.), ([-75., -45., -78.], 22.)]),
        Tube::new(&[([-110., 15., -80.], 24.), ([-110., 20., -140.], 30.)]),
    ]
}

fn aorta() -> Vec<Tube> {
    vec![
        Tube::new(&[([22., 18., 120.], 11.), ([10., 12., -20.], 10.5), ([4., 10., -90.], 9.5)]),
        // The arch and the ascending aorta.
        Tube::new(&[
            ([22., 18., 120.], 11.),
            ([16., -10., 142.], 12.),
            ([-12., -32., 120.], 13.),
            ([-12., -35., 80.], 14.),
        ]),
        Tube::new(&[([4., 10., -90.], 7.), ([40., 20., -140.], 6.)]),
        Tube::new(&[([4., 10., -90.], 7.), ([-35., 18., -150.], 6.)]),
        // Coeliac trunk, superior mesenteric and renal arteries.
        Tube::new(&[([9., 5., -20.], 4.), ([8., -25., -28.], 3.5)]),
        Tube::new(&[([8., 4., -38.], 4.), ([6., -28., -60.], 3.5), ([0., -30., -110.], 3.)]),
        Tube::new(&[([10., 12., -48.], 3.5), ([42., 26., -52.], 3.)]),
        // The right one passes behind the vena cava.
        Tube::new(&[([2., 14., -48.], 3.5), ([-24., 26., -50.], 3.), ([-42., 28., -52.], 3.)]),
    ]
}

/// A grid that holds the whole torso.
fn whole(spacing_mm: [f64; 3], scale: f64) -> Grid {
    let h = DVec3::from(spacing_mm);
    let dims = (scale * DVec3::new(400.0, 290.0, 450.0) / h).round();
    let origin = -0.5 * h * (dims - 1.0);
    let dims = dims.as_uvec3().to_array().map(u64::from);
    Grid::new(dims, h, origin, DMat3::IDENTITY).unwrap()
}

/// A generator of numbers (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    fn is(&mut self, share: f64) -> bool {
        self.next() < share
    }
}

impl Torso {
    /// A torso of any size, contrast, thickness of slices, noise, position, crop and content.
    pub fn random(seed: u64) -> Self {
        let mut random = Random(seed.wrapping_mul(0x2545_f491_4f6c_dd1d));
        let scale = random.between(0.85, 1.15);
        let slice_mm = [0.7, 1.0, 1.5, 2.5, 3.0, 5.0, 8.0][(7.0 * random.next()) as usize];
        let pixel_mm = random.between(1.4, 2.4);
        let mut grid = whole([pixel_mm, pixel_mm, slice_mm], scale);
        // Cropped on one or two sides by up to a quarter, more along the patient.
        for _ in 0..2 {
            if random.is(0.4) {
                let axis = (3.0 * random.next()) as usize;
                let most = if axis == 2 { 0.5 } else { 0.25 };
                let cut = (random.between(0.05, most) * f64::from(grid.dims[axis])) as u32;
                if random.is(0.5) {
                    grid.origin_mm[axis] += f64::from(cut) * grid.spacing_mm[axis];
                }
                grid.dims[axis] -= cut;
            }
        }
        let has_contrast = random.is(0.8);
        let blood_hu = if has_contrast { random.between(120.0, 600.0) } else { 45.0 };
        let marrow_hu = random.between(100.0, blood_hu.clamp(160.0, 350.0));
        let mut colon = if random.is(0.75) { colon() } else { Vec::new() };
        while colon.len() > 1 && random.is(0.3) {
            colon.remove((random.next() * colon.len() as f64) as usize);
        }
        Self {
            airway: airway(),
            colon,
            aorta: if has_contrast { aorta() } else { Vec::new() },
            disease: None,
            has_stomach: random.is(0.6),
            stomach_fluid_mm: if random.is(0.6) { random.between(5.0, 35.0) } else { 0.0 },
            has_oesophagus: random.is(0.3),
            blood_hu,
            vein_hu: random.between(50.0, blood_hu.max(60.0)),
            marrow_hu,
            cortex_hu: marrow_hu + random.between(150.0, 450.0),
            noise_hu: random.between(10.0, 80.0) * random.next().sqrt().max(0.3),
            is_prone: random.is(0.3),
            roll: random.between(-20.0, 20.0f64).to_radians(),
            scale,
            grid,
            seed,
        }
    }

    /// Place in the torso of default size and position.
    pub fn own(&self, p: DVec3) -> DVec3 {
        DMat3::from_rotation_z(-self.roll) * p / self.scale
    }

    /// Voxels whose centre lies in one of some tubes.
    pub fn truth(&self, tubes: &[Tube]) -> BitVolume {
        let inside = self.each(|p| tubes.iter().any(|t| t.distance(p) < 0.0));
        let mut out = BitVolume::new(self.grid.dims);
        for i in (0..inside.len()).filter(|i| inside[*i]) {
            let v = self.grid.voxel(i);
            out.set(v.x, v.y, v.z);
        }
        out
    }

    /// Share of a mask that lies within tubes or so far beyond them, mm of the default torso.
    pub fn share_near(&self, mask: &BitVolume, tubes: &[Tube], mm: f64) -> f64 {
        let to_world = self.grid.world_from_voxel();
        let all: Vec<UVec3> = mask.voxels().collect();
        let is_near = |v: &&UVec3| {
            let p = self.own(to_world.transform_point3(v.as_dvec3()));
            tubes.iter().any(|t| t.distance(p) < mm)
        };
        all.par_iter().filter(is_near).count() as f64 / all.len().max(1) as f64
    }

    /// A value for each voxel, of its place in the torso of default size.
    fn each<T: Send>(&self, value: impl Fn(DVec3) -> T + Sync) -> Vec<T> {
        let to_world = self.grid.world_from_voxel();
        let at = |i: usize| self.own(to_world.transform_point3(self.grid.voxel(i).as_dvec3()));
        (0..self.grid.len()).into_par_iter().map(|i| value(at(i))).collect()
    }

    /// The scan, HU.
    pub fn scan(&self) -> Volume {
        let walls: Vec<Tube> = self.airway.iter().map(|t| t.scaled(1.35)).collect();
        let mut values = self.each(|p| self.value(p, &walls));
        let mut random = Random(self.seed);
        let mut noise =
            || (0..6).map(|_| random.next()).sum::<f64>() * 2f64.sqrt() - 3.0 * 2f64.sqrt();
        let stored = values
            .iter_mut()
            .map(|hu| (*hu + self.noise_hu * noise()).round().clamp(-1024.0, 3071.0) as i16);
        Volume::new(self.grid, stored.collect::<Vec<_>>().into())
    }

    /// Mean value of a voxel about a place: surfaces are as wide as it.
    fn value(&self, p: DVec3, walls: &[Tube]) -> f64 {
        let wide = self.grid.spacing_mm.element_product().cbrt() / self.scale;
        let mut hu = -1000.0;
        let mut put = |distance: f64, value: f64| {
            let share = (0.5 - distance / wide).clamp(0.0, 1.0);
            hu += share * (value - hu);
        };
        let of = |tubes: &[Tube]| tubes.iter().map(|t| t.distance(p)).fold(f64::INFINITY, f64::min);
        // A table, thin, below the patient.
        let below = if self.is_prone { -p.y } else { p.y };
        put((below - 118.0).abs() - 3.0, -200.0);
        let torso = ((p.x / 165.0).powi(2) + (p.y / 105.0).powi(2)).sqrt();
        if torso > 1.1 {
            return hu;
        }
        put((torso - 1.0) * 105.0, -90.0);
        put((torso - 0.9) * 105.0, 45.0);
        // Organs of the belly.
        put(ellipsoid(p, [-75., -5., -5.], [72., 70., 45.]), 45.0 + 0.25 * self.vein_hu);
        put(ellipsoid(p, [105., 35., -5.], [28., 30., 38.]), 45.0 + 0.3 * self.vein_hu);
        for x in [-62.0, 62.0] {
            let cortex = 45.0 + 0.45 * (self.blood_hu - 45.0).max(0.0);
            put(ellipsoid(p, [x, 36., -52.], [27., 25., 50.]), cortex);
        }
        let lungs = ellipsoid(p, [72., 5., 112.], [54., 75., 78.]).min(ellipsoid(
            p,
            [-70., 5., 115.],
            [56., 75., 100.],
        ));
        put(lungs, -860.0);
        put(of(walls), 20.0);
        put(of(&self.airway), -1000.0);
        // Heart: two ventricles with their walls.
        put(ellipsoid(p, [10., -38., 62.], [55., 40., 42.]), 90.0);
        put(ellipsoid(p, [34., -34., 52.], [26., 24., 26.]), self.blood_hu);
        put(ellipsoid(p, [-16., -46., 58.], [26., 22., 28.]), self.vein_hu);
        self.put_bones(p, torso, &mut put);
        let cava = [([-26., 12., -95.], 10.), ([-24., 10., -40.], 11.), ([-22., -5., 45.], 11.)];
        put(Tube::new(&cava).distance(p), self.vein_hu);
        self.put_aorta(p, &mut put);
        // Folds of the colon.
        put(of(&self.colon) + 2.5 * (0.25 * (p.x + p.y + p.z)).sin().abs(), -1000.0);
        if self.has_oesophagus {
            put((DVec2::new(p.x + 4.0, p.y - 21.0).length() - 4.0).max(-(p.z - 45.0)), -1000.0);
        }
        if self.has_stomach {
            self.put_stomach(p, &mut put);
        }
        for i in 0..6 {
            let at = [
                -50. + 18. * f64::from(i),
                -20. + 5. * f64::from(i % 3),
                -112. - 4. * f64::from(i),
            ];
            put(ellipsoid(p, at, [9., 8., 8.]), -1000.0);
        }
        hu
    }

    fn put_aorta(&self, p: DVec3, put: &mut impl FnMut(f64, f64)) {
        let lumen = self.aorta.iter().map(|t| t.distance(p)).fold(f64::INFINITY, f64::min);
        if let Some(AortaDisease::Clot { radius_mm }) = self.disease {
            put(ellipsoid(p, [12., 4., -52.], [radius_mm, radius_mm, 35.]), 60.0);
        }
        put(lumen, self.blood_hu);
        // Place in the section of the descending aorta.
        let Some(descending) =
            self.aorta.first().filter(|t| (-90.0..120.0).contains(&p.z) && t.distance(p) < 2.0)
        else {
            return;
        };
        let ends = descending.points.windows(2).find(|w| p.z <= w[0].0.z && p.z >= w[1].0.z);
        let Some(&[(upper, _), (lower, _)]) = ends else { return };
        let middle = upper.lerp(lower, (upper.z - p.z) / (upper.z - lower.z));
        match self.disease {
            Some(AortaDisease::Dissection { false_hu }) => {
                let side = (p - middle).truncate().dot(DVec2::from_angle(p.z / 60.0)) - 2.0;
                put(lumen.max(-side), false_hu);
                put(lumen.max(side.abs() - 0.75), 50.0);
            }
            Some(AortaDisease::Stent { wire_hu }) => {
                let along = (p.z + 2.0 * (4.0 * (p.y - middle.y).atan2(p.x - middle.x)).sin())
                    .rem_euclid(8.0);
                put(lumen.abs().max((along - 4.0).abs()) - 0.5, wire_hu);
            }
            _ => {}
        }
    }

    fn put_bones(&self, p: DVec3, torso: f64, put: &mut impl FnMut(f64, f64)) {
        // The sacrum leads backwards; vertebrae are larger in the belly.
        let middle = if p.z < -130.0 {
            45.0 + 0.35 * (-130.0 - p.z)
        } else {
            45.0 + 4.0 * (p.z / 60.0).sin()
        };
        let (side, front) = if p.z < 20.0 { (22.0, 16.0) } else { (17.0, 14.0) };
        let off = DVec2::new(p.x, p.y - middle);
        if off.length() < 70.0 {
            let step = p.z.rem_euclid(31.0);
            let is_disc = step < 7.0;
            let body = ((off / DVec2::new(side, front)).length() - 1.0) * front;
            let canal = (off - DVec2::new(0.0, front + 8.0)).length() - 7.5;
            if is_disc {
                put(body, 80.0);
            } else {
                put(body, self.cortex_hu);
                put(body + 2.0, self.marrow_hu);
                put(canal - 4.0, self.cortex_hu);
                let spinous = (off.x.abs() - 3.5).max((off.y - front - 30.0).abs() - 12.0);
                if step > 12.0 {
                    put(spinous, self.cortex_hu);
                }
                let transverse = (off.y - front - 8.0).hypot(step - 19.0) - 4.0;
                put(transverse.max(off.x.abs() - 32.0), self.cortex_hu);
                put(canal, 30.0);
            }
        }
        // Ribs slant downwards to the front; the sternum.
        let rib = (p.z + 0.35 * (p.y + 100.0)).rem_euclid(26.0);
        let is_chest = p.z > 0.0 && p.z < 200.0 && p.y > -70.0;
        if is_chest && rib < 9.0 {
            put(((torso - 0.83).abs() * 105.0 - 3.5).max((rib - 4.5).abs() - 4.5), self.cortex_hu);
        }
        if p.z > 40.0 && p.z < 190.0 {
            put((p.x.abs() - 16.0).max((p.y + 80.0).abs() - 5.0), self.marrow_hu + 60.0);
        }
        // Wings of the pelvis, shells of 6 mm.
        if p.z < -110.0 {
            let wing =
                ellipsoid(DVec3::new(p.x.abs(), p.y, p.z), [92., 45., -190.], [40., 28., 75.]);
            put(wing.abs() - 3.0, self.cortex_hu);
        }
    }

    /// A fundus under the left dome, and a body that crosses the middle to the antrum; gas over fluid.
    fn put_stomach(&self, p: DVec3, put: &mut impl FnMut(f64, f64)) {
        let fundus = ellipsoid(p, [60., 0., 2.], [34., 34., 26.]);
        let body = Tube::new(&[
            ([60., -10., -8.], 26.),
            ([45., -48., -28.], 22.),
            ([8., -60., -36.], 17.),
            ([-28., -50., -38.], 12.),
        ]);
        // Rugae.
        let shape = fundus.min(body.distance(p)) + 2.0 * (0.35 * (p.x - p.z)).sin().abs();
        let height = if self.is_prone { p.y + 70.0 } else { 34.0 - p.y };
        put(shape, -1000.0);
        if self.stomach_fluid_mm > 0.0 {
            put(shape.max(height - self.stomach_fluid_mm), 20.0);
        }
    }

    /// Whether a scan shows enough of the aorta for a flight: 80 mm of the descending part, along the
    /// patient, well inside the volume.
    pub fn shows_aorta(&self) -> bool {
        let steps =
            (-90..=120).map(|z| DVec3::new(4.0 + 0.085 * f64::from(z + 90), 14.0, f64::from(z)));
        !self.aorta.is_empty() && steps.filter(|p| self.holds(*p, 14.0)).count() >= 80
    }

    /// Whether a scan shows 45 mm of the trachea, and lung or carina.
    pub fn shows_airway(&self) -> bool {
        let steps = (130..=222).map(|z| DVec3::new(0.0, -2.0, f64::from(z)));
        let trachea = steps.filter(|p| self.holds(*p, 11.0)).count();
        trachea >= 45
    }

    /// Whether a scan shows a segment of the colon of 70 mm or more, and 60 ml of all.
    pub fn shows_colon(&self) -> bool {
        let samples: Vec<usize> = self.colon.iter().map(|tube| self.samples_of(tube)).collect();
        samples.iter().any(|mm| *mm >= 75)
    }

    /// Samples of a tube's middle line, a millimetre apart, in the scan.
    fn samples_of(&self, tube: &Tube) -> usize {
        let on = |w: &[(DVec3, f64)]| {
            let steps = w[0].0.distance(w[1].0).ceil() as usize;
            let at = |k: usize| w[0].0.lerp(w[1].0, k as f64 / steps as f64);
            (0..steps).filter(|k| self.holds(at(*k), 5.0)).count()
        };
        tube.points.windows(2).map(on).sum()
    }

    /// Whether the scan holds a place of the default torso with so many mm about it.
    fn holds(&self, p: DVec3, margin_mm: f64) -> bool {
        let world = DMat3::from_rotation_z(self.roll) * (p * self.scale);
        let voxel = self.grid.voxel_from_world().transform_point3(world);
        let margin = margin_mm * self.scale / self.grid.spacing_mm;
        let last = (self.grid.dims - UVec3::ONE).as_dvec3();
        voxel.cmpge(margin).all() && voxel.cmple(last - margin).all()
    }
}

//! A ray from the wall outwards. Twin of `shaders/draw/behind.wgsl`.

use glam::{DVec3, IVec3, Vec3};

use super::opacity::OpacityTable;
use super::tissue::{ABSENT, TILE_SIDE, TissueField, unpacked};

/// Part of the tissue that rays look at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Depth at which it begins, voxel sides along the normal of the wall.
    pub skin_vox: f32,
    /// Depth at which it ends, mm.
    pub depth_mm: f32,
}

/// What a ray sees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Light from the tissue, linear, before the light on the wall is applied.
    pub colour: [f32; 3],
    /// Share of light from farther away that comes through.
    pub through: f32,
    /// Largest value in the band; `None` if the ray never came into the band.
    pub largest: Option<f32>,
    /// Normal of the wall where the ray begins, as gradient of the distance: out of the lumen, world.
    pub normal: Vec3,
    /// Place of the next wall, with its normal, if the ray comes out into the lumen.
    pub next_wall: Option<(DVec3, Vec3)>,
}

/// Steps to where the band begins.
const SKIN_STEPS: u32 = 32;
/// Samples in the band.
const BAND_STEPS: u32 = 64;
/// Steps through the lumen behind a fold.
const LUMEN_STEPS: u32 = 48;
/// Share of light below which nothing behind shows.
const MIN_THROUGH: f32 = 0.015;
/// Share of the skin's depth below which a piece takes no light; at the skin's depth it takes all.
const SKIN_SHARE: f32 = 0.7;
/// Length of a ray within the band, in depths of the band.
const MAX_BANDS: f32 = 3.0;

/// Value, and distance from the wall.
struct RaySample {
    value: f32,
    offset_mm: f32,
}

/// Looks along a ray.
///
/// * `from`: place where the ray meets the wall, LPS mm.
/// * `way`: unit vector, away from the eye.
/// * `table`: its steps are those of the ray.
pub(super) fn cast(
    tissue: &TissueField,
    table: &OpacityTable,
    band: &Band,
    from: DVec3,
    way: Vec3,
) -> Seen {
    let start = tissue.voxel_from_world.transform_point3(from).as_vec3();
    let per_mm = (tissue.voxel_from_world.matrix3 * way.as_dvec3()).as_vec3();
    let ray = Ray { tissue, start, per_mm };
    let least = tissue.least_step_mm();

    // 1. Normal of the wall, and where the band begins.
    let first = ray.at(0.0);
    let slopes = ray.slopes(0.0);
    let normal = ray.normal(slopes);
    let skin_mm = band.skin_vox * slopes.length();
    let (mut t, mut now) = (0.0, first);
    let (mut step, mut before_mm) = (0.0, now.offset_mm);
    for _ in 0..SKIN_STEPS {
        if now.offset_mm >= skin_mm || now.offset_mm < -least {
            break;
        }
        // Not past a wall on the other side.
        let farthest = now.offset_mm.max(0.0) + least;
        (step, before_mm) = ((skin_mm - now.offset_mm).clamp(least, farthest), now.offset_mm);
        t += step;
        now = ray.at(t);
    }
    // Back to where the distance is that of the skin, exactly: the first piece begins there.
    if now.offset_mm > skin_mm && before_mm < skin_mm {
        t -= step * (now.offset_mm - skin_mm) / (now.offset_mm - before_mm);
        now = ray.at(t);
    }

    // 2. Through the band.
    let mut seen = Seen { through: 1.0, normal, ..Seen::default() };
    let end = t + MAX_BANDS * band.depth_mm;
    let mut is_out = now.offset_mm < -least;
    for _ in 0..BAND_STEPS {
        if is_out || seen.through < MIN_THROUGH || t >= end {
            break;
        }
        // Before another wall, small steps: where a ray enters the lumen shows.
        let is_skin = now.offset_mm < SKIN_SHARE * skin_mm;
        let step = if is_skin { now.offset_mm.clamp(least, table.step_mm) } else { table.step_mm };
        let next = ray.at(t + step);
        if !is_skin {
            let [r, g, b, taken] = table.entry(now.value, next.value);
            // Parts of the piece: before the end of the ray and of the band, and out of the skin.
            let before_end = ((end - t) / step).min(1.0);
            let is_last = next.offset_mm > band.depth_mm;
            let rise = next.offset_mm - now.offset_mm;
            let in_band = match is_last {
                true => ((band.depth_mm - now.offset_mm) / rise).clamp(0.0, 1.0),
                false => 1.0,
            };
            let share = before_end * in_band * out_of_skin(now.offset_mm, skin_mm);
            seen.largest = Some(seen.largest.map_or(now.value, |most| most.max(now.value)));
            let weight = seen.through * share;
            for (sum, light) in seen.colour.iter_mut().zip([r, g, b]) {
                *sum += weight * light;
            }
            seen.through *= 1.0 - share * taken;
            if is_last {
                return seen;
            }
        }
        t += step;
        now = next;
        is_out = now.offset_mm < 0.0;
    }
    if !is_out || seen.through < MIN_THROUGH {
        return seen;
    }

    // 3. Through the lumen behind a fold, to the next wall.
    for _ in 0..LUMEN_STEPS {
        let step = (-0.9 * now.offset_mm).max(least);
        t += step;
        let next = ray.at(t);
        if next.offset_mm >= 0.0 {
            t -= step * next.offset_mm / (next.offset_mm - now.offset_mm);
            let place = from + f64::from(t) * way.as_dvec3();
            seen.next_wall = Some((place, ray.normal(ray.slopes(t))));
            break;
        }
        now = next;
    }
    seen
}

/// Share of light that a piece takes before another wall, by its distance from that wall.
fn out_of_skin(offset_mm: f32, skin_mm: f32) -> f32 {
    let share = offset_mm / skin_mm.max(f32::MIN_POSITIVE);
    ((share - SKIN_SHARE) * (1.0 / (1.0 - SKIN_SHARE))).clamp(0.0, 1.0)
}

/// Corners of a tetrahedron, voxels.
const CORNERS: [Vec3; 4] = [
    Vec3::new(1.0, -1.0, -1.0),
    Vec3::new(-1.0, -1.0, 1.0),
    Vec3::new(-1.0, 1.0, -1.0),
    Vec3::new(1.0, 1.0, 1.0),
];

struct Ray<'a> {
    tissue: &'a TissueField,
    start: Vec3,
    /// Voxels by mm.
    per_mm: Vec3,
}

impl Ray<'_> {
    fn at(&self, t: f32) -> RaySample {
        self.at_voxel(self.start + t * self.per_mm)
    }

    fn at_voxel(&self, p: Vec3) -> RaySample {
        let cell = p.floor();
        let share = p - cell;
        let cell = cell.as_ivec3();
        let bricks = &self.tissue.bricks;
        let slot = bricks.word(cell >> 3i32);
        if ABSENT.contains(&slot) {
            let reach = self.tissue.reach_mm();
            let offset_mm = if slot == ABSENT[0] { reach } else { -reach };
            return RaySample { value: super::VALUES[0], offset_mm };
        }
        let tile = TILE_SIDE * TILE_SIDE * TILE_SIDE;
        let local: IVec3 = cell & 7;
        let side = TILE_SIDE as i32;
        let first = slot as usize * tile + (local.x + side * (local.y + side * local.z)) as usize;
        let corner = |k: usize| {
            let at = first + (k & 1) + TILE_SIDE * ((k >> 1 & 1) + TILE_SIDE * (k >> 2));
            let (value, offset) = unpacked(self.tissue.words[at]);
            glam::Vec2::new(value, offset)
        };
        let c: [glam::Vec2; 8] = std::array::from_fn(corner);
        let mixed = |a: glam::Vec2, b: glam::Vec2, t: f32| a + (b - a) * t;
        let x: [glam::Vec2; 4] = std::array::from_fn(|i| mixed(c[2 * i], c[2 * i + 1], share.x));
        let y = [mixed(x[0], x[1], share.y), mixed(x[2], x[3], share.y)];
        let all = mixed(y[0], y[1], share.z);
        RaySample { value: all.x, offset_mm: all.y }
    }

    /// Slopes of the distance along the axes of the grid, mm a voxel, from the corners of a tetrahedron:
    /// those of a cell alone jump from cell to cell.
    fn slopes(&self, t: f32) -> Vec3 {
        let p = self.start + t * self.per_mm;
        CORNERS.iter().map(|corner| *corner * self.at_voxel(p + *corner).offset_mm).sum::<Vec3>()
            * 0.25
    }

    /// Unit normal in the world of slopes along the axes of the grid.
    fn normal(&self, slopes: Vec3) -> Vec3 {
        let to_world = self.tissue.voxel_from_world.matrix3.transpose();
        (to_world * slopes.as_dvec3()).as_vec3().normalize_or_zero()
    }
}

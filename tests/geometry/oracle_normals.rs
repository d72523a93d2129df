//! Multiscale normals on shapes that the method was not tuned on, beside smoothing steps and the
//! gradient of the mask after a Gaussian, all against analytic normals.

use glam::{DMat3, DQuat, DVec3, EulerRot, UVec3, Vec3};
use intima::compute::{Plan, run_cpu};
use intima::lumen::{BitVolume, Lumen};
use intima::surface::{
    Fairing, Midpoint, MultiscaleNormals, Surface, VoxelFrame, Weights, face_normals, fair,
    multiscale_normals, weights,
};
use intima::volume::Grid;

/// A shape about the origin, mm.
#[derive(Clone, Copy)]
enum Shape {
    /// Semi-axes.
    Ellipsoid(DVec3),
    /// x²/a² + y²/b² − z²/c² = 1 with a, b, c: a saddle everywhere. Cut off at |z| = the last number.
    Hyperboloid(DVec3, f64),
    /// The hull of two spheres of these radii, this far apart along z: a cone with a rounded tip, or
    /// a capsule.
    RoundCone([f64; 2], f64),
}

impl Shape {
    /// Negative inside; 0 on the surface.
    fn value(&self, p: DVec3) -> f64 {
        match *self {
            Self::Ellipsoid(axes) => (p / axes).length_squared() - 1.0,
            Self::Hyperboloid(axes, end) => {
                let q = p / axes;
                let side = q.truncate().length_squared() - q.z * q.z - 1.0;
                side.max(p.z.abs() - end)
            }
            Self::RoundCone([low, high], apart) => {
                let (slope, side) = Self::cone([low, high], apart);
                let (r, z) = (p.truncate().length(), p.z + 0.5 * apart);
                match side * z - slope * r {
                    k if k < 0.0 => r.hypot(z) - low,
                    k if k > side * apart => r.hypot(z - apart) - high,
                    _ => r * side + z * slope - low,
                }
            }
        }
    }

    /// Outward normal of the surface at the foot of `p`, not of unit length.
    fn normal(&self, p: DVec3) -> DVec3 {
        let gradient = |p: DVec3| match *self {
            Self::Ellipsoid(axes) => 2.0 * p / (axes * axes),
            Self::Hyperboloid(axes, _) => 2.0 * p / (axes * axes) * DVec3::new(1.0, 1.0, -1.0),
            Self::RoundCone(radii, apart) => {
                let (slope, side) = Self::cone(radii, apart);
                let (r, z) = (p.truncate().length(), p.z + 0.5 * apart);
                match side * z - slope * r {
                    k if k < 0.0 => p.with_z(z),
                    k if k > side * apart => p.with_z(z - apart),
                    _ => (p.with_z(0.0) / r) * side + slope * DVec3::Z,
                }
            }
        };
        // The gradient does not depend on how far a point is from a hull of spheres.
        if matches!(self, Self::RoundCone(..)) {
            return gradient(p);
        }
        let mut foot = p;
        for _ in 0..4 {
            let g = gradient(foot);
            foot -= g * (self.value(foot) / g.length_squared());
        }
        gradient(foot)
    }

    /// Sine and cosine of the half-angle of the cone's side: the normal along and across the axis.
    fn cone([low, high]: [f64; 2], apart: f64) -> (f64, f64) {
        let slope = (low - high) / apart;
        (slope, (1.0 - slope * slope).sqrt())
    }

    /// Whether the normal at a place is that of the shape and not of its cut.
    fn scored(&self, p: DVec3) -> bool {
        match self {
            Self::Hyperboloid(_, end) => p.z.abs() < 0.5 * end,
            _ => true,
        }
    }

    /// Radius of a ball that holds it.
    fn reach(&self) -> f64 {
        match self {
            Self::Ellipsoid(axes) => axes.max_element(),
            Self::Hyperboloid(axes, end) => {
                (axes.truncate().max_element() * (1.0 + (end / axes.z).powi(2)).sqrt()).hypot(*end)
            }
            Self::RoundCone([low, high], apart) => 0.5 * apart + low.max(*high),
        }
    }
}

/// A shape turned and shifted off the grid, as a mask.
struct Case {
    shape: Shape,
    turn: DMat3,
    centre: DVec3,
    spacing: DVec3,
    lumen: Lumen,
    surface: Surface,
}

impl Case {
    fn new(shape: Shape, spacing: [f64; 3]) -> Self {
        let turn = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.45, -0.71, 1.13));
        let h = DVec3::from(spacing);
        let centre = ((shape.reach() / h).ceil() + 3.0 + DVec3::new(0.3, 0.2, 0.1)) * h;
        let dims = (2.0 * centre / h).ceil().as_uvec3() + UVec3::ONE;
        let grid = Grid::axis_aligned(dims.to_array(), spacing);
        let mut bits = BitVolume::new(dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)) {
            if shape.value(turn.transpose() * (v.as_dvec3() * h - centre)) <= 0.0 {
                bits.set(v.x, v.y, v.z);
            }
        }
        let lumen = Lumen::of_volume(grid, &bits);
        let surface = Surface::new(&lumen, &Midpoint, None);
        Self { shape, turn, centre, spacing: h, lumen, surface }
    }

    /// Root of the mean square angle to the analytic normals, degrees.
    fn rms(&self, normals: impl Iterator<Item = DVec3>) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for (p, n) in self.surface.mesh.positions.iter().zip(normals) {
            let p = self.turn.transpose() * (p.as_dvec3() - self.centre);
            if self.shape.scored(p) {
                let inward = -(self.turn * self.shape.normal(p));
                sum += inward.angle_between(n).to_degrees().powi(2);
                count += 1;
            }
        }
        assert!(count > 1000, "{count} vertices scored");
        (sum / f64::from(count)).sqrt()
    }

    fn multiscale(&self) -> f64 {
        let Surface { mesh, adjacency, .. } = &self.surface;
        let frame = VoxelFrame { direction: DMat3::IDENTITY, spacing_mm: self.spacing };
        let initial = MultiscaleNormals::new(mesh, adjacency, frame);
        let mut plan = Plan::new();
        let out = multiscale_normals(&mut plan, adjacency, &initial);
        plan.download(out);
        let got = run_cpu(&plan);
        self.rms(got.get(out).chunks_exact(3).map(|n| Vec3::from_slice(n).as_dvec3()))
    }

    /// Thirty steps with the better weights.
    fn steps(&self) -> f64 {
        let Surface { mesh, adjacency, .. } = &self.surface;
        let start = face_normals(mesh);
        let one = |kind| {
            let weight = weights(mesh, adjacency, kind);
            let mut plan = Plan::new();
            let fairing = Fairing { weights: kind, ..Fairing::PAPER };
            let out = fair(&mut plan, adjacency, &weight, &start, fairing);
            plan.download(out);
            let got = run_cpu(&plan);
            self.rms(got.get(out).chunks_exact(3).map(|n| Vec3::from_slice(n).as_dvec3()))
        };
        one(Weights::Uniform).min(one(Weights::InverseDistance))
    }

    /// Gradient of the mask after a Gaussian of `sigma_mm`, as SciPy's `gaussian_gradient`: the
    /// derivative of the kernel, cut off at four standard deviations, summed over inside voxels.
    /// Taken at each vertex instead of interpolated from voxels.
    fn gaussian(&self, sigma_mm: f64) -> f64 {
        let reach = (4.0 * sigma_mm / self.spacing).ceil().as_ivec3();
        let at = |p: &Vec3| {
            let q = p.as_dvec3() / self.spacing;
            let first = q.round().as_ivec3() - reach;
            // Kernel and derivative along each axis.
            let weights: [Vec<[f64; 2]>; 3] = [0, 1, 2].map(|axis| {
                let one = |i: i32| {
                    let d = (f64::from(first[axis] + i) - q[axis]) * self.spacing[axis];
                    let g = (-0.5 * (d / sigma_mm).powi(2)).exp();
                    [g, d * g]
                };
                (0..=2 * reach[axis]).map(one).collect()
            });
            let mut sum = DVec3::ZERO;
            for (z, wz) in weights[2].iter().enumerate() {
                for (y, wy) in weights[1].iter().enumerate() {
                    for (x, wx) in weights[0].iter().enumerate() {
                        let v = first + glam::IVec3::new(x as i32, y as i32, z as i32);
                        if self.lumen.holds(v) {
                            sum += DVec3::new(
                                wx[1] * wy[0] * wz[0],
                                wx[0] * wy[1] * wz[0],
                                wx[0] * wy[0] * wz[1],
                            );
                        }
                    }
                }
            }
            sum
        };
        self.rms(self.surface.mesh.positions.iter().map(at))
    }
}

#[test]
fn multiscale_normals_of_untuned_masks_beat_steps_and_where_isotropic_gaussian_gradients() {
    const ISO: [f64; 3] = [1.0; 3];
    const THICK: [f64; 3] = [1.0, 1.0, 3.0];
    let ellipsoid = Shape::Ellipsoid(DVec3::new(18.0, 12.0, 8.0));
    let hyperboloid = Shape::Hyperboloid(DVec3::new(7.0, 6.0, 10.0), 18.0);
    let cone = Shape::RoundCone([3.0, 10.0], 26.0);
    let capsule = Shape::RoundCone([7.0; 2], 24.0);
    let large = Shape::Ellipsoid(DVec3::new(30.0, 24.0, 20.0));
    println!(
        "{:24} {:>7} {:>7} {:>7} {:>10}",
        "RMS degrees", "steps", "1 vox", "1.5 vox", "multiscale"
    );
    for (name, shape, spacing) in [
        ("ellipsoid", ellipsoid, ISO),
        ("hyperboloid", hyperboloid, ISO),
        ("round cone", cone, ISO),
        ("capsule", capsule, ISO),
        ("ellipsoid, 1:3", large, THICK),
        ("capsule, 1:3", Shape::RoundCone([14.0; 2], 30.0), THICK),
    ] {
        let case = Case::new(shape, spacing);
        let largest = case.spacing.max_element();
        let gaussian = [1.0, 1.5].map(|s| case.gaussian(s * largest));
        let (steps, multiscale) = (case.steps(), case.multiscale());
        println!("{name:24} {steps:7.2} {:7.2} {:7.2} {multiscale:10.2}", gaussian[0], gaussian[1]);
    }
}

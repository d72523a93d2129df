use glam::{DVec3, IVec3, UVec3, Vec3};

use super::*;
use crate::lumen::{BitVolume, Lumen};
use crate::volume::Grid;

fn mask(dims: [u32; 3], inside: impl Fn(UVec3) -> bool) -> Lumen {
    let grid = Grid::axis_aligned(dims, [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
        bits.set(v.x, v.y, v.z);
    }
    Lumen::of_volume(grid, &bits)
}

/// Vertices and Euler number from the mask alone: inside/outside pairs of 6-neighbours, and the
/// alternating sum over cells of the 6-connected inside, corrected for cells whose only outside
/// corners are two opposite ones.
fn counts(l: &Lumen) -> (usize, i64) {
    let d = l.grid.dims.as_ivec3();
    let at = |v: IVec3| l.holds(v);
    let (mut pairs, mut links) = (0usize, 0i64);
    let (mut voxels, mut squares, mut cubes, mut twisted) = (0i64, 0i64, 0i64, 0i64);
    for z in -1..d.z {
        for y in -1..d.y {
            for x in -1..d.x {
                let v = IVec3::new(x, y, z);
                let c: [bool; 8] = std::array::from_fn(|i| {
                    at(v + IVec3::new(i as i32 & 1, i as i32 >> 1 & 1, i as i32 >> 2))
                });
                voxels += i64::from(c[0]);
                for k in [1, 2, 4] {
                    pairs += usize::from(c[0] != c[k]);
                    links += i64::from(c[0] && c[k]);
                }
                for (a, b) in [(1, 2), (1, 4), (2, 4)] {
                    squares += i64::from(c[0] && c[a] && c[b] && c[a | b]);
                }
                cubes += i64::from(c.iter().all(|c| *c));
                let out: Vec<usize> = (0..8).filter(|&i| !c[i]).collect();
                twisted += i64::from(out.len() == 2 && out[0] ^ out[1] == 7);
            }
        }
    }
    (pairs, 2 * (voxels - links + squares - cubes + twisted))
}

#[test]
fn vertices_and_euler_number_equal_the_mask_counts_on_200_random_masks() {
    for seed in 0..200u64 {
        let density = 1 + seed % 15;
        let dims = [9 + (seed % 7) as u32, 8, 7 + (seed % 5) as u32];
        let l = mask(dims, |v| {
            let n = (u64::from(v.x) | u64::from(v.y) << 20 | u64::from(v.z) << 40) ^ seed << 8;
            let n = (n ^ n >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (n ^ n >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 60 < density
        });
        let s = Surface::new(&l, &Midpoint, None);
        let (v, euler) = counts(&l);
        assert_eq!(s.mesh.positions.len(), v, "mask {seed}");
        assert_eq!(s.topology.euler, euler, "mask {seed}");
        assert!(s.topology.watertight, "mask {seed}");
    }
}

#[test]
fn faces_look_into_the_lumen_on_grids_of_either_hand() {
    for mirrored in [false, true] {
        let mut l =
            mask([12, 13, 14], |v| (v.as_dvec3() - DVec3::new(5.5, 6.0, 6.5)).length() < 4.5);
        if mirrored {
            l.grid.direction.x_axis = -l.grid.direction.x_axis;
        }
        let s = Surface::new(&l, &Midpoint, None);
        let volume = s.mesh.volume_mm3();
        let voxels = l.inside_voxels() as f64;
        assert!(volume > 0.9 * voxels && volume < 1.1 * voxels, "{volume} {voxels}");
        let n = face_normals(&s.mesh);
        let centre = l.grid.world_from_voxel().transform_point3(DVec3::new(5.5, 6.0, 6.5));
        for (p, n) in s.mesh.positions.iter().zip(n.chunks(3)) {
            assert!((centre.as_vec3() - p).dot(glam::Vec3::from_slice(n)) > 0.0);
        }
    }
}

#[test]
fn voxels_that_touch_by_an_edge_get_separate_surfaces() {
    let l = mask([4, 4, 3], |v| v == UVec3::new(1, 1, 1) || v == UVec3::new(2, 2, 1));
    assert_eq!(Surface::new(&l, &Midpoint, None).topology.components, 2);
    let one = Surface::new(&l, &Midpoint, Some(IVec3::new(2, 2, 1)));
    assert_eq!((one.topology.components, one.topology.vertices), (1, 6));
    assert!(one.mesh.positions.iter().all(|p| p.x > 1.4));
}

#[test]
fn a_lumen_that_reaches_the_edge_is_closed_there_by_caps() {
    let l = mask([5, 5, 8], |v| (1..4).contains(&v.x) && (1..4).contains(&v.y));
    assert!(l.touches_edge);
    let s = Surface::new(&l, &Midpoint, None);
    assert!(s.topology.watertight && s.topology.euler == 2);
    let caps = s.mesh.caps.iter().filter(|c| **c).count();
    assert!(caps > 0 && caps < s.mesh.faces.len() / 2, "{caps}");
    for (f, cap) in s.mesh.faces.iter().zip(&s.mesh.caps) {
        let z: Vec<f32> = f.iter().map(|v| s.mesh.positions[*v as usize].z).collect();
        let at_end = z.iter().all(|z| *z < 0.0) || z.iter().all(|z| *z > 7.0);
        assert!(!at_end || *cap);
    }
}

/// A sampled signed distance gives a sphere whose area and volume converge with resolution.
#[test]
fn the_grey_surface_of_a_sphere_converges() {
    let mut last = f64::INFINITY;
    for n in [20u32, 40, 80] {
        let r = 0.35 * f64::from(n);
        let grid = Grid::axis_aligned([n; 3], [1.0; 3]);
        let c = DVec3::splat(f64::from(n) / 2.0 - 0.37);
        let f = |v: UVec3| ((v.as_dvec3() - c).length() - r) as f32;
        let values: Vec<f32> = (0..grid.len()).map(|i| f(grid.voxel(i))).collect();
        let volume = crate::volume::Volume::new(grid, values.into());
        let selection = crate::lumen::IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: 0.0 };
        let (lumen, _) =
            crate::lumen::SegmentationOptions::new(selection.clone()).apply(&volume).unwrap();
        let grey = Grey::new(&lumen, (&volume).into(), &selection).unwrap();
        let s = Surface::new(&lumen, &grey, None);
        let pi = std::f64::consts::PI;
        let area = (s.mesh.area_mm2() / (4.0 * pi * r * r) - 1.0).abs();
        let bulk = (s.mesh.volume_mm3() / (4.0 / 3.0 * pi * r.powi(3)) - 1.0).abs();
        assert!(area < 0.01 && bulk < 0.02 && bulk < last / 2.0, "{n}: {area} {bulk}");
        last = bulk;
    }
}

#[test]
fn fairing_steps_reuse_two_buffers_and_leave_the_start_alone() {
    let l = mask([20; 3], |v| (v.as_dvec3() - 9.3).length() < 7.0);
    let s = Surface::new(&l, &Midpoint, None);
    let start = face_normals(&s.mesh);
    let w = weights(&s.mesh, &s.adjacency, Weights::Uniform);
    let mut plan = crate::compute::Plan::new();
    let n = fair(&mut plan, &s.adjacency, &w, &start, Fairing::PAPER);
    plan.download(n);
    assert_eq!(plan.buffers().len(), 6);
    let out = crate::compute::run_cpu(&plan);
    let error = |n: &[f32]| {
        let sum: f64 = s
            .mesh
            .positions
            .iter()
            .zip(n.chunks(3))
            .map(|(p, n)| {
                let want = (glam::Vec3::splat(9.3) - p).normalize();
                f64::from(want.dot(glam::Vec3::from_slice(n)).clamp(-1.0, 1.0).acos()).powi(2)
            })
            .sum();
        (sum / s.mesh.positions.len() as f64).sqrt().to_degrees()
    };
    assert!(error(out.get(n)) < error(&start) / 2.5, "{} {}", error(out.get(n)), error(&start));
}

/// Counting all edges of the tip for each of its neighbours took 10¹¹ steps here.
#[test]
fn the_tip_of_a_fan_is_adjacent_to_all_its_triangles() {
    let rim = 300_000u32;
    let place = |i: u32| {
        let angle = std::f32::consts::TAU * i as f32 / rim as f32;
        Vec3::new(angle.cos(), angle.sin(), 0.0)
    };
    let positions = (0..rim).map(place).chain([Vec3::Z]).collect();
    let faces = (0..rim).map(|i| [i, (i + 1) % rim, rim]).collect();
    let mesh = Mesh { positions, faces, ..Mesh::default() };
    let (adjacency, watertight) = Adjacency::of(&mesh);
    assert!(!watertight);
    assert_eq!(adjacency.row(rim as usize).len(), rim as usize);
    assert_eq!(adjacency.row(7), [6, 8, rim]);
}

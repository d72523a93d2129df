use std::collections::HashMap;
use std::sync::Arc;

use glam::Vec3;

use super::*;
use crate::geometry::shapes::torus;
use crate::geometry::{Camera, Lens, Mesh, Pose, Vertex, point_triangle_distance};
use crate::lod::morph::PatchVertex;
use crate::lod::{DrawnWall, Tolerance, occlusion_grid};
use crate::surface::{Adjacency, shading};

/// Radii of `shapes::torus`.
const MAJOR: f32 = 10.0;
const MINOR: f32 = 3.0;

/// A torus about z.
#[derive(Debug)]
struct Torus;

impl Torus {
    /// Distance from the wall, negative inside.
    fn offset(p: Vec3) -> f32 {
        Vec3::new(p.truncate().length() - MAJOR, p.z, 0.0).length() - MINOR
    }
}

impl SmoothWall for Torus {
    fn root(&self, from: Vec3, way: Vec3, reach_mm: f32) -> Option<f32> {
        let mut t = 0.0;
        for _ in 0..20 {
            t += Torus::offset(from + t * way);
        }
        (t.abs() <= reach_mm).then_some(t)
    }

    fn off(&self, p: Vec3, _: Vec3) -> Option<f32> {
        Some(Torus::offset(p).abs())
    }
}

/// A coarse torus whose vertices are off the wall, refined.
fn wall(pixels: f32) -> (Mesh, RefinedWall) {
    let mut mesh = torus(60, 24);
    for (i, p) in mesh.positions.iter_mut().enumerate() {
        *p += 0.05 * (i as f32).sin() * mesh.normals[i];
    }
    let input = RefinedWallInput {
        mesh: &mesh,
        shading: &shading(&mesh),
        is_fixed: vec![false; mesh.positions.len()],
        smooth: Some(Arc::new(Torus)),
        exterior: Some(Arc::new(occlusion_grid(&mesh))),
        reach_mm: 0.2,
        tolerance: Tolerance { pixels },
    };
    let wall = RefinedWall::new(input);
    (mesh, wall)
}

fn camera(eye: Vec3, to: Vec3, fov: f32) -> Camera {
    let lens = Lens { fov_y_rad: fov, aspect: 1.5, near_mm: 0.05 };
    Camera { pose: Pose::looking(eye, to - eye, Vec3::Z), lens, height_px: 600 }
}

/// Cameras inside the torus, from far to near the wall.
fn cameras() -> impl Iterator<Item = Camera> {
    (0..24u32).map(|k| {
        let turn = 0.4 * k as f32;
        let off = 0.11 * k as f32;
        let out = Vec3::new(turn.cos(), turn.sin(), 0.0);
        let eye = (MAJOR + off) * out;
        let ahead = Vec3::new(-turn.sin(), turn.cos(), 0.3 * (k as f32).sin());
        camera(eye, eye + ahead + 0.6 * out, 1.0 + 0.04 * k as f32)
    })
}

/// All triangles that a camera sees.
fn triangles(wall: &RefinedWall, camera: &Camera) -> Vec<[Vertex; 3]> {
    let seen = wall.visible(camera);
    let face = |f: u32| wall.faces()[f as usize].map(|v| wall.shading().vertices[v as usize]);
    let flat = seen.ranges.iter().flat_map(|r| r.first_index / 3..(r.first_index + r.indices) / 3);
    let mut all: Vec<[Vertex; 3]> = flat.map(face).collect();
    all.extend(seen.refined.iter().flat_map(|f| wall.triangles(*f)));
    all
}

/// Asserts that the triangles of a picture meet in every bit: in its inner, near the eye, each
/// half-edge has its twin. Farther from the eye, the drawn part of the wall ends.
fn assert_no_crack(all: &[[Vertex; 3]], camera: &Camera) {
    let key = |v: &Vertex| v.position().to_array().map(f32::to_bits);
    let mut open: HashMap<_, Vec3> = HashMap::new();
    for t in all {
        for e in 0..3 {
            let (a, b) = (&t[e], &t[(e + 1) % 3]);
            if open.remove(&(key(b), key(a))).is_none() {
                open.insert((key(a), key(b)), 0.5 * (a.position() + b.position()));
            }
        }
    }
    let turn = camera.pose.rotation.conjugate();
    let tangent = (0.5 * camera.lens.fov_y_rad).tan();
    for middle in open.values() {
        let c = turn * (*middle - camera.pose.position_mm);
        let inside = -c.z > camera.lens.near_mm
            && c.x.abs() < 0.97 * 1.5 * tangent * -c.z
            && c.y.abs() < 0.97 * tangent * -c.z;
        let tube = MAJOR * Vec3::new(middle.x, middle.y, 0.0).normalize();
        let inwards = (tube - *middle).normalize();
        let to_eye = camera.pose.position_mm - *middle;
        let faces_eye = inwards.dot(to_eye) > 0.0;
        assert!(!(inside && faces_eye && to_eye.length() < 3.0), "a crack at {middle} ({c})");
    }
}

#[test]
fn neighbours_agree_in_every_bit_along_their_edge_whatever_their_fineness() {
    let (_, wall) = wall(0.5);
    let mut refined = 0;
    for camera in cameras() {
        refined += wall.visible(&camera).refined.len();
        assert_no_crack(&triangles(&wall, &camera), &camera);
    }
    assert!(refined > 2_000, "{refined}");
}

#[test]
fn drawn_points_are_within_the_tolerance_but_between_sides_of_other_fineness() {
    for pixels in [0.5, 2.0] {
        let (_, wall) = wall(pixels);
        let (mut worst, mut over, mut count): (f32, usize, usize) = (0.0, 0, 0);
        for camera in cameras() {
            let turn = camera.pose.rotation.conjugate();
            let focal = 300.0 / (0.5 * camera.lens.fov_y_rad).tan();
            for t in triangles(&wall, &camera) {
                let [a, b, c] = t.map(|v| v.position());
                for p in [(a + b + c) / 3.0, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)] {
                    let c = turn * (p - camera.pose.position_mm);
                    let depth = -c.z;
                    let half = (0.5 * camera.lens.fov_y_rad).tan() * depth;
                    // Nearer, four splits are too few.
                    if depth > 1.0 && c.x.abs() < 1.5 * half && c.y.abs() < half {
                        let away = focal * Torus::offset(p).abs() / depth;
                        worst = worst.max(away);
                        over += usize::from(away > pixels);
                        count += 1;
                    }
                }
            }
        }
        // The tolerance is of edges of the mesh and their halves. A triangle between a coarse side and
        // finer points inside has longer edges.
        assert!(over * 50 < count && worst < 2.5 * pixels, "{over} of {count}, {worst}");
        assert!(worst > 0.3 * pixels && count > 20_000, "{worst} {count}");
    }
}

/// Buffer of vertices as the device has it.
#[derive(Default)]
struct SlotBuffer(HashMap<u64, PatchVertex>);

impl SlotBuffer {
    fn write(&mut self, writes: &[SlotWrite]) {
        for w in writes {
            let first = w.offset / size_of::<PatchVertex>() as u64;
            self.0.extend(w.vertices.iter().enumerate().map(|(k, v)| (first + k as u64, *v)));
        }
    }

    /// Returns all triangles of one camera.
    fn triangles(&self, placed: &PlacedFaces, wall: &RefinedWall) -> Vec<[Vertex; 3]> {
        let flat = placed.flat.ranges.iter();
        let flat = flat.flat_map(|r| r.first_index / 3..(r.first_index + r.indices) / 3);
        let corner = |v: u32| wall.shading().vertices[v as usize];
        let mut all: Vec<_> = flat.map(|f| wall.faces()[f as usize].map(corner)).collect();
        let by_slot = |(first, words): (u32, &[u32])| {
            (first..).zip(words.to_vec()).collect::<Vec<(u32, u32)>>()
        };
        let fineness: HashMap<u32, u32> = placed.fineness_of_slots().flat_map(by_slot).collect();
        let vertex = |i: u32| {
            let vertex = self.0[&u64::from(i)];
            vertex.morphed(fineness[&(vertex.carrier >> 13)])
        };
        all.extend(placed.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(vertex)));
        all
    }
}

#[test]
fn slots_hold_the_same_triangles_as_the_wall_and_are_rarely_written_twice() {
    let (_, wall) = wall(0.5);
    let mut slots = RefinedSlots::new();
    let mut buffer = SlotBuffer::default();
    let (mut written, mut drawn) = (0, 0);
    for _ in 0..2 {
        for camera in cameras() {
            let seen = wall.visible(&camera);
            let (placed, writes, waiting) = slots.place(&wall, &[&seen], u32::MAX);
            assert_eq!((placed.len(), waiting), (1, 0));
            (written, drawn) = (written + writes.len(), drawn + seen.refined.len());
            buffer.write(&writes);
            assert_eq!(placed[0].triangles, seen.triangles());
            assert!(buffer.triangles(&placed[0], &wall) == triangles(&wall, &camera));
        }
    }
    assert!(written * 3 < 2 * drawn, "{written} {drawn}");
}

#[test]
fn faces_that_wait_leave_no_crack_and_are_made_later() {
    let (_, wall) = wall(0.5);
    let camera = cameras().nth(20).unwrap();
    let seen = wall.visible(&camera);
    let mut slots = RefinedSlots::new();
    let mut buffer = SlotBuffer::default();
    for frames in 1.. {
        let (placed, writes, waiting) = slots.place(&wall, &[&seen], 40);
        assert!(writes.len() <= 4 * 40, "{}", writes.len());
        buffer.write(&writes);
        let all = buffer.triangles(&placed[0], &wall);
        assert_eq!(all.len() as u64, placed[0].triangles);
        assert_no_crack(&all, &camera);
        if waiting == 0 {
            assert!(frames > 2, "{frames}");
            assert_eq!(placed[0].triangles, seen.triangles());
            break;
        }
    }
}

#[test]
fn a_split_mesh_is_closed_on_the_wall_and_keeps_its_caps_flat() {
    let (mesh, wall) = wall(1.0);
    for level in [1, 2, 3] {
        let split = wall.mesh(level, &[]);
        assert_eq!(split.faces.len(), mesh.faces.len() << (2 * level));
        let (adjacency, watertight) = Adjacency::of(&split);
        let topology = adjacency.topology(&split, watertight);
        assert!(watertight && topology.euler == 0, "{topology:?}");
        let off = split.positions.iter().map(|p| Torus::offset(*p).abs()).fold(0.0, f32::max);
        assert!(off < 1e-4, "{off}");
    }
    // A tetrahedron whose base is a cap.
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::new(0.2, 0.2, 1.0)];
    let mut cut = Mesh { positions: corners.to_vec(), ..Mesh::default() };
    cut.faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    cut.caps = vec![true, false, false, false];
    let input = RefinedWallInput {
        mesh: &cut,
        shading: &shading(&cut),
        is_fixed: vec![true, true, true, false],
        smooth: None,
        exterior: None,
        reach_mm: 0.0,
        tolerance: Tolerance { pixels: 1.0 },
    };
    let split = RefinedWall::new(input).mesh(2, &cut.caps);
    let flat = split.faces.iter().zip(&split.caps).filter(|f| *f.1).map(|f| f.0);
    let heights: Vec<f32> = flat.flatten().map(|v| split.positions[*v as usize].z).collect();
    assert_eq!(heights.len(), 48);
    assert!(heights.iter().all(|z| *z == 0.0));
}

#[test]
fn proven_distances_are_not_more_than_those_to_any_drawn_point() {
    let (_, wall) = wall(0.5);
    let (mut loss, mut count) = (0.0, 0);
    for camera in cameras() {
        let eye = camera.pose.position_mm.as_dvec3();
        let found = wall.distance(eye, 50.0);
        // What this camera draws, and coarser and finer ones.
        let mut drawn = f64::INFINITY;
        for (scale, near) in [(1, 0.05), (8, 0.05), (40, 0.05)] {
            let lens = Lens { near_mm: near, ..camera.lens };
            let other = Camera { height_px: camera.height_px * scale / 8 + 1, lens, ..camera };
            for t in triangles(&wall, &other) {
                let corners = t.map(|v| v.position().as_dvec3());
                drawn = drawn.min(point_triangle_distance(eye, corners));
            }
        }
        assert!(found.proven_mm <= drawn, "{found:?} {drawn}");
        assert!(found.proven_mm <= found.nominal_mm, "{found:?}");
        let exact = f64::from(-Torus::offset(camera.pose.position_mm));
        assert!((found.nominal_mm - exact).abs() < 0.02, "{found:?} {exact}");
        (loss, count) = (loss + found.nominal_mm - found.proven_mm, count + 1);
    }
    assert!(loss / f64::from(count) < 0.15, "{}", loss / f64::from(count));
    let far = wall.distance(glam::DVec3::splat(500.0), 3.0);
    assert_eq!((far.nominal_mm, far.proven_mm), (3.0, 3.0));
}

#[test]
fn a_face_that_waits_for_a_finer_level_stays_as_fine_as_it_was() {
    let (_, wall) = wall(0.5);
    let near = cameras().nth(20).unwrap();
    let far = Camera { height_px: near.height_px / 6, ..near };
    let mut slots = RefinedSlots::new();
    let mut buffer = SlotBuffer::default();
    let seen = wall.visible(&far);
    let (placed, writes, _) = slots.place(&wall, &[&seen], u32::MAX);
    buffer.write(&writes);
    let coarse = placed[0].indices.len();
    // Nothing new is made for the finer picture.
    let seen = wall.visible(&near);
    let (placed, writes, waiting) = slots.place(&wall, &[&seen], 0);
    assert!(waiting > 0 && writes.is_empty());
    let all = buffer.triangles(&placed[0], &wall);
    assert!(placed[0].indices.len() >= coarse, "{} {coarse}", placed[0].indices.len());
    assert_no_crack(&all, &near);
}

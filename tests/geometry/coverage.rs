//! Coverage of flown phantoms, and of real organs where the checkout has them beside it, against a
//! ray for every face and frame.

use std::sync::Arc;
use std::time::Instant;

use common::cast::Cast;
use common::volumes;
use glam::{DVec3, UVec3};
use intima::centerline::{RouteOptions, centerline};
use intima::compute::{Plan, run_cpu};
use intima::field::{LumenBuffers, distance, smooth};
use intima::flight::{self, Coverage, CoverageMap, Flight, FlightOptions, Frames, unseen_voxels};
use intima::formats::{ReadOptions, read_volume};
use intima::geometry::{CenterlinePoint, Lens, Mesh, Pose, TriangleBvh};
use intima::lod::occlusion_grid;
use intima::lumen::{IntensitySelection, Lumen, SegmentationOptions};
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::surface::{Midpoint, Surface};
use intima::volume::Volume;
use intima::volume::phantom::{Kind, Phantom};
use rayon::prelude::*;

struct Organ {
    lumen: Lumen,
    distance: Vec<f32>,
    path: Vec<CenterlinePoint>,
    wall: Mesh,
}

impl Organ {
    fn of(volume: &Volume, options: &SegmentationOptions) -> Self {
        let (lumen, _) = options.apply(volume).unwrap();
        let mut plan = Plan::new();
        let buffers = LumenBuffers::new(&mut plan, &lumen);
        let d = distance(&mut plan, &buffers);
        let f = smooth(&mut plan, &buffers, d, lumen.grid.spacing_mm.min_element(), None);
        plan.download(d);
        plan.download(f);
        let out = run_cpu(&plan);
        let (d, f) = (out.get(d).to_vec(), out.get(f).to_vec());
        let line = centerline(&lumen, &d, &f, RouteOptions::default()).unwrap().line;
        let wall = Surface::new(&lumen, &Midpoint, None).mesh;
        Self { path: line.path_to(0), lumen, distance: d, wall }
    }

    fn phantom(kind: Kind, size: u32, spacing: [f64; 3]) -> Self {
        let mask = Phantom::new(kind, size, spacing).unwrap().mask();
        Self::of(&mask, &SegmentationOptions::new(IntensitySelection::Labels(Vec::new())))
    }

    /// Pose and lens of every frame, there or back.
    fn views(&self, frames: usize, reverse: bool) -> Vec<(Pose, Lens)> {
        let index = TriangleBvh::new(&self.wall);
        let options = FlightOptions {
            frames: Frames::Count(frames),
            wall: Some(&index),
            reverse,
            ..FlightOptions::default()
        };
        Flight::new(&self.path, &self.lumen, &self.distance, options).unwrap().views()
    }
}

/// Whether a lens has a place, relative to its eye, in its picture.
fn in_picture((pose, lens): &(Pose, Lens), p: DVec3) -> bool {
    let p = pose.rotation.as_dquat().normalize().inverse() * p;
    let y = (0.5 * f64::from(lens.fov_y_rad)).tan();
    -p.z >= f64::from(lens.near_mm)
        && p.y.abs() <= -p.z * y
        && p.x.abs() <= -p.z * y * f64::from(lens.aspect)
}

/// Share of the wall's area that the views see, by a ray to each face's centroid in every view
/// that has it in its picture, and which faces those are. `every`: looks at each such face alone.
fn by_rays(wall: &Mesh, views: &[(Pose, Lens)], every: usize) -> (f64, Vec<Option<bool>>) {
    let cast = Cast::of(wall);
    let corners = |f: usize| wall.faces[f].map(|v| wall.positions[v as usize].as_dvec3());
    let seen: Vec<Option<bool>> = (0..wall.faces.len())
        .into_par_iter()
        .map(|f| {
            if f % every != 0 {
                return None;
            }
            let [a, b, c] = corners(f);
            let normal = (b - a).cross(c - a);
            let at = (a + b + c) / 3.0;
            Some(views.iter().any(|view| {
                let eye = view.0.position_mm.as_dvec3();
                normal.dot(eye - at) > 0.0
                    && in_picture(view, at - eye)
                    && cast.ray(eye, at - eye).is_none_or(|hit| hit.t > 1.0 - 1e-6)
            }))
        })
        .collect();
    let (mut all, mut sum) = (0.0, 0.0);
    for f in 0..wall.faces.len() {
        let [a, b, c] = corners(f);
        let area = (b - a).cross(c - a).length();
        let cap = wall.caps.get(f).copied().unwrap_or(false);
        if let (Some(seen), false) = (seen[f], cap) {
            all += area;
            sum += if seen { area } else { 0.0 };
        }
    }
    (sum / all, seen)
}

/// Coverage of a closed wall.
fn coverage(wall: &Mesh, there: &[(Pose, Lens)], back: &[(Pose, Lens)]) -> Coverage {
    let (tree, exterior) = (TriangleBvh::new(wall), occlusion_grid(wall));
    flight::coverage(CoverageMap::new(wall, &tree, Some(&exterior)), there, back, &[])
}

/// Prints both figures and how far they are from rays.
fn beside_rays(name: &str, organ: &Organ, frames: usize, every: usize) -> (Coverage, [f64; 2]) {
    let (there, back) = (organ.views(frames, false), organ.views(frames, true));
    let start = Instant::now();
    let found = coverage(&organ.wall, &there, &back);
    let time = start.elapsed();
    let start = Instant::now();
    let missed = unseen_voxels(&organ.lumen, &TriangleBvh::new(&organ.wall), &found);
    println!(
        "{name}: {} faces, {frames} frames each way: {time:.0?}; {} voxels of {} unseen, {:.0?}",
        organ.wall.faces.len(),
        missed.len(),
        organ.lumen.boundary_voxels,
        start.elapsed()
    );
    let start = Instant::now();
    let one = by_rays(&organ.wall, &there, every).0;
    let both = by_rays(&organ.wall, &[there, back].concat(), every).0;
    println!(
        "  one way {:.4} (rays {one:.4}), both ways {:.4} (rays {both:.4}, {:.0?}), area {:.0} mm2",
        found.one_way_fraction,
        found.both_ways_fraction,
        start.elapsed(),
        found.area_mm2
    );
    for p in &found.patches {
        let [x, y, z] = p.center_mm.to_array();
        println!("  {:.0} mm2 at ({x:.1}, {y:.1}, {z:.1}), {:.0} mm in", p.area_mm2, p.arc_mm);
    }
    println!("  {} smaller: {:.0} mm2", found.smaller_patches, found.smaller_patches_mm2);
    (found, [one, both])
}

#[test]
fn coverage_agrees_with_a_ray_for_every_face_and_frame() {
    for (kind, size, spacing) in [
        (Kind::Colon, 64, [1.0; 3]),
        (Kind::Bend, 48, [1.0; 3]),
        (Kind::Helix, 64, [0.8, 0.8, 1.6]),
    ] {
        let organ = Organ::phantom(kind, size, spacing);
        let (found, [one, both]) = beside_rays(kind.name(), &organ, 40, 1);
        assert!((found.one_way_fraction - one).abs() < 1e-3, "{}", kind.name());
        assert!((found.both_ways_fraction - both).abs() < 1e-3, "{}", kind.name());
        assert!(found.both_ways_fraction > found.one_way_fraction);
        // Face by face, where a face has one sample.
        let seen = by_rays(&organ.wall, &organ.views(40, false), 1).1;
        let same = seen.iter().zip(&found.seen_one_way).filter(|(a, b)| **a == Some(**b)).count();
        assert!(same as f64 > 0.999 * seen.len() as f64, "{}: {same}", kind.name());
    }
}

#[test]
fn unseen_voxels_are_those_whose_nearest_face_was_missed() {
    let organ = Organ::phantom(Kind::Colon, 48, [1.0; 3]);
    let there = organ.views(20, false);
    let found = coverage(&organ.wall, &there, &[]);
    let listed = unseen_voxels(&organ.lumen, &TriangleBvh::new(&organ.wall), &found);
    assert!(listed.len() > 100 && listed.windows(2).all(|w| w[0].0 < w[1].0));
    let world = organ.lumen.grid.world_from_voxel();
    let corners =
        |f: usize| organ.wall.faces[f].map(|v| organ.wall.positions[v as usize].as_dvec3());
    let casts: Vec<Cast> = [true, false]
        .iter()
        .map(|seen| {
            let all = (0..organ.wall.faces.len()).filter(|f| found.seen_one_way[*f] == *seen);
            Cast::new(all.map(corners).collect())
        })
        .collect();
    let mut at = listed.iter().peekable();
    for e in organ.lumen.elements(&organ.lumen.boundary) {
        let centre = world.transform_point3(organ.lumen.bricks.voxel(e).as_dvec3());
        let [seen, missed] = [&casts[0], &casts[1]].map(|c| c.nearest(centre).unwrap().1);
        let is_listed = at.next_if(|l| l.0 as usize == e).is_some();
        // Of faces as near as each other either may count.
        if (seen - missed).abs() > 1e-9 {
            assert_eq!(is_listed, missed < seen, "voxel {e}: {seen} {missed}");
        }
    }
    assert!(at.next().is_none(), "only boundary voxels are listed");
    let patches = found.patches.len() + found.smaller_patches;
    assert!(listed.iter().all(|l| (l.1 as usize) < patches));
    let all = Coverage { patch_of_face: vec![None; organ.wall.faces.len()], ..found };
    assert!(unseen_voxels(&organ.lumen, &TriangleBvh::new(&organ.wall), &all).is_empty());
}

/// Share of the boundary voxels that views see: the line from the eye to one voxel before it stays
/// in voxels of the lumen. Neither faces nor their direction take part. Axes of phantoms are
/// their grid's, and voxels are cubes.
fn by_voxel_rays(lumen: &Lumen, views: &[(Pose, Lens)]) -> f64 {
    let (world, local) = (lumen.grid.world_from_voxel(), lumen.grid.voxel_from_world());
    let boundary: Vec<DVec3> =
        lumen.elements(&lumen.boundary).map(|e| lumen.bricks.voxel(e).as_dvec3()).collect();
    let is_seen = |v: DVec3, view: &(Pose, Lens)| {
        let eye = view.0.position_mm.as_dvec3();
        let from = local.transform_point3(eye);
        let length = from.distance(v);
        let reach = (length - 1.0).max(0.0);
        let steps = (4.0 * reach).ceil() as u32;
        in_picture(view, world.transform_point3(v) - eye)
            && (0..=steps).all(|k| {
                let t = (0.25 * f64::from(k)).min(reach) / length.max(1e-9);
                lumen.holds(from.lerp(v, t).round().as_ivec3())
            })
    };
    let seen = boundary.par_iter().filter(|v| views.iter().any(|view| is_seen(**v, view))).count();
    seen as f64 / boundary.len() as f64
}

#[test]
fn coverage_of_a_mask_is_not_low_because_stair_faces_hide_each_other() {
    for (kind, size) in [(Kind::Colon, 64), (Kind::Helix, 64)] {
        let organ = Organ::phantom(kind, size, [1.0; 3]);
        let mask = Arc::new(Phantom::new(kind, size, [1.0; 3]).unwrap().mask());
        let session =
            Session::new(Source::Image(VolumeSource::Memory(mask)), Settings::default()).unwrap();
        let relaxed = session.wall().unwrap();
        let there = organ.views(60, false);
        let rays = by_voxel_rays(&organ.lumen, &there);
        let share = |wall: &Mesh| coverage(wall, &there, &[]).one_way_fraction;
        let (drawn, stairs) = (share(&relaxed.mesh), share(&organ.wall));
        println!("{}: {drawn:.4} of the wall, {stairs:.4} of stairs, rays {rays:.4}", kind.name());
        assert!((drawn - rays).abs() < 0.02, "{}: {drawn:.4}, rays {rays:.4}", kind.name());
        assert!(stairs < drawn - 0.01, "{}: {stairs:.4} of stairs", kind.name());
    }
}

#[test]
#[ignore = "minutes: cargo test --release --test geometry coverage_of_real -- --ignored"]
fn coverage_of_real_organs_beside_rays() {
    let Some(data) = volumes::shared_data() else { return };
    let labels = SegmentationOptions::new(IntensitySelection::Labels(Vec::new()));
    let bright = SegmentationOptions {
        seed: Some(UVec3::new(75, 133, 16)),
        ..SegmentationOptions::new(IntensitySelection::Range { lo: 1100.0, hi: f64::INFINITY })
    };
    for (name, options, every) in [
        ("colon_label_1.nii.gz", &labels, 7),
        ("airway_label_lidc4.nii.gz", &labels, 7),
        ("aorta_mra.mha", &bright, 1),
    ] {
        let volume = read_volume(&data.join(name), &ReadOptions::default()).unwrap();
        let organ = Organ::of(&volume, options);
        let (found, [one, both]) = beside_rays(name, &organ, 120, every);
        assert!((found.one_way_fraction - one).abs() < 0.01, "{name}");
        assert!((found.both_ways_fraction - both).abs() < 0.01, "{name}");
    }
}

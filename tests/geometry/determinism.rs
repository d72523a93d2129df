//! Every product has the same bytes at any number of threads.

use std::collections::BTreeMap;

use common::{curves, volumes};
use intima::compute::{Plan, run_cpu};
use intima::flight::{CoverageMap, Flight, FlightOptions, Frames, coverage, unseen_voxels};
use intima::geometry::{Mesh, TriangleBvh};
use intima::lod::occlusion_grid;
use intima::lumen::{IntensitySelection, Lumen, SegmentationOptions};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::surface::{
    Adjacency, Fairing, Midpoint, MultiscaleNormals, Surface, VoxelFrame, Weights, face_normals,
    fair, multiscale_normals, shading, weights,
};
use intima::volume::Volume;

/// Products by name, as bytes.
type Products = BTreeMap<&'static str, Vec<u8>>;

fn bytes<T: bytemuck::NoUninit>(of: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(of).to_vec()
}

fn mesh_bytes(mesh: &Mesh) -> Vec<u8> {
    let caps: Vec<u8> = mesh.caps.iter().map(|c| u8::from(*c)).collect();
    [bytes(&mesh.positions), bytes(&mesh.normals), bytes(&mesh.faces), caps].concat()
}

/// Normals with the default method, and with the steps of the paper.
fn normals(surface: &Surface, lumen: &Lumen) -> [Vec<f32>; 2] {
    let frame = VoxelFrame { direction: lumen.grid.direction, spacing_mm: lumen.grid.spacing_mm };
    let initial = MultiscaleNormals::new(&surface.mesh, &surface.adjacency, frame);
    let mut plan = Plan::new();
    let default = multiscale_normals(&mut plan, &surface.adjacency, &initial);
    let weight = weights(&surface.mesh, &surface.adjacency, Weights::InverseDistance);
    let start = face_normals(&surface.mesh);
    let steps = fair(&mut plan, &surface.adjacency, &weight, &start, Fairing::PAPER);
    plan.download(default);
    plan.download(steps);
    let out = run_cpu(&plan);
    [out.get(default).to_vec(), out.get(steps).to_vec()]
}

/// The whole chain, each product as it is made.
fn products(volume: &Volume) -> Products {
    let options = SegmentationOptions {
        all_components: true,
        ..SegmentationOptions::new(IntensitySelection::Labels(vec![1]))
    };
    let (lumen, _) = options.apply(volume).unwrap();
    assert!(lumen.grid.is_left_handed() && lumen.touches_edge);
    let mut all = Products::new();
    all.insert("bricks", [bytes(lumen.bricks.corners()), bytes(&lumen.inside)].concat());
    all.insert("boundary", bytes(&lumen.boundary));

    let mut surface = Surface::new(&lumen, &Midpoint, None);
    assert!(surface.topology.faces >= 200_000, "{} faces", surface.topology.faces);
    assert_eq!(surface.topology.components, 2);
    assert!(surface.topology.watertight);
    all.insert("surface", mesh_bytes(&surface.mesh));
    let (adjacency, _) = Adjacency::of(&surface.mesh);
    let (start, near) = adjacency.rows();
    all.insert("adjacency", [bytes(start), bytes(near)].concat());

    let [default, steps] = normals(&surface, &lumen);
    surface.mesh.normals = default.chunks_exact(3).map(glam::Vec3::from_slice).collect();
    all.insert("multiscale normals", bytes(&default));
    all.insert("normals by steps", bytes(&steps));
    all.insert("curvature tint", bytes(&shading(&surface.mesh).vertices));

    let mut parameterization = Parameterization::new(&surface.mesh).unwrap();
    let options = SimplifyOptions { relocate: true, ..SimplifyOptions::to_faces(10_000) };
    let base = simplify(&surface.mesh, &options, &mut parameterization).unwrap();
    all.insert("base", [mesh_bytes(&base.mesh), bytes(&base.vertex_ids)].concat());
    all.insert("parameterization", format!("{parameterization:?}").into_bytes());

    let case = curves::route(lumen, true);
    all.insert("distance", bytes(&case.distance));
    let points: Vec<f64> =
        case.routed.line.branches.iter().flat_map(|b| &b.points).fold(Vec::new(), |mut all, p| {
            all.extend(p.position_mm.to_array());
            all.extend([p.radius_mm, p.abscissa_mm]);
            all
        });
    all.insert("centerline", bytes(&points));

    let path = case.routed.line.path_to(0);
    let index = TriangleBvh::new(&surface.mesh);
    let views = |reverse: bool| {
        let options = FlightOptions {
            frames: Frames::Count(24),
            wall: Some(&index),
            reverse,
            ..FlightOptions::default()
        };
        Flight::new(&path, &case.lumen, &case.distance, options).unwrap().views()
    };
    let [there, back] = [views(false), views(true)];
    let poses: Vec<f32> = there
        .iter()
        .chain(&back)
        .flat_map(|(p, l)| {
            let [x, y, z] = p.position_mm.to_array();
            let [a, b, c, d] = p.rotation.to_array();
            [x, y, z, a, b, c, d, l.near_mm]
        })
        .collect();
    all.insert("flight", bytes(&poses));
    let (tree, grid) = (TriangleBvh::new(&surface.mesh), occlusion_grid(&surface.mesh));
    let seen = coverage(CoverageMap::new(&surface.mesh, &tree, Some(&grid)), &there, &back, &[]);
    let fractions = [seen.one_way_fraction, seen.both_ways_fraction, seen.area_mm2];
    let flags: Vec<u8> = seen.seen_both_ways.iter().map(|s| u8::from(*s)).collect();
    all.insert("coverage", [bytes(&fractions), flags].concat());
    let missed = unseen_voxels(&case.lumen, &tree, &seen);
    all.insert("unseen voxels", missed.iter().flat_map(|(e, p)| bytes(&[*e, *p])).collect());
    all
}

#[test]
fn products_of_an_oblique_two_piece_lumen_are_byte_equal_at_1_3_and_8_threads() {
    let volume = volumes::oblique_two_piece();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| products(&volume))
    };
    let want = on(1);
    assert_eq!(want.len(), 14);
    for (name, bytes) in &want {
        println!("{name}: {} bytes", bytes.len());
        assert!(!bytes.is_empty(), "{name} is empty");
    }
    for threads in [3, 8] {
        for (name, got) in on(threads) {
            assert!(got == want[name], "{name} differs at {threads} threads");
        }
    }
}

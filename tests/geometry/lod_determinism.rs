//! Levels of detail have the same bytes at any number of threads, on a lumen that is hard on every
//! assumption about grids.

use std::sync::Arc;

use common::volumes;
use intima::geometry::{Camera, Lens, Mesh, Pose, TriangleBvh};
use intima::lod::clusters::{ClusterLod, Clusters, DEFAULT_SHADING_RAD, NO_GROUP};
use intima::lod::vds::{ParameterizedOriginal, SubdivisionSurface, Vds, VdsOptions};
use intima::lod::{LodHierarchy, LodStep, PageCache, Tolerance};
use intima::lumen::{IntensitySelection, SegmentationOptions};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::surface::{Midpoint, Surface, shading};

/// Steps of a few cameras, as many pages as are needed.
fn steps(lod: &mut dyn LodHierarchy, mesh: &Mesh) -> Vec<LodStep> {
    let cache = &mut PageCache::new(40_000, 400, 2);
    let centre = mesh.positions.iter().sum::<glam::Vec3>() / mesh.positions.len() as f32;
    let lens = Lens { fov_y_rad: 1.5, aspect: 4.0 / 3.0, near_mm: 0.2 };
    let one = |k: usize| {
        let at = mesh.positions[k * mesh.positions.len() / 8];
        let pose = Pose::looking(at.lerp(centre, 0.05), centre - at, glam::Vec3::Z);
        cache.begin_step();
        lod.step(&Camera { pose, lens, height_px: 240 }, &Tolerance { pixels: 1.0 }, cache)
    };
    (0..8).map(one).collect()
}

fn lumen_mesh() -> Mesh {
    let options = SegmentationOptions {
        all_components: true,
        ..SegmentationOptions::new(IntensitySelection::Labels(vec![1]))
    };
    let (lumen, _) = options.apply(&volumes::oblique_two_piece()).unwrap();
    let surface = Surface::new(&lumen, &Midpoint, None);
    assert!(surface.topology.faces >= 200_000 && surface.topology.components == 2);
    surface.mesh
}

fn at_any_thread_count<T: PartialEq + Send>(make: impl Fn() -> T + Sync) {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(&make)
    };
    let want = on(1);
    for threads in [3, 8] {
        assert!(on(threads) == want, "differs at {threads} threads");
    }
}

#[test]
fn clusters_of_an_oblique_two_piece_lumen_are_byte_equal_at_1_3_and_8_threads() {
    let mesh = lumen_mesh();
    let vertices = shading(&mesh).vertices;
    at_any_thread_count(|| {
        let clusters =
            Arc::new(Clusters::build(&mesh, &vertices, &TriangleBvh::new(&mesh)).unwrap());
        // Several levels: groups made of the clusters of other groups.
        let made_by = |c: &u32| clusters.clusters()[*c as usize].output_of;
        let below =
            |g: &u32| clusters.inputs(*g).iter().map(made_by).filter(|g| *g != NO_GROUP).max();
        let top = clusters.groups().len() as u32 - 1;
        let levels = std::iter::successors(Some(top), below).count();
        assert!(levels > 2, "{levels} levels");
        let mut lod = ClusterLod::new(Arc::clone(&clusters), DEFAULT_SHADING_RAD);
        (clusters.to_bytes(), steps(&mut lod, &mesh))
    });
}

#[test]
fn subdivision_of_an_oblique_two_piece_lumen_is_byte_equal_at_1_3_and_8_threads() {
    let mesh = lumen_mesh();
    let vertices = shading(&mesh).vertices;
    let mut maps = Parameterization::new(&mesh).unwrap();
    let base = simplify(&mesh, &SimplifyOptions::to_faces(1500), &mut maps).unwrap();
    let tree = TriangleBvh::new(&mesh);
    at_any_thread_count(|| {
        let original = ParameterizedOriginal::new(&mesh, &vertices, &tree, &base, &maps);
        let surface =
            SubdivisionSurface::new(&base.mesh, &original, VdsOptions::default()).unwrap();
        assert!(surface.patches().patches() > 2 * base.mesh.faces.len());
        let patches = surface.patches().vertex_bytes().to_vec();
        (patches, steps(&mut Vds::new(Arc::new(surface)), &mesh))
    });
}

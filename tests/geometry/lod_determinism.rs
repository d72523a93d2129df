//! Levels of detail have the same bytes at any number of threads, on a lumen that is hard on every
//! assumption about grids.

use std::sync::Arc;

use common::volumes;
use intima::geometry::{Camera, Lens, Mesh, Pose, TriangleBvh};
use intima::lod::vds::{ParameterizedOriginal, SubdividedWall, SubdivisionSurface, VdsOptions};
use intima::lod::{CulledWall, DrawnWall, FaceOctree, Tolerance, VisibleWall};
use intima::lumen::{IntensitySelection, SegmentationOptions};
use intima::mesh::{Parameterization, SimplifyOptions, simplify};
use intima::surface::{Midpoint, Surface, shading};

/// What a few cameras see.
fn seen(wall: &dyn DrawnWall, mesh: &Mesh) -> Vec<VisibleWall> {
    let centre = mesh.positions.iter().sum::<glam::Vec3>() / mesh.positions.len() as f32;
    let lens = Lens { fov_y_rad: 1.5, aspect: 4.0 / 3.0, near_mm: 0.2 };
    let one = |k: usize| {
        let at = mesh.positions[k * mesh.positions.len() / 8];
        let pose = Pose::looking(at.lerp(centre, 0.05), centre - at, glam::Vec3::Z);
        wall.visible(&Camera { pose, lens, height_px: 240 })
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
fn culling_of_an_oblique_two_piece_lumen_is_equal_at_1_3_and_8_threads() {
    let mesh = lumen_mesh();
    at_any_thread_count(|| {
        let wall = CulledWall { octree: Arc::new(FaceOctree::new(&mesh)), closed: None };
        (wall.octree.indices(&mesh.faces), seen(&wall, &mesh))
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
        let wall = SubdividedWall::new(Arc::new(surface), Tolerance { pixels: 1.0 }, None);
        (patches, seen(&wall, &mesh))
    });
}

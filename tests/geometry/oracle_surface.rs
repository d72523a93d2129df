//! The extracted surface against counts made on the mask alone, and against scikit-image's mesh.

use common::fixtures::{int, lumen, mask, masks, real};
use intima::lumen::{IntensitySelection, Lumen, SegmentationOptions};
use intima::surface::{Midpoint, Surface};
use serde_json::Value;

/// The voxels of a mask: as a label, parts that touch by edges would be joined.
const SELECTED: IntensitySelection = IntensitySelection::Range { lo: 1.0, hi: f64::INFINITY };

fn assert_counts(lumen: &Lumen, want: &Value, what: &str) {
    let t = Surface::new(lumen, &Midpoint, None).topology;
    assert_eq!(t.vertices as i64, int(&want["vertices"]), "{what}: vertices");
    assert_eq!(t.euler, int(&want["euler"]), "{what}: Euler number");
    assert_eq!(t.faces as i64, int(&want["faces"]), "{what}: faces");
    assert!(t.watertight, "{what}: not closed");
}

#[test]
fn vertices_faces_and_euler_number_are_those_counted_on_the_mask() {
    for (name, want) in masks() {
        assert_counts(&lumen(&name), &want["surface"], &name);
        if int(&want["inside"]) == 0 {
            continue;
        }
        let options =
            SegmentationOptions { all_components: true, ..SegmentationOptions::new(SELECTED) };
        let filled = options.apply(&mask(&name)).unwrap().0;
        assert_counts(&filled, &want["filled"]["surface"], &format!("{name}, filled"));
        let one =
            SegmentationOptions { all_components: false, ..options }.apply(&mask(&name)).unwrap().0;
        assert_counts(&one, &want["largest_filled"]["surface"], &format!("{name}, largest"));
    }
}

#[test]
fn area_and_volume_are_scikit_images_and_vtks_where_no_face_is_ambiguous() {
    // The other table cuts some polygons along other diagonals: area may differ by a percent, and
    // volume by what moving the whole surface by a hundredth of a voxel would do.
    let mut compared = 0;
    for (name, want) in masks() {
        let vtk = want.get("flying_edges").cloned();
        let (Some(want), Some(vtk)) = (want.get("lorensen"), vtk) else { continue };
        let lumen = lumen(&name);
        let mesh = Surface::new(&lumen, &Midpoint, None).mesh;
        assert_eq!(mesh.positions.len() as i64, int(&want["vertices"]), "{name}");
        assert_eq!(mesh.faces.len() as i64, int(&want["faces"]), "{name}");
        let area = mesh.area_mm2() / real(&want["area_mm2"]) - 1.0;
        let moved = (mesh.volume_mm3() - real(&want["volume_mm3"])) / real(&want["area_mm2"]);
        let moved = moved / lumen.grid.spacing_mm.min_element();
        assert_eq!(mesh.positions.len() as i64, int(&vtk["vertices"]), "{name}");
        assert_eq!(mesh.faces.len() as i64, int(&vtk["faces"]), "{name}");
        let to_vtk = mesh.area_mm2() / real(&vtk["area_mm2"]) - 1.0;
        assert!(to_vtk.abs() <= 0.01, "{name}: area differs from VTK's by {to_vtk}");
        println!("{name}: area {:+.3} %, moved {moved:+.4} voxel", 100.0 * area);
        assert!(area.abs() <= 0.01, "{name}: area is off by {area}");
        assert!(moved.abs() <= 0.01, "{name}: the wall moved by {moved} voxel");
        compared += 1;
    }
    assert!(compared >= 5, "{compared}");
}

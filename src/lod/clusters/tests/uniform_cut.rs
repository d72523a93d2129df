//! Uniform cuts.

use super::*;

#[test]
fn uniform_cuts_are_watertight_and_within_their_error_bound() {
    let (mesh, clusters) = &*RING;
    let all = mesh.faces.len() as u64;
    let original = TriangleBvh::new(mesh);
    let mut before = (u64::MAX, 0.0);
    for wanted in [all + 1, all, all / 2, all / 5, all / 20, 1] {
        let (cut, error_mm) = clusters.uniform_cut(wanted);
        let count = cut.faces.len() as u64;
        assert!(count >= wanted.min(all) && count <= before.0, "{count} faces for {wanted}");
        assert!(error_mm >= before.1, "{count} faces: {error_mm} mm");
        before = (count, error_mm);
        assert_eq!(tears(cut.faces.iter().copied()), 0);
        assert_eq!(cut.normals.len(), cut.positions.len());
        let back = TriangleBvh::new(&cut);
        let away = |bvh: &TriangleBvh, p: &Vec3| bvh.closest(p.as_dvec3()).unwrap().distance_mm;
        let there = cut.positions.iter().map(|p| away(&original, p));
        let far = there.chain(mesh.positions.iter().map(|p| away(&back, p))).fold(0.0, f64::max);
        assert!(far <= f64::from(error_mm) + 1e-5, "{far} mm, not {error_mm}");
    }
    assert!(before.0 < all / 20 && before.1 > 0.0);
    let (same, error_mm) = clusters.uniform_cut(all);
    assert_eq!((same.faces.len(), error_mm), (mesh.faces.len(), 0.0));
}

//! The distance transform against SciPy's, on every fixture mask.

#[path = "common/fixtures.rs"]
mod common;

use common::{devices, lumen, masks, path, volume};
use intima::compute::Plan;
use intima::field::{LumenBuffers, distance};

#[test]
fn distance_is_scipys_and_its_isotropic_square_is_exact() {
    for mut device in devices() {
        let name_of_device = device.name().to_owned();
        let (mut worst, mut compared, mut squares) = (0.0f64, 0usize, 0usize);
        for (name, _) in masks() {
            let lumen = lumen(&name);
            let want = volume(&format!("mask/{name}.edt.nrrd"));
            let mut plan = Plan::new();
            let buffers = LumenBuffers::new(&mut plan, &lumen);
            let d = distance(&mut plan, &buffers);
            plan.download(d);
            let out = device.run(&plan).unwrap();
            let d = lumen.dense(out.get(d), 0.0);
            let square = format!("mask/{name}.edt2.nrrd");
            let square = path(&square).exists().then(|| volume(&square));
            let h = lumen.grid.spacing_mm;
            assert_eq!(square.is_some(), h.x == h.y && h.y == h.z, "{name}");
            for (i, &d) in d.iter().enumerate() {
                let (d, want) = (f64::from(d), want.real(i));
                let at = format!("{name} on {name_of_device}, voxel {}", lumen.grid.voxel(i));
                let error = (d - want).abs();
                assert!(error <= 1e-6 * want, "{at}: {d}, not {want}");
                worst = worst.max(error / want.max(1.0));
                compared += usize::from(want > 0.0);
                if let Some(square) = &square {
                    let got = (d / h.x).powi(2);
                    assert_eq!(got.round(), square.real(i), "{at}: {got}");
                    squares += usize::from(got > 0.0);
                }
            }
        }
        println!("{name_of_device}: {compared} voxels, {squares} squares, worst {worst:.1e}");
        assert!(compared > 40_000 && squares > 20_000, "{compared}, {squares}");
    }
}

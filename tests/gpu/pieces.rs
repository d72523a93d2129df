//! Plans are submitted in pieces, and what comes out does not depend on how many there were.

use std::time::Duration;

use intima::compute::{Outputs, Plan};
use intima::field::{LumenBuffers, distance, smooth};
use intima::kernels::fair;
use intima::lumen::{BitVolume, IntensitySelection, Lumen, SegmentationOptions};
use intima::paper::ridge;
use intima::task::CancelToken;
use intima::vk::{Gpu, RunOptions, Validate, VkError};
use intima::volume::Grid;
use intima::volume::phantom::{Kind, Phantom};

fn colon(size: u32) -> Lumen {
    let mask = Phantom::new(Kind::Colon, size, [1.0; 3]).unwrap().mask();
    SegmentationOptions::new(IntensitySelection::Labels(vec![])).apply(&mask).unwrap().0
}

/// Mask to ridge candidates, all of it read back.
fn chain(lumen: &Lumen) -> Plan<'_> {
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let d = distance(&mut plan, &buffers);
    let s = smooth(&mut plan, &buffers, d, 1.0, None);
    ridge(&mut plan, &buffers, d, s, 100_000);
    plan.download(d);
    plan.download(s);
    plan
}

/// More workgroups than fit one dimension.
fn folded() -> Plan<'static> {
    let vertices = 65_535 * 64 + 1000;
    let mut plan = Plan::new();
    let start: Vec<u32> = (0..=vertices).collect();
    let near: Vec<u32> = (0..vertices).map(|v| (v * 7 + 1) % vertices).collect();
    let normals: Vec<f32> = (0..3 * vertices).map(|i| (i % 17) as f32 - 8.1).collect();
    let start = plan.upload_owned("start", &start);
    let near = plan.upload_owned("near", &near);
    let weight = plan.upload_owned("weight", &vec![1.0f32; vertices as usize]);
    let normal = plan.upload_owned("normal", &normals);
    let faired = plan.zeroed::<f32>("faired", 3 * vertices as usize);
    let bindings = fair::Bindings { start, near, weight, normal, faired };
    let (params, n) = (fair::Params { vertices, lambda: 0.5 }, vertices as usize);
    plan.launch(&fair::KERNEL, bindings, params, n, n);
    plan.download(faired);
    plan
}

fn run(gpu: &mut Gpu, plan: &Plan<'_>, piece: Option<Duration>) -> (Outputs, u64) {
    let before = gpu.submissions();
    let out = gpu.run_with(plan, RunOptions { piece, ..Default::default() }).unwrap();
    (out, gpu.submissions() - before)
}

#[test]
fn a_plan_in_many_pieces_gives_the_bytes_of_one_submission() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let lumen = colon(128);
    let folded = folded();
    for (what, plan) in [("chain", &chain(&lumen)), ("folded", &folded)] {
        let (whole, one) = run(&mut gpu, plan, Some(Duration::MAX));
        // Where the host does not reach the device's memory, batches of inputs come before.
        assert!(one == 1 || gpu.info().is_real(), "{what}: {one}");
        // The second run knows how fast each kernel is, and a card is a hundred times as fast as
        // software.
        let seconds: f64 = whole.times.iter().map(|t| t.seconds).sum();
        let most = if seconds > 0.0 { seconds } else { 0.02 };
        // Small shares: the first run of a kernel may take ten times as long as the next.
        for share in [0.01, 0.01, 0.02] {
            let piece = Duration::from_secs_f64(share * most);
            let (cut, several) = run(&mut gpu, plan, Some(piece));
            println!("{what}: {several} submissions of {piece:?}");
            assert!(several > one, "{what}: {several}");
            for id in plan.downloads() {
                assert!(whole.words(*id) == cut.words(*id), "{what}: {id:?} at {piece:?}");
            }
            assert_eq!(whole.times.len(), cut.times.len());
        }
        let stamped = gpu.info().timestamp_period_ns > 0.0;
        let (_, small) = run(&mut gpu, plan, Some(Duration::from_micros(1)));
        assert!(small > plan.steps().len() as u64, "{what}: {small}");
        assert!(whole.times.iter().all(|t| !stamped || t.seconds > 0.0), "{what}");
    }
    common::assert_silent(&gpu);
}

#[test]
fn pieces_of_a_large_lumen_stay_short() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let lumen = colon(256);
    let plan = chain(&lumen);
    let (first, some) = run(&mut gpu, &plan, None);
    let (_, known) = run(&mut gpu, &plan, None);
    let longest = gpu.longest_piece();
    let all: f64 = first.times.iter().map(|t| t.seconds).sum();
    println!("{some} submissions, then {known}; the longest {longest:?} of {all:.3} s");
    // Loaded machines are slow now and then: this is five times what a piece should take.
    assert!(longest < Duration::from_millis(500), "{longest:?}");
    assert!(some > 1, "{some}");
}

#[test]
fn a_cancelled_token_ends_a_plan_between_pieces_and_leaves_nothing() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let lumen = colon(64);
    let plan = chain(&lumen);
    let (whole, _) = run(&mut gpu, &plan, Some(Duration::MAX));
    let token = CancelToken::default();
    token.enter();
    token.cancel();
    let (held, before) = (gpu.memory_held(), gpu.submissions());
    let cut = RunOptions { piece: Some(Duration::from_micros(1)), ..Default::default() };
    let outcome = gpu.run_with(&plan, cut);
    assert!(matches!(outcome, Err(VkError::Cancelled)), "{:?}", outcome.map(|_| ()));
    assert_eq!(gpu.submissions() - before, 1, "the piece at hand is ended, no other begun");
    token.reset();
    let (again, _) = run(&mut gpu, &plan, Some(Duration::from_micros(200)));
    for id in plan.downloads() {
        assert!(whole.words(*id) == again.words(*id), "{id:?}");
    }
    assert!(gpu.memory_held() <= held.max(1));
    common::assert_silent(&gpu);
}

/// Bricks in the middle of a full volume take many times as long as those at its faces, which come
/// first.
#[test]
fn pieces_of_a_full_volume_stay_short() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let grid = Grid::axis_aligned([256; 3], [1.0; 3]);
    let lumen = Lumen::of_volume(grid, &BitVolume::new(grid.dims).inverted());
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, &lumen);
    let d = distance(&mut plan, &buffers);
    plan.download(d);
    for round in ["unknown", "known"] {
        let (out, pieces) = run(&mut gpu, &plan, None);
        let longest = gpu.longest_piece();
        let all: f64 = out.times.iter().map(|t| t.seconds).sum();
        println!("{round}: {pieces} submissions; the longest {longest:?} of {all:.3} s");
        // Half of what a desktop's driver allows, on a machine that may be loaded.
        assert!(longest < Duration::from_secs(1), "{longest:?}");
    }
}

//! Memory of plans: shared between buffers, kept between plans, and filled through batches.

use intima::compute::{Array, Buf, DeviceCopy, Outputs, Plan, run_cpu};
use intima::field::{LumenBuffers, Response, distance, hessian, smooth};
use intima::kernels::copy;
use intima::lumen::{IntensitySelection, Lumen, SegmentationOptions};
use intima::paper::ridge;
use intima::vk::{Gpu, PlanCounts, RunOptions, Validate};
use intima::volume::phantom::{Kind, Phantom};

use crate::cases;

fn colon(size: u32) -> Lumen {
    let mask = Phantom::new(Kind::Colon, size, [1.0; 3]).unwrap().mask();
    SegmentationOptions::new(IntensitySelection::Labels(vec![])).apply(&mask).unwrap().0
}

/// Copies of copies of some quads; every second one is read back.
fn copies(source: &[[u32; 4]], count: usize) -> (Plan<'_>, Vec<Buf<[u32; 4]>>) {
    let mut plan = Plan::new();
    let mut from = plan.upload("source", source);
    let mut back = Vec::new();
    for i in 0..count {
        let copied = plan.undefined("copied", source.len());
        let params = copy::Params { quads: source.len() as u32 };
        let bindings = copy::Bindings { source: from, copied };
        plan.launch(&copy::KERNEL, bindings, params, source.len(), source.len());
        from = copied;
        if i % 2 == 1 {
            plan.download(copied);
            back.push(copied);
        }
    }
    (plan, back)
}

/// What one plan asked of the device, and the least.
fn counted(gpu: &mut Gpu, plan: &Plan<'_>) -> (Outputs, [PlanCounts; 2]) {
    let before = gpu.plan_counts();
    let out = gpu.run(plan).unwrap();
    let after = gpu.plan_counts();
    (out, [0, 1].map(|i| after[i].since(&before[i])))
}

#[test]
fn inputs_and_results_larger_than_a_batch_come_back_whole() {
    let Some(mut gpu) = common::staging_gpu(Validate::Sync) else { return };
    // 40 MiB in, 80 MiB out; ends that are no multiple of a batch.
    let quads: Vec<[u32; 4]> =
        (0..(40 << 16) + 37).map(|i: u32| [i, !i, i.wrapping_mul(2_654_435_761), 7]).collect();
    let (plan, back) = copies(&quads, 4);
    for _ in 0..2 {
        let (out, [took, least]) = counted(&mut gpu, &plan);
        for b in &back {
            assert!(out.get(*b) == &quads[..]);
        }
        assert_eq!(took.uploaded_bytes, least.uploaded_bytes);
        assert_eq!(took.read_back_bytes, least.read_back_bytes);
        assert_eq!(took.copied_bytes, least.copied_bytes);
        assert_eq!((took.cleared_bytes, least.cleared_bytes), (0, 0));
    }
    common::assert_silent(&gpu);
}

#[test]
fn a_plan_like_the_one_before_takes_no_memory_and_one_submission() {
    for staged in [false, true] {
        let opened =
            if staged { common::staging_gpu(Validate::Sync) } else { common::gpu(Validate::Sync) };
        let Some(mut gpu) = opened else { return };
        let quads = vec![[3u32; 4]; 5000];
        let (plan, _) = copies(&quads, 6);
        counted(&mut gpu, &plan);
        counted(&mut gpu, &plan);
        let (_, [took, least]) = counted(&mut gpu, &plan);
        assert_eq!((took.allocations, took.submissions, took.waits), (0, 1, 1), "{took:?}");
        assert_eq!(took.cleared_bytes, 0);
        assert_eq!(took.copied_bytes, least.copied_bytes);
        // Source, results so far and the copy in progress, not seven buffers.
        assert!(took.arena_bytes < 6 * 80_000 && took.arena_bytes >= least.arena_bytes, "{took:?}");
        common::assert_silent(&gpu);
    }
}

/// A copy of `source`, which stays on the device as `from`, and stays there itself as `to`.
fn kept_copy<'a>(
    source: &'a [[u32; 4]],
    [from, to]: [&'a DeviceCopy; 2],
) -> (Plan<'a>, Buf<[u32; 4]>) {
    let mut plan = Plan::new();
    let from = plan.upload_kept("source", source, from);
    let copied = plan.undefined("copied", source.len());
    let params = copy::Params { quads: source.len() as u32 };
    let bindings = copy::Bindings { source: from, copied };
    plan.launch(&copy::KERNEL, bindings, params, source.len(), source.len());
    plan.download_kept(copied, to);
    (plan, copied)
}

/// A plan uploads neither what an earlier one has uploaded nor what it has computed.
#[test]
fn arrays_that_stay_on_the_device_are_uploaded_once() {
    for staged in [false, true] {
        let opened =
            if staged { common::staging_gpu(Validate::Sync) } else { common::gpu(Validate::Sync) };
        let Some(mut gpu) = opened else { return };
        let before = gpu.live_resources();
        let quads: Vec<[u32; 4]> = (0..3_000_000).map(|i| [i, !i, i ^ 77, 5]).collect();
        let bytes = size_of_val(&quads[..]) as u64;
        {
            let copies: [DeviceCopy; 3] = Default::default();
            let (plan, copied) = kept_copy(&quads, [&copies[0], &copies[1]]);
            let (mut out, [took, _]) = counted(&mut gpu, &plan);
            assert_eq!((took.uploaded_bytes, took.read_back_bytes), (bytes, bytes));
            let first: Array<[u32; 4]> = out.take(copied);
            assert!(first[..] == quads[..]);
            // The input again, then the result as an input, which is read back too.
            let none = DeviceCopy::default();
            for (source, from, to) in [(&quads[..], 0, &none), (&first[..], 1, &copies[2])] {
                let (mut plan, copied) = kept_copy(source, [&copies[from], to]);
                let kept = plan.upload_kept("read back", source, &copies[from]);
                plan.download(kept);
                let (out, [took, least]) = counted(&mut gpu, &plan);
                assert_eq!((took.uploaded_bytes, least.uploaded_bytes), (0, 0), "from {from}");
                assert!(out.get(copied) == &quads[..] && out.get(kept) == &quads[..]);
            }
            // Source, result, that of its copy and the one nobody asks for again.
            assert_eq!(gpu.live_resources(), before + 4);
            // The CPU and another device have no use for the copy.
            let (plan, copied) = kept_copy(&quads, [&copies[0], &none]);
            assert!(run_cpu(&plan).get(copied) == &quads[..]);
            let Some(mut other) = common::gpu(Validate::Sync) else { return };
            let (out, [took, _]) = counted(&mut other, &plan);
            assert!(out.get(copied) == &quads[..] && took.uploaded_bytes == bytes);
            common::assert_silent(&other);
        }
        counted(&mut gpu, &copies(&quads[..1], 1).0);
        assert_eq!(gpu.live_resources(), before, "the copies are gone");
        common::assert_silent(&gpu);
    }
}

#[test]
#[should_panic(expected = "copy of another array")]
fn a_copy_of_another_array_is_refused() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { panic!("copy of another array") };
    let (quads, kept) = (vec![[1u32; 4]; 100], DeviceCopy::default());
    gpu.run(&kept_copy(&quads, [&kept, &DeviceCopy::default()]).0).unwrap();
    let _ = gpu.run(&kept_copy(&quads[..99], [&kept, &DeviceCopy::default()]).0);
}

#[test]
fn a_chain_takes_less_memory_than_its_buffers() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let lumen = colon(96);
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, &lumen);
    let d = distance(&mut plan, &buffers);
    let s = smooth(&mut plan, &buffers, d, 1.0, None);
    let out = hessian(&mut plan, &buffers, s, Response::Ridge, false, u64::MAX)[0];
    plan.download(out);
    let all: u64 = plan.buffers().iter().map(|b| b.bytes as u64).sum();
    let (got, [took, least]) = counted(&mut gpu, &plan);
    println!("{all} bytes of buffers, {} taken, {} least", took.arena_bytes, least.arena_bytes);
    assert!(took.arena_bytes < all * 6 / 10, "{} of {all}", took.arena_bytes);
    let want = run_cpu(&plan);
    let apart = want.get(out).iter().zip(got.get(out)).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 2e-3);
    common::assert_silent(&gpu);
}

/// Undefined contents are never read: whatever they are, the results are the same.
#[test]
fn nonsense_in_undefined_buffers_changes_no_result() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let (mut filled, lumen) = (0, colon(64));
    let mut chain = Plan::new();
    let buffers = LumenBuffers::new(&mut chain, &lumen);
    let d = distance(&mut chain, &buffers);
    let s = smooth(&mut chain, &buffers, d, 1.0, None);
    ridge(&mut chain, &buffers, d, s, 10_000);
    let kernels = cases::all().flat_map(|(_, cases)| cases).map(|case| case.plan);
    for plan in kernels.chain([chain]) {
        let plain = gpu.run(&plan).unwrap();
        let before = gpu.plan_counts()[0].cleared_bytes;
        let nonsense =
            gpu.run_with(&plan, RunOptions { nonsense: true, ..Default::default() }).unwrap();
        filled += gpu.plan_counts()[0].cleared_bytes - before;
        for id in plan.downloads() {
            let name = plan.buffers()[id.0 as usize].name;
            assert!(plain.words(*id) == nonsense.words(*id), "{name}");
        }
    }
    assert!(filled > 0);
    common::assert_silent(&gpu);
}

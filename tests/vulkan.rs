//! The Vulkan room itself: that validation would see our faults, and that failures have types.

#[path = "common/child.rs"]
mod child;
mod common;

use intima::compute::{Buf, Kernel, Plan, Shader, run_cpu, worst};
use intima::device::{Device, DeviceChoice};
use intima::kernels::fair::{Bindings, KERNEL, Params};
use intima::vk::{
    BufferId, Choice, Frame, FrameOptions, Gpu, OpenOptions, RunOptions, STAGING_BYTES, Validate,
    VkError, Write,
};

/// A ring of vertices, faired `rounds` times; the output has room for `room` vertices.
fn ring(
    kernel: &'static Kernel,
    vertices: u32,
    room: u32,
    rounds: usize,
) -> (Plan<'static>, Buf<f32>) {
    let around = |v: u32| [(v + vertices - 1) % vertices, (v + 1) % vertices];
    let near: Vec<u32> = (0..vertices).flat_map(around).collect();
    let start: Vec<u32> = (0..=vertices).map(|v| 2 * v).collect();
    let normal = |v: u32| {
        let a = v as f32 * 0.37;
        glam::Vec3::new(a.cos(), a.sin(), (3.0 * a).sin()).normalize().to_array()
    };
    let normals: Vec<f32> = (0..vertices).flat_map(normal).collect();
    let mut plan = Plan::new();
    let start = plan.upload_owned("start", &start);
    let weight = plan.upload_owned("weight", &vec![0.5f32; near.len()]);
    let near = plan.upload_owned("near", &near);
    let mut from = plan.upload_owned("normal", &normals);
    for _ in 0..rounds {
        let faired = plan.zeroed::<f32>("faired", 3 * room as usize);
        let bindings = Bindings { start, near, weight, normal: from, faired };
        let threads = vertices as usize;
        plan.launch(kernel, bindings, Params { vertices, lambda: 0.5 }, threads, threads);
        from = faired;
    }
    plan.download(from);
    (plan, from)
}

#[test]
fn a_missing_barrier_is_reported_and_a_present_one_is_not() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let (plan, _) = ring(&KERNEL, 1000, 1000, 3);
    gpu.run(&plan).unwrap();
    common::assert_silent(&gpu);
    gpu.run_with(&plan, RunOptions { skip_barriers: true }).unwrap();
    let said = gpu.validation_messages();
    assert!(said.iter().any(|m| m.contains("SYNC-HAZARD")), "validation saw nothing: {said:?}");
}

#[test]
fn a_write_past_a_buffer_is_reported_and_one_within_is_not() {
    let Some(mut gpu) = common::gpu(Validate::GpuAssisted) else { return };
    gpu.run(&ring(&KERNEL, 64, 64, 1).0).unwrap();
    common::assert_silent(&gpu);
    // Four vertices have no room. They fall into memory of the same block that nothing else uses.
    let (plan, _) = ring(&KERNEL, 64, 60, 1);
    let _ = gpu.run(&plan);
    let said = gpu.validation_messages();
    assert!(said.iter().any(|m| m.contains("ut of bounds")), "validation saw nothing: {said:?}");
}

/// A frame that does nothing but write `bytes` zeros at `offset`.
fn written(to: BufferId, offset: u64, bytes: usize) -> Write<'static> {
    Write { to, offset, bytes: vec![0; bytes].into() }
}

#[test]
fn a_missing_barrier_between_writes_to_one_place_is_reported() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let to = gpu.empty_vertices("vertices", 4096).unwrap();
    let frame = Frame { writes: vec![written(to, 0, 512)], ..Frame::default() };
    // Within one submission, which is as far as older layers look.
    let options = FrameOptions { write_twice: true, ..FrameOptions::default() };
    gpu.submit_draws_with(&frame, options).unwrap();
    gpu.submit_draws(&frame).unwrap();
    common::assert_silent(&gpu);
    gpu.submit_draws_with(&frame, FrameOptions { skip_barriers: true, ..options }).unwrap();
    let said = gpu.validation_messages();
    assert!(said.iter().any(|m| m.contains("SYNC-HAZARD")), "validation saw nothing: {said:?}");
}

#[test]
fn writes_that_overlap_or_pass_the_end_are_refused_before_anything_is_recorded() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let vertices = gpu.empty_vertices("vertices", 4096).unwrap();
    let indices = gpu.empty_indices("indices", 100, 50).unwrap();
    let mut refused = |writes: Vec<Write<'static>>| {
        let frame = Frame { writes, ..Frame::default() };
        let send = || gpu.submit_draws(&frame);
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(send)).is_err()
    };
    let touching = vec![written(vertices, 0, 100), written(vertices, 100, 100)];
    assert!(!refused(touching));
    assert!(!refused(vec![written(vertices, 0, 100), written(indices, 0, 100)]));
    assert!(refused(vec![written(vertices, 0, 101), written(vertices, 100, 100)]));
    assert!(refused(vec![written(vertices, 4000, 97)]));
    assert!(refused(vec![written(vertices, u64::MAX, 2)]));
    assert!(refused(vec![written(indices, 1, 2)]));
    common::assert_silent(&gpu);
}

#[test]
fn a_frame_larger_than_the_staging_ring_is_refused_and_smaller_ones_take_turns() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let huge = (STAGING_BYTES + 4) as usize;
    let to = gpu.empty_vertices("vertices", huge as u64).unwrap();
    let frame = |bytes| Frame { writes: vec![written(to, 0, bytes)], ..Frame::default() };
    match gpu.submit_draws(&frame(huge)) {
        Err(VkError::StagingFull { bytes, budget }) => assert_eq!(bytes - 4, budget),
        other => panic!("{other:?}"),
    }
    assert!(matches!(gpu.make_room(huge as u64), Err(VkError::StagingFull { .. })));
    assert_eq!(gpu.staging_held(), 0);
    // A third of the ring each: the fourth of every round waits for the first.
    let third = (STAGING_BYTES / 3) as usize;
    for _ in 0..10 {
        gpu.make_room(third as u64).unwrap();
        gpu.submit_draws(&frame(third)).unwrap();
    }
    let held = gpu.staging_held();
    assert!(held >= third as u64 && held <= STAGING_BYTES, "{held}");
}

/// `fair` with the constant 1 of its shader made a little larger.
fn planted() -> &'static Kernel {
    let mut spirv = KERNEL.shader.spirv.to_vec();
    let one = 1.0f32.to_ne_bytes();
    let mut patched = 0;
    // OpConstant: opcode 43, four words, the value last.
    let op = (4u32 << 16 | 43).to_ne_bytes();
    for at in (20..spirv.len() - 12).step_by(4) {
        if spirv[at..at + 4] == op && spirv[at + 12..at + 16] == one {
            spirv[at + 12..at + 16].copy_from_slice(&1.001f32.to_ne_bytes());
            patched += 1;
        }
    }
    assert_eq!(patched, 1, "the shader has one constant 1");
    let shader = KERNEL.shader;
    Box::leak(Box::new(Kernel {
        shader: Box::leak(Box::new(Shader {
            name: shader.name,
            spirv: spirv.leak(),
            workgroup: shader.workgroup,
            params_size: shader.params_size,
            bindings: shader.bindings,
        })),
        twin: KERNEL.twin,
        unit: KERNEL.unit,
        tolerance: KERNEL.tolerance,
        cases: KERNEL.cases,
    }))
}

#[test]
fn a_fault_planted_in_one_kernel_is_caught() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    for (kernel, fine) in [(&KERNEL, true), (planted(), false)] {
        let (plan, out) = ring(kernel, 1000, 1000, 1);
        let (want, got) = (run_cpu(&plan), gpu.run(&plan).unwrap());
        let verdict = worst(want.get(out), got.get(out), kernel.tolerance);
        assert_eq!(verdict.is_ok(), fine, "{verdict:?}");
    }
}

#[test]
fn every_launch_has_a_time_and_what_no_launch_touches_comes_back() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let (mut plan, _) = ring(&KERNEL, 200_000, 200_000, 3);
    let idle = plan.upload_owned("idle", &[1u32, 2, 3]);
    let zero = plan.zeroed::<u32>("zero", 5);
    let none = plan.zeroed::<u32>("none", 0);
    plan.download(idle);
    plan.download(zero);
    plan.download(none);
    let out = gpu.run(&plan).unwrap();
    assert_eq!(out.times.len(), 3);
    let stamped = gpu.info().timestamp_period_ns > 0.0;
    for t in &out.times {
        assert!(!stamped || (t.seconds > 0.0 && t.seconds < 10.0), "{t:?}");
    }
    assert_eq!(out.get(idle), [1, 2, 3]);
    assert_eq!(out.get(zero), [0; 5]);
    assert!(out.get(none).is_empty());
    let empty = gpu.run(&Plan::new()).unwrap();
    assert!(empty.times.is_empty());
    common::assert_silent(&gpu);
}

#[test]
fn more_groups_than_one_dimension_holds_are_folded() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    let vertices = 65_535 * 64 + 1000;
    let (plan, out) = ring(&KERNEL, vertices, vertices, 1);
    let (want, got) = (run_cpu(&plan), gpu.run(&plan).unwrap());
    worst(want.get(out), got.get(out), KERNEL.tolerance).unwrap();
}

#[test]
fn a_buffer_the_device_cannot_bind_is_refused_before_anything_is_done() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let limit = gpu.info().max_storage_buffer_range.min(gpu.info().max_buffer_bytes);
    let mut plan = Plan::new();
    let few = plan.upload_owned("few", &[0u32]);
    let huge = plan.zeroed::<f32>("huge", (limit / 4 + 1) as usize);
    let some = plan.zeroed::<f32>("some", 4);
    let bindings = Bindings { start: few, near: few, weight: some, normal: some, faired: huge };
    plan.launch(&KERNEL, bindings, Params { vertices: 0, lambda: 0.5 }, 1, 1);
    match gpu.run(&plan) {
        Err(VkError::TooLarge { buffer: "huge", bytes, limit: said, .. }) => {
            assert_eq!((bytes, said), (4 * (limit / 4 + 1), limit));
        }
        other => panic!("{:?}", other.map(|_| ())),
    }
    common::assert_silent(&gpu);
}

#[test]
fn a_device_that_is_not_there_is_named() {
    let Some(_) = common::gpu(Validate::Off) else { return };
    let e = Gpu::open(Choice::Index(99)).err().expect("no hundredth device");
    assert!(e.is_no_device() && e.to_string().contains("gpu:99"), "{e}");
}

#[test]
fn pipelines_are_kept_on_disk_and_a_damaged_file_does_no_harm() {
    let Some(_) = common::gpu(Validate::Off) else { return };
    let dir = tempfile::tempdir().unwrap();
    let options = OpenOptions {
        validate: Validate::Off,
        cache_dir: Some(dir.path().join("cache")),
        ..OpenOptions::default()
    };
    let once = || {
        let mut gpu = Gpu::open_with(Choice::Any, options.clone()).unwrap();
        gpu.run(&ring(&KERNEL, 100, 100, 1).0).unwrap();
    };
    once();
    // Some drivers have nothing worth keeping; where there is a file, spoil it.
    for file in std::fs::read_dir(dir.path().join("cache")).into_iter().flatten() {
        let path = file.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 0xff;
        std::fs::write(&path, bytes).unwrap();
    }
    once();
}

#[test]
#[ignore = "runs in a process of its own, started by the tests below"]
fn child_opens_devices() {
    let kind = |e: &VkError| match e {
        VkError::NoLibrary(_) => "no library",
        VkError::NoDriver => "no driver",
        VkError::NoDevice { .. } => "no device",
        _ => "other",
    };
    match Gpu::open(Choice::Any) {
        Ok(_) => println!("child: gpu opened"),
        Err(e) => println!("child: gpu {} {}", e.is_no_device(), kind(&e)),
    }
    match Device::open(DeviceChoice::Auto) {
        Ok(d) => println!("child: auto {}", d.name()),
        Err(e) => println!("child: auto failed: {e}"),
    }
}

#[test]
fn a_machine_without_a_driver_computes_on_the_cpu() {
    let Some(_) = common::gpu(Validate::Off) else { return };
    let none = [("VK_DRIVER_FILES", "/nowhere.json"), ("VK_ICD_FILENAMES", "/nowhere.json")];
    let out = child::run("child_opens_devices", &none);
    assert_eq!(child::said(&out), ["gpu true no driver", "auto cpu"]);
}

#[test]
#[cfg(target_os = "linux")]
fn a_machine_without_the_library_computes_on_the_cpu() {
    // A library that is no library, found before the real one.
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("libvulkan.so.1"), "not a library").unwrap();
    let path = dir.path().to_str().unwrap();
    let out = child::run("child_opens_devices", &[("LD_LIBRARY_PATH", path)]);
    assert_eq!(child::said(&out), ["gpu true no library", "auto cpu"]);
}

#[cfg(feature = "faults")]
mod faults {
    use super::*;

    #[test]
    #[ignore = "runs in a process of its own, started by the test below"]
    fn child_runs_a_plan() {
        let options =
            OpenOptions { validate: Validate::Sync, cache_dir: None, ..OpenOptions::default() };
        let mut gpu = match Gpu::open_with(Choice::Any, options) {
            Ok(gpu) => gpu,
            Err(VkError::NoDriver) => return println!("child: no driver"),
            Err(e) => return println!("child: {e}"),
        };
        let said = match gpu.run(&ring(&KERNEL, 1000, 1000, 2).0) {
            Ok(_) => "done".into(),
            Err(VkError::OutOfMemory { what, .. }) => format!("out of memory for {what}"),
            Err(VkError::DeviceLost { during }) => format!("lost during {during}"),
            Err(e) => e.to_string(),
        };
        println!("child: {said}; {} messages", gpu.validation_messages().len());
    }

    #[test]
    fn planted_faults_come_back_typed_and_leave_nothing_behind() {
        let Some(_) = common::gpu(Validate::Sync) else { return };
        for (fault, want) in [
            ("none:1", "done; 0 messages"),
            ("instance:1", "no driver"),
            ("allocate:1", "out of memory for start; 0 messages"),
            ("allocate:3", "out of memory for near; 0 messages"),
            ("submit:1", "lost during vkQueueSubmit2; 0 messages"),
        ] {
            let out = child::run("faults::child_runs_a_plan", &[("INTIMA_FAULT", fault)]);
            assert_eq!(child::said(&out), [want], "{fault}");
        }
    }
}

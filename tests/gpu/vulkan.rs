//! The Vulkan room itself: that validation would see our faults, and that failures have types.

use common::child;
use intima::compute::{Buf, Kernel, Plan, run_cpu};
use intima::device::{Device, DeviceChoice};
use intima::kernels::fair::{Bindings, KERNEL, Params};
use intima::vk::{
    BufferId, Choice, Frame, FrameOptions, Gpu, OpenOptions, RunOptions, STAGING_BYTES, Validate,
    VkError, Write,
};

use crate::compare::worst;

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
        let faired = plan.undefined::<f32>("faired", 3 * room as usize);
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
    gpu.run_with(&plan, RunOptions { skip_barriers: true, ..Default::default() }).unwrap();
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

#[test]
fn a_write_past_a_buffer_stays_within_it_where_the_driver_checks_no_bounds() {
    let Some(mut gpu) = common::restricted_gpu(Validate::GpuAssisted) else { return };
    let (plan, out) = ring(&KERNEL, 64, 60, 1);
    let got = gpu.run(&plan).unwrap();
    assert_eq!(got.get(out).len(), 180);
    common::assert_silent(&gpu);
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
    let indices = gpu.empty_indices("indices", 100).unwrap();
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
    assert!(refused(vec![written(indices, 1, 4)]));
    assert!(refused(vec![written(indices, 4, 2)]));
    common::assert_silent(&gpu);
}

/// Drivers of graphics cards run code at the end of each thread that called them. It was gone with
/// the last instance, and threads that ended then ended the process.
#[test]
fn threads_end_after_the_last_device_was_closed() {
    for _ in 0..4 {
        let opened = |_| std::thread::spawn(|| drop(common::gpu(Validate::Off)));
        let threads: Vec<_> = (0..3).map(opened).collect();
        threads.into_iter().for_each(|t| t.join().unwrap());
    }
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
fn a_field_too_large_for_the_device_is_computed_on_the_cpu() {
    let Some(gpu) = common::gpu(Validate::Sync) else { return };
    let limit = gpu.info().max_storage_buffer_range.min(gpu.info().max_buffer_bytes);
    if limit > 1 << 30 {
        println!("skipped: this device binds {limit} bytes at once");
        return;
    }
    // Weights of zero leave normals as they are; there may be more of them than are used.
    let unweighted = |weights: usize| {
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &[0u32, 1, 2, 3]);
        let near = plan.upload_owned("near", &[1u32, 2, 0]);
        let weight = plan.zeroed::<f32>("weight", weights);
        let normal = plan.upload_owned("normal", &[1.0f32, 0.0, 0.0, 0.0, 1.0, 0.0, 0.6, 0.0, 0.8]);
        let faired = plan.zeroed::<f32>("faired", 9);
        let bindings = Bindings { start, near, weight, normal, faired };
        plan.launch(&KERNEL, bindings, Params { vertices: 3, lambda: 0.5 }, 3, 3);
        plan.download(faired);
        (plan, faired)
    };
    let mut device = Device::Gpu(Box::new(gpu));
    let (small, out) = unweighted(3);
    let want = device.run(&small).unwrap().get(out).to_vec();
    let submissions = device.submissions();
    assert_eq!(submissions, 1);
    let (large, out) = unweighted((limit / 4) as usize + 1);
    worst(&want, device.run(&large).unwrap().get(out), KERNEL.tolerance).unwrap();
    assert_eq!(device.submissions(), submissions, "nothing was submitted");
}

#[test]
fn retired_memory_is_reclaimed_without_drawing() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    const BYTES: u64 = 64 << 20; // memory of its own
    gpu.run(&ring(&KERNEL, 100, 100, 1).0).unwrap();
    let before = gpu.memory_held();
    let buffer = gpu.empty_vertices("vertices", BYTES).unwrap();
    assert!(gpu.memory_held() >= before + BYTES);
    gpu.free_buffer(buffer);
    gpu.run(&ring(&KERNEL, 100, 100, 1).0).unwrap();
    assert!(gpu.memory_held() < before + BYTES, "held after a plan was run");
    for _ in 0..8 {
        let buffer = gpu.empty_vertices("vertices", BYTES).unwrap();
        gpu.free_buffer(buffer);
        assert!(gpu.memory_held() < before + 3 * BYTES, "held while others are made");
    }
}

/// The program; that of a pack where the tests are in one.
fn program() -> String {
    std::env::var("INTIMA_TEST_PROGRAM").unwrap_or_else(|_| env!("CARGO_BIN_EXE_intima").into())
}

/// The driver's manifest that `VK_DRIVER_FILES` names, with one member more.
fn manifest_with(member: &str) -> Option<String> {
    let file = std::env::var("VK_DRIVER_FILES").ok()?;
    let text = std::fs::read_to_string(file.split(':').next()?).ok()?;
    let at = text.find("\"library_path\"")?;
    Some(format!("{}{member}, {}", &text[..at], &text[at..]))
}

/// On macOS every driver is of that kind; the loader hides them from programs that do not ask.
#[test]
fn a_driver_that_translates_vulkan_to_another_interface_is_found() {
    if child::is_child() {
        return child_opens_devices();
    }
    let Some(_) = common::gpu(Validate::Off) else { return };
    let Some(text) = manifest_with("\"is_portability_driver\": true") else {
        println!("skipped: VK_DRIVER_FILES names no driver");
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("portable.json");
    std::fs::write(&file, text).unwrap();
    let file = file.to_str().unwrap();
    let env = [("VK_DRIVER_FILES", file), ("VK_ICD_FILENAMES", file)];
    assert_eq!(
        child::said(&child::run(
            "vulkan::a_driver_that_translates_vulkan_to_another_interface_is_found",
            &env
        ))[0],
        "gpu opened"
    );
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
        let (plan, out) = ring(&KERNEL, 100, 100, 1);
        gpu.run(&plan).unwrap().get(out).to_vec()
    };
    let kept = || -> Vec<(std::path::PathBuf, Vec<u8>)> {
        let files = std::fs::read_dir(dir.path().join("cache")).into_iter().flatten();
        let paths = files.map(|f| f.unwrap().path());
        let pipelines = |p: &std::path::PathBuf| {
            p.file_name().is_some_and(|n| n.to_string_lossy().starts_with("pipelines"))
        };
        paths.filter(pipelines).map(|p| (p.clone(), std::fs::read(p).unwrap())).collect()
    };
    let first = once();
    let written = kept();
    if written.is_empty() {
        // Some software drivers have nothing to keep: then there is no file, and no harm.
        let real = common::gpu(Validate::Off).is_some_and(|g| g.info().is_real());
        assert!(!real, "a real driver keeps what it compiled");
        assert_eq!(once(), first);
        return;
    }
    assert!(written.len() == 1 && written[0].1.len() > 40, "{} files", written.len());
    let (path, mut bytes) = written[0].clone();
    let last = bytes.len() - 1;
    bytes[last] ^= 0xff;
    std::fs::write(&path, &bytes).unwrap();
    assert_eq!(once(), first);
    // The damaged file was not believed, and a sound one has taken its place.
    let mended = kept();
    assert!(mended.len() == 1 && mended[0].0 == path && mended[0].1 != bytes);
}

#[test]
fn rates_that_an_earlier_run_measured_spare_submissions() {
    let Some(_) = common::gpu(Validate::Off) else { return };
    let dir = tempfile::tempdir().unwrap();
    let (validate, cache_dir) = (Validate::Off, Some(dir.path().join("cache")));
    let options = OpenOptions { validate, cache_dir, ..OpenOptions::default() };
    // So many workgroups that a kernel which was never measured begins with a few of them.
    let (plan, out) = ring(&KERNEL, 64 * 4000, 64 * 4000, 1);
    let once = || {
        let mut gpu = Gpu::open_with(Choice::Any, options.clone()).unwrap();
        let words = gpu.run(&plan).unwrap().get(out).to_vec();
        (gpu.submissions(), words)
    };
    let (first, words) = once();
    let (second, again) = once();
    assert!(second < first, "{second} after {first}");
    assert!(words == again);
    let files = std::fs::read_dir(dir.path().join("cache")).unwrap().flatten();
    assert!(files.into_iter().any(|f| f.file_name().to_string_lossy().starts_with("rates-")));
}

/// Runs in a process of its own.
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
    if child::is_child() {
        return child_opens_devices();
    }
    let Some(_) = common::gpu(Validate::Off) else { return };
    let none = [("VK_DRIVER_FILES", "/nowhere.json"), ("VK_ICD_FILENAMES", "/nowhere.json")];
    let out = child::run("vulkan::a_machine_without_a_driver_computes_on_the_cpu", &none);
    assert_eq!(child::said(&out), ["gpu true no driver", "auto cpu"]);
}

#[test]
#[cfg(target_os = "linux")]
fn a_machine_without_the_library_computes_on_the_cpu() {
    if child::is_child() {
        return child_opens_devices();
    }
    // A library that is no library, found before the real one.
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("libvulkan.so.1"), "not a library").unwrap();
    let path = dir.path().to_str().unwrap();
    let out = child::run(
        "vulkan::a_machine_without_the_library_computes_on_the_cpu",
        &[("LD_LIBRARY_PATH", path)],
    );
    assert_eq!(child::said(&out), ["gpu true no library", "auto cpu"]);
}

#[cfg(feature = "faults")]
mod faults {
    use glam::Vec3;
    use intima::geometry::{Lens, Mesh, Pose};
    use intima::render::{Renderer, Scene, Shot, View};
    use intima::task::CancelToken;

    use super::*;

    /// Runs in a process of its own.
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
        if child::is_child() {
            return child_runs_a_plan();
        }
        let Some(_) = common::gpu(Validate::Sync) else { return };
        for (fault, want) in [
            ("none:1", "done; 0 messages"),
            ("instance:1", "no driver"),
            ("allocate:1", "out of memory for start; 0 messages"),
            ("allocate:3", "out of memory for near; 0 messages"),
            // Tried once more after retired memory is reclaimed.
            ("allocate:1-1", "done; 0 messages"),
            ("allocate:3-3", "done; 0 messages"),
            ("allocate:3-4", "out of memory for near; 0 messages"),
            ("submit:1", "lost during vkQueueSubmit2; 0 messages"),
        ] {
            let out = child::run(
                "vulkan::faults::planted_faults_come_back_typed_and_leave_nothing_behind",
                &[("INTIMA_FAULT", fault)],
            );
            assert_eq!(child::said(&out), [want], "{fault}");
        }
    }

    /// Runs in a process of its own.
    fn child_waits_for_a_hung_device() {
        let is_assisted = std::env::var_os("INTIMA_TEST_ASSISTED").is_some();
        let validate = if is_assisted { Validate::GpuAssisted } else { Validate::Sync };
        let mut gpu = common::gpu(validate).expect("the parent found a device");
        let token = CancelToken::default();
        token.enter();
        if std::env::var_os("INTIMA_TEST_CANCELLED").is_some() {
            token.cancel();
        }
        let (plan, _) = ring(&KERNEL, 1000, 1000, 2);
        for _ in 0..2 {
            let e = gpu.run(&plan).err().expect("the device does not answer");
            println!("child: {e}; lost: {}", e.is_lost());
        }
        drop(gpu);
        println!("child: {:?}", intima::vk::all_validation_messages());
    }

    #[test]
    fn a_device_that_hangs_is_given_up_and_the_wait_is_named() {
        if child::is_child() {
            return child_waits_for_a_hung_device();
        }
        let Some(_) = common::gpu(Validate::Sync) else { return };
        let name = "vulkan::faults::a_device_that_hangs_is_given_up_and_the_wait_is_named";
        for (cancelled, seconds) in [(false, 120), (true, 5)] {
            let mut env = vec![("INTIMA_FAULT", "wait:1")];
            env.extend(cancelled.then_some(("INTIMA_TEST_CANCELLED", "1")));
            let said = format!(
                "the device did not answer for {seconds} s, while a piece of a plan was waited \
                 for; lost: true"
            );
            // Nothing that the device may use is destroyed, and no later wait takes as long.
            assert_eq!(child::said(&child::run(name, &env)), [said.as_str(), said.as_str(), "[]"]);
        }
        // Nor does a wait of GPU-assisted validation, which is by a fence.
        let env = [("INTIMA_FAULT", "wait:1"), ("INTIMA_TEST_ASSISTED", "1")];
        let said = child::said(&child::run(name, &env));
        assert!(said[0].starts_with("the device did not answer for 120 s"), "{said:?}");
        assert!(said[0].ends_with("lost: true") && said[2] == "[]", "{said:?}");
        // A device that takes its time is not given up.
        let said = child::said(&child::run(
            "vulkan::faults::planted_faults_come_back_typed_and_leave_nothing_behind",
            &[("INTIMA_FAULT", "wait:1-119")],
        ));
        assert_eq!(said, ["done; 0 messages"]);
    }

    /// Runs in a process of its own.
    fn child_opens_a_validated_device() {
        let options =
            OpenOptions { validate: Validate::Sync, cache_dir: None, ..OpenOptions::default() };
        let said = match Gpu::open_with(Choice::Any, options) {
            Ok(_) => "opened".to_owned(),
            Err(VkError::OutOfMemory { what, .. }) => format!("out of memory for {what}"),
            Err(e) => e.to_string(),
        };
        println!("child: {said}; {:?}", intima::vk::all_validation_messages());
    }

    #[test]
    fn a_device_that_fails_to_open_leaks_nothing() {
        if child::is_child() {
            return child_opens_a_validated_device();
        }
        let Some(_) = common::gpu(Validate::Sync) else { return };
        let open = |n: u32| {
            let fault = format!("create:{n}-{n}");
            let env = [("INTIMA_FAULT", fault.as_str())];
            child::said(&child::run(
                "vulkan::faults::a_device_that_fails_to_open_leaks_nothing",
                &env,
            ))
            .remove(0)
        };
        // The layer says at the end of a device what of it was not destroyed.
        let said: Vec<String> = (1..=7).map(open).collect();
        let of = |what: &str| format!("out of memory for {what}; []");
        let wanted = [
            of("vkCreateDebugUtilsMessengerEXT"),
            of("vkCreateDevice"),
            of("the allocator"),
            of("vkCreatePipelineCache"),
            of("vkCreateCommandPool"),
            of("vkCreateSemaphore"),
            "opened; []".to_owned(),
        ];
        assert_eq!(said, wanted);
    }

    /// Runs in a process of its own.
    fn child_makes_a_renderer() {
        let mut gpu = common::gpu(Validate::Off).expect("the parent found a device");
        let made = Renderer::new(&mut gpu, 64, 64, 4).map(drop);
        let said = if made.is_ok() { "made" } else { "failed" };
        println!("child: {said}, {} live", gpu.live_resources());
    }

    #[test]
    fn a_renderer_that_fails_to_open_leaves_nothing_on_the_device() {
        if child::is_child() {
            return child_makes_a_renderer();
        }
        let Some(_) = common::gpu(Validate::Off) else { return };
        let make = |n: u32| {
            let fault = format!("allocate:{n}");
            let env = [("INTIMA_FAULT", fault.as_str())];
            child::said(&child::run(
                "vulkan::faults::a_renderer_that_fails_to_open_leaves_nothing_on_the_device",
                &env,
            ))
            .remove(0)
        };
        // Four images, three read-back buffers, two models of two buffers each; copies through
        // staging memory come on top where memory is not shared.
        for n in [1, 2, 4, 5, 7, 8, 11] {
            assert_eq!(make(n), "failed, 0 live", "allocation {n}");
        }
        let made = make(1000);
        assert!(made.starts_with("made, ") && made != "made, 0 live", "{made}");
    }

    /// Runs in a process of its own.
    fn child_draws_after_a_failed_submission() {
        let mut gpu = common::gpu(Validate::Sync).expect("the parent found a device");
        let set_up = Renderer::new(&mut gpu, 64, 64, 4).and_then(|mut r| {
            let mesh = r.upload_mesh(&mut gpu, &Mesh::default(), false)?;
            Ok((r, mesh))
        });
        let Ok((mut r, mesh)) = set_up else { return println!("child: no renderer") };
        let shot = Shot {
            view: View::Split,
            pose: Pose::looking(Vec3::ZERO, Vec3::X, Vec3::Z),
            lens: Lens { fov_y_rad: 1.0, aspect: 1.0, near_mm: 0.5 },
            progress: 0.0,
            room_mm: None,
        };
        for _ in 0..3 {
            let drawn = r.render(&mut gpu, &Scene::of(mesh), &shot);
            let said = if drawn.is_ok() { "drawn" } else { "failed" };
            println!("child: {said}, {:?}", gpu.validation_messages());
        }
    }

    #[test]
    fn image_layouts_are_those_before_a_submission_that_failed() {
        if child::is_child() {
            return child_draws_after_a_failed_submission();
        }
        let Some(_) = common::gpu(Validate::Sync) else { return };
        let name = "vulkan::faults::image_layouts_are_those_before_a_submission_that_failed";
        // The first submission of a frame: others come before it where textures are staged.
        let run = |n: u32| child::run(name, &[("INTIMA_FAULT", &format!("submit:{n}-{n}"))]);
        let said = (1..9).map(|n| child::said(&run(n))).find(|said| said != &["no renderer"]);
        assert_eq!(said.expect("a frame"), ["failed, []", "drawn, []", "drawn, []"]);
    }

    #[test]
    fn the_reason_for_computing_on_the_cpu_is_said() {
        let Some(gpu) = common::gpu(Validate::Off) else { return };
        if gpu.info().is_real() {
            return println!("skipped: this machine has a real GPU");
        }
        let tmp = tempfile::tempdir().unwrap();
        let phantom = ["phantom", "tube", "--size", "32", "--mask", "-o", "mask.nrrd"];
        assert_eq!(validated(tmp.path(), "none:1", &phantom).0, 0);
        let args = ["-v", "distance", "--mask", "mask.nrrd", "-o", "o.nrrd"];
        let (code, said) = validated(tmp.path(), "none:1", &args);
        let found = said.lines().find(|l| l.contains("the CPU computes"));
        assert!(code == 0 && found.is_some_and(|l| l.contains(&gpu.info().name)), "{said}");
        let (code, said) = validated(tmp.path(), "instance:1", &args);
        assert!(code == 0 && said.contains("the CPU computes: the Vulkan library found no driver"));
    }

    /// Runs the program with a planted fault and validation; exit code and standard error.
    fn validated(folder: &std::path::Path, fault: &str, args: &[&str]) -> (i32, String) {
        let out = std::process::Command::new(program())
            .current_dir(folder)
            .args(args)
            .envs([("INTIMA_FAULT", fault), ("INTIMA_VALIDATE", "1")])
            .output()
            .unwrap();
        (out.status.code().unwrap_or(-1), String::from_utf8_lossy(&out.stderr).into_owned())
    }

    #[test]
    fn a_run_with_a_validation_message_fails() {
        let Some(_) = common::gpu(Validate::Sync) else { return };
        let tmp = tempfile::tempdir().unwrap();
        let phantom = ["phantom", "tube", "--size", "32", "--mask", "-o", "mask.nrrd"];
        let (code, said) = validated(tmp.path(), "none:1", &phantom);
        assert_eq!(code, 0, "{said}");
        let args = ["distance", "--mask", "mask.nrrd", "-o", "o.nrrd", "--device", "gpu"];
        let (code, said) = validated(tmp.path(), "none:1", &args);
        assert_eq!(code, 0, "{said}");
        // Whoever asks for the GPU by that name hears when it is software.
        let Ok(Device::Gpu(gpu)) = Device::open(DeviceChoice::Gpu) else { panic!("a device") };
        assert_eq!(said.contains("software Vulkan"), !gpu.info().is_real(), "{said}");
        let (code, said) = validated(tmp.path(), "barrier:1", &args);
        assert!(code == 1 && said.contains("SYNC-HAZARD"), "exit code {code}: {said}");
        // How many messages depends on the pieces of the plan.
        let ends_so = |said: &str| {
            let last = said.lines().last().unwrap_or_default();
            last.starts_with("intima: failed: ") && last.contains("validation")
        };
        assert!(ends_so(&said), "{said}");
        // Nor does a message pass where nobody reads the answer, or with another error.
        let (code, said) = validated(tmp.path(), "barrier:1,write:1", &args);
        assert!(code == 1 && ends_so(&said), "exit code {code}: {said}");
        let program = program();
        let line = format!("('{program}' {} --json; echo $? > code) | true", args.join(" "));
        let ran = std::process::Command::new("sh")
            .current_dir(tmp.path())
            .args(["-c", &line])
            .envs([("INTIMA_FAULT", "barrier:1"), ("INTIMA_VALIDATE", "1")])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&ran.stderr);
        let code = std::fs::read_to_string(tmp.path().join("code")).unwrap();
        assert_eq!(code.trim(), "1", "{said}");
    }
}

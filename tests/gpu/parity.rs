//! Every kernel on every case: the shader agrees with its CPU twin, and validation is silent.

use std::collections::BTreeSet;

use intima::compute::{Outputs, Plan, Step, Tolerance, run_cpu};
use intima::vk::{Gpu, Validate};

use crate::cases;
use crate::compare::worst;

/// The first disagreement of two runs of `plan`, if any: floats within `tol`, all else exactly.
fn disagreement(plan: &Plan<'_>, want: &Outputs, got: &Outputs, tol: Tolerance) -> Option<String> {
    plan.downloads().iter().find_map(|id| {
        let b = &plan.buffers()[id.0 as usize];
        let (want, got) = (want.words(*id), got.words(*id));
        let floats = |w: &[u32]| w.iter().map(|w| f32::from_bits(*w)).collect::<Vec<_>>();
        let said = if b.float {
            worst(&floats(want), &floats(got), tol).err().map(|e| e.to_string())
        } else if want.len() != got.len() {
            Some(format!("{} words instead of {}", got.len(), want.len()))
        } else {
            let at = (0..want.len()).find(|&i| want[i] != got[i]);
            at.map(|i| format!("word {i}: wanted {}, got {}", want[i], got[i]))
        };
        said.map(|s| format!("`{}`: {s}", b.name))
    })
}

#[test]
fn every_kernel_agrees_with_its_twin() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    every_kernel_agrees(&mut gpu);
}

#[test]
fn every_kernel_agrees_with_its_twin_through_staging_memory() {
    let Some(mut gpu) = common::staging_gpu(Validate::Sync) else { return };
    every_kernel_agrees(&mut gpu);
}

/// Drivers that check no bounds get modules that do.
#[test]
fn every_kernel_agrees_with_its_twin_with_its_indices_restricted() {
    let Some(mut gpu) = common::restricted_gpu(Validate::Sync) else { return };
    every_kernel_agrees(&mut gpu);
}

/// Launches of more workgroups than fit one dimension are folded into two.
#[test]
fn every_kernel_agrees_with_its_twin_in_a_folded_grid() {
    let (mut failed, mut folded) = (Vec::new(), BTreeSet::new());
    // Few for kernels with a thread a brick, more for those with a thread a voxel.
    for limit in [2, 3, 16, 61] {
        let Some(mut gpu) = common::few_groups_gpu(limit, Validate::Off) else { return };
        for (kernel, cases) in cases::all() {
            for case in cases {
                let groups =
                    |s: &Step| s.threads.div_ceil(s.kernel.shader.workgroup as usize) as u32;
                let most = case.plan.steps().iter().map(groups).max().unwrap_or(0);
                if !(limit + 1..=limit * limit).contains(&most) {
                    continue;
                }
                folded.insert(kernel.name());
                let (want, got) = (run_cpu(&case.plan), gpu.run(&case.plan).unwrap());
                let said = disagreement(&case.plan, &want, &got, kernel.tolerance);
                failed.extend(said.map(|d| format!("{}/{}: {d}", kernel.name(), case.name)));
            }
        }
    }
    assert!(failed.is_empty(), "{} cases disagree:\n{}", failed.len(), failed.join("\n"));
    let names = cases::all().map(|(k, _)| k.name());
    let never: Vec<_> = names.filter(|n| !folded.contains(n)).collect();
    assert_eq!(never, ["prefix_sum"], "one workgroup is all it has");
}

/// Not-a-number in every upload of floats: no search runs for ever, no index goes astray, and what
/// is a number stays one. A shader may take it that there is no not-a-number (WGSL, 15.7.2), and
/// those of graphics cards do: what a card makes of one itself is open.
#[test]
fn every_kernel_agrees_with_its_twin_on_not_a_number() {
    let Some(mut gpu) = common::gpu(Validate::Sync) else { return };
    let mut failed = Vec::new();
    let mut poisoned = BTreeSet::new();
    for (kernel, cases) in cases::all() {
        for mut case in cases {
            if !case.plan.poison() {
                continue;
            }
            poisoned.insert(kernel.name());
            let (mut want, got) = (run_cpu(&case.plan), gpu.run(&case.plan).unwrap());
            if gpu.info().is_real() {
                for id in case
                    .plan
                    .downloads()
                    .iter()
                    .filter(|id| case.plan.buffers()[id.0 as usize].float)
                {
                    let bytes = case.plan.buffers()[id.0 as usize].bytes;
                    let got = got.words(*id).to_vec();
                    let want: &mut [u32] = bytemuck::cast_slice_mut(want.bytes_mut(*id, bytes));
                    for (want, got) in want.iter_mut().zip(got) {
                        *want = if f32::from_bits(*want).is_nan() { got } else { *want };
                    }
                }
            }
            let said = disagreement(&case.plan, &want, &got, kernel.tolerance);
            failed.extend(said.map(|d| format!("{}/{}: {d}", kernel.name(), case.name)));
        }
    }
    assert!(failed.is_empty(), "{} cases disagree:\n{}", failed.len(), failed.join("\n"));
    println!("{poisoned:?}");
    common::assert_silent(&gpu);
}

fn every_kernel_agrees(gpu: &mut Gpu) {
    let mut failed = Vec::new();
    for (kernel, cases) in cases::all() {
        for case in cases {
            let place = format!("{}/{}", kernel.name(), case.name);
            let want = run_cpu(&case.plan);
            match gpu.run(&case.plan) {
                Ok(got) => failed.extend(
                    disagreement(&case.plan, &want, &got, kernel.tolerance)
                        .map(|d| format!("{place}: {d}")),
                ),
                Err(e) => failed.push(format!("{place}: {e}")),
            }
        }
    }
    assert!(failed.is_empty(), "{} cases disagree:\n{}", failed.len(), failed.join("\n"));
    common::assert_silent(gpu);
}

#[test]
fn no_kernel_reaches_past_its_buffers() {
    let Some(mut gpu) = common::gpu(Validate::GpuAssisted) else { return };
    for (kernel, cases) in cases::all() {
        for case in cases {
            gpu.run(&case.plan).unwrap();
            let said = gpu.validation_messages();
            assert!(said.is_empty(), "{}/{}: {}", kernel.name(), case.name, said.join("\n"));
        }
    }
}

#[test]
fn a_second_run_gives_the_same_bytes() {
    let Some(mut gpu) = common::gpu(Validate::Off) else { return };
    for (kernel, cases) in cases::all() {
        for case in cases {
            let (a, b) = (gpu.run(&case.plan).unwrap(), gpu.run(&case.plan).unwrap());
            for id in case.plan.downloads() {
                assert_eq!(a.words(*id), b.words(*id), "{}/{}", kernel.name(), case.name);
            }
        }
    }
}

#[test]
fn the_comparer_sees_one_wrong_element_of_every_kernel() {
    for (kernel, cases) in cases::all() {
        let mut seen = 0;
        for case in cases {
            let want = run_cpu(&case.plan);
            for id in case.plan.downloads() {
                let b = &case.plan.buffers()[id.0 as usize];
                let mut words = want.words(*id).to_vec();
                let Some(at) = words.iter().position(|w| f32::from_bits(*w).is_finite()) else {
                    continue;
                };
                words[at] = if b.float {
                    let v = f32::from_bits(words[at]);
                    let tol = kernel.tolerance;
                    (v + 2.0 * (tol.abs + tol.rel * v.abs()) + 1e-6 * v.abs() + 1e-30).to_bits()
                } else {
                    words[at] ^ 1
                };
                let mut bad = run_cpu(&case.plan);
                bad.insert_bytes(*id, bytemuck::cast_slice(&words));
                let said = disagreement(&case.plan, &want, &bad, kernel.tolerance);
                assert!(said.is_some(), "{}/{}: `{}`", kernel.name(), case.name, b.name);
                seen += 1;
            }
        }
        assert!(seen > 0, "{} has no case with a result", kernel.name());
    }
}

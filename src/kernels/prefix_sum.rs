//! CPU twin and cases of `prefix_sum`.

pub use super::host::prefix_sum::{Bindings, Params};
use super::host::prefix_sum::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/prefix_sum.wgsl`. One workgroup: launch it with 256 threads.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "counts", tolerance: Tolerance::EXACT, cases };

/// Number of threads of a launch.
pub const THREADS: usize = 256;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let mut at = 0u32;
    for (sum, n) in s.sum.iter_mut().zip(&s.count[..p.len as usize]) {
        *sum = at;
        at += n;
    }
    s.sum[p.len as usize] = at;
}

fn cases() -> Vec<Case> {
    let case = |name, count: Vec<u32>| {
        let mut plan = Plan::new();
        let len = count.len();
        let sum = plan.zeroed::<u32>("sum", len + 1);
        let count = plan.upload_owned("count", &count);
        plan.launch(&KERNEL, Bindings { count, sum }, Params { len: len as u32 }, THREADS, len);
        plan.download(sum);
        Case { name, plan }
    };
    vec![
        case("empty", vec![]),
        case("one", vec![7]),
        case("odd length", (0..1001).map(|i| i * 37 % 11).collect()),
        case("shorter than the workgroup", (0..200).collect()),
        case("70,000 counts", (0..70_000).map(|i| i % 513).collect()),
    ]
}

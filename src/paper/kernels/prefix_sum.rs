//! CPU twin of `prefix_sum`.

use crate::compute::{CpuArgs, Kernel, Tolerance};
pub use crate::kernels::host::prefix_sum::{Bindings, Params};
use crate::kernels::host::prefix_sum::{SHADER, open};

/// See `shaders/prefix_sum.wgsl`. One workgroup: launch it with 256 threads.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "counts", tolerance: Tolerance::EXACT };

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

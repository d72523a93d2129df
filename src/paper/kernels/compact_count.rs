//! CPU twin of `compact_count`.

use rayon::prelude::*;

use crate::compute::{CpuArgs, Kernel, Tolerance};
pub use crate::kernels::host::compact_count::{Bindings, Params};
use crate::kernels::host::compact_count::{SHADER, open};

/// See `shaders/compact_count.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "bricks", tolerance: Tolerance::EXACT };

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    s.count
        .par_iter_mut()
        .zip(s.marked.par_chunks_exact(16))
        .with_min_len(1024)
        .for_each(|(n, words)| *n = words.iter().map(|w| w.count_ones()).sum());
}

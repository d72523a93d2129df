//! CPU twin of `compact_scatter`.

use crate::compute::{CpuArgs, Kernel, Tolerance};
pub use crate::kernels::host::compact_scatter::{Bindings, Params};
use crate::kernels::host::compact_scatter::{SHADER, open};

/// See `shaders/compact_scatter.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "bricks", tolerance: Tolerance::EXACT };

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    // Serial: marked bits are few (a ridge), and walking the words is a fraction of marking them.
    let mut at = 0;
    for (w, &word) in s.marked[..p.slots as usize * 16].iter().enumerate() {
        let mut bits = word;
        while bits != 0 {
            if at < p.capacity as usize {
                s.list[at] = w as u32 * 32 + bits.trailing_zeros();
            }
            at += 1;
            bits &= bits - 1;
        }
    }
    debug_assert_eq!(at as u32, s.sum[p.slots as usize]);
}

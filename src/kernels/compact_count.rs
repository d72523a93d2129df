//! CPU twin and cases of `compact_count`.

use rayon::prelude::*;

use super::cases_on_bricks;
pub use super::host::compact_count::{Bindings, Params};
use super::host::compact_count::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};

/// See `shaders/compact_count.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "bricks", tolerance: Tolerance::EXACT, cases };

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    s.count
        .par_iter_mut()
        .zip(s.marked.par_chunks_exact(16))
        .with_min_len(1024)
        .for_each(|(n, words)| *n = words.iter().map(|w| w.count_ones()).sum());
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, _, inside| {
        let slots = lumen.bricks.len();
        let count = plan.zeroed::<u32>("count", slots);
        let params = Params { slots: slots as u32 };
        plan.launch(&KERNEL, Bindings { marked: inside, count }, params, slots, slots);
        plan.download(count);
    })
}

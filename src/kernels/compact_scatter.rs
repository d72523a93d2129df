//! CPU twin and cases of `compact_scatter`.

use super::cases_on_bricks;
pub use super::host::compact_scatter::{Bindings, Params};
use super::host::compact_scatter::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};

/// See `shaders/compact_scatter.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "bricks", tolerance: Tolerance::EXACT, cases };

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

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, _, inside| {
        let slots = lumen.bricks.len();
        let counts: Vec<u32> =
            lumen.inside.chunks(8).map(|w| w.iter().map(|w| w.count_ones()).sum()).collect();
        let sums: Vec<u32> = std::iter::once(0)
            .chain(counts.iter().scan(0, |at, n| {
                *at += n;
                Some(*at)
            }))
            .collect();
        let sum = plan.upload_owned("sum", &sums);
        let all = lumen.inside_voxels() as u32;
        // Room for all, and room for two thirds: the rest is left out, nothing else is touched.
        for capacity in [all, all * 2 / 3] {
            let list = plan.zeroed::<u32>("list", capacity as usize);
            let params = Params { slots: slots as u32, capacity };
            let bindings = Bindings { marked: inside, sum, list };
            plan.launch(&KERNEL, bindings, params, slots, slots);
            plan.download(list);
        }
    })
}

//! CPU twin of `copy`: the memory bandwidth that other kernels' rates are compared with.

use rayon::prelude::*;

pub use super::host::copy::{Bindings, Params};
use super::host::copy::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/copy.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "quads", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

/// Number of quads of a parallel task: 1 MiB.
const CHUNK: usize = 1 << 16;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let quads = p.quads as usize;
    let copied = s.copied[..quads].par_chunks_mut(CHUNK);
    copied.zip(s.source[..quads].par_chunks(CHUNK)).for_each(|(to, from)| to.copy_from_slice(from));
}

#[cfg(test)]
mod tests {
    use super::{Bindings, KERNEL, Params};
    use crate::compute::{Buf, Plan, run_cpu};

    #[test]
    fn storage_of_another_buffer_is_cleared_for_one_that_begins_with_zeros() {
        let mut plan = Plan::new();
        let ones = vec![[1u32; 4]; 64];
        let source: Buf<[u32; 4]> = plan.upload("source", &ones);
        let [first, second] = ["first", "second"].map(|name| plan.undefined::<[u32; 4]>(name, 64));
        let last = plan.zeroed::<[u32; 4]>("last", 64);
        for (source, copied, quads) in [(source, first, 64), (first, second, 64), (second, last, 1)]
        {
            plan.launch(&KERNEL, Bindings { source, copied }, Params { quads }, 64, 64);
        }
        plan.download(last);
        let found = run_cpu(&plan).take(last);
        assert_eq!(found[..], [&ones[..1], &[[0; 4]; 63][..]].concat());
    }
}

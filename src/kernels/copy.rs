//! CPU twin and cases of `copy`: the memory bandwidth that other kernels' rates are compared with.

use rayon::prelude::*;

pub use super::host::copy::{Bindings, Params};
use super::host::copy::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/copy.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "quads",
    tolerance: Tolerance { abs: 0.0, rel: 0.0 },
    cases,
};

/// Number of quads of a parallel task: 1 MiB.
const CHUNK: usize = 1 << 16;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let quads = p.quads as usize;
    let copied = s.copied[..quads].par_chunks_mut(CHUNK);
    copied.zip(s.source[..quads].par_chunks(CHUNK)).for_each(|(to, from)| to.copy_from_slice(from));
}

fn cases() -> Vec<Case> {
    let case = |name, quads: usize, room: usize| {
        let mut plan = Plan::new();
        let values: Vec<[u32; 4]> = (0..quads as u32).map(|q| [q, !q, 7 * q, q << 16]).collect();
        let source = plan.upload_owned("source", &values);
        let copied = plan.zeroed::<[u32; 4]>("copied", room);
        let params = Params { quads: quads as u32 };
        plan.launch(&KERNEL, Bindings { source, copied }, params, quads, quads);
        plan.download(copied);
        Case { name, plan }
    };
    vec![
        case("empty", 0, 0),
        case("one quad", 1, 1),
        case("a group and one", 65, 65),
        case("more than a chunk", CHUNK + 3, CHUNK + 3),
        case("what lies behind stays", 100, 300),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::run_cpu;

    #[test]
    fn a_copy_is_whole_and_nothing_behind_it_is_written() {
        for case in cases() {
            let out = run_cpu(&case.plan);
            let words = out.words(case.plan.downloads()[0]);
            let quads = case.plan.steps()[0].items;
            let same = (0..quads as u32)
                .all(|q| words[4 * q as usize..][..4] == [q, !q, q.wrapping_mul(7), q << 16]);
            assert!(same && words[4 * quads..].iter().all(|w| *w == 0), "{}", case.name);
        }
    }
}

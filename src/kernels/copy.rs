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

//! The CPU runner: executes the twins in order. Twins use rayon and must not let the number of
//! threads show in their results.

use std::time::Instant;

use super::array::Storage;
use super::{Contents, CpuArgs, Outputs, Plan, StepTime};

/// Bytes of undefined contents in builds with debug assertions: floats are tiny and negative,
/// integers huge.
const NONSENSE: u8 = 0xA5;

enum BufferData<'a> {
    Input(&'a [u8]),
    Own(Storage),
}

/// Executes a plan with the CPU twins on the current rayon pool.
pub fn run_cpu(plan: &Plan<'_>) -> Outputs {
    let steps = plan.steps();
    let mut last_use = vec![0usize; plan.buffers().len()];
    for (i, step) in steps.iter().enumerate() {
        for b in &step.buffers {
            last_use[b.0 as usize] = i;
        }
    }
    for b in plan.downloads() {
        last_use[b.0 as usize] = usize::MAX;
    }
    // Owned storage appears at first use and goes after the last one.
    let mut held: Vec<Option<BufferData<'_>>> = plan
        .buffers()
        .iter()
        .map(|b| match &b.contents {
            Contents::Zeroed | Contents::Undefined => None,
            Contents::Borrowed(data) => Some(BufferData::Input(data)),
            Contents::Owned(data) => Some(BufferData::Own(Storage::from_bytes(data))),
        })
        .collect();

    let mut times = Vec::with_capacity(steps.len());
    for (i, step) in steps.iter().enumerate() {
        crate::task::checkpoint();
        let start = Instant::now();
        let shader = step.kernel.shader;
        let mut writes = Vec::with_capacity(step.buffers.len());
        for (id, binding) in step.buffers.iter().zip(shader.bindings) {
            let at = id.0 as usize;
            let bytes = plan.buffers()[at].bytes;
            let slot = &mut held[at];
            if slot.is_none() {
                let mut fresh = Storage::zeroed(bytes);
                if cfg!(debug_assertions)
                    && matches!(plan.buffers()[at].contents, Contents::Undefined)
                {
                    fresh.typed_mut::<u8>(bytes).fill(NONSENSE);
                } else if binding.read {
                    fresh.touch();
                }
                *slot = Some(BufferData::Own(fresh));
            }
            writes.push(if binding.writable {
                let own = match slot.take() {
                    Some(BufferData::Own(s)) => s,
                    Some(BufferData::Input(data)) => Storage::from_bytes(data),
                    None => Storage::zeroed(bytes),
                };
                Some((own, bytes))
            } else {
                None
            });
        }
        let reads = step
            .buffers
            .iter()
            .zip(shader.bindings)
            .map(|(id, binding)| {
                let bytes = plan.buffers()[id.0 as usize].bytes;
                (!binding.writable).then(|| match &held[id.0 as usize] {
                    Some(BufferData::Input(data)) => *data,
                    Some(BufferData::Own(s)) => s.typed::<u8>(bytes),
                    None => unreachable!("filled above"),
                })
            })
            .collect();
        let (params, threads) = (&step.params[..], step.threads);
        let mut args = CpuArgs { params, threads, reads, writes };
        (step.kernel.twin)(&mut args);
        let writes = args.writes;
        for (id, w) in step.buffers.iter().zip(writes) {
            if let Some((s, _)) = w {
                held[id.0 as usize] = Some(BufferData::Own(s));
            }
        }
        for id in &step.buffers {
            if last_use[id.0 as usize] == i {
                held[id.0 as usize] = None;
            }
        }
        times.push(StepTime {
            kernel: shader.name,
            unit: step.kernel.unit,
            items: step.items,
            bytes: step.buffers.iter().map(|b| plan.buffers()[b.0 as usize].bytes as u64).sum(),
            seconds: start.elapsed().as_secs_f64(),
        });
    }

    let mut out = Outputs { times, ..Default::default() };
    for id in plan.downloads() {
        let bytes = plan.buffers()[id.0 as usize].bytes;
        let s = match held[id.0 as usize].take() {
            Some(BufferData::Own(s)) => s,
            Some(BufferData::Input(data)) => Storage::from_bytes(data),
            None => Storage::zeroed(bytes),
        };
        out.arrays.insert(*id, (s, bytes));
    }
    out
}

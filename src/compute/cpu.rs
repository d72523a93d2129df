//! The CPU runner: executes the twins in order. Twins use rayon and must not let the number of
//! threads show in their results.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use super::array::Storage;
use super::{BufId, Contents, CpuArgs, Outputs, Plan, StepTime};

/// Bytes of undefined contents in builds with debug assertions: floats are tiny and negative,
/// integers huge.
const NONSENSE: u8 = 0xA5;

enum BufferData<'a> {
    Input(&'a [u8]),
    Own(Storage),
}

/// Storage of buffers that are not needed any more, for later ones of the same size: the system
/// clears fresh pages, which takes as long as a pass over them. No more is kept than is asked for
/// later, so that the plan takes no more memory than it would without.
struct KeptStorage {
    free: Vec<(Storage, usize)>,
    /// Number of buffers of each size that have no storage yet.
    to_come: BTreeMap<usize, usize>,
}

impl KeptStorage {
    fn of(plan: &Plan<'_>) -> Self {
        let used: BTreeSet<BufId> = plan.steps().iter().flat_map(|s| &s.buffers).copied().collect();
        let mut to_come = BTreeMap::new();
        for b in used.iter().map(|id| &plan.buffers()[id.0 as usize]) {
            if matches!(b.contents, Contents::Zeroed | Contents::Undefined) {
                *to_come.entry(b.bytes).or_default() += 1;
            }
        }
        Self { free: Vec::new(), to_come }
    }

    /// Storage for a buffer that has none yet; zeros if it is not undefined.
    fn take(&mut self, bytes: usize, is_undefined: bool, is_read: bool) -> Storage {
        if let Some(count) = self.to_come.get_mut(&bytes) {
            *count = count.saturating_sub(1);
        }
        if let Some(at) = self.free.iter().position(|(_, size)| *size == bytes) {
            let (mut storage, _) = self.free.swap_remove(at);
            if !is_undefined {
                storage.clear();
            }
            return storage;
        }
        let mut fresh = Storage::zeroed(bytes);
        if is_read {
            fresh.touch();
        }
        fresh
    }

    fn give(&mut self, storage: Storage, bytes: usize) {
        let has = self.free.iter().filter(|(_, size)| *size == bytes).count();
        if self.to_come.get(&bytes).is_some_and(|count| *count > has) {
            self.free.push((storage, bytes));
        }
    }
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

    let mut kept = KeptStorage::of(plan);
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
                let is_undefined = matches!(plan.buffers()[at].contents, Contents::Undefined);
                let mut fresh = kept.take(bytes, is_undefined, binding.read);
                if cfg!(debug_assertions) && is_undefined {
                    fresh.typed_mut::<u8>(bytes).fill(NONSENSE);
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
            if last_use[id.0 as usize] == i
                && let Some(BufferData::Own(storage)) = held[id.0 as usize].take()
            {
                kept.give(storage, plan.buffers()[id.0 as usize].bytes);
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

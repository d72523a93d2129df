//! Barriers between the launches of a plan.

use crate::compute::Step;

/// Buffers that were read or written since the last barrier.
pub(super) struct Hazards<'a> {
    read: Vec<bool>,
    written: Vec<bool>,
    /// Buffers that share bytes with each buffer.
    aliases: &'a [Vec<u32>],
}

impl<'a> Hazards<'a> {
    /// Starts with no access.
    pub fn new(aliases: &'a [Vec<u32>]) -> Self {
        Self { read: vec![false; aliases.len()], written: vec![false; aliases.len()], aliases }
    }

    /// Whether `step` needs a barrier before it: it touches what was written, writes what was read,
    /// or uses memory that held another buffer. Then notes its accesses.
    pub fn before(&mut self, step: &Step) -> bool {
        let touched = || step.buffers.iter().zip(step.kernel.shader.bindings);
        let clash = touched().any(|(id, b)| {
            let at = id.0 as usize;
            let used = |a: &u32| self.read[*a as usize] || self.written[*a as usize];
            self.written[at] || (b.writable && self.read[at]) || self.aliases[at].iter().any(used)
        });
        if clash {
            self.read.fill(false);
            self.written.fill(false);
        }
        for (id, b) in touched() {
            let list = if b.writable { &mut self.written } else { &mut self.read };
            list[id.0 as usize] = true;
        }
        clash
    }
}

//! A launch as a CPU twin sees it.

use std::cell::Cell;

use bytemuck::Pod;

use super::array::Storage;

/// Arguments of one launch for its twin.
pub struct CpuArgs<'a> {
    /// The immediate block.
    pub(super) params: &'a [u8],
    pub(super) threads: usize,
    pub(super) reads: Vec<Option<&'a [u8]>>,
    /// Storage with its bytes.
    pub(super) writes: Vec<Option<(Storage, usize)>>,
}

/// Buffers of a launch, each of which can be opened once.
pub struct CpuSlices<'a> {
    reads: &'a [Option<&'a [u8]>],
    writes: Vec<Cell<Option<(&'a mut Storage, usize)>>>,
}

impl CpuArgs<'_> {
    /// Returns the immediate block.
    pub fn params<P: Pod>(&self) -> P {
        bytemuck::pod_read_unaligned(self.params)
    }
    /// Returns the number of threads of the launch.
    pub fn threads(&self) -> usize {
        self.threads
    }
    /// Returns access to the buffers.
    pub fn slices(&mut self) -> CpuSlices<'_> {
        CpuSlices {
            reads: &self.reads,
            writes: self
                .writes
                .iter_mut()
                .map(|w| Cell::new(w.as_mut().map(|(s, n)| (s, *n))))
                .collect(),
        }
    }
}

impl<'a> CpuSlices<'a> {
    /// Returns a read-only binding.
    pub fn read<T: Pod>(&self, binding: usize) -> &'a [T] {
        bytemuck::cast_slice(self.reads[binding].expect("read-only binding"))
    }
    /// Returns a writable binding; each can be opened once.
    pub fn write<T: Pod>(&mut self, binding: usize) -> &'a mut [T] {
        let (s, bytes) = self.writes[binding].take().expect("writable binding, opened once");
        s.typed_mut(bytes / size_of::<T>())
    }
}

//! A zero-initialised array of plain data whose element type is chosen by the reader.

use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

use bytemuck::Pod;
use rayon::prelude::*;

/// Untyped storage aligned for every buffer element (at most 8 bytes), allocated zeroed by the
/// system, so that untouched pages cost nothing.
#[derive(Clone, Default)]
pub(super) struct Storage(Vec<u64>);

impl Storage {
    pub fn zeroed(bytes: usize) -> Self {
        Self(vec![0; bytes.div_ceil(8)])
    }
    /// Writes to every page, so that the system gives each memory of its own at once. A fresh page
    /// that is read first is a shared one of zeros; the first write to it must then be announced to
    /// every core that runs this program, which costs more than the work of many kernels.
    pub fn touch(&mut self) {
        const PAGE: usize = 4096 / 8; // the least there is; larger ones are touched more than once
        self.0.par_chunks_mut(64 * PAGE).for_each(|words| {
            words.iter_mut().step_by(PAGE).for_each(|w| *w = std::hint::black_box(0));
        });
    }
    /// Writes zeros.
    pub fn clear(&mut self) {
        self.0.par_chunks_mut(1 << 15).for_each(|words| words.fill(0));
    }
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let mut s = Self::zeroed(bytes.len());
        bytemuck::cast_slice_mut::<u64, u8>(&mut s.0)[..bytes.len()].copy_from_slice(bytes);
        s
    }
    pub fn typed<T: Pod>(&self, len: usize) -> &[T] {
        let bytes: &[u8] = bytemuck::cast_slice(&self.0);
        bytemuck::cast_slice(&bytes[..len * size_of::<T>()])
    }
    pub fn typed_mut<T: Pod>(&mut self, len: usize) -> &mut [T] {
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.0);
        bytemuck::cast_slice_mut(&mut bytes[..len * size_of::<T>()])
    }
    pub fn capacity_bytes(&self) -> usize {
        self.0.len() * 8
    }
}

/// A downloaded buffer: derefs to `[T]`.
#[derive(Clone)]
pub struct Array<T> {
    storage: Storage,
    len: usize,
    of: PhantomData<T>,
}

impl<T: Pod> Array<T> {
    pub(super) fn new(storage: Storage, len: usize) -> Self {
        assert!(len * size_of::<T>() <= storage.capacity_bytes());
        Self { storage, len, of: PhantomData }
    }

    /// Joins several arrays into one, in order. One alone is not copied.
    pub fn joined(mut parts: Vec<Self>) -> Self {
        if parts.len() == 1 {
            return parts.remove(0);
        }
        let len = parts.iter().map(|p| p.len).sum();
        let mut all = Self::new(Storage::zeroed(len * size_of::<T>()), len);
        let mut rest = &mut all[..];
        for part in parts {
            let (here, after) = rest.split_at_mut(part.len);
            here.copy_from_slice(&part);
            rest = after;
        }
        all
    }

    /// Copies a slice.
    pub fn from_slice(s: &[T]) -> Self {
        Self::new(Storage::from_bytes(bytemuck::cast_slice(s)), s.len())
    }
}

impl<T: Pod> Default for Array<T> {
    fn default() -> Self {
        Self::from_slice(&[])
    }
}

impl<T: Pod> Deref for Array<T> {
    type Target = [T];
    fn deref(&self) -> &[T] {
        self.storage.typed(self.len)
    }
}

impl<T: Pod> DerefMut for Array<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        self.storage.typed_mut(self.len)
    }
}

impl<T: Pod + std::fmt::Debug> std::fmt::Debug for Array<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Array(len {})", self.len)
    }
}

#[cfg(test)]
mod tests {
    use super::Storage;

    #[test]
    fn pretouched_buffers_are_zero() {
        for bytes in [0, 1, 4096, 300_001] {
            let mut s = Storage::zeroed(bytes);
            s.touch();
            assert_eq!(s.typed::<u8>(bytes), vec![0; bytes], "{bytes} bytes");
        }
    }
}

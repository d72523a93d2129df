//! Things by handle: a handle outlives what it names without harm, and a stale one is noticed.

use std::marker::PhantomData;

/// Names a `T` that a `Gpu` holds.
pub struct Handle<T> {
    index: u32,
    generation: u32,
    of: PhantomData<fn() -> T>,
}

impl<T> Handle<T> {
    /// Names nothing.
    #[cfg(test)]
    pub(crate) fn none() -> Self {
        Self { index: u32::MAX, generation: 0, of: PhantomData }
    }

    /// Differs between any two live things of one kind.
    pub(super) fn order(self) -> u32 {
        self.index
    }
}
impl<T> Clone for Handle<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Handle<T> {}
impl<T> PartialEq for Handle<T> {
    fn eq(&self, other: &Self) -> bool {
        (self.index, self.generation) == (other.index, other.generation)
    }
}
impl<T> Eq for Handle<T> {}
impl<T> std::fmt::Debug for Handle<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "#{}.{}", self.index, self.generation)
    }
}

/// Slots that are used again under a new generation.
pub(super) struct Slab<T> {
    slots: Vec<(u32, Option<T>)>,
    free: Vec<u32>,
}

impl<T> Default for Slab<T> {
    fn default() -> Self {
        Self { slots: Vec::new(), free: Vec::new() }
    }
}

impl<T> Slab<T> {
    pub fn insert(&mut self, thing: T) -> Handle<T> {
        let index = self.free.pop().unwrap_or_else(|| {
            self.slots.push((0, None));
            self.slots.len() as u32 - 1
        });
        let slot = &mut self.slots[index as usize];
        slot.1 = Some(thing);
        Handle { index, generation: slot.0, of: PhantomData }
    }

    pub fn remove(&mut self, h: Handle<T>) -> Option<T> {
        let slot = self.slots.get_mut(h.index as usize).filter(|s| s.0 == h.generation)?;
        let thing = slot.1.take()?;
        slot.0 += 1;
        self.free.push(h.index);
        Some(thing)
    }

    /// # Panics
    /// If the thing is gone: an error of the caller.
    pub fn get(&self, h: Handle<T>) -> &T {
        let slot = self.slots.get(h.index as usize).filter(|s| s.0 == h.generation);
        slot.and_then(|s| s.1.as_ref()).expect("a handle to a live thing of this device")
    }

    /// # Panics
    /// As [`Slab::get`].
    pub fn get_mut(&mut self, h: Handle<T>) -> &mut T {
        let slot = self.slots.get_mut(h.index as usize).filter(|s| s.0 == h.generation);
        slot.and_then(|s| s.1.as_mut()).expect("a handle to a live thing of this device")
    }

    pub fn drain(&mut self) -> impl Iterator<Item = T> + '_ {
        self.free.clear();
        self.slots.drain(..).filter_map(|s| s.1)
    }
}

#[cfg(test)]
mod tests {
    use super::Slab;

    #[test]
    fn a_stale_handle_does_not_reach_the_slots_next_tenant() {
        let mut s = Slab::default();
        let a = s.insert('a');
        assert_eq!(s.remove(a), Some('a'));
        let b = s.insert('b');
        assert_eq!(s.remove(a), None);
        assert_eq!(*s.get(b), 'b');
        assert!(std::panic::catch_unwind(|| *s.get(a)).is_err());
    }
}

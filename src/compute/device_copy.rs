//! Device copies: arrays of the host that stay on a device between plans.

use std::any::Any;
use std::sync::OnceLock;

/// Copy of an array of the host on a device, left there by a plan for later ones
/// ([`Plan::upload_kept`](super::Plan::upload_kept),
/// [`Plan::download_kept`](super::Plan::download_kept)). Empty until then, and always where the CPU
/// computes. It belongs beside the array, which must not change while the copy is used. Its memory
/// is freed with it. A device that did not make the copy uploads the array as if there were none.
#[derive(Default)]
pub struct DeviceCopy(OnceLock<Box<dyn Any + Send + Sync>>);

impl DeviceCopy {
    /// Returns the memory that a runner left, if it is of this type.
    pub(crate) fn memory<M: Any>(&self) -> Option<&M> {
        self.0.get()?.downcast_ref()
    }

    /// Takes over memory of a device; where there is a copy already, drops it.
    pub(crate) fn set(&self, memory: impl Any + Send + Sync) {
        let _ = self.0.set(Box::new(memory));
    }
}

/// The copy of a clone of the array is empty.
impl Clone for DeviceCopy {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl std::fmt::Debug for DeviceCopy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DeviceCopy({})", if self.0.get().is_some() { "made" } else { "empty" })
    }
}

//! Handles to resources of a [`Gpu`](super::Gpu): keys of its slot maps.

slotmap::new_key_type! {
    /// Handle to a buffer of a [`Gpu`](super::Gpu). It may outlive the buffer; a stale one is noticed.
    pub struct BufferId;
    /// Handle to an image of a [`Gpu`](super::Gpu). It may outlive the image; a stale one is noticed.
    pub struct ImageId;
    /// Handle to a graphics pipeline of a [`Gpu`](super::Gpu). A stale one is noticed.
    pub struct DrawPipelineId;
}

/// Names a resource of a [`Gpu`](super::Gpu).
#[derive(Clone, Copy)]
pub(super) enum ResourceId {
    Buffer(BufferId),
    Image(ImageId),
    Pipeline(DrawPipelineId),
}

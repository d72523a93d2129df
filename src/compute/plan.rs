//! The plan: buffers, launches, downloads.

use std::collections::BTreeMap;
use std::marker::PhantomData;

use bytemuck::Pod;

use super::array::Storage;
use super::{Array, BufId, DeviceCopy, Kernel, Launch};

/// Handle to a buffer of a plan, with its element type.
pub struct Buf<T> {
    id: BufId,
    len: usize,
    of: PhantomData<fn() -> T>,
}

impl<T> Clone for Buf<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Buf<T> {}

impl<T> Buf<T> {
    /// Returns the index of the buffer in the plan.
    pub fn id(self) -> BufId {
        self.id
    }
    /// Returns the number of elements.
    pub fn len(self) -> usize {
        self.len
    }
    /// Whether the buffer holds no element.
    pub fn is_empty(self) -> bool {
        self.len == 0
    }
}

/// Contents of a buffer before the first launch.
pub enum Contents<'a> {
    /// Zero bytes.
    Zeroed,
    /// Any bytes: launches write whatever is read.
    Undefined,
    /// Bytes the plan borrows.
    Borrowed(&'a [u8]),
    /// Bytes the plan owns.
    Owned(Vec<u8>),
}

/// A buffer of a plan.
pub struct PlanBuffer<'a> {
    /// Name for messages.
    pub name: &'static str,
    /// Size in bytes; zero-sized buffers are legal.
    pub bytes: usize,
    /// Size of an element, bytes.
    pub stride: usize,
    /// Whether the elements are f32 (or vectors of them): parity then allows a tolerance.
    pub float: bool,
    /// Initial contents.
    pub contents: Contents<'a>,
    /// Copy that stays on the device after the plan, or was left there by an earlier one.
    pub copy: Option<&'a DeviceCopy>,
}

/// One kernel launch.
pub struct Step {
    /// Kernel that is launched.
    pub kernel: &'static Kernel,
    /// Buffers of the launch in binding order.
    pub buffers: Vec<BufId>,
    /// Bytes of the immediate block.
    pub params: Vec<u8>,
    /// Number of threads; devices round up to workgroups, so kernels check their index.
    pub threads: usize,
    /// Number of items of [`Kernel::unit`] this launch works on, for rates.
    pub items: usize,
}

/// Buffers, launches in order, and the buffers to be read back. Launches see the writes of earlier
/// ones.
#[derive(Default)]
pub struct Plan<'a> {
    buffers: Vec<PlanBuffer<'a>>,
    steps: Vec<Step>,
    downloads: Vec<BufId>,
}

impl<'a> Plan<'a> {
    /// Creates an empty plan.
    pub fn new() -> Self {
        Self::default()
    }

    fn push<T: Pod>(&mut self, name: &'static str, len: usize, contents: Contents<'a>) -> Buf<T> {
        let id = BufId(self.buffers.len() as u32);
        let stride = size_of::<T>();
        let float = std::any::type_name::<T>().contains("f32");
        let bytes = len * stride;
        self.buffers.push(PlanBuffer { name, bytes, stride, float, contents, copy: None });
        Buf { id, len, of: PhantomData }
    }

    /// Adds a buffer with borrowed contents.
    pub fn upload<T: Pod>(&mut self, name: &'static str, data: &'a [T]) -> Buf<T> {
        self.push(name, data.len(), Contents::Borrowed(bytemuck::cast_slice(data)))
    }

    /// Adds a buffer with borrowed contents that stay on the device: a plan with the same `copy`
    /// uploads nothing. Launches only read it.
    ///
    /// * `copy`: that of `data`, which has not changed since the copy was made.
    pub fn upload_kept<T: Pod>(
        &mut self,
        name: &'static str,
        data: &'a [T],
        copy: &'a DeviceCopy,
    ) -> Buf<T> {
        let buf = self.upload(name, data);
        self.buffers[buf.id.0 as usize].copy = Some(copy);
        buf
    }

    /// Adds a buffer with contents of its own.
    pub fn upload_owned<T: Pod>(&mut self, name: &'static str, data: &[T]) -> Buf<T> {
        let bytes = bytemuck::cast_slice::<T, u8>(data).to_vec();
        self.push(name, data.len(), Contents::Owned(bytes))
    }

    /// Adds a buffer of `len` elements that launches write before anything reads them. A device
    /// spends no time on its contents before, and may give it the memory of a buffer that is not
    /// needed any more. Builds with debug assertions fill it with nonsense on the CPU.
    pub fn undefined<T: Pod>(&mut self, name: &'static str, len: usize) -> Buf<T> {
        self.push(name, len, Contents::Undefined)
    }

    /// Adds a zeroed buffer of `len` elements, for launches that write only some of them.
    pub fn zeroed<T: Pod>(&mut self, name: &'static str, len: usize) -> Buf<T> {
        self.push(name, len, Contents::Zeroed)
    }

    /// Appends a launch over `threads` invocations that work on `items` units.
    ///
    /// # Panics
    /// If a writable buffer is bound twice or is an input that stays on the device, or the
    /// immediate's size is not the shader's: errors of the stage that builds the plan.
    pub fn launch<L: Launch>(
        &mut self,
        kernel: &'static Kernel,
        bindings: L,
        params: L::Params,
        threads: usize,
        items: usize,
    ) {
        let buffers = bindings.ids();
        let shader = kernel.shader;
        assert_eq!(buffers.len(), shader.bindings.len(), "{}: bindings", shader.name);
        assert_eq!(size_of::<L::Params>(), shader.params_size as usize, "{}", shader.name);
        for (i, b) in shader.bindings.iter().enumerate() {
            let shared = buffers.iter().filter(|id| **id == buffers[i]).count() > 1;
            assert!(!(b.writable && shared), "{}: `{}` is bound twice", shader.name, b.name);
            let buffer = &self.buffers[buffers[i].0 as usize];
            let is_input = matches!(buffer.contents, Contents::Borrowed(_) | Contents::Owned(_));
            let is_kept = is_input && buffer.copy.is_some();
            assert!(!(b.writable && is_kept), "{}: writes `{}`", shader.name, buffer.name);
        }
        let params = bytemuck::bytes_of(&params).to_vec();
        self.steps.push(Step { kernel, buffers, params, threads, items });
    }

    /// Requests a buffer's contents after the last launch.
    pub fn download<T>(&mut self, buf: Buf<T>) {
        if !self.downloads.contains(&buf.id) {
            self.downloads.push(buf.id);
        }
    }

    /// Requests a buffer's contents, which stay on the device too, as the copy of what
    /// [`Outputs::take`] returns.
    ///
    /// # Panics
    /// If the host has filled the buffer.
    pub fn download_kept<T>(&mut self, buf: Buf<T>, copy: &'a DeviceCopy) {
        let buffer = &mut self.buffers[buf.id.0 as usize];
        let is_result = matches!(buffer.contents, Contents::Zeroed | Contents::Undefined);
        assert!(is_result, "`{}` is no result", buffer.name);
        buffer.copy = Some(copy);
        self.download(buf);
    }

    /// Puts not-a-number into elements of the uploads of floats, for tests: a third, a half and two
    /// thirds into each. Returns whether there was any.
    #[doc(hidden)]
    pub fn poison(&mut self) -> bool {
        let mut any = false;
        for b in &mut self.buffers {
            if let (Contents::Owned(bytes), true) = (&mut b.contents, b.float) {
                let floats = bytes.len() / size_of::<f32>();
                for at in [floats / 3, floats / 2, 2 * floats / 3] {
                    if at < floats {
                        let nan = f32::NAN.to_ne_bytes();
                        bytes[at * size_of::<f32>()..][..nan.len()].copy_from_slice(&nan);
                        any = true;
                    }
                }
            }
        }
        any
    }

    /// Returns all buffers, by id.
    pub fn buffers(&self) -> &[PlanBuffer<'a>] {
        &self.buffers
    }
    /// Returns the launches in order.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }
    /// Returns the buffers to be read back.
    pub fn downloads(&self) -> &[BufId] {
        &self.downloads
    }
}

/// Duration of one launch.
#[derive(Clone, Debug)]
pub struct StepTime {
    /// Kernel name.
    pub kernel: &'static str,
    /// Unit of the kernel's items.
    pub unit: &'static str,
    /// Number of items worked on.
    pub items: usize,
    /// Size of all bound buffers, bytes: the least memory that the launch reads or writes.
    pub bytes: u64,
    /// Duration, s: on a GPU from timestamp queries, on the CPU from the monotonic clock.
    pub seconds: f64,
}

/// Results of running a plan: downloaded buffers and times.
#[derive(Default)]
pub struct Outputs {
    pub(super) arrays: BTreeMap<BufId, (Storage, usize)>,
    /// Duration of each launch, in order.
    pub times: Vec<StepTime>,
}

impl Outputs {
    /// Adds a downloaded buffer (for runners).
    pub fn insert_bytes(&mut self, id: BufId, bytes: &[u8]) {
        self.arrays.insert(id, (Storage::from_bytes(bytes), bytes.len()));
    }

    /// Returns the bytes of a downloaded buffer to be filled, zeros at first (for runners).
    pub fn bytes_mut(&mut self, id: BufId, bytes: usize) -> &mut [u8] {
        let empty = || (Storage::zeroed(bytes), bytes);
        self.arrays.entry(id).or_insert_with(empty).0.typed_mut(bytes)
    }

    /// Returns a downloaded buffer.
    ///
    /// # Panics
    /// If the plan did not request it.
    pub fn get<T: Pod>(&self, buf: Buf<T>) -> &[T] {
        let (s, bytes) = self.arrays.get(&buf.id).expect("the plan downloads this buffer");
        assert_eq!(*bytes, buf.len * size_of::<T>());
        s.typed(buf.len)
    }

    /// Moves a downloaded buffer out.
    ///
    /// # Panics
    /// If the plan did not request it, or it was taken before.
    pub fn take<T: Pod>(&mut self, buf: Buf<T>) -> Array<T> {
        let (s, bytes) = self.arrays.remove(&buf.id).expect("the plan downloads this buffer");
        assert_eq!(bytes, buf.len * size_of::<T>());
        Array::new(s, buf.len)
    }

    /// Returns a downloaded buffer as 32-bit words, for comparing devices.
    pub fn words(&self, id: BufId) -> &[u32] {
        let (s, bytes) = &self.arrays[&id];
        s.typed(bytes / 4)
    }
}

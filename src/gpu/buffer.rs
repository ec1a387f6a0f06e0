//! Typed device buffers.

use super::context::Context;
use super::device::Device;
use super::error::{During, Error};
use super::harness::red_zone;
use super::memory;
use crate::lock::lock;
use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc};
use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes allocated for `bytes`: Vulkan has no empty buffers, and a fill needs a multiple of four bytes.
const fn stored(bytes: u64) -> u64 {
    if bytes < 4 { 4 } else { bytes.next_multiple_of(4) }
}

static NEXT: AtomicU64 = AtomicU64::new(1);

/// A buffer without its element type; freed when its last holder, recordings included, drops it.
#[derive(Clone)]
pub struct RawBuffer(pub(super) Arc<Storage>);

pub(super) struct Storage {
    pub raw: vk::Buffer,
    pub number: u64,
    pub bytes: u64,
    /// Number of bytes behind the contents that no kernel may touch; 0 without guards.
    red_zone: u64,
    pub name: String,
    allocation: Option<Allocation>,
    /// Stands in for mapped memory when nothing runs; takes no device memory.
    pretended: Vec<u8>,
    context: Arc<Context>,
}

impl RawBuffer {
    pub(super) fn new(
        device: &Device,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Self, Error> {
        let (context, size) = (device.context(), stored(bytes));
        let bound = usage.contains(vk::BufferUsageFlags::STORAGE_BUFFER);
        if let Some(counted) = device.counted() {
            counted.add(name, size, bound);
            return Ok(Self::pretended(context, name, 0, 0));
        }
        if bound && size > context.logical.info.max_buffer_bytes {
            return Err(Error::TooLarge {
                name: name.to_owned(),
                needed: size,
                limit: context.logical.info.max_buffer_bytes,
                device: context.logical.info.name.clone(),
            });
        }
        context.memory.reserve(name, size)?;
        lock(&context.traffic).buffers += 1;
        let guarded = bound && context.guards.is_some();
        // A guarded buffer is read and written by the host.
        let (red_zone, location) = if guarded { (red_zone::BYTES, MemoryLocation::GpuToCpu) } else { (0, location) };
        let mut made = Self::allocate(context, name, size, red_zone, usage, location);
        match (&mut made, &context.guards) {
            (Err(_), _) => context.memory.release(size),
            (Ok(buffer), Some(guards)) if guarded => {
                red_zone::fill(buffer.number(), buffer.mapped_mut().split_at_mut(size as usize));
                guards.watch(&buffer.0);
            }
            _ => {}
        }
        made
    }

    fn allocate(
        context: &Arc<Context>,
        name: &str,
        size: u64,
        red_zone: u64,
        usage: vk::BufferUsageFlags,
        location: MemoryLocation,
    ) -> Result<Self, Error> {
        if context.logical.compile_only {
            let pretended = if location == MemoryLocation::GpuOnly { 0 } else { size as usize };
            return Ok(Self::pretended(context, name, size, pretended));
        }
        let info = vk::BufferCreateInfo::default().size(size + red_zone).usage(usage);
        // SAFETY: the device is alive and `info` is complete.
        let raw = unsafe { context.logical.raw.create_buffer(&info, None) }.during("create buffer")?;
        // SAFETY: `raw` was just made by this device.
        let requirements = unsafe { context.logical.raw.get_buffer_memory_requirements(raw) };
        let wanted = AllocationCreateDesc {
            name,
            requirements,
            location,
            linear: true,
            allocation_scheme: memory::scheme(raw, size + red_zone),
        };
        let bound = context.memory.allocate(&wanted, size).and_then(|a| {
            // SAFETY: the memory was allocated for this buffer's requirements and is bound once.
            match unsafe { context.logical.raw.bind_buffer_memory(raw, a.memory(), a.offset()) }.during("bind memory") {
                Ok(()) => Ok(a),
                Err(e) => {
                    context.memory.free(a);
                    Err(e)
                }
            }
        });
        match bound {
            Ok(allocation) => {
                context.logical.name(raw, name);
                let number = NEXT.fetch_add(1, Ordering::Relaxed);
                let (name, context) = (name.to_owned(), Arc::clone(context));
                let allocation = Some(allocation);
                let pretended = Vec::new();
                Ok(Self(Arc::new(Storage { raw, number, bytes: size, red_zone, name, allocation, pretended, context })))
            }
            Err(e) => {
                // SAFETY: no work was ever submitted that uses the buffer.
                unsafe { context.logical.raw.destroy_buffer(raw, None) };
                Err(e)
            }
        }
    }

    /// A buffer of which only the size is known, and `mapped` bytes of host memory.
    fn pretended(context: &Arc<Context>, name: &str, size: u64, mapped: usize) -> Self {
        Self(Arc::new(Storage {
            raw: vk::Buffer::null(),
            number: NEXT.fetch_add(1, Ordering::Relaxed),
            bytes: size,
            red_zone: 0,
            name: name.to_owned(),
            allocation: None,
            pretended: vec![0; mapped],
            context: Arc::clone(context),
        }))
    }

    /// Size in bytes, a multiple of four.
    pub fn bytes(&self) -> u64 {
        self.0.bytes
    }

    pub(super) fn number(&self) -> u64 {
        self.0.number
    }

    pub(super) fn mapped(&self) -> &[u8] {
        self.0.mapped()
    }

    /// Whether no other handle, such as a recording's, refers to the buffer.
    pub(super) fn is_alone(&self) -> bool {
        Arc::strong_count(&self.0) == 1
    }

    pub(super) fn mapped_mut(&mut self) -> &mut [u8] {
        let Some(storage) = Arc::get_mut(&mut self.0) else { return &mut [] };
        let mapped = storage.allocation.as_mut().and_then(Allocation::mapped_slice_mut);
        mapped.unwrap_or(&mut storage.pretended)
    }
}

impl Storage {
    pub fn mapped(&self) -> &[u8] {
        self.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or(&self.pretended)
    }

    /// The bytes behind the contents.
    pub fn red_zone(&self) -> &[u8] {
        let zone = self.bytes as usize..(self.bytes + self.red_zone) as usize;
        self.mapped().get(zone).unwrap_or_default()
    }
}

impl Drop for Storage {
    fn drop(&mut self) {
        self.context.forget(self.number);
        if let Some(guards) = self.context.guards.as_ref().filter(|_| self.red_zone > 0) {
            guards.leave(self);
        }
        if let Some(allocation) = self.allocation.take() {
            self.context.logical.unname(self.raw);
            // SAFETY: submitted work holds its own reference until its fence was waited for, so none uses the buffer now.
            unsafe { self.context.logical.raw.destroy_buffer(self.raw, None) };
            self.context.memory.free(allocation);
        }
        self.context.memory.release(self.bytes);
    }
}

/// `len` elements of `T` in device memory.
pub struct Buffer<T> {
    raw: RawBuffer,
    len: usize,
    element: PhantomData<T>,
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self { raw: self.raw.clone(), len: self.len, element: PhantomData }
    }
}

impl<T: Pod> Buffer<T> {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it holds no elements.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Bytes that a buffer of `len` elements takes.
    pub const fn bytes_of(len: usize) -> u64 {
        stored(len as u64 * size_of::<T>() as u64)
    }

    /// Size in bytes.
    pub fn bytes(&self) -> u64 {
        self.raw.bytes()
    }

    /// Its name in messages.
    pub fn name(&self) -> &str {
        &self.raw.0.name
    }

    /// The same memory as elements of another type.
    ///
    /// # Panics
    /// When the sizes do not divide.
    #[must_use]
    pub fn cast<U: Pod>(&self) -> Buffer<U> {
        let bytes = self.len * size_of::<T>();
        assert!(bytes.is_multiple_of(size_of::<U>()), "{bytes} bytes are not a whole number of elements");
        Buffer { raw: self.raw.clone(), len: bytes / size_of::<U>(), element: PhantomData }
    }

    /// Number of elements for which it has memory; see [`Buffer::of_len`].
    pub fn room(&self) -> usize {
        self.raw.bytes() as usize / size_of::<T>()
    }

    /// The same memory as a buffer of `len` elements.
    ///
    /// # Panics
    /// If that is more than [`Buffer::room`].
    #[must_use]
    pub fn of_len(&self, len: usize) -> Self {
        assert!(len <= self.room(), "{len} elements in the memory of {}", self.room());
        Self { raw: self.raw.clone(), len, element: PhantomData }
    }

    /// The buffer without its type.
    pub fn raw(&self) -> &RawBuffer {
        &self.raw
    }
}

impl Device {
    /// A buffer of `len` elements, contents undefined.
    ///
    /// # Errors
    /// [`Error::TooLarge`] beyond what a kernel can bind, [`Error::OutOfMemory`].
    pub fn buffer<T: Pod>(&self, name: &str, len: usize) -> Result<Buffer<T>, Error> {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let bytes = len as u64 * size_of::<T>() as u64;
        let raw = RawBuffer::new(self, name, bytes, usage, MemoryLocation::GpuOnly)?;
        Ok(Buffer { raw, len, element: PhantomData })
    }
}

//! Values sent to the device while it works.

use super::buffer::{Buffer, RawBuffer};
use super::device::Device;
use super::error::Error;
use super::recording::Recording;
use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;
use std::marker::PhantomData;

/// Host memory from which recordings copy values to the device, in parts of equal length.
///
/// A recording holds the part that it copies from until it has been waited for; only a part that no recording holds is
/// written again. With as many parts as recordings in flight, the one being made included, the host never waits for a
/// part, and no memory is allocated later.
pub struct Feed<T> {
    device: Device,
    name: String,
    parts: Vec<RawBuffer>,
    len: usize,
    element: PhantomData<T>,
}

impl<T: Pod> Feed<T> {
    /// Bytes of [`Feed::new`].
    pub fn bytes(len: usize, parts: usize) -> u64 {
        parts as u64 * Buffer::<T>::bytes_of(len)
    }

    /// Memory for `parts` recordings in flight, each with up to `len` values.
    pub fn new(device: &Device, name: &str, len: usize, parts: usize) -> Result<Self, Error> {
        let (device, name) = (device.clone(), name.to_owned());
        let mut feed = Self { device, name, parts: Vec::with_capacity(parts), len, element: PhantomData };
        for _ in 0..parts {
            feed.parts.push(feed.part()?);
        }
        Ok(feed)
    }

    fn part(&self) -> Result<RawBuffer, Error> {
        let bytes = self.len as u64 * size_of::<T>() as u64;
        let usage = vk::BufferUsageFlags::TRANSFER_SRC;
        RawBuffer::new(&self.device, &self.name, bytes, usage, MemoryLocation::CpuToGpu)
    }

    /// Records a copy of `values` to the beginning of a buffer.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`], if more recordings are in flight than there are parts.
    ///
    /// # Panics
    /// If the values do not fit a part or the buffer.
    pub fn record(&mut self, recording: &mut Recording, values: &[T], to: &Buffer<T>) -> Result<(), Error> {
        assert!(values.len() <= self.len.min(to.len()), "{} values do not fit", values.len());
        let bytes: &[u8] = bytemuck::cast_slice(values);
        if !self.parts.iter().any(RawBuffer::is_alone) {
            self.parts.push(self.part()?);
        }
        if let Some(part) = self.parts.iter_mut().find(|part| part.is_alone()) {
            part.mapped_mut()[..bytes.len()].copy_from_slice(bytes);
            recording.copy_raw(part, 0, to.raw(), 0, bytes.len() as u64);
        }
        Ok(())
    }
}

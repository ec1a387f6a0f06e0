//! Results that come to the host while the device goes on: host memory that a submission owns until it was waited for.

use super::buffer::{Buffer, RawBuffer};
use super::device::Device;
use super::error::Error;
use super::profiler::Timings;
use super::recording::Recording;
use super::submit::Ticket;
use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;
use std::marker::PhantomData;

/// Host memory for `len` elements that the device copies into.
///
/// A submission takes it whole and gives it back when it was waited for: the host never reads what is still written.
pub struct Landing<T> {
    raw: RawBuffer,
    len: usize,
    element: PhantomData<T>,
}

/// A submission under way whose results will lie in a [`Landing`]. Dropping it waits.
pub struct Reading<T> {
    ticket: Ticket,
    landing: Landing<T>,
}

impl<T: Pod> Landing<T> {
    /// Elements that it holds.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it holds none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The elements; what no submission wrote is undefined.
    pub fn values(&self) -> &[T] {
        &bytemuck::cast_slice(&self.raw.mapped()[..self.len * size_of::<T>()])[..self.len]
    }
}

impl<T: Pod> Reading<T> {
    /// Waits for the work; gives the results and the time of its scopes.
    ///
    /// # Errors
    /// Device errors.
    pub fn wait(self) -> Result<(Landing<T>, Timings), Error> {
        let timings = self.ticket.wait()?;
        Ok((self.landing, timings))
    }
}

impl Device {
    /// Host memory for `len` elements.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`].
    pub fn landing<T: Pod>(&self, name: &str, len: usize) -> Result<Landing<T>, Error> {
        let bytes = len as u64 * size_of::<T>() as u64;
        let usage = vk::BufferUsageFlags::TRANSFER_DST;
        let raw = RawBuffer::new(self.context(), name, bytes, usage, MemoryLocation::GpuToCpu)?;
        Ok(Landing { raw, len, element: PhantomData })
    }

    /// Submits a recording, and after it copies the first elements of each buffer into the landing, one after the other.
    ///
    /// # Errors
    /// Device errors.
    ///
    /// # Panics
    /// When a buffer holds fewer elements than asked for, or the landing too few.
    pub fn submit_reading<T: Pod>(
        &self,
        mut recording: Recording,
        from: &[(&Buffer<T>, usize)],
        landing: Landing<T>,
    ) -> Result<Reading<T>, Error> {
        let size = size_of::<T>();
        let mut at = 0;
        for (buffer, count) in from {
            assert!(*count <= buffer.len() && at + count <= landing.len, "{count} elements do not fit");
            recording.copy_raw(buffer.raw(), 0, &landing.raw, (at * size) as u64, (count * size) as u64);
            at += count;
        }
        Ok(Reading { ticket: self.submit(recording)?, landing })
    }
}

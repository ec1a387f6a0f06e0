//! Results that reach the host while the device keeps working.

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

/// Host memory that submissions copy their results into, one submission at a time.
///
/// Only [`Readback::wait`] returns results, so that the host never reads memory that the device still writes.
pub struct Readback<T> {
    under_way: Option<Ticket>,
    raw: RawBuffer,
    len: usize,
    element: PhantomData<T>,
}

impl<T: Pod> Readback<T> {
    /// Submits a recording, followed by copies of the first elements of each buffer, one behind the other. A submission
    /// not yet waited for is waited for first.
    ///
    /// # Panics
    /// If a buffer holds fewer elements than asked for, or this memory too few.
    pub fn submit(
        &mut self,
        device: &Device,
        mut recording: Recording,
        from: &[(&Buffer<T>, usize)],
    ) -> Result<(), Error> {
        if let Some(ticket) = self.under_way.take() {
            ticket.wait()?;
        }
        let size = size_of::<T>();
        let mut at = 0;
        for (buffer, count) in from {
            assert!(*count <= buffer.len() && at + count <= self.len, "{count} elements do not fit");
            recording.read_back(buffer.raw(), &self.raw, (at * size) as u64, (count * size) as u64);
            at += count;
        }
        self.under_way = Some(device.submit(recording)?);
        Ok(())
    }

    /// Waits for the pending submission, if any; returns the results and the time of its scopes. Elements that no
    /// submission wrote are undefined.
    pub fn wait(&mut self) -> Result<(&[T], Timings), Error> {
        let timings = self.under_way.take().map_or_else(|| Ok(Timings::default()), Ticket::wait)?;
        let values = &bytemuck::cast_slice(&self.raw.mapped()[..self.len * size_of::<T>()])[..self.len];
        Ok((values, timings))
    }
}

impl Device {
    /// Host memory for `len` elements of results.
    pub fn readback<T: Pod>(&self, name: &str, len: usize) -> Result<Readback<T>, Error> {
        let bytes = len as u64 * size_of::<T>() as u64;
        let usage = vk::BufferUsageFlags::TRANSFER_DST;
        let raw = RawBuffer::new(self, name, bytes, usage, MemoryLocation::GpuToCpu)?;
        Ok(Readback { under_way: None, raw, len, element: PhantomData })
    }
}

//! Copies between buffers and the host, through staging memory.

use super::buffer::{Buffer, RawBuffer};
use super::device::Device;
use super::error::Error;
use super::memory;
use super::recording::Recording;
use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;

/// Bytes that one staging transfer moves; larger arrays take several. This much fits a block that the allocator keeps;
/// drivers take milliseconds to allocate dedicated host memory.
const STAGING_BYTES: u64 = memory::SHARED;

/// Bytes of staging memory in use while an array of `bytes` moves to or from the device.
pub fn staging_bytes(bytes: u64) -> u64 {
    bytes.min(STAGING_BYTES)
}

impl<T: Pod> Buffer<T> {
    /// Passes the first `count` elements to `look` part by part, with the offset of each part; waits for the device.
    pub fn read_parts(&self, device: &Device, count: usize, mut look: impl FnMut(usize, &[T])) -> Result<(), Error> {
        let size = size_of::<T>();
        let count = if device.counted().is_some() { 0 } else { count.min(self.len()) };
        let step = (STAGING_BYTES as usize / size).max(1);
        for start in (0..count).step_by(step) {
            let n = step.min(count - start);
            let staging = RawBuffer::new(
                device,
                "read-back",
                (n * size) as u64,
                vk::BufferUsageFlags::TRANSFER_DST,
                MemoryLocation::GpuToCpu,
            )?;
            let mut recording = Recording::new();
            recording.copy_raw(self.raw(), (start * size) as u64, &staging, 0, (n * size) as u64);
            device.run(recording)?;
            let bytes = &staging.mapped()[..n * size];
            match bytemuck::try_cast_slice(bytes) {
                Ok(values) => look(start, values),
                Err(_) => look(start, &bytemuck::pod_collect_to_vec::<u8, T>(bytes)),
            }
        }
        Ok(())
    }

    /// Copies the first `count` elements to the host; waits for the device.
    pub fn read_first(&self, device: &Device, count: usize) -> Result<Vec<T>, Error> {
        let mut out = Vec::with_capacity(count.min(self.len()));
        self.read_parts(device, count, |_, values| out.extend_from_slice(values))?;
        Ok(out)
    }

    /// Copies everything to the host; waits for the device.
    pub fn read(&self, device: &Device) -> Result<Vec<T>, Error> {
        self.read_first(device, self.len())
    }

    /// Copies `data` into the buffer from its start; waits for the device.
    ///
    /// # Panics
    /// If `data` is longer than the buffer.
    pub fn write(&self, device: &Device, data: &[T]) -> Result<(), Error> {
        assert!(data.len() <= self.len(), "{} elements do not fit a buffer of {}", data.len(), self.len());
        if device.counted().is_some() {
            return Ok(());
        }
        let bytes: &[u8] = bytemuck::cast_slice(data);
        for (i, chunk) in bytes.chunks(STAGING_BYTES as usize).enumerate() {
            let mut staging = RawBuffer::new(
                device,
                "upload",
                chunk.len() as u64,
                vk::BufferUsageFlags::TRANSFER_SRC,
                MemoryLocation::CpuToGpu,
            )?;
            staging.mapped_mut()[..chunk.len()].copy_from_slice(chunk);
            let mut recording = Recording::new();
            recording.copy_raw(&staging, 0, self.raw(), i as u64 * STAGING_BYTES, chunk.len() as u64);
            device.run(recording)?;
        }
        Ok(())
    }
}

impl Device {
    /// A buffer that holds `data`.
    pub fn upload<T: Pod>(&self, name: &str, data: &[T]) -> Result<Buffer<T>, Error> {
        let buffer = self.buffer(name, data.len())?;
        buffer.write(self, data)?;
        Ok(buffer)
    }
}

//! Device memory: the allocator, and the count of bytes in use.

use super::error::Error;
use super::info::{DeviceInfo, DeviceKind};
use crate::lock::lock;
use ash::vk;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc};
use gpu_allocator::{AllocationError, MemoryLocation};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Bytes of a block that small buffers share.
pub(super) const BLOCK: u64 = 64 << 20;
/// Larger buffers have memory of their own: in a shared block, each could leave almost its own size unused.
pub(super) const SHARED: u64 = 16 << 20;

/// The allocation scheme of a buffer of this size.
pub(super) fn scheme(buffer: vk::Buffer, bytes: u64) -> AllocationScheme {
    if bytes > SHARED { AllocationScheme::DedicatedBuffer(buffer) } else { AllocationScheme::GpuAllocatorManaged }
}

/// The memory of one device.
pub(super) struct Memory {
    allocator: Mutex<Allocator>,
    used: AtomicU64,
    peak: AtomicU64,
    limit: u64,
    enforced: AtomicBool,
    device: String,
    /// Whether the device shares the host's memory: then any memory will do.
    shared: bool,
}

impl Memory {
    /// Memory of a device, of which this program may use `limit` bytes.
    pub fn new(info: &AllocatorCreateDesc, device: &DeviceInfo, limit: u64) -> Result<Self, Error> {
        let allocator = Allocator::new(info)
            .map_err(|e| Error::MissingFeature { device: device.name.clone(), feature: format!("memory ({e})") })?;
        let (allocator, used, peak) = (Mutex::new(allocator), AtomicU64::new(0), AtomicU64::new(0));
        let (device, shared) = (device.name.clone(), device.kind == DeviceKind::Integrated);
        Ok(Self { allocator, used, peak, limit, enforced: AtomicBool::new(false), device, shared })
    }

    /// Enforces the limit from here on; the probe's memory does not count.
    pub fn enforce(&self) {
        self.enforced.store(true, Ordering::Relaxed);
        self.forget_peak();
    }

    /// Restarts the peak of bytes in use.
    pub fn forget_peak(&self) {
        self.peak.store(self.used.load(Ordering::Relaxed), Ordering::Relaxed);
    }

    /// Bytes in use: now, and the peak since [`Memory::forget_peak`].
    pub fn used(&self) -> (u64, u64) {
        (self.used.load(Ordering::Relaxed), self.peak.load(Ordering::Relaxed))
    }

    /// Bytes that may be in use.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Counts `bytes` as used, unless this would exceed the limit.
    pub fn reserve(&self, name: &str, bytes: u64) -> Result<(), Error> {
        let used = self.used.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if used > self.limit && self.enforced.load(Ordering::Relaxed) {
            self.release(bytes);
            return Err(self.out_of_memory(name, bytes));
        }
        self.peak.fetch_max(used, Ordering::Relaxed);
        Ok(())
    }

    /// Returns the error of [`Memory::reserve`], if any, without counting anything.
    pub fn check(&self, name: &str, bytes: u64) -> Result<(), Error> {
        let beyond = self.used().0.saturating_add(bytes) > self.limit && self.enforced.load(Ordering::Relaxed);
        if beyond { Err(self.out_of_memory(name, bytes)) } else { Ok(()) }
    }

    /// Takes back a reservation.
    pub fn release(&self, bytes: u64) {
        self.used.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Allocates memory for a buffer of `bytes`.
    pub fn allocate(&self, wanted: &AllocationCreateDesc<'_>, bytes: u64) -> Result<Allocation, Error> {
        let mut allocator = lock(&self.allocator);
        let full = |e: &AllocationError| {
            matches!(e, AllocationError::OutOfMemory | AllocationError::NoCompatibleMemoryTypeFound)
        };
        let allocated = match allocator.allocate(wanted) {
            // Visible to the host, it may lie in any heap.
            Err(e) if self.shared && wanted.location == MemoryLocation::GpuOnly && full(&e) => {
                allocator.allocate(&AllocationCreateDesc { location: MemoryLocation::CpuToGpu, ..wanted.clone() })
            }
            allocated => allocated,
        };
        allocated.map_err(|e| self.error(wanted.name, bytes, &e))
    }

    /// Frees an allocation.
    pub fn free(&self, allocation: Allocation) {
        let _ = lock(&self.allocator).free(allocation);
    }

    fn out_of_memory(&self, name: &str, needed: u64) -> Error {
        let (used, _) = self.used();
        Error::OutOfMemory { name: name.to_owned(), needed, used, limit: self.limit, device: self.device.clone() }
    }

    fn error(&self, name: &str, bytes: u64, error: &AllocationError) -> Error {
        match error {
            AllocationError::OutOfMemory => self.out_of_memory(name, bytes),
            // The allocator's texts for a host out of memory and for too many allocations.
            AllocationError::FailedToMap(why) | AllocationError::Internal(why) => {
                tracing::warn!("allocation of '{name}', {bytes} bytes: {why}");
                Error::Exhausted { call: "allocate memory", of: "the host's" }
            }
            other => {
                tracing::error!("allocation of '{name}': {other}");
                Error::Vulkan { call: "allocate memory", result: vk::Result::ERROR_UNKNOWN }
            }
        }
    }
}

//! The state that a device's handles, buffers and submissions share.

use super::choose::lease::Lease;
use super::choose::properties::Candidate;
use super::error::Error;
use super::frame::Frames;
use super::harness::order::Disorder;
use super::harness::red_zone::Guards;
use super::hazards::Hazards;
use super::info::{DeviceClass, DeviceKind};
use super::instance::Instance;
use super::logical::Logical;
use super::memory::{self, Memory};
use super::options::DeviceOptions;
use super::pace::{self, Pace};
use super::pipeline::Pipelines;
use super::queue::Queue;
use super::traffic::Traffic;
use crate::lock::lock;
use gpu_allocator::vulkan::AllocatorCreateDesc;
use std::mem::ManuallyDrop;
use std::sync::Mutex;

/// An open device with its queue, memory and pipelines; destroyed when its last handle, buffer and submission are gone.
pub(super) struct Context {
    pub logical: Logical,
    pub queue: Queue,
    pub pipelines: Pipelines,
    pub frames: Frames,
    pub hazards: Mutex<Hazards>,
    pub traffic: Mutex<Traffic>,
    /// The limit on the length of submissions.
    pub pace: Option<Pace>,
    pub guards: Option<Guards>,
    pub disorder: Option<Disorder>,
    pub memory: ManuallyDrop<Memory>,
    /// Held while the device is open.
    _lease: Option<Lease>,
    /// Destroyed after the device.
    _instance: Instance,
}

impl Context {
    /// The state of a candidate, for kernels of a class; with a later tuning of another class, modules stay those of this one.
    pub fn new(
        instance: Instance,
        candidate: Candidate,
        class: DeviceClass,
        options: &DeviceOptions,
    ) -> Result<Self, Error> {
        let logical = Logical::new(&instance, &candidate, class, options)?;
        let (raw, info) = (&logical.raw, &logical.info);
        // SAFETY: the family was found on this device and one queue was asked for.
        let queue = unsafe { raw.get_device_queue(candidate.queue_family, 0) };
        // A CPU device's memory is the host's and can be swapped: its free amount says little.
        let free = candidate.free_bytes.filter(|_| info.kind != DeviceKind::Cpu);
        // One block of the allocator may be almost empty, and only the buffers' own bytes are counted.
        let limit = options.memory_limit.unwrap_or(free.unwrap_or(info.memory_bytes).saturating_sub(memory::BLOCK));
        let limit = if options.compile_only { u64::MAX } else { limit };
        let allocator = AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: raw.clone(),
            physical_device: candidate.physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: gpu_allocator::AllocationSizes::new(memory::BLOCK, memory::BLOCK),
        };
        Ok(Self {
            queue: Queue::new(queue, candidate.queue_family, options.harness.fault),
            pipelines: Pipelines::new(raw, candidate.pipeline_cache_uuid)?,
            frames: Frames::default(),
            hazards: Mutex::default(),
            traffic: Mutex::default(),
            pace: options.max_submission.or_else(|| pace::usual(info.kind, cfg!(windows))).map(Pace::new),
            guards: options.harness.guarded.then(Guards::default),
            disorder: options.harness.order.map(Disorder::new),
            memory: ManuallyDrop::new(Memory::new(&allocator, info, limit)?),
            _lease: candidate.lease,
            logical,
            _instance: instance,
        })
    }

    /// Removes the hazards of a freed buffer.
    pub fn forget(&self, buffer: u64) {
        lock(&self.hazards).forget(buffer);
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        // A lost driver's cache may be damaged and must not affect the next start.
        if !self.queue.is_lost() {
            self.pipelines.save(&self.logical.raw);
        }
        if !self.logical.compile_only {
            let _ = self.queue.idle(&self.logical.raw);
        }
        // SAFETY: every submission was waited for (or lost, and no work is under way on a lost device) and every buffer is
        // gone, since both hold this context; each handle is destroyed once, children before the device, the allocator's
        // memory before it too.
        unsafe {
            self.frames.destroy(&self.logical.raw);
            self.pipelines.destroy(&self.logical.raw);
            ManuallyDrop::drop(&mut self.memory);
            self.logical.raw.destroy_device(None);
        }
    }
}

//! The command buffer, fence, queries and descriptor sets of one submission.

use super::descriptors::{Room, Sets};
use super::error::{During, Error};
use crate::lock::lock;
use ash::vk;
use std::sync::Mutex;

/// The frames whose work is over.
#[derive(Default)]
pub(super) struct Frames(Mutex<Vec<Frame>>);

/// Resources of one submission besides its commands; reused by the next.
#[derive(Default)]
pub(super) struct Frame {
    /// Its command buffers: one, or more where the recording is cut.
    pub commands: Vec<vk::CommandBuffer>,
    pub fence: vk::Fence,
    pub queries: vk::QueryPool,
    /// Queries that the pool holds.
    pub capacity: u32,
    pub sets: Sets,
    pool: vk::CommandPool,
}

impl Frames {
    /// A frame whose work is over, or a new one, for a queue of this family.
    pub fn take(&self, device: &ash::Device, family: u32, queries: u32, room: Room) -> Result<Frame, Error> {
        let mut frame = lock(&self.0).pop().unwrap_or_default();
        match frame.prepare(device, family, queries, room) {
            Ok(()) => Ok(frame),
            Err(e) => {
                // SAFETY: nothing is under way in a frame that was kept, nor in a new one.
                unsafe { frame.destroy(device) };
                Err(e)
            }
        }
    }

    /// Keeps a frame whose work is over.
    pub fn give_back(&self, frame: Frame) {
        lock(&self.0).push(frame);
    }

    /// # Safety
    /// No frame is taken afterwards.
    pub unsafe fn destroy(&self, device: &ash::Device) {
        for frame in lock(&self.0).drain(..) {
            // SAFETY: its work is over, since it was given back.
            unsafe { frame.destroy(device) };
        }
    }
}

impl Frame {
    /// Creates what is missing and resets what was used.
    fn prepare(&mut self, device: &ash::Device, family: u32, queries: u32, room: Room) -> Result<(), Error> {
        // SAFETY: a kept frame's work is over (its fence was waited for); new handles come from this device.
        unsafe {
            if self.pool == vk::CommandPool::null() {
                let info = vk::CommandPoolCreateInfo::default().queue_family_index(family);
                self.pool = device.create_command_pool(&info, None).during("create command pool")?;
                self.fence = device.create_fence(&vk::FenceCreateInfo::default(), None).during("create fence")?;
            } else {
                device.reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty()).during("reset commands")?;
            }
            if self.capacity < queries {
                device.destroy_query_pool(self.queries, None);
                (self.queries, self.capacity) = (vk::QueryPool::null(), 0);
                let count = queries.next_power_of_two();
                let info = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
                self.queries = device.create_query_pool(&info, None).during("create queries")?;
                self.capacity = count;
            }
            self.commands(device, 0)?;
            self.sets.prepare(device, room)?;
            device.reset_fences(&[self.fence]).during("reset fence")
        }
    }

    /// The command buffer at `index`, which is in its initial state; those before it exist.
    pub fn commands(&mut self, device: &ash::Device, index: usize) -> Result<vk::CommandBuffer, Error> {
        if index == self.commands.len() {
            let info = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
            // SAFETY: the pool is this frame's, which one thread uses at a time.
            self.commands.extend(unsafe { device.allocate_command_buffers(&info) }.during("allocate commands")?);
        }
        Ok(self.commands[index])
    }

    /// # Safety
    /// The frame's work has finished.
    unsafe fn destroy(self, device: &ash::Device) {
        // SAFETY: the caller's promise; handles are destroyed once.
        unsafe {
            device.destroy_query_pool(self.queries, None);
            self.sets.destroy(device);
            device.destroy_fence(self.fence, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}

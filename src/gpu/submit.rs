//! Turning a recording into a command buffer, submitting it, and waiting.

use super::device::{Context, Device, lock};
use super::error::{During, Error};
use super::hazards::Barrier;
use super::pipeline::Pipeline;
use super::profiler::Timings;
use super::recording::{Command, Recording, Size};
use ash::vk;
use std::ffi::CString;
use std::sync::Arc;

/// What one submission needs besides its commands; kept for the next.
pub(super) struct Frame {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    fence: vk::Fence,
    queries: vk::QueryPool,
    capacity: u32,
}

/// Work under way. Dropping it waits.
pub struct Ticket {
    context: Arc<Context>,
    frame: Option<Frame>,
    scopes: Vec<(&'static str, u32, u32)>,
    _recording: Recording, // keeps the buffers alive
    _pipelines: Vec<Arc<Pipeline>>,
}

impl Device {
    /// Submits a recording and waits for it.
    ///
    /// # Errors
    /// Device errors.
    pub fn run(&self, recording: Recording) -> Result<Timings, Error> {
        self.submit(recording)?.wait()
    }

    /// Submits a recording. Recordings run in the order of their submission.
    ///
    /// # Errors
    /// Device errors.
    pub fn submit(&self, recording: Recording) -> Result<Ticket, Error> {
        let context = self.context();
        if context.queue.is_lost() {
            return Err(Error::Lost("queue submit")); // nothing that a lost device still holds is touched again
        }
        // Pipelines first: hazards must not advance for a recording that is never submitted.
        let mut pipelines = Vec::new();
        for command in &recording.commands {
            if let Command::Dispatch { shader, constants, .. } = command {
                pipelines.push(context.pipelines.get(context, shader, constants.clone())?);
            }
        }
        let frame = Frame::take(context, recording.scopes() as u32 * 2)?;
        // The queue's lock spans deriving and submitting, so that barriers see the true order of submissions.
        let queue = context.queue.lock();
        let barriers = recording.barriers(&mut lock(&context.hazards));
        let mut scopes = Vec::new();
        let submitted = encode(context, &frame, &recording, &barriers, &pipelines, &mut scopes).and_then(|()| {
            // SAFETY: the command buffer is complete, its buffers and pipelines are kept alive by the ticket, and the
            // queue is locked for the call.
            unsafe { context.queue.submit(&context.raw, *queue, frame.commands, frame.fence) }.during("queue submit")
        });
        if submitted.is_err() {
            lock(&context.hazards).doubt();
        }
        drop(queue);
        if let Err(e) = submitted {
            lock(&context.frames).push(frame); // never submitted: there is nothing to wait for
            return Err(e);
        }
        Ok(Ticket {
            context: Arc::clone(context),
            frame: Some(frame),
            scopes,
            _recording: recording,
            _pipelines: pipelines,
        })
    }
}

impl Ticket {
    /// Waits for the work and gives the time of its scopes.
    ///
    /// # Errors
    /// Device errors.
    pub fn wait(mut self) -> Result<Timings, Error> {
        self.finish()
    }

    fn finish(&mut self) -> Result<Timings, Error> {
        let Some(frame) = self.frame.take() else { return Ok(Timings::default()) };
        let timings = self.timings(&frame);
        // Its work is over or lost: the next submission takes it, or the context destroys it.
        lock(&self.context.frames).push(frame);
        timings
    }

    fn timings(&self, frame: &Frame) -> Result<Timings, Error> {
        let (device, queue) = (&self.context.raw, &self.context.queue);
        // SAFETY: the fence was submitted with this frame's work.
        unsafe { queue.wait(device, frame.fence) }.during("wait for the device")?;
        let mut timings = Timings::default();
        let period = f64::from(self.context.info.timestamp_period) * 1e-9;
        if !self.scopes.is_empty() && period > 0.0 {
            let mut ticks = vec![0_u64; self.scopes.len() * 2];
            // SAFETY: the queries were all written, since the fence has signalled.
            let read =
                unsafe { device.get_query_pool_results(frame.queries, 0, &mut ticks, vk::QueryResultFlags::TYPE_64) };
            queue.answered(read).during("read timestamps")?;
            for (name, begin, end) in &self.scopes {
                let span = ticks[*end as usize].saturating_sub(ticks[*begin as usize]);
                timings.add(name, span as f64 * period);
            }
        }
        Ok(timings)
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        // Of a loss the first to see it tells.
        let known = self.context.queue.is_lost();
        if let Err(e) = self.finish()
            && !known
        {
            tracing::error!("{e}");
        }
    }
}

impl Frame {
    /// A frame whose work is over, or a new one.
    fn take(context: &Context, queries: u32) -> Result<Self, Error> {
        let new = Self {
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            fence: vk::Fence::null(),
            queries: vk::QueryPool::null(),
            capacity: 0,
        };
        let mut frame = lock(&context.frames).pop().unwrap_or(new);
        match frame.prepare(context, queries) {
            Ok(()) => Ok(frame),
            Err(e) => {
                // SAFETY: nothing is under way in a frame that was kept, nor in a new one.
                unsafe { frame.destroy(&context.raw) };
                Err(e)
            }
        }
    }

    /// Makes what is missing and resets what was used.
    fn prepare(&mut self, context: &Context, queries: u32) -> Result<(), Error> {
        let device = &context.raw;
        // SAFETY: a kept frame's work is over (its fence was waited for); new handles come from this device.
        unsafe {
            if self.pool == vk::CommandPool::null() {
                let info = vk::CommandPoolCreateInfo::default().queue_family_index(context.queue.family);
                self.pool = device.create_command_pool(&info, None).during("create command pool")?;
                let info = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
                self.commands = device.allocate_command_buffers(&info).during("allocate commands")?[0];
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
            device.reset_fences(&[self.fence]).during("reset fence")
        }
    }

    /// # Safety
    /// The frame's work must be over.
    pub unsafe fn destroy(self, device: &ash::Device) {
        // SAFETY: the caller's promise; handles are destroyed once.
        unsafe {
            device.destroy_query_pool(self.queries, None);
            device.destroy_fence(self.fence, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}

fn encode(
    context: &Context,
    frame: &Frame,
    recording: &Recording,
    barriers: &[Option<Barrier>],
    pipelines: &[Arc<Pipeline>],
    scopes: &mut Vec<(&'static str, u32, u32)>,
) -> Result<(), Error> {
    let device = &context.raw;
    let commands = frame.commands;
    let timed = context.info.timestamp_period > 0.0 && frame.capacity > 0;
    let mut open: Vec<usize> = Vec::new();
    let mut query = 0;
    let mut pipelines = pipelines.iter();
    let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
    // SAFETY: the command buffer is in its initial state; every handle recorded is alive and is kept so by the ticket.
    unsafe {
        device.begin_command_buffer(commands, &begin).during("begin commands")?;
        if timed {
            device.cmd_reset_query_pool(commands, frame.queries, 0, frame.capacity);
        }
        for (command, barrier) in recording.commands.iter().zip(barriers) {
            if let Some(barrier) = barrier {
                let (source, source_access) = barrier.source();
                let (destination, destination_access) = Barrier::destination();
                let memory =
                    [vk::MemoryBarrier::default().src_access_mask(source_access).dst_access_mask(destination_access)];
                let none = vk::DependencyFlags::empty();
                device.cmd_pipeline_barrier(commands, source, destination, none, &memory, &[], &[]);
            }
            match command {
                Command::Dispatch { shader, push, buffers, size, .. } => {
                    let pipeline = pipelines.next().expect("one pipeline a dispatch");
                    let infos: Vec<_> = buffers
                        .iter()
                        .map(|b| [vk::DescriptorBufferInfo::default().buffer(b.0.raw).range(vk::WHOLE_SIZE)])
                        .collect();
                    let writes: Vec<_> = infos
                        .iter()
                        .zip(0..)
                        .map(|(info, i)| {
                            vk::WriteDescriptorSet::default()
                                .dst_binding(i)
                                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                                .buffer_info(info)
                        })
                        .collect();
                    label(context, commands, Some(shader.name));
                    device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.raw);
                    let point = vk::PipelineBindPoint::COMPUTE;
                    context.push.cmd_push_descriptor_set(commands, point, pipeline.layout, 0, &writes);
                    if !push.is_empty() {
                        let stage = vk::ShaderStageFlags::COMPUTE;
                        device.cmd_push_constants(commands, pipeline.layout, stage, 0, push);
                    }
                    match size {
                        Size::Direct([x, y, z]) => device.cmd_dispatch(commands, *x, *y, *z),
                        Size::Indirect(b, offset) => device.cmd_dispatch_indirect(commands, b.0.raw, *offset),
                    }
                    label(context, commands, None);
                }
                Command::Fill { buffer, bytes, value } => {
                    device.cmd_fill_buffer(commands, buffer.0.raw, 0, *bytes, *value);
                }
                Command::Update { buffer, data } => device.cmd_update_buffer(commands, buffer.0.raw, 0, data),
                Command::Copy { from, from_offset, to, to_offset, bytes } => {
                    let region = [vk::BufferCopy { src_offset: *from_offset, dst_offset: *to_offset, size: *bytes }];
                    device.cmd_copy_buffer(commands, from.0.raw, to.0.raw, &region);
                }
                Command::Begin(name) => {
                    label(context, commands, Some(name));
                    if timed {
                        let stage = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
                        device.cmd_write_timestamp(commands, stage, frame.queries, query);
                        open.push(scopes.len());
                        scopes.push((name, query, 0));
                        query += 1;
                    }
                }
                Command::End => {
                    if let Some(scope) = open.pop() {
                        let stage = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
                        device.cmd_write_timestamp(commands, stage, frame.queries, query);
                        scopes[scope].2 = query;
                        query += 1;
                    }
                    label(context, commands, None);
                }
            }
        }
        // What the host reads after the fence was written by copies.
        let memory = [vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ)];
        let (transfer, host) = (vk::PipelineStageFlags::TRANSFER, vk::PipelineStageFlags::HOST);
        device.cmd_pipeline_barrier(commands, transfer, host, vk::DependencyFlags::empty(), &memory, &[], &[]);
        device.end_command_buffer(commands).during("end commands")
    }
}

/// Opens (or closes) a debug label.
fn label(context: &Context, commands: vk::CommandBuffer, name: Option<&str>) {
    let Some(debug) = &context.debug else { return };
    // SAFETY: the command buffer is being recorded; labels are opened and closed in pairs.
    unsafe {
        if let Some(name) = name.and_then(|n| CString::new(n).ok()) {
            debug.cmd_begin_debug_utils_label(commands, &vk::DebugUtilsLabelEXT::default().label_name(&name));
        } else {
            debug.cmd_end_debug_utils_label(commands);
        }
    }
}

//! Encoding a recording into a command buffer.

use super::buffer::RawBuffer;
use super::context::Context;
use super::error::{During, Error};
use super::frame::Frame;
use super::hazards::Barrier;
use super::pace::Work;
use super::pipeline::Pipeline;
use super::recording::{Arguments, Command, Recording, Size};
use ash::vk;
use std::ffi::CString;
use std::sync::Arc;

/// A named scope of a recording, with the queries written at its begin and end.
pub(super) struct Scope {
    pub name: &'static str,
    pub begin: u32,
    pub end: u32,
}

/// An encoded recording.
pub(super) struct Encoded {
    pub scopes: Vec<Scope>,
    /// The dispatches of each piece, where submissions are limited.
    pub dispatches: Vec<Vec<(Work, Scope)>>,
    /// The frame's command buffers that it fills, to be submitted one by one.
    pub pieces: usize,
}

/// The writes that the host reads after the fence: copies' results, and those of kernels where it checks what is behind buffers.
fn written_for_host(guarded: bool) -> (vk::PipelineStageFlags, vk::AccessFlags) {
    let (stages, access) = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
    if guarded {
        (stages | vk::PipelineStageFlags::COMPUTE_SHADER, access | vk::AccessFlags::SHADER_WRITE)
    } else {
        (stages, access)
    }
}

/// Writes commands into a frame's command buffers, which are in their initial state. The submitter must keep the
/// referenced resources alive.
pub(super) struct Encoder<'a> {
    context: &'a Context,
    frame: &'a mut Frame,
    /// The command buffer being recorded, the last of `pieces`.
    commands: vk::CommandBuffer,
    pieces: usize,
    /// Seconds that its kernels may take.
    under_way: f64,
    dispatches: Vec<Vec<(Work, Scope)>>,
    timed: bool,
    scopes: Vec<Scope>,
    open: Vec<usize>,
    queries: u32,
    /// The query written last, if no command follows it: one timestamp then serves the end of a scope and the beginning
    /// of the next.
    now: Option<u32>,
    /// Buffers of the dispatch being encoded.
    bound: Vec<vk::DescriptorBufferInfo>,
}

impl<'a> Encoder<'a> {
    /// An encoder of one recording.
    pub fn new(context: &'a Context, frame: &'a mut Frame) -> Self {
        let timed = context.logical.info.timestamp_period > 0.0 && frame.capacity > 0;
        Self {
            context,
            commands: vk::CommandBuffer::null(),
            pieces: 0,
            under_way: 0.0,
            dispatches: Vec::new(),
            frame,
            timed,
            scopes: Vec::new(),
            open: Vec::new(),
            queries: 0,
            now: None,
            bound: Vec::new(),
        }
    }

    /// Encodes a recording with the barriers before its commands and the pipelines of its dispatches; returns its timed
    /// scopes.
    pub fn encode(
        mut self,
        recording: &Recording,
        barriers: &[Option<Barrier>],
        pipelines: &[Arc<Pipeline>],
    ) -> Result<Encoded, Error> {
        self.open_commands()?;
        if self.timed {
            // SAFETY: the pool holds as many queries.
            unsafe {
                self.context.logical.raw.cmd_reset_query_pool(
                    self.commands,
                    self.frame.queries,
                    0,
                    self.frame.capacity,
                );
            }
        }
        let mut pipelines = pipelines.iter();
        for (command, barrier) in recording.commands.iter().zip(barriers) {
            self.pace(command)?;
            if let Some(barrier) = barrier {
                self.barrier(barrier.source(), barrier.destination());
            }
            self.command(command, &recording.arguments, &mut pipelines)?;
        }
        let written = written_for_host(self.context.guards.is_some());
        self.barrier(written, (vk::PipelineStageFlags::HOST, vk::AccessFlags::HOST_READ));
        self.close_commands()?;
        Ok(Encoded { scopes: self.scopes, dispatches: self.dispatches, pieces: self.pieces })
    }

    /// Begins the next command buffer.
    fn open_commands(&mut self) -> Result<(), Error> {
        self.commands = self.frame.commands(&self.context.logical.raw, self.pieces)?;
        self.pieces += 1;
        self.dispatches.push(Vec::new());
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the command buffer is in its initial state.
        unsafe { self.context.logical.raw.begin_command_buffer(self.commands, &begin) }.during("begin commands")
    }

    fn close_commands(&self) -> Result<(), Error> {
        // SAFETY: the command buffer is being recorded.
        unsafe { self.context.logical.raw.end_command_buffer(self.commands) }.during("end commands")
    }

    /// Continues in another command buffer if this one would take too long with the next command. Barriers hold between
    /// them, too: their order on the queue is that of one buffer.
    fn pace(&mut self, command: &Command) -> Result<(), Error> {
        let (Some(pace), Command::Dispatch(dispatch)) = (&self.context.pace, command) else { return Ok(()) };
        let (cuts, under_way) = pace.cuts(self.under_way, dispatch.work());
        self.under_way = under_way;
        if cuts {
            self.close_commands()?;
            self.open_commands()?;
            self.now = None; // the next kernel's time is not that between two submissions
        }
        Ok(())
    }

    fn barrier(
        &self,
        (source, source_access): (vk::PipelineStageFlags, vk::AccessFlags),
        (destination, destination_access): (vk::PipelineStageFlags, vk::AccessFlags),
    ) {
        let (device, commands, none) = (&self.context.logical.raw, self.commands, vk::DependencyFlags::empty());
        let memory = [vk::MemoryBarrier::default().src_access_mask(source_access).dst_access_mask(destination_access)];
        // SAFETY: the command buffer is being recorded.
        unsafe { device.cmd_pipeline_barrier(commands, source, destination, none, &memory, &[], &[]) };
    }

    fn command<'b>(
        &mut self,
        command: &Command,
        arguments: &Arguments,
        pipelines: &mut impl Iterator<Item = &'b Arc<Pipeline>>,
    ) -> Result<(), Error> {
        let (device, commands) = (&self.context.logical.raw, self.commands);
        if !matches!(command, Command::Begin(_) | Command::End | Command::Dispatch(_)) {
            self.now = None;
        }
        let copy = |from: &RawBuffer, to: &RawBuffer, [src_offset, dst_offset, size]: [u64; 3]| {
            let region = [vk::BufferCopy { src_offset, dst_offset, size }];
            // SAFETY: as below.
            unsafe { device.cmd_copy_buffer(commands, from.0.raw, to.0.raw, &region) };
        };
        // SAFETY: the command buffer is being recorded; every buffer is alive, and the recording keeps it so.
        unsafe {
            match command {
                Command::Dispatch(dispatch) => {
                    let pipeline = pipelines.next().expect("one pipeline a dispatch");
                    let begin = if self.context.pace.is_some() { self.timestamp() } else { None };
                    self.now = None;
                    self.label(Some(dispatch.shader.name));
                    self.bind(pipeline, arguments.push(dispatch), arguments.buffers(dispatch))?;
                    match &dispatch.size {
                        Size::Direct([x, y, z]) => device.cmd_dispatch(commands, *x, *y, *z),
                        Size::Indirect(b, offset) => device.cmd_dispatch_indirect(commands, b.0.raw, *offset),
                    }
                    self.label(None);
                    let end = begin.and_then(|_| self.timestamp());
                    if let (Some(begin), Some(end), Some(piece)) = (begin, end, self.dispatches.last_mut()) {
                        piece.push((dispatch.work(), Scope { name: dispatch.shader.name, begin, end }));
                    }
                }
                Command::Fill { buffer, bytes, value } => {
                    device.cmd_fill_buffer(commands, buffer.0.raw, 0, *bytes, *value);
                }
                Command::Update { buffer, data } => device.cmd_update_buffer(commands, buffer.0.raw, 0, data),
                Command::Copy { from, from_offset, to, to_offset, bytes } => {
                    copy(from, to, [*from_offset, *to_offset, *bytes]);
                }
                Command::ReadBack { from, to, to_offset, bytes } => copy(from, to, [0, *to_offset, *bytes]),
                Command::Begin(name) => {
                    self.label(Some(name));
                    self.begin(name);
                }
                Command::End => {
                    self.end();
                    self.label(None);
                }
            }
        }
        Ok(())
    }

    /// Binds a pipeline with its arguments.
    fn bind(&mut self, pipeline: &Pipeline, push: &[u8], buffers: &[RawBuffer]) -> Result<(), Error> {
        let (device, commands) = (&self.context.logical.raw, self.commands);
        let info = |b: &RawBuffer| vk::DescriptorBufferInfo { buffer: b.0.raw, offset: 0, range: vk::WHOLE_SIZE };
        self.bound.clear();
        self.bound.extend(buffers.iter().map(info));
        // SAFETY: the command buffer is being recorded; pipeline and buffers are alive, and are those of one shader.
        unsafe {
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.raw);
            self.context.logical.binder.bind(device, (commands, &self.frame.sets), &pipeline.layouts, &self.bound)?;
            if !push.is_empty() {
                device.cmd_push_constants(commands, pipeline.layouts.pipeline, vk::ShaderStageFlags::COMPUTE, 0, push);
            }
        }
        Ok(())
    }

    fn begin(&mut self, name: &'static str) {
        if let Some(query) = self.timestamp() {
            self.open.push(self.scopes.len());
            self.scopes.push(Scope { name, begin: query, end: query });
        }
    }

    fn end(&mut self) {
        if let (Some(scope), Some(query)) = (self.open.pop(), self.timestamp()) {
            self.scopes[scope].end = query;
        }
    }

    /// Writes the time at which all previous commands have finished; returns its query.
    fn timestamp(&mut self) -> Option<u32> {
        if !self.timed || self.now.is_some() {
            return self.now;
        }
        let (stage, query) = (vk::PipelineStageFlags::BOTTOM_OF_PIPE, self.queries);
        self.queries += 1;
        // SAFETY: the command buffer is being recorded; the frame has two queries per scope, and per dispatch where each is timed.
        unsafe {
            self.context.logical.raw.cmd_write_timestamp(self.commands, stage, self.frame.queries, query);
        }
        self.now = Some(query);
        self.now
    }

    /// Opens (or closes) a debug label.
    fn label(&self, name: Option<&str>) {
        let Some(debug) = &self.context.logical.debug else { return };
        let commands = self.commands;
        // SAFETY: the command buffer is being recorded; labels are opened and closed in pairs.
        unsafe {
            if let Some(name) = name.and_then(|n| CString::new(n).ok()) {
                debug.cmd_begin_debug_utils_label(commands, &vk::DebugUtilsLabelEXT::default().label_name(&name));
            } else {
                debug.cmd_end_debug_utils_label(commands);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Software devices would not show it: their kernels write into the host's memory.
    #[test]
    fn the_host_sees_what_kernels_write_behind_guarded_buffers() {
        let kernels = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
        for guarded in [false, true] {
            let (stages, access) = written_for_host(guarded);
            assert_eq!([stages.contains(kernels.0), access.contains(kernels.1)], [guarded; 2]);
            assert!(access.contains(vk::AccessFlags::TRANSFER_WRITE));
        }
    }
}

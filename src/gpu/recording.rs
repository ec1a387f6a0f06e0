//! A recording: commands as data. The commands declare how they use their buffers; barriers follow from that.

use super::buffer::{Buffer, RawBuffer};
use super::hazards::{Barrier, Hazards, Use};
use super::kernel::Kernel;
use super::pace::Work;
use super::shader::{Access, Shader};
use crate::kernels::constants::counts::{FEW_GROUPS, MAX_GROUPS};
use bytemuck::Pod;
use std::ops::Range;

/// The number of workgroups that a dispatch starts.
#[derive(Clone, Copy)]
pub enum Groups<'a> {
    /// This number of workgroups, laid out in two dimensions if one cannot hold them; kernels call `group_index()`.
    Count(u32),
    /// The three words of a buffer from this word on; see `primitives::arguments`.
    Indirect(&'a Buffer<u32>, u32),
}

pub(super) enum Size {
    Direct([u32; 3]),
    Indirect(RawBuffer, u64),
}

/// A kernel to run; its arguments lie in those of the recording.
pub(super) struct Dispatch {
    pub shader: &'static Shader,
    pub size: Size,
    constants: Range<usize>,
    push: Range<usize>,
    buffers: Range<usize>,
}

impl Dispatch {
    /// Its kernel and size.
    pub fn work(&self) -> Work {
        let groups = match self.size {
            Size::Direct(groups) => groups.iter().map(|n| u64::from(*n)).product(),
            Size::Indirect(..) => 0,
        };
        Work { kernel: self.shader.name, groups }
    }
}

pub(super) enum Command {
    Dispatch(Dispatch),
    Fill {
        buffer: RawBuffer,
        bytes: u64,
        value: u32,
    },
    Update {
        buffer: RawBuffer,
        data: Vec<u8>,
    },
    Copy {
        from: RawBuffer,
        from_offset: u64,
        to: RawBuffer,
        to_offset: u64,
        bytes: u64,
    },
    /// A copy into host-only memory; each copy has its own place until it has been waited for.
    ReadBack {
        from: RawBuffer,
        to: RawBuffer,
        to_offset: u64,
        bytes: u64,
    },
    Begin(&'static str),
    End,
}

/// Arguments of all dispatches of a recording, one after the other: an iteration has dozens of dispatches with a dozen
/// buffers each.
pub(super) struct Arguments {
    constants: Vec<u32>,
    push: Vec<u8>,
    buffers: Vec<RawBuffer>,
}

impl Arguments {
    fn add(&mut self, kernel: &dyn Kernel, size: Size) -> Dispatch {
        let (constants, push, buffers) = (self.constants.len(), self.push.len(), self.buffers.len());
        kernel.constants(&mut self.constants);
        self.push.extend_from_slice(kernel.push_bytes());
        kernel.buffers(&mut self.buffers);
        Dispatch {
            shader: kernel.shader(),
            size,
            constants: constants..self.constants.len(),
            push: push..self.push.len(),
            buffers: buffers..self.buffers.len(),
        }
    }

    /// Values of the specialization constants of a dispatch.
    pub fn constants(&self, dispatch: &Dispatch) -> &[u32] {
        &self.constants[dispatch.constants.clone()]
    }

    /// The push constants of a dispatch.
    pub fn push(&self, dispatch: &Dispatch) -> &[u8] {
        &self.push[dispatch.push.clone()]
    }

    /// The buffers of a dispatch, in binding order.
    pub fn buffers(&self, dispatch: &Dispatch) -> &[RawBuffer] {
        &self.buffers[dispatch.buffers.clone()]
    }
}

impl Command {
    /// Replaces `uses` by the command's uses of buffers (by number).
    pub(super) fn uses(&self, arguments: &Arguments, uses: &mut Vec<(u64, Use)>) {
        uses.clear();
        match self {
            Self::Dispatch(dispatch) => {
                for (buffer, access) in arguments.buffers(dispatch).iter().zip(dispatch.shader.bindings) {
                    if *access != Access::Write {
                        uses.push((buffer.number(), Use::KernelRead));
                    }
                    if *access != Access::Read {
                        uses.push((buffer.number(), Use::KernelWrite));
                    }
                }
                if let Size::Indirect(buffer, _) = &dispatch.size {
                    uses.push((buffer.number(), Use::IndirectRead));
                }
            }
            Self::Fill { buffer, .. } | Self::Update { buffer, .. } => uses.push((buffer.number(), Use::TransferWrite)),
            Self::Copy { from, to, .. } => {
                uses.extend([(from.number(), Use::TransferRead), (to.number(), Use::TransferWrite)]);
            }
            Self::ReadBack { from, .. } => uses.push((from.number(), Use::TransferRead)),
            Self::Begin(_) | Self::End => {}
        }
    }

    /// The kernel's name, or the kind of command.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Dispatch(dispatch) => dispatch.shader.name,
            Self::Fill { .. } => "fill",
            Self::Update { .. } => "update",
            Self::Copy { .. } | Self::ReadBack { .. } => "copy",
            Self::Begin(_) | Self::End => "scope",
        }
    }
}

/// Commands to run in order, as if each waited for the earlier ones that it depends on.
pub struct Recording {
    pub(super) commands: Vec<Command>,
    pub(super) arguments: Arguments,
}

impl Default for Recording {
    fn default() -> Self {
        Self::new()
    }
}

impl Recording {
    /// An empty recording, with room for an iteration of training.
    pub fn new() -> Self {
        let arguments = Arguments {
            constants: Vec::with_capacity(512),
            push: Vec::with_capacity(2048),
            buffers: Vec::with_capacity(512),
        };
        Self { commands: Vec::with_capacity(96), arguments }
    }

    /// Runs a kernel. A dispatch of no groups is left out.
    pub fn dispatch(&mut self, kernel: &dyn Kernel, groups: Groups<'_>) {
        let size = match groups {
            Groups::Count(0) => return,
            Groups::Count(n) => {
                // Rows of equal length: few surplus workgroups.
                let rows = n.div_ceil(MAX_GROUPS);
                Size::Direct([n.div_ceil(rows), rows, 1])
            }
            Groups::Indirect(buffer, word) => Size::Indirect(buffer.raw().clone(), u64::from(word) * 4),
        };
        let dispatch = self.arguments.add(kernel, size);
        self.commands.push(Command::Dispatch(dispatch));
    }

    /// Sets every word of a buffer.
    pub fn fill<T: Pod>(&mut self, buffer: &Buffer<T>, value: u32) {
        let bytes = buffer.raw().bytes();
        self.commands.push(Command::Fill { buffer: buffer.raw().clone(), bytes, value });
    }

    /// Writes a few values (at most 64 KiB) at the buffer's start; they travel inside the recording.
    ///
    /// # Panics
    /// If `data` is larger than that, or than the buffer.
    pub fn update<T: Pod>(&mut self, buffer: &Buffer<T>, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        assert!(bytes.len() <= 65_536 && data.len() <= buffer.len() && bytes.len().is_multiple_of(4));
        if !bytes.is_empty() {
            self.commands.push(Command::Update { buffer: buffer.raw().clone(), data: bytes.to_vec() });
        }
    }

    /// Copies `count` elements.
    ///
    /// # Panics
    /// If either buffer is too short.
    pub fn copy<T: Pod>(&mut self, from: &Buffer<T>, to: &Buffer<T>, count: usize) {
        assert!(count <= from.len() && count <= to.len());
        self.copy_raw(from.raw(), 0, to.raw(), 0, (count * size_of::<T>()) as u64);
    }

    pub(super) fn copy_raw(&mut self, from: &RawBuffer, from_offset: u64, to: &RawBuffer, to_offset: u64, bytes: u64) {
        if bytes > 0 {
            let (from, to) = (from.clone(), to.clone());
            self.commands.push(Command::Copy { from, from_offset, to, to_offset, bytes });
        }
    }

    pub(super) fn read_back(&mut self, from: &RawBuffer, to: &RawBuffer, to_offset: u64, bytes: u64) {
        if bytes > 0 {
            self.commands.push(Command::ReadBack { from: from.clone(), to: to.clone(), to_offset, bytes });
        }
    }

    /// Times and labels the commands that `body` records.
    pub fn scope<R>(&mut self, name: &'static str, body: impl FnOnce(&mut Self) -> R) -> R {
        self.commands.push(Command::Begin(name));
        let result = body(self);
        self.commands.push(Command::End);
        result
    }

    /// Names of the kernels dispatched, in order; tests use it to show that disabled features cost nothing.
    pub fn kernels(&self) -> Vec<&'static str> {
        self.dispatches().map(|d| d.shader.name).collect()
    }

    /// The dispatches, in order.
    pub(super) fn dispatches(&self) -> impl Iterator<Item = &Dispatch> + Clone {
        self.commands.iter().filter_map(|c| match c {
            Command::Dispatch(dispatch) => Some(dispatch),
            _ => None,
        })
    }

    /// The barrier before each command, given the uses that earlier recordings left pending.
    pub fn barriers(&self, hazards: &mut Hazards) -> Vec<Option<Barrier>> {
        let mut uses = Vec::new();
        let barrier = |command: &Command| {
            command.uses(&self.arguments, &mut uses);
            hazards.next(&uses)
        };
        self.commands.iter().map(barrier).collect()
    }

    /// Lays dispatches out in two dimensions from few workgroups on, and moves all scopes, empty, to the beginning.
    pub(super) fn loosen(&mut self) {
        for command in &mut self.commands {
            if let Command::Dispatch(Dispatch { size: Size::Direct(size @ [_, 1, 1]), .. }) = command
                && size[0] > FEW_GROUPS
            {
                *size = [FEW_GROUPS, size[0].div_ceil(FEW_GROUPS), 1];
            }
        }
        let all = std::mem::take(&mut self.commands);
        let (scopes, work): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|c| matches!(c, Command::Begin(_) | Command::End));
        let begins = scopes.into_iter().filter(|c| matches!(c, Command::Begin(_)));
        self.commands = begins.flat_map(|begin| [begin, Command::End]).chain(work).collect();
    }

    pub(super) fn scopes(&self) -> usize {
        self.commands.iter().filter(|c| matches!(c, Command::Begin(_))).count()
    }
}

//! Barriers derived from declared accesses.
//!
//! Each buffer remembers the uses that later commands are not yet ordered after. A command that conflicts with one
//! (either writes) gets a global memory barrier after those uses; one barrier clears the same uses of every other
//! buffer too, so independent dispatches between two barriers stay unordered. A barrier that only kernels need ends
//! before kernels alone, so that a GPU need not delay its reading of commands. Any other ends before everything.

use ash::vk;
use rustc_hash::FxHashMap;

/// The use of a buffer by a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// A kernel reads it.
    KernelRead,
    /// A kernel writes it.
    KernelWrite,
    /// A dispatch reads its size from it.
    IndirectRead,
    /// A copy reads it.
    TransferRead,
    /// A copy, fill or update writes it.
    TransferWrite,
}

impl Use {
    const ALL: [Self; 5] =
        [Self::KernelRead, Self::KernelWrite, Self::IndirectRead, Self::TransferRead, Self::TransferWrite];

    const fn bit(self) -> u8 {
        1 << self as u8
    }

    const fn is_kernels(self) -> bool {
        matches!(self, Self::KernelRead | Self::KernelWrite)
    }

    const fn writes(self) -> bool {
        matches!(self, Self::KernelWrite | Self::TransferWrite)
    }

    const fn stage(self) -> vk::PipelineStageFlags {
        match self {
            Self::KernelRead | Self::KernelWrite => vk::PipelineStageFlags::COMPUTE_SHADER,
            Self::IndirectRead => vk::PipelineStageFlags::DRAW_INDIRECT,
            Self::TransferRead | Self::TransferWrite => vk::PipelineStageFlags::TRANSFER,
        }
    }

    const fn write_access(self) -> vk::AccessFlags {
        match self {
            Self::KernelWrite => vk::AccessFlags::SHADER_WRITE,
            Self::TransferWrite => vk::AccessFlags::TRANSFER_WRITE,
            _ => vk::AccessFlags::empty(),
        }
    }
}

/// The reason for a barrier between two commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Hazard {
    /// A kernel reads what a kernel wrote.
    ReadAfterWrite,
    /// A kernel writes what a kernel read.
    WriteAfterRead,
    /// A kernel writes what a kernel wrote.
    WriteAfterWrite,
    /// One of the two uses is a dispatch that reads its size from the buffer.
    Indirect,
    /// One of the two uses is a copy's, a fill's or an update's.
    Transfer,
}

impl Hazard {
    /// All hazards.
    pub const ALL: [Self; 5] =
        [Self::ReadAfterWrite, Self::WriteAfterRead, Self::WriteAfterWrite, Self::Indirect, Self::Transfer];

    /// The hazard between two uses of a buffer, one of which writes.
    pub(super) fn between(earlier: Use, later: Use) -> Self {
        let either = |u: Use| earlier == u || later == u;
        if either(Use::TransferRead) || either(Use::TransferWrite) {
            Self::Transfer
        } else if either(Use::IndirectRead) {
            Self::Indirect
        } else {
            match (earlier.writes(), later.writes()) {
                (true, true) => Self::WriteAfterWrite,
                (true, false) => Self::ReadAfterWrite,
                (false, _) => Self::WriteAfterRead,
            }
        }
    }
}

const WRITES: u8 = Use::KernelWrite.bit() | Use::TransferWrite.bit();

/// Uses that a barrier for others ends at no further cost: it waits for whole stages and for their predecessors. The
/// size of a dispatch is read before its kernel runs.
const fn ended_with(uses: u8) -> u8 {
    const KERNELS: u8 = Use::KernelRead.bit() | Use::KernelWrite.bit();
    const TRANSFERS: u8 = Use::TransferRead.bit() | Use::TransferWrite.bit();
    let kernels = if uses & KERNELS != 0 { KERNELS | Use::IndirectRead.bit() } else { 0 };
    let transfers = if uses & TRANSFERS != 0 { TRANSFERS } else { 0 };
    kernels | transfers
}

/// A global memory barrier before a command: the uses to wait for, and the stages that wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Barrier {
    uses: u8,
    before_kernels_alone: bool,
}

impl Barrier {
    /// Whether this barrier waits for `earlier`.
    pub const fn waits_for(self, earlier: Use) -> bool {
        self.uses & earlier.bit() != 0
    }

    pub(super) fn source(self) -> (vk::PipelineStageFlags, vk::AccessFlags) {
        let mut stages = vk::PipelineStageFlags::empty();
        let mut access = vk::AccessFlags::empty();
        for u in Use::ALL {
            if self.waits_for(u) {
                stages |= u.stage();
                access |= u.write_access();
            }
        }
        (stages, access)
    }

    pub(super) fn destination(self) -> (vk::PipelineStageFlags, vk::AccessFlags) {
        let (stage, access) =
            (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
        if self.before_kernels_alone {
            return (stage, access);
        }
        (
            stage | vk::PipelineStageFlags::TRANSFER | vk::PipelineStageFlags::DRAW_INDIRECT,
            access
                | vk::AccessFlags::TRANSFER_READ
                | vk::AccessFlags::TRANSFER_WRITE
                | vk::AccessFlags::INDIRECT_COMMAND_READ,
        )
    }
}

/// Pending uses of one buffer: those that later commands are not ordered after yet.
#[derive(Clone, Copy, Debug, Default)]
struct Pending {
    /// Uses that later kernels must wait for.
    before_kernels: u8,
    /// Uses that all other later commands must wait for.
    before_others: u8,
}

impl Pending {
    fn before(self, later: Use) -> u8 {
        if later.is_kernels() { self.before_kernels } else { self.before_others }
    }
}

/// Pending uses of each buffer, by its number.
#[derive(Clone, Debug, Default)]
pub struct Hazards {
    pending: FxHashMap<u64, Pending>,
    doubted: bool,
}

impl Hazards {
    /// The pending uses that conflict with the next command's, each with the conflicting use.
    pub(super) fn conflicts(&self, uses: &[(u64, Use)]) -> impl Iterator<Item = (Use, Use)> {
        uses.iter().flat_map(|&(buffer, later)| {
            let pending = self.pending.get(&buffer).map_or(0, |pending| pending.before(later));
            let conflicting = if later.writes() { pending } else { pending & WRITES };
            Use::ALL.into_iter().filter(move |u| conflicting & u.bit() != 0).map(move |earlier| (earlier, later))
        })
    }

    /// Adds the next command's uses and returns the barrier that must come before it, if any.
    pub fn next(&mut self, uses: &[(u64, Use)]) -> Option<Barrier> {
        let (mut wait, mut before_kernels_alone) = (0, true);
        for (earlier, later) in self.conflicts(uses) {
            wait |= earlier.bit();
            before_kernels_alone &= later.is_kernels();
        }
        if self.doubted && !uses.is_empty() {
            wait = Use::ALL.iter().fold(0, |all, u| all | u.bit());
            before_kernels_alone = false;
            self.doubted = false;
        }
        wait |= ended_with(wait);
        if wait != 0 {
            self.pending.retain(|_, pending| {
                pending.before_kernels &= !wait;
                pending.before_others &= if before_kernels_alone { u8::MAX } else { !wait };
                pending.before_kernels | pending.before_others != 0
            });
        }
        for (buffer, u) in uses {
            let pending = self.pending.entry(*buffer).or_default();
            pending.before_kernels |= u.bit();
            pending.before_others |= u.bit();
        }
        (wait != 0).then_some(Barrier { uses: wait, before_kernels_alone })
    }

    /// Handles a recording that was never submitted although its barriers were derived: the next command waits for
    /// everything.
    pub fn doubt(&mut self) {
        self.doubted = true;
    }

    /// Removes a freed buffer.
    pub fn forget(&mut self, buffer: u64) {
        self.pending.remove(&buffer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Use::{IndirectRead, KernelRead, KernelWrite, TransferWrite};

    #[test]
    fn reads_need_no_barrier_between_them() {
        let mut h = Hazards::default();
        assert_eq!(h.next(&[(1, KernelRead)]), None);
        assert_eq!(h.next(&[(1, KernelRead), (2, KernelWrite)]), None);
    }

    #[test]
    fn each_kind_of_hazard_gets_a_barrier() {
        let mut h = Hazards::default();
        assert_eq!(h.next(&[(1, KernelWrite)]), None);
        assert!(h.next(&[(1, KernelRead)]).expect("read after write").waits_for(KernelWrite));
        assert!(h.next(&[(1, KernelWrite)]).expect("write after read").waits_for(KernelRead));
        assert!(h.next(&[(1, KernelWrite)]).expect("write after write").waits_for(KernelWrite));
        assert!(h.next(&[(1, IndirectRead)]).expect("indirect after write").waits_for(KernelWrite));
    }

    #[test]
    fn hazards_have_kinds() {
        let mut h = Hazards::default();
        h.next(&[(1, KernelRead), (2, KernelWrite), (3, KernelWrite)]);
        let uses = [(1, KernelWrite), (2, IndirectRead), (3, TransferWrite), (4, KernelRead)];
        let kinds: Vec<Hazard> = h.conflicts(&uses).map(|(a, b)| Hazard::between(a, b)).collect();
        assert_eq!(kinds, [Hazard::WriteAfterRead, Hazard::Indirect, Hazard::Transfer]);
        assert_eq!(Hazard::between(KernelWrite, KernelRead), Hazard::ReadAfterWrite);
        assert_eq!(Hazard::between(KernelWrite, KernelWrite), Hazard::WriteAfterWrite);
    }

    #[test]
    fn one_barrier_serves_all_buffers() {
        let mut h = Hazards::default();
        h.next(&[(1, KernelWrite)]);
        h.next(&[(2, KernelWrite)]);
        assert!(h.next(&[(1, KernelRead)]).is_some());
        assert_eq!(h.next(&[(2, KernelRead)]), None);
        h.next(&[(3, TransferWrite)]);
        assert!(h.next(&[(3, KernelRead)]).expect("after a copy").waits_for(TransferWrite));
    }

    #[test]
    fn a_barrier_ends_before_what_needs_it() {
        let mut h = Hazards::default();
        h.next(&[(1, KernelWrite), (2, KernelWrite)]);
        assert!(h.next(&[(1, KernelRead)]).expect("a kernel reads it").before_kernels_alone);
        let sized = [(1, KernelRead), (2, IndirectRead)];
        assert!(!h.next(&sized).expect("a size was not ready for that").before_kernels_alone);
        assert_eq!(h.next(&[(1, IndirectRead), (2, KernelRead)]), None, "all were waited for");
        h.next(&[(1, KernelWrite)]);
        h.next(&[(1, KernelRead)]);
        assert!(h.next(&[(1, TransferWrite)]).expect("nor was a copy held back").waits_for(KernelWrite));
    }

    #[test]
    fn a_barrier_ends_whole_stages() {
        let mut h = Hazards::default();
        h.next(&[(1, KernelWrite), (2, KernelRead), (3, IndirectRead), (4, TransferWrite)]);
        assert!(h.next(&[(1, KernelRead)]).is_some());
        assert_eq!(h.next(&[(2, KernelWrite), (3, KernelWrite)]), None, "kernels and their sizes are over");
        assert!(h.next(&[(4, KernelRead)]).is_some(), "copies are not");
    }

    #[test]
    fn after_a_recording_that_was_not_submitted_all_is_waited_for() {
        let mut h = Hazards::default();
        h.next(&[(1, KernelWrite)]);
        // This barrier is never submitted.
        assert!(h.next(&[(1, KernelRead)]).is_some());
        h.doubt();
        assert_eq!(h.next(&[]), None);
        let barrier = h.next(&[(1, KernelRead)]).expect("before the next command");
        assert!(Use::ALL.iter().all(|u| barrier.waits_for(*u)));
        assert_eq!(h.next(&[(1, KernelRead)]), None);
    }

    #[test]
    fn a_kernel_that_reads_and_writes_one_buffer_does_not_wait_for_itself() {
        let mut h = Hazards::default();
        assert_eq!(h.next(&[(1, KernelRead), (1, KernelWrite)]), None);
        assert!(h.next(&[(1, KernelRead), (1, KernelWrite)]).is_some());
    }
}

//! Counted work: the commands and bytes of a recording, known before it runs and equal on every machine.

use super::hazards::Hazards;
use super::recording::{Arguments, Command, Recording};
use super::shader::Access;

/// The work of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Kernels started.
    pub dispatches: usize,
    /// Copies, fills and updates.
    pub transfers: usize,
    /// Barriers between commands.
    pub barriers: usize,
    /// Bytes of all arrays that commands read: each binding counts in full, once per dispatch.
    pub read: u64,
    /// Bytes of all arrays that commands write, counted likewise.
    pub written: u64,
}

impl Recording {
    /// The work of this recording; `hazards` holds the uses that earlier recordings left pending.
    pub fn work(&self, hazards: &mut Hazards) -> Work {
        let barriers = self.barriers(hazards).iter().flatten().count();
        let none = Work { barriers, ..Work::default() };
        self.commands.iter().fold(none, |all, command| all.plus(Work::of(command, &self.arguments)))
    }

    /// The work of the dispatches of one kernel.
    pub fn work_of(&self, kernel: &str) -> Work {
        let own = self.commands.iter().filter(|c| matches!(c, Command::Dispatch(d) if d.shader.name == kernel));
        own.fold(Work::default(), |all, command| all.plus(Work::of(command, &self.arguments)))
    }
}

impl Work {
    fn of(command: &Command, arguments: &Arguments) -> Self {
        let transfer = Self { transfers: 1, ..Self::default() };
        match command {
            Command::Dispatch(dispatch) => {
                let sum = |unwanted: Access| {
                    let bound = arguments.buffers(dispatch).iter().zip(dispatch.shader.bindings);
                    let counted = bound.filter(|(_, access)| **access != unwanted);
                    counted.map(|(buffer, _)| buffer.bytes()).sum()
                };
                Self { dispatches: 1, read: sum(Access::Write), written: sum(Access::Read), ..Self::default() }
            }
            Command::Fill { bytes, .. } => Self { written: *bytes, ..transfer },
            Command::Update { data, .. } => Self { written: data.len() as u64, ..transfer },
            Command::Copy { bytes, .. } | Command::ReadBack { bytes, .. } => {
                Self { read: *bytes, written: *bytes, ..transfer }
            }
            Command::Begin(_) | Command::End => Self::default(),
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            dispatches: self.dispatches + other.dispatches,
            transfers: self.transfers + other.transfers,
            barriers: self.barriers + other.barriers,
            read: self.read + other.read,
            written: self.written + other.written,
        }
    }
}

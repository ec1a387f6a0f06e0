//! SPIR-V modules in the form that a device takes.

use super::error::Error;
use super::info::{DeviceClass, DeviceKind};
use super::shader::Shader;
use std::path::PathBuf;

/// Words of a module's header; its capabilities follow, then its extensions.
const HEADER: usize = 5;
/// Low half of an instruction's first word; the high half is its length in words.
const OP_EXTENSION: u32 = 10;
const OP_ENTRY_POINT: u32 = 15;
const OP_EXECUTION_MODE: u32 = 16;
const OP_CAPABILITY: u32 = 17;
const OP_LOOP_MERGE: u32 = 246;
/// Bits of the control of a loop.
const UNROLL: u32 = 1;
const DONT_UNROLL: u32 = 2;
const SIGNED_ZERO_INF_NAN_PRESERVE: u32 = 4461;
const SIGNED_ZERO_INF_NAN_PRESERVE_CAPABILITY: u32 = 4466;
const SUBGROUP_UNIFORM_CONTROL_FLOW: u32 = 4421;
const SUBGROUP_UNIFORM_CONTROL_FLOW_EXTENSION: &[u8] = b"SPV_KHR_subgroup_uniform_control_flow";

/// The source of modules, and additions to them.
#[derive(Clone, Debug, Default)]
pub(super) struct Modules {
    /// Folder of modules that replace the program's own of the same name (tests of mutants).
    pub folder: Option<PathBuf>,
    /// Whether modules declare that float32 infinities and NaN are kept: without it, Vulkan lets a driver assume that
    /// there are none. Only devices with the property accept it.
    pub keep_nan: bool,
    /// Whether modules declare that a subgroup that enters a construct as one leaves it as one: without it, SPIR-V says so of
    /// whole workgroups alone, and the subgroups of a tile walk loops of different lengths.
    pub reconverge: bool,
    /// Loops that the driver is asked to leave as loops.
    pub loops: Loops,
}

/// The loops that modules ask a driver not to unroll. A GPU's compiler decides for itself; that of a CPU device takes seconds for
/// what it unrolls, and gains nothing (decision 188).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Loops {
    /// No loops.
    #[default]
    Free,
    /// Loops that the shader does not ask to unroll.
    Unmarked,
    /// All.
    Every,
}

impl Loops {
    /// The choice for kernels of a class on a device of a kind. On a CPU device, kernels in the shapes of GPUs are
    /// for tests.
    pub fn of(kind: DeviceKind, class: DeviceClass) -> Self {
        match (kind, class) {
            (DeviceKind::Cpu, DeviceClass::Cpu | DeviceClass::SwiftShader) => Self::Unmarked,
            (DeviceKind::Cpu, _) => Self::Every,
            _ => Self::Free,
        }
    }

    /// Marks these loops of a module `DontUnroll`.
    fn ask(self, words: &mut [u32]) {
        let controls: &[u32] = match self {
            Self::Free => &[],
            Self::Unmarked => &[0],
            Self::Every => &[0, UNROLL],
        };
        let merges = instructions(words).filter(|i| i.operation == OP_LOOP_MERGE);
        for at in merges.map(|i| i.at + 3).collect::<Vec<_>>() {
            if words.get(at).is_some_and(|control| controls.contains(control)) {
                words[at] = DONT_UNROLL;
            }
        }
    }
}

impl Modules {
    /// The module of a shader.
    pub fn words(&self, shader: &Shader) -> Result<Vec<u32>, Error> {
        let replaced = self.folder.as_ref().map(|f| f.join(format!("{}.spv", shader.name.replace('/', "-"))));
        let mut words = match replaced.filter(|path| path.is_file()) {
            Some(path) => {
                let unreadable = |e| Error::Shader { path: path.clone(), what: format!("{e}") };
                words(&std::fs::read(&path).map_err(unreadable)?)
            }
            None => words(shader.spirv),
        };
        self.loops.ask(&mut words);
        if self.keep_nan {
            let capability = [OP_CAPABILITY | 2 << 16, SIGNED_ZERO_INF_NAN_PRESERVE_CAPABILITY];
            declare(&mut words, &capability, &[SIGNED_ZERO_INF_NAN_PRESERVE, 32]);
        }
        if self.reconverge {
            declare(&mut words, &extension(SUBGROUP_UNIFORM_CONTROL_FLOW_EXTENSION), &[SUBGROUP_UNIFORM_CONTROL_FLOW]);
        }
        Ok(words)
    }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect()
}

/// The instruction that declares an extension.
fn extension(name: &[u8]) -> Vec<u32> {
    // Text ends with a zero byte.
    let padded = [name, &[0; 4][..4 - name.len() % 4]].concat();
    let length = 1 + padded.len() as u32 / 4;
    [vec![OP_EXTENSION | length << 16], words(&padded)].concat()
}

/// Adds a capability or an extension, and an execution mode of the module's only entry point.
fn declare(words: &mut Vec<u32>, needed: &[u32], mode: &[u32]) {
    let Some(entry) = instructions(words).find(|i| i.operation == OP_ENTRY_POINT) else { return };
    let after_capabilities =
        instructions(words).take_while(|i| i.operation == OP_CAPABILITY).last().map_or(HEADER, |i| i.at + i.length);
    let head = [OP_EXECUTION_MODE | (2 + mode.len() as u32) << 16, words[entry.at + 2]];
    words.splice(entry.at + entry.length..entry.at + entry.length, head.iter().chain(mode).copied());
    words.splice(after_capabilities..after_capabilities, needed.iter().copied());
}

/// An instruction of a module.
struct Instruction {
    /// Its first word.
    at: usize,
    /// Its length in words.
    length: usize,
    operation: u32,
}

/// The instructions of a module.
fn instructions(words: &[u32]) -> impl Iterator<Item = Instruction> {
    let mut at = HEADER;
    std::iter::from_fn(move || {
        let word = words.get(at)?;
        let found = Instruction { at, length: (word >> 16).max(1) as usize, operation: word & 0xffff };
        at += found.length;
        Some(found)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_stand_behind_the_entry_point_and_what_they_need_behind_the_capabilities() {
        let header = [0x0723_0203, 0x0001_0500, 0, 9, 0];
        let shader = [OP_CAPABILITY | 2 << 16, 1, 0xe | 3 << 16, 0, 1];
        let entry = [OP_ENTRY_POINT | 5 << 16, 5, 4, 0x6e69_616d, 0];
        let rest = [OP_EXECUTION_MODE | 6 << 16, 4, 17, 1, 1, 1];
        let mut words = [&header[..], &shader, &entry, &rest].concat();
        let capability = [OP_CAPABILITY | 2 << 16, 4466];
        declare(&mut words, &capability, &[4461, 32]);
        let named = extension(b"SPV_four");
        assert_eq!(named, [OP_EXTENSION | 4 << 16, 0x5f56_5053, 0x7275_6f66, 0]);
        assert_eq!(extension(b"SPV"), [OP_EXTENSION | 2 << 16, 0x0056_5053]);
        declare(&mut words, &named, &[4421]);
        let modes = [OP_EXECUTION_MODE | 3 << 16, 4, 4421, OP_EXECUTION_MODE | 4 << 16, 4, 4461, 32];
        let (first, memory) = shader.split_at(2);
        assert_eq!(words, [&header[..], first, &capability, &named, memory, &entry, &modes, &rest].concat());
    }

    #[test]
    fn loops_stay_loops_on_cpus_alone() {
        let of = |loops: Loops| {
            let merge = |control| [OP_LOOP_MERGE | 4 << 16, 8, 9, control];
            let mut words =
                [&[0x0723_0203, 0x0001_0500, 0, 9, 0][..], &merge(0), &merge(UNROLL), &merge(DONT_UNROLL)].concat();
            loops.ask(&mut words);
            [words[8], words[12], words[16]]
        };
        assert_eq!(of(Loops::Free), [0, UNROLL, DONT_UNROLL]);
        assert_eq!(of(Loops::Unmarked), [DONT_UNROLL, UNROLL, DONT_UNROLL]);
        assert_eq!(of(Loops::Every), [DONT_UNROLL; 3]);
        assert_eq!(Loops::of(DeviceKind::Discrete, DeviceClass::Cpu), Loops::Free);
        assert_eq!(Loops::of(DeviceKind::Cpu, DeviceClass::Cpu), Loops::Unmarked);
        assert_eq!(Loops::of(DeviceKind::Cpu, DeviceClass::Nvidia), Loops::Every);
    }
}

//! SPIR-V modules in the form that a device takes.

use super::error::Error;
use super::kernel::Shader;
use std::path::PathBuf;

/// Words of a module's header; its capabilities follow.
const HEADER: usize = 5;
/// Low half of an instruction's first word; the high half is its length in words.
const OP_ENTRY_POINT: u32 = 15;
const OP_EXECUTION_MODE: u32 = 16;
const OP_CAPABILITY: u32 = 17;
const SIGNED_ZERO_INF_NAN_PRESERVE: u32 = 4461;
const SIGNED_ZERO_INF_NAN_PRESERVE_CAPABILITY: u32 = 4466;

/// The source of modules, and additions to them.
#[derive(Clone, Debug, Default)]
pub(super) struct Modules {
    /// Folder of modules that replace the program's own of the same name (tests of mutants).
    pub folder: Option<PathBuf>,
    /// Whether modules declare that float32 infinities and NaN are kept: without it, Vulkan lets a driver assume that
    /// there are none. Only devices with the property accept it.
    pub keep_nan: bool,
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
        if self.keep_nan {
            keep_nan(&mut words);
        }
        Ok(words)
    }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect()
}

/// Declares that the module's only entry point keeps float32 infinities, NaN and the signs of zeros.
fn keep_nan(words: &mut Vec<u32>) {
    let mut at = HEADER;
    while let Some(word) = words.get(at) {
        let (length, operation) = ((word >> 16) as usize, word & 0xffff);
        if operation == OP_ENTRY_POINT {
            let main = words[at + 2];
            let mode = [OP_EXECUTION_MODE | 4 << 16, main, SIGNED_ZERO_INF_NAN_PRESERVE, 32];
            words.splice(at + length..at + length, mode);
            let capability = [OP_CAPABILITY | 2 << 16, SIGNED_ZERO_INF_NAN_PRESERVE_CAPABILITY];
            words.splice(HEADER..HEADER, capability);
            return;
        }
        at += length.max(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mode_stands_behind_the_entry_point() {
        let header = [0x0723_0203, 0x0001_0500, 0, 9, 0];
        let shader = [OP_CAPABILITY | 2 << 16, 1, 0xe | 3 << 16, 0, 1];
        let entry = [OP_ENTRY_POINT | 5 << 16, 5, 4, 0x6e69_616d, 0];
        let rest = [OP_EXECUTION_MODE | 6 << 16, 4, 17, 1, 1, 1];
        let mut words = [&header[..], &shader, &entry, &rest].concat();
        keep_nan(&mut words);
        let capability = [OP_CAPABILITY | 2 << 16, 4466];
        let mode = [OP_EXECUTION_MODE | 4 << 16, 4, 4461, 32];
        assert_eq!(words, [&header[..], &capability, &shader, &entry, &mode, &rest].concat());
    }
}

//! Shaders as reflected by the build script.

/// A kernel's access to a binding, from the shader's own qualifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// `readonly`.
    Read,
    /// `writeonly`: every element that counts is written.
    Write,
    /// The shader has neither qualifier, and may read and write.
    ReadWrite,
}

/// A compute shader: SPIR-V and its reflection.
#[derive(Debug)]
pub struct Shader {
    /// `room/stage`: the debug label and profiler name.
    pub name: &'static str,
    /// The module, little-endian words.
    pub spirv: &'static [u8],
    /// The kernel's access to bindings 0, 1, ...
    pub bindings: &'static [Access],
    /// Bytes of push constants.
    pub push_size: u32,
    /// Identifiers of the specialization constants, in the order of [`super::Kernel::constants`].
    pub constants: &'static [u32],
    /// The constant that receives the subgroup size, if any.
    pub subgroup_constant: Option<u32>,
    /// The constant that reverses the order of workgroups, if any.
    pub backwards_constant: Option<u32>,
}

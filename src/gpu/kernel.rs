//! Kernels: shaders with their arguments.

use super::buffer::RawBuffer;
use super::shader::Shader;

/// A shader with its arguments; implemented by the generated structs of `crate::kernels`.
pub trait Kernel {
    /// The shader.
    fn shader(&self) -> &'static Shader;
    /// Appends the buffers in binding order.
    fn buffers(&self, into: &mut Vec<RawBuffer>);
    /// The push constants' bytes.
    fn push_bytes(&self) -> &[u8];
    /// Appends values of the specialization constants, as bits.
    fn constants(&self, into: &mut Vec<u32>);
}

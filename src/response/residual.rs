//! The residual of a picture against its photo.

use crate::gpu::{Buffer, Groups, Recording};
use crate::kernels::constants::photo;
use crate::kernels::response::{Residual, ResidualPush, ResidualSpec};
use crate::primitives::WORKGROUP;

/// Records the mean over the colours of |picture - photo| into the gradient's fourth component, after the loss.
///
/// Where `transparent`, the photo's fourth byte is its opacity over `background`.
pub fn record_residual(
    recording: &mut Recording,
    image: &Buffer<[f32; 4]>,
    photo: &Buffer<u32>,
    gradient: &Buffer<[f32; 4]>,
    [width, height]: [u32; 2],
    transparent: bool,
    [r, g, b]: [f32; 3],
) {
    let pixels = width * height;
    let kernel = Residual {
        image: &image.cast(),
        photo,
        gradient: &gradient.cast(),
        push: ResidualPush { background: [r, g, b, 0.0], pixels },
        spec: ResidualSpec { workgroup: WORKGROUP, alpha: if transparent { photo::OPACITY } else { photo::OPAQUE } },
    };
    recording.scope("residual", |r| r.dispatch(&kernel, Groups::Count(pixels.div_ceil(WORKGROUP))));
}

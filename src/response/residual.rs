//! The residual of a picture against its photo.

use crate::gpu::{Buffer, Groups, Recording};
use crate::kernels::constants::photo;
use crate::kernels::response::{Residual, ResidualPush, ResidualSpec};
use crate::primitives::WORKGROUP;
use crate::scene::AlphaRole;

/// The photo that a picture is compared with.
#[derive(Clone, Copy)]
pub struct Target<'a> {
    /// RGBA, 8 bits each.
    pub photo: &'a Buffer<u32>,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Meaning of the photo's fourth byte.
    pub alpha_role: AlphaRole,
    /// Colour that shows through the photo where its fourth byte is below 255.
    pub background: [f32; 3],
}

/// Records the mean of |picture - photo| over the colours into the fourth component of the gradient, after the loss.
pub fn record_residual(
    recording: &mut Recording,
    image: &Buffer<[f32; 4]>,
    target: Target<'_>,
    gradient: &Buffer<[f32; 4]>,
) {
    let Target { photo, size: [width, height], alpha_role, background: [r, g, b] } = target;
    let alpha = if alpha_role.shows_background() { photo::OPACITY } else { photo::OPAQUE };
    let pixels = width * height;
    let kernel = Residual {
        image: &image.cast(),
        photo,
        gradient: &gradient.cast(),
        push: ResidualPush { background: [r, g, b, 0.0], pixels },
        spec: ResidualSpec { workgroup: WORKGROUP, alpha },
    };
    recording.scope("residual", |r| r.dispatch(&kernel, Groups::Count(pixels.div_ceil(WORKGROUP))));
}

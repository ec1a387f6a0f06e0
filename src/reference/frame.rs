//! One view from parameters to pixels and back, stage by stage.

use super::{
    Params,
    bin::{Tiles, bin},
    project::{Culled, Projected, project},
    project_backward::project_backward,
    rasterise::{Composite, rasterise},
    rasterise_backward::{ImageGradient, SlotSums, rasterise_backward},
};
use crate::gaussians::MAX_SH_DEGREE;
use crate::kernels::constants::blending::float64::TRANSMITTANCE_STOP;
use crate::kernels::constants::view::float64::{DILATION, NEAR};
use crate::scene::camera::Camera;

/// Settings of image formation.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::struct_excessive_bools, reason = "switches of the formula, each on its own")]
pub struct Settings {
    /// Colour behind everything.
    pub background: [f64; 3],
    /// True if opacity includes the factor sqrt(max(det0/det, 2.5e-5)), which compensates for the area added by the
    /// dilation.
    pub antialias: bool,
    /// Added to a projected Gaussian's variance, in square pixels.
    pub dilation: f64,
    /// Side in pixels of the squares that share a list of Gaussians.
    pub tile: u32,
    /// True if each tile orders its list by the depths at which the ray through its middle meets the Gaussians;
    /// otherwise the whole picture is ordered by the depth of means. Tiles of one pixel give each pixel its own order.
    pub depth_order: bool,
    /// Gaussians at this camera-space depth, or nearer, are culled.
    pub near: f64,
    /// Tests only: without the 1/255 skip and the transmittance stop, so that finite differences hold.
    pub smooth_cutoff: bool,
    /// True if the gradient by the view direction is passed on to the mean.
    pub direction_gradient: bool,
    /// A pixel stops before the contribution that would lower its transmittance below this.
    pub transmittance_stop: f64,
    /// SH bands above this degree are ignored.
    pub sh_degree: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            antialias: false,
            dilation: DILATION,
            tile: 16,
            depth_order: false,
            near: NEAR,
            smooth_cutoff: false,
            direction_gradient: true,
            transmittance_stop: TRANSMITTANCE_STOP,
            sh_degree: MAX_SH_DEGREE,
        }
    }
}

/// A rendered view and the intermediate results of its stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// Pixels, opacities and contributions.
    pub composite: Composite,
    /// Projection of each Gaussian, or the reason why it was culled.
    pub projected: Vec<Result<Projected, Culled>>,
    /// Gaussians of each tile, front to back.
    pub tiles: Tiles,
}

/// Gradients of a loss on one view.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// Gradients by the stored parameters.
    pub params: Params,
    /// Gradient by each Gaussian's image mean in NDC units (x 0.5 width, x 0.5 height): density control takes its norm.
    pub mean2d_ndc: Vec<[f64; 2]>,
    /// The rasteriser's sums of each Gaussian.
    pub sums: Vec<SlotSums>,
}

/// Renders one view.
pub fn render(params: &Params, camera: &Camera, settings: &Settings) -> Rendered {
    let projected = project(params, camera, settings);
    let tiles = bin(&projected, camera, settings);
    let composite = rasterise(&projected, &tiles, camera, settings);
    Rendered { composite, projected, tiles }
}

/// Gradients of a loss whose derivatives are `dl_dimage` by the image's pixels and, if given, `dl_dalpha` by its
/// opacities.
pub fn gradients(
    params: &Params,
    camera: &Camera,
    settings: &Settings,
    dl_dimage: &[[f64; 3]],
    dl_dalpha: Option<&[f64]>,
) -> Gradients {
    let Rendered { composite, projected, tiles } = render(params, camera, settings);
    let gradient = ImageGradient { colour: dl_dimage, alpha: dl_dalpha };
    let sums = rasterise_backward(&projected, &tiles, camera, settings, &composite, gradient);
    let mut by_params = params.zeros_like();
    let half = [0.5 * f64::from(camera.width), 0.5 * f64::from(camera.height)];
    let mean2d_ndc = sums
        .iter()
        .enumerate()
        .map(|(i, own)| {
            let by_mean = project_backward(params, i, camera, settings, own, &mut by_params);
            [by_mean.x * half[0], by_mean.y * half[1]]
        })
        .collect();
    Gradients { params: by_params, mean2d_ndc, sums }
}

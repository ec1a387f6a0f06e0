//! Options of the style of rendering, which must match training.

use crate::render::Style;
use clap::Args;

#[derive(Clone, Debug, Args)]
pub struct Rendering {
    /// Keep the energy of Gaussians smaller than a pixel (models trained with anti-aliasing)
    #[arg(long, help_heading = "Rendering")]
    antialias: bool,
    /// Give each tile of the picture its own depth order (models trained with depth_order; nothing pops in front of
    /// another as the camera turns)
    #[arg(long, help_heading = "Rendering")]
    depth_order: bool,
}

impl Rendering {
    /// The style that the options select.
    pub fn style(&self) -> Style {
        Style { antialias: self.antialias, depth_order: self.depth_order }
    }
}

//! How a model is rendered: as it was trained.

use crate::render::Style;
use clap::Args;

#[derive(Clone, Debug, Args)]
pub struct Rendering {
    /// Keep each Gaussian's energy where it is smaller than a pixel (models trained with anti-aliasing)
    #[arg(long, help_heading = "Rendering")]
    antialias: bool,
    /// Give each tile of the picture a depth order of its own (models trained with depth_order; nothing pops in front of
    /// another as the camera turns)
    #[arg(long, help_heading = "Rendering")]
    depth_order: bool,
}

impl Rendering {
    /// What was asked for.
    pub fn style(&self) -> Style {
        Style { antialias: self.antialias, depth_order: self.depth_order }
    }
}

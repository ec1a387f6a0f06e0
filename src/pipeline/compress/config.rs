//! What a compression is asked to do.

use crate::pipeline::config::{Compression, Selection};
use crate::pipeline::virtual_views::VirtualCameras;
use crate::render::Style;

/// How a model is compressed.
#[derive(Clone, Debug, PartialEq)]
pub struct CompressConfig {
    /// How Gaussians are chosen.
    pub compression: Compression,
    /// Views that the model is judged by.
    pub views: ViewSource,
    /// How it is rendered: as the model was trained.
    pub style: Style,
    /// Iterations of training after the prune.
    pub fine_tune: u32,
    /// Key of all random numbers.
    pub seed: u32,
}

/// Where the views come from that a model is judged by.
#[derive(Clone, Debug, PartialEq)]
pub enum ViewSource {
    /// A scene's photos.
    Photos(Selection),
    /// The model's own pictures.
    OwnPictures {
        /// Their cameras.
        cameras: VirtualCameras,
        /// Red, green and blue behind the model, in [0, 1].
        background: [f32; 3],
    },
}

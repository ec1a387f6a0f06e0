//! Configuration of a compression.

use crate::pipeline::config::{PruneRule, Selection};
use crate::pipeline::virtual_views::VirtualCameras;
use crate::render::Style;
use serde::{Deserialize, Serialize};

/// How a model is compressed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompressConfig {
    /// Choice of Gaussians.
    pub compression: PruneRule,
    /// Views that the model is scored on.
    pub views: ViewSource,
    /// Style of rendering: the one that the model was trained with.
    pub style: Style,
    /// Iterations of training after the prune.
    pub fine_tune: u32,
    /// Key of all random numbers.
    pub seed: u32,
}

/// Source of the views that a model is scored on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
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

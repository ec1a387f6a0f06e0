//! Configuration of a compression.

use crate::job::Selection;
use crate::job::config::PruneRule;
use crate::pipeline::virtual_views::VirtualCameras;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Budget;
use crate::render::Style;
use serde::{Deserialize, Serialize};

/// Configuration of a compression.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompressConfig {
    /// Choice of Gaussians.
    pub compression: PruneRule,
    /// Views that the model is scored on.
    pub views: ViewSource,
    /// Style of rendering: the one that the model was trained with.
    pub style: Style,
    /// True if photos have exposures of their own: fitted before scores, and learnt in fine-tuning, as in a run.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub exposure: bool,
    /// Iterations of training after the prune.
    pub fine_tune: u32,
    /// Key of all random numbers.
    pub seed: u32,
}

impl CompressConfig {
    /// The default rule of a compression, with this many iterations of training after it. Without training, every block keeps
    /// its share, since no other block can replace its losses.
    pub fn rule(fine_tune: u32) -> PruneRule {
        let budget = if fine_tune == 0 { Budget::PerBlock } else { Budget::default() };
        PruneRule { selector: Selector::Pairs, budget, ..PruneRule::default() }
    }
}

impl Default for CompressConfig {
    /// Merges pairs by the model's own pictures over black, without training afterwards.
    fn default() -> Self {
        Self {
            compression: Self::rule(0),
            views: ViewSource::default(),
            style: Style::default(),
            exposure: false,
            fine_tune: 0,
            seed: 1,
        }
    }
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

impl Default for ViewSource {
    fn default() -> Self {
        Self::OwnPictures { cameras: VirtualCameras::default(), background: [0.0; 3] }
    }
}

//! CompressArgs of a compression, for `compress` and `shard plan`.

use super::choices::Choices;
use super::style;
use super::values::{self, Up};
use crate::effects::Overrides;
use crate::pipeline::Error;
use crate::pipeline::Selection;
use crate::pipeline::compress::{CompressConfig, ViewSource};
use crate::pipeline::config::PruneRule;
use crate::pipeline::virtual_views::VirtualCameras;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Budget;
use crate::render::Style;
use std::path::PathBuf;

/// Choice of Gaussians, views that judge it, and rendering.
#[derive(Debug, clap::Args)]
pub(super) struct CompressArgs {
    /// Preset of the options under this heading
    #[arg(long, value_name = "standard|paper", default_value = "standard", value_parser = values::one_of::<Preset>("a preset"), help_heading = "Compression")]
    preset: Preset,
    #[command(flatten)]
    choices: Choices,
    /// Random seed: the same seed on the same device gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Compression")]
    seed: u32,
    /// Number of virtual cameras around the model; every eighth is held out for the scores [default: 48]
    #[arg(long, value_name = "N", help_heading = "Without photos", conflicts_with = "scene", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    views: Option<u32>,
    /// Picture size of virtual cameras [default: 400x400]
    #[arg(long, value_name = "WxH", help_heading = "Without photos", conflicts_with = "scene", value_parser = values::size)]
    size: Option<(u32, u32)>,
    /// Up direction: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", help_heading = "Without photos", conflicts_with = "scene", value_parser = values::up, allow_hyphen_values = true)]
    up: Option<Up>,
    /// Scene whose photos decide what is kept, and score the result: a COLMAP, Blender, instant-ngp or nerfstudio folder
    #[arg(long, value_name = "SCENE", help_heading = "Photos")]
    scene: Option<PathBuf>,
    /// Photo folder, such as images_4 [default: the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Photos", requires = "scene")]
    images: Option<PathBuf>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: the photos' size]
    #[arg(long, value_name = "W|/K", help_heading = "Photos", requires = "scene", value_parser = values::resolution_text)]
    resolution: Option<String>,
    /// Hold out every N-th photo for the scores; 0 holds out none [default: 8]
    #[arg(long, value_name = "N", help_heading = "Photos", requires = "scene", value_parser = values::whole::<usize>)]
    eval_every: Option<usize>,
    #[command(flatten)]
    pub rendering: style::Rendering,
    /// Colour behind the Gaussians [default: white for photos with alpha, else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Rendering")]
    background: Option<[f32; 3]>,
}

/// A preset of all options under "Compression".
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Preset {
    /// Values that measured best
    Standard,
    /// Every value as published in the QIRF paper
    Paper,
}

impl CompressArgs {
    /// The configuration of a compression in this style, with `fine_tune` iterations of training afterwards.
    pub fn configuration(&self, style: Style, fine_tune: u32) -> Result<CompressConfig, Error> {
        let preset = match self.preset {
            Preset::Standard => {
                let selector = self.choices.selector.unwrap_or(Selector::Pairs);
                // Without training afterwards, what each block loses stays lost: every block keeps its share.
                let budget = if fine_tune == 0 { Budget::PerBlock } else { Budget::default() };
                PruneRule { selector, budget, ..PruneRule::default() }
            }
            Preset::Paper => PruneRule::paper(),
        };
        let default = VirtualCameras::default();
        let views = match &self.scene {
            Some(scene) => ViewSource::Photos(Selection {
                scene: scene.clone(),
                images: self.images.clone(),
                resolution: self.resolution.clone(),
                eval_every: self.eval_every.unwrap_or(8),
                background: self.background,
                effects: Overrides::default(),
            }),
            None => ViewSource::OwnPictures {
                cameras: VirtualCameras {
                    views: self.views.unwrap_or(default.views),
                    size: self.size.unwrap_or(default.size),
                    up: self.up.unwrap_or(Up::Auto).direction(),
                },
                background: self.background.unwrap_or([0.0; 3]),
            },
        };
        Ok(CompressConfig { compression: self.choices.over(preset)?, views, style, fine_tune, seed: self.seed })
    }
}

//! A run's configuration: what `config.toml` holds, and what reproduces the run.

use super::pruning::Pruning;
use crate::effects::{Choice, Effect, Overrides};
use crate::render::Style;
use crate::train::schedule::Schedule;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A named choice of schedule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The QIRF paper's: 30,000 iterations, densification to 13,000
    Paper,
    /// The 3DGS reference's: 30,000 iterations, densification to 15,000
    #[default]
    Standard,
    /// A look at the scene: 2,000 iterations
    Quick,
}

impl Preset {
    /// How the preset prunes.
    pub fn pruning(self) -> Pruning {
        match self {
            Self::Paper => Pruning::paper(),
            Self::Standard | Self::Quick => Pruning::default(),
        }
    }

    /// What the preset decides on effects, all else being left to the scene: no anti-aliasing, since viewers draw plain models
    /// unless they are told otherwise. The paper's has degree 3 and no exposures.
    pub fn effects(self) -> Overrides {
        let mut out = Overrides::default();
        out.set(Effect::Antialias, Choice::Off);
        if self == Self::Paper {
            out.set(Effect::ViewDependence, Choice::On);
            out.set(Effect::Exposure, Choice::Off);
        }
        out
    }

    /// The preset's schedule, scaled to another length where one is asked for.
    pub fn schedule(self, iterations: Option<u32>) -> Schedule {
        let whole = Schedule::default();
        match self {
            // The rates that were published, whatever the length.
            Self::Paper => {
                let iterations = iterations.unwrap_or(whole.iterations);
                Schedule { iterations, densify_until: 13.0 / 30.0, ..whole }
            }
            Self::Standard => Schedule::of(iterations.unwrap_or(whole.iterations)),
            Self::Quick => Schedule::of(iterations.unwrap_or(2000)),
        }
    }
}

/// Where training begins.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Init {
    /// On the reconstruction's points; random ones where the scene has none.
    Points,
    /// On random points where several cameras look.
    Random,
    /// On a model.
    Model(PathBuf),
}

/// All that reproduces a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// The scene's folder or file.
    pub scene: PathBuf,
    /// Photo folder, where not the scene's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<PathBuf>,
    /// Width of the pictures, or a divisor of the photos' size as `/K`; full size where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<String>,
    /// Key of all random numbers.
    pub seed: u32,
    /// Every how many-th photo is held out; 0 holds none out.
    pub eval_every: usize,
    /// Highest SH degree; lower where the scene does not call for it.
    pub sh_degree: usize,
    /// Where training begins.
    pub init: Init,
    /// Random points; by image size where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub init_count: Option<usize>,
    /// Colour behind everything; white for photos with alpha and black for others where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub background: Option<[f32; 3]>,
    /// Effects that the model is trained and rendered with: the user's choice, or the decision where that is left to the
    /// scene.
    #[serde(flatten)]
    pub style: Style,
    /// Whether each photo gets an exposure of its own: what was decided, where that is left to the scene.
    #[serde(default)]
    pub exposure: bool,
    /// No more Gaussians than this.
    pub max_gaussians: usize,
    /// Iterations between checkpoints; 0 for none but when interrupted.
    pub checkpoint_every: u32,
    /// Course of the optimisation.
    pub schedule: Schedule,
    /// When and how it prunes; never where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prune: Option<Pruning>,
    /// What the user decided on effects; the scene decides on all others.
    #[serde(default, skip_serializing_if = "Overrides::is_empty")]
    pub effects: Overrides,
}

/// Which pictures of which scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    /// The scene's folder or file.
    pub scene: PathBuf,
    /// Photo folder, where not the scene's own.
    pub images: Option<PathBuf>,
    /// Width of the pictures, or a divisor of the photos' size as `/K`; full size where absent.
    pub resolution: Option<String>,
    /// Every how many-th photo is held out; 0 holds none out.
    pub eval_every: usize,
    /// Colour behind everything; by the photos where absent.
    pub background: Option<[f32; 3]>,
    /// What the user decided on effects: on undistortion, transparency and masks.
    pub effects: Overrides,
}

impl RunConfig {
    /// The same run, pruned: nothing grows any more once the first prune is due.
    #[must_use]
    pub fn pruned(mut self, pruning: Pruning) -> Self {
        if let Some(first) = pruning.at.first() {
            self.schedule.densify_until = self.schedule.densify_until.min(*first);
        }
        self.prune = Some(pruning);
        self
    }

    /// The pictures that the run is of.
    pub fn selection(&self) -> Selection {
        Selection {
            scene: self.scene.clone(),
            images: self.images.clone(),
            resolution: self.resolution.clone(),
            eval_every: self.eval_every,
            background: self.background,
            effects: self.effects.clone(),
        }
    }
}

//! A run's configuration: the contents of `config.toml`, which reproduce the run.

use super::method::MethodConfig;
use super::pruning::Pruning;
use super::ranges::MOST_GAUSSIANS;
use crate::effects::{Choice, Effect, Overrides};
use crate::gaussians::MAX_SH_DEGREE;
use crate::gpu::Tuning;
use crate::job::output::respell;
use crate::qirf::select::budget::Keep;
use crate::render::Style;
use crate::scene::{EVAL_EVERY, LoadOptions, OpenOptions, Resize};
use crate::train::growth::Growth;
use crate::train::schedule::Schedule;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A preset of the schedule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The schedule of the QIRF paper: 30,000 iterations, densification to 13,000
    Paper,
    /// The schedule of the 3DGS reference: 30,000 iterations, densification to 15,000
    #[default]
    Standard,
    /// A short schedule: 2,000 iterations
    Quick,
}

impl Preset {
    /// The preset's pruning.
    pub fn pruning(self) -> Pruning {
        match self {
            Self::Paper => Pruning::paper(),
            Self::Standard | Self::Quick => Pruning::default(),
        }
    }

    /// The preset's decisions on effects; all others are left to the scene. No anti-aliasing, since viewers draw plain
    /// models by default. The paper's preset has degree 3, no exposures, no dropout, no sky, and cameras as they are given.
    pub fn effects(self) -> Overrides {
        let mut out = Overrides::default();
        out.set(Effect::Antialias, Choice::Off);
        if self == Self::Paper {
            out.set(Effect::Poses, Choice::Off);
            out.set(Effect::Dropout, Choice::Off);
            out.set(Effect::Sky, Choice::Off);
            out.set(Effect::ViewDependence, Choice::On);
            out.set(Effect::Exposure, Choice::Off);
        }
        out
    }

    /// The preset's schedule, scaled to another length if one is given.
    pub fn schedule(self, iterations: Option<u32>) -> Schedule {
        let whole = Schedule::default();
        let planned = |iterations| Schedule { growth: Some(Growth::default()), ..Schedule::of(iterations) };
        match self {
            // The published rates, at any length.
            Self::Paper => {
                let iterations = iterations.unwrap_or(whole.iterations);
                Schedule { iterations, densify_until: 13.0 / 30.0, ..whole }
            }
            Self::Standard => planned(iterations.unwrap_or(whole.iterations)),
            Self::Quick => planned(iterations.unwrap_or(2000)),
        }
    }
}

/// Initial Gaussians of training.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Init {
    /// On the reconstruction's points; on random points if the scene has none.
    #[default]
    Points,
    /// On random points in the region where several cameras look.
    Random,
    /// On a model.
    Model(PathBuf),
}

/// Everything that reproduces a run. The default trains nothing: begin with [`RunConfig::of`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(clippy::struct_excessive_bools, reason = "switches of a run, each on its own")]
pub struct RunConfig {
    /// The scene's folder or file.
    pub scene: PathBuf,
    /// Photo folder, if not the scene's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub images: Option<PathBuf>,
    /// Width of the pictures, or a divisor of the photos' size as `/K`; full size if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<String>,
    /// Angle in degrees: panoramas and wide fisheyes are masked within it of straight down.
    #[serde(default, skip_serializing_if = "num_traits::Zero::is_zero")]
    pub pole_mask: f64,
    /// Folder of depth maps with the photos' names; the scene's own if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<PathBuf>,
    /// Key of all random numbers.
    pub seed: u32,
    /// Every n-th photo is held out; 0 holds none out.
    pub eval_every: usize,
    /// Highest SH degree; lower if the scene does not call for it.
    pub sh_degree: usize,
    /// Initial Gaussians of training.
    pub init: Init,
    /// Number of random points; by image size if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub init_count: Option<usize>,
    /// Background colour; if absent, white for photos with alpha, a colour that nearly all pixels at the photos' edges have, or black.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub background: Option<[f32; 3]>,
    /// Effects that the model is trained and rendered with: the user's choice, or the decision if that is left to the
    /// scene.
    #[serde(flatten)]
    pub style: Style,
    /// True if each photo has its own exposure: the user's choice, or the decision if that is left to the scene.
    #[serde(default)]
    pub exposure: bool,
    /// True if the photos' cameras are corrected: the user's choice, or the decision if that is left to the scene.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub poses: bool,
    /// True if pictures leave out Gaussians by chance: the user's choice, or the scene's decision.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub dropout: bool,
    /// True if pictures are compared with the photos' depth maps: the user's choice, or the scene's decision.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub depth_loss: bool,
    /// Largest number of Gaussians.
    pub max_gaussians: usize,
    /// Iterations between checkpoints; with 0 only an interruption writes one.
    pub checkpoint_every: u32,
    /// True if floaters are removed before the model is written.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub clean: bool,
    /// Schedule of the optimisation.
    pub schedule: Schedule,
    /// When and how it prunes; never if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prune: Option<Pruning>,
    /// The method of another paper that trains the model; only arms of `compare` have one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub method: Option<MethodConfig>,
    /// The user's decisions on effects; the scene decides on all others.
    #[serde(default, skip_serializing_if = "Overrides::is_empty")]
    pub effects: Overrides,
    /// The tuning of kernels, which decides on the last bits of results; the device's own if absent, or if this one does
    /// not fit it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tuning: Option<Tuning>,
}

/// Selection of a scene's pictures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Selection {
    /// The scene's folder or file.
    pub scene: PathBuf,
    /// Photo folder, if not the scene's own.
    pub images: Option<PathBuf>,
    /// Width of the pictures, or a divisor of the photos' size as `/K`; full size if absent.
    pub resolution: Option<String>,
    /// Angle in degrees: panoramas and wide fisheyes are masked within it of straight down.
    #[serde(default, skip_serializing_if = "num_traits::Zero::is_zero")]
    pub pole_mask: f64,
    /// Folder of depth maps with the photos' names; the scene's own if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<PathBuf>,
    /// Every n-th photo is held out; 0 holds none out.
    pub eval_every: usize,
    /// Background colour; by the photos if absent.
    pub background: Option<[f32; 3]>,
    /// The user's decisions on effects; those on undistortion, transparency and masks are used.
    pub effects: Overrides,
    /// CRC-32 of each photo's files and camera by name, of photos that must not change; none if any are accepted.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub contents: BTreeMap<String, u32>,
}

impl Selection {
    /// All photos of a scene at full size, of which every eighth is held out.
    pub fn of(scene: PathBuf) -> Self {
        Self { scene, eval_every: EVAL_EVERY, ..Self::default() }
    }

    /// The options with which the scene is opened.
    pub fn open_options(&self) -> OpenOptions {
        OpenOptions {
            images: self.images.clone(),
            undistort: self.effects.forced(Effect::Distortion),
            pole_mask: self.pole_mask,
            depth: self.depth.clone(),
            check: false,
        }
    }

    /// The options with which its photos are decoded.
    pub fn load_options(&self, resize: Resize) -> LoadOptions<'static> {
        let (alpha, masks) = (self.effects.forced(Effect::Transparency), self.effects.allow(Effect::Masks));
        LoadOptions { resize, alpha, masks, ..LoadOptions::default() }
    }

    /// The working size of its photos; an error for a text that is none.
    pub fn resize(&self) -> Result<Resize, String> {
        self.resolution.as_deref().map_or(Ok(Resize::Full), str::parse)
    }
}

impl RunConfig {
    /// The configuration of `qirf-vk run SCENE --preset PRESET --no-prune`; [`pruned`](Self::pruned) by
    /// [`Preset::pruning`], that of the same command without the last option.
    pub fn of(scene: PathBuf, preset: Preset) -> Self {
        Self {
            scene,
            seed: 1,
            eval_every: EVAL_EVERY,
            sh_degree: MAX_SH_DEGREE,
            max_gaussians: 4_000_000,
            checkpoint_every: 5000,
            schedule: preset.schedule(None),
            effects: preset.effects(),
            ..Self::default()
        }
    }

    /// The same run with pruning: densification ends at the first prune. A run that is to keep a given number of Gaussians
    /// grows to the usual multiple of it at least: a smaller number does not mean less growth (docs/decisions.md, 159).
    #[must_use]
    pub fn pruned(mut self, pruning: Pruning) -> Self {
        if let Some(first) = pruning.at.first() {
            self.schedule.densify_until = self.schedule.densify_until.min(*first);
        }
        if let (Some(plan), Keep::Count(count)) = (&mut self.schedule.growth, pruning.compression.keep) {
            plan.least = Some(((count as f64 / Keep::SHARE).ceil() as usize).min(MOST_GAUSSIANS));
        }
        self.prune = Some(pruning);
        self
    }

    /// Changes the paths of the scene, of its photos and depth maps where these are not names within it, and of an initial model.
    pub fn respell(&mut self, spell: impl Fn(&Path) -> PathBuf) {
        if let Init::Model(path) = &mut self.init {
            *path = spell(path);
        }
        respell(&mut self.scene, [&mut self.images, &mut self.depth], spell);
    }

    /// The pictures of the run.
    pub fn selection(&self) -> Selection {
        Selection {
            scene: self.scene.clone(),
            images: self.images.clone(),
            resolution: self.resolution.clone(),
            pole_mask: self.pole_mask,
            depth: self.depth.clone(),
            eval_every: self.eval_every,
            background: self.background,
            effects: self.effects.clone(),
            contents: BTreeMap::new(),
        }
    }
}

#[cfg(test)]
impl RunConfig {
    /// A run of a preset on a scene called `capture`, without a prune.
    pub(crate) fn sample(preset: Preset) -> Self {
        Self { max_gaussians: 4000, checkpoint_every: 50, ..Self::of("capture".into(), preset) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::config::pruning::PruneRule;

    /// A run to a given number grows to the usual multiple at least, and otherwise as the photos say; cameras are left to
    /// the scene, except in the paper's preset.
    #[test]
    fn defaults_of_presets() {
        let pixels = [10_000; 100];
        let grown = |keep| {
            let compression = PruneRule { keep, ..PruneRule::default() };
            let run = RunConfig::sample(Preset::Standard).pruned(Pruning { compression, ..Pruning::default() });
            run.schedule.growth.unwrap().for_photos(&pixels, 30_000).gaussians.unwrap()
        };
        let usual = grown(Keep::Share(0.28));
        assert_eq!((usual, grown(Keep::Count(999)), grown(Keep::Count(84_000))), (173_205, 173_205, 300_000));
        let cameras = [Preset::Standard, Preset::Quick, Preset::Paper].map(|p| p.effects().allow(Effect::Poses));
        assert_eq!(cameras, [true, true, false]);
    }
}

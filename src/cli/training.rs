//! Options of training and photos, shared by run and compare.

use super::choices::Choices;
use super::console::Console;
use super::inspect::read_model;
use super::values::{self, GrowTo};
use crate::effects::{Choice, Effect, Overrides};
use crate::gaussians::formats::RenderMode;
use crate::job::config::Pruning;
use crate::job::config::ranges::{MOST_GAUSSIANS, MOST_ITERATIONS};
use crate::job::{Error, Init, Preset, RunConfig};
use crate::render::Style;
use crate::scene::EVAL_EVERY;
use crate::train::schedule::Schedule;
use clap::Args;
use std::path::{Path, PathBuf};

/// Options of training.
#[derive(Args, Clone, Debug)]
pub(super) struct Training {
    /// Preset of the schedule; paper also sets the pruning and the effects of the QIRF paper
    #[arg(long, default_value = "standard", value_parser = values::one_of::<Preset>("a preset"), help_heading = "Training")]
    pub preset: Preset,
    /// When and how the model is pruned [default: attrition; preset paper: one-shot]
    #[arg(long, value_name = "attrition|one-shot|gradual", value_parser = values::one_of::<Steps>("a schedule"), help_heading = "Compression")]
    schedule: Option<Steps>,
    /// Number of iterations; the schedule's milestones scale with it [default: the preset's]
    #[arg(long, value_name = "N", help_heading = "Training", value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_ITERATIONS)))]
    iterations: Option<u32>,
    /// Degree of the spherical harmonics [default: by the scene, 1 to 3; preset paper: 3]
    #[arg(long, value_name = "L", help_heading = "Effects", value_parser = clap::value_parser!(u8).range(0..=3))]
    sh_degree: Option<u8>,
    /// Random seed: the same seed on the same device gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Training")]
    seed: u32,
    /// Initial Gaussians: points (the scene's own, else random), random, or a model file
    #[arg(long, value_name = "points|random|MODEL", default_value = "points", help_heading = "Training")]
    init: String,
    /// Number of random points, with --init random or where a scene has too few points [default: by picture size]
    #[arg(long, value_name = "N", help_heading = "Training", value_parser = clap::value_parser!(u32).range(1..))]
    init_count: Option<u32>,
    /// Largest number of Gaussians that a run grows to; an initial model is not cut to it
    #[arg(long, value_name = "N", default_value_t = 4_000_000, help_heading = "Training", value_parser = clap::value_parser!(u32).range(1..=MOST_GAUSSIANS as i64))]
    max_gaussians: u32,
    /// Number of Gaussians to which the model grows before the prune. auto: a number computed from the photos' pixels and the
    /// iterations; thresholds: no fixed number, Gaussians with large gradients are split [default: auto; preset paper:
    /// thresholds]
    #[arg(long, value_name = "N|auto|thresholds", value_parser = values::growth, help_heading = "Training")]
    grow_to: Option<GrowTo>,
    /// Keep the energy of Gaussians smaller than a pixel; without a value, on; true and false stand for on and off [default: as
    /// the file of an initial model says, else off]
    #[arg(long, value_name = "on|off", help_heading = "Effects", num_args = 0..=1, require_equals = true,
        default_missing_value = "on", value_parser = values::switch(), ignore_case = true)]
    antialias: Option<bool>,
    /// Variance added to every splat, in square pixels; for anti-aliased models, viewers such as PlayCanvas's expect 0.3, which
    /// no file records [default: 0.1 with anti-aliasing, 0.3 without]
    #[arg(long, value_name = "0.1|0.3", help_heading = "Effects", value_parser = values::dilation)]
    dilation: Option<f32>,
    // Its help lists the effects.
    #[arg(long, value_name = "NAME=on|off|auto", value_parser = Overrides::parse, help = effects(), help_heading = "Effects")]
    effect: Vec<(Effect, Choice)>,
    /// Colour behind the Gaussians [default: white for photos with alpha; else the colour that nearly all pixels at the photos' edges share; else
    /// black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Training")]
    pub background: Option<[f32; 3]>,
    /// Iterations between checkpoints; with 0, only Ctrl-C writes one
    #[arg(long, value_name = "N", default_value_t = 5000, help_heading = "Training")]
    checkpoint_every: u32,
    /// Photo folder, such as images_4 [default: the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Photos")]
    images: Option<PathBuf>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: the photos' size]
    #[arg(long, value_name = "W|/K", help_heading = "Photos", value_parser = values::resolution_text)]
    resolution: Option<String>,
    /// Folder of depth maps with the photos' names, for initial points and the depth loss: .npy, 16-bit .png in thousandths of
    /// a unit, .tif, .exr, COLMAP's .geometric.bin [default: the scene's own, if its transforms.json names some]
    #[arg(long, value_name = "DIR", help_heading = "Photos")]
    depth: Option<PathBuf>,
    /// Mask everything within DEG degrees of straight down in panoramas and wide fisheyes, such as the tripod or the photographer
    #[arg(long, value_name = "DEG", default_value = "0", help_heading = "Photos", value_parser = values::pole)]
    pole_mask: f64,
    /// Hold out every N-th photo for the scores; 0 holds out none
    #[arg(long, value_name = "N", default_value_t = EVAL_EVERY, value_parser = values::whole::<usize>, help_heading = "Photos")]
    eval_every: usize,
}

fn effects() -> String {
    let names: Vec<&str> = Effect::settable().map(Effect::name).collect();
    format!(
        "Switch an effect on or off, or let the scene decide (auto); repeat it for more effects. Effects: {}. `qirf-vk inspect SCENE` \
         shows what a scene needs [default: auto; antialias and depth_order: off]",
        names.join(", ")
    )
}

/// One prune, or several.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Steps {
    /// From half the run on, growing pressure on opacities lets Gaussians fade until the number to keep is left; at 3/4 of the
    /// run at the latest, the model is cut to that number. Then learning rates are raised again
    Attrition,
    /// Once, at half the run
    OneShot,
    /// Four times, from 13/30 to 20/30 of the run
    Gradual,
}

fn init(text: &str) -> Init {
    match text {
        "points" => Init::Points,
        "random" => Init::Random,
        path => Init::Model(PathBuf::from(path)),
    }
}

impl Training {
    /// Pruning of a run: its steps and its choices.
    pub fn pruning(&self, choices: &Choices) -> Result<Pruning, Error> {
        let preset = self.preset.pruning();
        let process = match self.schedule {
            None => preset.clone(),
            Some(Steps::Attrition) => Pruning::default(),
            Some(Steps::OneShot) => Pruning::at_once(),
            Some(Steps::Gradual) => Pruning::gradual(),
        };
        let Pruning { responses, compression, .. } = preset;
        let mut pruning = Pruning { responses, compression, ..process };
        pruning.compression = choices.over(pruning.compression)?;
        Ok(pruning)
    }

    /// The configuration of a run on `scene`, without pruning.
    pub fn configuration(&self, scene: PathBuf, console: &Console) -> Result<RunConfig, Error> {
        let usual = RunConfig::of(scene, self.preset);
        let config = RunConfig {
            images: self.images.clone(),
            resolution: self.resolution.clone(),
            pole_mask: self.pole_mask,
            depth: self.depth.clone(),
            seed: self.seed,
            eval_every: self.eval_every,
            sh_degree: self.sh_degree.map_or(usual.sh_degree, usize::from),
            init: init(&self.init),
            init_count: self.init_count.map(|n| n as usize),
            background: self.background,
            style: Style { dilation: self.dilation, ..Style::default() },
            max_gaussians: self.max_gaussians as usize,
            checkpoint_every: self.checkpoint_every,
            schedule: self.schedule(),
            effects: self.overrides()?,
            ..usual
        };
        match &config.init {
            Init::Model(path) => self.obey(config.clone(), path, console),
            _ => Ok(config),
        }
    }

    /// The configuration for a run that begins with the model at `path`: anti-aliased if its file says so, unless an option
    /// decides, and says where one contradicts the file.
    pub fn obey(&self, mut config: RunConfig, path: &Path, console: &Console) -> Result<RunConfig, Error> {
        let mode = read_model(path, console)?.mode;
        let asked = self.antialias.is_some() || self.effect.iter().any(|(effect, _)| *effect == Effect::Antialias);
        if !asked && mode.antialiased() {
            config.effects.set(Effect::Antialias, Choice::On);
            console.note(format_args!("{}: anti-aliased, and so is the run", path.display()));
        } else if config.effects.forced(Effect::Antialias).is_some_and(|on| on != mode.antialiased()) {
            let run = RenderMode::of(!mode.antialiased());
            console.note(format_args!("{}: tagged as {mode}; the run is {run}, as requested", path.display()));
        }
        Ok(config)
    }

    fn schedule(&self) -> Schedule {
        let preset = self.preset.schedule(self.iterations);
        Schedule { growth: self.grow_to.map_or(preset.growth, |asked| asked.0), ..preset }
    }

    fn overrides(&self) -> Result<Overrides, Error> {
        let mut out = self.preset.effects();
        for (at, (effect, choice)) in self.effect.iter().enumerate() {
            let other = self.effect[..at].iter().find(|(named, other)| named == effect && other != choice);
            if let Some((_, other)) = other {
                let (name, what) = (effect.name(), "contradict each other; leave out one");
                return Err(Error::Usage(format!("--effect {name}={other} and --effect {name}={choice} {what}")));
            }
            out.set(*effect, *choice);
        }
        let choice = |on: bool| if on { Choice::On } else { Choice::Off };
        let own = [
            (Effect::Antialias, self.antialias.map(choice), "--antialias"),
            (Effect::ViewDependence, self.sh_degree.map(|degree| choice(degree > 0)), "--sh-degree"),
        ];
        for (effect, asked, option) in own {
            let other = self
                .effect
                .iter()
                .find(|(named, choice)| *named == effect && Some(*choice) != asked && *choice != Choice::Auto);
            if let (Some(_), Some((effect, choice))) = (asked, other) {
                let what =
                    format!("{option} and --effect {}={choice} contradict each other; leave out one", effect.name());
                return Err(Error::Usage(what));
            }
            if let Some(asked) = asked {
                out.set(effect, asked);
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Alone {
        #[command(flatten)]
        training: Training,
    }

    #[test]
    fn an_option_of_its_own_goes_before_auto_and_contradictions_are_refused() {
        let overrides = |words: &[&str]| Alone::parse_from([&["run"], words].concat()).training.overrides();
        let forced = |words: &[&str], effect| overrides(words).unwrap().forced(effect);
        assert_eq!(forced(&["--antialias", "--effect", "antialias=auto"], Effect::Antialias), Some(true));
        let degree = ["--sh-degree", "2", "--effect", "view_dependence=auto"];
        assert_eq!(forced(&degree, Effect::ViewDependence), Some(true));
        assert_eq!(forced(&["--effect", "exposure=on", "--effect", "exposure=on"], Effect::Exposure), Some(true));
        let Err(Error::Usage(what)) = overrides(&["--effect", "exposure=on", "--effect", "exposure=off"]) else {
            panic!("two choices for one effect");
        };
        assert!(what.starts_with("--effect exposure=on and --effect exposure=off contradict each other"), "{what}");
    }
}

//! `qirf-vk eval MODEL SCENE`, `qirf-vk eval MODEL --against MODEL`.

use super::console::Console;
use super::inspect::read_model;
use super::scratch::Scratch;
use super::show::Show;
use super::style;
use super::values;
use super::{Global, check_no_run, tell_of_missing};
use crate::gaussians::Gaussians;
use crate::gaussians::formats::Loaded;
use crate::job::records::{RunRecord, ViewScores};
use crate::job::{Error, Output, RunConfig, Selection};
use crate::metrics::{Networks, Scores};
use crate::pipeline::eval::{self, Evaluation};
use crate::pipeline::place::{align, place_read};
use crate::render::Style;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk eval model.ply capture --resolution /4
  qirf-vk eval trained/model.ply --config trained/config.toml
  qirf-vk eval model.spz --config trained/config.toml -o scores
  qirf-vk eval small.spz --against original.ply

Photos are held out, scaled and scored as by `qirf-vk run`: a run's model.ply gets the run's scores. The style of \
rendering is that of --config, else of the config.toml beside the model, and exposures of the photos are fitted if that has \
exposure = true.
With --against, the model is scored against pictures of its original, from the views that `qirf-vk compress` holds out. Where \
both pictures are equal, PSNR is infinite, and the table shows `equal`.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz file, or a SOG folder
    model: PathBuf,
    /// Scene: a COLMAP, Blender, instant-ngp or nerfstudio folder
    scene: Option<PathBuf>,
    /// Folder for metrics.json and renders/; created if absent
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Original of the model, before compression, whose pictures replace the photos
    #[arg(long, value_name = "MODEL", conflicts_with_all = ["scene", "config", "output", "images", "resolution", "eval_every", "pole_mask", "exposure", "scratch"])]
    against: Option<PathBuf>,
    /// Configuration of a run, its config.toml, which names scene, photos and rendering; options on the command line take
    /// precedence
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[command(flatten)]
    rendering: style::Rendering,
    /// Colour behind the Gaussians [default: that of --config, else white for photos with alpha, the
    /// colour of nearly all pixels at the photos' edges, or black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Rendering")]
    background: Option<[f32; 3]>,
    /// Limit on device memory, such as 2G or 800M [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Rendering")]
    memory_budget: Option<u64>,
    #[command(flatten)]
    scratch: Scratch,
    /// Photo folder, such as images_4 [default: that of --config, else the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Photos")]
    images: Option<PathBuf>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: that of --config, else the photos'
    /// size]
    #[arg(long, value_name = "W|/K", help_heading = "Photos", value_parser = values::resolution_text)]
    resolution: Option<String>,
    /// Mask everything within DEG degrees of straight down in panoramas and wide fisheyes [default: that of --config, else 0]
    #[arg(long, value_name = "DEG", help_heading = "Photos", value_parser = values::pole)]
    pole_mask: Option<f64>,
    /// Hold out every N-th photo for the scores [default: that of --config, else 8]
    #[arg(long, value_name = "N", help_heading = "Photos", value_parser = values::whole::<usize>)]
    eval_every: Option<usize>,
    /// Fit an exposure to each photo before scores, as runs with that effect do; without a value, on [default: as --config or the
    /// config.toml beside the model says, else off]
    #[arg(long, value_name = "on|off", help_heading = "Photos", num_args = 0..=1, require_equals = true,
        default_missing_value = "on", value_parser = values::switch(), ignore_case = true)]
    exposure: Option<bool>,
    /// LPIPS weights: a file, or a folder of them, as the script lpips-weights writes them [default: $QIRF_LPIPS, else the
    /// folder qirf-vk in the user's data folder]
    #[arg(long, value_name = "PATH", help_heading = "Photos")]
    lpips_weights: Option<PathBuf>,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if let Some(original) = &self.against {
            return self.run_against(original, console, global);
        }
        if self.scene.is_none() && self.config.is_none() {
            let model = self.model.display();
            return Err(Error::Usage(format!(
                "there is nothing to score {model} against: name a scene, a run's configuration with --config, or the original \
                 model with --against, as in `qirf-vk eval {model} capture`"
            )));
        }
        if let Some(folder) = &self.output {
            check_no_run(folder)?;
        }
        let mut loaded = read_model(&self.model, console)?;
        let evaluation = self.evaluation(&loaded, console)?;
        let selection = &evaluation.selection;
        if let Some(doubt) = place_read(&mut loaded, &selection.scene, selection.images.as_deref())? {
            console.warn(format_args!("{} {doubt}", self.model.display()));
        }
        let networks = Networks::find(self.lpips_weights.as_deref())?;
        let device = global.open_with(self.memory_budget)?;
        let output = self.output.as_deref().map(Output::new).transpose()?;
        let watcher = Show::new(console);
        let session = self.scratch.session(self.memory_budget, (&device, &networks), &watcher);
        let record = eval::eval(&session, &self.model, &loaded.gaussians, &evaluation, output.as_ref())?;
        watcher.rest();
        tell_of_missing(&networks, console);
        self.report(console, &record)
    }

    fn run_against(&self, original: &Path, console: &Console, global: &Global) -> Result<(), Error> {
        let read = |path: &Path| -> Result<(Gaussians, Style, [f64; 3]), Error> {
            let loaded = read_model(path, console)?;
            let style = self.rendering.style(path, &loaded, None, console);
            Ok((loaded.gaussians, style, loaded.origin))
        };
        let (mut model, original) = (read(&self.model)?, read(original)?);
        align(&mut model.0, [model.2, original.2], &original.0);
        if model.1 != original.1 {
            let (a, b) = (model.1.mode(), original.1.mode());
            console.warn(format_args!(
                "their files tag this model as {a} and the original as {b}, and each is drawn so; --antialias=on or --antialias=off draws both alike"
            ));
        }
        let networks = Networks::find(self.lpips_weights.as_deref())?;
        let device = global.open_with(self.memory_budget)?;
        let watcher = Show::new(console);
        let session = self.scratch.session(self.memory_budget, (&device, &networks), &watcher);
        let background = self.background.unwrap_or([0.0; 3]);
        let held_out = eval::against(&session, [(&model.0, model.1), (&original.0, original.1)], background)?;
        watcher.rest();
        tell_of_missing(&networks, console);
        let (test, views) = (held_out.mean(), &held_out.views);
        if self.json {
            let counts = serde_json::json!({ "model": model.0.len(), "original": original.0.len() });
            return console
                .json(&serde_json::json!({ "schema": 1, "gaussians": counts, "test": test, "views": views }));
        }
        table(console, test.as_ref(), views)
    }

    fn evaluation(&self, model: &Loaded, console: &Console) -> Result<Evaluation, Error> {
        let file = self.config.as_deref().map(RunConfig::read).transpose()?;
        let (style, exposure, base) = if let Some(config) = file {
            let style = self.rendering.style(&self.model, model, Some(config.style), console);
            (style, self.exposure.unwrap_or(config.exposure), config.selection())
        } else {
            let beside = self.rendering.beside(&self.model, model, console);
            let exposure = self.exposure.unwrap_or_else(|| beside.exposure(console));
            (beside.style, exposure, Selection { background: beside.background(), ..Selection::of(PathBuf::new()) })
        };
        let selection = Selection {
            // The configuration's photo folder does not apply to a scene given as an argument.
            images: self.images.clone().or(base.images.filter(|_| self.scene.is_none())),
            scene: self.scene.clone().unwrap_or(base.scene),
            resolution: self.resolution.clone().or(base.resolution),
            depth: None,
            pole_mask: self.pole_mask.unwrap_or(base.pole_mask),
            eval_every: self.eval_every.unwrap_or(base.eval_every),
            background: self.background.or(base.background),
            ..base
        };
        Ok(Evaluation { selection, style, exposure })
    }

    fn report(&self, console: &Console, record: &RunRecord) -> Result<(), Error> {
        if self.json {
            return console.json(record);
        }
        table(console, record.test.as_ref(), &record.views)?;
        if let Some(folder) = &self.output {
            console.note(format_args!("figures and pictures in {}", folder.display()));
        }
        Ok(())
    }
}

/// Scores view by view, and their mean.
fn table(console: &Console, test: Option<&Scores>, views: &[ViewScores]) -> Result<(), Error> {
    let lpips = test.is_some_and(|t| t.lpips_vgg.is_some());
    let row = |name: &str, scores: &Scores| {
        let Some(ssim) = scores.ssim else {
            return console.print(format_args!("{name:<32} {:>8} {:>8}", "hidden", "-"));
        };
        // The PSNR of equal pictures is infinite.
        let psnr = scores.psnr.map_or_else(|| "equal".to_owned(), |v| format!("{v:.3}"));
        let mut line = format!("{name:<32} {psnr:>8} {ssim:>8.4}");
        if lpips {
            line += &scores.lpips_vgg.map_or_else(|| format!(" {:>8}", "-"), |v| format!(" {v:>8.4}"));
        }
        console.print(line)
    };
    let heading = format!("{:<32} {:>8} {:>8}", "view", "PSNR/dB", "SSIM");
    console.print(if lpips { heading + &format!(" {:>8}", "LPIPS") } else { heading })?;
    for view in views {
        row(&view.name, &view.scores)?;
    }
    test.map_or(Ok(()), |mean| row(&format!("mean of {}", ViewScores::counting(views)), mean))
}

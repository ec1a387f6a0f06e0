//! Arguments of a compression, for `compress` and `shard plan`.

use super::choices::Choices;
use super::console::Console;
use super::inspect::read_model;
use super::style::{self, Beside};
use super::values::{self, Size};
use crate::gaussians::formats::Loaded;
use crate::job::config::PruneRule;
use crate::job::records::Aim;
use crate::job::{Error, Selection};
use crate::pipeline::compress::{CompressConfig, ViewSource};
use crate::pipeline::place::place_read;
use crate::pipeline::virtual_views::VirtualCameras;
use crate::scene::EVAL_EVERY;
use crate::scene::orbit::UP;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Selection of Gaussians, views for evidence and scores, and rendering.
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
    #[arg(long, value_name = "N", help_heading = "Without photos", conflicts_with_all = OF_PHOTOS, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    views: Option<u32>,
    /// Maximum size of the file, such as 5MB, 800kB or 4.5MiB: find the file with the highest PSNR. As WxH: picture size of
    /// virtual cameras [default: 400x400]
    #[arg(long, value_name = "BYTES|WxH", action = clap::ArgAction::Append, allow_hyphen_values = true, value_parser = values::size_of_file_or_pictures)]
    size: Vec<Size>,
    /// Minimum PSNR in dB against the original's pictures or the held-out photos: find the smallest file
    #[arg(long, value_name = "DB", value_parser = values::psnr, conflicts_with_all = ["keep", "target_count"])]
    psnr: Option<f64>,
    /// Up direction: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", help_heading = "Without photos", conflicts_with_all = OF_PHOTOS, value_parser = values::up, allow_hyphen_values = true)]
    up: Option<DVec3>,
    /// Scene whose photos guide the prune and score the result: a COLMAP, Blender, instant-ngp or nerfstudio folder
    #[arg(long, value_name = "SCENE", help_heading = "Photos")]
    scene: Option<PathBuf>,
    /// Photo folder, such as images_4 [default: the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Photos", requires = "scene")]
    images: Option<PathBuf>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: the photos' size]
    #[arg(long, value_name = "W|/K", help_heading = "Photos", requires = "scene", value_parser = values::resolution_text)]
    resolution: Option<String>,
    /// Mask everything within DEG degrees of straight down in panoramas and wide fisheyes, such as the tripod or the photographer
    #[arg(long, value_name = "DEG", default_value = "0", requires = "scene", help_heading = "Photos", value_parser = values::pole)]
    pole_mask: f64,
    /// Hold out every N-th photo for the scores; 0 holds out none [default: 8]
    #[arg(long, value_name = "N", help_heading = "Photos", requires = "scene", value_parser = values::whole::<usize>)]
    eval_every: Option<usize>,
    /// Fit an exposure to each photo before scores and in fine-tuning, as runs with that effect do; without a value, on [default: as
    /// config.toml beside the model says, else off]
    #[arg(long, value_name = "on|off", help_heading = "Photos", requires = "scene", num_args = 0..=1, require_equals = true,
        default_missing_value = "on", value_parser = values::switch(), ignore_case = true)]
    exposure: Option<bool>,
    #[command(flatten)]
    rendering: style::Rendering,
    /// Colour behind the Gaussians [default: with --scene, that in the model's config.toml, else white for photos with alpha, else the colour that
    /// nearly all pixels at the photos' edges share; else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Rendering")]
    background: Option<[f32; 3]>,
}

/// A scene and the options that require one: clap drops a requirement where another option excludes what is required.
const OF_PHOTOS: [&str; 6] = ["scene", "images", "resolution", "pole_mask", "eval_every", "exposure"];

/// A preset of all options under "Compression".
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Preset {
    /// The values with the best results in measurements
    Standard,
    /// Every value as published in the QIRF paper
    Paper,
}

impl CompressArgs {
    /// Reads the model, counts its means from the origin of its scene, if it has one, and decides how the model is drawn.
    pub fn read(&self, model: &Path, console: &Console) -> Result<(Loaded, Beside), Error> {
        let mut loaded = read_model(model, console)?;
        if let Some(scene) = &self.scene
            && let Some(doubt) = place_read(&mut loaded, scene, self.images.as_deref())?
        {
            console.warn(format_args!("{} {doubt}", model.display()));
        }
        let beside = self.rendering.beside(model, &loaded, console);
        let rule = self.rule(0)?;
        if let Some(note) = rule.detail_note(rule.keep, loaded.gaussians.len()) {
            console.note(note);
        }
        Ok((loaded, beside))
    }

    /// The aim for the file, if there is one.
    pub fn aim(&self) -> Result<Option<Aim>, Error> {
        self.pictures()?;
        let mut files =
            self.size.iter().filter_map(|size| if let Size::File(bytes) = size { Some(*bytes) } else { None });
        let aim = match (files.next(), files.next(), self.psnr) {
            (Some(_), Some(_), _) => return Err(Error::Usage("give only one --size of the file".to_owned())),
            (Some(_), _, Some(_)) => {
                return Err(Error::Usage("--size and --psnr exclude each other; give one of them".to_owned()));
            }
            (bytes, _, psnr) => bytes.map(Aim::Bytes).or(psnr.map(Aim::Psnr)),
        };
        if aim.is_some() && self.choices.counts() {
            let what = "--size finds how many Gaussians to keep; leave out --keep and --target-count";
            return Err(Error::Usage(what.to_owned()));
        }
        Ok(aim)
    }

    /// The picture size of virtual cameras, if given.
    fn pictures(&self) -> Result<Option<(u32, u32)>, Error> {
        let of = |size: &Size| if let Size::Pictures(w, h) = size { Some((*w, *h)) } else { None };
        let mut pictures = self.size.iter().filter_map(of);
        match (pictures.next(), pictures.next()) {
            (_, Some(_)) => Err(Error::Usage("give only one --size of the pictures".to_owned())),
            (Some(_), _) if self.scene.is_some() => {
                Err(Error::Usage("--size WxH applies to virtual cameras; for a scene use --resolution".to_owned()))
            }
            (size, _) => Ok(size),
        }
    }

    /// The choice of Gaussians, with `fine_tune` iterations of training afterwards.
    fn rule(&self, fine_tune: u32) -> Result<PruneRule, Error> {
        self.choices.over(match self.preset {
            Preset::Standard => {
                let usual = CompressConfig::rule(fine_tune);
                PruneRule { selector: self.choices.selector.unwrap_or(usual.selector), ..usual }
            }
            Preset::Paper => PruneRule::paper(),
        })
    }

    /// The configuration of a compression of a model by what lies `beside` it, with `fine_tune` iterations of training afterwards.
    pub fn configuration(&self, beside: &Beside, fine_tune: u32, console: &Console) -> Result<CompressConfig, Error> {
        let pictures = self.pictures()?;
        let default = VirtualCameras::default();
        let views = match &self.scene {
            Some(scene) => ViewSource::Photos(Selection {
                images: self.images.clone(),
                resolution: self.resolution.clone(),
                pole_mask: self.pole_mask,
                eval_every: self.eval_every.unwrap_or(EVAL_EVERY),
                background: self.background.or_else(|| beside.background()),
                ..Selection::of(scene.clone())
            }),
            None => ViewSource::OwnPictures {
                cameras: VirtualCameras {
                    views: self.views.unwrap_or(default.views),
                    size: pictures.unwrap_or(default.size),
                    up: self.up.unwrap_or(UP),
                },
                background: self.background.unwrap_or([0.0; 3]),
            },
        };
        let exposure = self.scene.is_some() && self.exposure.unwrap_or_else(|| beside.exposure(console));
        let style = beside.style;
        Ok(CompressConfig { compression: self.rule(fine_tune)?, views, style, exposure, fine_tune, seed: self.seed })
    }
}

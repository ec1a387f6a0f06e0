//! `qirf-vk convert IN OUT`.

use super::console::Console;
use super::inspect::read_model;
use super::values::{self, Up};
use crate::gaussians::formats::{self, Loaded, SpzVersion};
use crate::pipeline::Error;
use crate::scene::{OpenOptions, Scene};
use crate::view::alone::{self, PageOptions};
use crate::wording::counted;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  qirf-vk convert model.ply model.spz
  qirf-vk convert model.ply model.glb
  qirf-vk convert model.ply model.html --title Garden --background white
  qirf-vk convert playbot-sog/ playbot.compressed.ply

Formats read: PLY (binary, text, compressed), SPZ 1 to 4, .splat, .ksplat, SOG, glTF (.glb, .gltf), USD (.usda, .usdz).
Formats written: PLY (exact), GLB and USD (exact but for rounding), SPZ, SOG and .compressed.ply (quantised).
A name in .html gives one page that holds the model as SPZ and draws it in any browser with WebGL 2, without a network.";

/// Convert a model between file formats.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Model to write: .ply, .compressed.ply, .spz, .sog, .glb, .usda, .usdz or .html
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Version of a written SPZ: 3 for readers of before 2026; the values are the same
    #[arg(long, value_name = "3|4", default_value = "4", value_parser = spz_version)]
    spz_version: SpzVersion,
    /// Title of the page [default: the model's file name]
    #[arg(long, value_name = "TEXT", help_heading = "Pages (.html)")]
    title: Option<String>,
    /// Colour behind the Gaussians: three numbers from 0 to 1, or black, grey, white
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Pages (.html)")]
    background: Option<[f32; 3]>,
    /// World axis that is up: x, y, z, -x, -y, -z, or auto (as in captures: -y)
    #[arg(long, value_name = "AXIS", value_parser = values::up, allow_hyphen_values = true, help_heading = "Pages (.html)")]
    up: Option<Up>,
    /// Scene whose first camera shows the model first [default: the whole model]
    #[arg(long, value_name = "SCENE", help_heading = "Pages (.html)")]
    scene: Option<PathBuf>,
}

fn spz_version(text: &str) -> Result<SpzVersion, String> {
    match text {
        "3" => Ok(SpzVersion::Three),
        "4" => Ok(SpzVersion::Four),
        _ => Err("write 3 or 4".into()),
    }
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        formats::refuse_overwrite(&self.input, &self.output).map_err(Error::writing)?;
        if self.output.is_dir() {
            let what = format!("{} is a folder; name a file, such as model.spz", self.output.display());
            return Err(Error::Usage(what));
        }
        let is_page = self.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("html"));
        let for_pages = self.title.is_some() || self.background.is_some() || self.up.is_some() || self.scene.is_some();
        if for_pages && !is_page {
            let what = "--title, --background, --up and --scene are for pages: name an .html file";
            return Err(Error::Usage(what.into()));
        }
        if !is_page {
            formats::check_output(&self.output).map_err(Error::writing)?;
        }
        let loaded = read_model(&self.input, console)?;
        if is_page {
            self.write_page(&loaded)?;
        } else {
            formats::write_version(&self.output, &loaded.gaussians, loaded.mode, self.spz_version)
                .map_err(Error::writing)?;
        }
        let bytes = std::fs::metadata(&self.output).map_or(0, |m| m.len());
        console.note(format_args!(
            "{} of {} in {} ({bytes} bytes)",
            counted(
                loaded.gaussians.len(),
                if loaded.mode.antialiased() { "anti-aliased Gaussian" } else { "Gaussian" }
            ),
            loaded.format,
            self.output.display()
        ));
        Ok(())
    }

    fn write_page(&self, loaded: &Loaded) -> Result<(), Error> {
        let stem = || self.input.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let start = match &self.scene {
            Some(path) => Scene::open(path, &OpenOptions::default())?.views.first().map(|view| view.camera.clone()),
            None => None,
        };
        let options = PageOptions {
            title: self.title.clone().unwrap_or_else(stem),
            background: self.background.unwrap_or_default(),
            up: self.up.unwrap_or(Up::Auto).direction(),
            start,
        };
        let page = alone::page(&loaded.gaussians, loaded.mode, &options, &self.output).map_err(Error::writing)?;
        formats::write_atomically(&self.output, |out| out.write_all(page.as_bytes())).map_err(Error::writing)
    }
}

//! `qirf-vk convert IN OUT`.

use super::console::Console;
use super::inspect::read_model;
use crate::gaussians::formats;
use crate::pipeline::Error;
use crate::wording::counted;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  qirf-vk convert model.ply model.spz
  qirf-vk convert playbot-sog/ playbot.ply

Formats read: PLY (binary, text, compressed), SPZ 1 to 4, .splat, .ksplat, SOG. Formats written: PLY (exact), SPZ and SOG (quantised).";

/// Convert a model between file formats.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Model to write: .ply, .spz or .sog
    #[arg(value_name = "OUT")]
    output: PathBuf,
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        formats::refuse_overwrite(&self.input, &self.output).map_err(Error::writing)?;
        if self.output.is_dir() {
            let what = format!("{} is a folder; name a .ply, .spz or .sog file", self.output.display());
            return Err(Error::Usage(what));
        }
        let loaded = read_model(&self.input, console)?;
        formats::write(&self.output, &loaded.gaussians, loaded.mode).map_err(Error::writing)?;
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
}

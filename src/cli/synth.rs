//! `qirf-vk synth DIR`.

use super::console::Console;
use super::values;
use crate::job::Error;
use crate::synth::{self, Effect, Kind, SynthOptions};
use crate::wording::counted;
use std::path::PathBuf;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk synth capture
  qirf-vk synth capture --views 100 --size 640x480 --effects exposure,distortion
  qirf-vk synth land --kind terrain --views 96 --size 320x240
  qirf-vk synth walk --kind panorama --views 24";

/// Make a synthetic capture: a COLMAP project with photos, cameras and points.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES, after_long_help = long_help())]
pub(super) struct Arguments {
    /// Folder to write: new, empty, or an earlier synthetic capture
    dir: PathBuf,
    /// Kind of scene
    #[arg(long, value_name = "plaza|terrain|panorama", default_value = "plaza", value_parser = values::one_of::<Kind>("a kind of scene"))]
    kind: Kind,
    /// Number of photos
    #[arg(long, value_name = "N", default_value_t = 48, value_parser = values::whole::<usize>)]
    views: usize,
    /// Size of a photo [default: 240x180; of a panorama 512x256]
    #[arg(long, value_name = "WxH", value_parser = values::size)]
    size: Option<(u32, u32)>,
    /// Random seed: the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = values::whole::<u64>)]
    seed: u64,
    /// Largest number of points in the capture
    #[arg(long, value_name = "N", default_value_t = SynthOptions::default().points, value_parser = values::whole::<usize>)]
    points: usize,
    /// Also write depth/*.npy: the depth at the centre of each pixel, along the camera's axis, or along the ray in panoramas
    #[arg(long)]
    depth: bool,
    /// Effects that the scene calls for, separated by commas; --help lists them [default: none]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    effects: Vec<String>,
}

fn long_help() -> String {
    let effects: Vec<String> = Effect::ALL.iter().map(|e| format!("  {e:<11} {}", e.description())).collect();
    format!("Effects (--effects):\n{}\n\n{EXAMPLES}", effects.join("\n"))
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        let effects = self.effects.iter().filter(|e| !e.trim().is_empty()).map(|e| e.parse());
        let usual = if self.kind == Kind::Panorama { (512, 256) } else { (240, 180) };
        let (width, height) = self.size.unwrap_or(usual);
        let options = SynthOptions {
            kind: self.kind,
            views: self.views,
            width,
            height,
            seed: self.seed,
            points: self.points,
            depth: self.depth,
            effects: effects.collect::<Result<_, synth::Error>>()?,
        };
        let begun = Instant::now();
        let bar = console.bar(self.views as u64, "tracing photos");
        let report = synth::write(&self.dir, &options, &|done| bar.set_position(done))?;
        bar.finish_and_clear();
        console.note(format_args!(
            "{} ({} held out for tests) and {} in {} ({:.1} s)",
            counted(report.photos, "photo"),
            report.test_photos,
            counted(report.points, "point"),
            self.dir.display(),
            begun.elapsed().as_secs_f64(),
        ));
        Ok(())
    }
}

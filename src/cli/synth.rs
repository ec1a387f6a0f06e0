//! `qirf-vk synth DIR`.

use super::check_folder;
use super::console::Console;
use super::values;
use crate::job::Error;
use crate::synth::{self, Calibration, Effect, Kind, SynthOptions};
use crate::wording::counted;
use std::path::PathBuf;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk synth capture
  qirf-vk synth capture --views 100 --size 640x480 --effects exposure,distortion
  qirf-vk synth land --kind terrain --views 96 --size 320x240
  qirf-vk synth walk --kind panorama --views 24
  qirf-vk synth dots --kind dots --size 640x480 --lens FOV:450,455,320,240,0.7";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Folder to write: new, empty, or an earlier synthetic capture
    dir: PathBuf,
    /// Kind of scene
    #[arg(long, value_name = "plaza|terrain|panorama|dots", default_value = "plaza", value_parser = values::one_of::<Kind>("a kind of scene"))]
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
    /// Lens of all photos: a camera model of COLMAP and its parameters, in pixels and in COLMAP's order [default: a pinhole]
    #[arg(long, value_name = "MODEL:P,P,...")]
    lens: Option<String>,
    /// Largest number of points in the capture [default: 6000; of dots 400]
    #[arg(long, value_name = "N", value_parser = values::whole::<usize>)]
    points: Option<usize>,
    /// Also write depth/*.npy: the depth at the centre of each pixel, along the camera's axis, or along the ray in panoramas and
    /// wide fisheyes
    #[arg(long)]
    depth: bool,
    /// Effects that the scene needs, separated by commas [default: none]
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = values::one_of::<Effect>("an effect"))]
    effects: Vec<Effect>,
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        check_folder(&self.dir)?;
        let usual = if self.kind == Kind::Panorama { (512, 256) } else { (240, 180) };
        let (width, height) = self.size.unwrap_or(usual);
        let points = if self.kind == Kind::Dots { 400 } else { SynthOptions::default().points };
        let options = SynthOptions {
            kind: self.kind,
            views: self.views,
            width,
            height,
            seed: self.seed,
            lens: self.lens.as_deref().map(str::parse::<Calibration>).transpose()?,
            points: self.points.unwrap_or(points),
            depth: self.depth,
            effects: self.effects.clone(),
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

//! The synthetic scene: its bytes, its geometry, and the trace of each effect.

mod colmap;
mod dots;
mod files;
mod geometry;
mod panorama;
mod photos;
mod terrain;

use qirf_vk::synth::{self, Effect, SynthOptions, SynthReport};

fn options(views: usize, effects: &[Effect]) -> SynthOptions {
    SynthOptions { views, width: 64, height: 48, points: 400, effects: effects.to_vec(), ..SynthOptions::default() }
}

fn make(options: &SynthOptions) -> (tempfile::TempDir, SynthReport) {
    let dir = tempfile::tempdir().unwrap();
    let report = synth::write(dir.path(), options, &|_| ()).unwrap();
    (dir, report)
}

fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    assert!(!values.is_empty(), "no values");
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * q).round() as usize]
}

//! Contents of a model: counts, bounds, and the distributions of opacity and size.

use crate::extension::folder_of;
use crate::gaussians::formats::{self, Loaded};
use crate::gaussians::{Gaussians, opacity};
use crate::job::Error;
use crate::pipeline::effects;
use serde_json::{Map, Value, json};
use std::io;
use std::path::Path;

/// Shares at which quantiles are reported.
const SHARES: [(f64, &str); 7] =
    [(0.0, "min"), (0.01, "p01"), (0.1, "p10"), (0.5, "p50"), (0.9, "p90"), (0.99, "p99"), (1.0, "max")];

/// The model as one document.
pub(super) fn describe(path: &Path, loaded: &Loaded) -> Result<Value, Error> {
    let model = &loaded.gaussians;
    let opacities = model.opacity_logits.iter().map(|l| opacity(*l)).collect();
    let scales = model.log_scales.iter().flatten().map(|s| f64::from(*s).exp()).collect();
    let anisotropy = model
        .log_scales
        .iter()
        .map(|s| {
            let (low, high) = (s[0].min(s[1]).min(s[2]), s[0].max(s[1]).max(s[2]));
            f64::from(high - low).exp()
        })
        .collect();
    let axis = |i: usize| model.means.iter().map(|m| f64::from(m[i])).collect::<Vec<_>>();
    let bands: Vec<f64> = model.sh.iter().map(|band| rms(band)).collect();
    Ok(json!({
        "kind": "model",
        "format": loaded.format.to_string(),
        "render_mode": loaded.mode,
        "bytes": bytes(path)?,
        "gaussians": model.len(),
        "sh_degree": model.degree(),
        "sh_degree_in_effect": model.degree_in_effect(),
        "sh_rms_by_band": bands,
        "bytes_in_memory": memory(model),
        "origin": loaded.origin,
        "x": quantiles(axis(0)),
        "y": quantiles(axis(1)),
        "z": quantiles(axis(2)),
        "opacity": quantiles(opacities),
        "scale": quantiles(scales),
        "longest_to_shortest_axis": quantiles(anisotropy),
        "repairs": loaded.repairs,
        "effects": [effects::of_model(model)],
    }))
}

/// Bytes on disk; for a SOG model in a folder, those of its files, of all levels of detail.
fn bytes(path: &Path) -> Result<u64, Error> {
    let read = |source| Error::Read { path: path.to_owned(), source };
    let Some(meta) = formats::sog_meta(path) else {
        return Ok(std::fs::metadata(path).map_err(read)?.len());
    };
    files(folder_of(&meta), formats::is_levels(&meta)).map_err(read)
}

/// Bytes of the files in a folder, and of those in its folders.
fn files(folder: &Path, and_below: bool) -> io::Result<u64> {
    let mut sum = 0;
    for entry in std::fs::read_dir(folder)? {
        let (path, data) = entry.and_then(|entry| Ok((entry.path(), entry.metadata()?)))?;
        sum += match (data.is_file(), data.is_dir() && and_below) {
            (true, _) => data.len(),
            (_, true) => files(&path, false)?,
            _ => 0,
        };
    }
    Ok(sum)
}

/// Bytes of the parameters as float32.
fn memory(model: &Gaussians) -> usize {
    4 * (model.len() * (3 + 3 + 4 + 1) + model.sh.iter().map(Vec::len).sum::<usize>())
}

fn rms(values: &[f32]) -> f64 {
    // An empty sum is -0.
    let sum = values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().abs();
    (sum / values.len().max(1) as f64).sqrt()
}

/// Quantiles by name; none if there are no values.
fn quantiles(mut values: Vec<f64>) -> Value {
    if values.is_empty() {
        return Value::Null;
    }
    values.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    Value::Object(SHARES.iter().map(|(share, name)| ((*name).to_owned(), json!(at(*share)))).collect::<Map<_, _>>())
}

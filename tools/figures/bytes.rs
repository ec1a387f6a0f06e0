//! Quality against bytes: a plot and a table from the curves of several models.

use super::measured::json;
use qirf_vk::job::records::FileRecord;
use qirf_vk::report::curve::drawing;
use qirf_vk::report::plot::sheet;
use std::fmt::Write as _;
use std::path::Path;

/// Name of the plot in `docs/figures`.
pub const FILE: &str = "docs/figures/bytes.svg";
const OURS: &str = "qirf-vk";
/// PSNR in dB from which on pictures are as good as equal, and files have no place in a plot; equal pictures have no PSNR.
const EQUAL: f64 = 80.0;

/// The plot and the table of the curves in these folders, which are called like the models.
///
/// # Errors
/// A curve that is missing or wrong.
pub fn bytes(folders: &[&Path], told: &str) -> Result<(String, String), String> {
    let mut drawings = Vec::new();
    let mut table = "| model | MB | SOG | SPZ | splat-transform's best |\n|---|---:|---:|---:|---:|\n".to_owned();
    for folder in folders {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let files = read(&folder.join("curve.json"))?;
        drawings.push(drawing(&files, &label, &name));
        for file in files.iter().filter(|file| file.tool == OURS && file.format == "sog") {
            let at = |tool: &dyn Fn(&str) -> bool, format: Option<&str>| {
                let formats = ["sog", "spz"].into_iter().filter(|f| format.is_none_or(|only| only == *f));
                let known = formats.filter_map(|f| interpolated(&files, (tool, f), file.bytes));
                known.reduce(f64::max).map_or_else(|| "-".to_owned(), |psnr| format!("{psnr:.1}"))
            };
            let (spz, theirs) = (at(&|tool| tool == OURS, Some("spz")), at(&|tool| tool != OURS, None));
            let (size, psnr) = (file.bytes as f64 / 1e6, file.scores.psnr.unwrap_or_default());
            let _ = writeln!(table, "| {name} | {size:.3} | {psnr:.1} | {spz} | {theirs} |");
        }
    }
    let text = format!("{told} PSNR in dB against the model's own pictures.\n\n{table}");
    Ok((sheet("PSNR against bytes", &drawings, 2), text))
}

/// PSNR at a size: between the nearest files of a tool and a format, by the logarithm of bytes; none beyond them.
fn interpolated(files: &[FileRecord], (tool, format): (&dyn Fn(&str) -> bool, &str), bytes: u64) -> Option<f64> {
    let of = || files.iter().filter(|file| tool(&file.tool) && file.format == format);
    let below = of().filter(|file| file.bytes <= bytes).max_by_key(|file| file.bytes)?;
    let Some(above) = of().filter(|file| file.bytes >= bytes).min_by_key(|file| file.bytes) else {
        // What fits is the best there is, unless larger files were not measured.
        let whole = files.iter().map(|file| file.gaussians).max();
        return below.scores.psnr.filter(|_| below.tool == OURS || Some(below.gaussians) == whole);
    };
    let (low, high) = (below.scores.psnr?, above.scores.psnr?);
    let beyond = |bytes: u64| (bytes as f64 / below.bytes as f64).ln();
    let span = beyond(above.bytes);
    let share = if span > 0.0 { beyond(bytes) / span } else { 0.0 };
    Some(low + share * (high - low))
}

/// A line's name; the other tool's version would make the legend too wide.
fn label(file: &FileRecord) -> String {
    let tool = if file.tool == OURS { "" } else { file.tool.split(' ').next().unwrap_or_default() };
    format!("{tool} {}", file.format.to_uppercase()).trim().to_owned()
}

fn read(path: &Path) -> Result<Vec<FileRecord>, String> {
    let files = serde_json::from_value(json(path)?["files"].clone());
    let mut files: Vec<FileRecord> = files.map_err(|e| format!("{}: {e}", path.display()))?;
    files.retain(|file| file.scores.psnr.is_some_and(|psnr| psnr < EQUAL));
    if files.is_empty() { Err(format!("{}: no files", path.display())) } else { Ok(files) }
}

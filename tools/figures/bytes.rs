//! Quality against bytes: a plot and a table from the curves of several models.

use qirf_vk::report::plot::{Axis, Drawing, Line, Lines, sheet};
use std::fmt::Write as _;
use std::path::Path;

/// Name of the plot in `docs/figures`.
pub const FILE: &str = "docs/figures/bytes.svg";
const OURS: &str = "qirf-vk";
/// PSNR in dB from which on pictures are as good as equal, and files have no place in a plot.
const EQUAL: f64 = 80.0;

/// A file of a curve.
struct Row {
    tool: String,
    format: String,
    bytes: f64,
    gaussians: usize,
    psnr: f64,
}

/// The plot and the table of the curves in these folders, which are called like the models.
///
/// # Errors
/// A curve that is missing or wrong.
pub fn bytes(folders: &[&Path], told: &str) -> Result<(String, String), String> {
    let mut drawings = Vec::new();
    let mut table = "| model | MB | SOG | SPZ | splat-transform's best |\n|---|---:|---:|---:|---:|\n".to_owned();
    for folder in folders {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let rows = read(&folder.join("curve.csv"))?;
        drawings.push(drawing(&name, &rows));
        let sizes: Vec<&Row> = rows.iter().filter(|row| row.tool == OURS && row.format == "sog").collect();
        for row in sizes {
            let at = |tool: &dyn Fn(&str) -> bool, format: Option<&str>| {
                let formats = ["sog", "spz"].into_iter().filter(|f| format.is_none_or(|only| only == *f));
                let known = formats.filter_map(|f| interpolated(&rows, (tool, f), row.bytes));
                known.reduce(f64::max).map_or_else(|| "-".to_owned(), |psnr| format!("{psnr:.1}"))
            };
            let (spz, theirs) = (at(&|tool| tool == OURS, Some("spz")), at(&|tool| tool != OURS, None));
            let _ = writeln!(table, "| {name} | {:.3} | {:.1} | {spz} | {theirs} |", row.bytes / 1e6, row.psnr);
        }
    }
    let text = format!("{told} PSNR in dB against the model's own pictures.\n\n{table}");
    Ok((sheet("PSNR against bytes", &drawings, 2), text))
}

/// PSNR at a size: between the nearest files of a tool and a format, by the logarithm of bytes; none beyond them.
fn interpolated(rows: &[Row], (tool, format): (&dyn Fn(&str) -> bool, &str), bytes: f64) -> Option<f64> {
    let of = || rows.iter().filter(|row| tool(&row.tool) && row.format == format);
    let below = of().filter(|row| row.bytes <= bytes).max_by(|a, b| a.bytes.total_cmp(&b.bytes))?;
    let Some(above) = of().filter(|row| row.bytes >= bytes).min_by(|a, b| a.bytes.total_cmp(&b.bytes)) else {
        // What fits is the best there is, unless larger files were not measured.
        let whole = rows.iter().map(|row| row.gaussians).max();
        return (below.tool == OURS || Some(below.gaussians) == whole).then_some(below.psnr);
    };
    let span = (above.bytes / below.bytes).ln();
    let share = if span > 0.0 { (bytes / below.bytes).ln() / span } else { 0.0 };
    Some(below.psnr + share * (above.psnr - below.psnr))
}

fn drawing(name: &str, rows: &[Row]) -> Drawing {
    // The other tool's version would make the legend too wide.
    let label = |row: &Row| {
        let tool = if row.tool == OURS { "" } else { row.tool.split(' ').next().unwrap_or_default() };
        format!("{tool} {}", row.format.to_uppercase()).trim().to_owned()
    };
    let mut names: Vec<String> = rows.iter().map(label).collect();
    names.sort();
    names.dedup();
    let points = |line: &String| {
        let own = rows.iter().filter(|row| label(row) == *line);
        let mut points: Vec<[f64; 2]> = own.map(|row| [row.bytes / 1e6, row.psnr]).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        points
    };
    let lines = names.iter().map(|line| Line { name: line, points: points(line) }).collect();
    Lines { title: name, x: Axis::log("file / MB"), y: Axis::new("PSNR / dB"), lines, marks: Vec::new() }.drawing()
}

fn read(path: &Path) -> Result<Vec<Row>, String> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let [tool, format, _, bytes, gaussians, psnr, ..] = cells[..] else { return None };
        // Equal pictures have no PSNR, and no place in a plot.
        Some(Row {
            tool: tool.into(),
            format: format.into(),
            bytes: bytes.parse().ok()?,
            gaussians: gaussians.parse().ok()?,
            psnr: psnr.parse().ok()?,
        })
    };
    let rows: Vec<Row> = text.lines().skip(1).filter_map(row).filter(|row| row.psnr < EQUAL).collect();
    if rows.is_empty() { Err(format!("{}: no files", path.display())) } else { Ok(rows) }
}

//! Tables of `make results`: what pruning costs on whole scenes, from the comparisons in its folder.

use super::measured::json;
use super::{Origin, Parts};
use qirf_vk::report::format::{bytes, count, decimals, seconds};
use serde_json::Value;
use std::path::Path;

/// Arms of the table in README.md, with their headings there; those that no comparison has are left out.
const SHOWN: [(&str, &str); 5] = [
    ("dense+thresholds", "not pruned, growth of 3DGS"),
    ("dense", "not pruned"),
    ("grown", "not pruned, growth to the kept number"),
    ("importance", "pruned in one cut"),
    ("default", "pruned by attrition (default)"),
];

/// The comparison of one scene.
struct Compared {
    scene: String,
    record: Value,
}

/// Parts of docs/results.md and of README.md from a folder with a comparison for each scene.
///
/// # Errors
/// A folder without comparisons; a file that cannot be read or lacks a field.
pub fn results(folder: &Path, origin: &Origin) -> Result<[Parts; 2], String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut files: Vec<_> = entries.flatten().map(|e| e.path().join("compare.json")).filter(|f| f.exists()).collect();
    files.sort();
    let read = |file: &std::path::PathBuf| {
        let scene = file.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned();
        json(file).map(|record| Compared { scene, record })
    };
    let all: Vec<Compared> = files.iter().map(read).collect::<Result<_, _>>()?;
    let Some(first) = all.first() else {
        return Err(format!("{}: no comparison in it; run make results", folder.display()));
    };
    let device = first.record["device"]["name"].as_str().unwrap_or("unknown device");
    let measured = format!("Measured on {device}, commit {}; `{}`.", origin.commit, origin.command);
    let tables: String = all.iter().map(Compared::table).collect();
    Ok([vec![("results", format!("{measured}\n\n{tables}"))], vec![("results", summary(&all))]])
}

impl Compared {
    fn arms(&self) -> &[Value] {
        self.record["arms"].as_array().map_or(&[], Vec::as_slice)
    }

    fn arm(&self, name: &str) -> Option<&Value> {
        self.arms().iter().find(|a| a["name"] == name)
    }

    /// The table of a scene, under its heading.
    fn table(&self) -> String {
        let r = &self.record;
        let seeds = r["seeds"].as_array().map_or(1, Vec::len);
        let one = if seeds == 1 { "; another seed may differ by some tenths of a decibel" } else { "" };
        let mut out = format!(
            "### {}\n\n{} iterations; {} Gaussians after iteration {}; seeds: {seeds}{one}.\n\n\
             | arm | PSNR / dB | deviation | right after the prune | SSIM | Gaussians | PLY | training |\n\
             |---|---:|---:|---:|---:|---:|---:|---:|\n",
            self.scene,
            count(whole(&r["iterations"])),
            count(whole(&r["gaussians"])),
            count(whole(&r["prune_point"])),
        );
        for arm in self.arms() {
            out += &format!(
                "| {} | {} | {} | {} | {} | {} | {} | {} |\n",
                arm["name"].as_str().unwrap_or("?"),
                decimals(arm["psnr"].as_f64(), 2),
                decimals(arm["psnr_spread"].as_f64(), 2),
                decimals(arm["psnr_pruned"].as_f64(), 2),
                decimals(arm["ssim"].as_f64(), 4),
                count(whole(&arm["gaussians"])),
                bytes(whole(&arm["ply_bytes"]) as u64),
                seconds(arm["seconds"].as_f64().unwrap_or(0.0)),
            );
        }
        out + "\n"
    }
}

fn whole(value: &Value) -> usize {
    value.as_u64().unwrap_or(0) as usize
}

/// One row for each scene: PSNR and number of Gaussians of each arm shown.
fn summary(all: &[Compared]) -> String {
    let shown: Vec<_> = SHOWN.iter().filter(|(name, _)| all.iter().any(|c| c.arm(name).is_some())).collect();
    let heads: Vec<&str> = shown.iter().map(|(_, heading)| *heading).collect();
    let mut out = format!("| scene | {} |\n|---|{}\n", heads.join(" | "), "---:|".repeat(shown.len()));
    for compared in all {
        let cell = |name: &str| {
            let Some(arm) = compared.arm(name) else { return "-".to_owned() };
            let thousands = whole(&arm["gaussians"]) as f64 / 1e3;
            format!("{} dB, {thousands:.0} k", decimals(arm["psnr"].as_f64(), 2))
        };
        let cells: Vec<String> = shown.iter().map(|(name, _)| cell(name)).collect();
        out += &format!("| {} | {} |\n", compared.scene, cells.join(" | "));
    }
    out
}

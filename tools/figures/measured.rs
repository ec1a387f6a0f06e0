//! The files of criterion and of the benchmarks: times by name, and the work that each timed.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Milliseconds: smallest, median, largest of the samples.
    pub ms: [f64; 3],
    /// The work, as named numbers.
    pub numbers: BTreeMap<String, f64>,
}

impl Measured {
    /// The number of this name; 0 where there is none.
    pub fn number(&self, name: &str) -> f64 {
        self.numbers.get(name).copied().unwrap_or(0.0)
    }
}

/// All benchmarks of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bench {
    /// By criterion's name, `group/function/parameter`.
    all: BTreeMap<String, Measured>,
    /// `device.json` as the benchmarks wrote it.
    pub device: Value,
}

impl Bench {
    /// Reads criterion's folder.
    ///
    /// # Errors
    /// A file that is absent, not JSON, or lacks a field, by its path.
    pub fn read(home: &Path) -> Result<Self, String> {
        let device = json(&home.join("device.json"))
            .map_err(|e| format!("{e}; the benchmarks write it: make figures, or CRITERION_HOME=... cargo bench"))?;
        let mut all = BTreeMap::new();
        for file in found(home, "benchmark.json")? {
            let sample = file.with_file_name("sample.json");
            let id = text(&json(&file)?, "full_id", &file)?;
            all.insert(id, Measured { ms: spread(&json(&sample)?, &sample)?, numbers: BTreeMap::new() });
        }
        for file in found(&home.join("facts"), ".json")? {
            let fact = json(&file)?;
            let Some(measured) = all.get_mut(&text(&fact, "id", &file)?) else { continue };
            let numbers = fact["numbers"].as_object().ok_or_else(|| lacks(&file, "numbers"))?;
            measured.numbers = numbers.iter().filter_map(|(k, v)| Some((k.clone(), v.as_f64()?))).collect();
        }
        if all.is_empty() {
            return Err(format!("{}: no benchmark was measured", home.display()));
        }
        Ok(Self { all, device })
    }

    /// A benchmark by its name.
    ///
    /// # Errors
    /// Its name, where it was not measured.
    pub fn get(&self, id: &str) -> Result<&Measured, String> {
        self.all.get(id).ok_or_else(|| format!("benchmark '{id}' was not measured; run all groups: make figures"))
    }

    /// The benchmarks of a group, in order of their names without the group.
    pub fn group<'a>(&'a self, group: &'a str) -> impl Iterator<Item = (&'a str, &'a Measured)> {
        self.all.iter().filter_map(move |(id, m)| Some((id.strip_prefix(group)?.strip_prefix('/')?, m)))
    }
}

/// Files in this folder's tree whose names end with `end`; of several measurements the latest (`new`).
fn found(folder: &Path, end: &str) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    for entry in entries {
        let path = entry.map_err(|e| format!("{}: {e}", folder.display()))?.path();
        if path.is_dir() {
            files.extend(found(&path, end)?);
        } else if path.to_string_lossy().ends_with(end) && (end == ".json" || folder.ends_with("new")) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

pub fn json(path: &Path) -> Result<Value, String> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    serde_json::from_str(&text).map_err(|e| format!("{}: {e}", path.display()))
}

fn lacks(path: &Path, field: &str) -> String {
    format!("{}: no '{field}' as expected", path.display())
}

fn text(value: &Value, field: &str, path: &Path) -> Result<String, String> {
    value[field].as_str().map(str::to_owned).ok_or_else(|| lacks(path, field))
}

/// Smallest, median and largest time of an iteration, in milliseconds.
fn spread(sample: &Value, path: &Path) -> Result<[f64; 3], String> {
    let row = |field: &str| -> Result<Vec<f64>, String> {
        let values = sample[field].as_array().ok_or_else(|| lacks(path, field))?;
        values.iter().map(|v| v.as_f64().ok_or_else(|| lacks(path, field))).collect()
    };
    let mut each: Vec<f64> = row("times")?.iter().zip(row("iters")?).map(|(t, n)| 1e-6 * t / n).collect();
    each.sort_by(f64::total_cmp);
    let (Some(low), Some(high)) = (each.first(), each.last()) else { return Err(lacks(path, "times")) };
    let middle = f64::midpoint(each[(each.len() - 1) / 2], each[each.len() / 2]);
    Ok([*low, middle, *high])
}

//! Facts about each benchmark, beside criterion's figures: one file each in `facts/` of criterion's folder. `make
//! figures` makes tables and bounds from both.

use std::path::{Path, PathBuf};

/// Criterion's output folder.
fn home() -> PathBuf {
    let from = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    from("CRITERION_HOME")
        .or_else(|| from("CARGO_TARGET_DIR").map(|target| target.join("criterion")))
        .unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("target/criterion"))
}

/// Records numbers of the benchmark `group/rest[0]/rest[1]`, its name in criterion's files.
pub fn note(group: &str, rest: &[&str], numbers: &[(&str, f64)]) {
    let id = [&[group], rest].concat().join("/");
    let numbers: serde_json::Map<_, _> = numbers.iter().map(|(k, v)| ((*k).to_owned(), (*v).into())).collect();
    let name: String = id.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    write(&format!("facts/{name}.json"), &serde_json::json!({ "id": id, "numbers": numbers }));
}

/// Records the measured device and its machine.
pub fn note_device(info: &qirf_vk::gpu::DeviceInfo, quick: bool) {
    // The load before this process: from other programs running beside it.
    let load = std::fs::read_to_string("/proc/loadavg").ok();
    let load = load.as_deref().and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    let cpus = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpus.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':').map(|(_, name)| name.trim()));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let noted = serde_json::json!({
        "name": info.name, "kind": info.kind, "driver": info.driver, "subgroup": info.subgroup_size,
        "timestamps": info.timestamp_period > 0.0, "cpu": cpu, "threads": threads, "load": load, "quick": quick,
    });
    write("device.json", &noted);
}

/// Writes a file of facts; a failure is printed and does not stop the benchmark.
fn write(name: &str, value: &serde_json::Value) {
    let path = home().join(name);
    let written = std::fs::create_dir_all(path.parent().expect("a folder"))
        .and_then(|()| std::fs::write(&path, format!("{value:#}\n")));
    if let Err(e) = written {
        println!("{}: {e}", path.display());
    }
}

//! `qirf-vk device --tune` and `--tuning`: which shapes of kernels later runs have.

use crate::program::ended::{Ended, end, qirf};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

fn device(cache: &Path, arguments: &[&str], variable: Option<&str>) -> Ended {
    let mut command = qirf(["device"]);
    command.args(arguments).env("XDG_CACHE_HOME", cache).env_remove("QIRF_TUNING");
    // Mesa's own cache of kernels is not looked for there.
    let kernels = std::env::var_os("MESA_SHADER_CACHE_DIR").or_else(|| Some(dirs::cache_dir()?.into()));
    command.envs(kernels.map(|folder| ("MESA_SHADER_CACHE_DIR", folder)));
    end(command.envs(variable.map(|tuning| ("QIRF_TUNING", tuning))))
}

fn document(ended: Ended) -> Value {
    ended.with(0, &[]).json()
}

#[test]
fn a_stored_tuning_is_used_unless_another_is_asked_for() {
    let cache = tempfile::tempdir().unwrap();
    let opened = document(device(cache.path(), &["--json"], None));
    let own = opened["devices"].as_array().unwrap().iter().find(|d| d["index"] == opened["chosen"]).unwrap();
    let (name, driver) = (own["name"].as_str().unwrap(), own["driver"].as_str().unwrap());
    let mut tuning = opened["tuning"].clone();
    let rows = tuning["scan_rows"].as_u64().unwrap();
    tuning["scan_rows"] = json!(rows / 2);
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let file =
        cache.path().join("qirf-vk").join(format!("tuning-{}.json", name.chars().map(plain).collect::<String>()));
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    let store = |driver: &str, tuning: &Value| {
        fs::write(&file, json!({ "device": name, "driver": driver, "tuning": tuning }).to_string()).unwrap();
    };
    let used = |arguments: &[&str], variable| {
        let all = [&["--json"], arguments].concat();
        document(device(cache.path(), &all, variable))["tuning"]["scan_rows"].as_u64().unwrap()
    };
    store(driver, &tuning);
    assert_eq!(used(&[], None), rows / 2);
    assert_eq!(used(&["--tuning", "scan_rows=3"], None), 3);
    assert_eq!(used(&["--tuning", "scan_rows=3"], Some("scan_rows=5")), 3, "the option has precedence");
    assert_eq!(used(&[], Some("scan_rows=5")), 5);
    assert_eq!(used(&[], Some("")), rows, "an empty variable asks for the class's row");
    let text = device(cache.path(), &[], None).out;
    assert!(text.contains("as measured by --tune"), "{text}");

    // One of another driver, or that does not fit, is told of and not used.
    let mut unfit = tuning.clone();
    unfit["tile"] = json!(9);
    for (driver, tuning) in [("an older one", &tuning), (driver, &unfit)] {
        store(driver, tuning);
        let told = device(cache.path(), &["--json"], None);
        assert!(told.said.contains("is not used") && told.said.contains("--tune"), "{}", told.said);
        assert_eq!(document(told)["tuning"]["scan_rows"], rows);
    }

    device(cache.path(), &["--tuning", "riva"], None).with(2, &[]);
    // In a second, there is time to make the kernels of the usual tuning, and on a fast machine for some others.
    let ended = device(cache.path(), &["--tune", "1", "--json"], None);
    if ended.code == Some(2) {
        ended.with(2, &["nothing is changed"]);
        assert!(file.exists());
        return;
    }
    let again = document(ended);
    let tried = &again["tuned"]["tried"];
    assert!(tried[0]["ms"].as_f64().is_some_and(|ms| ms > 0.0), "{again}");
    assert_eq!(
        again["stored"].is_null(),
        again["tuned"]["best"] == 0,
        "what beats the usual tuning is stored: {again}"
    );
    assert_eq!(file.exists(), again["tuned"]["best"] != 0, "where the usual tuning is best, nothing stays: {again}");
}

//! `qirf-vk device --tune` and `--tuning`: which shapes of kernels later runs have.

use crate::program::ended::{Ended, end, qirf};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

fn device(cache: &Path, arguments: &[&str], variable: Option<&str>) -> Ended {
    let mut command = qirf(["device"]);
    command.args(arguments).env("XDG_CACHE_HOME", cache).env_remove("QIRF_TUNING");
    end(command.envs(variable.map(|tuning| ("QIRF_TUNING", tuning))))
}

fn document(ended: Ended) -> Value {
    ended.with(0, &[]).json()
}

#[test]
fn a_stored_tuning_is_used_unless_another_is_asked_for() {
    let cache = tempfile::tempdir().unwrap();
    // In a second, there is time for the class's row, and on a fast machine for some others.
    let tuned = document(device(cache.path(), &["--tune", "1", "--json"], None));
    let tried = &tuned["tuned"]["tried"];
    assert!(tried[0]["ms"].as_f64().is_some_and(|ms| ms > 0.0), "{tuned}");
    assert_eq!(tuned["stored"].is_null(), tuned["tuned"]["best"] == 0, "what beats the class's row is stored: {tuned}");

    let (name, driver) = (tuned["device"]["name"].as_str().unwrap(), tuned["device"]["driver"].as_str().unwrap());
    let mut tuning = tried[0]["tuning"].clone();
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
        assert_eq!(used(&[], None), rows);
        let told = device(cache.path(), &[], None).said;
        assert!(told.contains("is not used") && told.contains("--tune"), "{told}");
    }

    device(cache.path(), &["--tuning", "riva"], None).with(2, &[]);
    let again = document(device(cache.path(), &["--tune", "1", "--json"], None));
    assert_eq!(
        file.exists(),
        again["tuned"]["best"] != 0,
        "where the class's row is best, nothing stays stored: {again}"
    );
}

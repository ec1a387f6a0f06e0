//! The location of shared data, skipping of tests without them, and the files below a folder.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A path below the folder of shared data (`../shared`, or `QIRF_SHARED`); `None` if it is missing, and the test is
/// skipped.
pub fn shared(part: &str) -> Option<PathBuf> {
    found(part, "no shared data")
}

/// The same for the larger part of a test that can run without them: that part is skipped.
pub fn shared_as_well(part: &str) -> Option<PathBuf> {
    found(part, "in part: no shared data")
}

fn found(part: &str, otherwise: &str) -> Option<PathBuf> {
    let root = std::env::var_os("QIRF_SHARED").map_or_else(|| source("../shared"), PathBuf::from);
    let path = Some(root.join(part)).filter(|path| path.exists());
    if path.is_none() {
        skip(otherwise);
    }
    path
}

/// A path in the source tree, or in `QIRF_SOURCE` if the tests run without one (`tools/gpu-report`).
pub fn source(part: &str) -> PathBuf {
    let root = std::env::var_os("QIRF_SOURCE").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    PathBuf::from(root).join(part)
}

/// Records that the running test, or a part of it, is skipped. `tools/test` counts the lines: libtest itself counts the
/// test as passed.
pub fn skip(reason: &str) {
    println!("skipped: {reason}");
    if std::env::var_os("QIRF_SOURCE").is_some() {
        return; // the lines are not counted
    }
    let path = std::env::var_os("QIRF_SKIPPED");
    let path = path.unwrap_or_else(|| concat!(env!("CARGO_TARGET_TMPDIR"), "/skipped").into());
    let file = fs::OpenOptions::new().create(true).append(true).open(path);
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    file.and_then(|mut file| file.write_all(format!("{reason}\t{test}\n").as_bytes())).expect("a note of the skip");
}

/// Every file below a folder with its content; none if there is no folder.
pub fn content(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { found.push((path.clone(), fs::read(path).unwrap())) }
        }
    }
    found.sort();
    found
}

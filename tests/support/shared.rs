//! Where shared data lie.

use std::path::PathBuf;

/// The folder of shared data, or none; the test then says that it was skipped.
pub fn shared() -> Option<PathBuf> {
    let path = std::env::var_os("QIRF_SHARED")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")), PathBuf::from);
    if path.is_dir() {
        Some(path)
    } else {
        println!("skipped: no shared data");
        None
    }
}

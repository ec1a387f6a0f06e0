//! The weights of LPIPS, which are not part of the program.

use super::console::Console;
use crate::metrics::Networks;
use std::path::{Path, PathBuf};

/// Reports scores skipped because their weights are missing, and how to get those; to be called once there are scores.
pub(super) fn tell_of_missing(networks: &Networks, console: &Console) {
    if let Some(note) = networks.note() {
        let python = if cfg!(windows) { "python " } else { "" };
        console.note(format_args!("{note}: run {python}{} once", lpips_weights().display()));
    }
}

/// The script that makes the weights of LPIPS: where `tools/package` puts it beside the program, else where the sources have it.
fn lpips_weights() -> PathBuf {
    let program = std::env::current_exe().and_then(|p| p.canonicalize()).ok();
    let installed = program.as_deref().and_then(Path::parent).and_then(|folder| {
        // A tarball has the program at its top, a Debian package in usr/bin.
        let tops = [Some(folder), folder.parent()];
        tops.into_iter().flatten().map(|top| top.join("share/qirf-vk/lpips-weights")).find(|script| script.is_file())
    });
    installed.unwrap_or_else(|| "tools/lpips-weights".into())
}

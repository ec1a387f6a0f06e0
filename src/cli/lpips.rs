//! The weights of LPIPS, which are not part of the program.

use super::console::Console;
use crate::metrics::Networks;
use std::path::{Path, PathBuf};

/// Reports scores skipped because their weights are missing, and how to get those; to be called once there are scores.
pub(super) fn tell_of_missing(networks: &Networks, console: &Console) {
    let Some(note) = networks.note() else { return };
    let python = if cfg!(windows) { "python " } else { "" };
    match lpips_weights() {
        Some(script) => console.note(format_args!("{note}: run {python}{} once", script.display())),
        None => console.note(format_args!("{note}: run tools/lpips-weights, a script in qirf-vk's source tree, once")),
    }
}

/// The script that makes the weights of LPIPS: where `tools/package` puts it beside the program.
fn lpips_weights() -> Option<PathBuf> {
    let program = std::env::current_exe().and_then(|p| p.canonicalize()).ok();
    let folder = program.as_deref().and_then(Path::parent);
    // A tarball has the program at its top, a Debian package in usr/bin.
    let tops = [folder, folder.and_then(Path::parent)];
    let mut installed = tops.into_iter().flatten().map(|top| top.join("share/qirf-vk/lpips-weights"));
    installed.find(|script| script.is_file())
}

//! The folder of temporary files.

use clap::Args;
use std::path::{Path, PathBuf};

/// Folder of temporary files.
#[derive(Args, Clone, Debug)]
pub(super) struct Scratch {
    /// Folder for a temporary file of decoded photos, which is written if they exceed a quarter of the host's memory; it is best
    /// on a local disk [default: $TMPDIR if it is set, else beside the outputs]
    #[arg(long, value_name = "DIR", env = "TMPDIR", hide_env = true, help_heading = "Photos")]
    scratch: Option<PathBuf>,
}

impl Scratch {
    /// The folder, if one was named.
    pub fn folder(&self) -> Option<&Path> {
        self.scratch.as_deref().filter(|folder| !folder.as_os_str().is_empty())
    }
}

//! The folder of temporary files.

use clap::Args;
use std::path::{Path, PathBuf};

/// Folder of temporary files.
#[derive(Args, Clone, Debug)]
pub(super) struct Scratch {
    /// Folder of the temporary file of decoded photos, where they exceed a quarter of the host's memory; a disk of this
    /// machine is best [default: $TMPDIR if it is set, else beside the outputs]
    #[arg(long, value_name = "DIR", env = "TMPDIR", hide_env = true, help_heading = "Photos")]
    scratch: Option<PathBuf>,
}

impl Scratch {
    /// The folder, if one was named.
    pub fn folder(&self) -> Option<&Path> {
        self.scratch.as_deref().filter(|folder| !folder.as_os_str().is_empty())
    }
}

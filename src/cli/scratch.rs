//! The folder of temporary files.

use crate::gpu::Device;
use crate::job::{Session, Watcher, host_bytes};
use crate::metrics::Networks;
use clap::Args;
use std::path::PathBuf;
use std::sync::LazyLock;

/// `$TMPDIR`, which counts without the option. Clap would take it for the option, and refuse it where that has no effect.
static TMPDIR: LazyLock<Option<PathBuf>> =
    LazyLock::new(|| std::env::var_os("TMPDIR").filter(|folder| !folder.is_empty()).map(PathBuf::from));

/// Folder of temporary files.
#[derive(Args, Clone, Debug)]
pub(super) struct Scratch {
    /// Folder for a temporary file of decoded photos, which is written if they exceed a quarter of the host's memory; it is best
    /// on a local disk [default: $TMPDIR if it is set, else beside the outputs]
    #[arg(long, value_name = "DIR", help_heading = "Photos")]
    scratch: Option<PathBuf>,
}

impl Scratch {
    /// A session in which decoded photos take so much memory, and the rest of them this folder, if one was named.
    pub fn session<'a>(
        &'a self,
        memory_budget: Option<u64>,
        (device, networks): (&'a Device, &'a Networks),
        watcher: &'a (dyn Watcher + Sync),
    ) -> Session<'a> {
        let named = self.scratch.as_deref().filter(|folder| !folder.as_os_str().is_empty());
        let scratch = named.or(TMPDIR.as_deref());
        Session { host_bytes: host_bytes(memory_budget), scratch, watcher, ..Session::new(device, networks) }
    }
}

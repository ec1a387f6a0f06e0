//! Common parts of all jobs: configuration, session and its watcher, the folder of results, records, and errors.

pub mod config;
pub mod diagnostics;
pub mod earlier;
mod error;
mod exit;
pub mod host_memory;
pub mod output;
pub mod records;
pub mod run_log;
pub mod sealed;
pub mod session;
pub mod watcher;

pub use config::{Init, Preset, RunConfig, Selection};
pub use earlier::Earlier;
pub use error::{Error, Relief};
pub use exit::Exit;
pub use output::Output;
pub use session::{Session, host_bytes};
pub use watcher::{Silent, Stage, Watcher};

//! Configurations of jobs, as in `config.toml` and on the command line.

mod changes;
mod file;
mod method;
mod pruning;
pub mod ranges;
mod run;

pub use file::KEYS;
pub use method::{MethodConfig, Methods, no_methods};
pub use pruning::{PruneRule, Pruning, ResponseSource};
pub use run::{Init, Preset, RunConfig, Selection};

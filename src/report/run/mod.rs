//! `report.html` of a run: its sections in order.

pub(super) mod blocks;
mod details;
mod pictures;
pub(super) mod pruning;
mod quality;
mod summary;
mod time;

pub use pictures::stacks;
pub use pruning::cut;

use super::page::{self, Section};
use super::slider::Stack;
use crate::job::records::RunRecord;
use maud::html;

/// The page of a run with these pictures, whose folder has this name; `config` is the text of config.toml, `viewer` a page that draws the model.
pub fn page((results, name): (&RunRecord, &str), stacks: &[Stack], config: &str, viewer: Option<&str>) -> String {
    let mut sections = vec![
        Section("summary", "Summary", summary::body(results)),
        Section("pictures", "Pictures", pictures::body(results, stacks)),
        Section("quality", "Quality over time", quality::body(results)),
        Section("pruning", "Pruning", pruning::body(results)),
    ];
    sections.extend(blocks::section(&results.prunes));
    sections.extend([
        Section("time", "Time by stage", time::body(results)),
        Section("views", "Held-out views", details::views(results)),
        Section("protocol", "Protocol", details::protocol(results)),
        Section("effects", "Effects", details::effects(results)),
        Section("guards", "Guards", details::guards(results)),
        Section("memory", "Memory", details::memory(results)),
        Section("configuration", "Configuration", details::configuration(config)),
    ]);
    if let Some(viewer) = viewer {
        let frame = html! { iframe class="viewer" title="The model" allow="fullscreen" srcdoc=(viewer) {} };
        sections.insert(1, Section("model", "Model", frame));
    }
    let [w, h] = results.protocol.image_size;
    let subtitle = format!(
        "qirf-vk {} on {}; {} training and {} held-out views, up to {w} × {h} pixels",
        results.version, results.device.info.name, results.protocol.train_views, results.protocol.test_views
    );
    let title = if name.is_empty() { "Training report".to_owned() } else { format!("{name}: training report") };
    page::page(&title, &subtitle, &sections)
}

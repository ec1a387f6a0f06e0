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

/// The page of a run with these pictures; `config` is the text of config.toml, `viewer` a page that draws the model.
pub fn page(results: &RunRecord, stacks: &[Stack], config: &str, viewer: Option<&str>) -> String {
    let mut sections = vec![
        Section::new("summary", "Summary", summary::body(results)),
        Section::new("pictures", "Pictures", pictures::body(results, stacks)),
        Section::new("quality", "Quality over time", quality::body(results)),
        Section::new("pruning", "Pruning", pruning::body(results)),
    ];
    sections.extend(blocks::section(&results.prunes));
    sections.extend([
        Section::new("time", "Time by stage", time::body(results)),
        Section::new("views", "Held-out views", details::views(results)),
        Section::new("protocol", "Protocol", details::protocol(results)),
        Section::new("effects", "Effects", details::effects(results)),
        Section::new("guards", "Guards", details::guards(results)),
        Section::new("memory", "Memory", details::memory(results)),
        Section::new("configuration", "Configuration", details::configuration(config)),
    ]);
    if let Some(viewer) = viewer {
        let frame = html! { iframe class="viewer" title="The model" allow="fullscreen" srcdoc=(viewer) {} };
        sections.insert(1, Section::new("model", "Model", frame));
    }
    let [w, h] = results.protocol.image_size;
    let subtitle = format!(
        "qirf-vk {} on {}; {} training and {} held-out views, up to {w} × {h} pixels",
        results.version, results.device.info.name, results.protocol.train_views, results.protocol.test_views
    );
    page::page("Training report", &subtitle, &sections)
}

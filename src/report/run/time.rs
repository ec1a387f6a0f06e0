//! Time by part of the run and by stage.

use crate::job::records::RunRecord;
use crate::report::format::{percent, seconds};
use crate::report::page::{absent, side_by_side};
use crate::report::plot::{Bar, bars};
use maud::{Markup, html};

pub fn body(results: &RunRecord) -> Markup {
    let t = &results.time;
    // The seconds of training include pruning and, in a resumed run, its earlier parts.
    let parts = [
        ("photos", t.load_s),
        ("start", t.start_s),
        ("training", (t.train_s - t.prune_s).max(0.0)),
        ("pruning", t.prune_s),
        ("quality curve", t.curve_s),
        ("evaluation", t.evaluate_s),
        ("files", t.write_s),
        ("pictures of this page", t.report_s),
    ];
    let known: f64 = parts.iter().map(|(_, s)| s).sum();
    let rest = ("other", (t.total_s - known).max(0.0));
    let whole: Vec<(&str, f64)> = parts.into_iter().chain([rest]).collect();
    let mut stages: Vec<(&str, f64)> = t.stages_s.iter().map(|(name, s)| (*name, *s)).collect();
    stages.sort_by(|a, b| b.1.total_cmp(&a.1));
    let device = if stages.is_empty() {
        html! {
            figure class="plot" { figcaption { "Training by stage" } (absent("This device has no timestamps.")) }
        }
    } else {
        bars("Training by stage, device time since the last start", &shares(&stages)).figure()
    };
    side_by_side(&[bars("The whole run", &shares(&whole)).figure(), device])
}

fn shares(named: &[(&str, f64)]) -> Vec<Bar> {
    let sum: f64 = named.iter().map(|(_, s)| s).sum();
    let text = |s: f64| format!("{}, {}", percent(s, sum), seconds(s));
    named.iter().map(|&(name, s)| Bar { name: name.to_owned(), value: s, text: text(s) }).collect()
}

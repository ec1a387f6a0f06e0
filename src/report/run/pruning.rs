//! Each prune: its counts, and statistics of its blocks.

use crate::job::records::{PruneRecord, PruneSeconds, RunRecord};
use crate::report::format::{count, decimals, percent, seconds, short};
use crate::report::page::{absent, facts, side_by_side};
use crate::report::plot::{Axis, Bar, Columns, bars};
use crate::train::method::Cut;
use maud::{Markup, html};

/// The cut that ended a method, in a sentence.
pub fn cut(cut: &Cut) -> String {
    let Cut { iteration, before, shown, after } = *cut;
    format!(
        "After iteration {}, the method would have kept {} of {} Gaussians; {} were kept.",
        count(iteration as usize),
        count(shown),
        count(before),
        count(after)
    )
}

pub fn body(results: &RunRecord) -> Markup {
    if let (Some(done), true) = (&results.cut, results.prunes.is_empty()) {
        return html! { p { (cut(done)) } };
    }
    if results.prunes.is_empty() {
        return absent("The model was not pruned.");
    }
    html! {
        @for (k, prune) in results.prunes.iter().enumerate() {
            @if results.prunes.len() > 1 {
                h3 { "Prune " (k + 1) " of " (results.prunes.len()) ", after iteration " (count(prune.iteration as usize)) }
            }
            (one(prune))
        }
    }
}

/// A prune's counts and times.
pub fn one(prune: &PruneRecord) -> Markup {
    let selector = prune.selector.name();
    let removed = prune.before.saturating_sub(prune.after);
    // A model that is not in training has no iterations.
    let iteration = (prune.iteration > 0).then(|| ("after iteration", count(prune.iteration as usize)));
    let mut known: Vec<(&str, String)> = iteration.into_iter().collect();
    known.extend([
        ("ranked by", selector.to_owned()),
        ("Gaussians before", count(prune.before)),
        ("kept", format!("{} ({})", count(prune.after), percent(prune.after as f64, prune.before as f64))),
        ("removed", count(removed)),
    ]);
    if let Some(pairs) = prune.pairs {
        known.push(("kept in place of several", count(pairs.clusters)));
        known.push(("merged into others", count(pairs.merged)));
        known.push(("dropped", count(pairs.dropped)));
        return html! { (facts(&known)) (side_by_side(&[times(&prune.seconds)])) };
    }
    known.extend([
        ("kept by the detail safeguard", count(prune.detail)),
        ("blocks", count(prune.blocks)),
        ("mean block size", decimals(prune.before as f64 / prune.blocks as f64, 1)),
        ("edge of the finest voxels", format!("{} world units", short(prune.voxel))),
    ]);
    if let Some(merged) = prune.merged {
        known.push(("blocks merged", format!("{}, {} left unchanged", count(merged.accepted), count(merged.refused))));
    }
    html! {
        (facts(&known))
        (side_by_side(&[kept_shares(prune), times(&prune.seconds)]))
    }
}

fn kept_shares(prune: &PruneRecord) -> Markup {
    let name = |bin: usize| (10 * bin).to_string();
    let bins: Vec<(String, f64)> = prune.kept_shares.iter().enumerate().map(|(b, n)| (name(b), *n as f64)).collect();
    let (x, y) = ("kept share of a block / %, lower end of each class", Axis::from_zero("blocks"));
    Columns { title: "Share kept", x, y, bins: &bins, spreads: &[], text: short }.draw()
}

fn times(s: &PruneSeconds) -> Markup {
    let named = [
        ("responses", s.responses),
        ("partition", s.study.partition),
        ("blocks, on device and host", s.study.wall),
        ("selection", s.select),
        ("merging and compaction", s.merge),
    ];
    // Selectors that form no blocks have no times of blocks.
    let taken = named.into_iter().filter(|(_, value)| *value > 0.0);
    let bar = |(name, value): (&str, f64)| Bar { name: name.to_owned(), value, text: seconds(value) };
    bars(&format!("Time of the prune: {}", seconds(s.total)), &taken.map(bar).collect::<Vec<_>>()).figure()
}

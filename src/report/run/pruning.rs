//! Each prune: its counts, and statistics of its blocks.

use crate::pipeline::records::{PruneRecord, PruneSeconds, RunRecord};
use crate::qirf::select::Selector;
use crate::report::format::{count, decimals, percent, seconds, short};
use crate::report::page::{absent, facts, side_by_side};
use crate::report::plot::{Axis, Bar, Columns, bars};
use crate::train::learnt_masks::MasksCut;
use maud::{Markup, html};

/// The cut at the end of learnt masks, in a sentence.
pub fn masks(cut: &MasksCut) -> String {
    let MasksCut { iteration, before, shown, after } = *cut;
    format!(
        "After iteration {}, learnt masks would have kept {} of {} Gaussians; {} were kept.",
        count(iteration as usize),
        count(shown),
        count(before),
        count(after)
    )
}

pub fn body(results: &RunRecord) -> Markup {
    if let (Some(cut), true) = (&results.masks, results.prunes.is_empty()) {
        return html! { p { (masks(cut)) } };
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

fn one(prune: &PruneRecord) -> Markup {
    let selector = Selector::NAMES.iter().find(|(s, _)| *s == prune.selector).map_or("", |(_, name)| name);
    let removed = prune.before.saturating_sub(prune.after);
    let mut known = vec![
        ("after iteration", count(prune.iteration as usize)),
        ("ranked by", selector.to_owned()),
        ("Gaussians before", count(prune.before)),
        ("kept", format!("{} ({})", count(prune.after), percent(prune.after as f64, prune.before as f64))),
        ("removed", count(removed)),
    ];
    if let Some(pairs) = prune.pairs {
        known.push(("kept in place of several", count(pairs.clusters)));
        known.push(("merged into others", count(pairs.merged)));
        known.push(("dropped", count(pairs.dropped)));
        return html! { (facts(&known)) (times(&prune.seconds)) };
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
        (side_by_side(&[occupancy(prune), kept_shares(prune), spectrum(prune), modes(prune), times(&prune.seconds)]))
    }
}

fn number(v: f64) -> String {
    short(v)
}

fn occupancy(prune: &PruneRecord) -> Markup {
    let name = |bin: usize| (1_usize << bin.min(40)).to_string();
    let bins: Vec<(String, f64)> = prune.occupancy.iter().enumerate().map(|(b, n)| (name(b), *n as f64)).collect();
    let (x, y) = ("Gaussians in a block: from this number up to the next", Axis::from_zero("blocks"));
    Columns { title: "Block occupancy", x, y, bins: &bins, text: number }.draw()
}

fn kept_shares(prune: &PruneRecord) -> Markup {
    let name = |bin: usize| format!("{}–{}", 10 * bin, 10 * bin + 10);
    let bins: Vec<(String, f64)> = prune.kept_shares.iter().enumerate().map(|(b, n)| (name(b), *n as f64)).collect();
    let (x, y) = ("share of a block that was kept / %", Axis::from_zero("blocks"));
    Columns { title: "Share kept", x, y, bins: &bins, text: number }.draw()
}

fn spectrum(prune: &PruneRecord) -> Markup {
    if prune.spectrum.iter().all(|l| *l == 0.0) {
        return html! { figure class="plot" { figcaption { "Eigenvalue spectrum" } (unsolved()) } };
    }
    let bins: Vec<(String, f64)> = prune.spectrum.iter().enumerate().map(|(k, l)| ((k + 1).to_string(), *l)).collect();
    let title = "Eigenvalue spectrum, mean over blocks";
    let (x, y) = ("eigenvalue, largest first", Axis::log("share of the block's sum"));
    let text = |l: f64| if l >= 0.001 { percent(l, 1.0) } else { short(l) };
    Columns { title, x, y, bins: &bins, text }.draw()
}

fn modes(prune: &PruneRecord) -> Markup {
    if prune.modes.iter().all(|n| *n == 0) {
        return html! { figure class="plot" { figcaption { "Modes" } (unsolved()) } };
    }
    let bins: Vec<(String, f64)> =
        prune.modes.iter().enumerate().map(|(k, n)| ((k + 1).to_string(), *n as f64)).collect();
    let (x, y) = ("eigenvalues that reach the energy threshold", Axis::from_zero("blocks"));
    Columns { title: "Modes", x, y, bins: &bins, text: number }.draw()
}

fn unsolved() -> Markup {
    absent("This selector does not solve an eigenproblem.")
}

fn times(s: &PruneSeconds) -> Markup {
    let named = [
        ("responses", s.responses),
        ("partition", s.partition),
        ("overlaps and solution", s.assemble_and_solve),
        ("selection", s.select),
        ("merging and compaction", s.merge),
    ];
    let bar = |(name, value): (&str, f64)| Bar { name: name.to_owned(), value, text: seconds(value) };
    bars(&format!("Time of the prune: {}", seconds(s.total)), &named.map(bar))
}

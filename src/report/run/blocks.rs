//! Statistics of each prune's blocks: their solver and sizes, the spectrum of their eigenproblems, and their kept
//! Gaussians.

use crate::job::records::{PruneRecord, PruneSeconds};
use crate::report::format::{count, decimals, seconds, short};
use crate::report::page::{Section, facts, side_by_side};
use crate::report::plot::{Axis, Bar, Columns, bars};
use maud::{Markup, html};

/// The section; prunes that formed no blocks are left out. None if no prune formed any.
pub fn section(prunes: &[PruneRecord]) -> Option<Section> {
    let of_blocks: Vec<&PruneRecord> = prunes.iter().filter(|prune| prune.blocks > 0).collect();
    (!of_blocks.is_empty()).then(|| Section("blocks", "What the blocks say", body(&of_blocks)))
}

fn body(of_blocks: &[&PruneRecord]) -> Markup {
    html! {
        p {
            "Neighbouring Gaussians form a block, in which they are a basis that is not orthogonal. A block's eigenvalues say how many "
            "independent directions its responses have: where few reach the energy threshold, few Gaussians can replace the block."
        }
        @for prune in of_blocks {
            @if of_blocks.len() > 1 { h3 { "Prune after iteration " (count(prune.iteration as usize)) } }
            (one(prune))
        }
    }
}

fn one(prune: &PruneRecord) -> Markup {
    let solver =
        prune.solver.map_or_else(|| "none: this selector reads no blocks".to_owned(), |solver| solver.to_string());
    let mut known = vec![
        ("solver", solver),
        ("blocks", count(prune.blocks)),
        ("mean block size", decimals(prune.before as f64 / prune.blocks as f64, 1)),
    ];
    if prune.solver.is_none() {
        return html! { (facts(&known)) (side_by_side(&[occupancy(prune)])) };
    }
    let solved: usize = prune.modes.iter().sum();
    let modes: usize = prune.modes.iter().zip(1..).map(|(blocks, r)| blocks * r).sum();
    known.push(("modes to reach the threshold, mean", decimals(modes as f64 / solved.max(1) as f64, 2)));
    let guards = &prune.guards;
    for (name, blocks) in [
        ("solved by a fallback", guards.fallback_blocks),
        ("of these, in canonical form", guards.canonical_blocks),
        ("without any response", guards.unseen_blocks),
    ] {
        if blocks > 0 {
            known.push((name, format!("{} blocks", count(blocks))));
        }
    }
    html! {
        (facts(&known))
        (side_by_side(&[occupancy(prune), spectrum(prune), modes_reached(prune), kept_by_rank(prune), times(&prune.seconds)]))
    }
}

fn occupancy(prune: &PruneRecord) -> Markup {
    let name = |bin: usize| (1_usize << bin.min(40)).to_string();
    let bins: Vec<(String, f64)> = prune.occupancy.iter().enumerate().map(|(b, n)| (name(b), *n as f64)).collect();
    let (x, y) = ("Gaussians in a block: from this number up to the next", Axis::from_zero("blocks"));
    Columns { title: "Sizes of blocks", x, y, bins: &bins, spreads: &[], text: short }.draw()
}

fn spectrum(prune: &PruneRecord) -> Markup {
    let percents = |shares: &[f64]| -> Vec<f64> { shares.iter().map(|l| 100.0 * l).collect() };
    let spectrum = percents(&prune.spectrum);
    let bins: Vec<(String, f64)> = spectrum.into_iter().enumerate().map(|(k, l)| ((k + 1).to_string(), l)).collect();
    let title = "Spectrum: share of a block's energy by mode, mean and standard deviation over blocks";
    let (x, y) = ("mode, largest first", Axis::log("share of the block's energy / %"));
    Columns { title, x, y, bins: &bins, spreads: &percents(&prune.spectrum_spread), text: two_digits }.draw()
}

/// A positive share in per cent, in two digits: 95, 7.0, 0.56 or 0.0021.
fn two_digits(percent: f64) -> String {
    if percent < 1e-4 {
        return "<0.0001".to_owned();
    }
    let places = (1.0 - percent.log10().floor()).clamp(0.0, 4.0);
    decimals(percent, places as usize)
}

fn modes_reached(prune: &PruneRecord) -> Markup {
    let bins: Vec<(String, f64)> =
        prune.modes.iter().enumerate().map(|(k, n)| ((k + 1).to_string(), *n as f64)).collect();
    let (x, y) = ("modes that reach the energy threshold", Axis::from_zero("blocks"));
    Columns { title: "Modes to reach the threshold", x, y, bins: &bins, spreads: &[], text: short }.draw()
}

fn kept_by_rank(prune: &PruneRecord) -> Markup {
    let share = |kept: usize, of: usize| 100.0 * kept as f64 / of.max(1) as f64;
    let bins: Vec<(String, f64)> =
        prune.effective_ranks.iter().map(|r| (r.rank.to_string(), share(r.kept, r.gaussians))).collect();
    let (x, y) = ("effective rank of the block", Axis::from_zero("share of its Gaussians that was kept / %"));
    Columns { title: "Share kept by effective rank", x, y, bins: &bins, spreads: &[], text: short }.draw()
}

fn times(s: &PruneSeconds) -> Markup {
    let named = [
        ("device: overlaps", s.study.overlap),
        ("device: response densities", s.study.rrdm),
        ("device: eigenproblems", s.study.participation),
        ("host: eigenproblems and subsets", s.study.solve),
        ("elapsed (device and host in parallel)", s.study.wall),
    ];
    let taken = named.into_iter().filter(|(_, value)| *value > 0.0);
    let bar = |(name, value): (&str, f64)| Bar { name: name.to_owned(), value, text: seconds(value) };
    bars("Time of the blocks", &taken.map(bar).collect::<Vec<_>>()).figure()
}

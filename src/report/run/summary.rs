//! The most important figures, as tiles.

use crate::job::records::{Counts, RunRecord, ViewScores};
use crate::report::format::{NONE, bytes, count, decimals, percent, seconds};
use crate::report::page::{Tile, tiles};
use maud::Markup;

pub fn body(results: &RunRecord) -> Markup {
    let test = results.test.as_ref();
    let decibels = |v: Option<f64>| match v {
        Some(v) => format!("{} dB", decimals(v, 2)),
        None => NONE.to_owned(),
    };
    let test_psnr = match test {
        Some(t) if t.psnr.is_none() => "∞".to_owned(),
        _ => decibels(test.and_then(|t| t.psnr)),
    };
    let views = match ViewScores::counting(&results.views) {
        0 if results.protocol.test_views > 0 => "masks hide all held-out views".to_owned(),
        0 => "no view was held out".to_owned(),
        1 => "one held-out view".to_owned(),
        n => format!("mean of {n} held-out views"),
    };
    tiles(&[
        ("PSNR", test_psnr, format!("on training views: {}", decibels(results.train.psnr))),
        ("SSIM", decimals(test.and_then(|t| t.ssim), 4), views),
        ("LPIPS", decimals(test.and_then(|t| t.lpips_vgg), 4), results.protocol.lpips.clone()),
        gaussians(results.gaussians, !results.prunes.is_empty()),
        ("Model", bytes(results.model_bytes), "model.ply".to_owned()),
        frames(results),
        ("Time", seconds(results.time.total_s), format!("training and pruning: {}", seconds(results.time.train_s))),
        (
            "Device",
            results.device.info.name.clone(),
            format!("{}; {}", results.device.info.kind, results.device.info.driver),
        ),
    ])
}

fn gaussians(n: Counts, is_pruned: bool) -> Tile {
    let note = match n.dense {
        Some(_) if !is_pruned => {
            n.initial.map_or("not pruned".to_owned(), |first| format!("from {} at the start; not pruned", count(first)))
        }
        Some(dense) => {
            let removed = dense.saturating_sub(n.last);
            format!("{} before pruning: {} removed", count(dense), percent(removed as f64, dense as f64))
        }
        None => String::new(),
    };
    ("Gaussians", count(n.last), note)
}

fn frames(results: &RunRecord) -> Tile {
    let now = results.frames_per_second;
    let places = |v: f64| decimals(v, usize::from(v < 99.5));
    let before = results.prunes.first().and_then(|p| p.frames_per_second_before);
    let note = match before {
        Some(before) if now.is_some() => format!("before pruning: {}", places(before)),
        _ => "rendering only, at the size of the views".to_owned(),
    };
    ("Frames per second", now.map_or(NONE.to_owned(), places), note)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussians_are_counted_from_the_prune_on() {
        let note = |is_pruned| gaussians(Counts { initial: Some(900), dense: Some(5000), last: 1400 }, is_pruned).2;
        assert_eq!(note(true), "5,000 before pruning: 72.0 % removed");
        assert_eq!(note(false), "from 900 at the start; not pruned");
    }
}

//! Tables and lists: views, protocol, effects, guards, memory, configuration.

use crate::job::records::{RunRecord, ViewScores};
use crate::metrics::Scores;
use crate::report::format::{NONE, bytes, count, decimals};
use crate::report::page::{Column, absent, facts, table};
use crate::scene::{Names, Skipped};
use maud::{Markup, html};

/// The scores of each held-out view.
pub fn views(results: &RunRecord) -> Markup {
    if results.views.is_empty() {
        return absent("No view was held out.");
    }
    let networks = ["LPIPS (VGG)", "LPIPS (VGG, normalised)", "LPIPS (AlexNet)"];
    let distances = |s: &Scores| [s.lpips_vgg, s.lpips_vgg_normalized, s.lpips_alex];
    let known = |k: &usize| results.views.iter().any(|v| distances(&v.scores)[*k].is_some());
    let lpips: Vec<usize> = (0..networks.len()).filter(known).collect();
    let row = |name: String, scores: &Scores| -> Vec<String> {
        // The PSNR of equal pictures is infinite.
        let equal = scores.psnr.is_none() && scores.counts();
        let psnr = if equal { "∞".to_owned() } else { decimals(scores.psnr, 2) };
        let others = lpips.iter().map(|k| decimals(distances(scores)[*k], 4));
        [name, psnr, decimals(scores.ssim, 4)].into_iter().chain(others).collect()
    };
    let mut columns = vec![Column::Text("view"), Column::Number("PSNR / dB"), Column::Number("SSIM")];
    columns.extend(lpips.iter().map(|k| Column::Number(networks[*k])));
    let rows: Vec<Vec<String>> = results.views.iter().map(|v| row(v.name.clone(), &v.scores)).collect();
    let mean = results.test.as_ref().map(|t| row(format!("mean of {}", ViewScores::counting(&results.views)), t));
    let notes = results.test.iter().flat_map(|t| &t.notes);
    html! {
        (table(&columns, &rows, mean.as_deref()))
        @for note in notes { p class="hint" { (note) } }
    }
}

/// Conditions of the scores.
pub fn protocol(results: &RunRecord) -> Markup {
    let p = &results.protocol;
    let [w, h] = p.image_size;
    let number = |n: Option<u32>| n.map_or(NONE.to_owned(), |n| count(n as usize));
    facts(&[
        ("held out", p.test_split.clone()),
        ("training views", count(p.train_views)),
        ("held-out views", count(p.test_views)),
        ("largest picture", format!("{w} × {h} pixels")),
        ("photos", p.downscaling.to_owned()),
        ("background", p.background.map(|c| decimals(f64::from(c), 2)).join(", ")),
        ("LPIPS", p.lpips.clone()),
        ("scores", "on pictures rounded to 8 bits".to_owned()),
        ("iterations", number(p.iterations)),
        ("seed", p.seed.map_or(NONE.to_owned(), |n| n.to_string())),
        (
            "device",
            format!(
                "{} ({}), Vulkan {}",
                results.device.info.name, results.device.info.driver, results.device.info.api
            ),
        ),
        ("program", format!("qirf-vk {}", results.version)),
    ])
}

/// The decision on each effect, with the evidence.
pub fn effects(results: &RunRecord) -> Markup {
    if results.effects.is_empty() {
        return absent("No effect was decided on.");
    }
    let rows: Vec<Vec<String>> = results
        .effects
        .iter()
        .map(|d| {
            let state = if d.on { "on" } else { "off" };
            let by = if d.forced { ", not decided by the scene" } else { "" };
            let near = if d.near_threshold { "; near its threshold" } else { "" };
            vec![d.name.name().to_owned(), format!("{state}{by}"), d.evidence.clone() + near]
        })
        .collect();
    table(&[Column::Text("effect"), Column::Text("in use"), Column::Text("evidence")], &rows, None)
}

fn some(n: usize) -> String {
    if n == 0 { "none".to_owned() } else { count(n) }
}

fn row(what: &str, n: usize, which: String) -> Vec<String> {
    vec![what.to_owned(), some(n), which]
}

/// Parts of the scene that are not used as they are.
fn skipped(scene: &Skipped) -> Vec<Vec<String>> {
    // No `..`: the compiler asks for the row of a new field.
    let Skipped {
        missing_images,
        mismatched_images,
        turned_images,
        damaged_images,
        unread_images,
        bad_poses,
        mirrored_poses,
        repeated_views,
        unposed_images,
        missing_masks,
        damaged_masks,
        missing_depths,
        bad_points,
        repeated_points,
        track_entries,
        notes: _,
        choices: _,
    } = scene;
    let named = [
        ("missing photos", missing_images),
        ("photos whose shape differs from their camera's", mismatched_images),
        ("of these, photos turned by 90°", turned_images),
        ("damaged photos", damaged_images),
        ("photos not read", unread_images),
        ("views without a usable pose", bad_poses),
        ("views whose pose is mirrored", mirrored_poses),
        ("views listed twice", repeated_views),
        ("photos without a pose", unposed_images),
        ("missing masks", missing_masks),
        ("masks that cannot be used", damaged_masks),
        ("missing depth maps", missing_depths),
    ];
    let counts = [
        ("points that are not finite", bad_points),
        ("points merged with others close to them", repeated_points),
        ("track entries without a view", track_entries),
    ];
    let named = named.map(|(what, names): (_, &Names)| {
        let more = if names.count > names.examples.len() { ", …" } else { "" };
        row(what, names.count, names.examples.join(", ") + more)
    });
    named.into_iter().chain(counts.map(|(what, n)| row(what, *n, String::new()))).collect()
}

/// Counts of repaired, skipped and omitted values, and the notes and choices on the scene.
pub fn guards(results: &RunRecord) -> Markup {
    let g = &results.guards;
    let plain = |what: &str, n: usize| row(what, n, String::new());
    let mut rows = skipped(&g.scene);
    rows.extend([
        plain("updates skipped because a gradient was not finite", g.skipped_rows as usize),
        plain("Gaussians that pictures leave out: no rotation, not finite, or of e^30 units and more", g.undrawable),
        plain("held-out views that rendered empty", g.empty_views),
    ]);
    for (k, prune) in results.prunes.iter().enumerate() {
        let which = if results.prunes.len() > 1 { format!("prune {}", k + 1) } else { String::new() };
        let mut add = |what: &str, n: usize| rows.push(row(what, n, which.clone()));
        add("blocks whose Gram matrix was not positive definite", prune.guards.canonical_blocks);
        add("blocks without any response", prune.guards.unseen_blocks);
        add("overlaps and responses that were not finite", prune.guards.repaired_values);
    }
    let columns = [Column::Text("repaired, skipped or left out"), Column::Number("count"), Column::Text("which")];
    html! {
        (table(&columns, &rows, None))
        @for note in g.scene.notes.iter().chain(&g.scene.choices) { p class="hint" { (note) } }
    }
}

pub fn memory(results: &RunRecord) -> Markup {
    let m = results.memory;
    facts(&[
        ("peak", bytes(m.peak_bytes)),
        ("estimate before the start", bytes(m.estimated_bytes)),
        ("limit", bytes(m.limit_bytes)),
    ])
}

/// The configuration that reproduces the run.
pub fn configuration(config: &str) -> Markup {
    if config.is_empty() {
        return absent("config.toml is missing.");
    }
    html! {
        details {
            summary { "config.toml: qirf-vk run --config config.toml -o FOLDER reproduces this run" }
            pre { (config) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_that_is_left_out_has_a_row() {
        let names = |count| Names { count, examples: vec!["a.png".to_owned()], last: None };
        let scene = Skipped {
            missing_images: names(1),
            mismatched_images: names(2),
            turned_images: names(3),
            damaged_images: names(4),
            unread_images: names(5),
            bad_poses: names(6),
            mirrored_poses: names(7),
            repeated_views: names(8),
            unposed_images: names(9),
            missing_masks: names(10),
            damaged_masks: names(11),
            missing_depths: names(12),
            bad_points: 13,
            repeated_points: 14,
            track_entries: 15,
            notes: Vec::new(),
            choices: Vec::new(),
        };
        let rows = skipped(&scene);
        let counts: Vec<String> = (1..=15).map(count).collect();
        assert_eq!(rows.iter().map(|row| row[1].clone()).collect::<Vec<_>>(), counts);
        assert_eq!([&rows[0][2], &rows[11][2], &rows[12][2]], ["a.png", "a.png, …", ""]);
    }
}

//! The page of a compression: its figures, the held-out views, its time, and statistics of the blocks.

use super::format::{NONE, bytes, count, decimals, percent, seconds};
use super::page::Column::{self, Number, Text};
use super::page::{self, Said, Section, absent, facts, list, side_by_side, table, tiles};
use super::plot::{Bar, bars};
use super::run::{blocks, pruning};
use crate::job::records::{Aim, AimRecord, CompressRecord, Point, StageScores, Truth};
use crate::metrics::Scores;
use maud::{Markup, html};
use std::slice::from_ref;

/// A stage's name and its scores.
type Stage = (&'static str, fn(&StageScores) -> &Option<Scores>);

const STAGES: [Stage; 4] =
    [("before", |s| &s.before), ("pruned", |s| &s.pruned), ("fine-tuned", |s| &s.fine_tuned), ("file", |s| &s.written)];

/// The whole page.
pub fn page(record: &CompressRecord) -> String {
    let mut sections = vec![
        Section("summary", "Summary", summary(record)),
        Section("views", "Held-out views", views(record)),
        Section("pruning", "Pruning", pruning::one(&record.prune)),
    ];
    sections.extend(blocks::section(from_ref(&record.prune)));
    sections.push(Section("time", "Time", time(record)));
    if let Some(aim) = &record.aim {
        sections.insert(1, Section("search", "Search", search(aim)));
    }
    let truth = match record.protocol.truth {
        Truth::Photos => "photos",
        Truth::OwnPictures => "the original's own pictures",
    };
    let [w, h] = record.protocol.image_size;
    let subtitle = format!(
        "qirf-vk {} on {}; {} views for the choice, {} held out, up to {w} × {h} pixels, against {truth}",
        record.version, record.device.info.name, record.protocol.train_views, record.protocol.test_views
    );
    page::page("Compression report", &subtitle, &sections)
}

fn decibels(scores: Option<&Scores>) -> String {
    match scores {
        Some(Scores { psnr: Some(psnr), .. }) => format!("{} dB", decimals(*psnr, 2)),
        Some(_) => "∞".to_owned(),
        None => NONE.to_owned(),
    }
}

fn summary(record: &CompressRecord) -> Markup {
    let CompressRecord { input, output, test, time, .. } = record;
    let last = STAGES.iter().rev().find(|(_, of)| of(test).is_some());
    let (stage, scores) = last.map_or(("", None), |(name, of)| (*name, of(test).as_ref()));
    let of_what = match stage {
        "" => "no view was held out",
        "file" => "of the written file",
        "before" => "of the original",
        "pruned" => "of the pruned model",
        _ => "of the fine-tuned model",
    };
    let removed = input.gaussians.saturating_sub(output.gaussians);
    tiles(&[
        ("PSNR", decibels(scores), of_what.to_owned()),
        ("SSIM", decimals(scores.and_then(|s| s.ssim), 4), of_what.to_owned()),
        (
            "Gaussians",
            count(output.gaussians),
            format!("of {}: {} removed", count(input.gaussians), percent(removed as f64, input.gaussians as f64)),
        ),
        ("File", bytes(output.bytes), format!("of {}", bytes(input.bytes))),
        ("Time", seconds(time.total_s), format!("responses {}", seconds(time.responses_s))),
        ("Device", record.device.info.name.clone(), record.device.info.driver.clone()),
    ])
}

/// The parts of a compression's time with their names, without those that took none. The last one is what the others leave of the total:
/// reading, packing and writing files, and a search for a file.
pub fn parts(record: &CompressRecord) -> Vec<(&'static str, f64)> {
    let time = &record.time;
    let truth = match record.protocol.truth {
        Truth::Photos => "photos",
        Truth::OwnPictures => "pictures of the original",
    };
    // A search merges anew for every file that it tries.
    let (choice, rest) = match record.aim {
        None => (time.keep_mask_s + time.merge_s, "files"),
        Some(_) => (0.0, "search and files"),
    };
    let mut parts = vec![
        (truth, time.truth_s),
        ("responses", time.responses_s),
        ("choice and merging", choice),
        ("fine-tuning", time.fine_tune_s),
        ("scores", time.evaluate_s),
    ];
    let known: f64 = parts.iter().map(|(_, s)| s).sum();
    parts.push((rest, (time.total_s - known).max(0.0)));
    parts.retain(|(_, s)| *s > 0.0);
    parts
}

fn time(record: &CompressRecord) -> Markup {
    let bar = |(name, value): (&str, f64)| Bar { name: name.to_owned(), value, text: seconds(value) };
    let all: Vec<Bar> = parts(record).into_iter().map(bar).collect();
    side_by_side(&[bars(&format!("The whole compression: {}", seconds(record.time.total_s)), &all).figure()])
}

/// The target, the choice and the files tried.
fn search(record: &AimRecord) -> Markup {
    let AimRecord { aim, original, chosen, rungs, tried, .. } = record;
    let asked = match aim {
        Aim::Bytes(size) => format!("at most {}", bytes(*size)),
        Aim::Psnr(psnr) => format!("at least {} dB", decimals(*psnr, 2)),
    };
    let psnr = |point: &Point| match point.psnr {
        Some(psnr) if psnr.is_infinite() => "equal".to_owned(),
        psnr => decimals(psnr, 2),
    };
    let columns: [Said<'_, Point>; 5] = [
        (Number("rung"), &|point| point.rung.to_string()),
        (Number("Gaussians"), &|point| count(point.gaussians)),
        (Number("file"), &|point| bytes(point.bytes)),
        (Number("PSNR / dB"), &psnr),
        (Text("chosen"), &|point| if point == chosen { "yes" } else { "" }.to_owned()),
    ];
    if *original {
        return html! {
            (facts(&[("target", asked)]))
            p { "The input already has this format and is no larger: its own bytes were written." }
        };
    }
    html! {
        (facts(&[("target", asked), ("files tried", count(tried.len())), ("rungs of the format", count(*rungs))]))
        p { "A rung is a setting of the format; 0 is the coarsest. PSNR is that of the views by which files are compared." }
        (list(tried, &columns))
    }
}

fn views(record: &CompressRecord) -> Markup {
    if record.views.is_empty() {
        return absent("No view was held out.");
    }
    let row = |name: &str, scores: &StageScores| -> Vec<String> {
        std::iter::once(name.to_owned()).chain(STAGES.iter().map(|(_, of)| decibels(of(scores).as_ref()))).collect()
    };
    let rows: Vec<Vec<String>> = record.views.iter().map(|view| row(&view.name, &view.scores)).collect();
    let columns: Vec<Column<'_>> =
        std::iter::once(Text("view")).chain(STAGES.iter().map(|(name, _)| Number(name))).collect();
    let both = format!("qirf-vk view {} --against {}", record.output.path.display(), record.input.path.display());
    html! {
        (table(&columns, &rows, Some(&row("mean", &record.test))))
        p class="hint" { "Pictures of both models, with a slider between them: " code { (both) } }
    }
}

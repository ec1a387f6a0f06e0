//! The page of a curve: quality against bytes.

use super::format::{NONE, bytes, count, decimals};
use super::page::Column::{self, Number, Text};
use super::page::{self, Section, list, table};
use super::plot::{Axis, Drawing, Line, Lines};
use crate::job::records::{CurveRecord, FileRecord};
use crate::metrics::Scores;
use crate::wording::counted;
use maud::Markup;

/// The whole page.
pub fn page(record: &CurveRecord) -> String {
    let name = |file: &FileRecord| format!("{}, {}", file.tool, file.format);
    let plot = drawing(&record.files, &name, "PSNR of the held-out views").figure();
    let mut sections = vec![Section("plot", "PSNR against bytes", plot), Section("files", "Files", files(record))];
    if record.files.iter().any(|file| !file.parts.is_empty()) {
        sections.push(Section("parts", "Where the bytes are", parts(record)));
    }
    if !record.attributes.is_empty() {
        sections.push(Section("attributes", "Loss from each attribute alone", attributes(record)));
    }
    let [w, h] = record.protocol.image_size;
    let subtitle = format!(
        "qirf-vk {} on {}; {} of {} Gaussians; {} of up to {w} × {h} pixels",
        record.version,
        record.device.info.name,
        record.input.path.display(),
        count(record.input.gaussians),
        counted(record.protocol.test_views, "held-out view"),
    );
    page::page("Quality against bytes", &subtitle, &sections)
}

/// The plot: one line for all files of the same name.
pub fn drawing(files: &[FileRecord], name: &dyn Fn(&FileRecord) -> String, title: &str) -> Drawing {
    let mut names: Vec<String> = files.iter().map(name).collect();
    names.sort();
    names.dedup();
    // The unit that tables have.
    let small = files.iter().all(|file| file.bytes < 1_000_000);
    let (unit, title_of_x) = if small { (1e3, "file / kB") } else { (1e6, "file / MB") };
    let points = |line: &String| {
        let mut points: Vec<[f64; 2]> = files
            .iter()
            .filter(|file| name(file) == *line)
            .filter_map(|file| Some([file.bytes as f64 / unit, psnr(&file.scores)?]))
            .collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        points
    };
    let lines = names.iter().map(|line| Line { name: line, points: points(line) }).collect();
    let (x, y) = (Axis::log(title_of_x), Axis::new("PSNR / dB"));
    Lines { title, x, y, lines, marks: Vec::new() }.drawing()
}

/// PSNR in dB, infinite if no pixel differs; none without scores.
fn psnr(scores: &Scores) -> Option<f64> {
    scores.psnr.or(scores.counts().then_some(f64::INFINITY))
}

fn files(record: &CurveRecord) -> Markup {
    let told = |file: &FileRecord| match psnr(&file.scores) {
        Some(psnr) if psnr.is_infinite() => "equal".to_owned(),
        psnr => decimals(psnr, 2),
    };
    list(
        &record.files,
        &[
            // With hyphens at which lines do not break.
            (Text("tool"), &|file| file.tool.replace('-', "\u{2011}")),
            (Text("format"), &|file| file.format.clone()),
            (Number("target size"), &|file| file.wanted.map_or_else(|| NONE.to_owned(), bytes)),
            (Number("file size"), &|file| bytes(file.bytes)),
            (Number("Gaussians"), &|file| count(file.gaussians)),
            (Number("PSNR / dB"), &told),
            (Number("SSIM"), &|file| decimals(file.scores.ssim, 4)),
            (Number("LPIPS"), &|file| decimals(file.scores.lpips_vgg, 4)),
        ],
    )
}

fn parts(record: &CurveRecord) -> Markup {
    let mut names: Vec<&str> = Vec::new();
    let with: Vec<&FileRecord> = record.files.iter().filter(|file| !file.parts.is_empty()).collect();
    for (name, _) in with.iter().flat_map(|file| &file.parts) {
        if !names.contains(name) {
            names.push(name);
        }
    }
    let columns: Vec<Column<'_>> =
        [Text("format"), Number("file size")].into_iter().chain(names.iter().map(|name| Number(name))).collect();
    let row = |file: &&FileRecord| {
        let part = |name: &&str| {
            let part = file.parts.iter().find(|(known, _)| known == name);
            part.map_or_else(|| NONE.to_owned(), |(_, bytes)| decimals(*bytes as f64 / file.gaussians.max(1) as f64, 2))
        };
        [file.format.clone(), bytes(file.bytes)].into_iter().chain(names.iter().map(part)).collect()
    };
    maud::html! {
        p { "Bytes per Gaussian, by attribute." }
        (table(&columns, &with.iter().map(row).collect::<Vec<Vec<String>>>(), None))
    }
}

fn attributes(record: &CurveRecord) -> Markup {
    list(
        &record.attributes,
        &[
            (Text("format"), &|loss| loss.format.clone()),
            (Number("settings of"), &|loss| bytes(loss.wanted)),
            (Text("attribute"), &|loss| loss.attribute.to_owned()),
            (Number("PSNR / dB"), &|loss| loss.psnr.map_or_else(|| "equal".to_owned(), |psnr| decimals(psnr, 1))),
        ],
    )
}

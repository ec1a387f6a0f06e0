//! `compare.html`: arms side by side in figures, in pictures, and in the crops where they differ most.

use super::{Arm, ArmRecord, CompareRecord};
use crate::pipeline::evaluate::exhibits::exhibits;
use crate::report::cut;
use crate::report::format::{bytes, count, decimals, percent, seconds, short};
use crate::report::page::Column::{Number, Text};
use crate::report::page::{self, Section, absent, list, side_by_side};
use crate::report::picture::{data_uri, read};
use crate::report::plot::{Axis, Bar, Front, Point, bars};
use crate::report::slider::{Layer, Stack, compare};
use image::RgbImage;
use image::imageops::{FilterType, crop_imm, resize};
use maud::{Markup, html};
use std::path::Path;

/// Size of a picture relative to its crop, and magnification of the crop on the page.
const PARTS: u32 = 4;
const MAGNIFIED: u32 = 3;

/// One view: its photo, and the picture of each arm.
struct View {
    name: String,
    note: String,
    pictures: Vec<Option<RgbImage>>,
}

/// The page of a comparison with its arms in `folder`; missing pictures are left out.
pub fn page(compared: &CompareRecord, folder: &Path) -> String {
    let views = views(compared, folder);
    let choices: Vec<&str> =
        std::iter::once("ground truth").chain(compared.arms.iter().map(|a| a.name.as_str())).collect();
    let sections = [
        Section("figures", "Figures", figures(compared)),
        Section("plots", "Cost of pruning", plots(compared)),
        Section("pictures", "Pictures", pictures(&choices, &views, |view| view.stack(None))),
        Section("crops", "Where arms differ most", pictures(&choices, &views, View::crop)),
    ];
    let subtitle = format!(
        "{}: {} Gaussians at iteration {}; each arm trained on to iteration {} with the same seed and loss; qirf-vk {} on {}",
        compared.scene,
        count(compared.gaussians),
        compared.prune_point,
        compared.iterations,
        compared.version,
        compared.device.info.name
    );
    page::page("Comparison of pruning methods", &subtitle, &sections)
}

fn figures(compared: &CompareRecord) -> Markup {
    let table = list(
        &compared.arms,
        &[
            (Text("arm"), &|a| a.name.clone()),
            (Number("PSNR / dB"), &|a| decimals(a.psnr, 2)),
            (Number("deviation / dB"), &|a| decimals(a.psnr_spread, 2)),
            (Number("difference / dB"), &|a| a.paired.map_or_else(String::new, |p| p.to_string())),
            (Number("SSIM"), &|a| decimals(a.ssim, 4)),
            (Number("LPIPS"), &|a| decimals(a.lpips_vgg, 4)),
            (Number("after the prune / dB"), &|a| decimals(a.psnr_pruned, 2)),
            (Number("Gaussians"), &|a| count(a.gaussians)),
            (Number("removed"), &|a| percent(a.removed, 1.0)),
            (Number("PLY"), &|a| bytes(a.ply_bytes)),
            (Number("frames/s"), &|a| decimals(a.fps, 1)),
            (Number("time"), &|a| seconds(a.seconds)),
        ],
    );
    html! {
        (table)
        @if let Some(first) = compared.arms.first().filter(|_| compared.arms.iter().any(|a| a.paired.is_some())) {
            p {
                "Difference: mean PSNR minus that of " (first.name) ", over the same views with the same seeds, ± its standard error \
                 (the larger of those over views and over seeds). An arm counts as different only if its difference exceeds Student's t (95 %) times the \
                 standard error, over views and, with several seeds, also over seeds. Otherwise the arms tie."
                @if compared.seeds.len() < 2 {
                    " Only one seed was trained: differences are over views only; another seed may differ."
                }
            }
        }
        @for (name, done) in compared.arms.iter().filter_map(|a| Some((&a.name, a.cut.as_ref()?))) {
            p { (name) ": " (cut(done)) }
        }
    }
}

fn plots(compared: &CompareRecord) -> Markup {
    let arms = &compared.arms;
    let best = arms.iter().filter_map(|a| a.psnr).fold(f64::NEG_INFINITY, f64::max);
    let lost = |a: &ArmRecord| {
        let value = best - a.psnr?;
        Some(Bar { name: a.name.clone(), value, text: decimals(value, 2) })
    };
    let point = |a: &ArmRecord| {
        let (fps, psnr) = (a.fps?, a.psnr?);
        let (label, told) = (a.name.clone(), format!("{}: {}, {}", a.name, short(fps), short(psnr)));
        Some(Point { label, told, at: [fps, psnr], spread: [fps; 2], front: false, default: false })
    };
    let speed = Front {
        title: "Quality and speed",
        x: Axis::new("frames/s"),
        y: Axis::new("PSNR / dB"),
        legend: &[],
        points: arms.iter().filter_map(point).collect(),
    };
    let lost: Vec<Bar> = arms.iter().filter_map(lost).collect();
    if lost.is_empty() {
        return absent("No view was held out, so quality was not measured.");
    }
    side_by_side(&[bars("PSNR lost compared with the best arm / dB", &lost).figure(), speed.drawing().figure()])
}

fn pictures(choices: &[&str], views: &[View], stack: impl Fn(&View) -> Option<Stack>) -> Markup {
    let stacks: Vec<Stack> = views.iter().filter_map(stack).collect();
    if stacks.is_empty() {
        return absent("There are no pictures to compare.");
    }
    html! { (compare(choices, [0, 1], &stacks)) }
}

fn views(compared: &CompareRecord, folder: &Path) -> Vec<View> {
    let Some(first) = compared.arms.first() else { return Vec::new() };
    let names: Vec<&str> = first.views.iter().map(|v| v.name.as_str()).collect();
    // Pictures of the first seed.
    let folder = match compared.seeds.first() {
        Some(seed) if compared.by_seed() => folder.join(CompareRecord::folder_of(*seed)),
        _ => folder.to_owned(),
    };
    let renders = |arm: &ArmRecord| folder.join("arms").join(Arm::folder(&arm.name)).join("renders");
    let view = |exhibit: crate::pipeline::evaluate::exhibits::Exhibit| {
        let photo = read(&renders(first).join(&exhibit.photo));
        let arms = compared.arms.iter().map(|arm| read(&renders(arm).join(&exhibit.last)));
        let score = |a: &ArmRecord| {
            let psnr = a.views.get(exhibit.view).and_then(|v| v.scores.psnr);
            format!("{} {}", a.name, decimals(psnr, 2))
        };
        let of_seed = compared.seeds.first().filter(|_| compared.by_seed());
        let of_seed = of_seed.map_or_else(String::new, |seed| format!(" with seed {seed}"));
        let note = format!(
            "PSNR / dB of the whole view{of_seed}: {}",
            compared.arms.iter().map(score).collect::<Vec<_>>().join(", ")
        );
        View { name: exhibit.name, note, pictures: std::iter::once(photo).chain(arms).collect() }
    };
    exhibits(&names).into_iter().map(view).collect()
}

impl View {
    /// All its pictures, or the same crop of each: left, top, width and height.
    fn stack(&self, part: Option<[u32; 4]>) -> Option<Stack> {
        let whole = self.pictures.iter().flatten().next()?.dimensions();
        let cut = |picture: &RgbImage| match part {
            None => picture.clone(),
            Some([x, y, w, h]) => {
                let cut = crop_imm(picture, x, y, w, h).to_image();
                resize(&cut, w * MAGNIFIED, h * MAGNIFIED, FilterType::Nearest)
            }
        };
        let size = part.map_or(whole.into(), |[_, _, w, h]| [w * MAGNIFIED, h * MAGNIFIED]);
        let layer = |(choice, picture): (usize, &Option<RgbImage>)| {
            let picture = picture.as_ref().filter(|p| p.dimensions() == whole)?;
            Some(Layer { choice, uri: data_uri(&cut(picture))? })
        };
        let layers = self.pictures.iter().enumerate().filter_map(layer).collect();
        Some(Stack { name: self.name.clone(), note: self.note.clone(), size, layers })
    }

    /// The crop, a quarter of the width and height, in which the arms differ most.
    fn crop(&self) -> Option<Stack> {
        let arms: Vec<&RgbImage> = self.pictures.iter().skip(1).flatten().collect();
        let (width, height) = arms.first()?.dimensions();
        let [w, h] = [width, height].map(|side| (side / PARTS).max(1));
        let arms: Vec<_> = arms.into_iter().filter(|a| a.dimensions() == (width, height)).collect();
        // Range over the arms at a pixel: largest minus smallest value, summed over the colours.
        let spread = |x: u32, y: u32| -> u64 {
            let range = |c: usize| {
                let values = arms.iter().map(|a| a.get_pixel(x, y).0[c]);
                u64::from(values.clone().max().unwrap_or(0) - values.min().unwrap_or(0))
            };
            (0..3).map(range).sum()
        };
        let sum = |left: u32, top: u32| -> u64 {
            (top..top + h).flat_map(|y| (left..left + w).map(move |x| (x, y))).map(|(x, y)| spread(x, y)).sum()
        };
        let places = |side: u32, part: u32| (0..=side - part).step_by((part / 2).max(1) as usize);
        let corners = places(height, h).flat_map(|y| places(width, w).map(move |x| [x, y]));
        let [x, y] = corners.max_by_key(|[x, y]| sum(*x, *y))?;
        self.stack(Some([x, y, w, h]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_are_where_arms_differ() {
        let plain = RgbImage::from_pixel(64, 40, image::Rgb([90; 3]));
        let mut spotted = plain.clone();
        spotted.put_pixel(50, 33, image::Rgb([255; 3]));
        let view = View { name: "v".into(), note: String::new(), pictures: vec![None, Some(plain), Some(spotted)] };
        let stack = view.crop().unwrap();
        assert_eq!((stack.size, stack.layers.len()), ([48, 30], 2));
        assert_ne!(stack.layers[0].uri, stack.layers[1].uri, "the spot is in it");
        let empty = View { name: "v".into(), note: String::new(), pictures: vec![None, None] };
        assert!(empty.crop().is_none() && empty.stack(None).is_none());
    }
}

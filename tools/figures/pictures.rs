//! Frames, iterations, their cost by pixels and pairs, and culling.

use super::bound::{Bound, Rates};
use super::fit::Fit;
use super::measured::{Bench, Measured};
use super::tables::{AGAINST, against, digits, short_ratio, table, time};
use qirf_vk::render::STAGES;
use qirf_vk::report::format::{count, decimals, percent};
use qirf_vk::report::plot::{Axis, Bar, Line, Lines, bars, sheet};
use qirf_vk::train;

const WHOLE: &str = "whole, by the host's clock";
/// Gaussians of the frames, as the benchmarks name them.
const FRAMES: [&str; 3] = ["10k", "100k", "500k"];
const ITERATION: &str = "10k";
/// Target of an iteration in milliseconds.
const TARGET: f64 = 50.0;

/// The timed stages of a group with their bounds; none without device timestamps.
fn stages<'a>(
    bench: &'a Bench,
    rates: &Rates,
    group: &str,
    of: &str,
) -> Vec<(&'static str, &'a Measured, Option<Bound>)> {
    let timed = |stage| {
        let m = bench.get(&format!("{group}/{stage}/{of}")).ok()?;
        Some((stage, m, rates.bound(m)))
    };
    train::STAGES.into_iter().filter_map(timed).collect()
}

/// The whole; its stages run one after another, so its bound is the sum of theirs.
fn whole<'a>(
    bench: &'a Bench,
    rates: &Rates,
    group: &str,
    of: &str,
    stages: &[(&str, &Measured, Option<Bound>)],
) -> Result<(&'a Measured, Option<Bound>), String> {
    let m = bench.get(&format!("{group}/{WHOLE}/{of}"))?;
    let sum = stages.iter().filter_map(|(_, _, b)| b.map(|b| b.ms)).sum::<f64>();
    let bound = if stages.is_empty() { rates.bound(m) } else { Some(Bound { ms: sum, by: "both" }) };
    Ok((m, bound))
}

fn number(m: &Measured, name: &str) -> String {
    count(m.number(name) as usize)
}

/// Time of one picture by stage.
pub fn frame(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let mut rows = Vec::new();
    for of in FRAMES {
        let stages = stages(bench, &rates, "frame", of);
        let (all, bound) = whole(bench, &rates, "frame", of, &stages)?;
        let mut what = format!("{} ({} pairs)", number(all, "gaussians"), number(all, "pairs"));
        for (stage, m, bound) in stages.iter().copied().chain([(WHOLE, all, bound)]) {
            rows.push([vec![std::mem::take(&mut what), stage.to_owned()], against(m, bound).to_vec()].concat());
        }
    }
    let columns = [&["Gaussians", "stage"][..], &AGAINST].concat();
    Ok(format!(
        "{}\n![Milliseconds by stage against the number of Gaussians](figures/frame.svg)\n",
        table(&columns, 2, &rows)
    ))
}

/// Time by stage against the number of Gaussians.
pub fn frame_plot(bench: &Bench) -> String {
    let mut lines: Vec<Line<'_>> = Vec::new();
    for name in STAGES.into_iter().chain([WHOLE]) {
        let points = FRAMES.iter().filter_map(|of| bench.get(&format!("frame/{name}/{of}")).ok());
        let points: Vec<[f64; 2]> = points.map(|m| [m.number("gaussians"), m.ms[1]]).collect();
        if !points.is_empty() {
            lines.push(Line { name: if name == WHOLE { "whole" } else { name }, points });
        }
    }
    let (x, y) = (Axis::log("Gaussians"), Axis::log("ms, median"));
    let plot = Lines { title: "A picture of 1280 x 720, by stage", x, y, lines, marks: Vec::new() };
    sheet(plot.title, &[plot.drawing()], 1)
}

/// The points of an axis of the group `cost`, by rising pixels and pairs.
fn points<'a>(bench: &'a Bench, axis: &str) -> Vec<&'a Measured> {
    let of = |m: &Measured| (m.number("pixels"), m.number("pairs"));
    let mut all: Vec<&Measured> =
        bench.group("cost").filter(|(name, _)| name.split('/').next() == Some(axis)).map(|(_, m)| m).collect();
    all.sort_by(|a, b| of(a).partial_cmp(&of(b)).unwrap_or(std::cmp::Ordering::Equal));
    all
}

fn column(points: &[&Measured], name: &str) -> Vec<f64> {
    points.iter().map(|m| 1e-6 * m.number(name)).collect()
}

/// The smallest times: whatever else the machine does only adds to them.
fn least(points: &[&Measured]) -> Vec<f64> {
    points.iter().map(|m| m.ms[0]).collect()
}

/// A straight line through the points of an axis.
fn line(points: &[&Measured], axis: &str) -> Result<Fit, String> {
    let fit = Fit::of(&[&column(points, axis)], &least(points));
    fit.ok_or_else(|| {
        format!("group 'cost/{axis}' was not measured at two sizes or more; run all groups: make figures")
    })
}

/// Time against pixels and against pairs.
pub fn cost(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let mut out = String::new();
    let (mut rows, mut fits) = (Vec::new(), Vec::new());
    let mut all = Vec::new();
    for (axis, other) in [("pixels", "pairs"), ("pairs", "pixels")] {
        let points = points(bench, axis);
        let fit = line(&points, axis)?;
        let (values, others) = (column(&points, axis), column(&points, other));
        let range =
            |v: &[f64]| v.iter().fold(0.0_f64, |m, v| m.max(*v)) / v.iter().fold(f64::INFINITY, |m, v| m.min(*v));
        let held = match range(&others) {
            r if r < 1.0005 => format!("{other} constant"),
            r => format!("{other} within {} %", short_ratio(100.0 * (r - 1.0))),
        };
        let what = format!("{axis}, × {} ({held})", decimals(range(&values), 0));
        let slope = |of: &str| if of == axis { digits(fit.coefficients[1]) } else { String::new() };
        fits.push(fitted(what, &fit, [slope("pixels"), slope("pairs")]));
        for m in &points {
            let row = vec![axis.to_owned(), number(m, "pixels"), number(m, "pairs")];
            rows.push([row, against(m, rates.bound(m)).to_vec()].concat());
        }
        all.extend(points);
    }
    let plane = Fit::of(&[&column(&all, "pixels"), &column(&all, "pairs")], &least(&all))
        .ok_or("group 'cost' does not tell pixels from pairs")?;
    fits.push(fitted("all points".to_owned(), &plane, [digits(plane.coefficients[1]), digits(plane.coefficients[2])]));
    let columns = [&["varied", "pixels", "pairs"][..], &AGAINST].concat();
    out += &table(&columns, 1, &rows);
    out += "\nLeast-squares fits through the smallest times:\n\n";
    let columns = ["varied", "constant, ms", "ms per million pixels", "ms per million pairs", "R²", "worst point"];
    out += &table(&columns, 1, &fits);
    out += "\n![Milliseconds a picture against pixels and against pairs, with straight lines](figures/cost.svg)\n";
    Ok(out)
}

/// A row of the table of fits.
fn fitted(what: String, fit: &Fit, [pixels, pairs]: [String; 2]) -> Vec<String> {
    let worst = format!("{} % off", decimals(100.0 * fit.worst, 0));
    vec![what, digits(fit.coefficients[0]), pixels, pairs, decimals(fit.r2, 4), worst]
}

/// The same as a plot, with the fitted lines.
pub fn cost_plot(bench: &Bench) -> Result<String, String> {
    let mut drawings = Vec::new();
    for (axis, title) in [("pixels", "By pixels, pairs constant"), ("pairs", "By pairs, pixels constant")] {
        let points = points(bench, axis);
        let fit = line(&points, axis)?;
        let xs = column(&points, axis);
        let measured = xs.iter().zip(least(&points)).map(|(x, y)| [*x, y]).collect();
        let fitted = xs.iter().map(|x| [*x, fit.at(&[*x])]).collect();
        let lines =
            vec![Line { name: "measured, smallest", points: measured }, Line { name: "straight line", points: fitted }];
        let name = format!("million {axis}");
        let plot =
            Lines { title, x: Axis::from_zero(&name), y: Axis::from_zero("ms per picture"), lines, marks: Vec::new() };
        drawings.push(plot.drawing());
    }
    Ok(sheet("Cost against pixels and pairs", &drawings, 2))
}

/// Culling methods; only a remark if the shared model is missing.
pub fn culling(bench: &Bench) -> Result<String, String> {
    if bench.group("culling").next().is_none() {
        return Ok("Not measured: the shared model is missing.\n".to_owned());
    }
    let get = |rung: &'static str, at_16: &'static str| bench.get(&format!("culling/{rung}")).map(|m| (rung, m, at_16));
    let (exact, wide) = (get("exact", "exact_pairs_at_16")?, get("3-sigma", "three_sigma_pairs_at_16")?);
    let row = |(rung, m, at_16): (&str, _, _)| vec![rung.to_owned(), number(m, at_16), number(m, "pairs"), time(m)];
    let rows: Vec<Vec<String>> = [exact, wide].map(row).to_vec();
    let fewer = |a: f64, b: f64| percent(b - a, b);
    let (exact, wide) = (exact.1, wide.1);
    let gained = vec![
        "exact: fewer than 3-sigma by".to_owned(),
        fewer(exact.number("exact_pairs_at_16"), exact.number("three_sigma_pairs_at_16")),
        fewer(exact.number("pairs"), wide.number("pairs")),
        String::new(),
    ];
    let own = format!("pairs per image, tiles of {}", exact.number("tile"));
    Ok(table(&["culling", "pairs per image, tiles of 16", &own, "ms per image"], 1, &[rows, vec![gained]].concat()))
}

/// One training iteration by stage.
pub fn iteration(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let stages = stages(bench, &rates, "iteration", ITERATION);
    let (all, bound) = whole(bench, &rates, "iteration", ITERATION, &stages)?;
    let sum: f64 = stages.iter().map(|(_, m, _)| m.ms[1]).sum();
    let mut rows = Vec::new();
    for (stage, m, bound) in &stages {
        rows.push([vec![(*stage).to_owned(), percent(m.ms[1], sum)], against(m, *bound).to_vec()].concat());
    }
    rows.push([vec![WHOLE.to_owned(), String::new()], against(all, bound).to_vec()].concat());
    let columns = [&["stage", "share"][..], &AGAINST].concat();
    Ok(format!(
        "{} Gaussians ({} visible), {} pixels, tiles of {}: **{} pairs per image**. Target: {} ms or less; median: **{} ms**.\n\n{}\n![Milliseconds of an iteration by stage](figures/iteration.svg)\n",
        number(all, "gaussians"),
        number(all, "visible"),
        number(all, "pixels"),
        number(all, "tile"),
        number(all, "pairs"),
        TARGET,
        digits(all.ms[1]),
        table(&columns, 1, &rows)
    ))
}

/// The stages of an iteration as bars.
pub fn iteration_plot(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let timed: Vec<Bar> = stages(bench, &rates, "iteration", ITERATION)
        .into_iter()
        .map(|(stage, m, bound)| {
            let times = bound.map(|b| format!(" ({} x)", short_ratio(m.ms[1] / b.ms))).unwrap_or_default();
            Bar { name: stage.to_owned(), value: m.ms[1], text: format!("{} ms{times}", digits(m.ms[1])) }
        })
        .collect();
    let title = "An iteration by stage; in brackets, times its bound";
    Ok(sheet(title, &[bars(title, &timed)], 1))
}

//! Frames, iterations, what they cost by pixels and pairs, and ways of culling.

use super::bound::{Bound, Rates};
use super::fit::Fit;
use super::measured::{Bench, Measured};
use super::tables::{AGAINST, against, digits, short_ratio, table, time};
use qirf_vk::render::STAGES;
use qirf_vk::report::format::{count, decimals, percent};
use qirf_vk::report::plot::{Axis, Bar, Line, Lines, drawing_of_bars, sheet};
use qirf_vk::train;

const WHOLE: &str = "whole, by the host's clock";
/// Gaussians of the frames, as the benchmarks name them.
const FRAMES: [&str; 3] = ["10k", "100k", "500k"];
const ITERATION: &str = "10k";
/// Milliseconds that an iteration may take.
const ASKED: f64 = 50.0;

/// The stages of a group that were timed, with their bounds. Without the device's timestamps there are none.
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

/// The whole, whose stages run one after another: its bound is the sum of theirs.
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

/// Time by stage of one picture.
///
/// # Errors
/// What was not measured.
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
///
/// # Errors
/// What was not measured.
pub fn cost(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let mut out = String::new();
    let (mut rows, mut told) = (Vec::new(), Vec::new());
    let mut all = Vec::new();
    for (axis, other) in [("pixels", "pairs"), ("pairs", "pixels")] {
        let points = points(bench, axis);
        let fit = line(&points, axis)?;
        let (values, others) = (column(&points, axis), column(&points, other));
        let range =
            |v: &[f64]| v.iter().fold(0.0_f64, |m, v| m.max(*v)) / v.iter().fold(f64::INFINITY, |m, v| m.min(*v));
        told.push(format!(
            "* along {axis}, {} times as many from the first to the last ({other} {}): {} ms + {} ms a million {axis}, R² {}, the worst point {} % off;",
            decimals(range(&values), 0),
            if range(&others) < 1.0005 { "the same".to_owned() } else { format!("within {} %", short_ratio(100.0 * (range(&others) - 1.0))) },
            digits(fit.coefficients[0]),
            digits(fit.coefficients[1]),
            decimals(fit.r2, 4),
            decimals(100.0 * fit.worst, 0),
        ));
        for m in &points {
            let row = vec![axis.to_owned(), number(m, "pixels"), number(m, "pairs")];
            rows.push([row, against(m, rates.bound(m)).to_vec()].concat());
        }
        all.extend(points);
    }
    let plane = Fit::of(&[&column(&all, "pixels"), &column(&all, "pairs")], &least(&all))
        .ok_or("group 'cost' does not tell pixels from pairs")?;
    told.push(format!(
        "* all points by both: {} ms + {} ms a million pixels + {} ms a million pairs, R² {}, the worst point {} % off.",
        digits(plane.coefficients[0]),
        digits(plane.coefficients[1]),
        digits(plane.coefficients[2]),
        decimals(plane.r2, 4),
        decimals(100.0 * plane.worst, 0),
    ));
    let columns = [&["varied", "pixels", "pairs"][..], &AGAINST].concat();
    out += &table(&columns, 1, &rows);
    out += &format!("\nStraight lines through the smallest times, by least squares:\n\n{}\n", told.join("\n"));
    out += "\n![Milliseconds a picture against pixels and against pairs, with straight lines](figures/cost.svg)\n";
    Ok(out)
}

/// The same with straight lines through them.
///
/// # Errors
/// What was not measured.
pub fn cost_plot(bench: &Bench) -> Result<String, String> {
    let mut drawings = Vec::new();
    for (axis, title) in [("pixels", "By pixels, the pairs held"), ("pairs", "By pairs, the pixels held")] {
        let points = points(bench, axis);
        let fit = line(&points, axis)?;
        let xs = column(&points, axis);
        let measured = xs.iter().zip(least(&points)).map(|(x, y)| [*x, y]).collect();
        let fitted = xs.iter().map(|x| [*x, fit.at(&[*x])]).collect();
        let lines =
            vec![Line { name: "measured, smallest", points: measured }, Line { name: "straight line", points: fitted }];
        let name = format!("million {axis}");
        let plot =
            Lines { title, x: Axis::from_zero(&name), y: Axis::from_zero("ms a picture"), lines, marks: Vec::new() };
        drawings.push(plot.drawing());
    }
    Ok(sheet("Cost against pixels and pairs", &drawings, 2))
}

/// Ways of culling; without the shared model there is nothing to say but that.
///
/// # Errors
/// What was measured in part.
pub fn culling(bench: &Bench) -> Result<String, String> {
    if bench.group("culling").next().is_none() {
        return Ok("Not measured: the model was not there.\n".to_owned());
    }
    let rungs = ["exact", "box", "3-sigma"].map(|rung| bench.get(&format!("culling/{rung}")).map(|m| (rung, m)));
    let [exact, boxed, wide] = rungs;
    let (exact, boxed, wide) = (exact?, boxed?, wide?);
    let at_16 = [Some("exact_pairs_at_16"), None, Some("three_sigma_pairs_at_16")];
    let rows: Vec<Vec<String>> = [exact, boxed, wide]
        .into_iter()
        .zip(at_16)
        .map(|((rung, m), at_16)| {
            vec![rung.to_owned(), at_16.map(|n| number(m, n)).unwrap_or_default(), number(m, "pairs"), time(m)]
        })
        .collect();
    let fewer = |a: f64, b: f64| percent(b - a, b);
    let (exact, wide) = (exact.1, wide.1);
    let gained = vec![
        "exact has fewer than 3-sigma by".to_owned(),
        fewer(exact.number("exact_pairs_at_16"), exact.number("three_sigma_pairs_at_16")),
        fewer(exact.number("pairs"), wide.number("pairs")),
        String::new(),
    ];
    let own = format!("pairs an image, tiles of {}", exact.number("tile"));
    Ok(table(&["", "pairs an image, tiles of 16", &own, "ms an image"], 1, &[rows, vec![gained]].concat()))
}

/// One step of training, by stage.
///
/// # Errors
/// What was not measured.
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
        "{} Gaussians, {} of them visible, {} pixels in tiles of {}: **{} pairs an image**. {} ms or less were asked for; the median is **{} ms**.\n\n{}\n![Milliseconds of an iteration by stage](figures/iteration.svg)\n",
        number(all, "gaussians"),
        number(all, "visible"),
        number(all, "pixels"),
        number(all, "tile"),
        number(all, "pairs"),
        ASKED,
        digits(all.ms[1]),
        table(&columns, 1, &rows)
    ))
}

/// The stages of an iteration as bars.
///
/// # Errors
/// What was not measured.
pub fn iteration_plot(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let bars: Vec<Bar> = stages(bench, &rates, "iteration", ITERATION)
        .into_iter()
        .map(|(stage, m, bound)| {
            let times = bound.map(|b| format!(" ({} x)", short_ratio(m.ms[1] / b.ms))).unwrap_or_default();
            Bar { name: stage.to_owned(), value: m.ms[1], text: format!("{} ms{times}", digits(m.ms[1])) }
        })
        .collect();
    let title = "An iteration by stage; in brackets, times its bound";
    Ok(sheet(title, &[drawing_of_bars(title, &bars)], 1))
}

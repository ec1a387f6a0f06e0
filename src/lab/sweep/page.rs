//! `sweep.html`: accuracy against time for each axis, the cost of the next more exact rung, and all measurements.

use super::SweepRecord;
use super::records::{AxisRecord, Better, RungRecord, Table};
use crate::report::format::{NONE, count, decimals, seconds, short};
use crate::report::page::Column::{self, Number, Text};
use crate::report::page::{self, Section, absent, facts, list, side_by_side, table};
use crate::report::plot::{Accuracies, Axis as Scale, Front, Point};
use maud::{Markup, html};

pub fn page(swept: &SweepRecord) -> String {
    let mut sections = vec![Section("summary", "Cost of exactness", summary(swept))];
    for record in &swept.axes {
        sections.push(Section(record.axis.name, record.axis.title, body(record)));
    }
    let subtitle = format!(
        "{}: {}; qirf-vk {} on {}",
        swept.subject.path, swept.subject.origin, swept.version, swept.device.info.name
    );
    page::page("Accuracy against time", &subtitle, &sections)
}

fn summary(swept: &SweepRecord) -> Markup {
    let s = &swept.subject;
    let mut told = vec![("device", format!("{} ({})", swept.device.info.name, swept.device.info.driver))];
    if s.gaussians > 0 {
        told.push(("model of the light axes", format!("{} Gaussians, SH degree {}", count(s.gaussians), s.degree)));
        told.push(("views", format!("{} of {} × {} pixels", s.views, s.size[0], s.size[1])));
    }
    told.push(("host threads", swept.host_threads.to_string()));
    told.push(("total time", seconds(swept.seconds)));
    html! {
        (facts(&told))
        ul {
            @for record in &swept.axes {
                li { a href={ "#" (record.axis.name) } { (record.axis.name) } ": " (record.sentence) }
            }
        }
        p class="hint" {
            "The rungs of an axis take turns, round after round. The first round is not counted, because it also compiles. Times are \
             medians; whiskers are quartiles. Work on the device is timed by the device, all other \
             work by the host."
        }
    }
}

fn body(record: &AxisRecord) -> Markup {
    html! {
        p { (record.sentence) }
        @for flat in &record.flat { p { (flat) } }
        @if record.rungs.is_empty() {
            (absent("No rung was measured."))
        } @else {
            (side_by_side(&[plot(record), rungs(record)]))
            (figures(record))
        }
        @for note in &record.notes { p class="hint" { (note) } }
        @for t in &record.tables { (details(t)) }
        p class="hint" { "Time: " (record.axis.time) ". Accuracy: " (record.axis.accuracy) ", compared with " (record.axis.against) ". Measuring took " (seconds(record.seconds)) "." }
    }
}

fn plot(record: &AxisRecord) -> Markup {
    let axis = record.axis;
    let measured: Vec<f64> = record.rungs.iter().filter_map(|r| r.accuracy).collect();
    let accuracies = Accuracies::new(&measured, axis.better == Better::Lower);
    let point = |r: &RungRecord| {
        let (at, spread) = match axis.abscissa {
            Some(figure) => r.figures.get(figure).map(|v| (*v, [*v; 2]))?,
            None => r.time.map(|t| (t.median, [t.q1, t.q3]))?,
        };
        Some(Point {
            label: r.name.clone(),
            told: format!("{}: {} at {}", r.name, record.shown(r), short(at)),
            at: [at, accuracies.place(r.accuracy, r.exact)?],
            spread,
            front: r.front,
            default: r.default,
        })
    };
    let mut points: Vec<Point> = record.rungs.iter().filter_map(point).collect();
    let mut legend = ["on the Pareto front", "not on the front"].map(str::to_owned);
    if axis.abscissa.is_some() {
        // Times, which the Pareto front is about, are not shown here: the line goes through the values of epsilon.
        legend = ["values of epsilon", "dilations"].map(str::to_owned);
        for point in &mut points {
            point.front = !point.label.starts_with("t=");
        }
    }
    if points.iter().any(|p| p.default) {
        legend[1] += "; ring: default";
    }
    let legend = legend.each_ref().map(String::as_str);
    let xs: Vec<f64> = points.iter().map(|p| p.at[0]).collect();
    let title = axis.abscissa.map_or(axis.time, |_| "median condition number of a block's Gram matrix");
    let x = if axis.abscissa.is_some() { Scale::new(title) } else { Scale::from_zero(title) };
    let (x, y) = (x.or_log(&xs), accuracies.axis(axis.accuracy));
    Front { title: axis.title, x, y, legend: &legend, points }.drawing().figure()
}

/// A column of times, with their unit, the first word of the axis's.
fn of_time(name: &str, record: &AxisRecord) -> String {
    format!("{name} / {}", record.axis.time.split(' ').next().unwrap_or_default())
}

/// A measured number with the minus sign of the other tables.
fn minus(number: &str) -> String {
    number.replace('-', "−")
}

fn rungs(record: &AxisRecord) -> Markup {
    let [time, quartiles] = ["time", "quartiles"].map(|name| of_time(name, record));
    list(
        &record.rungs,
        &[
            (Text("rung"), &|r| r.name.clone()),
            (Number(&time), &|r| r.time.map_or(NONE.into(), |t| short(t.median))),
            (Number(&quartiles), &|r| r.time.map_or(NONE.into(), |t| format!("{} to {}", short(t.q1), short(t.q3)))),
            (Number("accuracy"), &|r| minus(&record.shown(r))),
            (Text(""), &|r| r.mark().to_owned()),
        ],
    )
}

/// The heading of a measurement's column.
fn heading(name: &str) -> String {
    match name {
        "kept_jaccard" => "Jaccard index of the kept set".to_owned(),
        "kept_jaccard_m256" => "Jaccard index of the kept set, blocks of 256".to_owned(),
        "speedup_m256" => "speedup, blocks of 256".to_owned(),
        "nan_share" => "NaN, all pairs".to_owned(),
        "thin_nan_share" => "NaN, thin pairs".to_owned(),
        "flat_nan_share" => "NaN, flat pairs".to_owned(),
        other => other.replace('_', " "),
    }
}

/// Further measurements of each rung.
fn figures(record: &AxisRecord) -> Markup {
    let mut names: Vec<&str> = record.rungs.iter().flat_map(|r| r.figures.keys().copied()).collect();
    names.sort_unstable();
    names.dedup();
    let titles: Vec<String> = names.iter().map(|n| heading(n)).collect();
    let clock = of_time("host's clock", record);
    let columns: Vec<Column<'_>> =
        [Text("rung"), Number("rounds"), Number(&clock)].into_iter().chain(titles.iter().map(|t| Number(t))).collect();
    let value = |v: f64| if (0.01..100.0).contains(&v.abs()) { decimals(v, 4) } else { short(v) };
    let row = |r: &RungRecord| {
        let cells = names.iter().map(|n| r.figures.get(n).map_or(NONE.into(), |v| value(*v)));
        let rounds = r.time.map_or(NONE.into(), |t| t.samples.to_string());
        let wall = r.wall.map_or(NONE.into(), |t| short(t.median));
        [r.name.clone(), rounds, wall].into_iter().chain(cells).collect::<Vec<_>>()
    };
    table(&columns, &record.rungs.iter().map(row).collect::<Vec<_>>(), None)
}

fn details(t: &Table) -> Markup {
    let column = |(k, title): (usize, &&'static str)| if k == 0 { Text(title) } else { Number(title) };
    let columns: Vec<Column<'_>> = t.columns.iter().enumerate().map(column).collect();
    let cell = |(k, cell): (usize, &String)| if k == 0 { cell.clone() } else { minus(cell) };
    let rows: Vec<Vec<String>> = t.rows.iter().map(|row| row.iter().enumerate().map(cell).collect()).collect();
    html! {
        h3 { (t.title) }
        (table(&columns, &rows, None))
    }
}

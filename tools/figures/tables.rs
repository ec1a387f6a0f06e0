//! Markdown tables, and the tables of the device and of the primitives.

use super::Origin;
use super::bound::{Bound, Rates};
use super::measured::{Bench, Measured};
use qirf_vk::report::format::{NONE, count, decimals, short};
use std::fmt::Write as _;

/// Titles of the columns of [`against`].
pub const AGAINST: [&str; 4] = ["ms", "bound, ms", "limited by", "ms / bound"];

/// A table; the columns after the first `texts` are numbers.
pub fn table(columns: &[&str], texts: usize, rows: &[Vec<String>]) -> String {
    let line = |cells: &[&str]| format!("| {} |\n", cells.join(" | "));
    let mut out = line(columns);
    let rule: Vec<&str> = (0..columns.len()).map(|k| if k < texts { "---" } else { "---:" }).collect();
    out += &format!("|{}|\n", rule.join("|"));
    for row in rows {
        out += &line(&row.iter().map(String::as_str).collect::<Vec<_>>());
    }
    out
}

/// Three digits, whole numbers in groups.
pub fn digits(value: f64) -> String {
    match value {
        v if !v.is_finite() => NONE.to_owned(),
        v if v.abs() >= 99.95 => format!("{}{}", if v < 0.0 { "−" } else { "" }, count(v.abs().round() as usize)),
        v if v.abs() >= 9.995 => decimals(v, 1),
        v if v.abs() >= 0.9995 => decimals(v, 2),
        v => decimals(v, if v.abs() >= 0.0995 { 3 } else { 4 }),
    }
}

/// `median [smallest..largest]`, in milliseconds.
pub fn time(m: &Measured) -> String {
    let [low, middle, high] = m.ms.map(digits);
    format!("{middle} [{low}..{high}]")
}

/// Cells of a time, its bound, what limits it, and their ratio.
pub fn against(m: &Measured, bound: Option<Bound>) -> [String; 4] {
    let none = || NONE.to_owned();
    let [ms, by, ratio] = bound
        .map_or_else(|| [none(), none(), none()], |b| [digits(b.ms), b.by.to_owned(), short_ratio(m.ms[1] / b.ms)]);
    [time(m), ms, by, ratio]
}

/// Two digits.
pub fn short_ratio(ratio: f64) -> String {
    decimals(ratio, usize::from(ratio < 9.95))
}

/// The device, its best rates, and how the figures were measured.
pub fn device(bench: &Bench, origin: &Origin) -> Result<String, String> {
    let d = &bench.device;
    let text = |name: &str| d[name].as_str().unwrap_or("unknown").to_owned();
    let (quick, load) = (d["quick"].as_bool().unwrap_or(false), d["load"].as_f64());
    let clock = if d["timestamps"].as_bool().unwrap_or(false) {
        "device timestamps"
    } else {
        "the host's clock, submissions included"
    };
    let conditions = format!(
        "{} samples per benchmark, one run; times by {clock}{}",
        if quick { 10 } else { 20 },
        load.map(|l| format!("; load average {} before the start", decimals(l, 1))).unwrap_or_default()
    );
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let facts = [
        row("device", format!("{}, subgroups of {}", text("name"), d["subgroup"])),
        row("driver", text("driver")),
        row("host", format!("{} threads, {}", d["threads"], text("cpu"))),
        row("commit", origin.commit.clone()),
        row("command", format!("`{}`", origin.command)),
        row("conditions", conditions),
    ];
    let mut sizes: Vec<(f64, &str)> = bench
        .group("device")
        .filter_map(|(name, m)| Some((m.number("buffers"), name.strip_prefix("copy by a kernel/")?)))
        .collect();
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let rates = Rates::of(bench)?;
    let mut rows = Vec::new();
    for (_, size) in sizes {
        let mut cells = vec![size.to_owned()];
        for by in ["copy by a kernel", "copy by command"] {
            let m = bench.get(&format!("device/{by}/{size}"))?;
            let rate = |ms: f64| short(1e-6 * m.number("bytes") / ms);
            cells.push(format!("{} ({})", rate(m.ms[0]), rate(m.ms[1])));
        }
        rows.push(cells);
    }
    let mut out = table(&["", ""], 2, &facts);
    let _ = write!(out, "\nBest rates of this device (bench group `device`), medians in brackets:\n\n");
    out += &table(&["copy between two buffers of", "with a kernel, GB/s", "with a copy command, GB/s"], 1, &rows);
    let middle = bench.get("device/multiply-add")?;
    let _ = write!(
        out,
        "\nfloat32 multiply-adds: {} GFLOP/s ({}).\n",
        short(1e-9 * rates.operations),
        short(1e-6 * middle.number("operations") / middle.ms[1])
    );
    let chain = bench.get("device/chain of dispatches")?;
    let each = |ms: f64| short(1e3 * ms / chain.number("dispatches"));
    let _ = write!(
        out,
        "\nA dispatch of one workgroup that waits for the one before: {} µs ({}).\n",
        each(chain.ms[0]),
        each(chain.ms[1])
    );
    Ok(out)
}

pub fn sort(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let mut rows = Vec::new();
    for group in ["sort", "scan"] {
        let mut sizes: Vec<_> = bench.group(group).collect();
        sizes.sort_by(|a, b| a.1.number("elements").total_cmp(&b.1.number("elements")));
        if sizes.is_empty() {
            return Err(format!("group '{group}' was not measured; run all groups: make figures"));
        }
        for (size, m) in sizes {
            let mut row = vec![group.to_owned(), size.to_owned(), short(1e-3 * m.number("elements") / m.ms[1])];
            row.extend(against(m, rates.bound(m)));
            rows.push(row);
        }
    }
    let columns = [&["stage", "elements", "M elements/s"][..], &AGAINST].concat();
    Ok(table(&columns, 2, &rows))
}

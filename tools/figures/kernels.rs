//! Kernels measured on their own, at several sizes.

use super::bound::Rates;
use super::measured::Bench;
use super::tables::{AGAINST, against, table};
use qirf_vk::report::format::{count, short};

/// Bench group, and the unit of its rates.
const GROUPS: [(&str, &str); 4] =
    [("loss", "pixels"), ("overlap", "pairs"), ("rrdm", "pairs"), ("participation", "blocks")];

/// Loss, overlaps, density matrices, and the device's eigensolver.
pub fn kernels(bench: &Bench) -> Result<String, String> {
    let rates = Rates::of(bench)?;
    let mut rows = Vec::new();
    for (group, of) in GROUPS {
        let mut all: Vec<_> = bench.group(group).map(|(name, m)| (sizes(name), name, m)).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.cmp(b.1)));
        if all.is_empty() {
            return Err(format!("group '{group}' was not measured; run all groups: make figures"));
        }
        for (_, name, m) in all {
            let amount = m.number(of);
            // Density matrices have no methods, despite the benchmark's name.
            let name = if group == "rrdm" { name.trim_start_matches("qr/") } else { name };
            let what = match name.split_once('/') {
                Some((method, m)) => format!("{method}, m = {m}"),
                None if group == "loss" => name.to_owned(),
                None => format!("m = {name}"),
            };
            let mut row =
                vec![group.to_owned(), what, format!("{} {of}", count(amount as usize)), short(1e3 * amount / m.ms[1])];
            row.extend(against(m, rates.bound(m)));
            rows.push(row);
        }
    }
    let columns = [&["stage", "variant", "work", "units/s"][..], &AGAINST].concat();
    Ok(table(&columns, 2, &rows))
}

/// The numbers in a name, by which names are sorted.
fn sizes(name: &str) -> Vec<u64> {
    name.split(|c: char| !c.is_ascii_digit()).filter_map(|digits| digits.parse().ok()).collect()
}

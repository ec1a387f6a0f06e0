//! Time that each effect adds to an iteration.

use super::measured::{Bench, Measured};
use super::tables::{table, time};
use qirf_vk::report::format::decimals;

/// The group `effects`, in its own order.
pub fn effects(bench: &Bench) -> Result<String, String> {
    let mut arms: Vec<_> = bench.group("effects").collect();
    arms.sort_by(|a, b| a.1.number("order").total_cmp(&b.1.number("order")));
    if arms.is_empty() {
        return Err("group 'effects' was not measured; run all groups: make figures".to_owned());
    }
    let row = |(name, m): (&str, &Measured)| {
        let name = name.rsplit_once('/').map_or(name, |(name, _)| name).to_owned();
        let [times, low, high] = ["times_off", "low", "high"].map(|n| decimals(m.number(n), 3));
        vec![name, time(m), times, format!("{low} to {high}")]
    };
    let rows: Vec<Vec<String>> = arms.into_iter().map(row).collect();
    Ok(table(&["on", "ms", "ratio to all off", "middle half"], 1, &rows))
}
